"""Figure 1: an actual arm and three virtual arms, and the Jacobian that stacks them, from a model."""

from typing import TYPE_CHECKING, Any

import numpy as np

from paper_repro.make.artefact import Artefact, Scale, no_jobs
from paper_repro.make.figure import COLOURS, MARKERS, new_figure
from paper_repro.make.jobs import Results
from paper_repro.measure.posed import VIRTUAL_ARMS_OF, VIRTUAL_ENDS, PosedArm
from prioritized_ik.validation import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

POSE = np.array([1.25, -0.75, -0.8, 1.3])  # [rad]

ACTUAL = "end_4"

PLACES = ("at joint 2", "on link 3", "at joint 4", "at the end of link 4")
INKS = ("blue", "vermilion", "green", "black")
NAME_OFFSETS = ((-15, 5), (2, 8), (-9, -16), (-15, 5))  # [pt] where no link is
MARGIN = 0.02  # [m]


def build(scale: Scale, results: Results) -> "Figure":
    """Return the figure."""
    del scale, results
    arm = PosedArm.of(VIRTUAL_ARMS_OF, POSE, [*VIRTUAL_ENDS, ACTUAL], "xy")
    figure, axes = new_figure(1, 5, height=2.0, width_ratios=[1, 1, 1, 1, 0.95])
    for number, ax in enumerate(axes[:-1]):
        _draw_arm(ax, arm, number)
    _draw_jacobian(axes[-1], arm)
    return figure


def outline(arm: PosedArm) -> Array:
    """Return base, joints and tip of a planar arm `(links + 1, 2)` [m]."""
    tip = arm.bases[-1] + VIRTUAL_ARMS_OF.link_length * arm.directions[-1]
    return np.vstack([arm.bases, tip])[:, :2]


def _draw_arm(ax: Any, arm: PosedArm, number: int) -> None:
    """Draw virtual arm `number` (from 0) over the actual arm, which is the last."""
    points, end = outline(arm), arm.positions[number]
    ink = COLOURS[INKS[number]]
    joints = moving_joints(arm, number)
    ax.plot(*points.T, color="#CCCCCC", linewidth=5.0, solid_capstyle="round", zorder=1)
    ax.plot(*np.vstack([points[:joints], end]).T, color=ink, linewidth=2.4, solid_capstyle="round", zorder=2)
    ax.plot(*points[:-1].T, "o", color="#999999", markersize=5.0, markerfacecolor="white", zorder=3)
    ax.plot(*points[:joints].T, "o", color=ink, markersize=5.0, markerfacecolor="white", zorder=4)
    ax.plot(*end, MARKERS[number + 1], color=ink, markersize=6.5, zorder=5)
    ax.annotate(f"$X^{number + 1}$", end, xytext=NAME_OFFSETS[number], textcoords="offset points", color=ink, fontsize=9)
    for joint, place in enumerate(points[:-1], start=1):
        ax.annotate(f"{joint}", place, xytext=(6, -10), textcoords="offset points", ha="center", fontsize=6.5)
    name = "actual arm" if number == len(VIRTUAL_ENDS) else f"virtual arm {number + 1}"
    ax.set_title(f"{name}\n{PLACES[number]}", fontsize=7.5)
    ax.set_xlim(points[:, 0].min() - MARGIN, points[:, 0].max() + 1.6 * MARGIN)
    ax.set_ylim(points[:, 1].min() - 1.4 * MARGIN, points[:, 1].max() + 1.4 * MARGIN)
    ax.set_aspect("equal")
    ax.axis("off")


def moving_joints(arm: PosedArm, number: int) -> int:
    """Return how many joints move the end point `number` (from 0): the columns of J^i that are not zero."""
    block = arm.jacobian[2 * number : 2 * number + 2]
    return int(np.flatnonzero(np.abs(block).max(axis=0))[-1]) + 1


def _draw_jacobian(ax: Any, arm: PosedArm) -> None:
    """Draw J as cells, each with its value in mm/rad."""
    jacobian = arm.jacobian
    for (row, column), value in np.ndenumerate(jacobian):
        ink = COLOURS[INKS[row // 2]] if value else "white"
        ax.fill_between([column, column + 1], row, row + 1, color=ink, alpha=0.22, linewidth=0)
        text = f"{1e3 * value:.0f}".replace("-", "−") if value else "0"
        ax.text(
            column + 0.5, row + 0.5, text, ha="center", va="center", fontsize=6.5, color="black" if value else "#888888"
        )
    for edge in range(0, len(jacobian) + 1, 2):
        ax.axhline(edge, color="black", linewidth=0.6)
    ax.set_xlim(0, jacobian.shape[1])
    ax.set_ylim(len(jacobian), 0)
    ax.set_xticks(np.arange(jacobian.shape[1]) + 0.5, [str(joint + 1) for joint in range(jacobian.shape[1])])
    ax.set_yticks(np.arange(1, len(jacobian), 2), [f"$J^{number + 1}$" for number in range(len(jacobian) // 2)])
    ax.tick_params(length=0)
    ax.grid(False)
    ax.spines[:].set_visible(False)
    ax.set_xlabel("joint", fontsize=7)
    ax.set_title(f"J [mm/rad]\nL = {len(jacobian)}, m = {jacobian.shape[1]}", fontsize=7.5)


ARTEFACT = Artefact(
    "figure-1",
    "Fig. 1: an arm and its virtual arms",
    """\
Three virtual arms and the actual one, which counts as the last (n = 4), on a planar arm of four links: a schematic,
but drawn from the library's model and its `VirtualArms`. Each virtual arm shares base, joints and links with the
actual arm (grey) and ends earlier: at a joint, or on a link. Circles are joints, numbered from the base; the filled
markers are the end points X^i. On the right the stacked Jacobian J of Eq. 3 in this pose, in the same colours: arm i
moves with the joints before its end point only, so that the rest of J^i is zero and J has the shape of a staircase.
The paper's own figure has other, unstated angles; the pose here is a choice.""",
    no_jobs,
    build,
)
