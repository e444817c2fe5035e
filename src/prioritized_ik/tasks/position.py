"""A point of the robot at a point of the world."""

from numpy.typing import ArrayLike

from prioritized_ik.robot import Robot
from prioritized_ik.tasks.task import FrameTask, extent_lever
from prioritized_ik.validation import Array, finite_array


class Position(FrameTask):
    """The origin of a frame at `target` `(3,)` [m] in the world; where it is now unless given. Three rows [m].

    Raises:
        InputError: a frame that does not exist, or a target of another dimension.
    """

    kind = "position"

    def __init__(
        self,
        robot: Robot,
        target: ArrayLike | None = None,
        *,
        body: str | int | None = None,
        site: str | int | None = None,
        geom: str | int | None = None,
        gain: float = 1.0,
        weights: ArrayLike = 1.0,
    ) -> None:
        super().__init__(robot, 3, body=body, site=site, geom=geom, gain=gain, weights=weights)
        self.target = robot.position(self.frame) if target is None else target

    @property
    def target(self) -> Array:
        """Where the origin is to be `(3,)` [m]."""
        return self._target

    @target.setter
    def target(self, value: ArrayLike) -> None:
        self._target = finite_array(f"target of {self.name}", value, (3,))

    def lever(self, robot: Robot) -> float:
        """Return half the model's extent [m]."""
        return extent_lever(robot)

    def _rows(self, robot: Robot) -> tuple[Array, Array]:
        return robot.jacobians(self.frame)[0], self.target - robot.position(self.frame)
