"""Whether the region where the closed form winds hangs on the time step, the contact threshold or the rank tolerance."""

from typing import Any

from paper_repro.artefacts.closed_form_map import REASONS, WEIGHTS, reasons
from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.jobs import Job, Results
from paper_repro.make.table import Cell, Column, Table
from paper_repro.measure.failing import examined_job
from paper_repro.measure.windings import CRITERION, counted, settings
from prioritized_ik.solvers.lexicographic import SolveOptions

LINKS = tuple(range(9, 16))

#: What is changed, as text, and how; the first is the default.
CHANGES: dict[str, dict[str, Any]] = {
    "none": {},
    "time step 1 ms (default 2)": {"dt": 1e-3},
    "time step 3 ms": {"dt": 3e-3},
    "time step 4 ms": {"dt": 4e-3},
    "contact / release 1.5 / 3 mm (default 2 / 4)": {"contact_distance": 1.5e-3, "release_distance": 3e-3},
    "contact / release 3 / 6 mm": {"contact_distance": 3e-3, "release_distance": 6e-3},
    "rank tolerance 1e-6 (default 1e-4)": {"options": SolveOptions(rank_tolerance=1e-6)},
    "rank tolerance 1e-3": {"options": SolveOptions(rank_tolerance=1e-3)},
}

CAPTION = f"""\
The region where the closed form winds, straight pose and untilted object, with one choice changed at a time: of the
windings from all directions, how many are wound by turns and depth, by first link. {CRITERION}.

First links 12 to 15 wind under all of these changes but one, and 11 under most; the edge of the region, first links 9
and 10, moves by a link. The one is a time step of 4 ms: with η·dt = 8 mm a link is pushed further into the object in
one step than the depth that counts, before it is felt (P). This does *not* show two changes together.

**Why not**, with how often: {REASONS}.
"""


def links(scale: Scale) -> tuple[int, ...]:
    """Return the first links; one in the reduced run."""
    return (12,) if scale.quick else LINKS


def changes(scale: Scale) -> list[str]:
    """Return what is changed; the default and one more in the reduced run."""
    return list(CHANGES)[:2] if scale.quick else list(CHANGES)


def group(scale: Scale, change: str, weights: str, link: int) -> list[Job]:
    """Return the windings of one cell, from one direction in the reduced run."""
    directions = scale.directions[:1] if scale.quick else scale.directions
    return [
        examined_job(settings("closed form", direction=direction, weights=weights, link=link, **CHANGES[change]))
        for direction in directions
    ]


def jobs(scale: Scale) -> list[Job]:
    """Return one job a winding."""
    return [
        job
        for change in changes(scale)
        for weights in WEIGHTS
        for link in links(scale)
        for job in group(scale, change, weights, link)
    ]


def build(scale: Scale, results: Results) -> Table:
    """Return the table."""
    columns = (
        Column("changed", "changed", width="4cm"),
        Column("weights", "weights"),
        Column("windings", "windings a first link"),
        *(Column(f"first_link_{link}", f"{link}") for link in links(scale)),
        Column("reasons", "why not"),
    )
    rows: tuple[tuple[Cell, ...], ...] = tuple(
        (
            change,
            WEIGHTS[weights],
            len(group(scale, change, weights, links(scale)[0])),
            *(counted(results[job] for job in group(scale, change, weights, link))[1] for link in links(scale)),
            reasons([results[job] for link in links(scale) for job in group(scale, change, weights, link)]),
        )
        for change in changes(scale)
        for weights in WEIGHTS
    )
    return Table(columns, rows, "Wound by turns and depth, by first link.")


ARTEFACT = Artefact("closed-form-stability", "How firm the region is where the closed form winds", CAPTION, jobs, build)
