"""A sum of joints at a value."""

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from prioritized_ik.errors import InputError
from prioritized_ik.robot import Robot
from prioritized_ik.tasks.task import Task
from prioritized_ik.validation import Array, finite_array

_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


class JointCoupling(Task):
    """Σ c_j q_j = `target` over hinges and slides: `{"left": 1.0, "right": -1.0}` keeps two joints alike. One row.

    Raises:
        InputError: no joint, one that does not exist, or a free or ball joint; a target that is no number.
    """

    def __init__(
        self,
        robot: Robot,
        coefficients: Mapping[str | int, float],
        target: float = 0.0,
        *,
        gain: float = 1.0,
        weights: ArrayLike = 1.0,
    ) -> None:
        if not isinstance(coefficients, Mapping):
            raise InputError(f"coefficients is {coefficients!r}; expected joints and numbers such as {{'left': 1.0}}.")
        super().__init__(robot, 1, "coupling of " + " and ".join(map(str, coefficients)), gain, weights)
        if not coefficients:
            raise InputError("a joint coupling has no joint; expected coefficients such as {'left': 1.0, 'right': -1.0}.")
        self._row = np.zeros(robot.model.nv)
        self._terms: list[tuple[int, float]] = []
        for joint, coefficient in coefficients.items():
            number = robot.joint(joint)
            if robot.model.jnt_type[number] not in _SCALAR:
                raise InputError(f"joint {joint!r} is a ball or free joint; expected hinges and slides in a coupling.")
            factor = float(finite_array(f"coefficient of {joint}", coefficient, ()))
            self._row[robot.model.jnt_dofadr[number]] += factor
            self._terms.append((int(robot.model.jnt_qposadr[number]), factor))
        self.target = target

    @property
    def target(self) -> float:
        """What the sum is to be [rad, m]."""
        return self._target

    @target.setter
    def target(self, value: float) -> None:
        self._target = float(finite_array(f"target of the {self.name}", value, ()))

    def _rows(self, robot: Robot) -> tuple[Array, Array]:
        here = sum(factor * float(robot.data.qpos[place]) for place, factor in self._terms)
        return self._row[None].copy(), np.array([self.target - here])
