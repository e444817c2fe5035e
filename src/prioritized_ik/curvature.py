"""What a step leaves out: the second order of tasks and limits, put back by solving the step again."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from prioritized_ik.errors import StepNotFoundError
from prioritized_ik.guard import END, Guarded, Limit
from prioritized_ik.problem import Equalities, IKProblem, Level, Rows, replaced
from prioritized_ik.robot import Robot
from prioritized_ik.solvers.step import JointStep
from prioritized_ik.tasks.task import Task
from prioritized_ik.tolerances import NOISE
from prioritized_ik.validation import Array

CORRECTIONS = 3  # each leaves an error of one order more
CLOSED = 0.1  # of the accuracy is what a step may open equalities by
DEEPER = 0.01  # of the accuracy is what a step may take of a row that is broken by more
HALVINGS = 10  # of a step that breaks a limit by its curvature all the same; the last is a thousandth as long

Solved = tuple[IKProblem, JointStep]


@dataclass(frozen=True)
class Straight:
    """Steps of a robot that end where their rows say, to within an accuracy.

    A step dθ moves a point by J dθ and a term of second order, at most ½ L (Σ|dθ_i|)² for joints that a length L
    reaches, in the joint metric. What it comes to is looked up at the end of the step, and the step is solved again with
    it taken off: from the targets of levels that the step meets, from those of equalities, and from the sides of the hard
    rows that it would break. A step that breaks one all the same is made shorter.

    Attributes:
        robot: that is to move; it is back where it was after each call.
        levels: the tasks of each level, none of them empty.
        limits: each with what it says of the step.
        accuracy: how far off a step may end [m, rad].
    """

    robot: Robot
    levels: Sequence[Sequence[Task]]
    limits: Sequence[tuple[Limit, Guarded]]
    accuracy: float

    def solved(self, problem: IKProblem, solve: Callable[[IKProblem], JointStep]) -> Solved:
        """Return a step that ends where its rows say, and the problem that it is the answer to.

        Args:
            problem: of the step.
            solve: returns the step of a problem; without dθ, or with a `StepNotFoundError`, there is none.
        """
        step = solve(problem)
        if step.dtheta is None or self._is_short(problem, step.dtheta):
            return problem, step
        first = problem.levels[len(problem.levels) - len(self.levels) :]
        if not self._may_curve(problem, first, step.dtheta):
            return problem, step
        meant = [_left(level, tasks) for level, tasks in zip(first, self.levels, strict=True)]
        meant_open = self._opened() + problem.equalities.target
        for _ in range(CORRECTIONS):
            ends, broken, opened = self._ahead(step.dtheta)
            left_out = [end - left for end, left in zip(ends, meant, strict=True)]
            corrected = self._corrected(problem, step.dtheta, left_out, broken, np.nan_to_num(opened - meant_open))
            if corrected is None and not any(broken):
                return problem, step
            again = self._found(corrected, solve)
            if corrected is None or again is None or again.dtheta is None:
                break  # the room there is, is not enough for the correction
            problem, step = corrected, again
        return self._shortened(problem, step, solve)

    @staticmethod
    def _found(problem: IKProblem | None, solve: Callable[[IKProblem], JointStep]) -> JointStep | None:
        try:
            return None if problem is None else solve(problem)
        except StepNotFoundError:
            return None

    def _is_short(self, problem: IKProblem, dtheta: Array) -> bool:
        """Whether the term of second order is below a tenth of the accuracy."""
        length = max(float(self.robot.model.stat.extent), 1.0)
        return 0.5 * length * float(np.abs(problem.to_metric(dtheta)).sum()) ** 2 <= 0.1 * self.accuracy

    def _may_curve(self, problem: IKProblem, levels: Sequence[Level], dtheta: Array) -> bool:
        """Whether anything could be taken off: there are equalities, rows that are not exact, or a level is met."""
        if len(problem.equalities.target) or not all([limit.is_exact for limit, _ in self.limits]):
            return True
        return any([_is_met(level, dtheta, self.accuracy) for level in levels])

    @cached_property
    def _rooms(self) -> list[dict[str, float]]:
        """What is left of each limit where the robot is."""
        return [limit.room(self.robot) for limit, _ in self.limits]

    def _opened(self) -> Array:
        """Return how far every equality is open `(e,)`; NaN where its limit does not tell."""
        if all([guard.equalities is None for _, guard in self.limits]):
            return np.zeros(0)
        told = [
            (limit.opened(self.robot), guard.equalities) for limit, guard in self.limits if guard.equalities is not None
        ]
        return np.concatenate([np.zeros(0), *(by if by.size else np.full_like(fixed.target, np.nan) for by, fixed in told)])

    def _ahead(self, dtheta: Array) -> tuple[list[Array], list[dict[str, float]], Array]:
        """Return each level's errors after a step, what it breaks of each limit, by how much, and `_opened`."""
        robot, q, velocity = self.robot, self.robot.q, self.robot.velocity
        try:
            robot.integrate(dtheta, 1.0)
            ends = [np.concatenate([task.error(robot) for task in tasks]) for tasks in self.levels]
            after, opened = [limit.room(robot) for limit, _ in self.limits], self._opened()
        finally:
            robot.data.qvel[:], robot.data.qpos[:] = velocity, q
            robot.update()
        if all(room >= -self.accuracy for rooms in after for room in rooms.values()):
            return ends, [{} for _ in after], opened
        return ends, [_broken(room, end, self.accuracy) for room, end in zip(self._rooms, after, strict=True)], opened

    def _corrected(
        self,
        problem: IKProblem,
        dtheta: Array,
        left_out: Sequence[Array],
        broken: Sequence[dict[str, float]],
        opened: Array,
    ) -> IKProblem | None:
        """Return the problem with what a step leaves out taken off, or None where there is nothing to take it off."""
        first = len(problem.levels) - len(self.levels)
        levels = [
            _aimed(level, tasks, more, dtheta, self.accuracy)
            for level, tasks, more in zip(problem.levels[first:], self.levels, left_out, strict=True)
        ]
        upper = self._tightened(problem, dtheta, broken)
        drifts = opened.size > 0 and bool((np.abs(opened) > CLOSED * self.accuracy).any())
        if upper is None and not drifts and all(level is None for level in levels):
            return None
        kept = [new or old for new, old in zip(levels, problem.levels[first:], strict=True)]
        rows = problem.rows if upper is None else replaced(problem.rows, upper=upper)
        fixed = _closed(problem, dtheta, opened) if drifts else problem.equalities
        return replaced(_with(problem, [*problem.levels[:first], *kept], rows), equalities=fixed)

    def _tightened(self, problem: IKProblem, dtheta: Array, broken: Sequence[dict[str, float]]) -> Array | None:
        """Return the sides `(r,)` of hard rows, those that the step would break less by how much it would."""
        if not any(broken):
            return None
        slack = problem.rows.upper - problem.rows.matrix @ dtheta
        upper, first = problem.rows.upper.copy(), 0
        for (_, guard), excesses in zip(self.limits, broken, strict=True):
            names = [] if guard.rows is None else [name.partition(END)[0] for name in guard.rows.names]
            for name, excess in excesses.items():
                rows = [first + place for place, known in enumerate(names) if known == name]
                if rows:  # what was too far away to have one is met by a shorter step
                    nearest = min(rows, key=lambda row: float(slack[row]))
                    upper[nearest] -= max(float(slack[nearest]), 0.0) + excess
            first += len(names)
        return None if (upper == problem.rows.upper).all() else upper

    def _shortened(
        self,
        problem: IKProblem,
        step: JointStep,
        solve: Callable[[IKProblem], JointStep],
    ) -> Solved:
        """Return the step that breaks no row, halved as often as that takes."""
        assert step.dtheta is not None
        shares = [0.5**halvings for halvings in range(HALVINGS + 1)]
        share = next((share for share in shares if not any(self._ahead(share * step.dtheta)[1])), shares[-1])
        if share == 1.0:
            return problem, step
        shorter = _scaled(problem, share)
        return shorter, solve(shorter)


