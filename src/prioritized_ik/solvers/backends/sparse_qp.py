"""What adapters of sparse solvers take and return: sparse QPs, their rows in other forms, and answers.

An adapter is a function that takes a QP whose matrices are sparse by columns, minimise ½ xᵀPx + qᵀx subject to Gx <= h,
Ax = b and lb <= x <= ub, and a solver's options; it returns a `SparseAnswer`. P is diagonal. Where a side of a bound is
infinite the solver gets none.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import qpsolvers
import scipy.sparse

from prioritized_ik.solvers.backends.abilities import Options
from prioritized_ik.validation import Array


@dataclass(frozen=True)
class SparseAnswer:
    """One call's outcome.

    Attributes:
        x: `(v,)`.
        of_bounds: multipliers of the bounds `(v,)`, above zero at upper ones, below at lower ones.
        of_rows: multipliers of the rows G `(r,)`, not negative.
        iterations: how many it took.
    """

    x: Array
    of_bounds: Array
    of_rows: Array
    iterations: int


#: Solves one QP, or raises `SolverFailedError` with the solver's own status.
SolveSparse = Callable[[qpsolvers.Problem, Options], SparseAnswer]


@dataclass(frozen=True)
class AllRows:
    """A QP's rows and bounds as rows l <= M x <= u, for solvers that know no other: those of A, of G, then finite bounds.

    Attributes:
        matrix: M `(k, v)`, sparse by columns.
        lower, upper: `(k,)`; infinite for none.
    """

    matrix: scipy.sparse.csc_matrix
    lower: Array
    upper: Array
    _problem: qpsolvers.Problem

    @staticmethod
    def of(problem: qpsolvers.Problem, *, equalities: bool = True) -> "AllRows":
        """Return the rows of a QP, those of A left out unless `equalities`."""
        bounded = np.isfinite(problem.lb) | np.isfinite(problem.ub)
        parts, lower, upper = [], [], []
        if equalities:
            parts, lower, upper = [problem.A], [problem.b], [problem.b]
        if problem.G is not None:
            parts.append(problem.G)
            lower.append(np.full(len(problem.h), -np.inf))
            upper.append(problem.h)
        parts.append(scipy.sparse.eye(len(problem.q), format="csr")[np.flatnonzero(bounded)])
        lower.append(problem.lb[bounded])
        upper.append(problem.ub[bounded])
        matrix = scipy.sparse.vstack(parts).tocsc()
        return AllRows(matrix, np.concatenate(lower), np.concatenate(upper), problem)

    def answer(self, x: Array, multipliers: Array, iterations: int) -> SparseAnswer:
        """Return an answer of signed `multipliers` `(k,)`, above zero at upper sides."""
        problem = self._problem
        rows = 0 if problem.h is None else len(problem.h)
        bounded = np.isfinite(problem.lb) | np.isfinite(problem.ub)
        count = int(np.count_nonzero(bounded))
        inequalities, of_bounds = multipliers[len(multipliers) - rows - count :], np.zeros(len(x))
        of_bounds[bounded] = inequalities[rows:]
        return SparseAnswer(np.array(x), of_bounds, np.maximum(inequalities[:rows], 0.0), iterations)
