"""The centre of mass above the feet."""

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull, QhullError

from prioritized_ik.errors import InputError
from prioritized_ik.guard import OUTSIDE, Guarded, Limit, Way
from prioritized_ik.robot import Frame, Robot
from prioritized_ik.tasks.turns import shortest_turn, turned, unit
from prioritized_ik.validation import Array, distinct, gain_of, non_negative, one_of, positive

_BOX, _SPHERE, _CAPSULE = (int(getattr(mujoco.mjtGeom, f"mjGEOM_{kind}")) for kind in ("BOX", "SPHERE", "CAPSULE"))
SOLE = ((-1, -1), (-1, 1), (1, -1), (1, 1))  # corners of a box's face

UPWARD = np.array([0.0, 0.0, 1.0])  # what is up in the axes that the plane's are turned from

CLOSER = 1e-9  # [m] outside by this is rounding


class SupportPolygon(Limit):
    """The centre of mass, seen along gravity, inside the convex hull of the points that the robot stands on.

    One row an edge of the hull: the distance d of the centre of mass from it changes by n·(J_c - (1 - s) J_a - s J_b) dθ,
    with n the edge's inward normal in the plane across gravity, J_a and J_b the Jacobians of its ends, and s where the
    centre of mass is along it. -n·(…) dθ <= gain (d - margin).

    The points may stand at any height, and on slopes: what counts is where they are seen from above. That is whether the
    robot can be in balance as long as the ground holds the feet; where friction is short, less of the polygon is of use,
    which this does not know. Whether the points stay on the ground is up to other tasks.

    Args:
        robot: which has the points.
        points: frames such as `robot.frame(site="left foot")`: the origin of a body or site; of a box, the corners of its
            lowest face; of a sphere or a capsule's ends, the lowest points.
        margin: distance that is kept from every edge [m].
        hard: whether the rows are hard; soft ones stand above all tasks and below hard limits.
        gain: how much of what is left of the distance one step may take, in (0, 1].
        outside: of a centre of mass outside: `"raise"` an error; `"hold"`, no further; `"return"`, also back, before any
            task; `"require"`, back in any case.
        return_speed: how fast, at most [m/s].
        up: away from gravity `(3,)`; by the model's own gravity unless given.
        ground: normal of the ground `(3,)`, which says what is lowest of a geom; `up` unless given.
        body: the centre of mass is of it and all that it carries; of the whole tree that the points are on unless given.

    Raises:
        InputError: a value out of range, points that make no polygon or are on several trees, or no gravity.
    """

    def __init__(
        self,
        robot: Robot,
        points: Sequence[Frame],
        *,
        margin: float = 0.0,
        hard: bool = True,
        gain: float = 1.0,
        outside: str = "return",
        return_speed: float = 0.5,
        up: ArrayLike | None = None,
        ground: ArrayLike | None = None,
        body: str | int | None = None,
    ) -> None:
        super().__init__(robot)
        self._margin, self._hard = non_negative("margin", margin), bool(hard)
        speed = positive("return_speed", return_speed)
        self._way = Way(one_of("outside", outside, OUTSIDE), gain_of("gain", gain), speed, CLOSER)
        if not isinstance(points, Sequence) or not all(isinstance(point, Frame) for point in points):
            raise InputError(f"points is {points!r}; expected frames such as [robot.frame(site='left foot'), …].")
        self._frames = tuple(points)
        for frame in self._frames:
            if frame.kind == "geom" and robot.model.geom_type[frame.number] not in (_BOX, _SPHERE, _CAPSULE):
                raise InputError(
                    f"geom {frame.name} is no box, sphere or capsule; expected those, bodies or sites, which "
                    "mark where anything else stands."
                )
        self._up = unit("up", _away_from_gravity(robot) if up is None else up)
        self._ground = self._up if ground is None else unit("ground", ground)
        if float(self._ground @ self._up) <= 0.0:
            raise InputError(f"ground is {self._ground.tolist()}, which does not face up, {self._up.tolist()}.")
        self._plane = turned(np.eye(3), shortest_turn(UPWARD, self._up))[:, :2]  # its axes, seen from above
        self._body = self._carried(robot) if body is None else robot.body(body)
        self._edges(robot)

    def distance(self, robot: Robot) -> float:
        """Return how far inside the nearest edge the centre of mass is [m], its `margin` aside; below zero outside."""
        return min(edge[0] for edge in self._edges(robot))

    def room(self, robot: Robot) -> dict[str, float]:
        """Return the distance from every edge less `margin` [m]; none where the rows are soft."""
        if not self._hard:
            return {}
        return {f"support edge {name}": distance - self._margin for distance, name, _ in self._edges(robot)}

    def _at(self, robot: Robot, dt: float) -> Guarded:
        edges = self._edges(robot)
        room = np.array([distance - self._margin for distance, _, _ in edges])
        if self._way.outside == "raise" and room.min() < -CLOSER:
            raise InputError(
                f"the centre of mass is {room.min() + self._margin:.6g} m inside the support polygon, less than margin, "
                f"{self._margin:.6g}."
            )
        names = [f"support edge {name}" for _, name, _ in edges]
        return self._way.guarded(-np.array([row for _, _, row in edges]), room, names, dt, hard=self._hard)

    def _edges(self, robot: Robot) -> list[tuple[float, str, Array]]:
        """Return the distance from each edge [m], its name, and how the distance changes with every joint `(nv,)`."""
        points, names, jacobians = self._standing(robot)
        try:
            ring = ConvexHull(points).vertices  # counterclockwise
        except (QhullError, ValueError) as error:
            places = np.round(points, 4).tolist()
            raise InputError(
                f"points stand at {places}, seen from above; expected at least three that are not on a line."
            ) from error
        moving = np.zeros((3, robot.model.nv))
        mujoco.mj_jacSubtreeCom(robot.model, robot.data, moving, self._body)
        moving, centre = self._plane.T @ moving, robot.data.subtree_com[self._body] @ self._plane
        edges = []
        for a, b in zip(ring, np.roll(ring, -1), strict=True):
            along, from_a = points[b] - points[a], centre - points[a]
            length = float(np.linalg.norm(along))
            inward = np.array([-along[1], along[0]]) / length
            share = float(from_a @ along) / length**2
            change = moving - (1.0 - share) * jacobians[a] - share * jacobians[b]
            edges.append((float(inward @ from_a), f"{names[a]} – {names[b]}", inward @ change))
        return edges

    def _standing(self, robot: Robot) -> tuple[Array, tuple[str, ...], Array]:
        """Return the points `(n, 2)` that the robot stands on, seen from above, their names and Jacobians `(n, 2, nv)`."""
        points, names, jacobians = [], [], []
        for frame in self._frames:
            corners = _corners(robot, frame, self._ground)
            for number, (point, carried) in enumerate(corners, 1):
                jacobian = np.zeros((3, robot.model.nv))
                mujoco.mj_jac(robot.model, robot.data, jacobian, None, carried, robot.carrier(frame))
                points.append(point @ self._plane)
                jacobians.append(self._plane.T @ jacobian)
                names.append(f"{frame.name} corner {number}" if len(corners) > 1 else frame.name)
        return np.array(points).reshape(-1, 2), distinct(names), np.array(jacobians)

    def _carried(self, robot: Robot) -> int:
        """Return the body at the root of the tree that the points are on."""
        roots = sorted({int(robot.model.body_rootid[robot.carrier(frame)]) for frame in self._frames})
        if len(roots) > 1:
            named = ", ".join(robot.names("body")[root] for root in roots)
            raise InputError(f"points are on the trees of {named}; expected one, or body=, whose centre of mass is meant.")
        return roots[0] if roots else 0


