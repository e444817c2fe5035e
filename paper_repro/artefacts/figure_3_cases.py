"""Figure 3: the three cases of virtual arms on the five-link planar arm."""

from typing import TYPE_CHECKING, Any

import numpy as np

from paper_repro.make.artefact import Artefact, Scale, no_jobs
from paper_repro.make.figure import COLOURS, new_figure
from paper_repro.make.jobs import Results
from paper_repro.measure.planar_cases import CASES, PLANAR, Case, case_arm
from paper_repro.measure.posed import PosedArm
from prioritized_ik.solvers.closed_form import rank_decomposition_svd, task_case

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MARGIN = 0.03  # [m]
EQUATIONS = {"REDUNDANT": "Eq. 16", "OVERCONSTRAINED": "Eq. 17", "SINGULAR": "only Eqs. 12 and 14"}


def build(scale: Scale, results: Results) -> "Figure":
    """Return the figure."""
    del scale, results
    figure, axes = new_figure(2, 3, height=3.5, height_ratios=[1.25, 1.0], sharey="row")
    for (letter, case), column in zip(CASES.items(), axes.T, strict=True):
        arm = case_arm(case)
        _draw_arm(column[0], arm, case)
        _draw_values(column[1], arm)
        rows, m = arm.jacobian.shape
        rank = rank_decomposition_svd(arm.jacobian).rank
        column[0].set_title(f"({letter}) {case.title}\nn = {arm.arms.count}, L = {rows}, m = {m}, p = {rank}")
        column[1].set_title(EQUATIONS[task_case(arm.jacobian).name], fontsize=8)
    axes[1, 0].set_ylabel("singular values of J [m/rad]")
    return figure


def _draw_arm(ax: Any, arm: PosedArm, case: Case) -> None:
    tip = arm.bases[-1] + PLANAR.link_length * arm.directions[-1]
    points = np.vstack([arm.bases, tip])[:, :2]
    ax.plot(*points.T, color="#BBBBBB", linewidth=5.0, solid_capstyle="round", zorder=1)
    ax.plot(*points[:-1].T, "o", color="black", markersize=6.0, markerfacecolor="white", linestyle="none", zorder=2)
    for joint, place in enumerate(points[:-1], start=1):
        ax.annotate(f"{joint}", place, xytext=(0, -12), textcoords="offset points", ha="center", fontsize=6.5)
    for number, (name, end) in enumerate(zip(case.points, arm.positions, strict=True), start=1):
        actual = name == case.points[-1]
        ink, marker = (COLOURS["black"], "v") if actual else (COLOURS["vermilion"], "s")
        ax.plot(*end, marker, color=ink, markersize=5.5, zorder=3)
        ax.annotate(f"$X^{number}$", end, xytext=(-10, 7), textcoords="offset points", color=ink, fontsize=8.5)
    ax.set_xlim(points[:, 0].min() - MARGIN, points[:, 0].max() + MARGIN)
    ax.set_ylim(points[:, 1].min() - MARGIN, points[:, 1].max() + MARGIN)
    ax.set_aspect("equal")
    ax.axis("off")


def _draw_values(ax: Any, arm: PosedArm) -> None:
    values = np.linalg.svd(arm.jacobian, compute_uv=False)
    rank = rank_decomposition_svd(arm.jacobian).rank
    places = np.arange(1, len(values) + 1)
    ax.bar(places[:rank], values[:rank], width=0.6, color=COLOURS["blue"])
    for place, value in zip(places, values, strict=True):
        text = f"{value:#.2g}" if place <= rank else "0"
        ink = "black" if place <= rank else COLOURS["vermilion"]
        ax.annotate(text, (place, value), xytext=(0, 2), textcoords="offset points", ha="center", fontsize=7, color=ink)
    ax.set_xticks(places, [f"σ{place}" for place in places])
    ax.set_xlim(0.4, PLANAR.joint_count + 0.6)
    ax.grid(axis="x", visible=False)
    ax.margins(y=0.15)


ARTEFACT = Artefact(
    "figure-3",
    "Fig. 3: the three cases of virtual arms",
    """\
The five-link planar arm (l = 2, m = 5) with the end points of the paper's three cases, drawn from the model, and
below each the singular values of its stacked Jacobian. Squares are end points of virtual arms, the triangle is the
actual one; circles are joints. (a) One virtual arm, on link 3: as many nonzero singular values as rows, so that every
request can be met. (b) A virtual arm at every joint: more rows than joints, none of the values zero; a request is met
as well as the weights say. (c) A virtual arm at joint 5: fewer rows than joints, as in (a), and yet one value is
zero, because only the direction of link 5 lies between the two end points. Rank and case do not depend on the pose,
as long as it is bent; the pose is a choice, and the values do. Table 3 has what Eqs. 12 to 17 give in the same pose.""",
    no_jobs,
    build,
)
