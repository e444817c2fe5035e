"""How windings end over all directions, for the README: a short and a long one, by closed form and QP."""

from statistics import median
from typing import Any

from paper_repro.artefacts.closed_form_map import ideal_turns
from paper_repro.artefacts.table_8_windings import WEIGHT_NAMES, directions
from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.jobs import Job, Results
from paper_repro.make.table import Cell, Column, Table
from paper_repro.measure.windings import (
    CRITERION,
    LONG,
    METHOD_NAMES,
    METHODS,
    SHORT,
    TERM_TITLES,
    counted,
    measured_job,
    settings,
)
from prioritized_ik.weights import KINDS

POSES = ("straight", "random")
SEEDS = 5  # of random poses; as many as Table 8 has if those are fewer

COLUMNS = (
    Column("first_link", "first link"),
    Column("weights", "weights"),
    Column("method", "method"),
    Column("turns_ratio_median", "turns / ideal, median", ".2f"),
    Column("penetration_mm_median", "penetration, median [mm]", ".1f"),
    Column("penetration_mm_worst", "penetration, worst [mm]", ".1f"),
    Column("bend_rad_worst", "bend, worst [rad]", ".2f"),
    Column("steps", "steps, median", ".0f"),
    *(
        Column(f"{pose}_{key}", f"{pose}, {title}")
        for pose in POSES
        for key, title in zip(("in_contact", "turned", "within_range"), TERM_TITLES, strict=True)
    ),
)

CAPTION = f"""\
Windings from all directions around the untilted object, of the links from {SHORT} on, {ideal_turns(SHORT):.2f} of a
turn, and from {LONG} on, {ideal_turns(LONG):.2f}: by the closed form (Eqs. 12 to 14 alone, as in the paper) and by the
QP with joint ranges, a step limit and contact rows; from the straight pose and from random ones (every joint within a
few hundredths of a radian of straight). *Strict* has levels in place of weights; by the closed form that is the method
of Hanafusa, Yoshikawa and Nakamura. Turns: over what a polygon of tangent links makes; penetration negative: the least
clearance. {CRITERION}. Where else the closed form winds, and why it does not elsewhere, shows its map.
"""


def poses(scale: Scale) -> dict[str, list[dict[str, Any]]]:
    """Return the changes to the settings of each kind of initial pose, by the names of `POSES`."""
    return {"straight": [{}], "random": [{"posture": "random", "seed": seed} for seed in range(min(SEEDS, scale.seeds))]}


def cases(scale: Scale) -> list[tuple[int, str, str]]:
    """Return first link, weights and method of each row; of the reduced run Eq. 23 alone from the first of the links."""
    kinds = {SHORT: KINDS[:1] if scale.quick else KINDS, LONG: KINDS}
    return [(link, weights, method) for link in (SHORT, LONG) for weights in kinds[link] for method in METHODS]


def group(scale: Scale, link: int, weights: str, method: str, pose: str) -> list[Job]:
    """Return the windings of one row from one kind of pose."""
    return [
        measured_job(settings(method, direction=direction, weights=weights, link=link, **changes))
        for direction in directions(scale)
        for changes in poses(scale)[pose]
    ]


def jobs(scale: Scale) -> list[Job]:
    """Return one job a winding."""
    return [job for case in cases(scale) for pose in POSES for job in group(scale, *case, pose)]


def build(scale: Scale, results: Results) -> Table:
    """Return the table."""
    rows = []
    for link, weights, method in cases(scale):
        windings = {pose: [results[job] for job in group(scale, link, weights, method, pose)] for pose in POSES}
        counts = [count for pose in POSES for count in counted(windings[pose])]
        figures = _cells([figures for pose in POSES for figures in windings[pose]])
        rows.append((link, WEIGHT_NAMES[weights], METHOD_NAMES[method], *figures, *counts))
    of = " and ".join(f"{len(group(scale, *cases(scale)[0], pose))} from {pose} poses" for pose in POSES)
    notes = (
        f"{of} a row, from {', '.join(directions(scale))}. {CRITERION}. Penetration negative: the least clearance. Where "
        "the QP misses by depth, the first link in contact sinks in: contact rows hold to first order, and never push out. "
        "Strict levels lock up where the last link's one hinge cannot reach the object."
    )
    return Table(COLUMNS, tuple(rows), notes)


def _cells(windings: list[dict[str, Any]]) -> tuple[Cell, ...]:
    turns, depths = ([figures[key] for figures in windings] for key in ("turns_ratio", "penetration"))
    return (
        median(turns),
        1e3 * median(depths),
        1e3 * max(depths),
        max(figures["bend"] for figures in windings),
        float(median([figures["steps"] for figures in windings])),
    )


ARTEFACT = Artefact("outcomes", "Winding outcomes, all directions together", CAPTION, jobs, build)
