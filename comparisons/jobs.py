"""What there is to do, in pieces that are done whole or not at all, and in which order.

Repeats are interleaved: all solvers once, then all once more, so that what else the machine does in between hits none of
them alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from comparisons.cases import Case, file_name
from comparisons.settings import MINK_SOLVERS, ComparisonSettings
from prioritized_ik.solvers.backends.abilities import abilities_of
from prioritized_ik.solvers.lexicographic import ONE_QP
from prioritized_ik.winding.settings import CLOSED_FORM

COLD, WARM = "cold", "warm"

#: Solver names of mink's rows.
MINK_ROWS = {f"mink ({solver})": solver for solver in MINK_SOLVERS}

#: The witness's row: the problem written out in CVXPY, with the solver that it calls.
WITNESS_SOLVER = "CLARABEL"
WITNESS = f"cvxpy ({WITNESS_SOLVER.lower()})"

#: These take longest, so they start first, and go without refinement where their answers are polished in any case.
SLOW = (WITNESS, "ecos", "clarabel", "scs", "highs", "cvxopt")


@dataclass(frozen=True)
class Job:
    """One solver on one case.

    Attributes:
        kind: `"replay"`, of the recorded problems, or `"drive"`, of the arm.
        case: name of the case.
        solver: who.
        formulation: of the problem.
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
    """Return all windings that solvers drive themselves, the longest first."""
    if not settings.drive:
        return []
    todo = []
    for case in cases:
        if "lexicographic" in settings.formulations:
            for solver in settings.solvers:
                start = WARM if starts_warm(solver) else COLD
                todo.append(Job("drive", case.name, solver, "lexicographic", min(settings.accuracies_of(solver)), start))
        if case.one_level:
            others = [(CLOSED_FORM, "closed form"), *((name, "mink") for name in MINK_ROWS if settings.mink)]
            todo += [Job("drive", case.name, name, formulation, None) for name, formulation in others]
    return sorted(todo, key=lambda job: _slowest_first(job.solver))


def starts_warm(solver: str) -> bool:
    """Whether a solver keeps what it learned from the step before."""
    return abilities_of(solver).native and solver != "daqp-hierarchy"


def _rows(settings: ComparisonSettings, case: Case) -> list[tuple[str, str, float | None, str]]:
    """Return solver, formulation, accuracy and start of everything that replays a case once."""
    rows: list[tuple[str, str, float | None, str]] = []
    for solver in settings.solvers:
        if "lexicographic" in settings.formulations:
            starts = (COLD, WARM) if starts_warm(solver) else (COLD,)
            rows += [(solver, "lexicographic", a, start) for a in settings.accuracies_of(solver) for start in starts]
        # A start helps nothing in a QP solved once.
        if case.one_level and not abilities_of(solver).native:
            rows += [(solver, name, None, COLD) for name in settings.formulations if name in ONE_QP]
    if settings.mink and case.one_level:
        rows += [(name, "mink", None, COLD) for name in MINK_ROWS]
    if settings.witness:
        rows.append((WITNESS, "witness", None, COLD))
    return rows


def _slowest_first(solver: str) -> int:
    return SLOW.index(solver) if solver in SLOW else len(SLOW)
