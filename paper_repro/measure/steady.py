"""The backends whose own answers are the same bits in every run, wherever in memory they were computed."""

from paper_repro.make.artefact import Scale
from paper_repro.measure.replays import solvers

#: Started warm, ProxQP's dense solver gives other last digits in every process; cold, and sparse, it does not. Its
#: certified steps are the same bits as all others', and its times stand in table 7.
UNSTEADY = ("proxqp-warm",)


def steady_solvers(scale: Scale) -> tuple[str, ...]:
    """Return the backends to compare where every run must give the same figures."""
    return tuple(name for name in solvers(scale) if name not in UNSTEADY)
