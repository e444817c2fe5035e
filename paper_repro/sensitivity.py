"""Sensitivity: what each choice that the paper does not state changes in a winding."""

from typing import Any

from paper_repro.artefact import Artefact, Scale
from paper_repro.jobs import Job, Results
from paper_repro.table import Cell, Column, Table
from paper_repro.windings import CRITERION, LONG, TERM_TITLES, counted, measured_job, settings
from prioritized_ik.models import Arm

BASE = {"posture": "random", "seed": 0}  # straight windings from opposite sides mirror each other: half of them say nothing


def _arm(**changes: float) -> dict[str, Any]:
    return {"arm": Arm(**changes)}  # type: ignore[arg-type]


def _thresholds(contact: float, release: float) -> dict[str, Any]:
    return {"contact_distance": contact, "release_distance": release}


#: Choice, value as text, and what it changes from `BASE`; the first of a choice is the default.
CHOICES: dict[str, dict[str, dict[str, Any]]] = {
    "initial pose": {
        "random, seed 0": {},
        "random, seed 1": {"seed": 1},
        "straight": {"posture": "straight", "seed": 0},
        "arched": {"posture": "arched", "seed": 0},
    },
    "link radius [mm]": {"10": {}, "5": _arm(radius=5e-3), "15": _arm(radius=15e-3)},
    "contact / release distance [mm]": {
        "2 / 4": {},
        "2 / 2 (no hysteresis)": _thresholds(2e-3, 2e-3),
        "1.5 / 3": _thresholds(1.5e-3, 3e-3),
        "3 / 6": _thresholds(3e-3, 6e-3),
        "4 / 8": _thresholds(4e-3, 8e-3),
    },
    "time step [ms]": {"2": {}, "1": {"dt": 1e-3}, "4": {"dt": 4e-3}},
    "joint range [rad]": {
        "±1.0": {},
        "±0.6": _arm(joint_range=0.6),
        "±0.8": _arm(joint_range=0.8),
        "±1.5": _arm(joint_range=1.5),
    },
    "first link k": {"6": {}, "9": {"link": 9}, "12": {"link": 12}},
    "tilt of the object [rad]": {"0": {}, "0.3": {"tilt": 0.3}},
}

COUNTS = ("in_contact", "turned", "within_range")

QP_ONLY = ("joint range [rad]",)  # what the closed form does not know

COLUMNS = (
    Column("choice", "choice"),
    Column("value", "value"),
    Column("qp_turns_ratio", "QP: turns / ideal, least", ".2f"),
    Column("qp_penetration_mm", "QP: penetration, worst [mm]", ".1f"),
    Column("qp_bend_rad", "QP: bend, worst [rad]", ".2f"),
    Column("qp_drift_mm", "QP: drift, worst [mm]", ".1f"),
    Column("qp_steps", "QP: steps, most"),
    *(Column(f"qp_{key}", f"QP, {title}") for key, title in zip(COUNTS, TERM_TITLES, strict=True)),
    Column("closed_form_turns_ratio", "closed form: turns / ideal, least", ".2f"),
    Column("closed_form_penetration_mm", "closed form: penetration, worst [mm]", ".1f"),
    *(Column(f"closed_form_{key}", f"closed form, {title}") for key, title in zip(COUNTS, TERM_TITLES, strict=True)),
)

CAPTION = f"""\
Every choice that the paper leaves open, changed one at a time; the first value of each is the default. Figures are the
worst over windings from all directions with Eq. 23, by the QP with limits and contact rows and by the closed form (`–`
where the choice does not concern it); the last columns of each count windings.

{CRITERION}.

The QP winds from every initial pose here, with thin and thick links, from either first link, tilted or not, and with a
narrow joint range. What it does not bear is a step η·dt of more than a few millimetres or contact reported from further
away than that: links then count as wound before they lie against the object, and the next ones start from there. The
closed form has 1.26 of a turn to wind from first link {LONG} on, too much for it (see the closed-form map, which also
has the rank tolerance); how it fails changes with every choice. This does *not* show what two choices changed together
do, nor other random poses: see Table 8 for those.
"""


def values(scale: Scale) -> list[tuple[str, str]]:
    """Return choice and value of each row; the reduced run has two values of each of the first choices."""
    if scale.quick:
        return [(choice, value) for choice in list(CHOICES)[:2] for value in list(CHOICES[choice])[:2]]
    return [(choice, value) for choice, entries in CHOICES.items() for value in entries]


def windings(scale: Scale, method: str, choice: str, value: str) -> list[Job]:
    """Return the windings of one row by one method, from one direction in the reduced run."""
    directions = scale.directions[:1] if scale.quick else scale.directions
    return [
        measured_job(settings(method, direction=direction, **{**BASE, **CHOICES[choice][value]}))
        for direction in directions
    ]


def jobs(scale: Scale) -> list[Job]:
    """Return one job a winding."""
    return [
        job
        for choice, value in values(scale)
        for method in ("qp", *(("closed form",) if choice not in QP_ONLY else ()))
        for job in windings(scale, method, choice, value)
    ]


def build(scale: Scale, results: Results) -> Table:
    """Return the table."""
    rows = []
    for choice, value in values(scale):
        qp = [results[job] for job in windings(scale, "qp", choice, value)]
        free = [] if choice in QP_ONLY else [results[job] for job in windings(scale, "closed form", choice, value)]
        rows.append((choice, value, *_qp_cells(qp), *(_closed_form_cells(free) if free else (None,) * 5)))
    count = len(windings(scale, "qp", *values(scale)[0]))
    return Table(COLUMNS, tuple(rows), f"{count} {'winding' if count == 1 else 'windings'} a row and method.")


def _qp_cells(figures: list[dict[str, Any]]) -> tuple[Cell, ...]:
    turns, penetration, *wound = _closed_form_cells(figures)
    bend, drift = (max(f[key] for f in figures) for key in ("bend", "drift"))
    return turns, penetration, bend, 1e3 * drift, max(f["steps"] for f in figures), *wound


def _closed_form_cells(figures: list[dict[str, Any]]) -> tuple[Cell, ...]:
    return (
        min(f["turns_ratio"] for f in figures),
        1e3 * max(f["penetration"] for f in figures),
        *counted(figures),
    )


ARTEFACT = Artefact("sensitivity", "Sensitivity to what the paper does not state", CAPTION, jobs, build)