def _away_from_gravity(robot: Robot) -> Array:
    gravity = np.array(robot.model.opt.gravity)
    if not gravity.any():
        raise InputError("the model has no gravity; give up, the direction away from it, such as up=[0, 0, 1].")
    return -gravity


def _corners(robot: Robot, frame: Frame, ground: Array) -> list[tuple[Array, Array]]:
    """Return the points `(3,)` of a frame that stand on a ground with a normal, and those fixed to it that move alike."""
    centre = robot.position(frame)
    kind = int(robot.model.geom_type[frame.number]) if frame.kind == "geom" else None
    if kind is None:
        return [(centre, centre)]
    axes, size = robot.rotation(frame), robot.model.geom_size[frame.number]
    if kind == _BOX:
        facing = ground @ axes
        down = int(np.abs(facing).argmax())
        one, other = (axis for axis in range(3) if axis != down)
        face = centre - np.sign(facing[down]) * size[down] * axes[:, down]
        corners = [face + i * size[one] * axes[:, one] + j * size[other] * axes[:, other] for i, j in SOLE]
        return [(corner, corner) for corner in corners]
    # What rolls stands below its core, wherever that turns to.
    cores = [centre] if kind == _SPHERE else [centre + sign * size[1] * axes[:, 2] for sign in (-1, 1)]
    return [(core - size[0] * ground, core) for core in cores]
