"""A robot of any MuJoCo model: its state, its parts by name or number, its frames and their Jacobians."""

import fnmatch
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from prioritized_ik.errors import InputError
from prioritized_ik.limits import joint_metric
from prioritized_ik.model_file import model_of
from prioritized_ik.validation import Array, distinct, finite_array, nearest_first, non_negative, read_only, shape_of

#: Kinds of parts that are found by name or number.
KINDS = {
    "joint": mujoco.mjtObj.mjOBJ_JOINT,
    "body": mujoco.mjtObj.mjOBJ_BODY,
    "site": mujoco.mjtObj.mjOBJ_SITE,
    "geom": mujoco.mjtObj.mjOBJ_GEOM,
    "keyframe": mujoco.mjtObj.mjOBJ_KEY,
}
PLURALS = {"joint": "joints", "body": "bodies", "site": "sites", "geom": "geoms", "keyframe": "keyframes"}
_COUNTS = {"joint": "njnt", "body": "nbody", "site": "nsite", "geom": "ngeom", "keyframe": "nkey"}
PARTS = ("joint", "body", "site", "geom")  # kinds that are mixed up with each other
LISTED = 20  # names of a kind in a message; robots have hundreds
LISTED_OTHERS = 6  # names of each other kind


@dataclass(frozen=True)
class Frame:
    """A frame fixed to a body: its `kind` (`"body"`, `"site"` or `"geom"`), its number there, and its name."""

    kind: str
    number: int
    name: str


