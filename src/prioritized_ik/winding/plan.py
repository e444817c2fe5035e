"""Where the virtual end points should go to wind around the object (Eqs. 18-22). Pure functions, of one arm or of many.

Vectors stand in the last axis, so that each function takes one arm's `(3,)` or all arms' `(n, 3)`: a^i is the unit
direction of link i and c^i its contact vector, the unit normal from the object *into* the link, zero without contact. The
scan of the paper prints a and α alike; the forms here keep them apart.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from prioritized_ik.validation import Array

#: |a·e| below this counts as in plane. Without it the out-of-plane part, whose size is fixed, flips its sign almost
#: every step; 0.05 is an angle of 3 degrees, more than a step of 4 mm turns a 60 mm link by.
DEAD_BAND = 0.05

_YZX, _ZXY = np.array([1, 2, 0]), np.array([2, 0, 1])


def plane_normal(link_direction: Array, contact_vector: Array) -> Array:
    """Eq. (22): e^{i-1} = a^{i-1} x c^{i-1} `(…, 3)`, normal of the plane P of link and contact.

    Both indices are i - 1: with a^i, as the text around Eq. (22) has it, a^i·e^{i-1} would vanish identically.
    """
    return _cross(link_direction, contact_vector)


def side_sign(link_direction: Array, normal: Array, dead_band: float = DEAD_BAND) -> Array:
    """Eq. (21): s^i = -sign(a^i·e^{i-1}) `(…)`, and 0 within the dead band."""
    out_of_plane = (link_direction * normal).sum(axis=-1)
    return np.where(np.abs(out_of_plane) <= dead_band, 0.0, -np.sign(out_of_plane))


def into_plane(sign: ArrayLike, normal: Array) -> Array:
    """Eq. (20), first half: β^i = s^i e^{i-1} `(…, 3)`, towards the plane P."""
    return np.asarray(sign)[..., None] * normal


def towards_object(link_direction: Array, normal: Array) -> Array:
    """Eq. (20), second half: γ^i = a^i x e^{i-1} `(…, 3)`, in the plane P and towards the object.

    The scan prints α^i for a^i, which would define α^i by itself.
    """
    return _cross(link_direction, normal)


def winding_direction(into: Array, towards: Array) -> Array:
    """Eq. (19): α^i = β^i + γ^i `(…, 3)`."""
    return into + towards


def desired_displacement(
    direction: Array, previous_in_contact: ArrayLike, in_contact: ArrayLike, *, speed: float, dt: float
) -> Array:
    """Eq. (18): dX^{i*} = η dt α^i M^{i-1} (1 - M^i) `(…, 3)` [m].

    Equal to the printed (1 - M^i)(M^{i-1} - M^i) for M in {0, 1}. η is a speed [m/s]: 2.0 read as metres would be 33
    link lengths a step.
    """
    driven = np.logical_and(previous_in_contact, np.logical_not(in_contact))
    return speed * dt * direction * driven[..., None]


def plan_arm(
    previous_direction: Array,
    previous_contact_vector: Array,
    previous_in_contact: ArrayLike,
    direction: Array,
    in_contact: ArrayLike,
    *,
    speed: float,
    dt: float,
    dead_band: float = DEAD_BAND,
) -> tuple[Array, Array]:
    """Return dX^{i*} `(…, 3)` [m] and s^i `(…)` of an arm, from links i - 1 and i alone (Eqs. 18-22).

    Nothing else is read, so that all arms can be planned in parallel.
    """
    normal = plane_normal(previous_direction, previous_contact_vector)
    sign = side_sign(direction, normal, dead_band)
    alpha = winding_direction(into_plane(sign, normal), towards_object(direction, normal))
    return desired_displacement(alpha, previous_in_contact, in_contact, speed=speed, dt=dt), sign


def plan(
    directions: Array,
    contact_vectors: Array,
    in_contact: NDArray[np.bool_],
    *,
    speed: float,
    dt: float,
    dead_band: float = DEAD_BAND,
) -> tuple[Array, Array]:
    """Return the desired displacements dX* `(n, 3)` [m] and the signs s `(n,)` of all arms, planned in parallel.

    Args:
        directions: a `(n, 3)`.
        contact_vectors: c `(n, 3)`.
        in_contact: M `(n,)`; M^0 = 0 is understood, so the first arm is never driven.
        speed: η [m/s].
        dt: time step [s].
        dead_band: see `DEAD_BAND`.
    """
    displacements, signs = np.zeros_like(directions), np.zeros(len(directions))
    displacements[1:], signs[1:] = plan_arm(
        directions[:-1],
        contact_vectors[:-1],
        in_contact[:-1],
        directions[1:],
        in_contact[1:],
        speed=speed,
        dt=dt,
        dead_band=dead_band,
    )
    return displacements, signs


def driven_arms(in_contact: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which arms Eq. (18) drives `(n,)`: those free while the link before is in contact."""
    driven = np.zeros(len(in_contact), dtype=bool)
    driven[1:] = in_contact[:-1] & ~in_contact[1:]
    return driven


def first_and_last_in_contact(in_contact: NDArray[np.bool_]) -> tuple[int, int]:
    """Return the first link in contact and the last of the links in successive contact with it, from 1; (0, 0) if none.

    The first is the paper's k of state [1]; the last is its k of Eqs. (23) and (24).
    """
    touching = np.flatnonzero(in_contact)
    if not touching.size:
        return 0, 0
    first = int(touching[0])
    gaps = np.flatnonzero(~in_contact[first:])
    last = first + int(gaps[0]) - 1 if gaps.size else len(in_contact) - 1
    return first + 1, last + 1


def _cross(a: Array, b: Array) -> Array:
    """Return a x b of vectors in the last axis, ten times faster than `numpy.cross` on small arrays."""
    return a.take(_YZX, axis=-1) * b.take(_ZXY, axis=-1) - a.take(_ZXY, axis=-1) * b.take(_YZX, axis=-1)
