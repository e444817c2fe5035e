"""Figure 6: windings from four directions: a short and a long one by the closed form, and the long one by the QP."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from paper_repro.artefacts.closed_form_map import ideal_turns
from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.drawing3d import draw_lines, extent, line_of_sight, rendered, view_of
from paper_repro.make.figure import PAGE, new_figure
from paper_repro.make.jobs import Job, Results
from paper_repro.measure.windings import CRITERION, LONG, METHOD_NAMES, SHORT, judged, settings, story_job
from prioritized_ik.validation import Array
from prioritized_ik.winding.settings import WindingSettings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EVERY = 10  # steps between the states that are kept
STAGES = (0.12, 0.3, 0.45, 0.6, 0.8, 1.0)  # of a winding's steps
FIRST_SHOWN = 3  # end of the link at which a picture begins: what is before hardly moves
LETTERS = {"up": "a", "down": "b", "front": "c", "back": "d"}
FROM = {"up": "from above", "down": "from below", "front": "from the front", "back": "from the back"}

#: By how many of the three terms hold.
VERDICTS = (
    "not wound",
    "all links in contact",
    "wound by turns and depth",
    "wound within a joint's range",
)

GAP, TITLE = 0.08, 0.34  # [in] between pictures, and above a row of them
DOTS = 260  # pixels rendered an inch of paper
POINTS = 72.0  # an inch

#: What is shown of each direction: method and first link.
SHOWN = (("closed form", SHORT), ("closed form", LONG), ("qp", LONG))

CAPTION = f"""\
The 17-link arm winds around a cylinder of 0.14 m diameter from four directions, from one and the same straight initial
pose, with the weights of Eq. 23. Three rows a direction. First the closed form, Eqs. 12 to 14 alone, as in the paper,
with the cylinder at link {SHORT}: {ideal_turns(SHORT):.2f} of a turn. Then the closed form with the cylinder at link
{LONG}: {ideal_turns(LONG):.2f} of a turn. Then the QP from there, the same solve with joint ranges, a step limit and
contact rows. Time runs to the right; all pictures are of one scale; links in contact are red (lighter in print); links
1 to {FIRST_SHOWN} are cut off at the left, and the cylinder is shown short and translucent. Rendered by MuJoCo off
screen; where it cannot render, the same views are drawn as lines. A negative penetration is the least clearance.

{CRITERION}.

