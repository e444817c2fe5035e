"""What the paper states, and whether we agree: `facts.toml` held against the checks."""

import dataclasses
import importlib
import tomllib
from dataclasses import dataclass
from enum import Enum
from functools import cache
from importlib.resources import files
from typing import Any

from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.jobs import Results
from paper_repro.make.table import Column, Table
from paper_repro.measure.checks import STATIC, WOUND, Ours, run_checks
from paper_repro.measure.checks import jobs as jobs
from paper_repro.measure.windings import CRITERION

SAME = 1e-9  # relative; figures of the paper have three digits, and ours of a model lose a few to rounding


class Verdict(Enum):
    """How our figure stands to the paper's."""

    AGREES = "agrees"
    DIFFERS = "differs"
    NOT_STATED = "not stated"


@dataclass(frozen=True)
class Fact:
    """An entry of `facts.toml`, which explains its fields."""

    id: str
    says: str
    where: str
    value: Any = None
    unit: str = ""
    reason: str = ""
    set_at: tuple[tuple[str, str], ...] = ()
    why: str = ""

    @property
    def is_stated(self) -> bool:
        """Whether the paper states it."""
        return self.value is not None


@dataclass(frozen=True)
class Finding:
    """A fact and what we have in its place."""

    fact: Fact
    verdict: Verdict
    ours: str

    @property
    def unexpected(self) -> bool:
        """Whether we differ for no reason that is known."""
        return self.verdict is Verdict.DIFFERS and not self.fact.reason


@cache
def known_facts() -> tuple[Fact, ...]:
    """Return the facts of `facts.toml`, each with a check or a place to read our figure at.

    Raises:
        ValueError: a fact without either, a check without a fact, or an id used twice.
    """
    text = files("paper_repro.artefacts").joinpath("facts.toml").read_text(encoding="utf-8")
    return parse(text)


def parse(text: str) -> tuple[Fact, ...]:
    """Return the facts of a TOML text: see `known_facts`."""
    entries = tomllib.loads(text)["fact"]
    facts = tuple(Fact(**{**entry, "set_at": tuple(entry.get("set_at", {}).items())}) for entry in entries)
    checked = [*STATIC, *WOUND]
    ids = [fact.id for fact in facts]
    needing = {fact.id for fact in facts if fact.is_stated or not fact.set_at}
    for what, names in (
        ("ids used twice", {name for name in ids if ids.count(name) > 1}),
        ("facts without a check", needing - set(checked)),
        ("checks without a fact", set(checked) - needing),
    ):
        if names:
            raise ValueError(f"{what}: {', '.join(sorted(names))}")
    return facts


def findings(scale: Scale, results: Results) -> list[Finding]:
    """Return what the checks find, fact by fact."""
    ours = run_checks(scale, results)
    return [finding(fact, ours.get(fact.id)) for fact in known_facts()]


def finding(fact: Fact, ours: Ours | None) -> Finding:
    """Return the verdict on one fact, given what its check found."""
    if not fact.is_stated:
        return Finding(fact, Verdict.NOT_STATED, ours.figure if ours else choices_of(fact))
    if ours is None:
        raise ValueError(f"no check found anything on {fact.id!r}.")
    verdict = Verdict.AGREES if same(fact.value, ours.value) else Verdict.DIFFERS
    if isinstance(ours.value, bool):
        return Finding(fact, verdict, ours.figure)
    return Finding(fact, verdict, "; ".join(filter(None, (with_unit(ours.value, fact.unit), ours.figure))))


def same(stated: Any, found: Any) -> bool:
    """Return whether two values are the same but for rounding. A word is no number, and a claim neither."""
    if isinstance(stated, list):
        return isinstance(found, list) and len(found) == len(stated) and all(map(same, stated, found))
    if isinstance(stated, bool | str) or isinstance(found, bool | str):
        return type(stated) is type(found) and stated == found
    return found is not None and abs(found - stated) <= SAME * abs(stated)


def with_unit(value: Any, unit: str) -> str:
    """Return a value for people."""
    match value:
        case bool():
            return "yes" if value else "no"
        case None:
            text = "none"
        case float() | int():
            text = f"{value:g}"
        case list() | tuple():
            text = ", ".join(with_unit(item, "") for item in value) or "none"
        case _:
            text = str(value)
    return f"{text} {unit}".rstrip()


def choices_of(fact: Fact) -> str:
    """Return our choices for what is not stated, as the code has them now."""
    return "; ".join(f"{path.rpartition('.')[2]} {with_unit(read(path), unit)}" for path, unit in fact.set_at)


def read(path: str) -> Any:
    """Return what stands in the library at a dotted path: a constant, or the default of a class's field."""
    parts = path.split(".")
    place = next(i for i, part in enumerate(parts) if part != part.lower())  # modules are in lower case
    found: Any = importlib.import_module(".".join(["prioritized_ik", *parts[:place]]))
    for part in parts[place:]:
        found = _default(found, part)
    return found


def _default(owner: Any, name: str) -> Any:
    """Return what `owner` has under a name; of a class also the default that it makes anew for each of its objects."""
    fields = dataclasses.fields(owner) if isinstance(owner, type) and dataclasses.is_dataclass(owner) else ()
    for field in fields:
        if field.name == name and field.default_factory is not dataclasses.MISSING:
            return field.default_factory()
    return getattr(owner, name)


def table(found: list[Finding]) -> Table:
    """Return findings as a table: what differs, what agrees and what is not stated, in the paper's order."""
    counts = {verdict: sum(finding.verdict is verdict for finding in found) for verdict in Verdict}
    notes = [", ".join(f"{verdict.value}: {count}" for verdict, count in counts.items()) + "."]
    notes += [
        f"- *{finding.fact.id}* differs: {finding.fact.reason or 'no reason is known'}."
        for finding in found
        if finding.verdict is Verdict.DIFFERS
    ]
    columns = (
        Column("verdict", "verdict"),
        Column("statement", "the paper", width="5cm"),
        Column("where", "where", width="2.2cm"),
        Column("says", "says"),
        Column("ours", "ours", width="5cm"),
    )
    rows = tuple((f.verdict.value, f.fact.says, f.fact.where, _says(f.fact), f.ours) for f in found)
    return Table(columns, rows, "\n".join([notes[0], "", *notes[1:]]).rstrip())


def _says(fact: Fact) -> str:
    if not fact.is_stated:
        return "–"
    return "so" if fact.value is True else with_unit(fact.value, fact.unit)


def build(scale: Scale, results: Results) -> Table:
    """Return all findings."""
    return table(findings(scale, results))


ARTEFACT = Artefact(
    "facts",
    "What the paper states, and whether we agree",
    f"""\
Each statement of the paper that can be checked, where it stands, and our figure: counted on the model, computed, or
measured on windings with the default settings, from every direction, with the weights of Eqs. 23 and 24, by the
closed form (Eqs. 12 to 14 alone) and by the QP with joint limits and contact rows. *So* marks a claim, which holds or
does not. *Not stated* is what one has to know to run the simulation and will not find in the paper; our figure is
then a choice of ours.

A statement that differs has its reason below the table; `prioritized-ik paper check` prints the same table and fails
if one differs without. {CRITERION}. The claims that the arm winds by Eqs. 12 and 14 are judged by turns and depth, on a
winding of less than a turn; a longer one stands beside it. What agrees is the statement, in our poses; nothing here
compares with the poses of Figs. 6 and 7, which are not published.""",
    jobs,
    build,
)
