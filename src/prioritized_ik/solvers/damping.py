"""Damped levels that leave something to those below.

A level with damping δ minimises its cost + δ ‖dθ‖². As rows of the level, √δ dθ = 0, the damping would decide every joint
and leave nothing to the levels below (`below="hold"`). With `below="free"` the level's damped optimum, under all levels
above and every hard row, is computed first, and the level then asks for what that reaches: A dθ = A dθ_δ. Its share of weak
directions stays as calm as the damping makes it, and every motion that does not change A dθ is left to the levels below.
"""

from collections.abc import Callable
from dataclasses import replace

from prioritized_ik.problem import IKProblem, Level, replaced
from prioritized_ik.solvers.step import JointStep


def handed_down(problem: IKProblem, solve: Callable[[IKProblem], JointStep]) -> IKProblem | JointStep:
    """Return the problem with the optimum of each damped level as its target, or the step that could not be found.

    Args:
        problem: with any damped levels.
        solve: returns the step of a problem whose damping is all rows.
    """
    levels: list[Level] = []
    for level in problem.levels:
        if level.hands_down:
            step = solve(problem.with_levels((*levels, replaced(level, below="hold"))))
            if step.dtheta is None:
                return replace(step, message=f"level {level.name!r}, damped: {step.message}".rstrip(": "))
            level = replaced(level, target=level.matrix @ step.dtheta, damping=0.0)
        levels.append(level)
    return problem.with_levels(tuple(levels))
