"""Figure: the wound objects, and how far they slip while they are lifted and shaken."""

from typing import TYPE_CHECKING, Any

import numpy as np

from paper_repro.artefacts.table_14_holding import held_job, jobs, trials
from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.figure import COLOURS, DASHES, new_figure
from paper_repro.make.jobs import Results
from paper_repro.measure.hold_trials import CONTROLS
from paper_repro.measure.holding import GRIP, LIFT, SHAKE, SLIPPED, wound_settings
from prioritized_ik.validation import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIDES = {"up": "from above, level axis", "front": "from the front, upright axis"}
COLOUR_OF = dict(zip(CONTROLS, ("orange", "blue", "green"), strict=True))
WIDTH_OF = dict(zip(CONTROLS, (1.0, 1.0, 1.6), strict=True))
MOST = 65.0  # [mm] of slip that is drawn; trials end at 60

CAPTION = f"""\
Above: the arm wound around each object of Table 14 when it is let go, seen along the object's axis, ends of links as
dots. Below: how far marks on links and object have come apart, median of the wound links, while the arm grips, is lifted
(grey) and is shaken, with gravity, by the three controls; a line that ends is an object that fell. The dotted line is
{1e3 * SLIPPED:g} mm, beyond which an object does not count as held.

**To see:** around a level axis the object is caged. Along an upright one it falls from the first approach when gravity
comes on, and sinks in the second's grip, on links that roll; the hierarchy of torques lets it creep. It does *not* show
how hard the grips press: see Table 14.
"""


def build(scale: Scale, results: Results) -> "Figure":
    """Return the figure."""
    from matplotlib.ticker import MaxNLocator

    shown = [trial for trial in trials(scale) if trial[1] in SIDES]
    objects, sides = (list(dict.fromkeys(trial[place] for trial in shown)) for place in (0, 1))
    rows = 1 + len(sides)
    figure, axes = new_figure(rows, len(objects), height=1.75 * rows + 0.4, squeeze=False)
    for column, wound in enumerate(objects):
        _outline(axes[0, column], wound, np.array(results[held_job(scale, wound, sides[0], CONTROLS[0])]["ends"]), sides[0])
        axes[0, column].set_title(wound)
        axes[0, column].set_ylabel("to the object [m]" if column == 0 else "")
        for row, side in enumerate(sides, 1):
            panel = axes[row, column]
            for control in CONTROLS:
                _slip(panel, control, results[held_job(scale, wound, side, control)])
            _phases(panel, named=row == 1 and column == 0)
            panel.set_title(SIDES[side], fontsize=7.0, fontweight="normal")
            panel.set_xlabel("time [s]" if row == len(sides) else "")
            panel.set_ylabel("slip [mm]" if column == 0 else "")
            panel.yaxis.set_major_locator(MaxNLocator(4))
    handles = axes[1, 0].get_legend_handles_labels()
    figure.legend(*handles, loc="outside lower center", ncols=3)
    return figure


def _outline(axes: "Axes", wound: str, ends: Array, side: str) -> None:
    """Draw the object's section and the links, seen along its axis, the object above the arm."""
    from matplotlib.patches import Ellipse, Rectangle

    settings = wound_settings(wound, side)
    thing = settings.wound_object()
    across, up = np.array([1.0, 0.0, 0.0]), thing.rotation[:, 0]
    seen = np.vstack([np.zeros(3), ends]) @ np.column_stack([across, up])
    x, y = float(thing.position @ across), float(thing.position @ up)
    face: dict[str, Any] = {"facecolor": "#EFE6B0", "edgecolor": COLOURS["grey"], "linewidth": 0.6}
    high = thing.size[0]
    wide = thing.size[1] if thing.shape != "cylinder" else high
    if thing.shape == "box":
        axes.add_patch(Rectangle((x - wide, y - high), 2.0 * wide, 2.0 * high, **face))
    else:
        axes.add_patch(Ellipse((x, y), 2.0 * wide, 2.0 * high, **face))
    axes.plot(*seen.T, "-o", color=COLOURS["black"], linewidth=1.6, markersize=2.6)
    axes.set(aspect="equal", xlabel="along the arm [m]", xlim=(x - 0.22, x + 0.17), ylim=(y - 0.15, y + 0.13))


def _slip(axes: "Axes", control: str, found: dict[str, Any]) -> None:
    course = np.array(found["course"])
    dash = DASHES[(CONTROLS.index(control) + 1) % len(CONTROLS)]
    style: dict[str, Any] = {"color": COLOURS[COLOUR_OF[control]], "linestyle": dash}
    axes.plot(course[:, 0], 1e3 * course[:, 1], linewidth=WIDTH_OF[control], label=control, **style)


def _phases(axes: "Axes", named: bool) -> None:
    """Shade the phases, and name them if told so."""
    ends = np.cumsum([0.0, GRIP, LIFT, SHAKE])
    axes.axvspan(ends[1], ends[2], color="#EEEEEE", linewidth=0.0)
    axes.axhline(1e3 * SLIPPED, color=COLOURS["grey"], linestyle=":", linewidth=0.8)
    if named:
        for name, place in zip(("lift", "shake"), (0.5 * (ends[1] + ends[2]), ends[2] + 1.0), strict=True):
            axes.text(place, 0.97 * MOST, name, ha="center", va="top", fontsize=6.0)
    axes.set(xlim=(0.0, ends[-1]), ylim=(0.0, MOST))


ARTEFACT = Artefact("figure-holding", "Hold, lift and shake: how far wound objects slip", CAPTION, jobs, build)
