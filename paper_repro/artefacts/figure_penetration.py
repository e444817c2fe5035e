"""Penetration and bend over the steps, closed form against QP."""

import math
from typing import TYPE_CHECKING

import numpy as np

from paper_repro.artefacts.figure_6_windings import EVERY, FROM, LETTERS, SHOWN, directions, jobs, winding
from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.figure import COLOURS, DASHES, new_figure
from paper_repro.make.jobs import Results
from paper_repro.measure.windings import DEEPEST, FOLDED, LONG, METHOD_NAMES, SHORT, story_job

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS_SHOWN = dict(zip(SHOWN, ("green", "vermilion", "blue"), strict=True))
DASHES_SHOWN = dict(zip(SHOWN, (DASHES[2], DASHES[1], DASHES[0]), strict=True))

CAPTION = f"""\
The deepest penetration of any link into the object (negative: the least clearance) and the largest bend between
neighbouring links, at every step of the windings of Figure 6. Dotted: {1e3 * DEEPEST:g} mm, above which an arm does not
count as wound by turns and depth, and a right angle, above which not within a joint's range either.

From link {SHORT} on the closed form stays out of the object, but folds by almost 3 rad on the way, as the free tail is
asked to stay; at the end it is as little bent as the QP's. From link {LONG} on it folds as much, and links enter the
object when the tail is reached. The QP stays below both from start to end. This does *not* show other poses: see the
closed-form map.
"""


def build(scale: Scale, results: Results) -> "Figure":
    """Return the figure."""
    sides = directions(scale)
    figure, axes = new_figure(2, len(sides), height=3.6, sharex=True, sharey="row", squeeze=False)
    for column, direction in enumerate(sides):
        above, below = axes[:, column]
        for shown in SHOWN:
            method, link = shown
            story = results[story_job(winding(direction, method, link), every=EVERY)]
            style = {
                "color": COLOURS[COLOURS_SHOWN[shown]],
                "linestyle": DASHES_SHOWN[shown],
                "label": f"{METHOD_NAMES[method]}, from link {link}",
            }
            above.plot(1e3 * np.array(story["penetration_path"]), **style)
            below.plot(story["bend_path"], **style)
        for panel, limit in ((above, 1e3 * DEEPEST), (below, FOLDED)):
            panel.axhline(limit, color=COLOURS["black"], linestyle=":", linewidth=0.9)
        above.set_title(f"({LETTERS[direction]}) {FROM[direction]}")
        below.set(xlabel="step", ylim=(0.0, math.pi))
    axes[0, 0].set_ylabel("penetration [mm]")
    axes[1, 0].set_ylabel("largest bend [rad]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=3)
    return figure


ARTEFACT = Artefact(
    "figure-penetration", "Penetration and bend over a winding, closed form against QP", CAPTION, jobs, build
)
