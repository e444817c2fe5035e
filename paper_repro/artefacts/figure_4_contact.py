"""Figure 4: a link in contact, the plane P, and where Eqs. 18-22 send the next link's end, from the library's plan."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from paper_repro.make.artefact import Artefact, Scale, no_jobs
from paper_repro.make.figure import COLOURS, new_figure
from paper_repro.make.jobs import Results
from paper_repro.make.projection import View
from prioritized_ik.models import Arm
from prioritized_ik.validation import Array
from prioritized_ik.winding import plan
from prioritized_ik.winding.settings import WindingSettings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RADIUS, LINK, THICK = WindingSettings().size[0], Arm().link_length, Arm().radius  # [m]
OUT_OF_PLANE, BEND = 0.5, 0.1  # [rad] of link k + 1: out of the plane P, which β is to mend, and away from the object
VIEW = View(azimuth=-1.1, elevation=0.42)
ARROW = 0.027  # [m] length of a unit vector
HALF_LENGTH = 0.06  # [m] shown of the cylinder, to either side


@dataclass(frozen=True)
class Contact:
    """Link k on the cylinder, link k + 1 off the plane, and what the plan makes of it; vectors `(3,)`.

    The cylinder's axis is y through the origin, and link k touches it on top, along x.
    """

    end_k: Array
    a_k: Array
    c_k: Array
    a_next: Array
    e: Array
    beta: Array
    gamma: Array
    alpha: Array

    @property
    def end_next(self) -> Array:
        """End of link k + 1 [m]."""
        return self.end_k + LINK * self.a_next


def contact() -> Contact:
    """Return the contact drawn, Eqs. 19 to 22 by the library's functions."""
    a_k, c_k = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    a_next = np.array([np.cos(OUT_OF_PLANE) * np.cos(BEND), -np.sin(OUT_OF_PLANE), np.cos(OUT_OF_PLANE) * np.sin(BEND)])
    e = plan.plane_normal(a_k, c_k)
    beta = plan.into_plane(plan.side_sign(a_next, e), e)
    gamma = plan.towards_object(a_next, e)
    end_k = np.array([0.5 * LINK, 0.0, RADIUS + THICK])
    return Contact(end_k, a_k, c_k, a_next, e, beta, gamma, plan.winding_direction(beta, gamma))


def build(scale: Scale, results: Results) -> "Figure":
    """Return the figure."""
    del scale, results
    figure, ax = new_figure(height=3.6, width=4.6)
    state = contact()
    _draw_object(ax)
    _draw_plane(ax, state)
    _draw_links(ax, state)
    _draw_vectors(ax, state)
    ax.set_aspect("equal")
    ax.margins(0.03)
    ax.axis("off")
    return figure


def _draw_object(ax: Any) -> None:
    """Draw the upper half of the cylinder: its two rims and the lines between them."""
    angles = np.linspace(0.0, np.pi, 60)
    rims = [
        np.column_stack([RADIUS * np.cos(angles), np.full_like(angles, y), RADIUS * np.sin(angles)])
        for y in (-HALF_LENGTH, HALF_LENGTH)
    ]
    near, far = (VIEW.page(rim) for rim in rims)
    ax.fill(*np.vstack([near, far[::-1]]).T, color="#EFE6C0", zorder=0)
    ax.fill(*near.T, color="#E4D79E", zorder=1)
    for rim, dash in ((near, "-"), (far, "--")):
        ax.plot(*rim.T, dash, color="#8A7A2E", linewidth=0.9, zorder=2)
    ax.text(
        *VIEW.page([0.0, -HALF_LENGTH, 0.35 * RADIUS]), f"object (Ø {2.0 * RADIUS:g} m)", ha="center", fontsize=7, zorder=3
    )


def _draw_plane(ax: Any, state: Contact) -> None:
    """Draw the part of the plane P, through link k and along its contact vector, that is above the object."""
    corners = [
        state.end_k + along * LINK * state.a_k + up * LINK * state.c_k
        for along, up in ((-1.35, -0.17), (1.45, -0.17), (1.45, 1.0), (-1.35, 1.0))
    ]
    page = VIEW.page(corners)
    ax.fill(*page.T, facecolor=COLOURS["sky"], alpha=0.25, edgecolor=COLOURS["blue"], linewidth=0.8, zorder=3)
    ax.annotate("P", page[3], xytext=(8, -12), textcoords="offset points", fontsize=9, color=COLOURS["blue"])


def _draw_links(ax: Any, state: Contact) -> None:
    base = state.end_k - LINK * state.a_k
    page = VIEW.page([base, state.end_k, state.end_next])
    ax.plot(*page[:2].T, color="#888888", linewidth=9.0, solid_capstyle="round", zorder=4)
    ax.plot(*page[1:].T, color="#BBBBBB", linewidth=9.0, solid_capstyle="round", zorder=5)
    ax.plot(*page[1:].T, "s", color=COLOURS["vermilion"], markersize=5.0, linestyle="none", zorder=9)
    for text, place, off in (
        ("link k", page[0], (2, 9)),
        ("link k + 1", 0.45 * page[1] + 0.55 * page[2], (-4, -17)),
    ):
        ax.annotate(text, place, xytext=off, textcoords="offset points", ha="center", fontsize=7.5, zorder=10)


def _draw_vectors(ax: Any, state: Contact) -> None:
    touching = state.end_k - 0.5 * LINK * state.a_k
    vectors = (
        (touching, state.c_k, "$c^k$", "black", "-", (0, 7)),
        (touching, state.a_k, "$a^k$", "black", "-", (-5, 9)),
        (touching, state.e, "$e^k$", "black", "-", (-9, -5)),
        (state.end_next, state.a_next, "$a^{k+1}$", "black", "-", (15, 4)),
        (state.end_next, state.beta, "$β^{k+1}$", "green", "--", (0, 9)),
        (state.end_next, state.gamma, "$γ^{k+1}$", "blue", ":", (0, -10)),
        (state.end_next, state.alpha, "$α^{k+1}$", "vermilion", "-", (15, -8)),
    )
    for start, vector, name, ink, dash, off in vectors:
        tail, tip = VIEW.page([start, start + ARROW * vector])
        style = {
            "arrowstyle": "-|>",
            "linewidth": 1.5,
            "color": COLOURS[ink],
            "linestyle": dash,
            "shrinkA": 0,
            "shrinkB": 0,
        }
        ax.annotate("", tip, tail, arrowprops=style, zorder=8)
        ax.annotate(name, tip, xytext=off, textcoords="offset points", ha="center", va="center", fontsize=9,
                    color=COLOURS[ink], zorder=10)  # fmt: skip
        ax.plot(*tip, alpha=0.0)  # arrows do not count towards the limits of the axes


ARTEFACT = Artefact(
    "figure-4",
    "Fig. 4: contact, and the winding direction",
    """\
Link k touches the object; link k + 1 does not yet, and has left the plane P of a^k and c^k. All vectors are those of
the library's functions of Eqs. 19 to 22, drawn in parallel projection, a unit vector with the same length everywhere:
c^k from the object into the link, e^k = a^k × c^k square to P, β^{k+1} back towards P, γ^{k+1} towards the object,
and their sum α^{k+1}, along which Eq. 18 moves the end of link k + 1 (square). The paper prints a and α alike in the
scan; which is which, and that c^k points into the link, is this library's reading (Table 1). The pose is made for
this drawing.""",
    no_jobs,
    build,
)
