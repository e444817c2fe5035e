"""What all limits have in common."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

from prioritized_ik.errors import InputError
from prioritized_ik.problem import Bounds, Rows
from prioritized_ik.robot import Robot
from prioritized_ik.validation import positive

#: What may be done where a limit is broken already.
OUTSIDE = ("raise", "hold", "return")


@dataclass(frozen=True)
class Guarded:
    """What a limit says of one step dθ `(nv,)`.

    Attributes:
        bounds: hard bounds; dθ = 0 keeps them, unless the limit is broken and may not be.
        rows: hard rows, likewise.
        recovery: soft rows above all tasks, which bring back what is outside.
    """

    bounds: Bounds | None = None
    rows: Rows | None = None
    recovery: tuple[Rows, ...] = field(default=())


class Limit(ABC):
    """A limit of a robot: bounds and rows that a step must keep, and the way back where they are broken already.

    Hard rows never ask for motion, so that no two limits contradict each other: a step of zero keeps them all. The way
    back is a level of soft rows above all tasks, at a bounded speed.
    """

    def __init__(self, robot: Robot) -> None:
        if not isinstance(robot, Robot):
            raise InputError(f"robot of {type(self).__name__} is of type {type(robot).__name__}; expected a Robot.")
        self._model = robot.model

    def at(self, robot: Robot, dt: float) -> Guarded:
        """Return what the limit says of a step from the robot's position, over `dt` [s].

        Raises:
            InputError: a robot of another model; `dt` that is not positive; outside the limit, where that is an error.
        """
        if robot.model is not self._model:
            raise InputError(f"{type(self).__name__} is a limit of another model; make it from the robot that is to move.")
        return self._at(robot, positive("dt", dt))

    @abstractmethod
    def _at(self, robot: Robot, dt: float) -> Guarded: ...
