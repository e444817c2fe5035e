"""The same physical problem in other units: of joints, and of the rows of levels, inequalities and equalities.

With joint units s, dθ' = s∘dθ. Whatever a level costs, and whatever the last level measures, stays the same number.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from prioritized_ik.problem import Bounds, Equalities, IKProblem, Level, Rows

Array = np.ndarray


def reposed(
    problem: IKProblem,
    levels: Sequence[ArrayLike] | None = None,
    rows: ArrayLike = 1.0,
    equalities: ArrayLike = 1.0,
    joints: ArrayLike | None = None,
) -> IKProblem:
    """Return `problem` in other units. Every factor is above zero.

    Args:
        problem: the problem.
        levels: for each level what its rows are multiplied by, one number or one a row; weights make up for it.
        rows: what hard rows are multiplied by, with their sides.
        equalities: what equalities are multiplied by, with their sides.
        joints: s `(m,)`, what joint displacements are multiplied by. The metric makes up for it.
    """
    m = problem.joint_count
    s = np.ones(m) if joints is None else np.asarray(joints, dtype=float)
    factors = [1.0] * len(problem.levels) if levels is None else levels
    hard, fixed = problem.rows, problem.equalities
    arguments = {}
    if joints is not None or hasattr(problem, "metric"):
        arguments["metric"] = getattr(problem, "metric", np.ones(m)) / s**2
    return IKProblem(
        [_in_units(level, factor, s) for level, factor in zip(problem.levels, factors, strict=True)],
        Bounds(problem.bounds.lower * s, problem.bounds.upper * s, problem.bounds.names),
        Rows(_times(hard.matrix / s, rows), hard.upper * rows, hard.names),
        problem.reference * s,
        Equalities(_times(fixed.matrix / s, equalities), fixed.target * equalities, fixed.names),
        **arguments,
    )


def physical(dtheta: ArrayLike, joints: ArrayLike | None = None) -> Array:
    """Return the step dθ `(m,)` that is `dtheta` in the joint units s, `joints`."""
    return np.asarray(dtheta, dtype=float) / (1.0 if joints is None else np.asarray(joints, dtype=float))


def _in_units(level: Level, factor: ArrayLike, s: Array) -> Level:
    f = np.broadcast_to(np.asarray(factor, dtype=float), level.target.shape)
    return Level(_times(level.matrix / s, f), level.target * f, level.weights / f**2, level.name, level.kind)


def _times(matrix: Array, factor: ArrayLike) -> Array:
    """Return `matrix` with its rows multiplied by one number, or one a row."""
    return matrix * np.broadcast_to(np.asarray(factor, dtype=float), len(matrix))[:, None]
