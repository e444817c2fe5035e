"""How windings end over all directions: table 8 in a few rows, for the README."""

from paper_repro.artefact import Artefact, Scale
from paper_repro.jobs import Results
from paper_repro.table import Cell, Table
from paper_repro.table_8_windings import COLUMNS, WEIGHT_NAMES, directions, found, jobs, two_rows
from paper_repro.windings import CRITERION, METHOD_NAMES, METHODS
from prioritized_ik.weights import KINDS

CAPTION = f"""\
Table 8 over all directions together: windings from random initial poses by the closed form (Eqs. 12 to 14 alone, as in the
paper) and by the QP with joint ranges, a step limit and contact rows. Two rows a case: the median of the windings, and the
worst of each figure by itself. Columns, and what they do *not* show, are those of table 8. {CRITERION}.
"""


def build(scale: Scale, results: Results) -> Table:
    """Return the table."""
    rows: list[tuple[Cell, ...]] = []
    for weights in KINDS:
        for method in METHODS:
            wound = found(scale, results, directions(scale), weights, method)
            rows += two_rows((WEIGHT_NAMES[weights], METHOD_NAMES[method]), wound)
    notes = (
        f"From {', '.join(directions(scale))}, {scale.seeds} random initial poses each. {CRITERION}. Turns: over what a "
        "polygon of tangent links would make; penetration negative: the least clearance; drift: of a link's end once its "
        "link is wound."
    )
    return Table(COLUMNS[1:], tuple(rows), notes)


ARTEFACT = Artefact("outcomes", "Winding outcomes, all directions together", CAPTION, jobs, build)
