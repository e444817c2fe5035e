"""A scene and its run: step by step, each target where it is at the end of the step."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from prioritized_ik.errors import InputError
from prioritized_ik.guard import Limit
from prioritized_ik.motion import posed_and_solved
from prioritized_ik.problem import IKProblem
from prioritized_ik.reaching import REST, Ending, ending_after, errors_of
from prioritized_ik.recording import Recording
from prioritized_ik.robot import Robot
from prioritized_ik.scene.entries import AimedTask, LimitEntry, TaskEntry, placed
from prioritized_ik.solvers.explain import Concession, explain
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.methods import Method, Place
from prioritized_ik.solvers.registry import DEFAULT, get_method
from prioritized_ik.solvers.solve import step_of
from prioritized_ik.solvers.step import JointStep
from prioritized_ik.tasks.task import Task
from prioritized_ik.validation import Array, at_least, distinct, non_negative, positive, read_only


@dataclass(frozen=True)
class Staged:
    """A scene set up: a robot at the start, its tasks by level, those whose targets move, and its limits."""

    robot: Robot
    levels: list[list[Task]]
    aimed: list[AimedTask]
    limits: list[Limit]


@dataclass(frozen=True)
class SceneStep:
    """One step of a scene.

    Attributes:
        time: at its end [s].
        q: the position at its end `(nq,)`.
        problem: what was solved.
        step: what came of it; without dθ the robot did not move.
        errors: ‖e‖ of every task at its end, by name, against its target then [m, rad].
    """

    time: float
    q: Array
    problem: IKProblem
    step: JointStep
    errors: dict[str, float]


@dataclass(frozen=True, eq=False)
class Scene:
    """A robot, what it is asked to do over time, and its limits. `load_scene` reads one from a task file.

    Attributes:
        model: the robot's.
        q: where it starts `(nq,)`.
        tasks: what it is asked to do.
        limits: what its steps must keep.
        dt: time step [s].
        duration: of the whole, rounded to whole steps [s].
        required: how many levels, from the first, are to be met at the end.
        tolerance: of each required task's ‖e‖ at the end, in its units [m, rad].
        damping: see `solve_step`.
        solver: name of the method, see `solve`.

    Raises:
        InputError: a value out of range, a position of another length, a frame, joint or method that does not exist, or a
            target that its task refuses; the message says where.
        SolverUnavailableError: the method is unknown, or not installed.
    """

    model: mujoco.MjModel
    q: Array
    tasks: Sequence[TaskEntry]
    limits: Sequence[LimitEntry] = ()
    dt: float = 0.01
    duration: float = 1.0
    required: int = 1
    tolerance: float = 1e-4
    damping: float = 1.0
    solver: str = DEFAULT

    def __post_init__(self) -> None:
        for name in ("dt", "duration", "tolerance"):
            object.__setattr__(self, name, positive(name, getattr(self, name)))
        if self.duration < self.dt:
            raise InputError(f"duration is {self.duration!r}, less than a step of {self.dt!r}; expected at least one step.")
        object.__setattr__(self, "required", at_least("required", self.required, 1))
        object.__setattr__(self, "damping", non_negative("damping", self.damping))
        if not isinstance(self.solver, str):
            raise InputError(f"solver is {self.solver!r}; expected the name of a method, such as {DEFAULT!r}.")
        get_method(self.solver)
        object.__setattr__(self, "tasks", tuple(self.tasks))
        object.__setattr__(self, "limits", tuple(self.limits))
        if not self.tasks or not all(isinstance(task, TaskEntry) for task in self.tasks):
            raise InputError(f"tasks is {self.tasks!r}; expected at least one TaskEntry.")
        if not all(isinstance(limit, LimitEntry) for limit in self.limits):
            raise InputError(f"limits is {self.limits!r}; expected LimitEntry objects.")
        object.__setattr__(self, "q", read_only(self.staged().robot.q))

    @property
    def step_count(self) -> int:
        """How many steps it has."""
        return round(self.duration / self.dt)

    def staged(self) -> Staged:
        """Return the scene set up anew, the robot at the start."""
        robot = Robot(self.model, self.q)
        levels: dict[int, list[Task]] = {number: [] for number in sorted({entry.level for entry in self.tasks})}
        aimed = []
        for number, entry in enumerate(self.tasks, 1):
            with placed(f"task {number}, {entry.kind}"):
                made = entry.made(robot)
            levels[entry.level].append(made.task)
            aimed.append(made)
        for one, name in zip(aimed, distinct(one.task.name for one in aimed), strict=True):
            one.task.name = name
        limits = []
        for number, limit in enumerate(self.limits, 1):
            with placed(f"limit {number}, {limit.kind}"):
                limits.append(limit.made(robot))
        return Staged(robot, list(levels.values()), aimed, limits)

    def steps(self, solver: str | Method | None = None, options: SolveOptions | None = None) -> Iterator[SceneStep]:
        """Yield step after step, until the scene is over or one is not found.

        Args:
            solver: finds the steps, instead of the one that the scene names.
            options: how.

        Raises:
            InputError: a limit is broken that may not be, or the method does not know such a problem.
        """
        chosen, options = self.solver if solver is None else solver, options or SolveOptions()
        method = get_method(chosen, options.accuracy) if isinstance(chosen, str) else chosen
        staged = self.staged()
        robot, tasks = staged.robot, [task for level in staged.levels for task in level]
        for number in range(1, self.step_count + 1):
            for aimed in staged.aimed:
                aimed.aim(number * self.dt)
            find = _finder(method, options, Place(robot.q, self))
            problem, step = posed_and_solved(robot, staged.levels, staged.limits, self.dt, find, damping=self.damping)
            if step.dtheta is not None:
                robot.integrate(step.dtheta / self.dt, self.dt)
            yield SceneStep(number * self.dt, read_only(robot.q), problem, step, errors_of(robot, tasks))
            if step.dtheta is None:
                return

    def run(self, solver: str | Method | None = None, options: SolveOptions | None = None) -> "SceneRun":
        """Return all steps, and how they ended; see `steps`."""
        return self.ended(list(self.steps(solver, options)))

    def ended(self, steps: Sequence[SceneStep]) -> "SceneRun":
        """Return the run of which these are all `steps`, at least one."""
        last, levels = steps[-1], [[task.name for task in level] for level in self.staged().levels]
        error = max(last.errors[name] for names in levels[: self.required] for name in names)
        ending, held_by = ending_after(last.problem, last.step, error, self.tolerance, self.required)
        return SceneRun(self, tuple(steps), tuple(map(tuple, levels)), ending, held_by)


@dataclass(frozen=True)
class SceneRun:
    """A scene that was run.

    Attributes:
        scene: what was run.
        steps: all of them.
        levels: names of the tasks by level, the most important first.
        ending: how it ended.
        held_by: names of the limits that hold the required levels back at the end.
    """

    scene: Scene
    steps: tuple[SceneStep, ...]
    levels: tuple[tuple[str, ...], ...]
    ending: Ending
    held_by: tuple[str, ...]

    @property
    def q(self) -> Array:
        """The positions, from the start to the end `(T + 1, nq)`."""
        return np.array([self.scene.q, *(step.q for step in self.steps)])

    @property
    def errors(self) -> dict[str, float]:
        """‖e‖ of every task at the end, by name [m, rad]."""
        return self.steps[-1].errors

    @property
    def largest_errors(self) -> dict[str, float]:
        """The largest ‖e‖ of every task at the end of any step, by name [m, rad]."""
        return {name: max(step.errors[name] for step in self.steps) for name in self.errors}

    @property
    def statuses(self) -> dict[str, int]:
        """How many steps ended how, by the names of `StepStatus`."""
        return dict(Counter(step.step.status.name for step in self.steps))

    @cached_property
    def report(self) -> tuple[Concession, ...]:
        """Which level gave way in the last step, by how much, and to what; empty if there is no such step."""
        last = self.steps[-1]
        if last.step.dtheta is None or last.step.certificate is None:
            return ()
        return explain(last.problem, last.step)

    def recording(self) -> Recording:
        """Return its problems and steps, to be saved, or compared by `prioritized-ik compare --recorded`."""
        missing = np.full(self.scene.model.nv, np.nan)
        dtheta = [missing if one.step.dtheta is None else one.step.dtheta for one in self.steps]
        return Recording.of((one.problem for one in self.steps), self.q[:-1], np.array(dtheta), self.ending.name)

    def told(self) -> str:
        """Return what there is to know of it, in lines for people."""
        least = REST * self.scene.tolerance  # less than that is rounding, of a robot at rest
        held = f", held back by {', '.join(self.held_by)}" if self.held_by else ""
        lines = [
            f"ended    {self.ending.name}: {self.ending.value}{held}",
            *([f"         {self.steps[-1].step.message}"] if self.steps[-1].step.message else []),
            f"steps    {len(self.steps)} of {self.scene.dt:g} s by {self.steps[-1].step.method}",
            f"status   {', '.join(f'{name} {count}' for name, count in self.statuses.items())}",
            "",
            f"level  {'task':<32}  {'error at the end':>16}  {'largest':>8}",
        ]
        for number, names in enumerate(self.levels, 1):
            for name in names:
                lines.append(f"{number:>5}  {name:<32}  {self.errors[name]:>16.2g}  {self.largest_errors[name]:>8.2g}")
        return "\n".join([*lines, "", *(str(one) for one in self.report if one.gave_way and one.error > least)]).rstrip()

    def to_json(self) -> dict[str, Any]:
        """Return what is known of it, as JSON takes it."""
        return {
            "ending": self.ending.name,
            "held_by": list(self.held_by),
            "dt": self.scene.dt,
            "steps": len(self.steps),
            "statuses": self.statuses,
            "tasks": [
                {"name": name, "level": number, "error": self.errors[name], "largest_error": self.largest_errors[name]}
                for number, names in enumerate(self.levels, 1)
                for name in names
            ],
            "gave_way": [
                {"level": one.level, "alone": one.alone, "error": one.error, "held_by": list(one.held_by)}
                for one in self.report
                if one.gave_way
            ],
            "message": self.steps[-1].step.message,
            "positions": self.q.tolist(),
        }


def _finder(method: Method, options: SolveOptions, place: Place) -> Callable[[IKProblem], JointStep]:
    """Return what finds a step with a method from one place."""
    return lambda problem: step_of(method, problem, options, place)
