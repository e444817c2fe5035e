"""Table 6: how near a weighted solve comes to strict priorities as the ratio of the weights grows."""

from dataclasses import asdict
from typing import Any

from comparisons.demonstrations import QUANTITIES
from comparisons.weight_ratio import METHODS, RATIOS, Row, closest, measure
from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.jobs import Job, Results
from paper_repro.make.table import Cell, Column, Table


def rows_of_methods() -> list[dict[str, Any]]:
    """Return the rows of `demo weight-ratio`."""
    return [asdict(row) for row in measure()]


JOB = Job(rows_of_methods)


def jobs(scale: Scale) -> list[Job]:
    """Return the one job, the same at every scale."""
    del scale
    return [JOB]


def measured(results: Results) -> list[Row]:
    """Return the rows that the job found."""
    return [Row(**row) for row in results[JOB]]


COLUMNS = (
    Column("distance_of", "distance of"),
    Column("ratio", "ratio of weights", ".0e"),
    *(Column(name.replace(", ", "_").replace(" ", "_"), name, ".0e") for name in METHODS),
    Column("strict_levels", "strict levels, QP", ".0e"),
)


def build(scale: Scale, results: Results) -> Table:
    """Return one row a quantity and ratio; the strict answer, which has no ratio, stands in the first of each."""
    del scale
    found = measured(results)
    rows: list[tuple[Cell, ...]] = []
    for quantity, title in QUANTITIES.items():
        (strict,) = (getattr(row, quantity) for row in found if row.ratio is None)
        for ratio in RATIOS:
            of = {row.method: getattr(row, quantity) for row in found if row.ratio == ratio}
            rows.append((title, ratio, *(of[name] for name in METHODS), strict))
    return Table(COLUMNS, tuple(rows), notes(found))


def notes(found: list[Row]) -> str:
    """Return where each method comes nearest to the strict step, and at how many ratios it fails."""
    said = []
    for name in METHODS:
        best = closest(found, name)
        failed = sum(bool(row.failure) for row in found if row.method == name)
        said.append(
            f"{name} fails everywhere"
            if best is None
            else f"{name} to {best.dtheta:.0e} at ratio {best.ratio:.0e}"
            + (f", failing at {failed} ratios" if failed else "")
        )
    return f"Nearest to the strict step dθ: {'; '.join(said)}."


CAPTION = """\
Two tasks at the ends of one link of the 17-link arm, which cannot both be done, as one weighted level with a growing
ratio of weights, by several methods, beside the two of them as strict levels. Figures are distances from the strict
closed form, relative: of dθ, and of each task's residual, relative to what the task asks. *Orthogonal factors*: Eqs. 12
and 14 by QR of W^½J_a, without JᵀWJ. *Normal equations*: (JᵀWJ)⁺JᵀW dX\\* (pinv), and with 1e-12 I added (damped).
*QP*: the lexicographic QP of the one weighted level. *Slack QP*: min sᵀWs + 1e-12 ‖dθ‖² subject to J dθ + s = dX\\*, by
a solver that stops at its default tolerance (daqp) and by one that knows only rounding (quadprog). *Strict levels*: the
lexicographic QP of the two levels, which has no ratio and is the same on every row. `–`: no answer.

**To see:** in exact arithmetic the distance falls as one over the ratio. Orthogonal factors and the lexicographic QP
follow over the whole range; the normal equations turn back where the product JᵀWJ drowns the lighter task, the damped
ones long before in dθ, though their residuals still look right. The slack QP by quadprog keeps the residuals down to
large ratios, but its dθ stops where the damping is too weak to decide. Strict levels need no ratio.

It does *not* show what a large ratio does together with active limits."""

ARTEFACT = Artefact("table-6", "Table 6: ratio of weights towards strict priorities", CAPTION, jobs, build)
