"""Table 1: every equation of the paper, as printed and as implemented, and how far each is from an independent answer."""

from typing import Any

from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.jobs import Job, Results
from paper_repro.make.table import Column, Table
from paper_repro.measure import audit
from paper_repro.measure.windings import measured_job, settings

COLUMNS = (
    Column("equation", "Eq."),
    Column("printed", "as printed", width="2.8cm"),
    Column("implemented", "implemented by", width="2.8cm"),
    Column("differs", "differs, because", width="3.6cm"),
    Column("test", "held against", width="3.2cm"),
    Column("error_printed", "error, printed", ".0e"),
    Column("error_implemented", "error, implemented", ".0e"),
    Column("allowed", "allowed", ".0e"),
    Column("holds", "holds"),
)

#: Bent at every joint, so that links leave the plane P and Eq. (21) has something to decide.
BENT = {"posture": "arched"}


def _winding(**changes: Any) -> Job:
    return measured_job(settings(**BENT, **changes))


def jobs(scale: Scale) -> list[Job]:
    """Return the measurements of all rows, and a winding with and one without the dead band of Eq. (21)."""
    return [Job(audit.measure), *([] if scale.quick else [_winding(), _winding(dead_band=0.0)])]


def build(scale: Scale, results: Results) -> Table:
    """Return the audit."""
    measured = results[Job(audit.measure)]
    rows = tuple(_cells(row, measured[row.equation]) for row in audit.ROWS)
    return Table(COLUMNS, rows, _notes(scale, results, measured))


def holds(row: audit.Row, measured: audit.Measured) -> bool:
    """Return whether the implemented form is within what is allowed; one that is refused where it should be, is."""
    error = measured["implemented"]
    return error is None or error <= row.allowed


def _cells(row: audit.Row, measured: audit.Measured) -> tuple[str | float | bool | None, ...]:
    return (
        row.equation,
        row.printed,
        row.names,
        row.differs or "–",
        row.test,
        measured["printed"],
        measured["implemented"],
        row.allowed,
        holds(row, measured),
    )


def _notes(scale: Scale, results: Results, measured: dict[str, audit.Measured]) -> str:
    inner, plain = measured["2"], measured["17 on Fig. 5"]["printed"]
    lines = [
        f"- Eq. 2 as printed is wrong by {inner['printed_least']:.0%} for the inner arm next to the last and by "
        f"{inner['printed']:.0%} for the first.",
        "- Eq. 17 as printed, solved for the arm of Fig. 5 although JᵀWJ is singular there, "
        + (
            "stops at a zero pivot."
            if plain is None
            else f"gives a step {plain:.0e} times as far off as the right one is long."
        ),
    ]
    if not scale.quick:
        with_band, without = (results[job] for job in (_winding(), _winding(dead_band=0.0)))
        lines.append(
            f"- Eq. 21 without the dead band: s changes its sign {without['flips']} times in {without['steps']} steps of a "
            f"winding from the arched pose; with it {with_band['flips']} times in {with_band['steps']}."
        )
    return "\n".join(lines)


ARTEFACT = Artefact(
    "table-1",
    "Table 1: the equations, as printed and as implemented",
    """\
Every equation of the paper, what implements it, and how far the printed and the implemented form are from an answer
that comes by another way and shares no code with the library. Errors are relative to the size of that answer, the
worst of general poses of the 17-link arm (Eqs. 1 to 15), the planar arm (16, 17), or of a few hundred drawn contacts
(18 to 22). *As printed* is what the scan shows: it merges the winding direction **α** and the link's direction **a**,
so that some of what differs there may be the scan's doing and not the paper's.

Where both columns give the same error the printed form is the implemented one, or its formula written out. Where the
printed form differs and is computable its error is not rounding: it is another equation. – is what cannot be computed
(indices that do not exist, an equation that is not printed) or, among the implemented, what is refused with an error,
as Eqs. 16 and 17 are on an arm that they do not apply to. *Allowed* is what rounding, or the step of a finite
difference, leaves; a row that does not hold is a fault of this library. What the table does not show is whether the
paper's own program used the forms that it prints.""",
    jobs,
    build,
)
