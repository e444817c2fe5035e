"""Pictures of an episode, rendered by MuJoCo off screen, with the backend that works here (`rendering`)."""

from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from prioritized_ik.models import WindingObject, update_kinematics
from prioritized_ik.pictures import STILL, kind_of, write_pictures
from prioritized_ik.rendering import use_working_backend
from prioritized_ik.validation import Array
from prioritized_ik.winding.cameras import SHOWN_LENGTH, View, cameras, cut_to_view, shown_part
from prioritized_ik.winding.episode import Episode
from prioritized_ik.winding.settings import WindingSettings

Colour = tuple[float, float, float]  # red, green, blue

TOUCHING = (0.93, 0.40, 0.47, 1.0)  # links in contact [rgba]
FRAMES = 60  # of an animation, evenly spaced over the episode
RATE = 20.0  # [frames/s]
WHITE = (1.0, 1.0, 1.0)
SKY = (WHITE, (0.86, 0.90, 0.94))
OUTSIDE = 2.0  # [m] an orthographic camera may stand anywhere in front of all there is to see


def frames(episode: Episode, steps: list[int], width: int = 960, height: int = 720) -> Iterator[NDArray[np.uint8]]:
    """Yield the picture `(height, width, 3)` of each of `steps` (0 to T), links in contact coloured."""
    spec = _spec(episode.settings, shown_part(episode), SKY, width, height)
    seen = cameras(episode, steps, width / height)
    yield from _drawn(spec, episode.settings, episode.q[steps], episode.in_contact[steps], seen)


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
    spec = _spec(settings, cut_to_view(settings.wound_object(), shown_length), (WHITE, WHITE), width, height)
    spec.visual.global_.fovy = view.height  # a length, as the camera is orthographic
    camera = mujoco.MjvCamera()
    camera.orthographic = 1
    camera.lookat[:] = view.centre
    camera.distance, camera.azimuth, camera.elevation = OUTSIDE, view.azimuth, view.elevation
    yield from _drawn(spec, settings, q, in_contact, [camera] * len(q))


def model_of(settings: WindingSettings) -> mujoco.MjModel:
    """Return the arm and the object, a long one cut short so that it does not hide the arm."""
    spec = settings.arm.spec()
    cut_to_view(settings.wound_object()).add_to(spec)
    return spec.compile()


def _spec(
    settings: WindingSettings, wound: WindingObject, sky: tuple[Colour, Colour], width: int, height: int
) -> mujoco.MjSpec:
    """Return the arm and the object before a sky that fades from one colour to another."""
    spec = settings.arm.spec()
    wound.add_to(spec)
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
    spec: mujoco.MjSpec,
    settings: WindingSettings,
    q: Array,
    in_contact: NDArray[np.bool_],
    seen: list[mujoco.MjvCamera],
) -> Iterator[NDArray[np.uint8]]:
    model = spec.compile()
    data = mujoco.MjData(model)
    links = [model.geom(name).id for name in settings.arm.link_geoms]
    model.geom_rgba[model.geom("object").id, 3] = 0.5
    colours = model.geom_rgba[links].copy()
    width, height = model.vis.global_.offwidth, model.vis.global_.offheight
    use_working_backend()
    with mujoco.Renderer(model, height, width) as renderer:
        for position, touching, camera in zip(q, in_contact, seen, strict=True):
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
