"""Joint range, step and contact limits, as bounds and rows that dθ = 0 keeps, but for links to be pushed out."""

import weakref

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from prioritized_ik.errors import InputError
from prioritized_ik.problem import Bounds, Rows, trusted
from prioritized_ik.touch import OBJECT, Touch, TouchSensor
from prioritized_ik.validation import Array, distinct, finite_array, gain_of, non_negative, positive, read_only

_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
OUTSIDE = 1e-4  # [rad] a joint this far outside its range is rounding of accepted steps; further is an error

CONTACT_MARGIN = 0.05  # [m] links nearer to the object than this get a contact row
CONTACT_GAIN = 0.25  # of a gap that one step may close; the rest is left to the curvature of steps
PUSH_OUT = 5e-3  # [m] how far a link that is too close comes out in one step: 0.5 m/s in steps of 10 ms
AHEAD = 2.0  # steps as fast as any before, within which a link may reach the object

#: Names of joints by model: they cannot change, and asking MuJoCo for each takes longer than all else here.
_NAMES: weakref.WeakKeyDictionary[mujoco.MjModel, tuple[str, ...]] = weakref.WeakKeyDictionary()

#: The last metric of each model, and the length that it was made with [m].
_METRICS: weakref.WeakKeyDictionary[mujoco.MjModel, tuple[float, Array]] = weakref.WeakKeyDictionary()

#: Limited hinges and slides by model and by which joints it has limited now: their numbers, and places in dθ and q.
_LIMITED: weakref.WeakKeyDictionary[mujoco.MjModel, dict[bytes, tuple[NDArray[np.int_], ...]]] = weakref.WeakKeyDictionary()


def joint_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return one name a degree of freedom `(m,)`: that of its joint, numbered from 1 where the joint has several."""
    known = _NAMES.get(model)
    if known is None:
        known = _NAMES[model] = _joint_names(model)
    return known


def _joint_names(model: mujoco.MjModel) -> tuple[str, ...]:
    names = []
    for dof, joint in enumerate(model.dof_jntid):
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, joint) or f"joint {joint + 1}"
        several = np.count_nonzero(model.dof_jntid == joint) > 1
        names.append(f"{name}[{dof - model.jnt_dofadr[joint] + 1}]" if several else name)
    return distinct(names)


def joint_metric(model: mujoco.MjModel, length: float | None = None) -> Array:
    """Return a read-only diagonal metric `(m,)` for `IKProblem(metric=…)` in which metres and radians are of one size.

    1 for hinges and balls [rad⁻²]; 1 / `length`² for slides and the translation of a free base [m⁻²], so that a slide
    of one `length` weighs as much as a turn of one radian.

    Args:
        model: the MuJoCo model.
        length: [m]; half the model's extent unless given: about how far a turn of one radian moves the points on it.

    Raises:
        InputError: a length that is not positive.
    """
    size = positive("length", 0.5 * float(model.stat.extent) if length is None else length)
    known = _METRICS.get(model)
    if known is None or known[0] != size:
        known = _METRICS[model] = size, read_only(np.where(_translating(model), 1.0 / size**2, 1.0))
    return known[1]


def _translating(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Return which degrees of freedom `(m,)` translate: slides, and the first three of a free base."""
    kinds = model.jnt_type[model.dof_jntid]
    place = np.arange(model.nv) - model.jnt_dofadr[model.dof_jntid]
    return (kinds == _SLIDE) | ((kinds == int(mujoco.mjtJoint.mjJNT_FREE)) & (place < 3))


def limited_scalars(model: mujoco.MjModel) -> tuple[NDArray[np.int_], NDArray[np.int_], NDArray[np.int_]]:
    """Return the numbers of the limited hinges and slides `(k,)`, and their places in dθ and in q."""
    by_limited, limited = _LIMITED.setdefault(model, {}), model.jnt_limited
    key = limited.tobytes()
    if key not in by_limited:
        scalar = (model.jnt_type == _HINGE) | (model.jnt_type == _SLIDE)
        joints = np.flatnonzero(scalar & (limited != 0))
        by_limited[key] = joints, model.jnt_dofadr[joints], model.jnt_qposadr[joints]
    joints, dofs, places = by_limited[key]
    return joints, dofs, places


def in_succession(numbers: NDArray[np.int_]) -> slice | NDArray[np.int_]:
    """Return whole numbers `(k,)` as a slice where they follow each other, which is faster to look up."""
    if not numbers.size or (np.diff(numbers) != 1).any():
        return numbers
    return slice(int(numbers[0]), int(numbers[-1]) + 1)


