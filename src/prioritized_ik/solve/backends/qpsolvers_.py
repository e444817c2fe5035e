"""Every solver that qpsolvers finds, through one adapter."""

import importlib.metadata
import warnings

import numpy as np
import qpsolvers
import scipy.sparse

from prioritized_ik.solve.backends.abilities import abilities_of
from prioritized_ik.solve.backends.protocol import StageResult
from prioritized_ik.solve.refinement import proximal_point, zoom_in
from prioritized_ik.solve.stages import Stage
from prioritized_ik.validation import Array

#: What solvers raise when they cannot solve a QP: qpsolvers' own, LAPACK's, division by zero, and what bindings translate
#: C++ and XLA errors to. Anything else is a bug and passes.
SOLVER_ERRORS = (qpsolvers.exceptions.QPError, ArithmeticError, ValueError, RuntimeError)


class _SolverFailedError(Exception):
    """One call of the solver gave no answer."""


class QpsolversBackend:
    """A solver of qpsolvers, with its row of the table of abilities."""

    def __init__(self, name: str, accuracy: float) -> None:
        self.name = name
        self.accuracy = accuracy
        self.abilities = abilities_of(name)
        self._options = dict(self.abilities.options(accuracy))

    @property
    def version(self) -> str:
        """Version of the solver's package."""
        try:
            return importlib.metadata.version(self.abilities.package)
        except importlib.metadata.PackageNotFoundError:
            return "unknown"

    def solve(self, stage: Stage) -> StageResult:
        """See `Backend.solve`."""
        calls = 0

        def solve_once(problem: qpsolvers.Problem) -> Array:
            nonlocal calls
            calls += 1
            return self._call(problem)

        try:
            if stage.as_it_stands:
                return StageResult(solve_once(stage.problem), calls=calls)
            solve = solve_once if self.abilities.semidefinite else proximal_point(stage, solve_once)
            x = zoom_in(stage, solve(stage.problem), self.abilities.zooms, solve, _SolverFailedError)
        except _SolverFailedError as failure:
            return StageResult(None, str(failure), calls)
        return StageResult(x, calls=calls)

    def _call(self, problem: qpsolvers.Problem) -> Array:
        """Return the solver's finite answer to one QP."""
        if self.abilities.sparse:
            problem = _as_sparse(problem)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # solvers warn about inaccuracy; what they found is judged by its figures
                solution = qpsolvers.solve_problem(problem, solver=self.name, **self._options)
        except SOLVER_ERRORS as error:
            raise _SolverFailedError(f"{self.name} raised {type(error).__name__}: {error}") from error
        # Some backends return a junk x when they fail: `found` decides.
        if not solution.found or solution.x is None:
            raise _SolverFailedError(f"{self.name} found no solution")
        x = np.asarray(solution.x, dtype=float)
        if x.shape != problem.q.shape or not np.isfinite(x).all():
            raise _SolverFailedError(f"{self.name} returned values that are not finite")
        return x


def _as_sparse(problem: qpsolvers.Problem) -> qpsolvers.Problem:
    g = None if problem.G is None else scipy.sparse.csc_matrix(problem.G)
    return qpsolvers.Problem(scipy.sparse.csc_matrix(problem.P), problem.q, g, problem.h, lb=problem.lb, ub=problem.ub)
