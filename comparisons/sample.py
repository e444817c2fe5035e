"""The recorded problems that every solver is given, with what the closed form says of each."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from prioritized_ik.problem import IKProblem, Level
from prioritized_ik.solvers.closed_form import level_decomposition, resulting_displacement
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.tolerances import FREE
from prioritized_ik.validation import Array
from prioritized_ik.winding.episode import Episode


@dataclass(frozen=True)
class Sampled:
    """A recorded problem and what the closed form says of it.

    Attributes:
        step: its number in the episode.
        problem: as it was posed.
        level: the problem's first one, its matrix cut to the rank that all solvers share.
        q: joint positions `(m,)` [rad].
        dtheta: Eqs. (12) to (14) `(m,)` [rad].
        dx: Eq. (15) of the first level [m].
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


def free_steps(episode: Episode, rank_tolerance: float, on_step: Callable[[int], object] = lambda _: None) -> list[bool]:
    """Return for each step whether no row binds there; `on_step` is called after each, with how many there are."""
    free: list[bool] = []
    for problem in episode.problems():
        free.append(problem.relative_violation(Hierarchy(problem, rank_tolerance).closed_form) <= FREE)
        on_step(len(free))
    return free


def chosen(free: list[bool], count: int) -> list[int]:
    """Return the numbers of up to `count` steps, evenly spaced, half of them free as far as there are so many."""
    frees, bound = ([number for number, is_free in enumerate(free) if is_free is kind] for kind in (True, False))
    some = _spread(frees, max(count // 2, count - len(bound)))
    return sorted([*some, *_spread(bound, count - len(some))])


def sampled(episode: Episode, step: int, rank_tolerance: float) -> Sampled:
    """Return the problem of `step` with what the closed form says of it."""
    problem = episode.problem(step)
    level = problem.levels[0]
    hierarchy = Hierarchy(problem, rank_tolerance)
    dtheta = hierarchy.closed_form
    factors, _, _ = level_decomposition(level, np.eye(problem.joint_count), rank_tolerance)
    return Sampled(
        step,
        episode.problem(step),  # afresh: what a problem computes of itself it keeps, and would be sent along
        _cut(level, hierarchy.blocks[0].below),
        episode.q[step],
        dtheta,
        resulting_displacement(factors.j_a, level.weights, level.target),
        problem.relative_violation(dtheta) <= FREE,
        episode.problem(step - 1) if step else None,
    )


def sample(episode: Episode, count: int, rank_tolerance: float) -> list[Sampled]:
    """Return up to `count` problems of an episode: those that `chosen` chooses."""
    steps = chosen(free_steps(episode, rank_tolerance), count)
    return [sampled(episode, step, rank_tolerance) for step in steps]


def _cut(level: Level, unfelt: Array) -> Level:
    """Return the level with nothing felt along orthonormal directions `(m, f)`; rows that are rounding stay in it."""
    return Level(level.matrix - (level.matrix @ unfelt) @ unfelt.T, level.target, level.weights, level.name, level.kind)


def _spread(items: list[int], count: int) -> list[int]:
    """Return `count` of `items`, evenly spaced."""
    if count >= len(items):
        return items
    return [items[i] for i in np.linspace(0, len(items) - 1, count).round().astype(int)]