def _broken(before: dict[str, float], after: dict[str, float], accuracy: float) -> dict[str, float]:
    """Return by how much each room is less than none, or than it was where that is less; those that may not be so small.

    None may be below minus the accuracy, so that what steps take does not add up, or below what it was.
    """
    least = {name: min(before.get(name, 0.0), 0.0) for name in after}
    allowed = {name: -accuracy if room >= -accuracy else room - DEEPER * accuracy for name, room in least.items()}
    return {name: least[name] - room for name, room in after.items() if room < allowed[name]}


def _left(level: Level, tasks: Sequence[Task]) -> Array:
    """Return the errors `(k,)` that a level means to leave: e - gain e, of its targets gain e."""
    return level.target * np.concatenate([np.full(task.size, 1.0 / task.gain - 1.0) for task in tasks])


def _aimed(level: Level, tasks: Sequence[Task], left_out: Array, dtheta: Array, accuracy: float) -> Level | None:
    """Return a level that asks for what the step left out, too; None if it met nothing or left out little."""
    if not _is_met(level, dtheta, accuracy):
        return None
    counted = level.weights > 0.0
    # An error that is made every step, and of which every step takes a share, adds up to one divided by the other.
    allowed = np.concatenate([np.full(task.size, 0.5 * task.gain * accuracy) for task in tasks])
    if (np.abs(left_out) <= allowed)[counted].all():
        return None
    return replaced(level, target=level.target + left_out)


def _is_met(level: Level, dtheta: Array, accuracy: float) -> bool:
    """Whether a step leaves nothing of what a level asks for, weights of zero aside."""
    left = np.abs(level.target - level.times(dtheta))
    return not ((left > accuracy) & (level.weights > 0.0)).any()


def _closed(problem: IKProblem, dtheta: Array, opened: Array) -> Equalities:
    """Return the equalities with what a step opens `(e,)` taken off, where rows that depend on each other can.

    In no direction is that more than a step as long as this one can take back, so that none near a singular posture jumps.
    """
    scaled, step = problem.in_metric.equalities, float(np.linalg.norm(problem.to_metric(dtheta)))
    directions, sizes, _ = np.linalg.svd(scaled.matrix, full_matrices=False)
    along = np.where(sizes > NOISE * sizes.max(initial=0.0), directions.T @ opened, 0.0)
    back = directions @ np.clip(along, -step * sizes, step * sizes)
    return replaced(problem.equalities, target=problem.equalities.target - back)


def _scaled(problem: IKProblem, share: float) -> IKProblem:
    """Return the problem whose step is a share of this one's."""
    bounds, rows, fixed = problem.bounds, problem.rows, problem.equalities
    scaled = _with(
        problem,
        [replaced(level, target=share * level.target) for level in problem.levels],
        replaced(rows, upper=share * rows.upper),
    )
    return replaced(
        scaled,
        bounds=replaced(bounds, lower=share * bounds.lower, upper=share * bounds.upper),
        equalities=replaced(fixed, target=share * fixed.target),
    )


def _with(problem: IKProblem, levels: Sequence[Level], rows: Rows) -> IKProblem:
    return replaced(problem, levels=tuple(levels), rows=rows)
