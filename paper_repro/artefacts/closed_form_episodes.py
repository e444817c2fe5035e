"""The windings of the closed form's map, one a row."""

from paper_repro.artefacts.closed_form_map import REASONS, WEIGHTS, found, jobs
from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.jobs import Results
from paper_repro.make.table import Column, Table
from paper_repro.measure.windings import CRITERION, TERM_TITLES, judged

COLUMNS = (
    Column("rank_tolerance", "rank tolerance", ".0e"),
    Column("weights", "weights"),
    Column("tilt_rad", "tilt [rad]", ".1f"),
    Column("pose", "initial pose"),
    Column("direction", "object from"),
    Column("first_link", "first link"),
    Column("in_contact", TERM_TITLES[0]),
    Column("turned", TERM_TITLES[1]),
    Column("within_range", TERM_TITLES[2]),
    Column("turns", "turns", ".2f"),
    Column("turns_ratio", "turns / ideal", ".2f"),
    Column("penetration_mm", "penetration [mm]", ".1f"),
    Column("fold_rad", "fold [rad]", ".2f"),
    Column("largest_step_rad", "largest joint step [rad]", ".2f"),
    Column("steps", "steps"),
    Column("reason", "why not"),
)

CAPTION = f"""\
Every winding of the closed-form map, the table to look one up in. *Fold* is the largest bend between
neighbouring links at any time. {CRITERION}. Why not: {REASONS}.
"""


def build(scale: Scale, results: Results) -> Table:
    """Return the table."""
    rows = tuple(
        (
            case.tolerance,
            WEIGHTS[case.weights],
            case.tilt,
            case.pose,
            case.direction,
            case.link,
            *judged(figures),
            figures["turns"],
            figures["turns_ratio"],
            1e3 * figures["penetration"],
            figures["bend"],
            figures["largest_step"],
            figures["steps"],
            figures["reason"],
        )
        for case, figures in found(scale, results).items()
    )
    return Table(COLUMNS, rows)


ARTEFACT = Artefact("closed-form-episodes", "The closed form's map, every winding", CAPTION, jobs, build)
