"""The controller's look at its arm and the numbers of its problem, one call of the compiled core each (`winding.hpp`).

`controller.py` is the form to read and the reference: the first look is taken both ways, and where they differ, or the core
or MuJoCo's library cannot be had, the Python form goes on alone.
"""

import ctypes
import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from prioritized_ik.limits import OUTSIDE, contact_row_name, joint_names, limited_scalars
from prioritized_ik.mujoco_functions import mujoco_functions
from prioritized_ik.packed import Layout, PackedProblem
from prioritized_ik.problem import Bounds, IKProblem, Rows, trusted
from prioritized_ik.solvers.compiled.library import library
from prioritized_ik.touch import TouchSensor
from prioritized_ik.validation import LARGEST, Array
from prioritized_ik.virtual_arms import VirtualArms
from prioritized_ik.winding.settings import Control

SAME = 1e-9  # [m] and of unit vectors: what the two forms may differ by at the first look; rounding is a millionth of it

_BOXED = [
    int(kind)
    for kind in (
        *(mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_ELLIPSOID),
        *(mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_MESH),
    )
]  # kinds of geoms that the model knows a box around

_FUNCTIONS = ("kinematics", "com_pos", "geom_distance")  # of MuJoCo's

_VECTORS = ("positions", "directions", "normal", "point", "contact_vectors", "desired")  # (n, 3) each
_NUMBERS = ("distance", "signs")  # (n,) each
_SEEN = {"positions": "end_points"}  # where Scene has another name


def parts_of(written: Array, links: int) -> dict[str, Array]:
    """Return the arrays of a situation and its touch by name, as the core wrote them one after the other."""
    end = 3 * links * len(_VECTORS)
    parts = dict(zip(_VECTORS, written[:end].reshape(-1, links, 3), strict=True))
    return parts | dict(zip(_NUMBERS, written[end:].reshape(-1, links), strict=True))


class Scene(ctypes.Structure):
    """What the core reads and writes: `Scene` in winding.hpp, field by field."""

    _fields_ = (
        [(name, ctypes.c_int32) for name in ("links", "joints", "positions", "object", "ranges")]
        + [
            (name, ctypes.c_double)
            for name in (
                *("reach", "contact_distance", "release_distance", "stride", "dead_band", "margin", "min_distance"),
                *("gain", "max_step", "outside", "largest"),
            )
        ]
        + [
            (name, ctypes.c_void_p)
            for name in (
                *("model", "data", "kinematics", "com_pos", "geom_distance"),
                *("geoms", "bodies", "roots", "end_bodies", "end_roots", "range_dofs", "range_places"),
                *("moves", "end_moves", "offsets", "half_lengths", "radii", "box", "range_low", "range_high"),
                *("qpos", "xpos", "xmat", "geom_xpos", "geom_xmat", "cdof", "subtree_com"),
                *("q", "was_in_contact"),
                *("end_points", "directions", "distance", "normal", "point", "contact_vectors", "desired", "signs"),
                *("in_contact", "first_and_last"),
                *("jacobian", "row_matrix", "row_upper", "lower", "upper", "axes", "near"),
            )
        ]
    )


class Parts(NamedTuple):
    """What a winding controller is made of.

    `links` are the bodies of the links `(n,)`, `margin` is that of contact rows; `poses`, whether matrices are posed too.
    """

    settings: Control
    data: mujoco.MjData
    arms: VirtualArms
    sensor: TouchSensor
    links: NDArray[np.int_]
    margin: float
    poses: bool


