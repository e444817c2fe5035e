"""Solvers through their own interfaces: set up once, sent only what changed, started from the last answer.

The stage at one place of the fold resembles the one at that place a step ago, so a backend keeps one workspace a place. It
starts from the multipliers that the same rows had a step ago, and from the x that goes with them: the variables themselves
are other directions at every step. The Hessian, diag(1, 0), is the same for all stages of one size; one of another size
gets a new workspace but keeps the multipliers. A failure costs the place its memory, and the stage is tried once more from
nothing, less accurately.

Workspaces stay where they were made: a copy of a backend, pickled or not, starts with none, and so does a process that was
forked. Two threads cannot be in one workspace, so a backend refuses a call that comes while it is at work on another.
"""

import importlib.metadata
import math
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NoReturn

import numpy as np
import qpsolvers
import scipy.sparse
from numpy.typing import NDArray

from prioritized_ik.errors import InputError
from prioritized_ik.solvers.backends.abilities import Options, abilities_of
from prioritized_ik.solvers.backends.protocol import SolverFailedError, StageResult
from prioritized_ik.solvers.backends.qpsolvers_ import FIRM_SHIFT, LOOSER, SOLVER_ERRORS
from prioritized_ik.solvers.refinement import zoom_in
from prioritized_ik.solvers.stages import Stage
from prioritized_ik.validation import Array

#: What stands for no side of a row where a solver takes two.
UNBOUNDED = -1e30


@dataclass(frozen=True)
class Answer:
    """One call's outcome: `x` `(v,)`, `multipliers` `(r,)` of the rows, not negative, and how many iterations it took."""

    x: Array
    multipliers: Array
    iterations: int


class Workspace(ABC):
    """One solver, set up for QPs of one size and one Hessian.

    Args:
        problem: the QP to set up for.
        options: of the solver.
        costed: how many of the variables, the first ones, the cost feels.
        shift: added to the diagonal of the Hessian for the others, by solvers that need it.
    """

    #: What the solver raises beside `SOLVER_ERRORS` when it cannot solve a QP.
    errors: tuple[type[Exception], ...] = ()

    @abstractmethod
    def __init__(self, problem: qpsolvers.Problem, options: Options, costed: int, shift: float) -> None: ...

    def __reduce__(self) -> NoReturn:
        """Refuse to be copied: what bindings copy of a solver's memory need not be memory at all."""
        raise TypeError(f"{type(self).__name__} holds a solver's own memory and cannot be copied; copy its backend.")

    _sent: Array | None  # the rows as they came, to tell whether others came

    def _changed(self, problem: qpsolvers.Problem, linear: str, upper: str, rows: str) -> dict[str, Any]:
        """Return what is to be sent of `problem`, by the solver's own names; `_rows_sent` gives rows their form."""
        changed = {linear: problem.q}
        if problem.h is not None:
            changed[upper] = problem.h
        if problem.G is not self._sent:
            changed[rows] = self._rows_sent(problem.G)
            self._sent = problem.G
        return changed

    @staticmethod
    def _rows_sent(rows: Array, /) -> Any:
        """Return `rows` in the form in which the solver takes them."""
        return rows

    @abstractmethod
    def solve(self, problem: qpsolvers.Problem, multipliers: Array | None) -> Answer:
        """Return the solver's answer to `problem`, which may differ from the last one in all but Hessian and sizes.

        Args:
            problem: the QP; rows that are the very array sent last are not sent again.
            multipliers: with which to start `(r,)`; None for the solver's own start.

        Raises:
            SolverFailedError: it found none.
        """


def start_with(multipliers: Array, problem: qpsolvers.Problem, costed: int) -> Array:
    """Return the x `(v,)` of a stage's QP at which rows pull with `multipliers` `(r,)`; zero in what no cost feels."""
    pull = problem.q if problem.G is None else problem.q + multipliers @ problem.G
    x = np.zeros(len(pull))
    x[:costed] = -pull[:costed]
    return x


def full_pattern(dense: Array) -> scipy.sparse.csc_matrix:
    """Return `dense` `(r, v)` as a sparse matrix that stores every entry, zeros too, so that each can change later."""
    r, v = dense.shape
    starts = np.arange(v + 1) * r
    return scipy.sparse.csc_matrix((dense.ravel(order="F"), np.tile(np.arange(r), v), starts), shape=(r, v))


@dataclass(frozen=True)
class _Memory:
    """What is left at a place of the fold by its last stage."""

    workspace: Workspace
    shape: tuple[int, int, int]  # variables, those with a cost, rows
    row_ids: NDArray[np.int_]
    multipliers: Array

    def multipliers_of(self, row_ids: NDArray[np.int_]) -> Array:
        """Return the multipliers `(r,)` that rows `row_ids` had, zero for those that are new."""
        if np.array_equal(row_ids, self.row_ids):
            return self.multipliers
        known = dict(zip(self.row_ids.tolist(), self.multipliers.tolist(), strict=True))
        return np.array([known.get(row, 0.0) for row in row_ids.tolist()])


