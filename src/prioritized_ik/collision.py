"""Parts of a robot and its surroundings kept apart, by the distances that MuJoCo measures."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from prioritized_ik.errors import InputError
from prioritized_ik.guard import END, OUTSIDE, Guarded, Limit, Way
from prioritized_ik.robot import Robot
from prioritized_ik.tasks.turns import turned
from prioritized_ik.validation import Array, gain_of, non_negative, one_of, positive

_SPHERE, _ELLIPSOID = int(mujoco.mjtGeom.mjGEOM_SPHERE), int(mujoco.mjtGeom.mjGEOM_ELLIPSOID)
_CAPSULE, _CYLINDER = int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_CYLINDER)
_PLANE, _BOX = int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_BOX)

Pair = tuple[str | int, str | int]

SELF = "self"  # in a pair: any geom of the robot's own

UNSEEN = 1e-6  # [m] nearer than this, the line between the nearest points has no direction that is to be trusted
APART = 1e-3  # [m] how far geoms are then moved apart, to see it
CLOSER = 1e-9  # [m] closer than asked by this is rounding

#: [rad] Faces and edges that meet at less than this angle have a row at each end: one step may turn them by so much and
#: still end where it said. Robots turn their links by a tenth of it in a step of 10 ms.
TILT = 0.05

NEARBY = 0.1  # of the smaller geom's size: ends nearer than this are one
SAME_FACE = 0.99  # cosine of the angle between normals of one face, seen as it is and tilted


class Collision(Limit):
    """Pairs of geoms kept at least `min_distance` apart.

    n·(J_1 - J_2) dθ >= -gain max(d - d_min, 0), with n the unit normal from geom 2 to geom 1 and J the Jacobians of the
    nearest points; the left side is the change of the distance d. The right side is a length, whatever `dt`.

    MuJoCo tells one pair of nearest points. Where faces, or edges and capsules along them, meet nearly flat (`TILT`),
    the other ends get rows too, with the same n and their own distance along it, so that they do not rock.

    Args:
        robot: which has the geoms.
        pairs: of geoms, each by name, by pattern such as `"left*"`, by number, or `"self"` for any geom that a joint moves;
            one `"self"` alone stands for `[("self", "self")]`. Pairs that no joint moves against each other are left out.
            Those of `"self"` are only those that MuJoCo lets collide: not a body with its parent, nor what the model
            excludes or masks.
        min_distance: d_min [m].
        gain: how much of what is left of the distance one step may take, in (0, 1].
        margin: only pairs nearer than this to `min_distance` get a row [m]; those of which the bounding spheres are
            further are not measured.
        outside: of pairs that are too close: `"raise"` an error; `"hold"`, they may not come closer; `"return"`, they also
            come apart, before any task; `"require"`, they come apart in any case.
        return_speed: how fast, at most [m/s].

    Attributes:
        pairs: the numbers of the geoms of every pair.

    Raises:
        InputError: a value out of range, a geom that does not exist, or no pair that moves.
    """

    def __init__(
        self,
        robot: Robot,
        pairs: str | Sequence[Pair],
        *,
        min_distance: float = 0.0,
        gain: float = 1.0,
        margin: float = 0.05,
        outside: str = "return",
        return_speed: float = 0.5,
    ) -> None:
        super().__init__(robot)
        self._least = non_negative("min_distance", min_distance)
        self._reach = self._least + positive("margin", margin)
        speed = positive("return_speed", return_speed)
        self._way = Way(one_of("outside", outside, OUTSIDE), gain_of("gain", gain), speed, CLOSER)
        self._names = robot.names("geom")
        self.pairs = _moving_pairs(robot, pairs)
        if not self.pairs:
            raise InputError(f"pairs {pairs!r} hold no two geoms that a joint moves against each other.")
        self._one, self._other = np.array(self.pairs).T
        kinds, radius = robot.model.geom_type, robot.model.geom_rbound
        self._radii = radius[self._one] + radius[self._other]  # a plane's is zero
        self._plane_first, self._plane_last = kinds[self._one] == _PLANE, kinds[self._other] == _PLANE

    def distances(self, robot: Robot) -> Array:
        """Return the distance of every pair `(n,)` [m], at most the largest that gets a row; negative in penetration."""
        found, segment = np.full(len(self.pairs), self._reach), np.zeros(6)
        for number in self._near(robot):
            found[number] = self._measured(robot, *self.pairs[number], segment)
        return found

    def room(self, robot: Robot) -> dict[str, float]:
        """Return each near pair's distance less `min_distance` [m]."""
        distances = self.distances(robot)
        near = np.flatnonzero(distances < self._reach).tolist()
        return {self._row_name(*self.pairs[number]): float(distances[number]) - self._least for number in near}

    def _row_name(self, one: int, other: int) -> str:
        return f"{self._names[one]} near {self._names[other]}"

    def nearest_points(self, robot: Robot) -> list[tuple[str, Array, Array]]:
        """Return what every row is called, and the points `(3,)`, `(3,)` [m] that it keeps apart."""
        return [(near.name, near.segment[:3], near.segment[3:]) for near in self._met(robot)]

    def _at(self, robot: Robot, dt: float) -> Guarded:
        met = self._met(robot)
        if not met:
            return Guarded()
        gaps = np.array([near.distance - self._least for near in met])
        if self._way.outside == "raise" and gaps.min() < -UNSEEN:
            worst = met[int(gaps.argmin())]
            raise InputError(f"{worst.name}: {worst.distance:.6g} m apart, less than min_distance, {self._least:.6g}.")
        gradients = np.array([_gradient(robot, near) for near in met])
        return self._way.guarded(-gradients, gaps, [near.name for near in met], dt)

    def _met(self, robot: Robot) -> list["_Near"]:
        """Return what is within reach: of every pair the nearest points, and the ends of faces that meet nearly flat."""
        met = []
        for number in self._near(robot):
            one, other = self.pairs[number]
            segment = np.zeros(6)
            distance = self._measured(robot, one, other, segment)
            if distance >= self._reach:
                continue
            name, normal = (
                self._row_name(one, other),
                self._normal(robot, one, other, segment, distance),
            )
            met.append(_Near(one, other, name, distance, segment, normal))
            for place, end in enumerate(self._ends(robot, one, other, segment, normal), 2):
                met.append(_Near(one, other, f"{name}{END}{place}", float(normal @ (end[:3] - end[3:])), end, normal))
        return met

    def _near(self, robot: Robot) -> list[int]:
        """Return the numbers of the pairs whose bounding spheres are within reach."""
        places, axes = robot.data.geom_xpos, robot.data.geom_xmat[:, 2::3]
        between = places[self._one] - places[self._other]
        distance = np.sqrt(np.einsum("ij,ij->i", between, between))
        for flat, planes, sign in ((self._plane_first, self._one, -1.0), (self._plane_last, self._other, 1.0)):
            distance[flat] = sign * np.einsum("ij,ij->i", between[flat], axes[planes[flat]])
        return np.flatnonzero(distance - self._radii < self._reach).tolist()

    def _measured(self, robot: Robot, one: int, other: int, segment: Array) -> float:
        """Return the distance of two geoms, and write the segment between their nearest points into `segment` `(6,)`."""
        return float(mujoco.mj_geomDistance(robot.model, robot.data, one, other, self._reach, segment))

    def _ends(self, robot: Robot, one: int, other: int, segment: Array, normal: Array) -> list[Array]:
        """Return segments `(6,)` between the other ends of two faces or edges that meet nearly flat."""
        ends: list[Array] = []
        nearby = NEARBY * min(size for size in robot.model.geom_rbound[[one, other]].tolist() if size)
        for turn in _tilts(robot, one, other, normal):
            found = self._tilted(robot, one, other, segment[:3], TILT * turn)
            if found is None or found[1] @ normal < SAME_FACE:
                continue
            if all(np.linalg.norm(found[0] - known) > nearby for known in (segment, *ends)):
                ends.append(found[0])
        return ends

    def _tilted(self, robot: Robot, one: int, other: int, about: Array, turn: Array) -> tuple[Array, Array] | None:
        """Return which points are nearest with geom `one` turned about a point, where they are without, and the normal."""
        place, axes = robot.data.geom_xpos[one], robot.data.geom_xmat[one]
        kept, segment, rotation = (place.copy(), axes.copy()), np.zeros(6), turned(np.eye(3), turn)
        place[:], axes[:] = about + rotation @ (place - about), (rotation @ axes.reshape(3, 3)).ravel()
        distance = self._measured(robot, one, other, segment)
        normal = self._normal(robot, one, other, segment, distance) if distance < self._reach else None
        place[:], axes[:] = kept
        segment[:3] = about + rotation.T @ (segment[:3] - about)
        return None if normal is None else (segment, normal)

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


