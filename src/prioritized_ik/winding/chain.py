"""What winds: a chain of links that feel an object, on a robot."""

import copy
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from prioritized_ik.errors import ModelError
from prioritized_ik.models import Arm
from prioritized_ik.robot import Robot
from prioritized_ik.touch import TouchSensor
from prioritized_ik.validation import Array
from prioritized_ik.virtual_arms import EndPoint, VirtualArms

_CAPSULE, _CYLINDER = int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_CYLINDER)


@dataclass(frozen=True, eq=False)
class Chain:
    """Links in series, base first, each with a virtual arm that ends at its far end.

    Attributes:
        robot: which has them, and the object.
        arms: the virtual arms.
        sensor: of touch, one link geom each.
        bodies: of the links `(n,)`.
        along: unit directions of the links in their bodies' frames, towards the tip `(n, 3)`.
        lengths: of the links `(n,)` [m].
    """

    robot: Robot
    arms: VirtualArms
    sensor: TouchSensor
    bodies: NDArray[np.int_]
    along: Array
    lengths: Array

    @staticmethod
    def of_arm(arm: Arm, model: mujoco.MjModel, reach: float) -> "Chain":
        """Return the chain of an arm in a model with an object, that feels it as far as `reach` [m]."""
        return Chain(
            Robot(model),
            VirtualArms(model, arm.end_sites),
            TouchSensor(model, arm.link_geoms, reach=reach),
            np.array([model.body(name).id for name in arm.link_geoms]),
            np.tile([1.0, 0.0, 0.0], (arm.links, 1)),
            np.full(arm.links, arm.link_length),
        )

    @staticmethod
    def of_robot(robot: Robot, tip: str | int, wound: str | int, reach: float) -> "Chain":
        """Return the chain of a robot's links from its base to a body: those bodies on the way that have a capsule.

        Args:
            robot: where it starts; it tells the ends of the capsules apart.
            tip: the last body.
            wound: the object's geom, or a body that has no other.
            reach: how far links feel it [m].

        Raises:
            InputError: a body or geom that does not exist.
            ModelError: fewer than two links.
        """
        geoms = _longest_to(robot.model, robot.body(tip), _CAPSULE)
        if len(geoms) < 2:
            last = robot.names("body")[robot.body(tip)]
            raise ModelError(
                f"{len(geoms)} bodies from the base to {last!r} have a capsule; expected two links or more. Give each one, "
                "or a cylinder, beside its meshes and boxes: winding feels nothing else. In a URDF that is a <cylinder>."
            )
        model, axes = robot.model, _towards_tip(robot, geoms)
        halves = model.geom_size[geoms, 1]
        ends = [
            EndPoint("geom", geom, (0.0, 0.0, side * half)) for geom, side, half in zip(geoms, axes, halves, strict=True)
        ]
        along = np.zeros((len(geoms), 3))
        for row, geom, side in zip(along, geoms, axes, strict=True):
            mujoco.mju_rotVecQuat(row, np.array([0.0, 0.0, side]), model.geom_quat[geom])
        sensor = TouchSensor(model, geoms, _object_of(robot, wound), reach=reach)
        return Chain(robot, VirtualArms(model, ends), sensor, model.geom_bodyid[geoms].astype(int), along, 2.0 * halves)

    @property
    def count(self) -> int:
        """Number of links n."""
        return self.arms.count

    @cached_property
    def lies_along_x(self) -> bool:
        """Whether every link lies along the x axis of its body, as those of `Arm`."""
        return bool((self.along == [1.0, 0.0, 0.0]).all())

    def directions(self) -> Array:
        """Return the unit directions of the links in the world `(n, 3)`."""
        rotations = self.robot.data.xmat[self.bodies]
        if self.lies_along_x:
            return rotations[:, ::3]  # the column itself: the same bits, signs of zeros included
        return np.einsum("nij,nj->ni", rotations.reshape(-1, 3, 3), self.along)

    def moved(self, q: Array, dtheta: Array) -> Array:
        """Return the position `(nq,)` after a step dθ `(nv,)` from `q`."""
        there = np.array(q)
        mujoco.mj_integratePos(self.robot.model, there, dtheta, 1.0)
        return there


def with_capsules(model: mujoco.MjModel, tip: int) -> mujoco.MjModel:
    """Return a model whose links to the body `tip` have capsules: a copy, if cylinders were to be rounded off for it.

    URDF knows no capsules. A capsule as long and thick as a cylinder holds it, and longer by a radius at each end.
    """
    cylinders = _longest_to(model, tip, _CYLINDER) if len(_longest_to(model, tip, _CAPSULE)) < 2 else []
    if not cylinders:
        return model
    rounded = copy.copy(model)
    for geom in cylinders:
        radius, half, _ = rounded.geom_size[geom]
        rounded.geom_type[geom], rounded.geom_rbound[geom] = _CAPSULE, radius + half
        rounded.geom_aabb[geom, 3:] = radius, radius, radius + half
    return rounded


def _object_of(robot: Robot, wound: str | int) -> int:
    """Return the number of a geom, by its name or number, or by the name of a body that has no other."""
    if isinstance(wound, str) and wound not in robot.names("geom") and wound in robot.names("body"):
        body = robot.body(wound)
        if robot.model.body_geomnum[body] == 1:
            return int(robot.model.body_geomadr[body])
    return robot.geom(wound)


def _longest_to(model: mujoco.MjModel, tip: int, kind: int) -> list[int]:
    """Return the longest geom of a `kind` of each body from the base to `tip` that has one."""
    found, body = [], tip
    while body:
        first, count = model.body_geomadr[body], model.body_geomnum[body]
        capsules = [geom for geom in range(first, first + count) if model.geom_type[geom] == kind]
        if capsules and model.body_weldid[body]:  # what is welded to the world is no link
            found.append(max(capsules, key=lambda geom: float(model.geom_size[geom, 1])))
        body = int(model.body_parentid[body])
    return found[::-1]


def _towards_tip(robot: Robot, geoms: list[int]) -> list[float]:
    """Return for each capsule whether its axis points towards the tip, 1, or away from it, -1, seen from its neighbour."""
    centres, axes = robot.data.geom_xpos[geoms], robot.data.geom_xmat[geoms].reshape(-1, 3, 3)[:, :, 2]
    ahead = np.diff(centres, axis=0)
    ahead = np.vstack([ahead, ahead[-1:]])  # the last lies ahead of the one before
    return np.where(np.einsum("ij,ij->i", axes, ahead) >= 0.0, 1.0, -1.0).tolist()
