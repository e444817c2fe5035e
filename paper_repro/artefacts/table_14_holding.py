"""Table 14: the wound object let go, lifted and shaken, by three controls; and what it takes to hold it."""

from typing import Any

from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.jobs import Job, Results
from paper_repro.make.table import Cell, Column, Table
from paper_repro.measure.hold_trials import CONTROLS, HIERARCHY, held
from paper_repro.measure.holding import (
    AMPLITUDE,
    FIRST_LINK,
    FREQUENCY,
    FRICTION,
    GRIP,
    HEIGHT,
    JOINT_SPACE,
    LIFT,
    MASS,
    OBJECTS,
    PRESS,
    PRESS_DEPTH,
    SHAKE,
    SLIPPED,
    TASK_SPACE,
    TORQUE_LIMIT,
)
from paper_repro.measure.torque_hierarchy import COUNTED, LEAST, MOST

COLUMNS = (
    Column("object", "object", width="2cm"),
    Column("direction", "object from"),
    Column("control", "control", width="2.6cm"),
    Column("held_weightless", "held, weightless"),
    Column("slip_weightless_mm", "slip, weightless [mm]", ".1f"),
    Column("held", "held"),
    Column("seconds", "time until it slipped [s]", ".1f"),
    Column("slip_mm", "slip [mm]", ".1f"),
    Column("roll_rad", "roll of a link, most [rad]", ".2f"),
    Column("torque_nm", "torque of a joint, largest [N m]", ".1f"),
    Column("contact_force_n", "contact force, largest [N]", ".1f"),
    Column("squeeze_n", "all contact forces, median [N]", ".1f"),
    Column("work_j", "work of the joints [J]", ".1f"),
    Column("friction", "friction coefficient: fails / holds"),
    Column("torque_limit", "torque limit [N m]: fails / holds"),
)

CAPTION = f"""\
The arm winds around the fixed object from link {FIRST_LINK} on, 0.8 of a turn around the cylinder, by the paper's second
approach (Table 13). Then the object, of {MASS:g} kg, is free. The arm grips for {GRIP:g} s, in which gravity comes on; its
base, on a carriage, rises by {1e3 * HEIGHT:g} mm in {LIFT:g} s and is shaken up and down, at {FREQUENCY:g} Hz by
±{1e3 * AMPLITUDE:g} mm, for {SHAKE:g} s. An object from above or below is wound around a level axis, one from the front or
from behind around an upright one, along which nothing but friction carries it.

*{JOINT_SPACE.capitalize()}*: joints are drawn to θ + dθ*, with dθ* of Eqs. 12 and 14 for dX* = {1e3 * PRESS_DEPTH:g} mm
into the object at every wound link. *{TASK_SPACE.capitalize()}*: the ends of links are held by the springs and dampers of
Table 13 where they were, and each wound one presses the object with {PRESS:g} N; τ = Jᵀ F_v. Gains are those of Table 13;
neither knows gravity or the object's mass. *{HIERARCHY.capitalize()}*: limits of contact forces ({LEAST:g} to {MOST:g} N a
link, {COUNTED:g} of the friction coefficient {FRICTION:g}) before the hold (the object's weight, then the links' ends)
before the posture, every 10 ms one certified solve of this library; it is told the object's mass and what an
accelerometer at the base feels.

*Held*: marks on wound links and on the object, together when it was let go, come apart by no more than
{1e3 * SLIPPED:g} mm, median of the wound links, at any time; *slip* is how far they are at the end. Friction coefficient
{FRICTION:g}, torque limit {TORQUE_LIMIT:g} N m but for the last two columns, which change one of them and bracket where it
fails; *weightless* is the same without gravity. Half-sizes are
{"; ".join(f"{name}: {' × '.join(f'{1e3 * half:g}' for half in size)} mm" for name, (_, size) in OBJECTS.items())}.
"""

TO_SEE = """
**To see:** around a level axis an object is caged, and friction of 0.05 to 0.4 is enough where it is held at all. Along an
upright axis friction has to carry it, and there both approaches of the paper fall short, for different reasons. The second
presses well, but links are round and their ends lie on their axes, so that virtual arms do not feel a link roll about
itself (what J does not feel, at least 15 directions, is nothing else): the cylinder and the ellipsoid sink as on rollers,
by up to 2.7 rad, whatever the friction. The first hardly presses: dX* into the object is more than joints can do, and
Eq. 12 spreads what they cannot over all links. The hierarchy holds all twelve, with 0.4 to 0.7 of the second approach's
squeeze and at most 0.4 of its work: the posture, in what the hold leaves, keeps links from rolling. No contact force
exceeded its limit. Still objects creep, by up to 0.7 mm in a second of shaking. A torque limit of 5 to 6 N m is what the
arm, held out level, needs at its base for itself and the object, not for the grip; the first approach gets by with less
where it may sag. Trials from the front and from behind are mirror images.

This does *not* show other gains, a grip by other wishes, links with flat or soft sides, or arms that touch themselves.
"""


def trials(scale: Scale) -> list[tuple[str, str]]:
    """Return object and direction of every trial; one in the reduced run."""
    directions = scale.directions[:1] if scale.quick else scale.directions
    return [(wound, direction) for wound in (list(OBJECTS)[:1] if scale.quick else OBJECTS) for direction in directions]


def held_job(scale: Scale, wound: str, direction: str, control: str) -> Job:
    """Return the job of one row: see `held`."""
    return Job(held, {"wound": wound, "direction": direction, "control": control, "sought": not scale.quick})


def jobs(scale: Scale) -> list[Job]:
    """Return one job a row."""
    return [held_job(scale, *trial, control) for trial in trials(scale) for control in CONTROLS]


def build(scale: Scale, results: Results) -> Table:
    """Return the table."""
    rows = []
    for wound, direction in trials(scale):
        for control in CONTROLS:
            found = results[held_job(scale, wound, direction, control)]
            rows.append((wound, direction, control, *_cells(found)))
    return Table(COLUMNS, tuple(rows), _notes(scale, results))


def _cells(found: dict[str, Any]) -> tuple[Cell, ...]:
    return (
        found["weightless"]["held"],
        1e3 * found["weightless"]["slip"],
        found["held"],
        None if found["held"] else found["seconds"],
        1e3 * found["slip"],
        found["roll"],
        found["torque"],
        found["contact_force"],
        found["squeeze"],
        found["work"],
        _ends(found["friction"]),
        _ends(found["torque_limit"]),
    )


def _ends(bracket: list[float | None]) -> str:
    low, high = bracket
    if low is None and high is None:
        return "–"
    return " / ".join("none" if end is None else f"{end:g}" for end in bracket)


def _notes(scale: Scale, results: Results) -> str:
    """Return how many each control holds, and how the hierarchy's solves went."""
    every = {c: [results[held_job(scale, *trial, c)] for trial in trials(scale)] for c in CONTROLS}
    counts = ", ".join(
        f"{control} {sum(f['held'] for f in found)} (weightless {sum(f['weightless']['held'] for f in found)})"
        for control, found in every.items()
    )
    solved = [each for found in every[HIERARCHY] for each in (found, found["weightless"])]
    steps, uncertified = (sum(each[key] for each in solved) for key in ("steps", "uncertified"))
    return (
        f"Held, of {len(trials(scale))} each: {counts}. The hierarchy in {len(solved)} trials solved {steps} problems, "
        f"{steps - uncertified} of them certified."
    )


ARTEFACT = Artefact("table-14", "Table 14: hold, lift and shake what was wound", f"{CAPTION}{TO_SEE}", jobs, build)
