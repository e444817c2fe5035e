"""Coordinates in whole numbers, as a page holds them."""

import base64

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.validation import Array

LARGEST = 32767  # of the whole numbers that coordinates are stored as: 0.02 mm steps over an arm of 1 m


def quantised(points: Array) -> tuple[NDArray[np.int16], Array, float]:
    """Return `points` `(…, 3)` as 16-bit numbers, little-endian; they are `centre` `(3,)` + number × `unit`."""
    if not points.size:
        return np.zeros(points.shape, dtype="<i2"), np.zeros(3), 1.0
    low, high = points.reshape(-1, 3).min(axis=0), points.reshape(-1, 3).max(axis=0)
    centre, unit = 0.5 * (low + high), max(float((high - low).max()), 1e-9) / (2 * LARGEST)
    return np.round((points - centre) / unit).astype("<i2"), centre, unit


def base64_of(content: bytes) -> str:
    """Return bytes as JSON takes them."""
    return base64.b64encode(content).decode("ascii")
