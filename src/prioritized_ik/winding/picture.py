"""Pictures of an episode, rendered by MuJoCo off screen (set MUJOCO_GL=egl or osmesa where there is no display)."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from prioritized_ik.errors import InputError
from prioritized_ik.files import write_whole
from prioritized_ik.models import WindingObject, update_kinematics
from prioritized_ik.validation import one_of
from prioritized_ik.winding.episode import Episode

TOUCHING = (0.93, 0.40, 0.47, 1.0)  # links in contact [rgba]
KINDS = (".png", ".gif")
FRAMES = 60  # of an animation, evenly spaced over the episode
FRAME_MILLISECONDS = 50
SHOWN_LENGTH = 2.2  # half length of a cylinder or capsule in a picture, in radii


def frames(episode: Episode, steps: list[int], width: int = 960, height: int = 720) -> Iterator[NDArray[np.uint8]]:
    """Yield the picture `(height, width, 3)` of each of `steps` (0 to T), links in contact coloured."""
    spec = episode.settings.arm.spec()
    _cut_to_view(episode.settings.wound_object()).add_to(spec)
    spec.visual.global_.offwidth, spec.visual.global_.offheight = width, height
    spec.visual.headlight.ambient = [0.45, 0.45, 0.45]
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[1.0, 1.0, 1.0],
        rgb2=[0.86, 0.90, 0.94],
        width=64,
        height=64,
    )
    model = spec.compile()
    data = mujoco.MjData(model)
    links = [model.geom(name).id for name in episode.settings.arm.link_geoms]
    model.geom_rgba[model.geom("object").id, 3] = 0.5
    colours = model.geom_rgba[links].copy()
    camera = _camera(episode)
    with mujoco.Renderer(model, height, width) as renderer:
        for step in steps:
            model.geom_rgba[links] = np.where(episode.in_contact[step][:, None], TOUCHING, colours)
            update_kinematics(model, data, episode.q[step])
            mujoco.mj_camlight(model, data)
            renderer.update_scene(data, camera)
            yield renderer.render()


def kind_of(path: str | Path) -> str:
    """Return the kind of picture that `path` names, one of `KINDS`, or raise an `InputError`."""
    return one_of("kind of picture", Path(path).suffix.lower(), KINDS)


def record(episode: Episode, path: str | Path) -> None:
    """Write the last state to a `.png`, or the whole winding to a `.gif`.

    Raises:
        InputError: another kind of file, no way to render here, or a place that is not writable.
    """
    from PIL import Image

    kind = kind_of(path)
    last = len(episode.q) - 1
    steps = [last] if kind == ".png" else [round(s) for s in np.linspace(0, last, min(FRAMES, last + 1))]
    try:
        pictures = [Image.fromarray(frame) for frame in frames(episode, steps)]
    except (mujoco.FatalError, RuntimeError, AttributeError, ImportError) as error:
        raise InputError(
            f"cannot render here ({error}); without a display set MUJOCO_GL=egl (Debian: libegl1 and libgl1-mesa-dri)."
        ) from error
    rest = {"save_all": kind == ".gif", "append_images": pictures[1:], "duration": FRAME_MILLISECONDS, "loop": 0}
    try:
        write_whole(path, lambda file: pictures[0].save(file, kind[1:], **rest))
    except OSError as error:
        raise InputError(f"cannot write {str(path)!r} ({error}); choose a place that is writable.") from error


def _cut_to_view(wound: WindingObject) -> WindingObject:
    """Return a long object cut short, so that it does not hide the arm. Only pictures see it so."""
    if wound.shape not in ("cylinder", "capsule"):
        return wound
    return replace(wound, size=(wound.size[0], min(wound.size[1], SHOWN_LENGTH * wound.size[0])))


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
