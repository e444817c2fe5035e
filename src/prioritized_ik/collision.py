"""Parts of a robot and its surroundings kept apart, by the distances that MuJoCo measures."""

from collections.abc import Sequence

import mujoco
import numpy as np

from prioritized_ik.errors import InputError
from prioritized_ik.guard import OUTSIDE, Guarded, Limit
from prioritized_ik.problem import Rows
from prioritized_ik.robot import Robot
from prioritized_ik.validation import Array, gain_of, non_negative, one_of, positive

_CAPSULE, _SPHERE = int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_SPHERE)
_PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)

UNSEEN = 1e-6  # [m] nearer than this, the line between the nearest points has no direction that is to be trusted
APART = 1e-3  # [m] how far geoms are then moved apart, to see it
CLOSER = 1e-9  # [m] closer than asked by this is rounding


class Collision(Limit):
    """Pairs of geoms kept at least `min_distance` apart.

    n·(J_1 - J_2) dθ >= -gain max(d - d_min, 0), with n the unit normal from geom 2 to geom 1 and J the Jacobians of the
    nearest points; the left side is the change of the distance d. The right side is a length, whatever `dt`.

    MuJoCo tells one pair of nearest points, so a pair of geoms has one row. Where two flat faces meet, that point jumps
    between corners from step to step, and the pair may rock by as much as a step turns it: 2.5 mm deep for boxes of 10 cm
    at 1 rad/s and 10 ms. Spheres, capsules and corners against anything convex come to rest.

    Args:
        robot: which has the geoms.
        pairs: of geoms, each by name, by pattern such as `"left*"`, or by number. Pairs that no joint moves against each
            other are left out.
        min_distance: d_min [m].
        gain: how much of what is left of the distance one step may take, in (0, 1].
        margin: only pairs nearer than this to `min_distance` get a row [m].
        outside: of pairs that are too close: `"raise"` an error; `"hold"`, they may not come closer; `"return"`, they also
            come apart, before any task.
        return_speed: how fast, at most [m/s].

    Raises:
        InputError: a value out of range, a geom that does not exist, or no pair that moves.
    """

    def __init__(
        self,
        robot: Robot,
        pairs: Sequence[tuple[str | int, str | int]],
        *,
        min_distance: float = 0.0,
        gain: float = 1.0,
        margin: float = 0.05,
        outside: str = "return",
        return_speed: float = 0.5,
    ) -> None:
        super().__init__(robot)
        self._least, self._gain = non_negative("min_distance", min_distance), gain_of("gain", gain)
        self._reach = self._least + positive("margin", margin)
        self._outside, self._speed = one_of("outside", outside, OUTSIDE), positive("return_speed", return_speed)
        self._names = robot.names("geom")
        self.pairs = _moving_pairs(robot, pairs)
        if not self.pairs:
            raise InputError(f"pairs {list(pairs)!r} hold no two geoms that a joint moves against each other.")

    def distances(self, robot: Robot) -> Array:
        """Return the distance of every pair `(n,)` [m], at most the largest that gets a row; negative in penetration."""
        return np.array([self._measured(robot, *pair)[0] for pair in self.pairs])

    def nearest_points(self, robot: Robot) -> list[tuple[str, Array, Array]]:
        """Return what the row of every pair that has one is called, and the pair's nearest points `(3,)`, `(3,)` [m]."""
        found = []
        for one, other in self.pairs:
            distance, segment = self._measured(robot, one, other)
            if distance < self._reach:
                found.append((self._row_name(one, other), segment[:3], segment[3:]))
        return found

    def _at(self, robot: Robot, dt: float) -> Guarded:
        gradients, gaps, names = [], [], []
        for one, other in self.pairs:
            distance, segment = self._measured(robot, one, other)
            if distance >= self._reach:
                continue
            gradients.append(self._gradient(robot, one, other, segment, distance))
            gaps.append(distance - self._least)
            names.append(self._row_name(one, other))
            if self._outside == "raise" and gaps[-1] < -UNSEEN:
                raise InputError(f"{names[-1]}: {distance:.6g} m apart, less than min_distance, {self._least:.6g}.")
        if not gaps:
            return Guarded()
        matrix, gap = -np.array(gradients), np.array(gaps)
        rows = Rows(matrix, self._gain * np.maximum(gap, 0.0), names)
        close = gap < -CLOSER
        if self._outside != "return" or not close.any():
            return Guarded(rows=rows)
        push = np.minimum(-gap[close], self._speed * dt)
        return Guarded(
            rows=rows, recovery=(Rows(matrix[close], -push, [f"{names[i]} return" for i in np.flatnonzero(close)]),)
        )

    def _row_name(self, one: int, other: int) -> str:
        return f"{self._names[one]} near {self._names[other]}"

    def _measured(self, robot: Robot, one: int, other: int) -> tuple[float, Array]:
        """Return the distance of two geoms, and the segment between their nearest points `(6,)`."""
        segment = np.zeros(6)
        model, data = robot.model, robot.data
        if _PLANE not in (model.geom_type[one], model.geom_type[other]):
            between = float(np.linalg.norm(data.geom_xpos[one] - data.geom_xpos[other]))
            if between - model.geom_rbound[one] - model.geom_rbound[other] > self._reach:
                return self._reach, segment
        return float(mujoco.mj_geomDistance(model, data, one, other, self._reach, segment)), segment

    def _gradient(self, robot: Robot, one: int, other: int, segment: Array, distance: float) -> Array:
        """Return how the distance changes with every joint `(nv,)`."""
        normal = self._normal(robot, one, other, segment, distance)
        model, change = robot.model, np.zeros(robot.model.nv)
        for geom, point, sign in ((one, segment[:3], 1.0), (other, segment[3:], -1.0)):
            jacobian = np.zeros((3, model.nv))
            mujoco.mj_jac(model, robot.data, jacobian, None, point, model.geom_bodyid[geom])
            change += sign * (normal @ jacobian)
        return change

    def _normal(self, robot: Robot, one: int, other: int, segment: Array, distance: float) -> Array:
        """Return the unit normal `(3,)` from geom `other` to geom `one`."""
        for geom, point, sign in ((one, segment[:3], 1.0), (other, segment[3:], -1.0)):
            if robot.model.geom_type[geom] in (_CAPSULE, _SPHERE):
                inward = _core(robot, geom, point) - point  # as long as the radius, however close the other is
                return sign * inward / np.linalg.norm(inward)
        if abs(distance) < UNSEEN:
            return self._normal_apart(robot, one, other)
        return (segment[:3] - segment[3:]) / distance

    def _normal_apart(self, robot: Robot, one: int, other: int) -> Array:
        """Return the normal of two geoms that touch, as seen with one moved away from the other."""
        place = robot.data.geom_xpos[one]
        kept, away = place.copy(), place - robot.data.geom_xpos[other]
        if robot.model.geom_type[other] == _PLANE:
            away = robot.data.geom_xmat[other].reshape(3, 3)[:, 2]
        size = float(np.linalg.norm(away))
        place += APART * (away / size if size else np.array([0.0, 0.0, 1.0]))
        segment = np.zeros(6)
        distance = mujoco.mj_geomDistance(robot.model, robot.data, one, other, 1.0, segment)
        place[:] = kept
        return (segment[:3] - segment[3:]) / distance


