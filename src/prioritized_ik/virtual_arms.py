"""Virtual arms: end points on a robot's links, their positions and stacked Jacobian (Sec. 2, Eqs. 1-5)."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from prioritized_ik.errors import InputError, ModelError
from prioritized_ik.jacobians import PointJacobians
from prioritized_ik.validation import Array, finite_array

_OBJECT_TYPES = {
    "site": mujoco.mjtObj.mjOBJ_SITE,
    "body": mujoco.mjtObj.mjOBJ_BODY,
    "geom": mujoco.mjtObj.mjOBJ_GEOM,
}


@dataclass(frozen=True)
class EndPoint:
    """A virtual end point: a point fixed to a site, body or geom of the model.

    Attributes:
        kind: `"site"`, `"body"` or `"geom"`.
        name: its name in the model, or its number: most geoms have no name.
        offset: the point in the frame of that site, body or geom [m].
    """

    kind: str
    name: str | int
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)


def object_id(model: mujoco.MjModel, kind: str, name: str | int) -> int:
    """Return the id of the `kind` ("site", "body" or "geom") called `name`, or of that number.

    Raises:
        ModelError: there is none; the message lists what there is.
    """
    if kind not in _OBJECT_TYPES:
        raise ModelError(f"unknown kind of end point {kind!r}; choose one of: {', '.join(_OBJECT_TYPES)}.")
    count = {"site": model.nsite, "body": model.nbody, "geom": model.ngeom}[kind]
    if isinstance(name, int | np.integer):
        found = int(name) if 0 <= name < count else -1
    else:
        found = mujoco.mj_name2id(model, _OBJECT_TYPES[kind], name)
    if found < 0:
        names = [mujoco.mj_id2name(model, _OBJECT_TYPES[kind], i) for i in range(count)]
        known = ", ".join(n for n in names if n) or "none"
        raise ModelError(f"the model has no {kind} called {name!r}; its {kind}s: {known}.")
    return int(found)


class VirtualArms:
    """The n virtual arms of a model: each ends at a point on one of its links.

    Args:
        model: any MuJoCo model; m is its number of degrees of freedom `nv`.
        points: the end points; a plain string names a site.
        axes: which world axes make the task space: `"xyz"` (l = 3), `"xy"` (planar, l = 2), …

    Raises:
        ModelError: a point that the model does not have, no point at all, or unknown axes.

    Attributes:
        bodies: which carry the end points `(n,)`.
        offsets: the end points in these bodies' frames `(n, 3)` [m].
        jacobians: of points on these bodies.
    """

    def __init__(self, model: mujoco.MjModel, points: Sequence[EndPoint | str], axes: str = "xyz") -> None:
        wrong = [point for point in points if not isinstance(point, str | EndPoint)]
        if isinstance(points, str) or not points or wrong:
            raise ModelError(f"points is {points!r}; expected a list of at least one site name or EndPoint.")
        if not axes or len(set(axes)) != len(axes) or set(axes) - set("xyz"):
            raise ModelError(f"axes is {axes!r}; expected some of x, y and z, each once, such as 'xyz' or 'xy'.")
        self.model = model
        self.points = tuple(EndPoint("site", p) if isinstance(p, str) else p for p in points)
        self.axes = axes
        self._rows = ["xyz".index(axis) for axis in axes]
        located = [_locate(model, point) for point in self.points]
        self.bodies = np.array([body for body, _ in located])
        self.jacobians = PointJacobians(model, self.bodies.tolist())
        self.offsets = np.array([offset for _, offset in located])  # (n, 3), body frame

    @property
    def count(self) -> int:
        """Number of virtual arms n."""
        return len(self.points)

    @property
    def dimension(self) -> int:
        """Dimension of the task space l."""
        return len(self._rows)

    def positions(self, data: mujoco.MjData) -> Array:
        """Return the end points `(n, l)` [m]. Needs `mj_kinematics` (see `models.update_kinematics`)."""
        points = self._world_points(data)
        return points if self._rows == [0, 1, 2] else points[:, self._rows]

    def jacobian(self, data: mujoco.MjData) -> Array:
        """Return the stacked Jacobian J `(L, m)` with dX_v = J dθ, L = l n (Eqs. 1, 3). Needs `mj_comPos`."""
        blocks = self.jacobians.at(data, self._world_points(data))  # Eq. (1)
        if self._rows != [0, 1, 2]:
            blocks = blocks[:, self._rows]
        return blocks.reshape(-1, self.model.nv)

    def _world_points(self, data: mujoco.MjData) -> Array:
        rotations = data.xmat[self.bodies].reshape(-1, 3, 3)
        return data.xpos[self.bodies] + (rotations @ self.offsets[:, :, None])[:, :, 0]


def jacobian_of_inner_arm(
    linear: ArrayLike, angular: ArrayLike, last_point: ArrayLike, inner_point: ArrayLike, joints_before: int
) -> Array:
    """Return the Jacobian `(3, m)` of an inner virtual arm from that of the whole arm, Eq. (2) corrected.

    The printed form J^n diag(I_r, 0) keeps the lever arm of the wrong end point; moving the point from p_n to p_i adds
    [p_n - p_i]_x J_ω, and only then may the columns after joint r be dropped.

    Args:
        linear: Jacobian of the last end point's velocity J_v `(3, m)`.
        angular: Jacobian of the last link's angular velocity J_ω `(3, m)`.
        last_point: p_n `(3,)` [m].
        inner_point: p_i `(3,)` [m].
        joints_before: r, the number of joints between the base and the inner end point.
    """
    j_v = finite_array("linear", linear, (3, None))
    m = j_v.shape[1]
    j_w = finite_array("angular", angular, (3, m))
    lever = finite_array("last_point", last_point, (3,)) - finite_array("inner_point", inner_point, (3,))
    if not 0 <= joints_before <= m:
        raise InputError(f"joints_before is {joints_before}; expected 0 to {m}.")
    moved = j_v + np.cross(lever, j_w, axisb=0, axisc=0)
    moved[:, joints_before:] = 0.0
    return moved


def joint_torques(jacobian: ArrayLike, forces: ArrayLike) -> Array:
    """Return τ = Jᵀ F_v `(m,)` [N·m] from end-point forces `(L,)` [N] (Eqs. 4, 5)."""
    j = finite_array("jacobian", jacobian, (None, None))
    return j.T @ finite_array("forces", forces, (j.shape[0],))


def joint_stiffness(jacobian: ArrayLike, end_point_stiffness: ArrayLike) -> Array:
    """Return K_a = Jᵀ K_v J `(m, m)` [N·m/rad] from the end points' stiffness K_v `(L, L)` [N/m] (Fig. 2)."""
    j = finite_array("jacobian", jacobian, (None, None))
    return j.T @ finite_array("end_point_stiffness", end_point_stiffness, (j.shape[0], j.shape[0])) @ j


def _locate(model: mujoco.MjModel, point: EndPoint) -> tuple[int, Array]:
    """Return the body that carries `point`, and the point in that body's frame."""
    found = object_id(model, point.kind, point.name)
    offset = finite_array(f"offset of {point.kind} {point.name!r}", point.offset, (3,))
    if point.kind == "body":
        return found, offset
    body, position, quaternion = (
        (model.site_bodyid, model.site_pos, model.site_quat)
        if point.kind == "site"
        else (model.geom_bodyid, model.geom_pos, model.geom_quat)
    )
    turned = np.empty(3)
    mujoco.mju_rotVecQuat(turned, offset, quaternion[found])
    return int(body[found]), position[found] + turned
