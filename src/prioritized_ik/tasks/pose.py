"""A frame at a place, turned as wanted."""

import numpy as np
from numpy.typing import ArrayLike

from prioritized_ik.errors import InputError
from prioritized_ik.robot import Robot
from prioritized_ik.tasks.task import FrameTask, extent_lever
from prioritized_ik.tasks.turns import rotation_of, turn_between, turned
from prioritized_ik.validation import Array, finite_array, shape_of


class Pose(FrameTask):
    """A frame at a pose `target` of the world or of `root`, a homogeneous matrix `(4, 4)`; as it is now unless given.

    Six rows: three of the origin [m], then three of the rotation [rad]. `weights` trade one against the other; for
    position strictly before orientation, give `Position` and `Orientation` a level each.

    Raises:
        InputError: a frame that does not exist, or a target that is no pose.
    """

    kind = "pose"
    row_count = 6

    def _now(self, robot: Robot) -> Array:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = self._rotation(robot), self._position(robot)
        return pose

    def _checked(self, value: ArrayLike) -> Array:
        shape = shape_of(f"target of {self.name}", value)
        if shape != (4, 4):
            raise InputError(f"target of {self.name} has shape {shape}; expected a homogeneous matrix (4, 4).")
        pose = finite_array(f"target of {self.name}", value, (4, 4))
        if not np.array_equal(pose[3], [0.0, 0.0, 0.0, 1.0]):
            raise InputError(f"target of {self.name} is {pose.tolist()}; expected the last row 0, 0, 0, 1.")
        rotation_of(f"rotation in the target of {self.name}", pose[:3, :3])
        return pose

    def between(self, one: Array, other: Array, share: float) -> Array:
        """Return the pose on the straight line, and a `share` of the shortest turn, from one to another."""
        pose = (1.0 - share) * one + share * other
        pose[:3, :3] = turned(one[:3, :3], share * turn_between(one[:3, :3], other[:3, :3]))
        return pose

    def lever(self, robot: Robot) -> float:
        """Return the larger of half the model's extent and 1."""
        return max(extent_lever(robot), 1.0)

    def error(self, robot: Robot) -> Array:
        """See `Task.error`."""
        turn = turn_between(self._rotation(robot), self.target[:3, :3])
        return np.concatenate([self.target[:3, 3] - self._position(robot), turn])

    def _rows(self, robot: Robot) -> tuple[Array, Array]:
        return np.concatenate(self._jacobians(robot)), self.error(robot)
