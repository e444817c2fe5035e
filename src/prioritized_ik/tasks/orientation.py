"""A frame turned as wanted."""

from numpy.typing import ArrayLike

from prioritized_ik.robot import Robot
from prioritized_ik.tasks.task import FrameTask
from prioritized_ik.tasks.turns import rotation_of, turn_between, turned
from prioritized_ik.validation import Array


class Orientation(FrameTask):
    """A frame turned like `target` in the world, or in `root`: a quaternion `(4,)`, w first, or a rotation matrix `(3, 3)`.

    As it is now unless given. Three rows [rad], along the axes of world or root: the rotation vector that is left.

    Raises:
        InputError: a frame that does not exist, or a target that is no rotation.
    """

    kind = "orientation"

    def _now(self, robot: Robot) -> Array:
        return self._rotation(robot)

    def _checked(self, value: ArrayLike) -> Array:
        return rotation_of(f"target of {self.name}", value)

    def between(self, one: Array, other: Array, share: float) -> Array:
        """Return the rotation a `share` of the shortest turn from one to another."""
        return turned(one, share * turn_between(one, other))

    def lever(self, robot: Robot) -> float:
        """Return 1: turns add up to first order only."""
        return 1.0

    def _rows(self, robot: Robot) -> tuple[Array, Array]:
        return self._jacobians(robot)[1], turn_between(self._rotation(robot), self.target)
