"""Penetration and bend over the steps, closed form against QP."""

import math
from typing import TYPE_CHECKING

import numpy as np

from paper_repro.artefact import Artefact, Scale
from paper_repro.figure import COLOURS, DASHES, new_figure
from paper_repro.figure_6_windings import EVERY, FROM, LETTERS, directions, jobs, winding
from paper_repro.jobs import Results
from paper_repro.windings import DEEPEST, FOLDED, METHOD_NAMES, METHODS, story_job

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOUR_OF = {"closed form": "vermilion", "qp": "blue"}
DASH_OF = dict(zip(METHODS, DASHES[1::-1], strict=True))

CAPTION = f"""\
The deepest penetration of any link into the object (negative: the least clearance) and the largest bend between
neighbouring links, at every step of the windings of Figure 6. Dotted: what still counts as wound, {1e3 * DEEPEST:g} mm
and a right angle.

The QP stays below both from start to end; it bends no further than two hinges at their limits can. The closed form leaves
both, and not at the end only: links enter the object and fold back as the arm winds on. This does *not* show how often: see
Table 8.
"""


def build(scale: Scale, results: Results) -> "Figure":
    """Return the figure."""
    sides = directions(scale)
    figure, axes = new_figure(2, len(sides), height=3.6, sharex=True, sharey="row", squeeze=False)
    for column, direction in enumerate(sides):
        above, below = axes[:, column]
        for method in METHODS:
            story = results[story_job(winding(direction, method), every=EVERY)]
            style = {"color": COLOURS[COLOUR_OF[method]], "linestyle": DASH_OF[method], "label": METHOD_NAMES[method]}
            above.plot(1e3 * np.array(story["penetration_path"]), **style)
            below.plot(story["bend_path"], **style)
        for panel, limit in ((above, 1e3 * DEEPEST), (below, FOLDED)):
            panel.axhline(limit, color=COLOURS["black"], linestyle=":", linewidth=0.9)
        above.set_title(f"({LETTERS[direction]}) {FROM[direction]}")
        below.set(xlabel="step", ylim=(0.0, math.pi))
    axes[0, 0].set_ylabel("penetration [mm]")
    axes[1, 0].set_ylabel("largest bend [rad]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=2)
    return figure


ARTEFACT = Artefact(
    "figure-penetration", "Penetration and bend over a winding, closed form against QP", CAPTION, jobs, build
)