class CompiledLook:
    """What the core needs to know of a controller, and the arrays that both see; for one thread at a time."""

    def __init__(self, parts: Parts) -> None:
        core, functions = library().core, mujoco_functions()
        assert core is not None
        assert functions is not None
        settings, data, arms, sensor, links, margin, poses = parts
        model = sensor.model
        n, m = arms.count, model.nv
        rows = n if poses else 0  # of matrices
        self._core_observe, self._core_pose = core.core_scene_observe, core.core_scene_pose
        joints, dofs, places = limited_scalars(model)
        low, high = model.jnt_range[joints].T.copy()
        self._q, self._was = np.zeros(model.nq), np.zeros(n, dtype=bool)
        self._written = np.zeros(n * (3 * len(_VECTORS) + len(_NUMBERS)))
        self._touching, self._ends = np.zeros(n, dtype=bool), np.zeros(2, dtype=np.int32)
        self._jacobian, self._bounds = np.zeros((3 * rows, m)), np.zeros((2, m))
        self._rows, self._sides, self._near = np.zeros((rows, m)), np.zeros(n), np.zeros(n, dtype=np.int32)
        self._joint_names = joint_names(model)
        self._wound = sensor.object_name
        none = np.zeros(0, dtype=np.uint8)
        kept: dict[str, NDArray[Any]] = {
            "geoms": np.array(sensor.links, dtype=np.int32),
            "bodies": np.array(links, dtype=np.int32),
            "roots": np.array(sensor.jacobians.roots[:n], dtype=np.int32),
            "end_bodies": np.array(arms.bodies, dtype=np.int32),
            "end_roots": np.array(arms.jacobians.roots, dtype=np.int32),
            "range_dofs": np.array(dofs, dtype=np.int32),
            "range_places": np.array(places, dtype=np.int32),
            "moves": sensor.jacobians.moving[:n].astype(np.uint8) if poses else none,
            "end_moves": arms.jacobians.moving.astype(np.uint8) if poses else none,
            "offsets": np.array(arms.offsets),
            "half_lengths": np.array(sensor.half_lengths),
            "radii": model.geom_rbound[sensor.links],
            "box": _box_around(model, sensor.object),
            "range_low": low,
            "range_high": high,
            "q": self._q,
            "was_in_contact": self._was,
            "in_contact": self._touching,
            "first_and_last": self._ends,
            "jacobian": self._jacobian,
            "row_matrix": self._rows,
            "row_upper": self._sides,
            "lower": self._bounds[0],
            "upper": self._bounds[1],
            "axes": np.zeros((6, m)),
            "near": self._near,
        }
        kept |= {_SEEN.get(name, name): part for name, part in parts_of(self._written, n).items()}
        self._desired = kept["desired"].reshape(-1)
        for name in ("qpos", "xpos", "xmat", "geom_xpos", "geom_xmat", "cdof", "subtree_com"):
            kept[name] = getattr(data, name)
        self._kept = model, data, kept  # whose memory the scene points to
        self._scene = Scene(
            links=n,
            joints=m,
            positions=model.nq,
            object=sensor.object,
            ranges=len(joints),
            reach=sensor.reach,
            contact_distance=settings.contact_distance,
            release_distance=settings.release_distance,
            stride=settings.speed * settings.dt,
            dead_band=settings.dead_band,
            margin=margin,
            min_distance=settings.min_distance,
            gain=settings.contact_gain,
            max_step=settings.max_step,
            outside=OUTSIDE,
            largest=LARGEST,
            model=model._address,
            data=data._address,
            **{name: functions[name] for name in _FUNCTIONS},
            **{name: array.ctypes.data for name, array in kept.items()},
        )
        self._at = ctypes.byref(self._scene)

    def observe(self, q: Array, was_in_contact: NDArray[np.bool_]) -> dict[str, Any] | None:
        """Return what is seen at `q` `(m,)`: M, the first and last link in contact, and what `parts_of` takes apart.

        None where the Python form is to say what is wrong with the positions.
        """
        if np.shape(q) != self._q.shape or np.shape(was_in_contact) != self._was.shape:
            return None
        self._q[:] = q
        self._was[:] = was_in_contact
        if self._core_observe(self._at):
            return None
        first, last = self._ends.tolist()
        touching = self._touching.copy()
        touching.setflags(write=False)
        return {"in_contact": touching, "first": first, "last": last, "written": self._written.copy()}

    def pose(self, q: Array) -> bytes | None:
        """Write J `(3 n, m)`, dX_v* `(3 n,)`, bounds and contact rows where the arm was observed last.

        Returns which links have such rows, as a key; None as for `observe`.
        """
        self._q[:] = q
        count = self._core_pose(self._at)
        return None if count < 0 else self._near[:count].tobytes()

    def posed(self, near: bytes) -> tuple[Array, Array, Bounds, Rows]:
        """Return what was posed last, where the links `near` have rows."""
        links = np.frombuffer(near, dtype=np.int32)
        names = tuple(contact_row_name(link + 1, self._wound) for link in links.tolist())
        lower, upper = self._bounds.copy()
        return (
            self._jacobian.copy(),
            self._desired.copy(),
            trusted(Bounds, lower=lower, upper=upper, names=self._joint_names),
            trusted(Rows, matrix=self._rows[: len(links)].copy(), upper=self._sides[: len(links)].copy(), names=names),
        )

    def packed(self, problem: IKProblem, rows: Sequence[slice]) -> "PackedPose":
        """Return what packs problems like one that was posed, whose levels are these `rows` of all."""
        return PackedPose(problem, self._jacobian, self._desired, self._bounds, self._rows, self._sides, rows)


