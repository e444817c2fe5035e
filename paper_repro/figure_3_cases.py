"""To come."""

from paper_repro.artefact import Artefact, Scale, no_jobs
from paper_repro.jobs import Results
from paper_repro.table import Column, Table


def build(scale: Scale, results: Results) -> Table:
    """Return nothing yet."""
    del scale, results
    return Table((Column("none", "to come"),), ())


ARTEFACT = Artefact("figure-3", "To come", "", no_jobs, build)
