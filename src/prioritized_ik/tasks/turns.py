"""Rotations as vectors."""

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from prioritized_ik.errors import InputError
from prioritized_ik.tolerances import ROUNDING
from prioritized_ik.validation import Array, finite_array, read_only, shape_of

SQUARE = 1e-6  # a given rotation matrix may be this far from one


def rotation_of(name: str, value: ArrayLike) -> Array:
    """Return a rotation matrix `(3, 3)` from one, or from a quaternion `(4,)`, w first.

    Raises:
        InputError: another shape, or no rotation.
    """
    shape = shape_of(name, value)
    if shape == (4,):
        quaternion = np.array(finite_array(name, value, (4,)))
        if not quaternion.any():
            raise InputError(f"{name} is a quaternion of zeros; expected a rotation.")
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, quaternion / np.linalg.norm(quaternion))
        return read_only(matrix.reshape(3, 3))
    if shape != (3, 3):
        raise InputError(f"{name} has shape {shape}; expected a quaternion (4,) or a rotation matrix (3, 3).")
    matrix = finite_array(name, value, (3, 3))
    if not np.allclose(matrix @ matrix.T, np.eye(3), atol=SQUARE) or np.linalg.det(matrix) < 0.0:
        raise InputError(f"{name} is {matrix.tolist()}; expected a rotation matrix.")
    return matrix


def turn_between(here: Array, there: Array) -> Array:
    """Return the rotation vector `(3,)` [rad] in the world that takes the rotation `here` to `there`."""
    quaternion, vector = np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(quaternion, (there @ here.T).ravel())
    mujoco.mju_quat2Vel(vector, quaternion, 1.0)
    return vector


def turned(rotation: Array, turn: Array) -> Array:
    """Return `rotation` `(3, 3)` turned by the rotation vector `turn` `(3,)` [rad] of the world."""
    quaternion, matrix = np.array([1.0, 0.0, 0.0, 0.0]), np.empty(9)
    mujoco.mju_quatIntegrate(quaternion, turn, 1.0)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3) @ rotation


def shortest_turn(here: Array, there: Array) -> Array:
    """Return the shortest rotation vector `(3,)` [rad] that takes the unit vector `here` to `there`."""
    axis = np.cross(here, there)
    sine, cosine = float(np.linalg.norm(axis)), float(here @ there)
    if sine <= ROUNDING:
        return np.zeros(3) if cosine > 0.0 else np.pi * across(here)[0]  # opposite: any axis across is as short
    return np.arctan2(sine, cosine) / sine * axis


def across(direction: Array) -> Array:
    """Return two unit vectors across a unit vector and each other `(2, 3)`."""
    first = np.cross(direction, np.eye(3)[int(np.abs(direction).argmin())])
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(direction, first)])


def unit(name: str, value: ArrayLike) -> Array:
    """Return a direction `(3,)` as a unit vector.

    Raises:
        InputError: another shape, or zero.
    """
    vector = finite_array(name, value, (3,))
    if not vector.any():
        raise InputError(f"{name} is zero; expected a direction.")
    return read_only(vector / np.linalg.norm(vector))
