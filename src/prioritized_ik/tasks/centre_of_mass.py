"""The centre of mass at a point of the world."""

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from prioritized_ik.robot import Robot
from prioritized_ik.tasks.task import Task, extent_lever
from prioritized_ik.validation import Array, finite_array


class CentreOfMass(Task):
    """The centre of mass of `body` and all it carries at `target` `(3,)` [m]; where it is now unless given.

    Three rows [m]; weights of `(1, 1, 0)` leave the height free.

    Raises:
        InputError: a body that does not exist, or a target of another dimension.
    """

    def __init__(
        self,
        robot: Robot,
        target: ArrayLike | None = None,
        *,
        body: str | int = 0,
        gain: float = 1.0,
        weights: ArrayLike = 1.0,
    ) -> None:
        super().__init__(robot, 3, "centre of mass", gain, weights)
        self._body = robot.body(body)
        self.target = robot.data.subtree_com[self._body] if target is None else target

    @property
    def target(self) -> Array:
        """Where the centre of mass is to be `(3,)` [m]."""
        return self._target

    @target.setter
    def target(self, value: ArrayLike) -> None:
        self._target = finite_array(f"target of the {self.name}", value, (3,))

    def place(self, robot: Robot) -> Array:
        """Return where the centre of mass is `(3,)` [m]."""
        return np.array(robot.data.subtree_com[self._body])

    def lever(self, robot: Robot) -> float:
        """Return half the model's extent [m]."""
        return extent_lever(robot)

    def _rows(self, robot: Robot) -> tuple[Array, Array]:
        jacobian = np.zeros((3, robot.model.nv))
        mujoco.mj_jacSubtreeCom(robot.model, robot.data, jacobian, self._body)
        return jacobian, self.target - robot.data.subtree_com[self._body]
