"""The recorded problems that every solver is given, with what the closed form says of each."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from comparisons.episodes import Recorded
from prioritized_ik.errors import InputError
from prioritized_ik.problem import IKProblem, Level
from prioritized_ik.solvers.closed_form import level_decomposition, resulting_displacement
from prioritized_ik.solvers.damping import handed_down
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.solvers.step import JointStep, StepStatus
from prioritized_ik.tolerances import FREE
from prioritized_ik.validation import Array

#: A level asks for nothing if that is less than this part of what a step of this length may do to it: a foot that rests,
#: of a robot whose hand moves.
ASKS = 1e-9


@dataclass(frozen=True)
class Sampled:
    """A recorded problem and what the closed form says of it.

    Attributes:
        step: its number in the episode.
        problem: as it was posed.
        level: the first one that asks for something, its matrix cut to the rank that all solvers share.
        q: joint positions `(nq,)` [rad].
        dtheta: Eqs. (12) to (14), level by level `(m,)` [rad].
        dx: what that does to the level [m], by Eq. (15) if it is the first of all.
        free: whether no row binds there.
        before: the problem of the step before, for solvers that start from it; None at the first.
    """

    step: int
    problem: IKProblem
    level: Level
    q: Array
    dtheta: Array
    dx: Array
    free: bool
    before: IKProblem | None


class Reference:
    """What the closed form says of a problem.

    Attributes:
        problem: levels that hand down their damped optimum are aimed at what the closed form makes of it.
        hierarchy: of that problem.
        dtheta: Eqs. (12) to (14), level by level `(m,)` [rad].
        free: whether no row binds, on the way or at the end.
        judged: number of the first `equal` level that asks for something; None if none does.
    """

    def __init__(self, problem: IKProblem, rank_tolerance: float) -> None:
        self._rank_tolerance = rank_tolerance
        self.free = True
        aimed = handed_down(problem, lambda damped: JointStep(self._solved(damped)[1], StepStatus.CLOSED_FORM))
        assert isinstance(aimed, IKProblem)
        self.problem = aimed
        self.hierarchy, self.dtheta = self._solved(aimed)
        self.judged = next((number for number, level in enumerate(aimed.levels) if self._asks(level)), None)

    def level(self, number: int) -> Level:
        """Return a level with nothing felt along the directions that it leaves; rows that are rounding stay in it."""
        level, below, root = self.problem.levels[number], self.hierarchy.blocks[number].below, self.problem.metric_root
        felt_below = self.problem.in_metric.levels[number].matrix @ below
        matrix = level.matrix - felt_below @ (below.T * root if root.ndim == 1 else below.T @ root)
        return Level(matrix, level.target, level.weights, level.name, level.kind)

    def displacement(self, number: int) -> Array:
        """Return what dθ does to a level [m], by Eq. (15) where it is the first and nothing stands above it."""
        level = self.problem.levels[number]
        if number or len(self.problem.equalities.target):
            return level.matrix @ self.dtheta
        factors, _, _ = level_decomposition(level, np.eye(self.problem.joint_count), self._rank_tolerance)
        return resulting_displacement(factors.j_a, level.weights, level.target)

    def _solved(self, problem: IKProblem) -> tuple[Hierarchy, Array]:
        hierarchy = Hierarchy(problem, self._rank_tolerance)
        dtheta = problem.from_metric(hierarchy.closed_form)
        soft = max((np.max(one.matrix @ dtheta - one.target) for one in problem.levels if one.is_soft), default=0.0)
        self.free &= problem.relative_violation(dtheta) <= FREE and soft <= FREE * hierarchy.length
        return hierarchy, dtheta

    def _asks(self, level: Level) -> bool:
        if level.is_soft:
            return False
        root = np.sqrt(level.weights)
        able = float(np.linalg.norm(root[:, None] * level.matrix)) * float(np.linalg.norm(self.dtheta))
        return float(np.linalg.norm(root * level.target)) > ASKS * able


def free_steps(
    episode: Recorded, rank_tolerance: float, on_step: Callable[[int], object] = lambda _: None
) -> list[bool | None]:
    """Return for each step whether no row binds there; None where nothing is asked. `on_step` hears how many there are."""
    free: list[bool | None] = []
    for problem in episode.problems():
        reference = Reference(problem, rank_tolerance)
        free.append(None if reference.judged is None else reference.free)
        on_step(len(free))
    return free


def chosen(free: Sequence[bool | None], count: int) -> list[int]:
    """Return the numbers of up to `count` steps, evenly spaced, half of them free as far as there are so many.

    Steps of which nothing is asked are left out.
    """
    frees, bound = ([number for number, is_free in enumerate(free) if is_free is kind] for kind in (True, False))
    some = _spread(frees, max(count // 2, count - len(bound)))
    return sorted([*some, *_spread(bound, count - len(some))])


def sampled(episode: Recorded, step: int, rank_tolerance: float) -> Sampled:
    """Return the problem of `step` with what the closed form says of it.

    Raises:
        InputError: nothing is asked of it.
    """
    reference = Reference(episode.problem(step), rank_tolerance)
    if reference.judged is None:
        raise InputError(f"no level of step {step} asks for anything, so that there is nothing to compare.")
    return Sampled(
        step,
        episode.problem(step),  # afresh: what a problem computes of itself it keeps, and would be sent along
        reference.level(reference.judged),
        episode.q[step],
        reference.dtheta,
        reference.displacement(reference.judged),
        reference.free,
        episode.problem(step - 1) if step else None,
    )


def sample(episode: Recorded, count: int, rank_tolerance: float) -> list[Sampled]:
    """Return up to `count` problems of an episode: those that `chosen` chooses."""
    steps = chosen(free_steps(episode, rank_tolerance), count)
    return [sampled(episode, step, rank_tolerance) for step in steps]


def _spread(items: list[int], count: int) -> list[int]:
    """Return `count` of `items`, evenly spaced."""
    if count >= len(items):
        return items
    return [items[i] for i in np.linspace(0, len(items) - 1, count).round().astype(int)]
