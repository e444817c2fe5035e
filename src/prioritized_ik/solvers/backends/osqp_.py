"""OSQP, a first-order method: its warm start is x and all multipliers, and it keeps the step size it adapted.

OSQP takes sparse matrices, lower <= Ax <= upper, and only values of the pattern it was set up with: the rows count as full.
It prints unless told not to; its polishing prints all the same, so it stays off.
"""

import numpy as np
import osqp
import qpsolvers
import scipy.sparse

from prioritized_ik.solvers.backends.abilities import Options
from prioritized_ik.solvers.backends.native import Answer, Workspace, full_pattern, start_with
from prioritized_ik.solvers.backends.protocol import SolverFailedError
from prioritized_ik.solvers.backends.sparse_qp import AllRows, SparseAnswer
from prioritized_ik.validation import Array

#: Regularisation of sparse QPs. Their equalities are dependent by nature, as links keep their lengths: with OSQP's own 1e-6
#: it runs into its iteration limit, or finds such a QP not convex, at 100 links; with this it takes 100 iterations.
SPARSE_SIGMA = 1e-4


class OsqpWorkspace(Workspace):
    """One `osqp.OSQP`."""

    errors = (osqp.OSQPException,)

    def __init__(self, problem: qpsolvers.Problem, options: Options, costed: int, shift: float) -> None:
        rows = np.zeros((0, len(problem.q))) if problem.G is None else problem.G
        upper = np.zeros(0) if problem.h is None else problem.h
        self._costed = costed
        self._sent = problem.G
        self._solver = osqp.OSQP()
        self._solver.setup(
            scipy.sparse.csc_matrix(np.triu(problem.P)),
            np.array(problem.q),
            full_pattern(rows),
            np.full(len(upper), -np.inf),
            np.array(upper),
            verbose=False,
            **options,
        )

    @staticmethod
    def _rows_sent(rows: Array, /) -> Array:
        return rows.ravel(order="F")  # the values of `full_pattern`

    def solve(self, problem: qpsolvers.Problem, multipliers: Array | None) -> Answer:
        """See `Workspace.solve`."""
        self._solver.update(**self._changed(problem, linear="q", upper="u", rows="Ax"))
        if multipliers is not None:
            self._solver.warm_start(x=start_with(multipliers, problem, self._costed), y=multipliers)
        result = self._solver.solve(raise_error=False)
        if result.info.status_val != osqp.SolverStatus.OSQP_SOLVED:
            raise SolverFailedError(f"found no solution ({result.info.status})")
        return Answer(result.x, np.maximum(result.y, 0.0), result.info.iter)


def solve_sparse(problem: qpsolvers.Problem, options: Options) -> SparseAnswer:
    """Return the answer to one sparse QP, see `sparse_qp`."""
    rows, solver = AllRows.of(problem), osqp.OSQP()
    hessian = scipy.sparse.triu(problem.P, format="csc")
    settings = {"verbose": False, "sigma": SPARSE_SIGMA, **options}
    solver.setup(hessian, problem.q, rows.matrix, rows.lower, rows.upper, **settings)
    result = solver.solve(raise_error=False)
    if result.info.status_val != osqp.SolverStatus.OSQP_SOLVED:
        raise SolverFailedError(f"found no solution ({result.info.status} after {result.info.iter} iterations)")
    return rows.answer(result.x, result.y, result.info.iter)
