"""Figure 2: joint space and virtual end-point space, what leads from one to the other, and within what error."""

from typing import TYPE_CHECKING, Any

import numpy as np

from paper_repro.make.artefact import Artefact, Scale, no_jobs
from paper_repro.make.figure import COLOURS, new_figure
from paper_repro.make.jobs import Results
from paper_repro.measure import audit
from paper_repro.measure.posed import relative_error
from prioritized_ik.solvers.closed_form import rank_decomposition_svd
from prioritized_ik.virtual_arms import joint_stiffness, joint_torques

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEFT, RIGHT = 1.45, 7.55  # middles of the two spaces, in tenths of the figure's width
TOP, BOTTOM = 3.55, 1.0  # heights of displacements and forces
HALF_WIDTH, HALF_HEIGHT = 1.0, 0.36  # of a box
HALF_SPACE = 1.25  # half the width of a space's frame
SEED = 2


def build(scale: Scale, results: Results) -> "Figure":
    """Return the figure."""
    del scale, results
    figure, ax = new_figure(height=3.3)
    ax.set_xlim(0.0, 9.0)
    ax.set_ylim(-0.35, 5.0)
    ax.axis("off")
    shapes, errors = measured()
    _draw_spaces(ax)
    _draw_boxes(ax, shapes)
    _draw_arrows(ax, shapes, errors)
    return figure


def measured() -> tuple[dict[str, str], dict[str, float]]:
    """Return the shapes of everything drawn, and the errors of the relations, on the arm of Fig. 5 in a general pose."""
    arm, rng = audit.posed(), np.random.default_rng(SEED)
    jacobian = arm.jacobian
    dtheta, springs = 1e-2 * rng.normal(size=audit.M), np.diag(rng.uniform(50.0, 500.0, audit.L))
    dx = jacobian @ dtheta
    forces = springs @ dx
    torques, stiffness = joint_torques(jacobian, forces), joint_stiffness(jacobian, springs)
    matrix, weights, desired = audit.request(SEED)
    step = audit.eqs_12_and_14(rank_decomposition_svd(matrix), weights, desired)
    shapes = {
        name: " × ".join(map(str, np.shape(value)))
        for name, value in {
            "dtheta": dtheta, "tau": torques, "k_a": stiffness, "dx": dx, "f": forces, "k_v": springs, "j": jacobian,
            "jt": jacobian.T,
        }.items()
    }  # fmt: skip
    errors = {
        "j": relative_error(dx, audit.difference_of_positions(arm) @ dtheta),
        "jt": relative_error(torques @ dtheta, forces @ dx),
        "k": relative_error(stiffness @ dtheta, torques),
        "inverse": relative_error(step, audit.pseudoinverse_answer(matrix, weights, desired)),
    }
    return shapes, errors


def _draw_spaces(ax: Any) -> None:
    from matplotlib.patches import FancyBboxPatch

    for middle, title, ink in (
        (LEFT, "joint space (actual arm)", COLOURS["blue"]),
        (RIGHT, "end-point space (virtual arms)", COLOURS["vermilion"]),
    ):
        corner = (middle - HALF_SPACE, BOTTOM - 0.95)
        frame = FancyBboxPatch(
            corner, 2.0 * HALF_SPACE, TOP - BOTTOM + 1.75, boxstyle="round,pad=0,rounding_size=0.15", linewidth=1.0,
            edgecolor=ink, facecolor=ink, alpha=0.10,
        )  # fmt: skip
        ax.add_patch(frame)
        ax.text(middle, TOP + 1.05, title, ha="center", fontsize=8, fontweight="bold")


def _draw_boxes(ax: Any, shapes: dict[str, str]) -> None:
    from matplotlib.patches import FancyBboxPatch

    boxes = (
        (LEFT, TOP, "dθ, dθ*", "dtheta", "rad"),
        (LEFT, BOTTOM, "τ", "tau", "N·m"),
        (RIGHT, TOP, "$dX_v$, $dX_v$*", "dx", "m"),
        (RIGHT, BOTTOM, "$F_v$", "f", "N"),
    )
    for x, y, symbol, key, unit in boxes:
        corner = (x - HALF_WIDTH, y - HALF_HEIGHT)
        style = "round,pad=0,rounding_size=0.08"
        ax.add_patch(
            FancyBboxPatch(corner, 2 * HALF_WIDTH, 2 * HALF_HEIGHT, boxstyle=style, linewidth=1.0, facecolor="white")
        )
        ax.text(x, y, f"{symbol}   ({shapes[key]}) [{unit}]", ha="center", va="center", fontsize=8)