@dataclass(frozen=True)
class _Near:
    """Two points of two geoms that are kept apart: the segment between them `(6,)`, and their distance along a normal."""

    one: int
    other: int
    name: str
    distance: float
    segment: Array
    normal: Array


def _gradient(robot: Robot, near: _Near) -> Array:
    """Return how the distance of two points fixed to geoms, along the normal, changes with every joint `(nv,)`."""
    model, jacobians = robot.model, np.zeros((2, 3, robot.model.nv))
    mujoco.mj_jac(model, robot.data, jacobians[0], None, near.segment[:3], model.geom_bodyid[near.one])
    mujoco.mj_jac(model, robot.data, jacobians[1], None, near.segment[3:], model.geom_bodyid[near.other])
    return near.normal @ (jacobians[0] - jacobians[1])


def _tilts(robot: Robot, one: int, other: int, normal: Array) -> Array:
    """Return unit axes `(k, 3)` across the normal to tilt geom `one` about, for its ends to come nearest."""
    model, data = robot.model, robot.data
    if {int(model.geom_type[one]), int(model.geom_type[other])} & {_SPHERE, _ELLIPSOID}:
        return np.zeros((0, 3))
    for geom in (one, other):
        axis = data.geom_xmat[geom].reshape(3, 3)[:, 2]
        leaning = abs(float(axis @ normal))  # sine of the angle between a length and a face
        if model.geom_type[geom] in (_CAPSULE, _CYLINDER) and leaning < 0.5:
            about = np.cross(normal, axis) / np.sqrt(1.0 - leaning**2)
            return np.array([about, -about])
        if model.geom_type[geom] == _CAPSULE or (model.geom_type[geom] == _CYLINDER and leaning < np.cos(TILT)):
            return np.zeros((0, 3))  # on its cap or its rim, which roll
    smaller = min((one, other), key=lambda geom: float(model.geom_rbound[geom]) or np.inf)
    axes = data.geom_xmat[smaller].reshape(3, 3)
    first = axes[:, int(np.abs(normal @ axes).argmin())]
    first = first - normal * (normal @ first)
    first = first / np.linalg.norm(first)
    diagonals = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]]) / np.sqrt(2.0)  # a box comes down on its corners
    return diagonals @ np.array([first, np.cross(normal, first)])


