"""All joints at a posture."""

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from prioritized_ik.errors import InputError
from prioritized_ik.robot import Robot
from prioritized_ik.tasks.task import Task
from prioritized_ik.validation import Array, finite_array, read_only, shape_of


class Posture(Task):
    """Every joint but free bases at the position `target` `(nq,)`; as it is now unless given. A row a degree of freedom.

    Weights may be given by joint, see `Robot.dof_values`; joints that are not named then have none.

    Raises:
        InputError: a target of another length, or a joint that does not exist.
    """

    def __init__(
        self,
        robot: Robot,
        target: ArrayLike | None = None,
        *,
        gain: float = 1.0,
        weights: ArrayLike | Mapping[str | int, ArrayLike] = 1.0,
    ) -> None:
        if not isinstance(robot, Robot):
            raise InputError(f"robot of a posture is of type {type(robot).__name__}; expected a Robot.")
        model = robot.model
        self._dofs = np.flatnonzero(model.jnt_type[model.dof_jntid] != int(mujoco.mjtJoint.mjJNT_FREE))
        self._matrix = read_only(np.eye(model.nv)[self._dofs])
        each = robot.dof_values("weights of posture", weights)[self._dofs] if isinstance(weights, Mapping) else weights
        super().__init__(robot, len(self._dofs), "posture", gain, each)
        self.target = robot.q if target is None else target

    @property
    def target(self) -> Array:
        """The position wanted `(nq,)`."""
        return self._target

    @target.setter
    def target(self, value: ArrayLike) -> None:
        nq, shape = self._model.nq, shape_of("target of the posture", value)
        if shape != (nq,):
            raise InputError(f"target of the posture has shape {shape}; expected a position ({nq},), as q.")
        self._target = finite_array("target of the posture", value, (nq,))

    def between(self, one: Array, other: Array, share: float) -> Array:
        """Return the position a `share` of the way from one to another; ball joints and free bases turn the short way."""
        way, position = np.empty(self._model.nv), np.array(one)
        mujoco.mj_differentiatePos(self._model, way, 1.0, one, other)
        mujoco.mj_integratePos(self._model, position, way, share)
        return position

    def _rows(self, robot: Robot) -> tuple[Array, Array]:
        error = np.empty(robot.model.nv)
        mujoco.mj_differentiatePos(robot.model, error, 1.0, robot.q, self.target)
        return self._matrix, error[self._dofs]
