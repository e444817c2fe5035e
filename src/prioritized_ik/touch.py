"""What the arm feels: distances to the object, contact vectors, and contact with hysteresis.

This is the sensor: whoever controls the arm gets its readings, and never the object's size, shape or place. Distances are
MuJoCo's, and beside a cylinder, where that would iterate, those of lines.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from prioritized_ik.errors import InputError, ModelError
from prioritized_ik.jacobians import PointJacobians
from prioritized_ik.validation import Array, positive
from prioritized_ik.virtual_arms import object_id

REACH = 10.0  # [m]
OBJECT = "object"  # what a winding's object is called
_CAPSULE, _SPHERE = int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_SPHERE)
_CYLINDER = int(mujoco.mjtGeom.mjGEOM_CYLINDER)
ASKEW = 1e-4  # square of the sine of the angle between a link and a cylinder from which on one point of the link is nearest


@dataclass(frozen=True)
class Touch:
    """One reading of every link.

    Attributes:
        distance: between link and object `(n,)` [m], negative in penetration.
        normal: unit vectors from the object into the link at the nearest points `(n, 3)`; zero beyond the reach.
        point: the nearest point on each link `(n, 3)` [m]; of no meaning beyond the reach.
        approach: the most that a link came nearer from one of the sensor's readings to the next, so far [m]; None at its
            first.
    """

    distance: Array
    normal: Array
    point: Array
    approach: float | None = None


class TouchSensor:
    """Reads `Touch` for links that are capsules or spheres, whose normals stay exact down to zero distance.

    It remembers how fast links came nearer, for `contact_rows`: take one sensor a robot.

    Args:
        model: the MuJoCo model.
        link_geoms: one geom a link, base first, by name or number.
        object_geom: the object's geom, by name or number: any convex shape MuJoCo knows.
        reach: beyond this a link counts as this far away [m].

    Raises:
        ModelError: a geom that the model lacks, or a link that is neither capsule nor sphere.
        InputError: a reach that is not positive.

    Attributes:
        model: the MuJoCo model.
        links, object: numbers of the geoms.
        object_name: what the object's geom is called; contact rows are named by it.
        half_lengths, radii: of the links, of their cores and around them `(n,)` [m].
        cylinder: radius and half height of the object [m] if it is a cylinder, or None.
        reach: see above.
        jacobians: of points on the links, base first, then of points on the object.
        object_moves: whether a joint moves the object.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        link_geoms: Sequence[str | int],
        object_geom: str | int = OBJECT,
        *,
        reach: float = REACH,
    ) -> None:
        self.model = model
        self.reach = positive("reach", reach)
        self.links = np.array([object_id(model, "geom", name) for name in link_geoms], dtype=int)
        self.object = object_id(model, "geom", object_geom)
        self.object_name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, self.object) or f"geom {self.object}"
        for name, geom in zip(link_geoms, self.links, strict=True):
            if model.geom_type[geom] not in (_CAPSULE, _SPHERE):
                kind = mujoco.mjtGeom(model.geom_type[geom]).name
                raise ModelError(f"link geom {name!r} is a {kind}; expected a capsule or a sphere.")
        self.object_body = int(model.geom_bodyid[self.object])
        self.bodies = [int(body) for body in model.geom_bodyid[self.links]]
        self.jacobians = PointJacobians(model, [*self.bodies, self.object_body])
        self.object_moves = self.jacobians.moves(len(self.bodies))
        self._is_capsule = model.geom_type[self.links] == _CAPSULE
        self._last: Array | None = None  # distances of the reading before
        self._approach: float | None = None
        self.half_lengths = np.where(self._is_capsule, model.geom_size[self.links, 1], 0.0)
        self.radii = model.geom_size[self.links, 0]
        is_cylinder = model.geom_type[self.object] == _CYLINDER
        self.cylinder: tuple[float, float] | None = (
            tuple(model.geom_size[self.object, :2].tolist()) if is_cylinder else None
        )

    def read(self, data: mujoco.MjData) -> Touch:
        """Return the reading at the current positions of `data`. Needs `mj_kinematics`."""
        n = len(self.links)
        centre = data.geom_xpos[self.links]
        axis = data.geom_xmat[self.links].reshape(n, 3, 3)[:, :, 2]
        distance, point, is_known = self._beside_cylinder(data, centre, axis)
        segment = np.empty(6)  # from the nearest point on a link to that on the object
        for i in np.flatnonzero(~is_known).tolist():
            distance[i] = mujoco.mj_geomDistance(self.model, data, int(self.links[i]), self.object, self.reach, segment)
            point[i] = segment[:3]
        # The normal runs from the surface point to the capsule's core, a radius away: well defined at zero distance,
        # where the segment between the two nearest points is not.
        along = np.vecdot(point - centre, axis)
        along = np.minimum(np.maximum(along, -self.half_lengths), self.half_lengths)
        inward = centre + along[:, None] * axis - point
        size = np.sqrt((inward * inward).sum(axis=1))
        size[distance >= self.reach] = np.inf
        return Touch(distance, inward / size[:, None], point, self._approached(distance))

    def _beside_cylinder(self, data: mujoco.MjData, centre: Array, axis: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return distances, nearest points on the links, and where these are known, by links' `centre` and `axis` `(n, 3)`.

        They are where the object is a cylinder, and one point of the link's core is nearest to the cylinder's axis, outside
        the cylinder and between its ends: no point of the core is nearer to the cylinder then.
        """
        n = len(self.links)
        if self.cylinder is None:
            return np.empty(n), np.empty((n, 3)), np.zeros(n, dtype=bool)
        radius, half_height = self.cylinder
        turn = data.geom_xmat[self.object].reshape(3, 3)
        start, direction = (centre - data.geom_xpos[self.object]) @ turn, axis @ turn  # in the cylinder's axes
        askew = np.vecdot(direction[:, :2], direction[:, :2])
        along = -np.vecdot(start[:, :2], direction[:, :2]) / np.maximum(askew, ASKEW)
        along = np.minimum(np.maximum(along, -self.half_lengths), self.half_lengths)
        core = start + along[:, None] * direction
        off_axis = np.hypot(core[:, 0], core[:, 1])
        is_known = ((askew >= ASKEW) | ~self._is_capsule) & (np.abs(core[:, 2]) <= half_height) & (off_axis > radius)
        outward = core[:, :2] / np.where(is_known, off_axis, 1.0)[:, None]
        point = centre + along[:, None] * axis - self.radii[:, None] * (outward @ turn[:, :2].T)
        return np.minimum(off_axis - radius - self.radii, self.reach), point, is_known

    def _approached(self, distance: Array) -> float | None:
        """Return the most that a link came nearer from one reading to the next, this one included."""
        if self._last is not None:
            self._approach = max(self._approach or 0.0, float((self._last - distance).max(initial=0.0)))
        self._last = distance.copy()
        return self._approach


def update_contact(
    in_contact: NDArray[np.bool_], distance: Array, contact_distance: float, release_distance: float
) -> NDArray[np.bool_]:
    """Return which links are in contact now `(n,)`, given which were.

    A link makes contact at or below `contact_distance` [m] and loses it above `release_distance` [m].

    Raises:
        InputError: a distance that is not positive, or a release distance below the contact distance.
    """
    if positive("release_distance", release_distance) < positive("contact_distance", contact_distance):
        raise InputError(
            f"release_distance {release_distance} is below contact_distance {contact_distance}; expected it above."
        )
    return np.where(in_contact, distance <= release_distance, distance <= contact_distance)
