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

from prioritized_ik.limits import OUTSIDE, limited_scalars
from prioritized_ik.mujoco_functions import mujoco_functions
from prioritized_ik.packed import Layout, PackedProblem
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.compiled.library import library
from prioritized_ik.touch import ASKEW, TouchSensor
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
_BOOL = np.dtype(bool)
_SEEN = {"positions": "end_points"}  # where Scene has another name


def parts_of(seen: bytes | NDArray[np.uint8], links: int) -> dict[str, Array]:
    """Return the arrays of a situation and its touch by name, as the core wrote them one after the other."""
    written = np.frombuffer(seen, count=links * (3 * len(_VECTORS) + len(_NUMBERS)))
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
                *("gain", "max_step", "outside", "largest", "cylinder_radius", "cylinder_half_height", "askew"),
            )
        ]
        + [
            (name, ctypes.c_void_p)
            for name in (
                *("model", "data", "kinematics", "com_pos", "geom_distance"),
                *("geoms", "bodies", "roots", "end_bodies", "end_roots", "range_dofs", "range_places"),
                *("moves", "end_moves", "offsets", "half_lengths", "radii", "spheres", "box", "range_low", "range_high"),
                *("qpos", "xpos", "xmat", "geom_xpos", "geom_xmat", "cdof", "subtree_com"),
                *("q", "was_in_contact"),
                *("end_points", "directions", "distance", "normal", "point", "contact_vectors", "desired", "signs"),
                *("in_contact", "ends", "axes"),
            )
        ]
    )


class Numbers(ctypes.Structure):
    """Where the core writes a problem: `Numbers` in winding.hpp, field by field."""

    _fields_ = [
        (name, ctypes.c_void_p) for name in ("matrix", "target", "lower", "upper", "row_matrix", "row_upper", "places")
    ]


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
        self._core_observe, self._core_pose = core.core_scene_observe, core.core_scene_pose
        joints, dofs, places = limited_scalars(model)
        low, high = model.jnt_range[joints].T.copy()
        self._q, self._was = np.zeros(model.nq), np.zeros(n, dtype=bool)
        # One piece of memory, so that one copy keeps what is seen: vectors and numbers, which links are in contact.
        self._touching_at = 8 * n * (3 * len(_VECTORS) + len(_NUMBERS))
        self._seen = np.zeros(self._touching_at + n, dtype=np.uint8)
        self._ends = np.zeros(2, dtype=np.int32)
        radius, half_height = sensor.cylinder or (np.inf, 0.0)  # no link is beside that
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
            "radii": sensor.radii,
            "spheres": model.geom_rbound[sensor.links],
            "box": _box_around(model, sensor.object),
            "range_low": low,
            "range_high": high,
            "q": self._q,
            "was_in_contact": self._was,
            "in_contact": self._seen[self._touching_at :],
            "ends": self._ends,
            "axes": np.zeros((6, m)),
        }
        kept |= {_SEEN.get(name, name): part for name, part in parts_of(self._seen, n).items()}
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
            cylinder_radius=radius,
            cylinder_half_height=half_height,
            askew=ASKEW,
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
        seen = self._seen.tobytes()
        touching = np.frombuffer(seen, _BOOL, len(self._was), self._touching_at)
        return {"in_contact": touching, "first": first, "last": last, "written": seen}

    def pose(self, q: Array, to: Any) -> bool:
        """Write the problem at `q` where the arm was observed last to `Numbers`; False as None for `observe`."""
        self._q[:] = q
        return not self._core_pose(self._at, to)


def _numbers_at(*arrays: NDArray[Any] | None) -> Any:
    """Return what tells the core where to write: arrays in the order of `Numbers`, which must live as long."""
    return ctypes.byref(Numbers(*(None if array is None else array.ctypes.data for array in arrays)))


class PackedPose:
    """Problems with the same levels, which the core writes where they are packed.

    Args:
        look: what poses.
        pattern: one of them, bounded unless none is, and with a row for every link unless none has one: those of links that
            are far are left out.
        levels: the rows of each level among those of all arms.
        arms: how many these are.
    """

    def __init__(self, look: CompiledLook, pattern: IKProblem, levels: Sequence[slice], arms: int) -> None:
        self._look, self._layout = look, Layout(pattern, leaves_out=True)
        self._numbers = self._layout.packed()
        parts, self._places = self._layout.parts(self._numbers), np.full(3 * arms, -1, dtype=np.int32)
        for place, run in zip(self._layout.levels, levels, strict=True):
            self._places[run] = np.arange(place.start, place.stop)
        self._places = self._places[::3].copy()
        keeps_limits, keeps_contacts = np.isfinite(parts.upper).all(), len(parts.row_upper) > 0
        bounds = (parts.lower, parts.upper) if keeps_limits else (None, None)
        rows = (parts.row_matrix, parts.row_upper) if keeps_contacts else (None, None)
        self._to = _numbers_at(parts.matrix, parts.target, *bounds, *rows, self._places)

    def problem(self, q: Array) -> PackedProblem | None:
        """Return the problem at `q`, where the arm was observed last; None as for `CompiledLook.observe`."""
        return self._layout.problem(self._numbers) if self._look.pose(q, self._to) else None


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
