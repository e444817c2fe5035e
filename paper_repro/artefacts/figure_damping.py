"""The U of rounding against bias: error of dθ over the damping."""

from typing import TYPE_CHECKING

from paper_repro.artefacts.table_5_damping import DAMPINGS, METHODS, WEIGHTS, biases_job, jobs
from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.figure import COLOURS, DASHES, MARKERS, new_figure
from paper_repro.make.jobs import Results
from paper_repro.measure.replays import median

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HUES = ("vermilion", "blue", "orange", "green")


def build(scale: Scale, results: Results) -> "Figure":
    """Return one panel a kind of weights: the median as a line, the maximum as its upper, thin one."""
    figure, axes = new_figure(1, 2, height=3.0, sharey=True)
    for axis, (weights, equation) in zip(axes, WEIGHTS.items(), strict=True):
        found = results[biases_job(scale, weights)]
        for name, hue, marker, dash in zip(METHODS, HUES, MARKERS, DASHES, strict=False):
            rows = [row for row in found if row["method"] == name and not row["failed"]]
            dampings = [row["damping"] for row in rows]
            look = {"color": COLOURS[hue], "linestyle": dash}
            axis.plot(dampings, [median(row["errors"]) for row in rows], marker=marker, label=name, **look)
            axis.plot(dampings, [max(row["errors"]) for row in rows], marker=marker, markersize=2.0, linewidth=0.5, **look)
        axis.set(xscale="log", yscale="log", xlim=(DAMPINGS[0] / 3, DAMPINGS[-1] * 3), title=f"Weights of {equation}")
        axis.set_xlabel("damping δ [m²/rad²]")
    axes[0].set_ylabel("relative error of dθ [–]")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


CAPTION = """\
Relative error of dθ against Eqs. 12–14 over the damping δ: thick lines the median over the recorded free steps, thin
lines the maximum. A line ends on the left where its method fails on some step. Measured as in table 5.

**To see:** on the right of each U the bias of the damping, on the left rounding. On the worst steps rounding is larger
where JᵀWJ is formed; on the median step either can be ahead. The best δ for the median step is not the best for the
worst one, nor that of Eq. 23 the one of Eq. 24. It does *not* show solvers that stop at a tolerance: theirs is a third,
higher floor (figure-agreement)."""

ARTEFACT = Artefact("figure-damping", "Damping: bias against rounding", CAPTION, jobs, build)