def joint_range_bounds(model: mujoco.MjModel, q: ArrayLike) -> Bounds:
    """Return bounds that keep every limited hinge and slide joint in its range from position `q` `(nq,)`.

    Raises:
        InputError: a joint is outside its range already.
    """
    position = finite_array("q", q, (model.nq,))
    names = joint_names(model)
    lower, upper = np.empty(model.nv), np.empty(model.nv)
    lower.fill(-np.inf)
    upper.fill(np.inf)
    joints, dofs, places = limited_scalars(model)
    low, high = model.jnt_range[joints].T
    here = position[places]
    down, up = low - here, high - here
    excess = np.maximum(down, -up)
    if (excess > OUTSIDE).any():
        worst = int(excess.argmax())
        raise InputError(
            f"{names[dofs[worst]]} is at {position[places[worst]]:.6g}, outside its range "
            f"[{low[worst]:.6g}, {high[worst]:.6g}]; move it inside, or drop the joint limits."
        )
    lower[dofs], upper[dofs] = np.minimum(down, 0.0), np.maximum(up, 0.0)
    return trusted(Bounds, lower=lower, upper=upper, names=names)


def step_bounds(model: mujoco.MjModel, max_step: float) -> Bounds:
    """Return bounds of plus and minus `max_step` [rad, m for slides] on every joint's step."""
    limit = np.full(model.nv, positive("max_step", max_step))
    return Bounds(-limit, limit, joint_names(model))


def contact_row_name(link: int, wound: str = OBJECT) -> str:
    """Return what the contact row of `link` (from 1) with the object `wound` is called; the rows of several differ."""
    return f"contact of link {link}" + (f" with {wound}" if wound != OBJECT else "")


def contact_sides(distance: Array, min_distance: float, gain: float) -> Array:
    """Return the sides gain max(d - d_min, 0) of contact rows `(k,)` [m]."""
    return gain * np.maximum(distance - min_distance, 0.0)


def contact_rows(
    sensor: TouchSensor,
    data: mujoco.MjData,
    touch: Touch,
    *,
    min_distance: float = 0.0,
    gain: float = CONTACT_GAIN,
    margin: float = CONTACT_MARGIN,
    ahead: float = AHEAD,
    push_out: float = PUSH_OUT,
    max_step: float | None = None,
) -> Rows:
    """Return rows that keep links from coming closer than `min_distance` to the object, and bring back those that are.

    n·J_c dθ >= -gain (d - d_min) where d >= d_min, and >= min(d_min - d, `push_out`) where a link is too close, with n the
    normal into the link and J_c the Jacobian of the link's nearest point less that of the object's: n·J_c is the gradient
    of the distance d. Rows are of first order: what a step curves takes a link that presses or slides closer than they say
    (millimetres in steps of 0.1 rad, centimetres in steps of 0.3 rad), and `push_out` brings it back. Without `push_out` no
    right side is positive, so that dθ = 0 always holds, and a link stays as deep as it is.

    Args:
        sensor: knows the model, the links and the object.
        data: the model's state, with `mj_kinematics` and `mj_comPos` done.
        touch: the sensor's reading at that state.
        min_distance: d_min [m].
        gain: how much of the remaining gap one step may close, in (0, 1].
        margin: links nearer than this get a row [m].
        ahead: so do links that would be at the object within so many steps as fast as the sensor has seen any; all in its
            reach where it has seen none. 0 for those within `margin` alone, which a longer step can jump over.
        push_out: how far a link that is too close has to come out in one step, at most [m]. Rows that ask for motion can
            contradict other limits: `InfeasibleError` then names them.
        max_step: of every joint [rad, m for slides]; links get a row as well that such a step can bring to the object,
            however far from it they are, and however slow they were.

    Raises:
        InputError: a value out of range.
    """
    gain_of("gain", gain)
    for name, value in (("min_distance", min_distance), ("ahead", ahead), ("push_out", push_out)):
        non_negative(name, value)
    watched = max(positive("margin", margin), min_distance + _soon(touch, ahead))
    near = (touch.distance < (watched if max_step is None else sensor.reach)).nonzero()[0]
    distance, normal, point = touch.distance[near], touch.normal[near], touch.point[near]
    gradients = sensor.jacobians.at(data, point, near)
    if sensor.object_moves:
        opposite = point - distance[:, None] * normal
        gradients -= sensor.jacobians.at(data, opposite, np.full(near.size, len(touch.distance)))
    if max_step is not None:
        travel = positive("max_step", max_step) * np.linalg.norm(gradients, axis=1).sum(axis=1)
        some = distance < np.maximum(watched, travel + min_distance)
        near, distance, normal, gradients = near[some], distance[some], normal[some], gradients[some]
    matrix = (-normal[:, None, :] @ gradients)[:, 0]
    gap = distance - min_distance
    upper = contact_sides(distance, min_distance, gain)
    if push_out:
        upper = np.where(gap < 0.0, np.maximum(gap, -push_out), upper)
    names = tuple(contact_row_name(link + 1, sensor.object_name) for link in near.tolist())
    return trusted(Rows, matrix=matrix, upper=upper, names=names)


def _soon(touch: Touch, ahead: float) -> float:
    """Return how much nearer links may come within `ahead` steps like the fastest yet [m]."""
    if not ahead:
        return 0.0
    return np.inf if touch.approach is None else ahead * touch.approach
