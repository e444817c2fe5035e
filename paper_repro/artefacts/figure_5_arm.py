"""Figure 5: the 17-link arm, its joints, their numbers and axes, from the model."""

import itertools
from typing import TYPE_CHECKING, Any

import numpy as np

from paper_repro.make.artefact import Artefact, Scale, no_jobs
from paper_repro.make.figure import COLOURS, new_figure
from paper_repro.make.jobs import Results
from paper_repro.make.projection import View
from paper_repro.measure.posed import PosedArm
from prioritized_ik.models import Arm
from prioritized_ik.validation import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ARM = Arm()
WAVE = 0.2  # [rad] amplitude of the bends in the pose, which is made for showing the arm, not for winding
VIEW = View(azimuth=-1.2, elevation=0.6)
CLOSE_VIEW = View(azimuth=-1.1, elevation=0.6)
SHOWN = 4  # links in the close view, the last ones
AXIS = 0.034  # [m] length of a drawn axis, to either side 0.4 of it
INKS = {"x": ("green", ":"), "y": ("orange", "--"), "z": ("blue", "-")}
NAMES = {"x": "local x, along the link (twist)", "y": "local y", "z": "local z"}


def build(scale: Scale, results: Results) -> "Figure":
    """Return the figure."""
    del scale, results
    arm = PosedArm.of(ARM, pose())
    figure, axes = new_figure(2, 1, height=4.2, height_ratios=[1.15, 1.0])
    _draw_whole(axes[0], arm)
    _draw_close(axes[1], arm)
    _draw_legend(figure)
    return figure


def pose() -> Array:
    """Return a pose that shows every link `(49,)` [rad]: a wave about z, a gentler one about y."""
    q = []
    for link in ARM.link_numbers:
        phase = 2.0 * np.pi * link / ARM.links
        bend = {"x": 0.0, "y": 0.5 * WAVE * np.cos(phase), "z": WAVE * np.cos(1.3 * phase)}
        q += [bend[axis] for axis in ARM.hinge_axes(link)]
    return np.array(q)


def joint_numbers() -> list[tuple[int, ...]]:
    """Return the numbers of the joints at the base of each link, from 1."""
    numbers, following = [], 1
    for link in ARM.link_numbers:
        count = len(ARM.hinge_axes(link))
        numbers.append(tuple(range(following, following + count)))
        following += count
    return numbers


def _ends(arm: PosedArm) -> Array:
    return np.vstack([arm.bases, arm.bases[-1] + ARM.link_length * arm.directions[-1]])


def _draw_whole(ax: Any, arm: PosedArm) -> None:
    ends = VIEW.page(_ends(arm))
    ax.plot(*ends.T, color="#BBBBBB", linewidth=6.0, solid_capstyle="round", zorder=1)
    for link, numbers in enumerate(joint_numbers()):
        _draw_axes(ax, arm, numbers, VIEW, 0.7)
        text = f"{numbers[0]}–{numbers[-1]}" if len(numbers) > 1 else f"{numbers[0]}"
        below = link % 2 == 1
        ax.annotate(
            text, ends[link], xytext=(0, -19 if below else 15), textcoords="offset points", ha="center", fontsize=6.5
        )
    ax.plot(*ends[1:].T, "s", color=COLOURS["vermilion"], markersize=2.8, linestyle="none", zorder=6)
    _draw_frame(ax, VIEW, ends[0])
    total = ARM.links * ARM.link_length
    ax.set_title(f"{ARM.links} links of {ARM.link_length:g} m ({total:.2f} m), {ARM.joint_count} joints", fontsize=8)
    _fit(ax, ends, 0.075)


