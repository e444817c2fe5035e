"""From a problem to the joint step of the compiled core, or to None where it declines."""

from collections.abc import Collection
from time import perf_counter
from typing import Any, NamedTuple

from prioritized_ik.late import Late
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.certificate import Certificate
from prioritized_ik.solvers.compiled.library import Ending, Question, library
from prioritized_ik.solvers.compiled.workspace import (
    ACTIVE,
    COUNTS,
    EXCEEDED,
    FIGURES,
    HOLDING,
    Sizes,
    Workspace,
    workspace_for,
)
from prioritized_ik.solvers.report import DeferredReports
from prioritized_ik.solvers.step import JointStep, StepStatus, Timings
from prioritized_ik.tolerances import NOISE
from prioritized_ik.validation import Array

TIGHT, NOT_KEPT = 1, 2  # of a guessed row
FEW = 64  # counts and lists of most steps, read at once

_STATUS: dict[int, StepStatus] = {Ending.CLOSED_FORM: StepStatus.CLOSED_FORM, Ending.SOLVED: StepStatus.SOLVED}


def answers(problem: IKProblem) -> bool:
    """Whether the core takes problems of this kind, see the table in `compiled/__init__.py`."""
    return library().core is not None and problem.noise == NOISE and len(problem.reference) > 0


class Remembered(NamedTuple):
    """Rows by their numbers among `names`; those `exceeded` are of soft levels."""

    names: tuple[str, ...]
    numbers: list[int]
    exceeded: list[int]

    def named(self) -> tuple[str, ...]:
        """Return the names of the rows."""
        return tuple([self.names[number] for number in sorted(self.numbers + self.exceeded)])


class CompiledStep(JointStep):
    """A step of the core: what a control loop needs is there, names and figures are put together when looked at.

    Attributes:
        written: what the core wrote of it.
    """

    costs: Any = Late()
    tight_rows: Any = Late()
    violation: Any = Late()
    certificate: Any = Late()
    repairs: Any = Late()
    levels: Any = Late()
    zeros: Any = Late()
    active_rows: Any = Late()
    timings: Any = Late()
    written: "Written"

    def late_fields(self) -> dict[str, Any]:
        """Return the fields that are put together late."""
        return _fields(self.written)

    @property
    def is_judged(self) -> bool:
        """Whether there is a certificate: there always is."""
        return True

    def made_by(self, method: str) -> "CompiledStep":
        """See `JointStep.made_by`; what is put together when looked at stays so."""
        if method == self.method:
            return self
        step = object.__new__(CompiledStep)
        step.__dict__.update(self.__dict__, method=method)
        return step


class Written(NamedTuple):
    """What the core wrote of a step, see exchange.hpp, and the names that it refers to."""

    problem: IKProblem
    rank_tolerance: float
    dtheta: Array
    figures: Array
    lists: list[int]
    names: tuple[str, ...]
    seconds: float

    def active(self) -> Remembered:
        """Return the rows that the step was computed from."""
        exceeded = COUNTS + self.lists[ACTIVE]
        end = exceeded + self.lists[EXCEEDED]
        return Remembered(self.names, self.lists[COUNTS:exceeded], self.lists[exceeded:end])


def compiled_step(
    problem: IKProblem,
    rank_tolerance: float,
    rows: Collection[str] | Remembered = (),
    question: Question = Question.STEP,
    method: str = "",
) -> CompiledStep | None:
    """Return the certified step of a problem that the core `answers`, None if it declines.

    Args:
        problem: damped levels are taken as their rows.
        rank_tolerance: see `SolveOptions`.
        rows: those that the step may rest on, such as the last step's, or their names.
        question: the step; only a closed form that breaks no row; or no closed form first.
        method: name of who solves.
    """
    started = perf_counter()
    flat = problem if problem.metric.ndim == 1 else problem.in_metric
    sizes = Sizes.of(flat)
    workspace = workspace_for(sizes)
    workspace.fill(flat, sizes, rank_tolerance)
    workspace.name(flat)
    _guess(rows, workspace)
    status = _STATUS.get(workspace.solve(sizes, question))
    if status is None:
        return None
    lists: list[int] = workspace.lists[:FEW].tolist()
    last = COUNTS + sum(lists[ACTIVE:HOLDING]) + 2 * lists[HOLDING]
    if last > FEW:
        lists = workspace.lists[:last].tolist()
    dtheta = workspace.dtheta.copy()
    if flat is not problem:
        dtheta = problem.from_metric(dtheta)
    figures = workspace.figures[: FIGURES * (sizes.levels + 1) + 2 + sizes.levels].copy()
    step = object.__new__(CompiledStep)
    step.__dict__.update(
        dtheta=dtheta,
        status=status,
        path="compiled",
        method=method,
        written=Written(problem, rank_tolerance, dtheta, figures, lists, workspace.names, perf_counter() - started),
    )
    return step


def _guess(rows: Collection[str] | Remembered, workspace: Workspace) -> None:
    """Write which rows the step may rest on, those that the problem does not have left out."""
    guess = workspace.guess
    guess[:] = 0
    if isinstance(rows, Remembered):
        if rows.names is workspace.names:
            for number in rows.numbers:
                guess[number] = TIGHT
            for number in rows.exceeded:
                guess[number] = NOT_KEPT
            return
        rows = rows.named()
    known = workspace.numbers
    for name in rows:
        if name in known:
            guess[known[name]] = TIGHT


def _fields(written: Written) -> dict[str, Any]:
    """Return the fields of a step that are put together late."""
    problem, rank_tolerance, dtheta, values, lists, names, seconds = written
    levels = len(problem.levels)
    end, figures = FIGURES * (levels + 1), values.tolist()
    corrections, _, _, active, exceeded, tight, zero, holding = lists[:COUNTS]
    exceeded += active + COUNTS
    tight += exceeded
    zero += tight
    held: list[tuple[str, ...]] = [()] * (levels + 1)
    for place in range(zero, zero + 2 * holding, 2):
        held[lists[place]] += (names[lists[place + 1]],)
    certificate = Certificate(
        figures[end],
        tuple(figures[0:end:FIGURES]),
        tuple(figures[1:end:FIGURES]),
        tuple(figures[2:end:FIGURES]),
        tuple(figures[3:end:FIGURES]),
        tuple(held),
    )
    return {
        "costs": tuple(figures[end + 2 :]),
        "tight_rows": tuple([names[i] for i in lists[exceeded:tight]]),
        "violation": figures[end],
        "certificate": certificate,
        "repairs": corrections,
        "levels": DeferredReports(problem, rank_tolerance, dtheta),
        "zeros": _row_names(problem, lists[tight:zero], names[2 * problem.joint_count :]) if zero > tight else (),
        "active_rows": written.active().named(),
        "timings": Timings(seconds, 0.0),
    }


def _row_names(problem: IKProblem, numbers: list[int], hard: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of rows by `numbers`, counted through all levels and then through the `hard` rows."""
    names: list[str] = []
    before, rest = 0, iter(numbers)
    number = next(rest, None)
    for level in problem.levels:
        end = before + len(level.target)
        while number is not None and number < end:
            names.append(f"{level.name} row {number - before + 1}")
            number = next(rest, None)
        before = end
    while number is not None:
        names.append(hard[number - before])
        number = next(rest, None)
    return tuple(names)
