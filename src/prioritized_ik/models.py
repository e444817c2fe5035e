"""The paper's arms and the objects they wind around, as MuJoCo models.

Links, their geoms and the sites at their ends are numbered from 1 as in the paper: body and geom `link_i`, site `end_i`.
The arm starts at the origin and lies along +x when every joint is zero.
"""

import copy
import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, lru_cache
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from prioritized_ik.errors import ModelError
from prioritized_ik.model_cache import cached_model
from prioritized_ik.validation import Array, at_least, finite_array, non_negative, one_of, positive

AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}

#: Where the object comes from, as seen with the arm along +x and z up (Fig. 6 a-d).
DIRECTIONS = {"up": (0.0, 0.0, 1.0), "down": (0.0, 0.0, -1.0), "front": (0.0, -1.0, 0.0), "back": (0.0, 1.0, 0.0)}

#: Object shapes: MuJoCo geom type and how many half-sizes it takes. The first half-size faces the arm.
SHAPES = {
    "cylinder": (mujoco.mjtGeom.mjGEOM_CYLINDER, 2),
    "capsule": (mujoco.mjtGeom.mjGEOM_CAPSULE, 2),
    "sphere": (mujoco.mjtGeom.mjGEOM_SPHERE, 1),
    "ellipsoid": (mujoco.mjtGeom.mjGEOM_ELLIPSOID, 3),
    "box": (mujoco.mjtGeom.mjGEOM_BOX, 3),
}

POSTURES = ("straight", "arched", "random")
LONG = 150  # links from which on a compiled model is kept on disk: compiling takes 0.1 s there
ARCH = 0.03  # bend of each link about z and y in the arched posture [rad]
SMALL_BEND = 0.05  # standard deviation of each joint in the random posture [rad]


@dataclass(frozen=True)
class Arm:
    """A serial arm of equal capsule links: the 17-link arm of Fig. 5 unless told otherwise.

    Attributes:
        links: number of links n.
        link_length: length of a link [m].
        radius: radius of a link's capsule [m]. The paper does not state one.
        joint_range: every hinge turns within plus and minus this [rad]. The paper does not state one.
        joints: `"ball"`: three hinges a link, but one (local z) for the last link, as in Fig. 5;
            `"planar"`: one hinge about z a link, as in Fig. 3.
        hinge_order: axes of a ball's three hinges, from the base outward. The paper does not state an order.
    """

    links: int = 17
    link_length: float = 0.06
    radius: float = 0.01
    joint_range: float = 1.0
    joints: str = "ball"
    hinge_order: str = "zyx"

    def __post_init__(self) -> None:
        at_least("links", self.links, 1)
        positive("link_length", self.link_length)
        positive("radius", self.radius)
        positive("joint_range", self.joint_range)
        one_of("joints", self.joints, ("ball", "planar"))
        if not isinstance(self.hinge_order, str) or sorted(self.hinge_order) != ["x", "y", "z"]:
            raise ModelError(f"hinge_order is {self.hinge_order!r}; expected an order of x, y and z such as 'zyx'.")

    def hinge_axes(self, link: int) -> str:
        """Axes of the hinges at the base of `link` (from 1), from the base outward."""
        return self.hinge_order if self.joints == "ball" and link < self.links else "z"

    @property
    def joint_count(self) -> int:
        """Number of joints m."""
        return sum(len(self.hinge_axes(link)) for link in self.link_numbers)

    @property
    def link_numbers(self) -> range:
        """1 … n."""
        return range(1, self.links + 1)

    @property
    def end_sites(self) -> list[str]:
        """Names of the sites at the link ends: the paper's virtual end points."""
        return [f"end_{link}" for link in self.link_numbers]

    @property
    def link_geoms(self) -> list[str]:
        """Names of the links' geoms."""
        return [f"link_{link}" for link in self.link_numbers]

    def spec(self) -> mujoco.MjSpec:
        """Return the arm alone as an editable MuJoCo specification."""
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        body = spec.worldbody
        for link in self.link_numbers:
            body = body.add_body(name=f"link_{link}", pos=[self.link_length if link > 1 else 0.0, 0.0, 0.0])
            for axis in self.hinge_axes(link):
                body.add_joint(
                    name=f"joint_{link}{axis}",
                    type=mujoco.mjtJoint.mjJNT_HINGE,
                    axis=AXES[axis],
                    limited=True,
                    range=[-self.joint_range, self.joint_range],
                )
            body.add_geom(
                name=f"link_{link}",
                type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                fromto=[0.0, 0.0, 0.0, self.link_length, 0.0, 0.0],
                size=[self.radius, 0.0, 0.0],
                rgba=[0.27, 0.47, 0.67, 1.0],
            )
            body.add_site(name=f"end_{link}", pos=[self.link_length, 0.0, 0.0], size=[self.radius / 2.0, 0.0, 0.0])
        return spec

    def posture(self, name: str, seed: int = 0) -> Array:
        """Return joint positions `(m,)` [rad] of a named initial posture.

        `straight` (all zero, a singular pose), `arched` (the same small bend everywhere), or `random` (small bends drawn
        with `seed`).
        """
        one_of("posture", name, POSTURES)
        if name == "random":
            return np.clip(
                np.random.default_rng(seed).normal(scale=SMALL_BEND, size=self.joint_count),
                -0.9 * self.joint_range,
                0.9 * self.joint_range,
            )
        if name == "straight":
            return np.zeros(self.joint_count)
        arch = min(ARCH, 0.9 * self.joint_range)
        bend = {"x": 0.0, "y": arch, "z": arch}
        return np.array([bend[axis] for link in self.link_numbers for axis in self.hinge_axes(link)])


