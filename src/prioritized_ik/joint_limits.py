"""Limits of a robot's joints: their range, and how fast they move."""

from collections.abc import Mapping

import mujoco
import numpy as np

from prioritized_ik.errors import InputError
from prioritized_ik.guard import OUTSIDE, Guarded, Limit
from prioritized_ik.limits import joint_names, joint_range_bounds
from prioritized_ik.problem import Bounds, Rows
from prioritized_ik.robot import Robot
from prioritized_ik.tolerances import ROUNDING
from prioritized_ik.validation import Array, gain_of, non_negative, one_of, positive

_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
_BALL = int(mujoco.mjtJoint.mjJNT_BALL)

#: [rad] A ball joint this far beyond its limit is no error: turns across the limit's gradient leave it by about half the
#: step's square.
BALL_DRIFT = 1e-2


class JointRange(Limit):
    """Every limited hinge, slide and ball joint in its range.

    A ball joint turned by the angle φ about the axis u keeps u·ω <= gain (φ_max - margin - φ) for its step ω.

    Args:
        robot: whose joints.
        gain: how much of the way to the end of its range a joint may take in one step, in (0, 1].
        margin: kept free at both ends of every range [rad; m for slides].
        outside: of a joint outside its range: `"raise"` an error; `"hold"`, it may not go further; `"return"`, it also
            comes back, before any task.
        return_speed: how fast, at most [rad/s, m/s].

    Raises:
        InputError: a value out of range, or a margin that leaves a joint no range.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        gain: float = 1.0,
        margin: float = 0.0,
        outside: str = "return",
        return_speed: float = 0.5,
    ) -> None:
        super().__init__(robot)
        model = robot.model
        self._gain, self._margin = gain_of("gain", gain), non_negative("margin", margin)
        self._outside, self._speed = one_of("outside", outside, OUTSIDE), positive("return_speed", return_speed)
        limited = model.jnt_limited != 0
        self._joints = np.flatnonzero(limited & np.isin(model.jnt_type, (_HINGE, _SLIDE)))
        self._balls = np.flatnonzero(limited & (model.jnt_type == _BALL))
        low, high = model.jnt_range[self._joints].T
        self._low, self._high = low + self._margin, high - self._margin
        narrow = [*self._joints[self._low > self._high], *self._balls[model.jnt_range[self._balls, 1] < self._margin]]
        if narrow:
            raise InputError(f"margin is {margin}, more than half the range of {robot.names('joint')[narrow[0]]}.")

    def _at(self, robot: Robot, dt: float) -> Guarded:
        if self._outside == "raise":
            joint_range_bounds(robot.model, robot.q)
        bounds, back = self._scalars(robot, dt)
        rows, way = self._ball_rows(robot, dt)
        returning = tuple(part for part in (back, way) if part is not None) if self._outside == "return" else ()
        return Guarded(bounds, rows, returning)

    def _scalars(self, robot: Robot, dt: float) -> tuple[Bounds, Rows | None]:
        model, names = robot.model, joint_names(robot.model)
        lower, upper = np.full(model.nv, -np.inf), np.full(model.nv, np.inf)
        dofs, here = model.jnt_dofadr[self._joints], robot.data.qpos[model.jnt_qposadr[self._joints]]
        down, up = self._low - here, self._high - here
        lower[dofs], upper[dofs] = self._gain * np.minimum(down, 0.0), self._gain * np.maximum(up, 0.0)
        excess = np.maximum(down, -up)
        out = np.flatnonzero(excess > ROUNDING)
        bounds = Bounds(lower, upper, names)
        if not out.size:
            return bounds, None
        matrix = np.zeros((len(out), model.nv))
        matrix[np.arange(len(out)), dofs[out]] = np.where(down[out] > 0.0, -1.0, 1.0)
        return bounds, Rows(matrix, -self._back(excess[out], dt), [f"{names[dofs[i]]} return" for i in out])

    def _ball_rows(self, robot: Robot, dt: float) -> tuple[Rows | None, Rows | None]:
        model = robot.model
        if not self._balls.size:
            return None, None
        matrix, room, names = np.zeros((len(self._balls), model.nv)), np.zeros(len(self._balls)), []
        for i, joint in enumerate(self._balls):
            turn = np.empty(3)
            place, dof = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
            mujoco.mju_quat2Vel(turn, robot.data.qpos[place : place + 4], 1.0)
            angle = float(np.linalg.norm(turn))
            room[i] = model.jnt_range[joint, 1] - self._margin - angle
            matrix[i, dof : dof + 3] = turn / angle if angle > ROUNDING else 0.0
            names.append(f"{robot.names('joint')[joint]} range")
            if self._outside == "raise" and room[i] + self._margin < -BALL_DRIFT:
                raise InputError(
                    f"ball joint {robot.names('joint')[joint]} is turned by {angle:.6g}, outside its range of "
                    f"{model.jnt_range[joint, 1]:.6g}; move it inside, or choose outside='return'."
                )
        rows = Rows(matrix, self._gain * np.maximum(room, 0.0), names)
        out = room < -ROUNDING
        if not out.any():
            return rows, None
        return rows, Rows(matrix[out], -self._back(-room[out], dt), [f"{names[i]} return" for i in np.flatnonzero(out)])

    def _back(self, excess: Array, dt: float) -> Array:
        """Return how far to come back in one step."""
        return np.minimum(excess, self._speed * dt)


class Velocity(Limit):
    """Every joint no faster than a speed.

    Args:
        robot: whose joints.
        fastest: [rad/s, m/s] one for all degrees of freedom but those of free bases; or by joint, the others being free.

    Raises:
        InputError: a speed that is not positive, or a joint that does not exist.
    """

    def __init__(self, robot: Robot, fastest: float | Mapping[str | int, float]) -> None:
        super().__init__(robot)
        model = robot.model
        self._fastest = np.full(model.nv, np.inf)
        if isinstance(fastest, Mapping):
            for joint, speed in fastest.items():
                self._fastest[robot.dofs(joint)] = positive(f"fastest of {joint}", speed)
        else:
            based = model.jnt_type[model.dof_jntid] == int(mujoco.mjtJoint.mjJNT_FREE)
            self._fastest[~based] = positive("fastest", fastest)

    def _at(self, robot: Robot, dt: float) -> Guarded:
        return Guarded(Bounds(-self._fastest * dt, self._fastest * dt, joint_names(robot.model)))
