"""Episodes and steps that several tests look at, each recorded once a session."""

from functools import cache

import numpy as np

from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.hierarchy import strict_solution
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.methods import Method
from prioritized_ik.winding.episode import Episode, wind
from prioritized_ik.winding.settings import WindingSettings

#: Every step goes through the QP, also those that the closed form would answer.
QP_ONLY = SolveOptions(closed_form_first=False)

#: The same with the rank cut as in all that reproduces the paper: what windings are recorded with.
AS_RECORDED = SolveOptions(rank_tolerance=RANK_TOLERANCE, closed_form_first=False)

MET = 1e-12  # a row broken by less than this fraction of the step is broken by rounding only
ZERO, CLEAR = (
    1e-14,
    1e-8,
)  # singular values relative to the largest: up to this nothing, and from this on more than rounding


@cache
def recorded(direction: str = "up", solver: str = "daqp", link: int = 6, tilt: float = 0.0) -> Episode:
    return wind(WindingSettings(direction=direction, solver=solver, link=link, tilt=tilt, options=AS_RECORDED))


@cache
def short_episode() -> Episode:
    return wind(WindingSettings(max_steps=25, options=AS_RECORDED))


@cache
def free_steps() -> tuple[IKProblem, ...]:
    """Twelve steps, spread over two episodes, at which the closed form meets every row."""
    return _spread(6, free=True)


@cache
def constrained_steps() -> tuple[IKProblem, ...]:
    """Eight steps, spread over two episodes, at which the closed form breaks a row."""
    return _spread(4, free=False)


def _spread(count: int, *, free: bool) -> tuple[IKProblem, ...]:
    chosen: list[IKProblem] = []
    for direction in ("up", "back"):
        problems = [
            problem
            for problem in recorded(direction).problems()
            if closed_form_is_feasible(problem) is free and feels_clearly(problem)
        ]
        chosen += [problems[i] for i in np.linspace(0, len(problems) - 1, count).astype(int)]
    return tuple(chosen)


def feels_clearly(problem: IKProblem) -> bool:
    """Whether every direction is felt, or not: what a level feels by rounding alone is no question to a QP solver."""
    (level,) = problem.levels
    felt = np.linalg.svd(level.matrix, compute_uv=False)
    return not ((felt > ZERO * felt[0]) & (felt < CLEAR * felt[0])).any()


def closed_form_is_feasible(problem: IKProblem) -> bool:
    return problem.relative_violation(strict_solution(problem.levels, problem.reference)) <= MET


class By(Method):
    """A method that answers with what a function makes of a problem and the joint positions where it was posed."""

    name, version = "by", "0"

    def __init__(self, function) -> None:
        self._function = function

    def step(self, problem, options=None, place=None):
        return self._function(problem, place.q)