#: The five-link planar arm of Fig. 3; its task space is x and y.
PLANAR_ARM = Arm(links=5, joints="planar", joint_range=np.pi)


@dataclass(frozen=True)
class WindingObject:
    """A convex object at a pose.

    Attributes:
        shape: a key of `SHAPES`.
        size: MuJoCo half-sizes [m]: cylinder and capsule (radius, half length), sphere (radius), ellipsoid (three
            semi-axes), box (three half-edges). The first faces the arm when placed with `touching`.
        position: centre `(3,)` [m].
        rotation: columns are the object's axes in the world `(3, 3)`; its third axis is the one to wind around.
    """

    shape: str = "cylinder"
    size: tuple[float, ...] = (0.07, 0.5)
    position: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.eye(3))

    def __post_init__(self) -> None:
        _, count = SHAPES[one_of("shape", self.shape, SHAPES)]
        if len(self.size) != count:
            raise ModelError(f"size of a {self.shape} is {self.size}; expected {count} half-sizes in metres.")
        for value in self.size:
            positive(f"size of the {self.shape}", value)
        object.__setattr__(self, "position", finite_array("position", self.position, (3,)))
        rotation = finite_array("rotation", self.rotation, (3, 3))
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-9) or np.linalg.det(rotation) < 0.0:
            raise ModelError(f"rotation is {rotation.tolist()}; expected a rotation matrix.")
        object.__setattr__(self, "rotation", rotation)

    @property
    def axis(self) -> Array:
        """Unit vector `(3,)` along the axis to wind around."""
        return self.rotation[:, 2]

    def touching(
        self, point: ArrayLike, along: ArrayLike, direction: str, tilt: float = 0.0, gap: float = 0.0
    ) -> "WindingObject":
        """Return this object moved so that it faces `point` from `direction`.

        Args:
            point: where the object's surface is to be, less the gap `(3,)` [m].
            along: direction of the link there `(3,)`. The object's axis is square to it, then tilted.
            direction: the side that the object comes from, a key of `DIRECTIONS`.
            tilt: turn of the object's axis about the contact normal [rad]; not zero winds a helix.
            gap: distance between surface and point [m].

        Raises:
            InputError: unknown direction, or one that points along the link.
        """
        side = np.array(DIRECTIONS[one_of("direction", direction, DIRECTIONS)])
        link = finite_array("along", along, (3,))
        if not link.any():
            raise ModelError(f"along is {link.tolist()}; expected the direction of a link, not zero.")
        link = link / np.linalg.norm(link)
        outward = side - link * (link @ side)
        if np.linalg.norm(outward) < 1e-6:
            raise ModelError(f"direction {direction!r} points along the link {link.tolist()}; choose another.")
        outward /= np.linalg.norm(outward)
        square = np.cross(link, outward)
        axis = np.cos(tilt) * square + np.sin(tilt) * np.cross(outward, square)
        return WindingObject(
            self.shape,
            self.size,
            finite_array("point", point, (3,)) + (self.size[0] + non_negative("gap", gap)) * outward,
            np.column_stack([outward, np.cross(axis, outward), axis]),
        )

    def add_to(self, spec: mujoco.MjSpec, name: str = "object") -> None:
        """Add the object to `spec` as a fixed geom called `name`."""
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, self.rotation.ravel())
        geom_type, count = SHAPES[self.shape]
        spec.worldbody.add_geom(
            name=name,
            type=geom_type,
            size=[*self.size, *[0.0] * (3 - count)],
            pos=self.position,
            quat=quaternion,
            rgba=[0.80, 0.73, 0.27, 1.0],
        )


def arm_model(arm: Arm) -> mujoco.MjModel:
    """Return the compiled model of an arm alone, compiled once; a long one once a user, see `model_cache`."""
    return copy.copy(_arm_model(arm))


def winding_model(arm: Arm, wound: WindingObject) -> mujoco.MjModel:
    """Return the model of `arm` and the object `wound`, whose geom is called `object`; compiled once, as by `arm_model`."""
    return copy.copy(_winding_model(arm, wound.shape, wound.size, wound.position.tobytes(), wound.rotation.tobytes()))


@lru_cache(maxsize=32)  # settings ask for one a first link, and a sweep goes through all of them
def _arm_model(arm: Arm) -> mujoco.MjModel:
    return _compiled(arm, "alone", arm.spec)


@lru_cache(maxsize=8)
def _winding_model(arm: Arm, shape: str, size: tuple[float, ...], position: bytes, rotation: bytes) -> mujoco.MjModel:
    def spec() -> mujoco.MjSpec:
        whole = arm.spec()
        WindingObject(shape, size, np.frombuffer(position), np.frombuffer(rotation).reshape(3, 3)).add_to(whole)
        return whole

    return _compiled(arm, f"{shape} {size} {position.hex()} {rotation.hex()}", spec)


def _compiled(arm: Arm, beside: str, spec: Callable[[], mujoco.MjSpec]) -> mujoco.MjModel:
    if arm.links < LONG:
        return spec().compile()
    return cached_model(f"{_source()}\n{arm}\n{beside}", lambda: spec().compile())


@cache
def _source() -> str:
    """Return a digest of this module, which decides what its models are like."""
    return hashlib.sha256(Path(__file__).read_bytes()).hexdigest()


def update_kinematics(model: mujoco.MjModel, data: mujoco.MjData, q: ArrayLike) -> None:
    """Set the joint positions `(nq,)` and bring all positions and the terms for Jacobians up to date.

    Raises:
        InputError: positions of another shape, or not finite.
    """
    data.qpos[:] = finite_array("q", q, (model.nq,))
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
