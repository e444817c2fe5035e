"""What the paper leaves open, one row each, by how much the choice made in its place changes a winding."""

from typing import Any, NamedTuple

from paper_repro.artefacts.facts import known_facts
from paper_repro.artefacts.sensitivity import base, jobs, methods, values, windings
from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.jobs import Results
from paper_repro.make.table import NOTHING, Cell, Column, Table
from paper_repro.measure.windings import METHOD_NAMES, METHODS, is_turned

#: By the id of what is open: the choices of the table of sensitivity that stand for it.
TRIED: dict[str, tuple[str, ...]] = {
    "initial pose": ("initial pose",),
    "hinge order": ("order of a ball's hinges",),
    "link thickness": ("link radius [mm]",),
    "joint range": ("joint range [rad]",),
    "step limit": ("largest step of a joint [rad]",),
    "contact rows": ("share of a gap closed in a step [–]",),
    "first link in contact": ("first link k", "gap at the start [mm]"),
    "tilt": ("tilt of the object [rad]",),
    "length of the cylinder": ("length of the object [m]",),
    "time step": ("time step [ms]",),
    "contact test": ("contact / release distance [mm]",),
    "dead band": ("dead band of Eq. 21 [–]",),
    "rank tolerance": ("rank tolerance of Eq. 6 [–]",),
}

#: What is not tried there: why, or where else it is.
ELSEWHERE = {
    "axis of joint 49": "Table 2 has the rank of J for each",
    "joint kinds": "another arm; Table 12 has one with a ball at every link",
    "meaning of the directions": "a matter of names",
    "unit of eta": "η counts times the time step, which is tried",
    "sense of c": "reversed, the plan turns links away from the object",
    "end of an episode": "several times what windings take",
    "constrained solve": "Tables 8 and 9 have the arm with limits and without",
}

COLUMNS = (
    Column("open", "what the paper leaves open", width="4cm"),
    Column("choice", "choice", width="3cm"),
    Column("values", "values", width="4cm"),
    Column("matters", "does it matter"),
    *(
        column
        for method in METHODS
        for column in (
            Column(f"{method.replace(' ', '_')}_changed", f"{METHOD_NAMES[method]}: windings won or lost, most of a value"),
            Column(f"{method.replace(' ', '_')}_turns", f"{METHOD_NAMES[method]}: turns / ideal, least … most"),
            Column(f"{method.replace(' ', '_')}_steps", f"{METHOD_NAMES[method]}: steps, least … most"),
        )
    ),
    Column("elsewhere", "not tried, because", width="4cm"),
)

CAPTION = """\
Every choice that has to be made before the paper's simulation can be run (see the table of choices), by how much it
matters. A choice *decides* where another value than the default wins or loses at least half of a method's windings, by
turns and depth; it *matters* where it wins or loses any; it matters *little* where it changes figures but no winding.
Windings are those of the table of sensitivity, which has each value's figures: by the closed form, from the straight
pose and a first link from where it winds, and by the QP, from a random pose and further. What decides stands first.

It does *not* say how the paper chose; nor what two choices changed together do: the rank tolerance, which matters little
here, decides for the closed form around tilted objects and from bent poses (closed-form map).
"""


class Effect(NamedTuple):
    """What the values of a choice do to one method's windings."""

    windings: int  # a value
    changed: int  # windings that are wound by turns and depth with the default and not with a value, or the other way
    turns: str
    steps: str


def effect(scale: Scale, results: Results, method: str, choice: str) -> Effect:
    """Return what the values of a choice do to the windings of a method."""
    default = [is_turned(results[job]) for job in base(scale, method)]
    changed, turns, steps = 0, [], []
    for value in (value for name, value in values(scale) if name == choice):
        found = [results[job] for job in windings(scale, method, choice, value)]
        changed = max(changed, sum(is_turned(f) != was for f, was in zip(found, default, strict=True)))
        turns += [figures["turns_ratio"] for figures in found]
        steps += [figures["steps"] for figures in found]
    return Effect(len(default), changed, f"{min(turns):.2f} … {max(turns):.2f}", f"{min(steps)} … {max(steps)}")


def matters(effects: list[Effect]) -> str:
    """Return the word for what a choice does."""
    if any(2 * each.changed >= each.windings for each in effects):
        return "decides"
    return "matters" if any(each.changed for each in effects) else "little"


def build(scale: Scale, results: Results) -> Table:
    """Return the table; of the reduced run what was tried there, and what is not tried."""
    tried: list[tuple[int, tuple[Cell, ...]]] = []
    rest: list[tuple[Cell, ...]] = []
    available = {choice for choice, _ in values(scale)}
    for fact in (fact for fact in known_facts() if not fact.is_stated):
        if fact.id in ELSEWHERE:
            rest.append((fact.says, NOTHING, NOTHING, NOTHING, *(None,) * 3 * len(METHODS), ELSEWHERE[fact.id]))
        for choice in (choice for choice in TRIED.get(fact.id, ()) if choice in available):
            effects = {method: effect(scale, results, method, choice) for method in methods(choice)}
            word = matters(list(effects.values()))
            names = "; ".join(value for name, value in values(scale) if name == choice)
            cells = [cell for method in METHODS for cell in _cells(effects.get(method))]
            order = -sum(each.changed for each in effects.values())
            tried.append((order, (fact.says, choice, names, word, *cells, NOTHING)))
    tried.sort(key=lambda row: row[0])
    return Table(COLUMNS, (*(cells for _, cells in tried), *rest))


def _cells(found: Effect | None) -> tuple[Any, ...]:
    return (None, None, None) if found is None else (f"{found.changed} of {found.windings}", found.turns, found.steps)


ARTEFACT = Artefact("leaves-open", "What the paper leaves open, and how much it matters", CAPTION, jobs, build)
