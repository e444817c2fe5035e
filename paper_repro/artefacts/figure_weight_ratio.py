"""Distance from strict priorities over the ratio of the weights, by method."""

from typing import TYPE_CHECKING

import numpy as np

from comparisons.demonstrations import QUANTITIES
from comparisons.weight_ratio import METHODS, RATIOS
from paper_repro.artefacts.table_6_weight_ratio import jobs, measured
from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.figure import COLOURS, DASHES, MARKERS, new_figure
from paper_repro.make.jobs import Results

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TITLES = {"dtheta": "Step dθ", "level_1": "First task's residual", "level_2": "Second task's residual"}
HUES = ("black", "vermilion", "orange", "sky", "purple", "green")


def build(scale: Scale, results: Results) -> "Figure":
    """Return one panel a quantity, one line a method."""
    del scale
    found = measured(results)
    figure, axes = new_figure(1, 3, height=3.1, sharey=True)
    for axis, quantity in zip(axes, QUANTITIES, strict=True):
        (strict,) = (getattr(row, quantity) for row in found if row.ratio is None)
        axis.plot(RATIOS, 1.0 / np.array(RATIOS), color=COLOURS["grey"], linewidth=3.0, alpha=0.4, label="1 / ratio")
        axis.axhline(strict, color=COLOURS["blue"], linewidth=0.8, linestyle=":", label="strict levels, QP")
        for place, (name, hue) in enumerate(zip(METHODS, HUES, strict=True)):
            points = [(row.ratio, getattr(row, quantity)) for row in found if row.method == name and row.ratio is not None]
            known = [(ratio, value) for ratio, value in points if value is not None]
            axis.plot(
                *(zip(*known, strict=True) if known else ([], [])),
                color=COLOURS[hue],
                marker=MARKERS[place],
                linestyle=DASHES[place % len(DASHES)],
                markerfacecolor="none" if place % 2 else COLOURS[hue],
                label=name,
            )
        axis.set(xscale="log", yscale="log", title=TITLES[quantity], xlabel="ratio of weights [–]")
        axis.set_xticks([1e0, 1e3, 1e6, 1e9, 1e12])
    axes[0].set_ylabel("distance from the strict answer,\nrelative [–]")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure


CAPTION = """\
Distance from the strict two-level answer over the ratio of the two tasks' weights, by method: of dθ, and of each task's
residual, relative to what it asks. From the rows of table 6, where the methods are described; a line ends where its
method gives no answer.

**To see:** a weight can stand for a priority as far as the method can follow. Orthogonal factors and the lexicographic
QP lie on the grey line 1/ratio; the others leave it, and in dθ earlier than in the residuals. The dotted line is the
strict QP, which has no ratio. It does *not* show limits, which bind nowhere here."""

ARTEFACT = Artefact("figure-weight-ratio", "Ratio of weights towards strict priorities", CAPTION, jobs, build)
