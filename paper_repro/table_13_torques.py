"""Table 13: winding by joint torques, by the paper's two approaches, against the kinematic windings."""

from typing import Any

from paper_repro.artefact import Artefact, Scale
from paper_repro.jobs import Job, Results
from paper_repro.table import Cell, Column, Table
from paper_repro.torques import (
    APPROACHES,
    ARMATURE,
    DENSITY,
    DERIVATIVE,
    JOINT_DAMPING,
    JOINT_STIFFNESS,
    LONGEST,
    RELAXATION,
    SPEED,
    STIFFNESS,
    STRETCH,
    TIME_STEP,
    wind_by_torques,
)
from paper_repro.windings import CRITERION, LONG, METHOD_NAMES, METHODS, SHORT, TERM_TITLES, counted, measured_job, settings
from prioritized_ik.winding.controller import Equilibrium
from prioritized_ik.winding.episode import Outcome

#: Directions by first link. From straight, those from below and behind mirror those from above and in front.
SIDES = {SHORT: ("up", "down", "front", "back"), LONG: ("up", "front")}
QUICK_LINK = 15

COLUMNS = (
    Column("control", "control", width="4.2cm"),
    Column("first_link", "first link"),
    Column("windings", "windings"),
    Column("in_contact", TERM_TITLES[0]),
    Column("turned", TERM_TITLES[1]),
    Column("within_range", TERM_TITLES[2]),
    Column("turns_ratio", "turns / ideal, least", ".2f"),
    Column("penetration_mm", "penetration, worst [mm]", ".1f"),
    Column("fold_rad", "fold, worst [rad]", ".2f"),
    Column("seconds", "time, longest [s]", ".1f"),
    Column("torque_nm", "torque of a joint, largest [N m]", ".2f"),
    Column("contact_force_n", "contact force, largest [N]", ".2f"),
    Column("work_j", "work of the joints, most [J]", ".2f"),
)

CAPTION = f"""\
The two approaches of the paper's Fig. 2 as control of a dynamic arm, in MuJoCo, without gravity, from the straight pose
around the untilted cylinder, Eq. 23. *Task space*, the second approach (ref. 6): F_v = K_v (dX_v* - dX_v) - D v and τ =
Jᵀ F_v, with the weights as stiffnesses, K_v = {STIFFNESS:g} N/m times W, D = {RELAXATION:g} s times K_v, springs
stretched by at most {1e3 * STRETCH:g} mm. *Joint space*, the first: the dθ* of Eqs. 12 and 14 moves desired joint
positions, and τ = {JOINT_STIFFNESS:g} N m/rad (θ* - θ) - {DERIVATIVE:g} N m s/rad dθ/dt. Links of {DENSITY:g} kg/m³,
{ARMATURE:g} kg m² a drive and {JOINT_DAMPING:g} N m s/rad a joint; η = {SPEED:g} m/s, {1e3 * TIME_STEP:g} ms a step,
given up after {LONGEST:g} s. Masses and gains are choices: the paper states none. Below, the kinematic windings with
the default settings, which have no forces.

{CRITERION}. Depth is limited here by MuJoCo's contacts, not by the control.

**To see:** the second approach winds both times, and within a joint's range, where the first folds: it does not ask the
free tail to stay, which is held by a spring of 0.01 N/m, its inertia and the joints' friction, and is drawn along. In
joint space the dynamic arm does what the kinematic one does, folds included: it winds from link {SHORT} on, and from
{LONG} on meets its own tail behind the object, now with forces. Contact is felt at 2 mm, where a link stops being
driven: a force of 0 says that it came to rest there. This does *not* show holding, lifting, gravity, or other gains.
"""


def links(scale: Scale) -> dict[int, tuple[str, ...]]:
    """Return the directions by first link; a short winding in the reduced run."""
    return {QUICK_LINK: scale.directions[:1]} if scale.quick else SIDES


def torque_job(approach: str, link: int, direction: str) -> Job:
    """Return the job of one winding: see `wound`."""
    return Job(wound, {"approach": approach, "link": link, "direction": direction})


def wound(approach: str, link: int, direction: str) -> dict[str, Any]:
    """Return the fields of `TorqueWinding`, with the name of an `Outcome` for its equilibrium."""
    found = wind_by_torques(approach, link=link, direction=direction)
    outcome = {Equilibrium.WINDING: Outcome.WOUND, Equilibrium.FREE: Outcome.LOST, None: Outcome.OUT_OF_STEPS}
    figures = {**vars(found), "outcome": outcome[found.equilibrium].name}
    del figures["equilibrium"]
    return figures


def group(scale: Scale, control: str, link: int) -> list[Job]:
    """Return the windings of one row: by an approach of `APPROACHES`, or kinematic by a method of `METHODS`."""
    sides = links(scale)[link]
    if control in APPROACHES:
        return [torque_job(control, link, direction) for direction in sides]
    return [measured_job(settings(control, link=link, direction=direction)) for direction in sides]


def cases(scale: Scale) -> list[tuple[str, int]]:
    """Return control and first link of each row."""
    return [(control, link) for control in (*APPROACHES, *METHODS) for link in links(scale)]


def jobs(scale: Scale) -> list[Job]:
    """Return one job a winding."""
    return [job for case in cases(scale) for job in group(scale, *case)]


def build(scale: Scale, results: Results) -> Table:
    """Return the table."""
    rows = []
    for control, link in cases(scale):
        windings = [results[job] for job in group(scale, control, link)]
        name = control if control in APPROACHES else f"kinematic, {METHOD_NAMES[control]}"
        rows.append((name, link, len(windings), *counted(windings), *_cells(windings)))
    return Table(COLUMNS, tuple(rows))


def _cells(windings: list[dict[str, Any]]) -> tuple[Cell, ...]:
    dynamic = (max(figures[key] for figures in windings) for key in ("seconds", "torque", "contact_force", "work"))
    return (
        min(figures["turns_ratio"] for figures in windings),
        1e3 * max(figures["penetration"] for figures in windings),
        max(figures["bend"] for figures in windings),
        *(dynamic if "torque" in windings[0] else (None,) * 4),
    )


ARTEFACT = Artefact("table-13", "Table 13: winding by joint torques, the two approaches", CAPTION, jobs, build)
