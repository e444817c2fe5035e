"""The live panel: every level's error, which gives way, and to what."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from prioritized_ik.motion import Motion
from prioritized_ik.robot import Robot
from prioritized_ik.solvers.explain import Concession
from prioritized_ik.tasks.axis import Axis, LookAt
from prioritized_ik.tasks.centre_of_mass import CentreOfMass
from prioritized_ik.tasks.orientation import Orientation
from prioritized_ik.tasks.pose import Pose
from prioritized_ik.tasks.position import Position
from prioritized_ik.tasks.task import Task

LISTED = 2  # rows that hold a level, by name
SEEN = 1e-2  # of what a level asks for: less given way is not worth a word
SMALLEST = 1e-4  # [m, rad] nor is less than this of a step


@dataclass(frozen=True)
class Line:
    """A level in the panel.

    Attributes:
        name: its tasks.
        error: what is left of them, with units.
        gives_way: whether it does worse in this step than it would alone.
        reason: to what it gives way; empty if it does not.
        holding: names of all rows that hold it back.
    """

    name: str
    error: str
    gives_way: bool = False
    reason: str = ""
    holding: tuple[str, ...] = ()


def lines_of(robot: Robot, levels: Sequence[Sequence[Task]], motion: Motion | None) -> list[Line]:
    """Return a line a level, the most important first; who gave way is left out where there is no `motion`."""
    shown = [tasks for tasks in levels if tasks]
    report = motion.report[-len(shown) :] if motion is not None and shown else ()  # a level of recovery may come first
    lines = []
    for place, tasks in enumerate(shown):
        name, error = _name(tasks), " · ".join(_error(robot, tasks))
        lines.append(_line(name, error, report[place]) if report else Line(name, error))
    return lines


def _name(tasks: Sequence[Task]) -> str:
    """Return what a level is called: two tasks in full, "pose of left foot, right foot", or the first and how many more."""
    first, _, frame = tasks[0].name.partition(" of ")
    if len(tasks) == 2 and frame and tasks[1].name.startswith(f"{first} of "):
        return f"{tasks[0].name}, {tasks[1].name.partition(' of ')[2]}"
    return tasks[0].name if len(tasks) == 1 else f"{tasks[0].name} and {len(tasks) - 1} more"


def _line(name: str, error: str, concession: Concession) -> Line:
    lost = concession.error - concession.alone
    if lost <= max(concession.tolerance, SEEN * concession.error, SMALLEST):
        return Line(name, error)
    to_rows = concession.error - concession.below_others > SEEN * lost
    to_levels = concession.below_others - concession.alone > SEEN * lost
    reasons = ["the levels above"] if to_levels else []
    if to_rows:
        more = len(concession.held_by) - LISTED
        reasons += [*concession.held_by[:LISTED], *([f"{more} more"] if more > 0 else [])] or ["limits"]
    return Line(name, error, True, ", ".join(reasons), concession.held_by)


def _error(robot: Robot, tasks: Sequence[Task]) -> list[str]:
    """Return the largest error of each unit."""
    metres, radians, plain = [], [], []
    for task in tasks:
        error = np.sign(task.weights) * task.rows(robot)[1]
        if isinstance(task, Position | CentreOfMass | Pose):
            metres.append(float(np.linalg.norm(error[:3])))
        if isinstance(task, Orientation | Axis | LookAt | Pose):
            radians.append(float(np.linalg.norm(error[-3:])))
        if not isinstance(task, Position | CentreOfMass | Pose | Orientation | Axis | LookAt):
            plain.append(float(np.linalg.norm(error)))
    return [
        *([f"{1e3 * max(metres):.1f} mm"] if metres else []),
        *([f"{np.degrees(max(radians)):.1f}°"] if radians else []),
        *([f"{max(plain):.2f}"] if plain else []),
    ]
