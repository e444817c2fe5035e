"""What is drawn beside the robot: where its tasks want it to be, and the limits that it is close to."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np

from prioritized_ik.collision import Collision
from prioritized_ik.guard import Limit
from prioritized_ik.robot import Robot
from prioritized_ik.tasks.axis import Axis, LookAt
from prioritized_ik.tasks.centre_of_mass import CentreOfMass
from prioritized_ik.tasks.orientation import Orientation
from prioritized_ik.tasks.pose import Pose
from prioritized_ik.tasks.position import Position
from prioritized_ik.tasks.task import Task
from prioritized_ik.validation import Array

Colour = tuple[float, float, float, float]  # red, green, blue, opacity

MET: Colour = (0.13, 0.53, 0.33, 1.0)
UNMET: Colour = (0.93, 0.40, 0.20, 1.0)
FREE: Colour = (0.40, 0.55, 0.80, 1.0)  # of a limit that is near and does not hold
HOLDING: Colour = (0.80, 0.20, 0.25, 1.0)
AXES: tuple[Colour, Colour, Colour] = ((0.85, 0.2, 0.2, 1.0), (0.2, 0.65, 0.2, 1.0), (0.2, 0.3, 0.85, 1.0))

CLOSE = 1e-3  # [m, rad] an error that nobody sees in a picture
SIZES = 0.012, 0.004, 0.08  # of points, lines and axes, in extents of the model


@dataclass(frozen=True)
class Mark:
    """A ball at `start` `(3,)`, or a line from there to `end` `(3,)`, of a radius [m]."""

    start: Array
    end: Array | None
    radius: float
    colour: Colour


def marks_of(
    robot: Robot, tasks: Sequence[Task], limits: Sequence[Limit] = (), holding: Collection[str] = ()
) -> list[Mark]:
    """Return the marks of tasks and limits at the robot's position; `holding` names the rows that hold a level back."""
    found = []
    for task in tasks:
        draw = _DRAWN.get(type(task))
        if draw is not None:
            met = float(np.linalg.norm(np.sign(task.weights) * task.rows(robot)[1])) < CLOSE
            found += draw(robot, task, MET if met else UNMET)
    for limit in limits:
        if isinstance(limit, Collision):
            found += _near(robot, limit, holding)
    return found


def _near(robot: Robot, limit: Collision, holding: Collection[str]) -> list[Mark]:
    """Return a line between the nearest points of every pair that has a row."""
    _, thin, _ = _sizes(robot)
    return [
        Mark(start, end, thin, HOLDING if name in holding else FREE) for name, start, end in limit.nearest_points(robot)
    ]


def _position(robot: Robot, task: Position, colour: Colour) -> list[Mark]:
    return _want(robot, robot.position(task.frame), task.target, colour)


def _pose(robot: Robot, task: Pose, colour: Colour) -> list[Mark]:
    place = task.target[:3, 3]
    return [*_want(robot, robot.position(task.frame), place, colour), *_axes(robot, place, task.target[:3, :3])]


def _orientation(robot: Robot, task: Orientation, colour: Colour) -> list[Mark]:
    return _axes(robot, robot.position(task.frame), task.target)


def _axis(robot: Robot, task: Axis, colour: Colour) -> list[Mark]:
    here = robot.position(task.frame)
    _, thin, long = _sizes(robot)
    return [Mark(here, here + 2.0 * long * task.target, thin, colour)]


def _look_at(robot: Robot, task: LookAt, colour: Colour) -> list[Mark]:
    return _want(robot, robot.position(task.frame), task.target, colour, joined=True)


def _centre_of_mass(robot: Robot, task: CentreOfMass, colour: Colour) -> list[Mark]:
    size, _, _ = _sizes(robot)
    here = task.place(robot)
    wanted = np.where(task.weights > 0.0, task.target, here)  # what has no weight is free
    return [*_want(robot, here, wanted, colour), Mark(here, None, size, (0.2, 0.2, 0.2, 1.0))]


def _want(robot: Robot, here: Array, target: Array, colour: Colour, joined: bool = False) -> list[Mark]:
    """Return a ball at a target, and a line to it from where the robot is unless it is there."""
    size, thin, _ = _sizes(robot)
    apart = joined or float(np.linalg.norm(target - here)) > CLOSE
    return [Mark(target, None, 1.4 * size, colour), *([Mark(here, target, thin, colour)] if apart else [])]


def _axes(robot: Robot, place: Array, rotation: Array) -> list[Mark]:
    _, thin, long = _sizes(robot)
    return [Mark(place, place + long * axis, thin, colour) for axis, colour in zip(rotation.T, AXES, strict=True)]


def _sizes(robot: Robot) -> tuple[float, float, float]:
    extent = float(robot.model.stat.extent)
    return SIZES[0] * extent, SIZES[1] * extent, SIZES[2] * extent


_DRAWN: dict[type[Task], Callable[..., list[Mark]]] = {
    Position: _position,
    Pose: _pose,
    Orientation: _orientation,
    Axis: _axis,
    LookAt: _look_at,
    CentreOfMass: _centre_of_mass,
}
