"""Every solver that qpsolvers finds, through one adapter."""

import importlib.metadata
import os
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

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


class _Silence:
    """No warnings while any thread is inside.

    Their filters are the process's, not the thread's: if each thread set and restored them, the last to leave could restore
    those that another had set, for good.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._inside: set[object] = set()
        self._filters: warnings.catch_warnings[None] | None = None  # those to restore

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Let no warning be shown or raised inside."""
        visit = object()
        try:
            with self._lock:
                self._inside.add(visit)
                if self._filters is None:
                    filters = warnings.catch_warnings()
                    filters.__enter__()
                    self._filters = filters
                    warnings.simplefilter("ignore")
            yield
        finally:
            with self._lock:
                self._inside.discard(visit)
                self._end()

    def _end(self) -> None:
        if self._filters is not None and not self._inside:
            self._filters.__exit__(None, None, None)
            self._filters = None

    def after_fork(self) -> None:
        """Forget the threads that a child process does not have."""
        self._lock, self._inside = threading.Lock(), set()
        self._end()


#: What solvers warn of is kept inside; their answers are judged by figures.
silence = _Silence()
os.register_at_fork(after_in_child=silence.after_fork)


class _Calls:
    """The calls of a solver for one answer: how many, and the multipliers `(r,)` that go with it, None without.

    Args:
        once: makes x `(v,)` and the multipliers of one QP.
    """

    def __init__(self, once: Callable[[qpsolvers.Problem], tuple[Array, Array | None]]) -> None:
        self._once = once
        self.count = 0
        self.multipliers: Array | None = None

    def __call__(self, problem: qpsolvers.Problem) -> Array:
        """Return x `(v,)` of one QP."""
        self.count += 1
        x, self.multipliers = self._once(problem)
        return x

    def zoomed(self, solve: SolveOnce, zooms: tuple[float, ...]) -> SolveOnce:
        """Return `solve`, made of these calls, for one problem a zoom by ε, which divides the multipliers by ε."""
        left = iter(zooms)

        def once(problem: qpsolvers.Problem) -> Array:
            epsilon = next(left)
            d = solve(problem)
            self.multipliers = None if self.multipliers is None else epsilon * self.multipliers
            return d

        return once


class QpsolversBackend:
    """A solver of qpsolvers, with its row of the table of abilities."""

    def __init__(self, name: str, accuracy: float, *, refine: bool = True) -> None:
        self.name = name
        self.accuracy = accuracy
        self.abilities = abilities_of(name)
        self.zooms = self.abilities.zooms if refine else ()

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy gets: all but the row of the table, which holds functions, and which it looks up."""
        return {name: value for name, value in vars(self).items() if name != "abilities"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self.abilities = abilities_of(self.name)

    @property
    def version(self) -> str:
        """Version of the solver's package."""
        try:
            return importlib.metadata.version(self.abilities.package)
        except importlib.metadata.PackageNotFoundError:
            return "unknown"

    def solve(self, stage: Stage) -> StageResult:
        """See `Backend.solve`. Where the accuracy asked for is out of reach, a looser one and a larger shift are tried."""
        first = self._solve_exactly(stage)
        if first.x is not None:
            return first
        second = self._solve_exactly(stage, again=True)
        message = first.message if second.x is None else ""
        return replace(second, message=message, calls=first.calls + second.calls)

    def solve_once(self, stage: Stage) -> StageResult:
        """See `Backend.solve_once`."""
        return self._attempt(stage, {})

    def _solve_exactly(self, stage: Stage, *, again: bool = False) -> StageResult:
        options, shift = self.abilities.options(self.accuracy), self.abilities.shift
        if again:
            options, shift = self.abilities.options(min(LOOSER * self.accuracy, 0.1)), max(shift, FIRM_SHIFT)

        def exactly(calls: _Calls) -> Array:
            solve = calls if self.abilities.semidefinite else proximal_point(stage, calls, shift, SolverFailedError)
            x = solve(stage.problem)
            return zoom_in(stage, x, self.zooms, calls.zoomed(solve, self.zooms), SolverFailedError)

        return self._attempt(stage, options, exactly)

    def _attempt(self, stage: Stage, options: Options, whole: Callable[[_Calls], Array] | None = None) -> StageResult:
        """Return what `whole`, a procedure of calls of the solver, makes of the stage; one call unless given."""
        calls = _Calls(lambda problem: self._call(problem, options))
        try:
            x = calls(stage.problem) if whole is None else whole(calls)
        except SolverFailedError as failure:
            return StageResult(None, str(failure), calls.count)
        return StageResult(x, calls=calls.count, multipliers=calls.multipliers)

    def _call(self, problem: qpsolvers.Problem, options: Options) -> tuple[Array, Array | None]:
        """Return the solver's finite answer to one QP, x `(v,)` and the multipliers `(r,)` if it gives them."""
        if self.abilities.sparse:
            problem = _as_sparse(problem)
        try:
            with silence.kept():  # solvers warn about inaccuracy; what they found is judged by its figures
                solution = qpsolvers.solve_problem(problem, solver=self.name, **options)
        except SOLVER_ERRORS as error:
            raise SolverFailedError(f"{self.name} raised {type(error).__name__}: {error}") from error
        # Some backends return a junk x when they fail: `found` decides.
        if not solution.found or solution.x is None:
            raise SolverFailedError(f"{self.name} found no solution")
        x = np.asarray(solution.x, dtype=float)
        if x.shape != problem.q.shape or not np.isfinite(x).all():
            raise SolverFailedError(f"{self.name} returned values that are not finite")
        return x, _multipliers(solution)


def _multipliers(solution: qpsolvers.Solution) -> Array | None:
    """Return the multipliers `(r,)` of the rows of a solution's problem, or None if it holds none that are finite."""
    upper = solution.problem.h
    if upper is None:
        return np.zeros(0)
    if solution.z is None:
        return None
    multipliers = np.asarray(solution.z, dtype=float)
    if multipliers.shape != upper.shape or not np.isfinite(multipliers).all():
        return None
    return np.maximum(multipliers, 0.0)


def _as_sparse(problem: qpsolvers.Problem) -> qpsolvers.Problem:
    hessian, g, a = (
        None if matrix is None else scipy.sparse.csc_matrix(matrix) for matrix in (problem.P, problem.G, problem.A)
    )
    return qpsolvers.Problem(hessian, problem.q, g, problem.h, a, problem.b)
