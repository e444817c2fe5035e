"""Pictures of an episode, rendered by MuJoCo off screen, with the backend that works here (`rendering`)."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from prioritized_ik.models import WindingObject, update_kinematics
from prioritized_ik.pictures import STILL, kind_of, write_pictures
from prioritized_ik.rendering import use_working_backend
from prioritized_ik.validation import Array
from prioritized_ik.winding.episode import Episode
from prioritized_ik.winding.settings import WindingSettings

Colour = tuple[float, float, float]  # red, green, blue

TOUCHING = (0.93, 0.40, 0.47, 1.0)  # links in contact [rgba]
FRAMES = 60  # of an animation, evenly spaced over the episode
RATE = 20.0  # [frames/s]
SHOWN_LENGTH = 2.2  # half length of a cylinder or capsule in a picture, in radii
WHITE = (1.0, 1.0, 1.0)
SKY = (WHITE, (0.86, 0.90, 0.94))
OUTSIDE = 2.0  # [m] an orthographic camera may stand anywhere in front of all there is to see


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

    def project(self, points: Array) -> Array:
        """Return how far right of the middle and above it `points` `(..., 3)` are seen `(..., 2)` [m]."""
        azimuth, elevation = np.radians([self.azimuth, self.elevation])
        right = [np.sin(azimuth), -np.cos(azimuth), 0.0]
        up = [-np.sin(elevation) * np.cos(azimuth), -np.sin(elevation) * np.sin(azimuth), np.cos(elevation)]
        return (points - np.array(self.centre)) @ np.array([right, up]).T


def frames(episode: Episode, steps: list[int], width: int = 960, height: int = 720) -> Iterator[NDArray[np.uint8]]:
    """Yield the picture `(height, width, 3)` of each of `steps` (0 to T), links in contact coloured."""
    spec = _spec(episode.settings, SKY, SHOWN_LENGTH, width, height)
    yield from _drawn(spec, episode.settings, episode.q[steps], episode.in_contact[steps], _camera(episode))


def poses(
    settings: WindingSettings,
    q: Array,
    in_contact: NDArray[np.bool_],
    view: View,
    resolution: float,
    shown_length: float = SHOWN_LENGTH,
) -> Iterator[NDArray[np.uint8]]:
    """Yield the picture of each pose on white, links in contact coloured.

    Args:
        settings: of the arm and the object.
        q: joint positions `(k, m)` [rad].
        in_contact: M `(k, n)`.
        view: what to show.
        resolution: pixels a metre.
        shown_length: half length of a cylinder or capsule, in radii.
    """
    width, height = round(view.width * resolution), round(view.height * resolution)
    spec = _spec(settings, (WHITE, WHITE), shown_length, width, height)
    spec.visual.global_.fovy = view.height  # a length, as the camera is orthographic
    camera = mujoco.MjvCamera()
    camera.orthographic = 1
    camera.lookat[:] = view.centre
    camera.distance, camera.azimuth, camera.elevation = OUTSIDE, view.azimuth, view.elevation
    yield from _drawn(spec, settings, q, in_contact, camera)


def model_of(settings: WindingSettings) -> mujoco.MjModel:
    """Return the arm and the object, a long one cut short so that it does not hide the arm."""
    spec = settings.arm.spec()
    _cut_to_view(settings.wound_object(), SHOWN_LENGTH).add_to(spec)
    return spec.compile()


def _spec(
    settings: WindingSettings, sky: tuple[Colour, Colour], shown_length: float, width: int, height: int
) -> mujoco.MjSpec:
    """Return the arm and the object before a sky that fades from one colour to another."""
    spec = settings.arm.spec()
    _cut_to_view(settings.wound_object(), shown_length).add_to(spec)
    spec.visual.global_.offwidth, spec.visual.global_.offheight = width, height
    spec.visual.headlight.ambient = [0.45, 0.45, 0.45]
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=sky[0],
        rgb2=sky[1],
        width=64,
        height=64,
    )
    return spec


def _drawn(
    spec: mujoco.MjSpec, settings: WindingSettings, q: Array, in_contact: NDArray[np.bool_], camera: mujoco.MjvCamera
) -> Iterator[NDArray[np.uint8]]:
    model = spec.compile()
    data = mujoco.MjData(model)
    links = [model.geom(name).id for name in settings.arm.link_geoms]
    model.geom_rgba[model.geom("object").id, 3] = 0.5
    colours = model.geom_rgba[links].copy()
    width, height = model.vis.global_.offwidth, model.vis.global_.offheight
    use_working_backend()
    with mujoco.Renderer(model, height, width) as renderer:
        for position, touching in zip(q, in_contact, strict=True):
            model.geom_rgba[links] = np.where(touching[:, None], TOUCHING, colours)
            update_kinematics(model, data, position)
            mujoco.mj_camlight(model, data)
            renderer.update_scene(data, camera)
            yield renderer.render()


def record(episode: Episode, path: str | Path) -> None:
    """Write the last state to a `.png`, or the whole winding to a `.gif`, `.webp` or `.mp4`.

    Raises:
        InputError: another kind of file, no way to render here, or a place that is not writable.
        MissingExtraError: the extra `render` is not installed.
    """
    last = len(episode.q) - 1
    still = kind_of(path) == STILL
    steps = [last] if still else [round(s) for s in np.linspace(0, last, min(FRAMES, last + 1))]
    write_pictures(path, list(frames(episode, steps)), RATE)


def _cut_to_view(wound: WindingObject, shown_length: float) -> WindingObject:
    """Return a long object cut short, so that it does not hide the arm. Only pictures see it so."""
    if wound.shape not in ("cylinder", "capsule"):
        return wound
    return replace(wound, size=(wound.size[0], min(wound.size[1], shown_length * wound.size[0])))


def _camera(episode: Episode) -> mujoco.MjvCamera:
    """Return a camera that sees the arm's whole path, obliquely along the object's axis."""
    settings = episode.settings
    wound = settings.wound_object()
    reach = settings.link * settings.arm.link_length
    camera = mujoco.MjvCamera()
    camera.lookat[:] = 0.5 * (wound.position + np.array([0.5 * reach, 0.0, 0.0]))
    camera.distance = 1.1 * reach + 4.0 * settings.size[0]
    along = wound.axis if wound.axis[1] < 0.0 or abs(wound.axis[2]) > 0.5 else -wound.axis
    view = 0.8 * along + np.array([0.45, -0.55, 0.55])
    camera.azimuth = float(np.degrees(np.arctan2(-view[1], -view[0])))
    camera.elevation = -float(np.degrees(np.arcsin(abs(view[2]) / np.linalg.norm(view))))
    return camera
