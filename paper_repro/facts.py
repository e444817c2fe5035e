"""To come."""

from typing import Any

from paper_repro.artefact import Artefact, Scale, no_jobs
from paper_repro.jobs import Job, Results
from paper_repro.table import Column, Table


def build(scale: Scale, results: Results) -> Table:
    """Return nothing yet."""
    del scale, results
    return Table((Column("none", "to come"),), ())


ARTEFACT = Artefact("facts", "To come", "", no_jobs, build)


def jobs(scale: Scale) -> list[Job]:
    """Return what the checks need."""
    return ARTEFACT.jobs(scale)


def findings(scale: Scale, results: Results) -> list[Any]:
    """Return nothing yet."""
    del scale, results
    return []


def table(found: list[Any]) -> Table:
    """Return nothing yet."""
    del found
    return Table((Column("none", "to come"),), ())
