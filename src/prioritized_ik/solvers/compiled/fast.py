"""From a problem to the joint step of the compiled core, or to None where it declines."""

from collections.abc import Collection
from itertools import compress
from time import perf_counter
from typing import Any, NamedTuple

from prioritized_ik.late import Late
from prioritized_ik.packed import Layout, PackedProblem
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.certificate import Certificate
from prioritized_ik.solvers.compiled.library import Ending, Question, library
from prioritized_ik.solvers.compiled.workspace import COUNTS, FIGURES, Answer, Sizes, Workspace, workspace_for, workspace_of
from prioritized_ik.solvers.report import DeferredReports
from prioritized_ik.solvers.step import JointStep, StepStatus, Timings
from prioritized_ik.tolerances import NOISE
from prioritized_ik.validation import Array

LOOSE, TIGHT, NOT_KEPT = 0, 1, 2  # of a guessed row; those that are not kept are of soft levels

STATUS: dict[int, StepStatus] = {
    Ending.CLOSED_FORM: StepStatus.CLOSED_FORM,
    Ending.SOLVED: StepStatus.SOLVED,
    Ending.OPEN: StepStatus.UNCERTIFIED,
}


def answers(problem: IKProblem) -> bool:
    """Whether the core takes problems of this kind, see the table in `compiled/__init__.py`."""
    pattern = problem.pattern
    return library().core is not None and pattern.noise == NOISE and len(pattern.reference) > 0


def is_sound(problem: PackedProblem) -> bool:
    """Whether the core sees at once that `IKProblem` takes such numbers; if in doubt, and without a core, it does not."""
    if library().core is None or problem.pattern.metric.ndim == 2 or not len(problem.pattern.reference):
        return False
    workspace, sizes = workspace_of(problem.layout)
    return workspace.is_sound(problem, sizes)


class Remembered(NamedTuple):
    """Which rows a step was computed from: of each of `names`, a byte that says so; and the `layout` if it was packed."""

    names: tuple[str, ...]
    kept: bytes | bytearray
    layout: Layout | None = None

    def named(self) -> tuple[str, ...]:
        """Return the names of the rows."""
        return tuple(compress(self.names, self.kept))


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
    """What the core wrote of a step, and the names that it refers to."""

    problem: IKProblem
    rank_tolerance: float
    dtheta: Array
    answer: Answer
    active: Remembered
    seconds: float


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
    is_flat, memory = problem.pattern.metric.ndim == 1, None
    if isinstance(problem, PackedProblem) and is_flat:
        workspace, sizes = workspace_of(problem.layout)
        workspace.settings[0], memory = rank_tolerance, problem.memory
    else:
        workspace, sizes = _filled(problem if is_flat else problem.in_metric, rank_tolerance, rounded=not is_flat)
    _guess(rows, workspace)
    ending, listed = workspace.solve(sizes, question, memory)
    status = STATUS.get(ending)
    if status is None:
        return None
    answer, names = workspace.answer(listed), workspace.names
    dtheta = answer.dtheta(sizes.joints)
    if not is_flat:
        dtheta = problem.from_metric(dtheta)
    active = Remembered(names, answer.kept_rows(len(names)), workspace.layout)
    written = Written(problem, rank_tolerance, dtheta, answer, active, perf_counter() - started)
    return step_of(status, "compiled", method, written)


def step_of(status: StepStatus, path: str, method: str, written: Written) -> CompiledStep:
    """Return the step that the core wrote."""
    step = object.__new__(CompiledStep)
    step.__dict__.update(dtheta=written.dtheta, status=status, path=path, method=method, written=written)
    return step


def _filled(problem: IKProblem, rank_tolerance: float, *, rounded: bool) -> tuple[Workspace, Sizes]:
    """Return the workspace that a problem was written into, and its sizes; see `Workspace.fill`."""
    sizes = Sizes.of(problem)
    workspace = workspace_for(sizes)
    workspace.fill(problem, sizes, rank_tolerance, rounded=rounded)
    workspace.name(problem)
    return workspace, sizes


def _guess(rows: Collection[str] | Remembered, workspace: Workspace) -> None:
    """Write which rows the step may rest on, those that the problem does not have left out."""
    of_another = isinstance(rows, Remembered) and rows.layout is not workspace.layout
    workspace.guess_rows(guessed(rows, workspace.names, workspace.numbers), of_another=of_another)


def guessed(rows: Collection[str] | Remembered, names: tuple[str, ...], numbers: dict[str, int]) -> bytes | bytearray:
    """Return which of a problem's rows, called `names` and numbered by them, are among `rows`: a byte for each."""
    if isinstance(rows, Remembered):
        if rows.names is names:
            return rows.kept
        rows = rows.named()
    guess = bytearray(len(names))
    for name in rows:
        if name in numbers:
            guess[numbers[name]] = TIGHT
    return guess


def _fields(written: Written) -> dict[str, Any]:
    """Return the fields of a step that are put together late."""
    problem, rank_tolerance, dtheta, answer, active, seconds = written
    lists, names = answer.all_lists(), active.names
    pattern = problem.pattern  # has what is asked of the problem here; its own parts may not have been looked at
    levels = len(pattern.levels)
    end, figures = FIGURES * (levels + 1), answer.all_figures(levels)
    corrections, _, _, computed_from, exceeded, tight, zero, holding = lists[:COUNTS]
    exceeded += computed_from + COUNTS
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
        "zeros": _row_names(pattern, lists[tight:zero], names[2 * problem.joint_count :]) if zero > tight else (),
        "active_rows": active.named(),
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
