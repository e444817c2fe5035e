"""A point of the robot at a point of the world."""

from numpy.typing import ArrayLike

from prioritized_ik.robot import Robot
from prioritized_ik.tasks.task import FrameTask, extent_lever
from prioritized_ik.validation import Array, finite_array


class Position(FrameTask):
    """The origin of a frame at `target` `(3,)` [m] in the world or `root`; where it is now unless given. Three rows [m].

    Raises:
        InputError: a frame that does not exist, or a target of another dimension.
    """

    kind = "position"

    def _now(self, robot: Robot) -> Array:
        return self._position(robot)

    def _checked(self, value: ArrayLike) -> Array:
        return finite_array(f"target of {self.name}", value, (3,))

    def lever(self, robot: Robot) -> float:
        """Return half the model's extent [m]."""
        return extent_lever(robot)

    def error(self, robot: Robot) -> Array:
        """See `Task.error`."""
        return self.target - self._position(robot)

    def _rows(self, robot: Robot) -> tuple[Array, Array]:
        jacobian = robot.position_jacobian(self.frame) if self.root is None else self._jacobians(robot)[0]
        return jacobian, self.error(robot)
