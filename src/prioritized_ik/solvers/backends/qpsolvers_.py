"""Every solver that qpsolvers finds, through one adapter."""

import importlib.metadata
import warnings
from collections.abc import Callable

import numpy as np
import qpsolvers
import scipy.sparse

from prioritized_ik.solvers.backends.abilities import Options, abilities_of
from prioritized_ik.solvers.backends.protocol import SolverFailedError, StageResult
from prioritized_ik.solvers.refinement import SolveOnce, proximal_point, zoom_in
from prioritized_ik.solvers.stages import Stage
from prioritized_ik.validation import Array

#: What solvers raise when they cannot solve a QP: qpsolvers' own, LAPACK's, division by zero, and what bindings translate
#: C++ and XLA errors to. Anything else is a bug and passes.
SOLVER_ERRORS = (qpsolvers.exceptions.QPError, ArithmeticError, ValueError, RuntimeError)

#: How much looser the second attempt is. Zooming in makes up for it.
LOOSER = 100.0

#: ρ of the second attempt at least. Where tight rows are nearly dependent, active-set methods fail on smaller shifts: of
#: 150 random hierarchies full of such rows DAQP loses 9 with its own shift twice, and none with this one second.
FIRM_SHIFT = 1e-6


class QpsolversBackend:
    """A solver of qpsolvers, with its row of the table of abilities."""

    def __init__(self, name: str, accuracy: float, *, refine: bool = True) -> None:
        self.name = name
        self.accuracy = accuracy
        self.abilities = abilities_of(name)
        self.zooms = self.abilities.zooms if refine else ()

    @property
    def version(self) -> str:
        """Version of the solver's package."""
        try:
            return importlib.metadata.version(self.abilities.package)
        except importlib.metadata.PackageNotFoundError:
            return "unknown"

    def solve(self, stage: Stage) -> StageResult:
        """See `Backend.solve`. Where the accuracy asked for is out of reach, a looser one and a larger shift are tried."""
        if stage.as_it_stands:
            return self._attempt(stage, lambda problem: self._call(problem, {}))
        first = self._solve_exactly(stage)
        if first.x is not None:
            return first
        second = self._solve_exactly(stage, again=True)
        return StageResult(second.x, first.message if second.x is None else "", first.calls + second.calls)

    def _solve_exactly(self, stage: Stage, *, again: bool = False) -> StageResult:
        options, shift = self.abilities.options(self.accuracy), self.abilities.shift
        if again:
            options, shift = self.abilities.options(min(LOOSER * self.accuracy, 0.1)), max(shift, FIRM_SHIFT)

        def exactly(once: SolveOnce) -> Array:
            solve = once if self.abilities.semidefinite else proximal_point(stage, once, shift, SolverFailedError)
            return zoom_in(stage, solve(stage.problem), self.zooms, solve, SolverFailedError)

        return self._attempt(stage, lambda problem: self._call(problem, options), exactly)

    @staticmethod
    def _attempt(stage: Stage, once: SolveOnce, whole: Callable[[SolveOnce], Array] | None = None) -> StageResult:
        """Return what `whole`, a procedure of calls of `once`, makes of the stage; one call of it unless given."""
        calls = 0

        def counted(problem: qpsolvers.Problem) -> Array:
            nonlocal calls
            calls += 1
            return once(problem)

        try:
            x = counted(stage.problem) if whole is None else whole(counted)
        except SolverFailedError as failure:
            return StageResult(None, str(failure), calls)
        return StageResult(x, calls=calls)

    def _call(self, problem: qpsolvers.Problem, options: Options) -> Array:
        """Return the solver's finite answer to one QP."""
        if self.abilities.sparse:
            problem = _as_sparse(problem)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # solvers warn about inaccuracy; what they found is judged by its figures
                solution = qpsolvers.solve_problem(problem, solver=self.name, **options)
        except SOLVER_ERRORS as error:
            raise SolverFailedError(f"{self.name} raised {type(error).__name__}: {error}") from error
        # Some backends return a junk x when they fail: `found` decides.
        if not solution.found or solution.x is None:
            raise SolverFailedError(f"{self.name} found no solution")
        x = np.asarray(solution.x, dtype=float)
        if x.shape != problem.q.shape or not np.isfinite(x).all():
            raise SolverFailedError(f"{self.name} returned values that are not finite")
        return x


def _as_sparse(problem: qpsolvers.Problem) -> qpsolvers.Problem:
    hessian, g, a = (
        None if matrix is None else scipy.sparse.csc_matrix(matrix) for matrix in (problem.P, problem.G, problem.A)
    )
    return qpsolvers.Problem(hessian, problem.q, g, problem.h, a, problem.b)
