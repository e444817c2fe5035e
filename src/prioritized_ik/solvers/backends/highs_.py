"""HiGHS, whose QP solver is an active-set method: it calls multipliers dual values and gives them the other sign."""

import highspy
import numpy as np
import qpsolvers
import scipy.sparse

from prioritized_ik.solvers.backends.abilities import Options
from prioritized_ik.solvers.backends.protocol import SolverFailedError
from prioritized_ik.solvers.backends.sparse_qp import SparseAnswer

#: HiGHS takes small right-hand sides for zero and ends in a "solve error": it gets all variables this much larger. Of
#: 80 random problems it loses 12 without.
SCALE = 30.0


def solve_sparse(problem: qpsolvers.Problem, options: Options) -> SparseAnswer:
    """Return the answer to one sparse QP, see `sparse_qp`."""
    solver = highspy.Highs()  # type: ignore[no-untyped-call]
    solver.setOptionValue("output_flag", False)
    for name, value in options.items():
        solver.setOptionValue(name, value)
    solver.passModel(_model(problem))
    solver.run()
    status, info = solver.getModelStatus(), solver.getInfo()
    iterations = max(int(info.qp_iteration_count), 0)
    if status != highspy.HighsModelStatus.kOptimal:
        raise SolverFailedError(f"found no solution ({solver.modelStatusToString(status)} after {iterations} iterations)")
    solution = solver.getSolution()
    equal = len(problem.b)
    of_rows = np.maximum(-np.array(solution.row_dual)[equal:], 0.0)
    of_bounds = -np.array(solution.col_dual) / SCALE
    return SparseAnswer(np.array(solution.col_value) / SCALE, of_bounds, of_rows / SCALE, iterations)


def _model(problem: qpsolvers.Problem) -> highspy.HighsModel:
    """Return a QP in `SCALE` x as HiGHS takes it: a linear program and the lower triangle of a Hessian, by columns."""
    model, v = highspy.HighsModel(), len(problem.q)
    matrix, lower, upper = problem.A, SCALE * problem.b, SCALE * problem.b
    if problem.G is not None:
        matrix = scipy.sparse.vstack([problem.A, problem.G]).tocsc()
        lower = np.concatenate([lower, np.full(len(problem.h), -np.inf)])
        upper = np.concatenate([upper, SCALE * problem.h])
    lp = model.lp_
    lp.num_col_, lp.num_row_ = v, len(upper)
    lp.col_cost_, lp.col_lower_, lp.col_upper_ = SCALE * problem.q, SCALE * problem.lb, SCALE * problem.ub
    lp.row_lower_, lp.row_upper_ = lower, upper
    lp.a_matrix_.format_ = highspy.MatrixFormat.kColwise
    lp.a_matrix_.start_, lp.a_matrix_.index_, lp.a_matrix_.value_ = matrix.indptr, matrix.indices, matrix.data
    hessian = scipy.sparse.tril(problem.P, format="csc")
    model.hessian_.dim_, model.hessian_.format_ = v, highspy.HessianFormat.kTriangular
    model.hessian_.start_, model.hessian_.index_ = hessian.indptr, hessian.indices
    model.hessian_.value_ = hessian.data
    return model