class PackedPose:
    """Problems with the same levels and contact rows, packed from the arrays that the core poses them in."""

    def __init__(
        self,
        pattern: IKProblem,
        jacobian: Array,
        desired: Array,
        bounds: Array,
        row_matrix: Array,
        row_upper: Array,
        levels: Sequence[slice],
    ) -> None:
        self._layout = Layout(pattern)
        self._numbers = self._layout.packed()
        parts, count = self._layout.parts(self._numbers), len(pattern.rows.upper)
        self._pairs = [(parts.row_matrix, row_matrix[:count]), (parts.row_upper, row_upper[:count])]
        for place, rows in zip(self._layout.levels, levels, strict=True):
            self._pairs += [(parts.matrix[place], jacobian[rows]), (parts.target[place], desired[rows])]
        if np.isfinite(parts.upper).all():  # they are kept, and always bind a step
            self._pairs += [(parts.lower, bounds[0]), (parts.upper, bounds[1])]

    def problem(self) -> PackedProblem:
        """Return the problem that was posed last."""
        for place, posed in self._pairs:
            place[...] = posed
        return PackedProblem(self._layout, self._numbers.copy())


def _box_around(model: mujoco.MjModel, geom: int) -> Array:
    """Return centre and half-sizes `(6,)` [m] of the box around a geom in its own axes, infinite where it has none."""
    centre, sizes = model.geom_aabb[geom].reshape(2, 3)
    return np.append(centre, sizes if model.geom_type[geom] in _BOXED else np.full(3, np.inf))


def compiled_look(parts: Parts) -> CompiledLook | None:
    """Return the compiled form of a controller's look, or None where there is none: it knows objects that stand still."""
    if parts.sensor.object_moves or library().core is None or mujoco_functions() is None:
        return None
    return CompiledLook(parts)


def same_look(one: Any, other: Any) -> bool:
    """Whether two situations, one by each form, differ by rounding at most; says so if not."""
    pairs = [
        (getattr(one, name), getattr(other, name)) for name in ("positions", "directions", "contact_vectors", "desired")
    ]
    pairs += [(getattr(one.touch, name), getattr(other.touch, name)) for name in ("distance", "normal", "point")]
    apart = max(float(np.abs(a - b).max(initial=0.0)) for a, b in pairs)
    if apart <= SAME and (one.in_contact == other.in_contact).all():
        return True
    message = f"the compiled look at the arm is {apart:.1e} off the Python form's, which is used; please report it"
    warnings.warn(message, RuntimeWarning, stacklevel=2)
    return False
