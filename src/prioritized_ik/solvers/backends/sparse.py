"""Sparse solvers through their own interfaces, for the sparse QPs of `solvers.lifted`: each is called from nothing."""

import importlib.metadata
from dataclasses import dataclass, replace

import numpy as np
import qpsolvers

from prioritized_ik.errors import InputError
from prioritized_ik.solvers.backends.abilities import SPARSE, Abilities, Options, abilities_of
from prioritized_ik.solvers.backends.protocol import SolverFailedError
from prioritized_ik.solvers.backends.qpsolvers_ import FIRM_SHIFT, LOOSER, SOLVER_ERRORS, silence
from prioritized_ik.solvers.backends.sparse_qp import SolveSparse, SparseAnswer
from prioritized_ik.solvers.lifted.stages import LiftedStage
from prioritized_ik.solvers.refinement import proximal_point, zoom_in
from prioritized_ik.validation import Array


@dataclass(frozen=True)
class SparseResult:
    """What a backend made of a stage.

    Attributes:
        answer: finite; None if the solver failed. Its iterations are those of all calls.
        message: why it failed; empty otherwise.
        calls: how often the solver was called.
    """

    answer: SparseAnswer | None
    message: str = ""
    calls: int = 1


class SparseBackend:
    """A sparse solver's own interface, with the solver's row of the table of abilities. It remembers nothing.

    Args:
        name: one of `abilities.SPARSE`.
        accuracy: asked of the solver, in the stages' scaled variables.
        refine: whether it zooms in on its answers where the table of abilities has zooms.
    """

    def __init__(self, name: str, accuracy: float, *, refine: bool = True) -> None:
        self.name = name
        self.accuracy = accuracy
        self.refine = refine

    def __repr__(self) -> str:
        """Return what makes it."""
        return f"SparseBackend({self.name!r}, {self.accuracy:g}, refine={self.refine})"

    @property
    def abilities(self) -> Abilities:
        """The solver's row of the table."""
        return abilities_of(self.name)

    @property
    def version(self) -> str:
        """Version of the solver's package."""
        return importlib.metadata.version(self.abilities.package)

    def solve(self, stage: LiftedStage) -> SparseResult:
        """Return the optimum of `stage`; where the accuracy is out of reach, a looser one and a larger shift are tried."""
        first = self._attempt(stage, self.accuracy, self.abilities.shift)
        if first.answer is not None:
            return first
        second = self._attempt(stage, min(LOOSER * self.accuracy, 0.1), max(self.abilities.shift, FIRM_SHIFT))
        return replace(second, message=first.message if second.answer is None else "", calls=first.calls + second.calls)

    def _attempt(self, stage: LiftedStage, accuracy: float, shift: float) -> SparseResult:
        calls = _Calls(self.name, self.abilities.options(accuracy))
        solve = calls if self.abilities.semidefinite else proximal_point(stage, calls, shift, SolverFailedError)
        try:
            x = solve(stage.problem)
            last = calls.last
            if self.refine:
                x = zoom_in(stage, x, self.abilities.zooms, solve, SolverFailedError)
        except SolverFailedError as failure:
            return SparseResult(None, f"{self.name} {failure}", calls.count)
        # The multipliers are those before zooming in, which divides them by what it divides the variables by.
        assert last is not None
        return SparseResult(replace(last, x=x, iterations=calls.iterations), calls=calls.count)


class _Calls:
    """The calls of a solver for one stage."""

    def __init__(self, name: str, options: Options) -> None:
        self._solve, self._options = adapter_of(name), options
        self.count = self.iterations = 0
        self.last: SparseAnswer | None = None

    def __call__(self, problem: qpsolvers.Problem) -> Array:
        self.count += 1
        try:
            with silence.kept():
                answer = self._solve(problem, self._options)
        except SOLVER_ERRORS as error:
            raise SolverFailedError(f"raised {type(error).__name__}: {error}") from error
        self.iterations += answer.iterations
        if not all(np.isfinite(values).all() for values in (answer.x, answer.of_bounds, answer.of_rows)):
            raise SolverFailedError("returned values that are not finite")
        self.last = answer
        return answer.x


def adapter_of(name: str) -> SolveSparse:
    """Return the adapter of one of `abilities.SPARSE`. Its module imports the solver, so it waits until now."""
    match name:
        case "clarabel":
            from prioritized_ik.solvers.backends.clarabel_ import solve_sparse
        case "highs":
            from prioritized_ik.solvers.backends.highs_ import solve_sparse
        case "osqp":
            from prioritized_ik.solvers.backends.osqp_ import solve_sparse
        case "piqp":
            from prioritized_ik.solvers.backends.piqp_ import solve_sparse
        case "proxqp":
            from prioritized_ik.solvers.backends.proxqp_ import solve_sparse
        case _:
            raise InputError(f"no sparse solver is called {name!r}; expected one of: {', '.join(SPARSE)}.")
    return solve_sparse