def _draw_close(ax: Any, arm: PosedArm) -> None:
    ends = CLOSE_VIEW.page(_ends(arm)[-SHOWN - 1 :])
    ax.plot(*ends.T, color="#BBBBBB", linewidth=15.0, solid_capstyle="round", zorder=1)
    for place, numbers in zip(ends, joint_numbers()[-SHOWN:], strict=False):
        _draw_axes(ax, arm, numbers, CLOSE_VIEW, 1.0, named=True)
        ax.plot(*place, "o", color="black", markersize=3.0, zorder=7)
    ax.plot(*ends[1:].T, "s", color=COLOURS["vermilion"], markersize=5.0, linestyle="none", zorder=6)
    for number, (start, end) in enumerate(itertools.pairwise(ends), start=ARM.links - SHOWN + 1):
        ax.annotate(f"link {number}", 0.5 * (start + end), xytext=(0, -17), textcoords="offset points", ha="center",
                    va="center", fontsize=7, zorder=8)  # fmt: skip
    ax.set_title(f"the last {SHOWN} links, and the numbers of their joints", fontsize=8)
    start, end = ends[-2], ends[-1]
    off = 0.026 * np.array([start[1] - end[1], end[0] - start[0]]) / np.linalg.norm(end - start)
    ax.annotate("", end + off, start + off, arrowprops={"arrowstyle": "<->", "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0})
    ax.annotate(f"{ARM.link_length:g} m", 0.5 * (start + end) + 1.6 * off, ha="center", va="center", fontsize=7)
    _fit(ax, ends, 0.045)


def _draw_legend(figure: "Figure") -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=COLOURS[INKS[letter][0]], linestyle=INKS[letter][1], label=f"joint about {NAMES[letter]}")
        for letter in ARM.hinge_order
    ]
    square = COLOURS["vermilion"]
    handles.append(Line2D([], [], marker="s", linestyle="none", color=square, label="virtual end point"))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))


def _draw_axes(ax: Any, arm: PosedArm, numbers: tuple[int, ...], view: View, size: float, named: bool = False) -> None:
    """Draw the axes of joints, each with an ink and dash of its local axis; `named` ones with their numbers."""
    for number in numbers:
        anchor, axis = arm.joint_anchors[number - 1], arm.joint_axes[number - 1]
        letter = "xyz"[int(np.argmax(np.abs(arm.model.jnt_axis[number - 1])))]
        ink, dash = INKS[letter]
        start, end = view.page(anchor - 0.4 * size * AXIS * axis), view.page(anchor + size * AXIS * axis)
        ax.plot(*np.array([start, end]).T, dash, color=COLOURS[ink], linewidth=1.3, zorder=4)
        if named:
            off = 7.0 * (end - start) / np.linalg.norm(end - start)
            ax.annotate(f"{number}", end, xytext=off, textcoords="offset points", ha="center", va="center", fontsize=7,
                        color=COLOURS[ink], zorder=9)  # fmt: skip


def _draw_frame(ax: Any, view: View, origin: Array) -> None:
    """Draw the directions of the world's axes."""
    corner = origin + np.array([0.05, -0.19])
    for letter, direction in zip("xyz", 0.09 * np.eye(3), strict=True):
        tip = corner + view.page(direction)
        ax.annotate("", tip, corner, arrowprops={"arrowstyle": "-|>", "linewidth": 0.9, "color": "#555555", "shrinkA": 0})
        ax.annotate(letter, corner + 1.22 * (tip - corner), ha="center", va="center", fontsize=7, color="#555555")


def _fit(ax: Any, points: Array, margin: float) -> None:
    ax.set_xlim(points[:, 0].min() - margin, points[:, 0].max() + margin)
    ax.set_ylim(points[:, 1].min() - margin, points[:, 1].max() + margin)
    ax.set_aspect("equal")
    ax.axis("off")


ARTEFACT = Artefact(
    "figure-5",
    "Fig. 5: the 17-link arm",
    """\
The arm of the simulations, drawn from the model in parallel projection: links (grey), the axes of its joints, and the
numbers of the joints at the base of each link, counted from the base as in the paper. Links 1 to 16 turn on balls of
three hinges whose axes meet in a point; link 17 has the one joint that is left, number 49. Squares are the 17 virtual
end points at the links' ends. The world's frame is at the base, and the arm lies along its x when every joint is
zero.

The paper states the number of links and joints, the links' length and that three adjoining joints make a ball. That
the hinges are ordered z, y, x from the base outward, that joint 49 turns about the local z, and the thickness of the
links, which is not drawn to scale here, are choices (see the table of choices; Table 2 for the other orders). The
pose is made for this drawing, and is in no winding.""",
    no_jobs,
    build,
)
