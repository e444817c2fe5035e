"""One step of a robot: levels of tasks in strict order, under limits."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from prioritized_ik.curvature import Straight
from prioritized_ik.errors import InputError
from prioritized_ik.guard import Guarded, Limit
from prioritized_ik.problem import Bounds, Equalities, IKProblem, Level, Rows, posed_level, posed_problem
from prioritized_ik.robot import Robot
from prioritized_ik.solvers.explain import Concession, explain
from prioritized_ik.solvers.methods import DAMPING, Method
from prioritized_ik.solvers.registry import DEFAULT
from prioritized_ik.solvers.solve import solve
from prioritized_ik.solvers.step import JointStep
from prioritized_ik.tasks.task import Task
from prioritized_ik.tolerances import NOISE
from prioritized_ik.validation import Array, length, non_negative, positive

Levels = Sequence[Task | Sequence[Task]]

ACCURACY = 1e-4  # [m, rad] how far the curvature may take a step from where its rows say

RECOVERY = "recovery of limits"  # what the level above all tasks is called


@dataclass(frozen=True)
class Motion:
    """A step of a robot.

    Attributes:
        velocity: `(nv,)` [rad/s, m/s for slides], for `Robot.integrate`.
        step: dθ and its certificate.
        problem: what was solved.
    """

    velocity: Array
    step: JointStep
    problem: IKProblem

    @cached_property
    def report(self) -> tuple[Concession, ...]:
        """Which level gave way, by how much, and to what; worked out when first looked at, at the cost of some solves."""
        return explain(self.problem, self.step)


def grouped(levels: Levels) -> list[list[Task]]:
    """Return the tasks of each level, the most important first; a task by itself is a level.

    Raises:
        InputError: something that is no task.
    """
    if not isinstance(levels, list | tuple | Sequence):  # the first two are told faster
        raise InputError(f"levels is {levels!r}; expected a list of tasks, or of lists of tasks, one a level.")
    groups = [[entry] if isinstance(entry, Task) else entry for entry in levels]
    for group in groups:
        if not isinstance(group, list | tuple) or not all(isinstance(task, Task) for task in group):
            raise InputError(f"levels hold {group!r}; expected tasks, or lists of tasks, one a level.")
    return [list(group) for group in groups]


def build_problem(
    robot: Robot, levels: Levels, limits: Sequence[Limit] = (), dt: float = 0.01, *, damping: float = 1.0
) -> IKProblem:
    """Return the problem of the next step dθ `(nv,)`, without solving it; see `solve_step`."""
    return _problem(robot, grouped(levels), _guards(robot, limits, dt), non_negative("damping", damping))


def _guards(robot: Robot, limits: Sequence[Limit], dt: float) -> list[Guarded]:
    positive("dt", dt)
    return [_limit(limit).at(robot, dt) for limit in _listed(limits)]


def _problem(robot: Robot, groups: list[list[Task]], guards: Sequence[Guarded], damping: float) -> IKProblem:
    bounds: Bounds | None = None
    for guard in guards:
        if guard.bounds is not None:
            bounds = guard.bounds if bounds is None else guard.bounds.intersect(bounds)
    fixed = Equalities.joined([guard.equalities for guard in guards if guard.equalities is not None], robot.model.nv)
    recovery = [Level(rows.matrix, rows.upper, name=RECOVERY, kind="at_most") for rows in _joined_recovery(guards)]
    return posed_problem(
        [*recovery, *_task_levels(robot, groups, damping, fixed)],
        Bounds.none(robot.model.nv) if bounds is None else bounds,
        Rows.joined([guard.rows for guard in guards if guard.rows is not None], robot.model.nv),
        fixed,
        robot.metric,
    )


def posed_and_solved(
    robot: Robot,
    levels: Levels,
    limits: Sequence[Limit],
    dt: float,
    find: Callable[[IKProblem], JointStep],
    *,
    damping: float = 1.0,
    accuracy: float | None = ACCURACY,
) -> tuple[IKProblem, JointStep]:
    """Return the problem of the next step and its answer, of which `find` makes one of the other; see `solve_step`."""
    groups, guards = grouped(levels), _guards(robot, limits, dt)
    problem = _problem(robot, groups, guards, non_negative("damping", damping))
    if accuracy is None:
        return problem, find(problem)
    kept = list(zip(limits, guards, strict=True))
    straight = Straight(robot, [tasks for tasks in groups if tasks], kept, positive("accuracy", accuracy))
    return straight.solved(problem, find)


def solve_step(
    robot: Robot,
    levels: Levels,
    limits: Sequence[Limit] = (),
    dt: float = 0.01,
    *,
    damping: float = 1.0,
    accuracy: float | None = ACCURACY,
    solver: str | Method = DEFAULT,
) -> Motion:
    """Return the robot's next step: every level of tasks among the optima of those above it, under all limits.

    A level whose tasks leave errors e is damped by δ = `damping` Σ ℓ ‖W e‖, with ℓ the size of the rows' second
    derivatives (`Task.lever`), added to that of the levels above. That is what Gauss-Newton leaves out: out of reach, the
    robot comes to rest instead of swinging, and near the target nothing is damped. Where damping takes more than half of
    a level's weakest direction, alone or among those that the levels above leave, levels below get nothing: they would
    swing in a null space that turns from step to step.

    Rows are of first order. A step of joints dθ that reach L moves points by up to ½ L (Σ|dθ_i|)² besides: half a
    millimetre for 1 m and 3 % of a radian in all. Where a step would so leave a level that it meets, or break a limit, by
    more than `accuracy`, or open one of the model's equalities by a tenth of that, it is solved again with that taken off,
    up to three times; one that breaks a limit all the same is made shorter. `Motion.problem` is then the problem solved
    last.

    Args:
        robot: up to date; it does not move.
        levels: the most important first: a task, or a list of tasks that share a level by their weights.
        limits: such as `JointRange`, `Velocity` and `Collision`.
        dt: time step [s].
        damping: 0 for none, 1 for as much as the curvature may need.
        accuracy: see above [m, rad]; None for steps of first order alone.
        solver: see `solve`.

    Raises:
        InputError: an argument out of range or of another model.
        StepNotFoundError: see `solve`.
    """
    problem, step = posed_and_solved(
        robot, levels, limits, dt, lambda posed: solve(posed, solver), damping=damping, accuracy=accuracy
    )
    assert step.dtheta is not None
    return Motion(step.dtheta / dt, step, problem)


def _task_levels(robot: Robot, groups: list[list[Task]], damping: float, fixed: Equalities) -> Iterator[Level]:
    shared, root = 0.0, np.sqrt(robot.metric)
    left = _left_by(fixed.matrix / root, None)  # what equalities and the levels above leave free
    for number, tasks in enumerate(groups, 1):
        if not tasks:
            continue
        rows = [(task, *task.rows(robot)) for task in tasks]
        matrix = np.concatenate([jacobian for _, jacobian, _ in rows])
        weights = np.concatenate([task.weights for task in tasks])
        shared += (own := damping * sum([_strain(robot, task, error) for task, _, error in rows]))
        strained, last = False, number == len(groups)  # nobody needs what it leaves
        if not last:
            counts = weights > 0.0
            counted = np.sqrt(weights[counts])[:, None] * (matrix[counts] / root)
            strained = own > 0.0 and _weakest(counted, left) ** 2 < own
        yield posed_level(
            matrix,
            np.concatenate([task.gain * error for task, _, error in rows]),
            weights,
            " + ".join([task.name for task in tasks]),
            shared if shared > DAMPING else 0.0,
            "hold" if last or strained else "free",
        )
        if number < len(groups) - 1:
            left = _left_by(counted, left)


def _strain(robot: Robot, task: Task, error: Array) -> float:
    """Return ℓ ‖W e‖ of a task, see `solve_step`."""
    lever = task.lever(robot)
    return lever * length(task.weights * (task.gain * error)) if lever else 0.0


def _weakest(rows: Array, left: Array | None) -> float:
    """Return the smallest singular value of rows `(k, n)`, zero of a robot that is stretched out.

    Also of what they are in the directions that are `left` `(n, f)`, all if None, but for what is rounding there.
    """
    weakest = float(np.linalg.svd(rows, compute_uv=False).min(initial=np.inf))
    if left is None:
        return weakest
    within = np.linalg.svd(rows @ left, compute_uv=False)
    return min(weakest, float(within[within > NOISE].min(initial=np.inf)))


def _left_by(rows: Array, left: Array | None) -> Array | None:
    """Return an orthonormal basis of the directions that rows `(k, n)` leave of those `left` `(n, f)`, None if all."""
    within = rows if left is None else rows @ left
    if not within.size:
        return left
    _, values, directions = np.linalg.svd(within)
    inside = directions[int(np.count_nonzero(values > NOISE)) :].T
    return inside if left is None else left @ inside


def _joined_recovery(guards: Sequence[Guarded]) -> list[Rows]:
    rows = [rows for guard in guards for rows in guard.recovery]
    return [Rows.joined(rows, rows[0].matrix.shape[1])] if rows else []


def _listed(limits: Sequence[Limit]) -> Sequence[Limit]:
    if not isinstance(limits, list | tuple | Sequence):
        raise InputError(f"limits is {limits!r}; expected a list of limits such as JointRange, Velocity and Collision.")
    return limits


def _limit(limit: Limit) -> Limit:
    if not isinstance(limit, Limit):
        raise InputError(f"limits hold {limit!r}; expected limits such as JointRange, Velocity and Collision.")
    return limit
