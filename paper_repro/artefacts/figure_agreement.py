"""Digits of agreement with Eqs. 12-14, by backend and formulation."""

import math
from typing import TYPE_CHECKING

import numpy as np

from paper_repro.artefacts.table_4_backends import jobs
from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.figure import PAGE, new_figure
from paper_repro.make.jobs import Results
from paper_repro.measure.replays import FORMULATIONS, Summary, formulations, summary
from paper_repro.measure.steady import steady_solvers

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DIGITS = 16  # of a double
MARGIN = 1.3  # [in] of the labels
ROW = 0.29  # [in]
HEADINGS = {"lexicographic": "lexico-\ngraphic"}
DARK = 9.0  # digits below which a cell of the colour map is dark


def digits(error: float) -> float:
    """Return how many digits of a value are right, none if it is off by all of itself."""
    return float(np.clip(-math.log10(max(error, 1e-300)), 0.0, DIGITS))


def words(found: Summary) -> str:
    """Return what stands in a cell: digits in the median and at worst, and how many steps fail if any do."""
    failed = f"✕ {100 * found.failed / found.steps:.0f}%" if found.failed else ""
    if found.dtheta_median is None or found.dtheta_max is None:
        return f"–\n{failed}"
    figures = f"{digits(found.dtheta_median):.0f} | {digits(found.dtheta_max):.0f}"
    return f"{figures}\n{failed}" if failed else figures


def build(scale: Scale, results: Results) -> "Figure":
    """Return a heat map: rows are backends, columns formulations."""
    names = steady_solvers(scale)
    figure, axis = new_figure(height=MARGIN + ROW * len(names), width=PAGE)
    shown = np.full((len(names), len(FORMULATIONS)), np.nan)
    for row, solver in enumerate(names):
        for column, formulation in enumerate(FORMULATIONS):
            if formulation not in formulations(solver):
                continue
            found = summary(scale, results, solver, formulation)
            if found.dtheta_median is not None:
                shown[row, column] = digits(found.dtheta_median)
            light = np.isnan(shown[row, column]) or shown[row, column] >= DARK
            colour = "black" if light else "white"
            axis.text(column, row, words(found), ha="center", va="center", fontsize=6.5, color=colour, linespacing=1.0)
    picture = axis.imshow(shown, cmap="cividis", vmin=0, vmax=DIGITS, aspect="auto")
    axis.set_yticks(range(len(names)), names)
    axis.set_xticks(range(len(FORMULATIONS)), [HEADINGS.get(f.title, f.title.replace(" ", "\n")) for f in FORMULATIONS])
    axis.tick_params(length=0)
    axis.xaxis.tick_top()
    axis.grid(False)
    axis.set_xticks(np.arange(len(FORMULATIONS) - 1) + 0.5, minor=True)
    axis.set_yticks(np.arange(len(names) - 1) + 0.5, minor=True)
    axis.grid(True, which="minor", color="white", linewidth=1.0)
    axis.tick_params(which="minor", length=0)
    axis.spines[:].set_visible(False)
    bar = figure.colorbar(picture, ax=axis, orientation="horizontal", aspect=50, pad=0.02, shrink=0.6)
    bar.set_label("median digits of dθ that agree with Eqs. 12–14 [–]")
    return figure


CAPTION = """\
Digits of dθ that agree with Eqs. 12–14 on the recorded steps on which no row binds: −log₁₀ of the relative error,
`median | worst`, by backend and formulation; the colour is the median. `✕`: steps, free or not, without an answer or
with one that breaks a row by more than 1e-6; the digits are of the others. Empty: a formulation that the backend is not
given. The numbers behind it, and what the formulations are, stand in table 4.

**To see:** by the lexicographic QP every backend gives the closed form; by the others agreement depends on the backend,
and the worst step is far from the median one. More damping makes backends agree with each other, but not with Eqs.
12–14.

It does *not* show the polished steps, which are the same bits for all."""

ARTEFACT = Artefact("figure-agreement", "Agreement with Eqs. 12–14 by backend and formulation", CAPTION, jobs, build)
