"""Pictures of a robot off screen, by MuJoCo's renderer."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType

import mujoco
import numpy as np

from prioritized_ik.pictures import Picture
from prioritized_ik.rendering import use_working_backend
from prioritized_ik.validation import Array
from prioritized_ik.viewer.marks import Mark

SKY = (0.94, 0.96, 0.98, 1.0)
ROOM = 3.2  # radii of what is seen: it fills a view of 45 degrees at 2.6
FAR = 15.0  # extents of the model; MuJoCo cuts at 50


@dataclass(frozen=True)
class Camera:
    """Where a picture is taken from.

    Attributes:
        azimuth: of the line of sight about the vertical [deg]; 90 looks along +y.
        elevation: of the line of sight [deg]; below zero looks down.
        distance: from what it looks at [m]; far enough to see all geoms but planes unless given.
        lookat: what it looks at `(3,)` [m]; the middle of all geoms but planes unless given.
    """

    azimuth: float = 130.0
    elevation: float = -15.0
    distance: float | None = None
    lookat: tuple[float, float, float] | None = None

    def of(self, model: mujoco.MjModel, data: mujoco.MjData) -> mujoco.MjvCamera:
        """Return the same as a camera of MuJoCo, that sees the model in the state it is in."""
        middle, radius = seen(model, data)
        camera = mujoco.MjvCamera()
        camera.azimuth, camera.elevation = self.azimuth, self.elevation
        camera.distance = ROOM * radius if self.distance is None else self.distance
        camera.lookat[:] = middle if self.lookat is None else self.lookat
        return camera


def seen(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, float]:
    """Return the middle of all geoms but planes `(3,)`, and how far the furthest reaches from there [m]."""
    solid = model.geom_type != int(mujoco.mjtGeom.mjGEOM_PLANE)
    if not solid.any():
        return np.array(model.stat.center), float(model.stat.extent)
    places, sizes = data.geom_xpos[solid], model.geom_rbound[solid, None]
    middle = 0.5 * ((places - sizes).min(axis=0) + (places + sizes).max(axis=0))
    return middle, float((np.linalg.norm(places - middle, axis=1) + sizes[:, 0]).max())


class Canvas:
    """Draws states of one model; to be closed, or used by `with`.

    Args:
        model: whose states are drawn; not changed.
        data: the first state.
        width: of the pictures [pixels].
        height: of the pictures [pixels].
        camera: where from.

    Raises:
        InputError: no way to render here.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, width: int, height: int, camera: Camera) -> None:
        use_working_backend()
        self._model = copy.deepcopy(model)
        self._model.vis.global_.offwidth = max(width, model.vis.global_.offwidth)
        self._model.vis.global_.offheight = max(height, model.vis.global_.offheight)
        self._model.vis.headlight.ambient[:] = np.maximum(model.vis.headlight.ambient, 0.35)
        self._model.vis.headlight.diffuse[:] = np.maximum(model.vis.headlight.diffuse, 0.5)
        self._camera = camera.of(model, data)
        self._renderer = mujoco.Renderer(self._model, height, width)

    def draw(self, data: mujoco.MjData, marks: Sequence[Mark] = ()) -> Picture:
        """Return the picture `(height, width, 3)` of a state, with marks."""
        mujoco.mj_camlight(self._model, data)
        self._renderer.update_scene(data, self._camera)
        add_marks(self._renderer.scene, [*marks, *self._backdrop()])
        picture: Picture = self._renderer.render()
        return picture

    def close(self) -> None:
        """Give the renderer back."""
        self._renderer.close()

    def __enter__(self) -> "Canvas":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _backdrop(self) -> list[Mark]:
        """Return a bright ball far behind what is seen: without a sky the background would be black."""
        azimuth, elevation = np.radians([self._camera.azimuth, self._camera.elevation])
        sight = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
        extent = float(self._model.stat.extent)
        radius = 20.0 * FAR * extent  # so large that its front is as good as flat
        return [Mark(np.array(self._camera.lookat) + (FAR * extent + radius) * sight, None, radius, SKY)]


def add_marks(scene: mujoco.MjvScene, marks: Sequence[Mark]) -> None:
    """Append marks to a scene, as many as it holds."""
    for mark in marks[: scene.maxgeom - scene.ngeom]:
        geom = scene.geoms[scene.ngeom]
        kind = mujoco.mjtGeom.mjGEOM_SPHERE if mark.end is None else mujoco.mjtGeom.mjGEOM_CAPSULE
        size: Array = np.full(3, mark.radius)
        mujoco.mjv_initGeom(geom, kind, size, mark.start, np.eye(3).ravel(), np.array(mark.colour, np.float32))
        if mark.end is not None:
            mujoco.mjv_connector(geom, kind, mark.radius, mark.start, mark.end)
        geom.emission, geom.specular = (1.0 if mark.colour == SKY else 0.4), 0.0
        scene.ngeom += 1