class NativeBackend:
    """A solver's own interface, with its row of the table of abilities.

    One is for one thread; `get_backend` makes one for each. A copy starts from nothing, wherever it goes.

    Attributes:
        name: what the registry calls it.
        accuracy: asked of the solver, in the stages' scaled variables.
        iterations: how many the last stage took, refinement included.
    """

    def __init__(self, name: str, accuracy: float, workspace: type[Workspace], *, refine: bool = True) -> None:
        self.name = name
        self.accuracy = accuracy
        self.abilities = abilities_of(name)
        self.zooms = self.abilities.zooms if refine else ()
        self._workspace = workspace
        self._start()

    def _start(self) -> None:
        """Begin with nothing."""
        self.iterations = self._calls = 0
        self._memories: dict[int, _Memory] = {}
        self._process = os.getpid()  # that made the memories
        self._users: dict[int, object] = {}  # the call at work in each process; after a fork, those of the parent are void

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy gets: the settings, not the memories."""
        left = ("abilities", "version", "iterations", "_calls", "_memories", "_process", "_users")
        return {name: value for name, value in vars(self).items() if name not in left}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self.abilities = abilities_of(self.name)
        self._start()

    @cached_property
    def version(self) -> str:
        """Version of the solver's package."""
        return importlib.metadata.version(self.abilities.package)

    def solve(self, stage: Stage) -> StageResult:
        """See `Backend.solve`.

        Raises:
            InputError: another thread's call is under way.
        """
        return self._alone(lambda: self._solve(stage))

    def solve_once(self, stage: Stage) -> StageResult:
        """See `Backend.solve_once`. It leaves nothing behind.

        Raises:
            InputError: another thread's call is under way.
        """
        return self._alone(lambda: self._attempt(lambda: self._solve_as_it_stands(stage)))

    def _alone(self, solve: Callable[[], StageResult]) -> StageResult:
        """Return what `solve` makes of a stage, if no other call is under way."""
        process, call = os.getpid(), object()
        try:
            if self._users.setdefault(process, call) is not call:  # one step, so that no two threads get through
                raise InputError(f"backend {self.name} is in use by another thread; make one a thread.")
            if process != self._process:
                self._process, self._memories = process, {}
            self._calls = self.iterations = 0
            return solve()
        finally:
            if self._users.get(process) is call:
                del self._users[process]

    def _solve(self, stage: Stage) -> StageResult:
        memory = self._memories.pop(stage.place, None)  # what follows puts it back, unless it fails
        first = self._attempt(lambda: self._solve_from(stage, memory))
        if first.x is not None:
            return first
        second = self._attempt(lambda: self._solve_from(stage, None, again=True))
        return second if second.x is not None else replace(first, calls=second.calls)

    def _attempt(self, solve: Callable[[], tuple[Array, Array]]) -> StageResult:
        """Return what `solve` makes of a stage, x `(v,)` and multipliers `(r,)`."""
        try:
            x, multipliers = solve()
        except SolverFailedError as failure:
            return StageResult(None, f"{self.name} {failure}", self._calls)
        return StageResult(x, calls=self._calls, multipliers=np.maximum(multipliers, 0.0))

    def _solve_as_it_stands(self, stage: Stage) -> tuple[Array, Array]:
        workspace = self._set_up(stage.problem, {}, stage.costed, 0.0)
        answer = self._call(workspace, stage.problem, None)
        return answer.x, answer.multipliers

    def _solve_from(self, stage: Stage, memory: _Memory | None, *, again: bool = False) -> tuple[Array, Array]:
        """Return the answer from what the place remembers. Only one of full accuracy is remembered."""
        problem = stage.problem
        shape = (stage.size, stage.costed, len(stage.row_ids))
        multipliers = np.zeros(shape[2]) if memory is None else memory.multipliers_of(stage.row_ids)
        if memory is not None and memory.shape == shape:
            workspace = memory.workspace
        else:
            accuracy, shift = self.accuracy, self.abilities.shift
            if again:
                accuracy, shift = min(LOOSER * accuracy, 0.1), max(shift, FIRM_SHIFT)
            workspace = self._set_up(problem, self.abilities.options(accuracy), stage.costed, shift)
        answer = self._call(workspace, problem, multipliers)
        if not again:
            self._memories[stage.place] = _Memory(workspace, shape, stage.row_ids, answer.multipliers)
        return self._refined(stage, workspace, answer)

    def _refined(self, stage: Stage, workspace: Workspace, answer: Answer) -> tuple[Array, Array]:
        """Return the answer zoomed in on; a zoom by ε divides the multipliers by ε too."""
        zooms, multipliers = iter(self.zooms), answer.multipliers

        def once(problem: qpsolvers.Problem) -> Array:
            nonlocal multipliers
            epsilon = next(zooms)
            try:
                zoomed = self._call(workspace, problem, answer.multipliers / epsilon)
            except SolverFailedError:
                self._memories.pop(stage.place, None)
                raise
            multipliers = epsilon * zoomed.multipliers
            return zoomed.x

        return zoom_in(stage, answer.x, self.zooms, once, SolverFailedError), multipliers

    def _set_up(self, problem: qpsolvers.Problem, options: Options, costed: int, shift: float) -> Workspace:
        with self._failures():
            return self._workspace(problem, options, costed, shift)

    def _call(self, workspace: Workspace, problem: qpsolvers.Problem, multipliers: Array | None) -> Answer:
        """Return the solver's finite answer to one QP."""
        self._calls += 1
        with self._failures():
            answer = workspace.solve(problem, multipliers)
        self.iterations += answer.iterations
        if not math.isfinite(answer.x @ answer.x + answer.multipliers @ answer.multipliers):
            raise SolverFailedError("returned values that are not finite")
        return answer

    @contextmanager
    def _failures(self) -> Iterator[None]:
        try:
            yield
        except (*SOLVER_ERRORS, *self._workspace.errors) as error:
            raise SolverFailedError(f"raised {type(error).__name__}: {error}") from error
