"""What a picture of an episode shows: the part of the object that is wound, and the arm as far as it still reaches."""

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from prioritized_ik.models import WindingObject
from prioritized_ik.validation import Array
from prioritized_ik.winding.episode import Episode

SHOWN_LENGTH = 2.2  # half length of a cylinder or capsule in a picture, in radii
BEYOND = 1.3  # how far it goes on beyond what is wound, in radii
LONG = ("cylinder", "capsule")  # shapes that are cut short
FIELD = 45.0  # height of a picture [deg]
ALONG, OBLIQUE = 0.1, np.array([0.45, -0.55, 0.55])  # the line of sight: of the object's axis, and beside it


@dataclass(frozen=True)
class View:
    """An orthographic view, of one scale all over.

    Attributes:
        azimuth, elevation: of the line of sight [deg], as MuJoCo counts them: 90 and 0 look along +y, with z up.
        centre: what is in the middle of the picture `(3,)` [m].
        width, height: of what is in the picture [m].
    """

    azimuth: float
    elevation: float
    centre: tuple[float, float, float]
    width: float
    height: float

    @property
    def axes(self) -> Array:
        """The directions to the right, up and towards the camera, a row each `(3, 3)`."""
        azimuth, elevation = np.radians([self.azimuth, self.elevation])
        right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
        up = np.array([-np.sin(elevation) * np.cos(azimuth), -np.sin(elevation) * np.sin(azimuth), np.cos(elevation)])
        return np.array([right, up, np.cross(right, up)])

    def project(self, points: Array) -> Array:
        """Return how far right of the middle and above it `points` `(..., 3)` are seen `(..., 2)` [m]."""
        return (points - np.array(self.centre)) @ self.axes[:2].T


def cut_to_view(wound: WindingObject, shown_length: float = SHOWN_LENGTH) -> WindingObject:
    """Return a long object cut short, so that it does not hide the arm. Only pictures see it so."""
    if wound.shape not in LONG:
        return wound
    return replace(wound, size=(wound.size[0], min(wound.size[1], shown_length * wound.size[0])))


def shown_part(episode: Episode) -> WindingObject:
    """Return the part of a long object that is wound at the end, and some more at both ends; see `cut_to_view`."""
    wound = episode.settings.wound_object()
    if wound.shape not in LONG:
        return wound
    radius, half = wound.size
    local = (episode.positions[-1] - wound.position) @ wound.rotation
    beside = np.hypot(local[:, 0], local[:, 1]) < 2.0 * radius + episode.settings.arm.radius
    heights = np.append(local[beside, 2], 0.0)
    lower = max(min(heights.min() - BEYOND * radius, -SHOWN_LENGTH * radius), -half)
    upper = min(max(heights.max() + BEYOND * radius, SHOWN_LENGTH * radius), half)
    centre = wound.position + 0.5 * (lower + upper) * wound.axis
    return replace(wound, size=(radius, 0.5 * (upper - lower)), position=centre)


def cameras(episode: Episode, steps: list[int], aspect: float) -> list[mujoco.MjvCamera]:
    """Return the camera of each of some steps, obliquely along the object's axis: each sees the arm there and from then on.

    Args:
        episode: what is shown.
        steps: of it, ascending.
        aspect: width of the picture to its height.
    """
    wound, radius = shown_part(episode), episode.settings.size[0]
    along = wound.axis if wound.axis[1] < 0.0 or abs(wound.axis[2]) > 0.5 else -wound.axis
    sight = -(ALONG * along + OBLIQUE)
    azimuth = float(np.degrees(np.arctan2(sight[1], sight[0])))
    elevation = float(np.degrees(np.arcsin(-abs(sight[2]) / np.linalg.norm(sight))))
    axes = View(azimuth, elevation, (0.0, 0.0, 0.0), 1.0, 1.0).axes
    half = wound.size[1] if wound.shape in LONG else radius
    still = [np.zeros(3), wound.position - half * wound.axis, wound.position + half * wound.axis]
    slopes = np.array([aspect, 1.0]) * np.tan(np.radians(0.5 * FIELD))
    made = []
    seen = np.array(still) @ axes.T
    for step in reversed(steps):
        seen = np.vstack([seen, episode.positions[step] @ axes.T])
        low, high = seen.min(axis=0), seen.max(axis=0)
        beside = seen - 0.5 * (low + high)
        camera = mujoco.MjvCamera()
        camera.azimuth, camera.elevation, camera.lookat[:] = azimuth, elevation, 0.5 * (low + high) @ axes
        camera.distance = float((beside[:, 2] + ((np.abs(beside[:, :2]) + radius) / slopes).max(axis=1)).max())
        made.append(camera)
    return made[::-1]
