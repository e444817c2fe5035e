"""Everything that the paper does not state, and what stands in its place here."""

from paper_repro.artefacts.facts import Finding, finding, known_facts
from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.jobs import Job, Results
from paper_repro.make.table import Column, Table
from paper_repro.measure.checks import Ours, run_static


def jobs(scale: Scale) -> list[Job]:
    """Return the checks that read choices off the model."""
    del scale
    return [Job(run_static)]


def build(scale: Scale, results: Results) -> Table:
    """Return the choices."""
    del scale
    ours = {name: Ours(**given) for name, given in results[Job(run_static)].items()}
    found = [finding(fact, ours.get(fact.id)) for fact in known_facts() if not fact.is_stated]
    columns = (
        Column("open", "what the paper leaves open", width="4.5cm"),
        Column("where", "where it would be", width="2.4cm"),
        Column("choice", "chosen here", width="4.5cm"),
        Column("set_at", "set at", width="4cm"),
        Column("why", "why", width="5cm"),
    )
    return Table(columns, tuple(_cells(each) for each in found))


def _cells(found: Finding) -> tuple[str, ...]:
    fact = found.fact
    places = ", ".join(f"`{'.'.join(path.split('.')[-2:])}`" for path, _ in fact.set_at)
    return fact.says, fact.where, found.ours, places or "–", fact.why


ARTEFACT = Artefact(
    "choices",
    "Choices: what the paper does not state",
    """\
What one has to decide before the paper's simulation can be run, because the paper does not say: the value chosen
here, read from the code's defaults when this table was made, where it is set, and why it was chosen. – under *set
at*: it is in the model's making. Every other result of this report rests on these choices, and none of them is the
paper's; the table before this one says how much each of them matters. Anything in this table can be set on the Python
side; most by the options of `prioritized-ik wind`.""",
    jobs,
    build,
)
