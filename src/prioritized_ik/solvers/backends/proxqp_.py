"""ProxQP, a proximal augmented Lagrangian method: its warm start is x and all multipliers. Dense and sparse.

ProxQP calls P H, q g, G C, h u and the multipliers z. It keeps the scaling of the first data it saw, unless told otherwise.
It does not look at complementarity unless told to, and takes a feasible start for the optimum whose multipliers are wrong.
"""

import numpy as np
import qpsolvers
from proxsuite import proxqp

from prioritized_ik.solvers.backends.abilities import Options
from prioritized_ik.solvers.backends.native import UNBOUNDED, Answer, Workspace, full_pattern, start_with
from prioritized_ik.solvers.backends.protocol import SolverFailedError
from prioritized_ik.solvers.backends.sparse_qp import AllRows, SparseAnswer
from prioritized_ik.validation import Array


class ProxqpWorkspace(Workspace):
    """One `proxsuite.proxqp.dense.QP`."""

    solver = proxqp.dense.QP

    def __init__(self, problem: qpsolvers.Problem, options: Options, costed: int, shift: float) -> None:
        rows = 0 if problem.h is None else len(problem.h)
        self._costed = costed
        self._sent = problem.G
        self._qp = self.solver(len(problem.q), 0, rows)
        for name, value in options.items():
            setattr(self._qp.settings, name, value)
        c = None if problem.G is None else self._rows_sent(problem.G)
        lower = None if problem.G is None else np.full(rows, UNBOUNDED)
        self._qp.init(H=self._rows_sent(problem.P), g=problem.q, C=c, l=lower, u=problem.h)

    def solve(self, problem: qpsolvers.Problem, multipliers: Array | None) -> Answer:
        """See `Workspace.solve`."""
        self._qp.update(**self._changed(problem, linear="g", upper="u", rows="C"))
        if multipliers is None:
            self._qp.solve()
        else:
            self._qp.settings.initial_guess = proxqp.InitialGuess.WARM_START
            self._qp.solve(start_with(multipliers, problem, self._costed), np.zeros(0), multipliers)
        results = self._qp.results
        if results.info.status != proxqp.QPSolverOutput.PROXQP_SOLVED:
            raise SolverFailedError(f"found no solution ({results.info.status.name})")
        return Answer(np.array(results.x), np.maximum(results.z, 0.0), results.info.iter)


class SparseProxqpWorkspace(ProxqpWorkspace):
    """One `proxsuite.proxqp.sparse.QP`. It takes only values of the pattern it was set up with."""

    solver = proxqp.sparse.QP
    _rows_sent = staticmethod(full_pattern)


def solve_sparse(problem: qpsolvers.Problem, options: Options) -> SparseAnswer:
    """Return the answer to one sparse QP, see `sparse_qp`."""
    rows = AllRows.of(problem, equalities=False)
    lower, upper = np.maximum(rows.lower, UNBOUNDED), np.minimum(rows.upper, -UNBOUNDED)
    qp = proxqp.sparse.QP(len(problem.q), len(problem.b), len(lower))
    for name, value in options.items():
        setattr(qp.settings, name, value)
    qp.init(problem.P, problem.q, problem.A, problem.b, rows.matrix, lower, upper)
    qp.solve()
    info = qp.results.info
    if info.status != proxqp.QPSolverOutput.PROXQP_SOLVED:
        raise SolverFailedError(f"found no solution ({info.status.name} after {info.iter} iterations)")
    return rows.answer(qp.results.x, np.array(qp.results.z), info.iter)
