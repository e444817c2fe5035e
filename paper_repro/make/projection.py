"""Parallel projection of points in space onto the page, for line drawings."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from prioritized_ik.validation import Array


@dataclass(frozen=True)
class View:
    """Where the drawing is seen from.

    Attributes:
        azimuth: of the viewer about z, from +x [rad].
        elevation: above the plane of x and y [rad].
    """

    azimuth: float
    elevation: float

    @property
    def frame(self) -> Array:
        """Rows: to the right and upwards on the page, and towards the viewer `(3, 3)`."""
        a, e = self.azimuth, self.elevation
        towards = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        right = np.array([-np.sin(a), np.cos(a), 0.0])
        return np.array([right, np.cross(towards, right), towards])

    def page(self, points: ArrayLike) -> Array:
        """Return points `(..., 3)` on the page `(..., 2)`, in the same unit."""
        return np.asarray(points) @ self.frame[:2].T

    def depth(self, points: ArrayLike) -> Array:
        """Return how near points `(..., 3)` are to the viewer `(...)`."""
        return np.asarray(points) @ self.frame[2]