def _moving_pairs(robot: Robot, pairs: str | Sequence[Pair]) -> list[tuple[int, int]]:
    """Return the numbers of all pairs, each once, of bodies that a joint moves against each other."""
    if pairs == SELF:
        return _moving_pairs(robot, [(SELF, SELF)])
    if isinstance(pairs, str) or not isinstance(pairs, Sequence):
        raise InputError(f"pairs is {pairs!r}; expected pairs of geoms such as [('hand', 'table')].")
    found: dict[tuple[int, int], None] = {}
    for pair in pairs:
        if not isinstance(pair, tuple | list) or len(pair) != 2:
            raise InputError(f"pairs holds {pair!r}; expected pairs of geoms such as ('hand', 'table').")
        for one in _geoms(robot, pair[0]):
            for other in _geoms(robot, pair[1]):
                apart = _may_collide(robot, one, other) if SELF in pair else _moves_against(robot, one, other)
                if apart and (other, one) not in found:
                    found[one, other] = None
    return list(found)


def _geoms(robot: Robot, which: str | int) -> list[int]:
    """Return the numbers of geoms, all that move for `"self"`."""
    if which != SELF:
        return robot.geoms(which)
    return np.flatnonzero(robot.model.body_weldid[robot.model.geom_bodyid] != 0).tolist()


def _moves_against(robot: Robot, one: int, other: int) -> bool:
    """Whether a joint moves two geoms against each other."""
    bodies = robot.model.geom_bodyid[[one, other]]
    return bool(robot.model.body_weldid[bodies[0]] != robot.model.body_weldid[bodies[1]])


def _may_collide(robot: Robot, one: int, other: int) -> bool:
    """Whether MuJoCo would let two geoms collide: not parent and child, nor what the model excludes or masks."""
    model = robot.model
    if not _moves_against(robot, one, other):
        return False
    types, affinities = model.geom_contype, model.geom_conaffinity
    if not (types[one] & affinities[other] or types[other] & affinities[one]):
        return False
    links = model.body_weldid[model.geom_bodyid[[one, other]]].tolist()
    above = [int(model.body_weldid[model.body_parentid[link]]) for link in links]
    if (above[0] == links[1] != 0) or (above[1] == links[0] != 0):
        return False
    first, second = sorted(model.geom_bodyid[[one, other]].tolist())
    return (first << 16) + second not in model.exclude_signature
