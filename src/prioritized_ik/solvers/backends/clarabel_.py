"""Clarabel, an interior-point method: it takes rows as A x + s = b with s in cones, zero for equalities, and no bounds."""

import clarabel  # type: ignore[import-untyped]
import numpy as np
import qpsolvers
import scipy.sparse

from prioritized_ik.solvers.backends.abilities import Options
from prioritized_ik.solvers.backends.protocol import SolverFailedError
from prioritized_ik.solvers.backends.sparse_qp import AllRows, SparseAnswer

#: The equalities of the sparse QPs are dependent by nature, as links keep their lengths: with Clarabel's own 1e-8 it
#: ends in numerical errors at 400 links, with 1e-7 to 1e-5 it takes 8 iterations.
REGULARIZATION = 1e-6


def solve_sparse(problem: qpsolvers.Problem, options: Options) -> SparseAnswer:
    """Return the answer to one sparse QP, see `sparse_qp`."""
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.static_regularization_constant = REGULARIZATION
    for name, value in options.items():
        setattr(settings, name, value)
    rows = AllRows.of(problem, equalities=False)
    above, below = np.isfinite(rows.upper), np.isfinite(rows.lower)
    by_row = rows.matrix.tocsr()
    matrix = scipy.sparse.vstack([problem.A, by_row[above], -by_row[below]]).tocsc()
    sides = np.concatenate([problem.b, rows.upper[above], -rows.lower[below]])
    equal, ups = len(problem.b), int(np.count_nonzero(above))
    cones = [clarabel.ZeroConeT(equal), clarabel.NonnegativeConeT(len(sides) - equal)]
    hessian = scipy.sparse.triu(problem.P, format="csc")
    solution = clarabel.DefaultSolver(hessian, problem.q, matrix, sides, cones, settings).solve()
    if solution.status != clarabel.SolverStatus.Solved:
        raise SolverFailedError(f"found no solution ({solution.status} after {solution.iterations} iterations)")
    z, multipliers = np.array(solution.z), np.zeros(len(rows.upper))
    multipliers[above] += z[equal : equal + ups]
    multipliers[below] -= z[equal + ups :]
    return rows.answer(np.array(solution.x), multipliers, solution.iterations)
