"""A frame's axis along a direction of the world, or towards a point of it."""

import numpy as np
from numpy.typing import ArrayLike

from prioritized_ik.errors import InputError
from prioritized_ik.robot import Frame, Robot
from prioritized_ik.tasks.task import FrameTask
from prioritized_ik.tasks.turns import across, shortest_turn, turned, unit
from prioritized_ik.tolerances import ROUNDING
from prioritized_ik.validation import Array, finite_array


class _AxisTask(FrameTask):
    """Two rows [rad] across an `axis` `(3,)` that is fixed to a frame."""

    row_count = 2

    def __init__(
        self,
        robot: Robot,
        target: ArrayLike,
        *,
        axis: ArrayLike = (0.0, 0.0, 1.0),
        body: str | int | None = None,
        site: str | int | None = None,
        geom: str | int | None = None,
        root: Frame | None = None,
        gain: float = 1.0,
        weights: ArrayLike = 1.0,
    ) -> None:
        self._axis = unit(f"axis of {self.kind}", axis)
        super().__init__(robot, target, body=body, site=site, geom=geom, root=root, gain=gain, weights=weights)

    def lever(self, robot: Robot) -> float:
        """Return 1: turns add up to first order only."""
        return 1.0

    def _pointing(self, robot: Robot) -> Array:
        """Return the axis `(3,)` in the world or the root."""
        return self._rotation(robot) @ self._axis


class Axis(_AxisTask):
    """`axis` `(3,)`, fixed to a frame, along the direction `target` `(3,)` of the world or `root`; turns about it are free.

    Two rows [rad], across the axis: the shortest turn that is left.

    Raises:
        InputError: a frame that does not exist; an axis or target of another dimension, or zero.
    """

    kind = "axis"

    def between(self, one: Array, other: Array, share: float) -> Array:
        """Return the direction a `share` of the shortest turn from one to another."""
        return turned(np.eye(3), share * shortest_turn(one, other)) @ one

    def _now(self, robot: Robot) -> Array:
        return self._pointing(robot)

    def _checked(self, value: ArrayLike) -> Array:
        return unit(f"target of {self.name}", value)

    def _rows(self, robot: Robot) -> tuple[Array, Array]:
        here = self._pointing(robot)
        sides = across(here)
        return sides @ self._jacobians(robot)[1], sides @ shortest_turn(here, self.target)


class LookAt(_AxisTask):
    """`axis` `(3,)`, fixed to a frame, through the point `target` `(3,)` [m] of world or `root`; turns about it are free.

    Two rows [rad], across the axis: the shortest turn that is left. The frame may also move to look.

    Raises:
        InputError: a frame that does not exist; an axis that is zero; a target of another dimension, or, when looked at,
            at the frame's origin.
    """

    kind = "look-at"

    def _now(self, robot: Robot) -> Array:
        return self._position(robot) + self._pointing(robot)

    def _checked(self, value: ArrayLike) -> Array:
        return finite_array(f"target of {self.name}", value, (3,))

    def _rows(self, robot: Robot) -> tuple[Array, Array]:
        sight = self.target - self._position(robot)
        distance = float(np.linalg.norm(sight))
        if distance <= ROUNDING:
            raise InputError(f"target of {self.name} is at the frame's origin; expected a point away from it.")
        here, there = self._pointing(robot), sight / distance
        linear, angular = self._jacobians(robot)
        # The axis turns by ω, the line of sight by -there × v / distance: what counts is the one less the other.
        turning = angular + np.cross(there, linear, axisb=0, axisc=0) / distance
        sides = across(here)
        return sides @ turning, sides @ shortest_turn(here, there)