**To see:** the closed form winds from all four directions, as the paper says; on the way the link after the driven one
folds back, for the free tail is asked to stay. With twice the links left to wind all of them report contact again, but
the object has come round to the tail, whose links end up in it or folded back. The QP lays link after link around the
object. Where the closed form winds shows its map, on which these are two points. This reproduces Fig. 6 of the paper in
quality only: initial pose, first link, tilt, link radius and time step are choices. It does *not* show contact between
links, which is not modelled: after a full turn the arm lies in itself, where a tilted object would lay it beside
itself.
"""


@dataclass(frozen=True)
class Strip:
    """One winding as a row of pictures.

    Attributes:
        title: what it is and how it went.
        chosen: its settings.
        story: see `windings.story`, with the states to show picked.
        rectangles: what each picture shows `(stages, 4)` [m], see `drawing3d.extent`.
    """

    title: str
    chosen: WindingSettings
    story: dict[str, Any]
    rectangles: Array


def winding(direction: str, method: str, link: int) -> WindingSettings:
    """Return the settings of one winding of the figure; the figure of penetration has the same."""
    return settings(method, direction=direction, link=link)


def directions(scale: Scale) -> tuple[str, ...]:
    """Return where the object comes from; one direction in the reduced run."""
    return scale.directions[:1] if scale.quick else scale.directions


def jobs(scale: Scale) -> list[Job]:
    """Return one job a winding."""
    return [story_job(winding(direction, *shown), every=EVERY) for direction in directions(scale) for shown in SHOWN]


def build(scale: Scale, results: Results) -> "Figure":
    """Return the figure."""
    strips = [
        _strip(direction, method, link, results[story_job(winding(direction, method, link), every=EVERY)])
        for direction in directions(scale)
        for method, link in SHOWN
    ]
    widths = np.max([strip.rectangles[:, 1] - strip.rectangles[:, 0] for strip in strips], axis=0)  # [m] of each stage
    heights = [float(strip.rectangles[0, 3] - strip.rectangles[0, 2]) for strip in strips]  # [m] of each strip
    inches = (PAGE - GAP * (len(widths) + 1)) / widths.sum()  # a metre
    height = sum(heights) * inches + TITLE * len(strips) + GAP
    figure, axes = new_figure(height=height)
    axes.remove()
    figure.set_layout_engine("none")  # every place is given
    top = height
    for strip, tall in zip(strips, heights, strict=True):
        top -= TITLE
        figure.text(GAP / PAGE, (top + 0.165) / height, strip.title, fontsize=7.5, va="bottom")
        _draw(figure, strip, widths, inches, top)
        top -= tall * inches
    return figure


def _strip(direction: str, method: str, link: int, story: dict[str, Any]) -> Strip:
    """Return the strip of one winding: all its pictures of one height, each of the width that it needs."""
    chosen = winding(direction, method, link)
    shown = np.array(story["shown"])
    places = [int(np.abs(shown - share * shown[-1]).argmin()) for share in STAGES]
    picked = {key: np.array(story[key])[places] for key in ("shown", "q", "positions", "in_contact")}
    picked["k"] = np.array(story["wound_to"])[picked["shown"]]
    sight = line_of_sight(chosen)
    rectangles = np.array([extent(chosen, ends[FIRST_SHOWN - 1 :], sight) for ends in picked["positions"]])
    rectangles[:, 2], rectangles[:, 3] = rectangles[:, 2].min(), rectangles[:, 3].max()
    title = (
        f"({LETTERS[direction]}) {FROM[direction]}, link {link}, {METHOD_NAMES[method]}: "
        f"turns {story['turns_ratio']:.2f} of the ideal, penetration {1e3 * story['penetration']:.1f} mm, "
        f"bend {story['bend']:.2f} rad; {VERDICTS[sum(judged(story))]}"
    )
    return Strip(title, chosen, picked, rectangles)


def _draw(figure: "Figure", strip: Strip, widths: Array, inches: float, top: float) -> None:
    """Draw a strip whose pictures begin `top` [in] above the figure's bottom; a metre is `inches` long."""
    width, height = figure.get_size_inches()
    sight = line_of_sight(strip.chosen)
    rectangles = strip.rectangles.copy()
    rectangles[:, 1] = rectangles[:, 0] + widths
    views = [view_of(rectangle, sight) for rectangle in rectangles]
    story = strip.story
    pictures = rendered(strip.chosen, story["q"], story["in_contact"], views, DOTS * inches)
    left = GAP
    for stage, view in enumerate(views):
        box = (
            left / width,
            (top - view.height * inches) / height,
            view.width * inches / width,
            view.height * inches / height,
        )
        axes = figure.add_axes(box)
        axes.set(xticks=[], yticks=[])
        axes.grid(visible=False)
        for spine in axes.spines.values():
            spine.set(visible=True, color="#CCCCCC", linewidth=0.5)
        sides = np.array([-0.5, 0.5])
        if pictures is None:
            draw_lines(axes, strip.chosen, story["positions"][stage], story["in_contact"][stage], view, POINTS * inches)
        else:
            axes.imshow(pictures[stage], extent=(*(view.width * sides), *(view.height * sides)), aspect="auto")
        axes.set(xlim=view.width * sides, ylim=view.height * sides)
        axes.set_title(
            f"step {story['shown'][stage]}, k = {story['k'][stage]}", fontsize=6.5, fontweight="normal", loc="left", pad=2.0
        )
        left += view.width * inches + GAP


ARTEFACT = Artefact("figure-6", "Fig. 6: winding from four directions, closed form and QP", CAPTION, jobs, build)
