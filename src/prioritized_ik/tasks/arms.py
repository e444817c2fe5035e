"""Virtual arms as a task."""

import numpy as np
from numpy.typing import ArrayLike

from prioritized_ik.errors import InputError
from prioritized_ik.robot import Robot
from prioritized_ik.tasks.task import Task, extent_lever
from prioritized_ik.validation import Array, finite_array, shape_of
from prioritized_ik.virtual_arms import VirtualArms


class VirtualArmsTask(Task):
    """The end points X_v of virtual arms at `target` `(n, l)` [m]; where they are now unless given (Eqs. 3 and 10).

    L = l n rows [m], arm by arm.

    Args:
        robot: see `Task`.
        arms: n virtual arms of the robot's model, in a task space of l dimensions.
        target: where the end points are to be `(n, l)` [m].
        gain: see `Task`.
        weights: one for all, one an arm `(n,)`, or one a row `(n, l)`: the diagonal of W.

    Raises:
        InputError: arms of another model, a target or weights of another shape.
    """

    def __init__(
        self,
        robot: Robot,
        arms: VirtualArms,
        target: ArrayLike | None = None,
        *,
        gain: float = 1.0,
        weights: ArrayLike = 1.0,
    ) -> None:
        if not isinstance(arms, VirtualArms):
            raise InputError(f"arms is of type {type(arms).__name__}; expected VirtualArms(robot.model, …).")
        self._arms, self._shape = arms, (arms.count, arms.dimension)
        shape = shape_of("weights of virtual arms", weights)
        each = np.repeat(weights, arms.dimension) if shape == (arms.count,) else weights
        rows = np.ravel(each) if shape == self._shape else each
        super().__init__(robot, arms.count * arms.dimension, "virtual arms", gain, rows)
        if arms.model is not robot.model:
            raise InputError("arms are virtual arms of another model; make them from the robot that is to move.")
        self.target = arms.positions(robot.data) if target is None else target

    @property
    def target(self) -> Array:
        """Where the end points are to be `(n, l)` [m]."""
        return self._target

    @target.setter
    def target(self, value: ArrayLike) -> None:
        self._target = finite_array(f"target of the {self.name}", value, self._shape)

    def lever(self, robot: Robot) -> float:
        """Return half the model's extent [m]."""
        return extent_lever(robot)

    def _rows(self, robot: Robot) -> tuple[Array, Array]:
        error = self.target - self._arms.positions(robot.data)
        return self._arms.jacobian(robot.data), error.ravel()
