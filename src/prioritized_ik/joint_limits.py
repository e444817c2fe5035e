"""Limits of a robot's joints: their range, how fast they move, and how fast that changes."""

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from prioritized_ik.errors import InputError
from prioritized_ik.guard import OUTSIDE, Guarded, Limit, Way
from prioritized_ik.limits import in_succession, joint_names, joint_range_bounds
from prioritized_ik.problem import Bounds, Rows, posed_bounds
from prioritized_ik.robot import Robot
from prioritized_ik.tolerances import ROUNDING
from prioritized_ik.validation import Array, finite_array, gain_of, non_negative, one_of, positive

_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
_BALL = int(mujoco.mjtJoint.mjJNT_BALL)

_UNLIMITED = np.array([[-np.inf], [np.inf]])

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
            comes back, before any task; `"require"`, it comes back in any case.
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
        self._dofs = in_succession(model.jnt_dofadr[self._joints])
        self._places = in_succession(model.jnt_qposadr[self._joints])
        low, high = model.jnt_range[self._joints].T
        self._low, self._high = low + self._margin, high - self._margin
        narrow = [*self._joints[self._low > self._high], *self._balls[model.jnt_range[self._balls, 1] < self._margin]]
        if narrow:
            raise InputError(f"margin is {margin}, more than half the range of {robot.names('joint')[narrow[0]]}.")

    def _at(self, robot: Robot, dt: float) -> Guarded:
        if self._outside == "raise":
            joint_range_bounds(robot.model, robot.q)
        bounds, back = self._scalars(robot, dt)
        balls = self._ball_rows(robot, dt)
        returning = (back,) if back is not None and self._outside == "return" else ()
        return Guarded(bounds, balls.rows, returning + balls.recovery)

    def _scalars(self, robot: Robot, dt: float) -> tuple[Bounds, Rows | None]:
        model, names, dofs = robot.model, joint_names(robot.model), self._dofs
        here = robot.data.qpos[self._places]
        down, up = self._low - here, self._high - here
        lower, upper = np.full((2, model.nv), _UNLIMITED)
        lower[dofs], upper[dofs] = np.minimum(down, 0.0), np.maximum(up, 0.0)
        if self._gain != 1.0:
            lower[dofs] *= self._gain
            upper[dofs] *= self._gain
        excess = np.maximum(down, -up)
        if not excess.max(initial=0.0) > ROUNDING:
            return posed_bounds(lower, upper, names), None
        out, dofs = np.flatnonzero(excess > ROUNDING), model.jnt_dofadr[self._joints]
        back, low = np.minimum(excess[out], self._speed * dt), down[out] > 0.0
        if self._outside == "require":
            lower[dofs[out[low]]], upper[dofs[out[~low]]] = back[low], -back[~low]
        matrix = np.zeros((len(out), model.nv))
        matrix[np.arange(len(out)), dofs[out]] = np.where(low, -1.0, 1.0)
        return Bounds(lower, upper, names), Rows(matrix, -back, [f"{names[dofs[i]]} return" for i in out])

    @property
    def is_exact(self) -> bool:
        """See `Limit.is_exact`: those of ball joints are not."""
        return not len(self._balls)

    def room(self, robot: Robot) -> dict[str, float]:
        """Return how much further each limited ball joint may turn [rad]; the bounds of other joints are exact."""
        return {self._ball_name(robot, joint): room for joint, _, room in self._turns(robot)}

    def _ball_rows(self, robot: Robot, dt: float) -> Guarded:
        if self.is_exact:
            return Guarded()
        turns = self._turns(robot)
        matrix = np.zeros((len(turns), robot.model.nv))
        for i, (joint, turn, room) in enumerate(turns):
            dof, angle = robot.model.jnt_dofadr[joint], float(np.linalg.norm(turn))
            matrix[i, dof : dof + 3] = turn / angle if angle > ROUNDING else 0.0
            if self._outside == "raise" and room + self._margin < -BALL_DRIFT:
                raise InputError(
                    f"ball joint {robot.names('joint')[joint]} is turned by {angle:.6g}, outside its range of "
                    f"{robot.model.jnt_range[joint, 1]:.6g}; move it inside, or choose outside='return'."
                )
        rooms, names = np.array([room for _, _, room in turns]), [self._ball_name(robot, joint) for joint, _, _ in turns]
        return Way(self._outside, self._gain, self._speed, ROUNDING).guarded(matrix, rooms, names, dt)

    def _turns(self, robot: Robot) -> list[tuple[int, Array, float]]:
        """Return each limited ball joint, its rotation vector `(3,)`, and how much further it may turn [rad]."""
        turns = []
        for joint in self._balls.tolist():
            turn, place = np.empty(3), robot.model.jnt_qposadr[joint]
            mujoco.mju_quat2Vel(turn, robot.data.qpos[place : place + 4], 1.0)
            turns.append((joint, turn, float(robot.model.jnt_range[joint, 1] - self._margin - np.linalg.norm(turn))))
        return turns

    def _ball_name(self, robot: Robot, joint: int) -> str:
        return f"{robot.names('joint')[joint]} range"


