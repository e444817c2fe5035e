"""Figure: the map of the closed form, one cell a winding."""

from typing import TYPE_CHECKING, Any

from paper_repro.artefacts.closed_form_map import REASONS, WEIGHTS, Case, found, jobs
from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.figure import COLOURS, new_figure
from paper_repro.make.jobs import Results
from paper_repro.measure.windings import CRITERION, TERM_TITLES, judged

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Colour of a cell by how many of the three terms hold.
FACES = ("#FFFFFF", "#F4D9A6", COLOURS["sky"], COLOURS["blue"])
NAMES = ("not wound", *TERM_TITLES)
CELL = 0.135  # [in] of height
FRAME = 1.7  # [in] of height for titles, axes and the legend

CAPTION = f"""\
The windings of the closed-form map one by one: first link to the right, initial pose and direction downwards, one panel
each weights, rank tolerance and tilt of the object. The colour says in how many of the three terms the arm is wound,
the letter why it is not by turns and depth. {CRITERION}.

{REASONS}.

To see: in the panels without tilt the upper right, straight pose and first links 10 or 11 to 15, is blue from all four
directions. At the rank tolerance 1e-3 the rest of the right follows. On the left, where a turn or more is left to wind,
tails are in the way (T, F) at either. It does *not* show how near a failure was to a success.
"""


def build(scale: Scale, results: Results) -> "Figure":
    """Return the figure."""
    from matplotlib.patches import Patch

    every = found(scale, results)
    links = sorted({case.link for case in every})
    lines = list(dict.fromkeys((case.pose, case.direction) for case in every))
    weights = list(dict.fromkeys(case.weights for case in every))
    across = list(dict.fromkeys((case.tolerance, case.tilt) for case in every))
    height = len(weights) * CELL * len(lines) + FRAME
    figure, axes = new_figure(len(weights), len(across), height=height, sharex=True, sharey=True, squeeze=False)
    for row, kind in enumerate(weights):
        for column, (tolerance, tilt) in enumerate(across):
            panel = axes[row, column]
            panel.set_title(f"{WEIGHTS[kind]}, rank cut {tolerance:.0e},\ntilt {tilt:g} rad", fontsize=7.0)
            shown = {c: f for c, f in every.items() if (c.weights, c.tolerance, c.tilt) == (kind, tolerance, tilt)}
            _cells(panel, shown, links, lines)
            panel.set_xlabel("first link" if row == len(weights) - 1 else "")
    figure.legend(
        handles=[Patch(facecolor=face, edgecolor="#999999", label=name) for face, name in zip(FACES, NAMES, strict=True)],
        loc="outside lower center",
        ncols=2,
    )
    return figure


def _cells(panel: "Axes", shown: dict[Case, dict[str, Any]], links: list[int], lines: list[tuple[str, str]]) -> None:
    from matplotlib.patches import Rectangle

    panel.grid(visible=False)
    for case, figures in shown.items():
        x, y = links.index(case.link), lines.index((case.pose, case.direction))
        face = FACES[sum(judged(figures))]
        panel.add_patch(Rectangle((x - 0.5, y - 0.5), 1.0, 1.0, facecolor=face, edgecolor="#BBBBBB", linewidth=0.4))
        panel.text(x, y, figures["reason"] or "", ha="center", va="center_baseline", fontsize=5.5)
    panel.set(xlim=(-0.5, len(links) - 0.5), ylim=(len(lines) - 0.5, -0.5))
    panel.set_xticks(range(len(links)), [str(link) for link in links])
    panel.set_yticks(range(len(lines)), [f"{pose}, {direction}" for pose, direction in lines], fontsize=6.0)
    panel.tick_params(length=0.0)
    for place in range(1, len(lines)):
        if lines[place][0] != lines[place - 1][0]:
            panel.axhline(place - 0.5, color=COLOURS["black"], linewidth=0.7)


ARTEFACT = Artefact("figure-closed-form-map", "The closed form's map, winding by winding", CAPTION, jobs, build)
