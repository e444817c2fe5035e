"""PIQP, an interior-point method: it keeps its workspace and the scaling of its data, but takes no starting point.

PIQP calls q c and h h_u, takes matrices by columns, and prints for rows with an infinite side, which stages do not have.
"""

import numpy as np
import piqp
import qpsolvers

from prioritized_ik.solvers.backends.abilities import Options
from prioritized_ik.solvers.backends.native import Answer, Workspace
from prioritized_ik.solvers.backends.protocol import SolverFailedError
from prioritized_ik.solvers.backends.sparse_qp import SparseAnswer
from prioritized_ik.validation import Array

#: Least regularisation of sparse QPs, whose equalities are dependent by nature, as links keep their lengths: with PIQP's
#: own 1e-10 it runs into its iteration limit on 4 of 326 steps of a winding of 17 links, with this on 2.
SPARSE_REGULARIZATION = 1e-8


class PiqpWorkspace(Workspace):
    """One `piqp.DenseSolver`."""

    def __init__(self, problem: qpsolvers.Problem, options: Options, costed: int, shift: float) -> None:
        self._sent = problem.G
        self._solver = piqp.DenseSolver()
        for name, value in options.items():
            setattr(self._solver.settings, name, value)
        rows = None if problem.G is None else self._rows_sent(problem.G)
        self._solver.setup(np.asfortranarray(problem.P), problem.q, G=rows, h_u=problem.h)

    @staticmethod
    def _rows_sent(rows: Array, /) -> Array:
        return np.asfortranarray(rows)

    def solve(self, problem: qpsolvers.Problem, multipliers: Array | None) -> Answer:
        """See `Workspace.solve`. There is no way to give it a start."""
        self._solver.update(**self._changed(problem, linear="c", upper="h_u", rows="G"))
        status = self._solver.solve()
        if status != piqp.PIQP_SOLVED:
            raise SolverFailedError(f"found no solution ({status.name})")
        result = self._solver.result
        return Answer(np.array(result.x), np.array(result.z_u), result.info.iter)


def solve_sparse(problem: qpsolvers.Problem, options: Options) -> SparseAnswer:
    """Return the answer to one sparse QP, see `sparse_qp`."""
    solver = piqp.SparseSolver()
    solver.settings.reg_lower_limit = SPARSE_REGULARIZATION
    for name, value in options.items():
        setattr(solver.settings, name, value)
    sides = {"x_l": problem.lb, "x_u": problem.ub}
    solver.setup(problem.P, problem.q, A=problem.A, b=problem.b, G=problem.G, h_u=problem.h, **sides)
    status = solver.solve()
    result = solver.result
    if status != piqp.PIQP_SOLVED:
        raise SolverFailedError(f"found no solution ({status.name} after {result.info.iter} iterations)")
    rows = np.zeros(0) if problem.h is None else np.array(result.z_u)
    return SparseAnswer(np.array(result.x), result.z_bu - result.z_bl, rows, result.info.iter)
