"""Figure 7: what the weights of the links not yet wound change."""

from typing import TYPE_CHECKING, Any

import numpy as np

from paper_repro.artefacts.figure_6_windings import EVERY
from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.figure import COLOURS, DASHES, new_figure
from paper_repro.make.jobs import Job, Results
from paper_repro.measure.windings import LONG, METHOD_NAMES, METHODS, SHORT, settings, story_job
from prioritized_ik.validation import Array
from prioritized_ik.winding.settings import WindingSettings

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DIRECTION = "front"  # from straight, all of it happens in the plane of x and y, where the last link's hinge turns it
LINK = {"closed form": SHORT, "qp": LONG}  # first links, from which each of the methods winds
STEPS = {"closed form": (0, 40, 80, 120, 160), "qp": (0, 60, 120, 180, 240)}  # at which the arm is drawn
WEIGHTS = {"eq24": "Eq. 24 (1.0)", "eq23": "Eq. 23 (0.01)", "strict": "strict"}
COLOUR_OF = {"eq24": "vermilion", "eq23": "blue", "strict": "green"}
WIDTH_OF = {"eq24": 1.2, "eq23": 2.6, "strict": 1.0}  # Eq. 23 and strict lie on each other
BEHIND = {"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.3}  # of a number on lines
SHADES = ("#BBBBBB", "#999999", "#777777", "#444444", "#000000")  # of the outlines, from the first to the last

CAPTION = f"""\
Links not yet wound hold their places with the weight 1.0 (Eq. 24, the paper's Fig. 7a), with 0.01 (Eq. 23, Fig. 7b), or
come after all others by strict priority. Above: the arm at the same steps in each panel of a row, darker as it goes on,
seen in the plane in which it moves, and the path of its end; below, how long that path has become by each step, and by
the time that link k is wound. Object from the front, straight initial pose; upper row by the closed form from link
{SHORT} on, lower row by the QP from link {LONG} on: all six windings succeed by turns and depth. Each panel says how
long the path of the arm's end is until equilibrium, and how far an end of a link not yet wound moves in a step on
average.

**To see:** with 1.0 the ends not yet wound move less in a step, as the paper says: they try to keep their places. But
the link being wound then also advances more slowly, and by the time that a link is wound the tail has moved about as
far as with 0.01: in our poses Eq. 24 changes the pace of the closed form by a few per cent, and its route hardly. Where
it does tell is how far the closed form winds: with 1.0 from link 10 on, with 0.01 only from link 11 (closed-form map).
Strict priorities do what 0.01 does. This does *not* show the paper's own postures, whose initial pose is not stated.
"""


def winding(weights: str, method: str) -> WindingSettings:
    """Return the settings of one winding of the figure."""
    return settings(method, direction=DIRECTION, weights=weights, link=LINK[method])


def jobs(scale: Scale) -> list[Job]:
    """Return one job a winding."""
    return [story_job(winding(weights, method), every=EVERY) for weights in WEIGHTS for method in METHODS]


def build(scale: Scale, results: Results) -> "Figure":
    """Return the figure."""
    del scale
    stories = {(w, m): results[story_job(winding(w, m), every=EVERY)] for w in WEIGHTS for m in METHODS}
    figure, axes = new_figure(3, 6, height=5.0, height_ratios=(1.0, 1.0, 1.5))
    grid = axes[0, 0].get_gridspec()
    for panel in axes.flat:
        panel.remove()
    first = None
    for row, method in enumerate(METHODS):
        for column, weights in enumerate(WEIGHTS):
            panel = figure.add_subplot(grid[row, 2 * column : 2 * column + 2], sharex=first, sharey=first)
            first = first or panel
            _outlines(panel, winding(weights, method), stories[weights, method], STEPS[method])
            panel.set_title(f"{WEIGHTS[weights]}, {METHOD_NAMES[method]}", fontsize=7.5)
            panel.set_ylabel("−y [m]" if column == 0 else "")
            panel.set_xlabel("x [m]" if row == 1 else "")
    by_step, by_link = figure.add_subplot(grid[2, :3]), figure.add_subplot(grid[2, 3:])
    _paths(by_step, by_link, stories)
    figure.legend(
        *by_step.get_legend_handles_labels(), loc="outside lower center", ncols=3, columnspacing=1.2, handlelength=2.2
    )
    return figure


def _outlines(axes: "Axes", chosen: WindingSettings, story: dict[str, Any], steps: tuple[int, ...]) -> None:
    """Draw the arm at each of `steps` that the winding has, and the path of its end."""
    from matplotlib.patches import Circle

    wound = chosen.wound_object()
    x, y = _seen(wound.position).tolist()
    axes.add_patch(Circle((x, y), wound.size[0], facecolor="#EFE6B0", edgecolor="none"))
    axes.plot(*_seen(np.array(story["tail"])).T, color=COLOURS["vermilion"], linewidth=0.9, linestyle="--")
    drawn = [step for step in steps if step in story["shown"]]
    for step, shade in zip(drawn, SHADES, strict=False):
        ends = _seen(np.vstack([np.zeros(3), story["positions"][story["shown"].index(step)]]))
        axes.plot(*ends.T, color=shade, linewidth=0.9)
        axes.plot(*ends[-1], "o", color=shade, markersize=2.4)
        axes.annotate(
            str(step), (ends[-1, 0], ends[-1, 1]), xytext=(2.5, 2.5), textcoords="offset points", fontsize=6.5, bbox=BEHIND
        )
    axes.text(
        0.02,
        0.98,
        f"path {story['tail_path']:.2f} m in {story['steps']} steps\n{1e3 * story['free_step']:.1f} mm a step",
        transform=axes.transAxes,
        ha="left",
        va="top",
        fontsize=6.5,
    )
    axes.set(aspect="equal", xlim=(-0.02, 1.13), ylim=(-0.17, 0.45), yticks=(0.0, 0.2, 0.4))


def _seen(points: Array) -> Array:
    """Return points `(…, 3)` [m] as they lie in the plane of the winding, the object above the arm `(…, 2)`."""
    return points[..., :2] * [1.0, -1.0]


def _paths(by_step: "Axes", by_link: "Axes", stories: dict[tuple[str, str], dict[str, Any]]) -> None:
    """Draw the length of the path of the arm's end over the steps, and over the links wound."""
    for (weights, method), story in stories.items():
        path = np.r_[0.0, np.linalg.norm(np.diff(story["tail"], axis=0), axis=1).cumsum()]
        style: dict[str, Any] = {
            "color": COLOURS[COLOUR_OF[weights]],
            "linewidth": WIDTH_OF[weights],
            "linestyle": DASHES[METHODS.index(method) == 0],
            "label": f"{WEIGHTS[weights].partition(' (')[0]}, {METHOD_NAMES[method]}",
        }
        by_step.plot(path, **style)
        wound_to = np.maximum.accumulate(story["wound_to"])
        links, first = np.unique(wound_to, return_index=True)
        marker = {"eq24": "o", "eq23": "s", "strict": "^"}[weights]
        by_link.plot(links, path[first], marker=marker, **style)
    by_step.set(xlabel="step", ylabel="path of the arm's end [m]", xlim=(0, None), ylim=(0, None))
    by_link.set(xlabel="last wound link k", ylabel="path of the arm's end [m]", xlim=(5.8, 17.2), ylim=(0, None))


ARTEFACT = Artefact("figure-7", "Fig. 7: effect of the weights of the links not yet wound", CAPTION, jobs, build)
