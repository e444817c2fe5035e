"""What all limits have in common."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from prioritized_ik.errors import InputError
from prioritized_ik.problem import Bounds, Equalities, Rows
from prioritized_ik.robot import Robot
from prioritized_ik.validation import Array, positive

#: What may be done where a limit is broken already: an error; no further; back, by soft rows above all tasks; or back by
#: hard rows, which other limits may contradict.
OUTSIDE = ("raise", "hold", "return", "require")


END = ", end "  # rows of one pair of geoms are called by the pair's name, those of further points with this behind it


@dataclass(frozen=True)
class Guarded:
    """What a limit says of one step dθ `(nv,)`.

    Attributes:
        bounds: hard bounds; dθ = 0 keeps them, unless the limit is broken and may not be.
        rows: hard rows, likewise.
        recovery: soft rows above all tasks, which bring back what is outside.
        equalities: hard rows that take back no more than drift.
    """

    bounds: Bounds | None = None
    rows: Rows | None = None
    recovery: tuple[Rows, ...] = field(default=())
    equalities: Equalities | None = None


class Limit(ABC):
    """A limit of a robot: bounds and rows that a step must keep, and the way back where they are broken already.

    Hard rows never ask for motion, so that no two limits contradict each other: a step of zero keeps them all. The way
    back is a level of soft rows above all tasks, at a bounded speed. Who chooses `outside="require"` has hard rows for it,
    and an `InfeasibleError` that names them where the way back is blocked.
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

    @property
    def is_exact(self) -> bool:
        """Whether its rows are, so that `room` has nothing to tell wherever the robot is."""
        return type(self).room is Limit.room

    def room(self, robot: Robot) -> dict[str, float]:
        """Return what is left by name of the hard rows [units of the rows], below zero where they are broken.

        Rows that belong together are called by one name, then `END` and more. None of a limit whose rows are exact.
        """
        return {}

    def opened(self, robot: Robot) -> Array:
        """Return how far each of the equalities is open `(e,)`, in the order of `Guarded.equalities`.

        None of a limit that has none, or whose equalities are exact.
        """
        return np.zeros(0)


@dataclass(frozen=True)
class Way:
    """What is done about rows that are broken.

    Attributes:
        outside: one of `OUTSIDE`; `"raise"` is up to the limit, which knows what to say.
        gain: how much of the room one step may take.
        speed: how fast to come back, at most [units of the rows / s].
        rounding: rows broken by less are not brought back [units of the rows].
    """

    outside: str
    gain: float
    speed: float
    rounding: float

    def guarded(self, matrix: Array, room: Array, names: Sequence[str], dt: float, *, hard: bool = True) -> Guarded:
        """Return rows of which dθ may take no more than the room, and the way back of those that have less than none.

        Args:
            matrix: of the rows `(r, nv)`.
            room: what is left `(r,)`, below zero where a row is broken.
            names: of the rows.
            dt: time step [s].
            hard: whether the rows are; soft ones join the way back, above all tasks.
        """
        out, kept = room < -self.rounding, self.gain * np.maximum(room, 0.0)
        back = np.where(out, -np.minimum(-room, self.speed * dt), kept)
        if not hard:
            return Guarded(recovery=(Rows(matrix, kept if self.outside == "hold" else back, names),))
        if self.outside == "require":
            return Guarded(rows=Rows(matrix, back, names))
        rows = Rows(matrix, kept, names)
        if self.outside != "return" or not out.any():
            return Guarded(rows=rows)
        returning = [f"{names[i]} return" for i in np.flatnonzero(out).tolist()]
        return Guarded(rows=rows, recovery=(Rows(matrix[out], back[out], returning),))
