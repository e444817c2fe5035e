"""A robot moved until its tasks are met, or until nothing more can be done."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from prioritized_ik.guard import Limit
from prioritized_ik.motion import RECOVERY, Levels, grouped, solve_step
from prioritized_ik.problem import IKProblem
from prioritized_ik.robot import Robot
from prioritized_ik.solvers.methods import Method
from prioritized_ik.solvers.registry import DEFAULT
from prioritized_ik.solvers.step import JointStep
from prioritized_ik.tasks.task import Task
from prioritized_ik.validation import Array, at_least, positive

#: A step below this part of the tolerance, in the joint metric, is rest.
REST = 1e-2


class Ending(Enum):
    """How a robot's way to its targets ended."""

    REACHED = "every required task is within the tolerance"
    OUT_OF_REACH = "at rest with no limit in the way: no small step brings the required tasks closer"
    STUCK = "at rest, held back by limits"
    OUT_OF_STEPS = "still moving after the last step allowed"
    SOLVER_FAILED = "the solver gave no step, so the robot stopped"


@dataclass(frozen=True)
class Reached:
    """How `reach` ended.

    Attributes:
        ending: see `Ending`.
        q: the position at the end `(nq,)`.
        errors: ‖e‖ of every required task at the end, by name.
        nearest: the least that the largest of these was on the way.
        held_by: names of the limits that hold the required levels back, from the last step's certificate.
        steps: how many were taken.
    """

    ending: Ending
    q: Array
    errors: dict[str, float]
    nearest: float
    held_by: tuple[str, ...]
    steps: int

    def __str__(self) -> str:
        """Return one line for people."""
        errors = ", ".join(f"{name} {error:.3g}" for name, error in self.errors.items())
        held = f"; held by {', '.join(self.held_by)}" if self.held_by else ""
        return f"{self.ending.name} after {self.steps} steps: {errors}{held}"


def reach(
    robot: Robot,
    levels: Levels,
    limits: Sequence[Limit] = (),
    dt: float = 0.01,
    max_steps: int = 1000,
    tolerance: float = 1e-4,
    *,
    required: int = 1,
    damping: float = 1.0,
    solver: str | Method = DEFAULT,
    progress: Callable[[int, float], object] | None = None,
) -> Reached:
    """Move the robot step by step until its tasks are met, and return how that ended.

    Rest is a local finding: from another start, the same targets may be in reach.

    Args:
        robot: is moved.
        levels: see `solve_step`.
        limits: see `solve_step`.
        dt: see `solve_step`.
        max_steps: at most so many.
        tolerance: of each required task's ‖e‖, in its units [m, rad].
        required: how many levels, from the first, are to be met; those below do what they can.
        damping: see `solve_step`.
        solver: see `solve_step`.
        progress: called after each step with its number and the largest required error.

    Raises:
        InputError: see `solve_step`.
        StepNotFoundError: see `solve`.
    """
    least = positive("tolerance", tolerance)
    wanted = [task for tasks in grouped(levels)[: at_least("required", required, 1)] for task in tasks]
    most = at_least("max_steps", max_steps, 1)
    errors, taken = errors_of(robot, wanted), 0
    held: tuple[str, ...] = ()
    nearest = _largest(errors)
    ending = Ending.REACHED if nearest <= least else Ending.OUT_OF_STEPS
    while ending is Ending.OUT_OF_STEPS and taken < most:
        motion = solve_step(robot, levels, limits, dt, damping=damping, solver=solver)
        robot.integrate(motion.velocity, dt)
        errors, taken = errors_of(robot, wanted), taken + 1
        nearest = min(nearest, _largest(errors))
        if progress is not None:
            progress(taken, _largest(errors))
        ending, held = ending_after(motion.problem, motion.step, _largest(errors), least, required)
    return Reached(ending, robot.q, errors, nearest, held, taken)


def errors_of(robot: Robot, tasks: Sequence[Task]) -> dict[str, float]:
    """Return ‖e‖ of each task by name, rows without weight left out."""
    return {task.name: float(np.linalg.norm(np.sign(task.weights) * task.rows(robot)[1])) for task in tasks}


def ending_after(
    problem: IKProblem, step: JointStep, error: float, tolerance: float, required: int
) -> tuple[Ending, tuple[str, ...]]:
    """Return how things stand after a step, and the names of the limits that hold the required levels back.

    Args:
        problem: of the step.
        step: what was taken.
        error: the largest of the required tasks' ‖e‖ after it.
        tolerance: of that error.
        required: how many levels of tasks, from the first, are to be met.
    """
    if step.dtheta is None:
        return Ending.SOLVER_FAILED, ()
    if error <= tolerance:
        return Ending.REACHED, ()
    if np.linalg.norm(problem.to_metric(step.dtheta)) > REST * tolerance:
        return Ending.OUT_OF_STEPS, ()
    held = _held_by(problem, step, required)
    return (Ending.STUCK if held else Ending.OUT_OF_REACH), held


def _largest(errors: dict[str, float]) -> float:
    return max(errors.values(), default=0.0)


def _held_by(problem: IKProblem, step: JointStep, required: int) -> tuple[str, ...]:
    """Return the limits that hold the required levels back."""
    if step.certificate is None:
        return ()
    first = sum(level.name == RECOVERY for level in problem.levels)
    held = step.certificate.held_by[first : first + required]
    return tuple(dict.fromkeys(name for names in held for name in names))
