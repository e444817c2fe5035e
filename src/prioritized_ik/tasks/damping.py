"""Joints at rest."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from prioritized_ik.errors import InputError
from prioritized_ik.robot import Robot
from prioritized_ik.tasks.task import Task
from prioritized_ik.validation import Array


class Damping(Task):
    """Every degree of freedom at rest, dθ = 0, by its weight: what the levels above leave open is not moved.

    In a level with other tasks it trades motion for error; in a level of its own it leaves those below only joints of
    weight zero.

    Args:
        robot: see `Task`.
        weights: one for all, `(nv,)`, or by joint, see `Robot.dof_values`; joints that are not named have none.
            `robot.metric` makes metres and radians of one size.

    Raises:
        InputError: a joint that does not exist; weights of another length, or below zero.
    """

    def __init__(self, robot: Robot, weights: ArrayLike | Mapping[str | int, ArrayLike] = 1.0) -> None:
        if not isinstance(robot, Robot):
            raise InputError(f"robot of a damping is of type {type(robot).__name__}; expected a Robot.")
        super().__init__(robot, robot.model.nv, "damping", weights=robot.dof_values("weights of damping", weights))

    def _rows(self, robot: Robot) -> tuple[Array, Array]:
        return np.eye(self.size), np.zeros(self.size)
