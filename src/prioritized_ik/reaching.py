"""A robot moved until its tasks are met, or until nothing more can be done."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from prioritized_ik.guard import Limit
from prioritized_ik.motion import RECOVERY, Levels, Motion, grouped, solve_step
from prioritized_ik.robot import Robot
from prioritized_ik.solvers.methods import Method
from prioritized_ik.solvers.registry import DEFAULT
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
    errors = _errors(robot, wanted)
    held: tuple[str, ...] = ()
    nearest, ending, taken = _largest(errors), Ending.OUT_OF_STEPS, 0
    for number in range(1, at_least("max_steps", max_steps, 1) + 1):
        if _largest(errors) <= least:
            ending = Ending.REACHED
            break
        motion = solve_step(robot, levels, limits, dt, damping=damping, solver=solver)
        robot.integrate(motion.velocity, dt)
        errors, taken = _errors(robot, wanted), number
        nearest = min(nearest, _largest(errors))
        if progress is not None:
            progress(number, _largest(errors))
        if np.linalg.norm(motion.problem.to_metric(motion.velocity * dt)) <= REST * least:
            held = _held_by(motion, required)
            ending = Ending.STUCK if held else Ending.OUT_OF_REACH
            break
    if _largest(errors) <= least:
        ending = Ending.REACHED
    return Reached(ending, robot.q, errors, nearest, () if ending is Ending.REACHED else held, taken)


def _errors(robot: Robot, tasks: Sequence[Task]) -> dict[str, float]:
    return {task.name: float(np.linalg.norm(np.sign(task.weights) * task.rows(robot)[1])) for task in tasks}


def _largest(errors: dict[str, float]) -> float:
    return max(errors.values(), default=0.0)


def _held_by(motion: Motion, required: int) -> tuple[str, ...]:
    """Return the limits that hold the required levels back."""
    assert motion.step.certificate is not None
    first = sum(level.name == RECOVERY for level in motion.problem.levels)
    held = motion.step.certificate.held_by[first : first + required]
    return tuple(dict.fromkeys(name for names in held for name in names))
