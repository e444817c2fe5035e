"""Sensitivity: what each choice that the paper does not state changes in a winding."""

from typing import Any

from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.jobs import Job, Results
from paper_repro.make.table import Cell, Column, Table
from paper_repro.measure.windings import CRITERION, LONG, METHODS, SHORT, TERM_TITLES, counted, measured_job, settings
from prioritized_ik.models import Arm
from prioritized_ik.solvers.lexicographic import SolveOptions

#: What each method changes from the default settings, so that it winds. Straight windings from opposite sides mirror each
#: other, so that half of them would say nothing of the QP; the closed form winds from straight, and not so far.
BASES: dict[str, dict[str, Any]] = {"qp": {"posture": "random", "seed": 0}, "closed form": {"link": SHORT}}


def _arm(**changes: float | str) -> dict[str, Any]:
    return {"arm": Arm(**changes)}  # type: ignore[arg-type]


def _thresholds(contact: float, release: float) -> dict[str, Any]:
    return {"contact_distance": contact, "release_distance": release}


def _rank_cut(tolerance: float) -> dict[str, Any]:
    return {"options": SolveOptions(rank_tolerance=tolerance)}


#: Choice, value as text, and what it changes from `BASES`; where nothing, that is the default.
CHOICES: dict[str, dict[str, dict[str, Any]]] = {
    "initial pose": {
        "random, seed 0": {"posture": "random", "seed": 0},
        "random, seed 1": {"posture": "random", "seed": 1},
        "straight": {"posture": "straight", "seed": 0},
        "arched": {"posture": "arched", "seed": 0},
    },
    "order of a ball's hinges": {"zyx": {}, "xyz": _arm(hinge_order="xyz"), "yzx": _arm(hinge_order="yzx")},
    "link radius [mm]": {"10": {}, "5": _arm(radius=5e-3), "15": _arm(radius=15e-3)},
    "contact / release distance [mm]": {
        "2 / 4": {},
        "2 / 2 (no hysteresis)": _thresholds(2e-3, 2e-3),
        "1.5 / 3": _thresholds(1.5e-3, 3e-3),
        "3 / 6": _thresholds(3e-3, 6e-3),
        "4 / 8": _thresholds(4e-3, 8e-3),
    },
    "gap at the start [mm]": {"1": {}, "0": {"gap": 0.0}, "1.9": {"gap": 1.9e-3}},
    "time step [ms]": {"2": {}, "1": {"dt": 1e-3}, "4": {"dt": 4e-3}},
    "dead band of Eq. 21 [–]": {"0.05": {}, "0": {"dead_band": 0.0}, "0.1": {"dead_band": 0.1}},
    "rank tolerance of Eq. 6 [–]": {"1e-4": {}, "1e-6": _rank_cut(1e-6), "1e-3": _rank_cut(1e-3)},
    "joint range [rad]": {
        "±1.0": {},
        "±0.6": _arm(joint_range=0.6),
        "±0.8": _arm(joint_range=0.8),
        "±1.5": _arm(joint_range=1.5),
    },
    "largest step of a joint [rad]": {"0.1": {}, "0.05": {"max_step": 0.05}, "0.3": {"max_step": 0.3}},
    "share of a gap closed in a step [–]": {"0.5": {}, "0.25": {"contact_gain": 0.25}, "1": {"contact_gain": 1.0}},
    "first link k": {"6": {"link": 6}, "9": {"link": 9}, "12": {"link": 12}},
    "tilt of the object [rad]": {"0": {}, "0.3": {"tilt": 0.3}},
    "length of the object [m]": {"1": {}, "0.2": {"size": (0.07, 0.1)}},
}

UNCHANGED = "time step [ms]"  # a choice whose first value is the default of both methods
QUICK_CHOICES = ("link radius [mm]", UNCHANGED)

COUNTS = ("in_contact", "turned", "within_range")

#: What the closed form does not know.
QP_ONLY = ("joint range [rad]", "largest step of a joint [rad]", "share of a gap closed in a step [–]")

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
Choices that the paper leaves open, changed one at a time: by the QP with limits and contact rows, from a random pose and
first link {LONG}, and by the closed form, from the straight pose and first link {SHORT}, from where it winds (`–` where the
choice does not concern it). Figures are the worst over windings from all directions with Eq. 23; the last columns of
each count windings.

{CRITERION}.

Neither method bears a step η·dt of 8 mm, no dead band in Eq. 21, or contact reported from 4 mm away: links then count as
wound before they lie against the object, or β turns them back and forth, and the next ones start from there. The QP also
wants its largest step and its joint range small: with 0.3 rad a step contact rows, linear in dθ, let links in. The
closed form loses windings by the pose, the tilt and the first link (see the closed-form map, where the rank tolerance
decides around tilted objects and from bent poses), and without hysteresis. The order of hinges, the link radius, the gap at
the start and the object's length change neither. This does *not* show what two choices changed together do, nor other
random poses: see Table 8 for those.
"""


def values(scale: Scale) -> list[tuple[str, str]]:
    """Return choice and value of each row; the reduced run has two values of some choices."""
    if scale.quick:
        return [(choice, value) for choice in QUICK_CHOICES for value in list(CHOICES[choice])[:2]]
    return [(choice, value) for choice, entries in CHOICES.items() for value in entries]


def windings(scale: Scale, method: str, choice: str, value: str) -> list[Job]:
    """Return the windings of one row by one method, from one direction in the reduced run."""
    directions = scale.directions[:1] if scale.quick else scale.directions
    return [
        measured_job(settings(method, direction=direction, **{**BASES[method], **CHOICES[choice][value]}))
        for direction in directions
    ]


def base(scale: Scale, method: str) -> list[Job]:
    """Return the windings of a method with every default."""
    return windings(scale, method, UNCHANGED, next(iter(CHOICES[UNCHANGED])))


def methods(choice: str) -> tuple[str, ...]:
    """Return the methods that a choice concerns."""
    return ("qp",) if choice in QP_ONLY else METHODS


def jobs(scale: Scale) -> list[Job]:
    """Return one job a winding."""
    rows = [(method, *row) for row in values(scale) for method in methods(row[0])]
    return [job for row in rows for job in windings(scale, *row)]


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
