"""What there is to do, in pieces that are done whole or not at all, and in which order.

Repeats are interleaved: all solvers once, then all once more, so that what else the machine does in between hits none of
them alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from comparisons.cases import Case, file_name
from comparisons.methods import MINK, REFERENCE
from comparisons.settings import MINK_SOLVERS, ONE_LEVEL, ONE_QP, ComparisonSettings
from prioritized_ik.solvers.backends.abilities import abilities_of
from prioritized_ik.solvers.methods import ActiveSet
from prioritized_ik.solvers.registry import LEXICOGRAPHIC, parts_of
from prioritized_ik.winding.settings import CLOSED_FORM

COLD, WARM = "cold", "warm"

#: Mink's rows.
MINK_ROWS = tuple(f"{MINK}:{solver}" for solver in MINK_SOLVERS)

#: The witness's row: the problem written out in CVXPY, with the solver that it calls.
WITNESS_SOLVER = "clarabel"
WITNESS = f"{REFERENCE}:{WITNESS_SOLVER}"

#: These take longest, so they start first, and go without refinement where their answers are polished in any case.
SLOW = (WITNESS, "ecos", "clarabel", "scs", "highs", "cvxopt")


@dataclass(frozen=True)
class Job:
    """One solver on one case.

    Attributes:
        kind: `"replay"`, of the recorded problems, or `"drive"`, of the arm.
        case: name of the case.
        solver: who.
        formulation: of the problem: the method's family, or `"lexicographic"` of those that solve all levels exactly.
        accuracy: asked of the solver; None where none is: formulations of one QP and mink leave it to the solver.
        start: `"cold"`, set up afresh for each problem, or `"warm"`, from the step before, see `worker.replay`.
        repeat: which time, from 0.
    """

    kind: str
    case: str
    solver: str
    formulation: str
    accuracy: float | None
    start: str = COLD
    repeat: int = 0

    @property
    def method(self) -> str:
        """Name of the method."""
        return f"{self.formulation}:{self.solver}" if self.formulation in ONE_QP else self.solver

    @property
    def label(self) -> str:
        """What the progress bar shows."""
        return f"{self.kind} {self.solver}" + ("" if self.formulation == "lexicographic" else f" {self.formulation}")

    @property
    def file(self) -> str:
        """Name of the files that hold what came of it, without suffix."""
        accuracy = "any" if self.accuracy is None else f"{self.accuracy:g}"
        return file_name(self.case, self.solver, self.formulation, accuracy, self.start, self.repeat)


def replays(settings: ComparisonSettings, cases: Sequence[Case]) -> list[Job]:
    """Return all replays, in the order in which to do them."""
    todo = []
    for repeat in range(settings.repeats):
        for case in cases:
            once = [Job("replay", case.name, *row, repeat) for row in _rows(settings, case)]
            todo += sorted(once, key=lambda job: _slowest_first(job.solver))
    return todo


def drives(settings: ComparisonSettings, cases: Sequence[Case]) -> list[Job]:
    """Return all episodes that solvers drive themselves, the longest first."""
    if not settings.drive:
        return []
    todo = []
    for case in cases:
        if case.posed is None:
            continue
        rows = [form for name in settings.solvers for form in _forms(settings, name) if _drives(name, form[1])]
        others = [(CLOSED_FORM, "closed form"), *_of_mink(settings, case)]
        for solver, formulation in dict.fromkeys([*rows, *(others if case.one_level else [])]):
            if case.one_level or formulation not in ONE_LEVEL:
                accuracy = min(_accuracies(settings, solver, formulation), key=lambda a: a or 0.0)
                start = WARM if starts_warm(solver) and formulation == LEXICOGRAPHIC else COLD
                todo.append(Job("drive", case.name, solver, formulation, accuracy, start))
    return sorted(todo, key=lambda job: _slowest_first(job.solver))


def starts_warm(solver: str) -> bool:
    """Whether a solver keeps what it learned from the step before."""
    return solver == ActiveSet.name or abilities_of(solver).native


def _rows(settings: ComparisonSettings, case: Case) -> list[tuple[str, str, float | None, str]]:
    """Return solver, formulation, accuracy and start of everything that replays a case once."""
    forms = [form for name in settings.solvers for form in _forms(settings, name)]
    forms += _of_mink(settings, case)
    forms += [(WITNESS, REFERENCE)] if settings.witness else []
    rows: list[tuple[str, str, float | None, str]] = []
    for solver, formulation in dict.fromkeys(forms):
        if case.one_level or formulation not in ONE_LEVEL:
            # A start helps nothing in a QP solved once.
            starts = (COLD, WARM) if formulation == LEXICOGRAPHIC and starts_warm(solver) else (COLD,)
            asked = _accuracies(settings, solver, formulation)
            rows += [(solver, formulation, accuracy, start) for accuracy in asked for start in starts]
    return rows


def _of_mink(settings: ComparisonSettings, case: Case) -> list[tuple[str, str]]:
    """Return mink's rows: it poses its own problem, of windings of one level alone."""
    return [(name, MINK) for name in MINK_ROWS] if settings.mink and case.one_level and case.winding else []


def _forms(settings: ComparisonSettings, name: str) -> list[tuple[str, str]]:
    """Return as whom (solver) and as what (formulation) the method of a name is replayed.

    A QP solver named by itself is replayed in every formulation asked for that suits it. The closed form is what all are
    compared with, and so no row of its own.
    """
    family, solver = parts_of(name)
    if family == LEXICOGRAPHIC and solver == name:
        suited = (one for one in settings.formulations if one == LEXICOGRAPHIC or not abilities_of(name).native)
        return [(name, formulation) for formulation in suited]
    if family in (LEXICOGRAPHIC, *ONE_QP):
        return [(solver, family)]
    if family:
        return [(name, family)]
    return [(name, LEXICOGRAPHIC)] if name != CLOSED_FORM and LEXICOGRAPHIC in settings.formulations else []


def _drives(name: str, formulation: str) -> bool:
    """Whether what `name` asks for winds the arm itself: whatever is exact, and what its name says in full."""
    return formulation == LEXICOGRAPHIC or ":" in name


def _accuracies(settings: ComparisonSettings, solver: str, formulation: str) -> tuple[float | None, ...]:
    """Return the accuracies asked of a solver; None where none is."""
    return settings.accuracies_of(solver) if formulation == LEXICOGRAPHIC and solver != ActiveSet.name else (None,)


def _slowest_first(solver: str) -> int:
    return SLOW.index(solver) if solver in SLOW else len(SLOW)