class Robot:
    """A MuJoCo model at a position.

    Args:
        model: any MuJoCo model, which is not changed, or the path of an MJCF or URDF file.
        q: position `(nq,)`; the model's `qpos0` unless given.

    Attributes:
        model: the model.
        data: its state, up to date with `q`.

    Raises:
        InputError: something else than a model or a path, or a position of another length.
        ModelError: no such file, one that MuJoCo cannot read, or a URDF with xacro or `package://` paths.
    """

    def __init__(self, model: mujoco.MjModel | str | Path, q: ArrayLike | None = None) -> None:
        if isinstance(model, str | Path):
            model = model_of(Path(model))
        if not isinstance(model, mujoco.MjModel):
            raise InputError(f"model is of type {type(model).__name__}; expected a mujoco.MjModel or the path of a file.")
        self.model = model
        self.data = mujoco.MjData(model)
        self.update(model.qpos0 if q is None else q)

    @property
    def q(self) -> Array:
        """The position `(nq,)`, a copy."""
        return np.array(self.data.qpos)

    @property
    def metric(self) -> Array:
        """Diagonal joint metric `(nv,)` in which metres and radians are of one size, see `joint_metric`."""
        return joint_metric(self.model)

    @property
    def velocity(self) -> Array:
        """The velocity `(nv,)` [rad/s, m/s] of the last `integrate`, a copy; zero before the first."""
        return np.array(self.data.qvel)

    def update(self, q: ArrayLike | None = None) -> None:
        """Bring positions, centres of mass and tendons up to date, at `q` `(nq,)` if given.

        Raises:
            InputError: a position of another length, or not finite.
        """
        if q is not None:
            self.data.qpos[:] = self._position(q)
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_tendon(self.model, self.data)

    def integrate(self, velocity: ArrayLike, dt: float) -> Array:
        """Move by `velocity` `(nv,)` [rad/s, m/s] over `dt` [s], and return the new position `(nq,)`."""
        q, moving = self.q, finite_array("velocity", velocity, (self.model.nv,))
        mujoco.mj_integratePos(self.model, q, moving, non_negative("dt", dt))
        self.data.qvel[:], self.data.qpos[:] = moving, q
        self.update()
        return q

    def joint(self, which: str | int) -> int:
        """Return the number of a joint, by name or number."""
        return self._number("joint", which)

    def body(self, which: str | int) -> int:
        """Return the number of a body, by name or number."""
        return self._number("body", which)

    def site(self, which: str | int) -> int:
        """Return the number of a site, by name or number."""
        return self._number("site", which)

    def geom(self, which: str | int) -> int:
        """Return the number of a geom, by name or number; most geoms of real models have no name."""
        return self._number("geom", which)

    def keyframe(self, which: str | int) -> Array:
        """Return the position `(nq,)` of a keyframe of the model, by name or number, for `update`."""
        return np.array(self.model.key_qpos[self._number("keyframe", which)])

    def joints(self, which: str | int) -> list[int]:
        """Return the numbers of joints, by name, by pattern such as `left*` (see `fnmatch`), or by number."""
        return self._numbers("joint", which)

    def bodies(self, which: str | int) -> list[int]:
        """Return the numbers of bodies, by name, pattern or number."""
        return self._numbers("body", which)

    def sites(self, which: str | int) -> list[int]:
        """Return the numbers of sites, by name, pattern or number."""
        return self._numbers("site", which)

    def geoms(self, which: str | int) -> list[int]:
        """Return the numbers of geoms, by name, pattern or number."""
        return self._numbers("geom", which)

    def names(self, kind: str) -> list[str]:
        """Return what the parts of a kind are called: their name, or for instance `geom 3` where they have none."""
        return list(distinct(name or f"{kind} {number}" for number, name in enumerate(self._given_names(kind))))

    def dofs(self, joint: str | int) -> slice:
        """Return the degrees of freedom of a joint."""
        number = self.joint(joint)
        ends = [*self.model.jnt_dofadr.tolist(), self.model.nv]
        return slice(ends[number], ends[number + 1])

    def dof_values(self, name: str, values: ArrayLike | Mapping[str | int, ArrayLike], otherwise: float = 0.0) -> Array:
        """Return one value a degree of freedom `(nv,)`.

        Args:
            name: what messages call the values.
            values: one for all, `(nv,)`, or by joint (name, pattern or number): one for the joint or one for each of its
                degrees of freedom, a later entry in place of an earlier one.
            otherwise: for joints that are not named.

        Raises:
            InputError: a joint that does not exist, or values of another length.
        """
        if not isinstance(values, Mapping):
            each = values if shape_of(name, values) else np.full(self.model.nv, values)
            return finite_array(name, each, (self.model.nv,))
        filled = np.full(self.model.nv, otherwise)
        for which, value in values.items():
            for number in self.joints(which):
                dofs = self.dofs(number)
                what, count = f"{name} of {which}", dofs.stop - dofs.start
                filled[dofs] = finite_array(what, value if shape_of(what, value) else np.full(count, value), (count,))
        return read_only(filled)

    def frame(
        self, *, body: str | int | None = None, site: str | int | None = None, geom: str | int | None = None
    ) -> Frame:
        """Return the frame of one body, site or geom.

        Raises:
            InputError: none or several given, or one that does not exist.
        """
        given = [(kind, which) for kind, which in (("body", body), ("site", site), ("geom", geom)) if which is not None]
        if len(given) != 1:
            raise InputError(f"{len(given)} frames were given; expected one of body=, site= and geom=, by name or number.")
        kind, which = given[0]
        number = self._number(kind, which)
        return Frame(kind, number, self.names(kind)[number])

    def position(self, frame: Frame) -> Array:
        """Return where a frame's origin is in the world `(3,)` [m]."""
        place = getattr(self.data, {"body": "xpos", "site": "site_xpos", "geom": "geom_xpos"}[frame.kind])
        return np.array(place[frame.number])

    def rotation(self, frame: Frame) -> Array:
        """Return the rotation matrix `(3, 3)` of a frame; its columns are the frame's axes in the world."""
        turn = getattr(self.data, {"body": "xmat", "site": "site_xmat", "geom": "geom_xmat"}[frame.kind])
        return np.array(turn[frame.number]).reshape(3, 3)

    def jacobians(self, frame: Frame) -> tuple[Array, Array]:
        """Return the Jacobians of a frame's origin [m] and of its rotation [rad], each `(3, nv)`, in the world's axes."""
        linear, angular = np.zeros((3, self.model.nv)), np.zeros((3, self.model.nv))
        mujoco.mj_jac(self.model, self.data, linear, angular, self.position(frame), self.carrier(frame))
        return linear, angular

    def position_jacobian(self, frame: Frame) -> Array:
        """Return the Jacobian of a frame's origin `(3, nv)` [m], in the world's axes."""
        linear = np.zeros((3, self.model.nv))
        mujoco.mj_jac(self.model, self.data, linear, None, self.position(frame), self.carrier(frame))
        return linear

    def carrier(self, frame: Frame) -> int:
        """Return the number of the body that a frame is fixed to."""
        if frame.kind == "body":
            return frame.number
        return int(getattr(self.model, f"{frame.kind}_bodyid")[frame.number])

    def _position(self, q: ArrayLike) -> Array:
        given = shape_of("q", q)
        if given != (self.model.nq,):
            raise InputError(
                f"q has shape {given}; expected ({self.model.nq},): the model has nq = {self.model.nq} positions and "
                f"nv = {self.model.nv} velocities."
            )
        return finite_array("q", q, (self.model.nq,))

    def _number(self, kind: str, which: str | int) -> int:
        count = getattr(self.model, _COUNTS[kind])
        if isinstance(which, str):
            number = mujoco.mj_name2id(self.model, KINDS[kind], which)
            if number >= 0:
                return int(number)
        elif isinstance(which, int | np.integer) and not isinstance(which, bool) and 0 <= which < count:
            return int(which)
        raise InputError(self._not_found(kind, which))

    def _numbers(self, kind: str, which: str | int) -> list[int]:
        if not isinstance(which, str) or not any(mark in which for mark in "*?["):
            return [self._number(kind, which)]
        found = [i for i, name in enumerate(self._given_names(kind)) if fnmatch.fnmatchcase(name, which)]
        return found or [self._number(kind, which)]  # a name may hold such marks itself

    def _given_names(self, kind: str) -> list[str]:
        """Return the names of a kind, empty where there is none."""
        count = getattr(self.model, _COUNTS[kind])
        return [mujoco.mj_id2name(self.model, KINDS[kind], number) or "" for number in range(count)]

    def _not_found(self, kind: str, which: str | int) -> str:
        """Return what there is instead, of the kind asked for and then of every other, the nearest names first."""
        kinds = [kind, *(other for other in PARTS if other != kind and kind in PARTS)]
        listed = [self._listed(each, str(which), LISTED if each == kind else LISTED_OTHERS) for each in kinds]
        return f"there is no {kind} {which!r}; the model has {'; '.join(listed)}."

    def _listed(self, kind: str, wanted: str, most: int) -> str:
        given = self._given_names(kind)
        names = [name for name in given if name]
        ordered = nearest_first(wanted, names)
        parts = ordered[:most] + ([f"{len(names) - most} more"] if len(names) > most else [])
        if len(names) < len(given):
            parts.append(f"{len(given) - len(names)} without a name, by number")
        if not given:
            return f"no {kind}"
        return f"{len(given)} {PLURALS[kind] if len(given) > 1 else kind}: {', '.join(parts)}"