def _core(robot: Robot, geom: int, point: Array) -> Array:
    """Return the point nearest to `point` on the core of a sphere or capsule `(3,)`."""
    centre = robot.data.geom_xpos[geom]
    if robot.model.geom_type[geom] == _SPHERE:
        return np.array(centre)
    axis, half = robot.data.geom_xmat[geom].reshape(3, 3)[:, 2], float(robot.model.geom_size[geom, 1])
    along = min(max(float((point - centre) @ axis), -half), half)
    return np.array(centre + along * axis)


def _moving_pairs(robot: Robot, pairs: Sequence[tuple[str | int, str | int]]) -> list[tuple[int, int]]:
    """Return the numbers of all pairs, each once, of bodies that a joint moves against each other."""
    if isinstance(pairs, str) or not isinstance(pairs, Sequence):
        raise InputError(f"pairs is {pairs!r}; expected pairs of geoms such as [('hand', 'table')].")
    found: dict[tuple[int, int], None] = {}
    for pair in pairs:
        if not isinstance(pair, tuple | list) or len(pair) != 2:
            raise InputError(f"pairs holds {pair!r}; expected pairs of geoms such as ('hand', 'table').")
        for one in robot.geoms(pair[0]):
            for other in robot.geoms(pair[1]):
                welded = robot.model.body_weldid[robot.model.geom_bodyid[[one, other]]]
                if welded[0] != welded[1] and (other, one) not in found:
                    found[one, other] = None
    return list(found)
