"""Pictures of poses in space, side by side at one scale: rendered by MuJoCo, or drawn as lines where it cannot render."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from paper_repro.make.figure import COLOURS
from prioritized_ik.errors import InputError
from prioritized_ik.validation import Array
from prioritized_ik.winding.cameras import View
from prioritized_ik.winding.picture import poses
from prioritized_ik.winding.settings import WindingSettings

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HALF_LENGTH = 1.0  # of the object as it is shown, in radii
RIM = 48  # points on the rim of a cylinder
ROOM = 0.012  # [m] around what a picture shows: a link's radius and a little more


def line_of_sight(settings: WindingSettings) -> tuple[float, float]:
    """Return azimuth and elevation [deg] of a view along the object's axis, oblique, with the arm pointing to the right."""
    axis = settings.wound_object().axis
    if abs(axis[2]) > 0.5:
        return 75.0, -50.0
    along = float(np.degrees(np.arctan2(axis[1], axis[0]))) % 180.0  # looking along +y or nearly
    return along - 10.0, -22.0


def extent(settings: WindingSettings, positions: Array, sight: tuple[float, float]) -> Array:
    """Return the rectangle that a picture of the object and of ends of links `(…, 3)` needs.

    Returns:
        Its left, right, bottom and top `(4,)` [m], in a view centred at the origin.
    """
    seen = View(*sight, (0.0, 0.0, 0.0), 1.0, 1.0).project(np.vstack([positions.reshape(-1, 3), _rims(settings)]))
    low, high = seen.min(axis=0) - ROOM, seen.max(axis=0) + ROOM
    return np.array([low[0], high[0], low[1], high[1]])


def view_of(rectangle: Array, sight: tuple[float, float]) -> View:
    """Return the view that shows a rectangle (left, right, bottom, top) [m] of a view centred at the origin."""
    left, right, bottom, top = (float(side) for side in rectangle)
    flat = View(*sight, (0.0, 0.0, 0.0), right - left, top - bottom)
    axes = np.array([flat.project(axis) for axis in np.eye(3)])  # how far right and up each axis of the world is seen
    centre = axes @ [0.5 * (left + right), 0.5 * (bottom + top)]
    return replace(flat, centre=(float(centre[0]), float(centre[1]), float(centre[2])))


def rendered(
    settings: WindingSettings, q: Array, in_contact: NDArray[np.bool_], views: list[View], resolution: float
) -> list[NDArray[np.uint8]] | None:
    """Return one picture a pose, each in its own view, or None where MuJoCo cannot render.

    Args:
        settings: of arm and object.
        q: joint positions `(k, m)` [rad].
        in_contact: M `(k, n)`.
        views: k of them.
        resolution: pixels a metre.
    """
    try:
        return [
            next(poses(settings, q[i : i + 1], in_contact[i : i + 1], view, resolution, HALF_LENGTH))
            for i, view in enumerate(views)
        ]
    except InputError:
        return None


def draw_lines(
    axes: "Axes",
    settings: WindingSettings,
    positions: Array,
    in_contact: NDArray[np.bool_],
    view: View,
    points_per_metre: float,
) -> None:
    """Draw the object's outline and the links as lines, projected.

    Args:
        axes: in metres from the middle of the view.
        settings: of arm and object.
        positions: ends of the links `(n, 3)` [m].
        in_contact: M `(n,)`.
        view: what to show.
        points_per_metre: scale, for the width of the links.
    """
    rims = view.project(_rims(settings))
    axes.fill(*rims[ConvexHull(rims).vertices].T, facecolor="#EFE6B0", edgecolor=COLOURS["grey"], linewidth=0.6)
    front = rims[:RIM] if _nearer(settings, view) else rims[RIM:]
    axes.plot(*front.T, color=COLOURS["grey"], linewidth=0.6)
    joints = view.project(np.vstack([np.zeros(3), positions]))
    width = 2.0 * settings.arm.radius * points_per_metre
    for link, touching in enumerate(in_contact):
        style: dict[str, Any] = {"linewidth": width, "solid_capstyle": "round"}
        axes.plot(*joints[link : link + 2].T, color=COLOURS["vermilion" if touching else "blue"], **style)


def _rims(settings: WindingSettings) -> Array:
    """Return points `(2 RIM, 3)` [m] on the rims of the cylinder as it is shown."""
    wound = settings.wound_object()
    angle = np.linspace(0.0, 2.0 * np.pi, RIM)
    circle = wound.size[0] * np.column_stack([np.cos(angle), np.sin(angle)]) @ wound.rotation[:, :2].T
    half = min(wound.size[1], HALF_LENGTH * wound.size[0]) * wound.axis
    return np.vstack([wound.position + circle + half, wound.position + circle - half])


def _nearer(settings: WindingSettings, view: View) -> bool:
    """Whether the end of the object to which its axis points is the nearer one."""
    azimuth, elevation = np.radians([view.azimuth, view.elevation])
    forward = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    return bool(settings.wound_object().axis @ forward < 0.0)
