"""Table 9: what limits and contact rows each do for a winding."""

from typing import Any

from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.jobs import Job, Results
from paper_repro.make.table import Cell, Column, Table
from paper_repro.measure.windings import CRITERION, TERM_TITLES, counted, measured_job, settings
from prioritized_ik.solvers.step import StepStatus
from prioritized_ik.winding.settings import WindingSettings

SEEDS = 5  # of random poses; as many as Table 8 has if those are fewer

#: Which constraints, and what `WindingSettings` calls them.
CONSTRAINTS: dict[str, dict[str, Any]] = {
    "none": {"limits": False, "contacts": False},
    "limits": {"limits": True, "contacts": False},
    "contacts": {"limits": False, "contacts": True},
    "both": {"limits": True, "contacts": True},
}

#: How steps end, as columns.
STATUSES = {
    "closed_form": (StepStatus.CLOSED_FORM,),
    "solved": (StepStatus.SOLVED,),
    "uncertified": (StepStatus.UNCERTIFIED,),
    "infeasible": (StepStatus.INFEASIBLE,),
    "not_found": (StepStatus.NOT_FOUND, StepStatus.VIOLATED),
}

COLUMNS = (
    Column("constraints", "constraints"),
    Column("direction", "object from"),
    Column("closed_form", "closed form [steps]"),
    Column("solved", "solved, certified [steps]"),
    Column("uncertified", "uncertified [steps]"),
    Column("infeasible", "infeasible [steps]"),
    Column("not_found", "refused or not found [steps]"),
    Column("turns_ratio", "turns / ideal, least", ".2f"),
    Column("penetration_mm", "penetration, worst [mm]", ".1f"),
    Column("bend_rad", "bend, worst [rad]", ".2f"),
    Column("hinge_excess_rad", "outside joint range, worst [rad]", ".2f"),
    Column("drift_mm", "drift, worst [mm]", ".1f"),
    Column("in_contact", TERM_TITLES[0]),
    Column("turned", TERM_TITLES[1]),
    Column("within_range", TERM_TITLES[2]),
)

CAPTION = f"""\
The same windings (Eq. 23; the straight initial pose and random ones) by the QP with no constraints, with joint ranges and
the step limit alone, with contact rows alone, and with both. The counts are of steps by how they ended, over all windings
of the row: answered by the closed form, because no row binds; solved by the QP and proven optimal; solved but not proven;
proven infeasible; refused because the solver's step broke a row, or not found. A failed step ends its winding. The
figures of the winding are the worst of the row; *outside joint range*, the furthest any hinge went beyond its range, is
negative inside.

{CRITERION}.

Limits alone keep links from folding back, but not always out of the object. Contact rows alone do not even do that: they
are linear in the step, and without a step limit steps near singular poses are too long for any linear row, so that hinges
spin and links land inside. Only both wind every time. This does *not* separate the joint range from the step limit, nor
say anything of other ranges: see the sensitivity table.
"""


def poses(scale: Scale) -> list[dict[str, Any]]:
    """Return the initial poses; the straight one only in the full run."""
    random = [{"posture": "random", "seed": seed} for seed in range(min(SEEDS, scale.seeds))]
    return random if scale.quick else [{}, *random]


def directions(scale: Scale) -> tuple[str, ...]:
    """Return where the object comes from; one direction in the reduced run."""
    return scale.directions[:1] if scale.quick else scale.directions


def windings(scale: Scale, constraints: str, direction: str) -> list[WindingSettings]:
    """Return the windings of one row."""
    return [settings(direction=direction, **CONSTRAINTS[constraints], **pose) for pose in poses(scale)]


def jobs(scale: Scale) -> list[Job]:
    """Return one job a winding."""
    rows = [(constraints, direction) for constraints in CONSTRAINTS for direction in directions(scale)]
    return [measured_job(winding) for row in rows for winding in windings(scale, *row)]


def build(scale: Scale, results: Results) -> Table:
    """Return the table."""
    rows = []
    for constraints in CONSTRAINTS:
        for direction in directions(scale):
            figures = [results[measured_job(winding)] for winding in windings(scale, constraints, direction)]
            rows.append((constraints, direction, *_cells(figures)))
    count = len(poses(scale))
    others = "" if scale.quick else "the straight pose and "
    seeds = min(SEEDS, scale.seeds)
    kind = "random pose" if seeds == 1 else "random poses"
    note = f"{count} {'winding' if count == 1 else 'windings'} a row: {others}{seeds} {kind}."
    return Table(COLUMNS, tuple(rows), note)


def _cells(figures: list[dict[str, Any]]) -> tuple[Cell, ...]:
    return (
        *(sum(f["status"][status.name] for f in figures for status in group) for group in STATUSES.values()),
        min(f["turns_ratio"] for f in figures),
        1e3 * max(f["penetration"] for f in figures),
        max(f["bend"] for f in figures),
        max(f["hinge_excess"] for f in figures),
        1e3 * max(f["drift"] for f in figures),
        *counted(figures),
    )


ARTEFACT = Artefact("table-9", "Table 9: ablation of the constraints", CAPTION, jobs, build)
