"""A frame's axis along a direction of the world, or towards a point of it."""

import numpy as np
from numpy.typing import ArrayLike

from prioritized_ik.errors import InputError
from prioritized_ik.robot import Robot
from prioritized_ik.tasks.task import FrameTask
from prioritized_ik.tasks.turns import across, shortest_turn, unit
from prioritized_ik.tolerances import ROUNDING
from prioritized_ik.validation import Array, finite_array


class Axis(FrameTask):
    """`axis` `(3,)`, fixed to a frame, along the direction `target` `(3,)` of the world; turns about it are free.

    Two rows [rad], across the axis: the shortest turn that is left.

    Raises:
        InputError: a frame that does not exist; an axis or target of another dimension, or zero.
    """

    kind = "axis"

    def __init__(
        self,
        robot: Robot,
        target: ArrayLike,
        *,
        axis: ArrayLike = (0.0, 0.0, 1.0),
        body: str | int | None = None,
        site: str | int | None = None,
        geom: str | int | None = None,
        gain: float = 1.0,
        weights: ArrayLike = 1.0,
    ) -> None:
        super().__init__(robot, 2, body=body, site=site, geom=geom, gain=gain, weights=weights)
        self._axis = unit(f"axis of {self.name}", axis)
        self.target = target

    @property
    def target(self) -> Array:
        """The direction wanted, of length 1 `(3,)`."""
        return self._target

    @target.setter
    def target(self, value: ArrayLike) -> None:
        self._target = unit(f"target of {self.name}", value)

    def lever(self, robot: Robot) -> float:
        """Return 1: turns add up to first order only."""
        return 1.0

    def _rows(self, robot: Robot) -> tuple[Array, Array]:
        here = robot.rotation(self.frame) @ self._axis
        sides = across(here)
        return sides @ robot.jacobians(self.frame)[1], sides @ shortest_turn(here, self.target)


class LookAt(FrameTask):
    """`axis` `(3,)`, fixed to a frame, through the point `target` `(3,)` [m] of the world; turns about it are free.

    Two rows [rad], across the axis: the shortest turn that is left. The frame may also move to look.

    Raises:
        InputError: a frame that does not exist; an axis that is zero; a target of another dimension, or, when looked at,
            at the frame's origin.
    """

    kind = "look-at"

    def __init__(
        self,
        robot: Robot,
        target: ArrayLike,
        *,
        axis: ArrayLike = (0.0, 0.0, 1.0),
        body: str | int | None = None,
        site: str | int | None = None,
        geom: str | int | None = None,
        gain: float = 1.0,
        weights: ArrayLike = 1.0,
    ) -> None:
        super().__init__(robot, 2, body=body, site=site, geom=geom, gain=gain, weights=weights)
        self._axis = unit(f"axis of {self.name}", axis)
        self.target = target

    @property
    def target(self) -> Array:
        """The point to look at `(3,)` [m]."""
        return self._target

    @target.setter
    def target(self, value: ArrayLike) -> None:
        self._target = finite_array(f"target of {self.name}", value, (3,))

    def lever(self, robot: Robot) -> float:
        """Return 1: turns add up to first order only."""
        return 1.0

    def _rows(self, robot: Robot) -> tuple[Array, Array]:
        sight = self.target - robot.position(self.frame)
        distance = float(np.linalg.norm(sight))
        if distance <= ROUNDING:
            raise InputError(f"target of {self.name} is at the frame's origin; expected a point away from it.")
        here, there = robot.rotation(self.frame) @ self._axis, sight / distance
        linear, angular = robot.jacobians(self.frame)
        # The axis turns by ω, the line of sight by -there × v / distance: what counts is the one less the other.
        turning = angular + np.cross(there, linear, axisb=0, axisc=0) / distance
        sides = across(here)
        return sides @ turning, sides @ shortest_turn(here, there)