class Velocity(Limit):
    """Every joint no faster than a speed.

    Args:
        robot: whose joints.
        fastest: [rad/s, m/s] one for all joints but free bases; or by joint (name, pattern or number), the others being
            free: one for the joint, or one for each of its degrees of freedom.
        base: of free bases, along each axis of the world [m/s] and about each of the base's own [rad/s]; free unless given.

    Raises:
        InputError: a speed that is not positive, or a joint that does not exist.
    """

    def __init__(
        self,
        robot: Robot,
        fastest: float | Mapping[str | int, ArrayLike],
        *,
        base: tuple[float, float] | None = None,
    ) -> None:
        super().__init__(robot)
        self._fastest = _by_dof(robot, "fastest", fastest, base)
        self._dt, self._guarded = 0.0, Guarded()  # of the last step

    def _at(self, robot: Robot, dt: float) -> Guarded:
        if dt != self._dt:
            furthest = self._fastest * dt
            bounds = posed_bounds(-furthest, furthest, joint_names(robot.model))
            self._dt, self._guarded = dt, Guarded(bounds)
        return self._guarded


class Acceleration(Limit):
    """Every joint's velocity within a·dt of the last, `Robot.velocity`, and slow enough to stop at the end of its range.

    Speeding up, and starting to brake before the end of the range, are hard. To brake no harder than a is the first
    thing asked of a step, above all tasks, but other limits come before it: a joint that meets an object stops there.

    With a distance d left, the velocity v keeps v²/(2 a) <= d - v dt, so that braking by a·dt a step ends inside.

    Args:
        robot: whose joints.
        greatest: a [rad/s², m/s²], as `fastest` of `Velocity`.
        base: a of free bases, as in `Velocity`.
        margin: that of `JointRange`, where one is given.

    Raises:
        InputError: an acceleration that is not positive, or a joint that does not exist.
    """

    def __init__(
        self,
        robot: Robot,
        greatest: float | Mapping[str | int, ArrayLike],
        *,
        base: tuple[float, float] | None = None,
        margin: float = 0.0,
    ) -> None:
        super().__init__(robot)
        model = robot.model
        self._greatest = _by_dof(robot, "greatest", greatest, base)
        scalar = (model.jnt_limited != 0) & np.isin(model.jnt_type, (_HINGE, _SLIDE))
        self._joints = np.flatnonzero(scalar & np.isfinite(self._greatest[model.jnt_dofadr]))
        self._margin = non_negative("margin", margin)

    def _at(self, robot: Robot, dt: float) -> Guarded:
        names, change = joint_names(robot.model), self._greatest * dt * dt
        least, most = robot.velocity * dt - change, robot.velocity * dt + change
        lower, upper = np.minimum(least, 0.0), np.maximum(most, 0.0)
        dofs, (down, up) = robot.model.jnt_dofadr[self._joints], self._stopping(robot, dt)
        lower[dofs], upper[dofs] = np.maximum(lower[dofs], -down), np.minimum(upper[dofs], up)
        forward, backward = np.flatnonzero(least > 0.0), np.flatnonzero(most < 0.0)
        rolling = np.append(forward, backward)
        if not rolling.size:
            return Guarded(Bounds(lower, upper, names))
        matrix = np.zeros((len(rolling), robot.model.nv))
        matrix[np.arange(len(rolling)), rolling] = np.repeat([-1.0, 1.0], [len(forward), len(backward)])
        slowest = np.minimum(np.append(least[forward], -most[backward]), np.append(upper[forward], -lower[backward]))
        braking = Rows(matrix, -slowest, [f"{names[dof]} braking" for dof in rolling])
        return Guarded(Bounds(lower, upper, names), recovery=(braking,))

    def _stopping(self, robot: Robot, dt: float) -> Array:
        """Return the longest steps down and up `(2, k)` after which a limited joint can still stop inside its range."""
        model = robot.model
        here = robot.data.qpos[model.jnt_qposadr[self._joints]]
        low, high = model.jnt_range[self._joints].T
        room = np.maximum([here - low - self._margin, high - self._margin - here], 0.0)
        change = self._greatest[model.jnt_dofadr[self._joints]] * dt * dt
        return np.sqrt(change * change + 2.0 * change * room) - change


def _by_dof(robot: Robot, name: str, values: float | Mapping[str | int, ArrayLike], base: object) -> Array:
    """Return a positive value a degree of freedom `(nv,)`, infinite where none is asked for."""
    model = robot.model
    based = model.jnt_type[model.dof_jntid] == int(mujoco.mjtJoint.mjJNT_FREE)
    if isinstance(values, Mapping):
        each = robot.dof_values(name, values, np.inf).copy()
    else:
        each = np.where(based, np.inf, positive(name, values))
    if base is not None:
        linear, angular = finite_array(f"base of {name}", base, (2,))  # type: ignore[arg-type]
        each[based] = np.tile(np.repeat([linear, angular], 3), np.count_nonzero(based) // 6)
    slow = np.flatnonzero(~(each > 0.0))
    if slow.size:
        raise InputError(f"{name} of {joint_names(model)[slow[0]]} is {each[slow[0]]}; expected a finite number above 0.")
    return each