def _draw_arrows(ax: Any, shapes: dict[str, str], errors: dict[str, float]) -> None:
    inside, outside = LEFT + HALF_WIDTH, RIGHT - HALF_WIDTH
    middle = 0.5 * (LEFT + RIGHT)
    _arrow(ax, (inside, TOP + 0.18), (outside, TOP + 0.18))
    ax.text(middle, TOP + 0.28, f"J ({shapes['j']}) [m/rad]", ha="center", fontsize=8)
    ax.text(middle, TOP + 0.62, f"Eq. 3: $dX_v$ = J dθ, within {errors['j']:.0e}", ha="center", fontsize=7)
    _arrow(ax, (outside, TOP - 0.18), (inside, TOP - 0.18), "--")
    ax.text(middle, TOP - 0.44, "Eqs. 12 and 14: weighted least squares, least norm", ha="center", fontsize=7)
    ax.text(
        middle,
        TOP - 0.74,
        f"dθ* = $(W^{{1/2}}J)^+ W^{{1/2}} dX_v$*, within {errors['inverse']:.0e}",
        ha="center",
        fontsize=7,
    )
    _arrow(ax, (outside, BOTTOM), (inside, BOTTOM))
    ax.text(middle, BOTTOM + 0.12, f"$J^T$ ({shapes['jt']}) [m/rad]", ha="center", fontsize=8)
    ax.text(middle, BOTTOM - 0.3, "Eq. 5: τ = $J^T F_v$", ha="center", fontsize=7)
    ax.text(
        middle, BOTTOM - 0.6, f"virtual work $τ^T$dθ = $F_v^T dX_v$, within {errors['jt']:.0e}", ha="center", fontsize=7
    )
    for x, key, symbol, law, unit in (
        (LEFT, "k_a", "$K_a$", "τ = $K_a$ dθ", "N·m/rad"),
        (RIGHT, "k_v", "$K_v$", "$F_v$ = $K_v dX_v$", "N/m"),
    ):
        _arrow(ax, (x - 0.55, TOP - HALF_HEIGHT), (x - 0.55, BOTTOM + HALF_HEIGHT))
        height = 0.5 * (TOP + BOTTOM)
        ax.text(x - 0.43, height + 0.33, f"{symbol} ({shapes[key]})", va="center", fontsize=8)
        ax.text(x - 0.43, height, f"[{unit}]", va="center", fontsize=7)
        ax.text(x - 0.43, height - 0.33, law, va="center", fontsize=7)
    frame = {"boxstyle": "round,pad=0.3", "facecolor": "#F2F2F2", "edgecolor": "#999999", "linewidth": 0.6}
    relation = f"$K_a$ = $J^T K_v$ J, within {errors['k']:.0e}"
    ax.text(middle, 0.5 * (TOP + BOTTOM) - 0.12, relation, ha="center", fontsize=8, bbox=frame)


def _arrow(ax: Any, start: tuple[float, float], end: tuple[float, float], dash: str = "-") -> None:
    style = {"arrowstyle": "-|>", "linewidth": 1.3, "color": "black", "linestyle": dash, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", end, start, arrowprops=style)


ARTEFACT = Artefact(
    "figure-2",
    "Fig. 2: joint space and virtual end-point space",
    """\
What leads from the joint space of the actual arm to the end-point space of its virtual arms and back: displacements
above, forces below, stiffness between. Shapes are those of the 17-link arm. The errors were measured on its model in
a general pose when the figure was made, relative: J against central differences of the end points; the torques
against virtual work, with drawn springs and a drawn dθ; K_a dθ against the torques of the springs' forces; and the
inverse, Eqs. 12 and 14 with the weights of Eq. 23, against the pseudoinverse of W^½ J. The way back (dashed) is no
inverse of J, for J is singular: what the end points do is Eq. 15. The paper prints K_a and K_v without an equation;
the one in the middle follows from Eqs. 3 and 5. Its second approach, control of the arm by forces, is not part of
this library beyond Jᵀ and K_a.""",
    no_jobs,
    build,
)
