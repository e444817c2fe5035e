"""Table 13: winding by joint torques, by the paper's two approaches, against the kinematic windings."""

from typing import Any, NamedTuple

from paper_repro.artefacts.table_8_windings import WEIGHT_NAMES
from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.jobs import Job, Results
from paper_repro.make.table import Cell, Column, Table
from paper_repro.measure.torques import (
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
    torque_job,
)
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

JOINT, TASK = APPROACHES


class Row(NamedTuple):
    """Windings of one kind: by an approach of `APPROACHES`, or kinematic by a method of `METHODS`; `tilt` is in rad."""

    control: str
    link: int
    weights: str = "eq23"
    tilt: float = 0.0


ROWS = (
    *(Row(control, link) for control in APPROACHES for link in (SHORT, LONG)),
    Row(TASK, LONG, tilt=0.3),
    Row(TASK, LONG, weights="eq24"),
    *(Row(method, link) for method in METHODS for link in (SHORT, LONG)),
)

#: Directions by first link. From straight, those from below and behind mirror those from above and in front.
SIDES = {SHORT: ("up", "down", "front", "back"), LONG: ("up", "front")}
QUICK_LINK = 15

COLUMNS = (
    Column("control", "control", width="4.2cm"),
    Column("first_link", "first link"),
    Column("weights", "weights"),
    Column("tilt_rad", "tilt [rad]", ".1f"),
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
around the cylinder. *Task space*, the second approach (ref. 6): F_v = K_v (dX_v* - dX_v) - D v and τ =
Jᵀ F_v, with the weights as stiffnesses, K_v = {STIFFNESS:g} N/m times W, D = {RELAXATION:g} s times K_v, springs
stretched by at most {1e3 * STRETCH:g} mm. *Joint space*, the first: the dθ* of Eqs. 12 and 14 moves desired joint
positions, and τ = {JOINT_STIFFNESS:g} N m/rad (θ* - θ) - {DERIVATIVE:g} N m s/rad dθ/dt. Links of {DENSITY:g} kg/m³,
{ARMATURE:g} kg m² a drive and {JOINT_DAMPING:g} N m s/rad a joint; η = {SPEED:g} m/s, {1e3 * TIME_STEP:g} ms a step,
given up after {LONGEST:g} s. Masses and gains are choices: the paper states none. Below, the kinematic windings with
the default settings, which have no forces.

{CRITERION}. Depth is limited here by MuJoCo's contacts, not by the control.

**To see:** with the weights of Eq. 23 the second approach winds a short way and a long one, straight and tilted, and
within a joint's range, where the first folds: it does not ask the free tail to stay, which is held by springs of 0.01
N/m, its inertia and the joints' friction, and is drawn along. With those of Eq. 24, springs of 1 N/m, the tail stays,
and folds as by the first. In joint space the dynamic arm does what the kinematic one does: it winds from link {SHORT}
on, and from {LONG} on it meets its own tail behind the object, now with forces. Contact is felt at 2 mm, where a link
stops being driven: a force of 0 says that it came to rest there. This does *not*
show other gains; holding, lifting and gravity are in Table 14.
"""


def cases(scale: Scale) -> tuple[Row, ...]:
    """Return the rows; of the reduced run short windings alone."""
    return tuple(Row(control, QUICK_LINK) for control in (*APPROACHES, *METHODS)) if scale.quick else ROWS


def group(scale: Scale, row: Row) -> list[Job]:
    """Return the windings of one row."""
    sides = scale.directions[:1] if scale.quick else SIDES[row.link]
    changes: dict[str, Any] = {"link": row.link, "weights": row.weights, "tilt": row.tilt}
    if row.control in APPROACHES:
        return [torque_job(row.control, direction=direction, **changes) for direction in sides]
    return [measured_job(settings(row.control, direction=direction, **changes)) for direction in sides]


def jobs(scale: Scale) -> list[Job]:
    """Return one job a winding."""
    return [job for row in cases(scale) for job in group(scale, row)]


def build(scale: Scale, results: Results) -> Table:
    """Return the table."""
    rows = []
    for row in cases(scale):
        windings = [results[job] for job in group(scale, row)]
        name = row.control if row.control in APPROACHES else f"kinematic, {METHOD_NAMES[row.control]}"
        head = (name, row.link, WEIGHT_NAMES[row.weights], row.tilt, len(windings))
        rows.append((*head, *counted(windings), *_cells(windings)))
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
