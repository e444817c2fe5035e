"""The centre of mass above the feet."""

from collections.abc import Sequence

import mujoco
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from prioritized_ik.errors import InputError
from prioritized_ik.guard import OUTSIDE, Guarded, Limit, Way
from prioritized_ik.robot import Frame, Robot
from prioritized_ik.validation import Array, distinct, gain_of, non_negative, one_of, positive

_BOX, _SPHERE = int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_SPHERE)
SOLE = ((-1, -1), (-1, 1), (1, -1), (1, 1))  # corners of a box's face

CLOSER = 1e-9  # [m] outside by this is rounding


class SupportPolygon(Limit):
    """The centre of mass, seen from above, inside the convex hull of the points that the robot stands on.

    One row an edge of the hull: the distance d of the centre of mass from it changes by n·(J_c - (1 - s) J_a - s J_b) dθ,
    with n the edge's inward normal in the plane, J_a and J_b the Jacobians of its ends, and s where the centre of mass is
    along it. -n·(…) dθ <= gain (d - margin). The ground is level, z up; whether the points stay on it is up to other
    tasks.

    Args:
        robot: which has the points.
        points: frames such as `robot.frame(site="left foot")`: the origin of a body, site or sphere; of a box, the corners
            of its lowest face.
        margin: distance that is kept from every edge [m].
        hard: whether the rows are hard; soft ones stand above all tasks and below hard limits.
        gain: how much of what is left of the distance one step may take, in (0, 1].
        outside: of a centre of mass outside: `"raise"` an error; `"hold"`, no further; `"return"`, also back, before any
            task; `"require"`, back in any case.
        return_speed: how fast, at most [m/s].

    Raises:
        InputError: a value out of range, or points that make no polygon.
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
    ) -> None:
        super().__init__(robot)
        self._margin, self._hard = non_negative("margin", margin), bool(hard)
        speed = positive("return_speed", return_speed)
        self._way = Way(one_of("outside", outside, OUTSIDE), gain_of("gain", gain), speed, CLOSER)
        if not isinstance(points, Sequence) or not all(isinstance(point, Frame) for point in points):
            raise InputError(f"points is {points!r}; expected frames such as [robot.frame(site='left foot'), …].")
        self._frames = tuple(points)
        for frame in self._frames:
            if frame.kind == "geom" and robot.model.geom_type[frame.number] not in (_BOX, _SPHERE):
                raise InputError(f"geom {frame.name} is neither box nor sphere; expected those, sites or bodies.")
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
            ring = ConvexHull(points[:, :2]).vertices  # counterclockwise
        except (QhullError, ValueError) as error:
            places = np.round(points[:, :2], 4).tolist()
            raise InputError(f"points stand at {places}; expected at least three that are not on a line.") from error
        moving = np.zeros((3, robot.model.nv))
        mujoco.mj_jacSubtreeCom(robot.model, robot.data, moving, 0)
        centre = robot.data.subtree_com[0, :2]
        edges = []
        for a, b in zip(ring, np.roll(ring, -1), strict=True):
            along, from_a = points[b, :2] - points[a, :2], centre - points[a, :2]
            length = float(np.linalg.norm(along))
            inward = np.array([-along[1], along[0]]) / length
            share = float(from_a @ along) / length**2
            change = moving[:2] - (1.0 - share) * jacobians[a, :2] - share * jacobians[b, :2]
            edges.append((float(inward @ from_a), f"{names[a]} – {names[b]}", inward @ change))
        return edges

    def _standing(self, robot: Robot) -> tuple[Array, tuple[str, ...], Array]:
        """Return the points `(n, 3)` that the robot stands on, their names, and their Jacobians `(n, 3, nv)`."""
        model = robot.model
        points, names, jacobians = [], [], []
        for frame in self._frames:
            for corner, point in enumerate(_corners(robot, frame), 1):
                jacobian = np.zeros((3, model.nv))
                mujoco.mj_jac(model, robot.data, jacobian, None, point, robot.carrier(frame))
                points.append(point)
                jacobians.append(jacobian)
                names.append(f"{frame.name} corner {corner}" if _is_box(robot, frame) else frame.name)
        return np.array(points).reshape(-1, 3), distinct(names), np.array(jacobians)


def _is_box(robot: Robot, frame: Frame) -> bool:
    return frame.kind == "geom" and int(robot.model.geom_type[frame.number]) == _BOX


def _corners(robot: Robot, frame: Frame) -> list[Array]:
    """Return the points `(3,)` of a frame that stand on the ground."""
    centre = robot.position(frame)
    if not _is_box(robot, frame):
        return [centre]
    axes, size = robot.rotation(frame), robot.model.geom_size[frame.number]
    down = int(np.abs(axes[2]).argmax())
    one, other = (axis for axis in range(3) if axis != down)
    face = centre - np.sign(axes[2, down]) * size[down] * axes[:, down]
    return [face + i * size[one] * axes[:, one] + j * size[other] * axes[:, other] for i, j in SOLE]
