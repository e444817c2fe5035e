"""Rows of a problem written where a robot is, all in one call of the compiled core: for loops that keep a `LiveProblem`.

    live, posing = LiveProblem(problem), Posing(robot.model, robot.data)
    posing.position(robot.frame(site="tool"), wanted, live.matrix("hand"), live.target("hand"))
    posing.bounds(live.lower, live.upper, max_step)
    while True:
        robot.update(q)
        wanted[:] = ...
        posing()
        step = solve(live.frozen(), method)

`Posing.by_python` writes the same and is the form to read; it runs where there is no core.
"""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from prioritized_ik.errors import InputError
from prioritized_ik.limits import limited_scalars
from prioritized_ik.mujoco_functions import mujoco_functions
from prioritized_ik.robot import Frame
from prioritized_ik.solvers.compiled.library import library
from prioritized_ik.tasks.turns import turn_between
from prioritized_ik.validation import Array, finite_array

PLACES = {"body": "xpos", "site": "site_xpos", "geom": "geom_xpos"}
TURNS = {"body": "xmat", "site": "site_xmat", "geom": "geom_xmat"}
FUNCTIONS = ("jac", "jac_mass", "to_quaternion", "to_vector")  # of MuJoCo's


class Kind(IntEnum):
    """What rows are of; `PosedKind` in posing.hpp."""

    POINT = 0
    TURN = 1
    MASS = 2
    JOINTS = 3
    BOUNDS = 4


@dataclass
class PosedRows:
    """Some rows, and the arrays that they are written to.

    Attributes:
        kind: what of.
        matrix: J `(k, nv)`, or of bounds the lower ones `(nv,)`.
        target: b `(k,)`, or the upper bounds `(nv,)`.
        here: where MuJoCo has it: a place `(3,)`, a rotation `(9,)`, or all positions `(nq,)`.
        wanted: the same as it is to be, looked at anew at every call; of bounds both ends of the ranges `(2, k)`. None for
            no error: the target is zero.
        across: combinations `(k, 3)` of the three rows; of bounds how far a step goes `(2, k)`.
        axes: that combinations are in `(9,)`, a rotation as MuJoCo has it; the world's unless given.
        body: that moves.
        gain: of the error.
        floored: whether no target is below zero.
        places, dofs: of joints, in q and in dθ.
    """

    kind: Kind
    matrix: Array
    target: Array
    here: Array
    wanted: Array | None = None
    across: Array | None = None
    axes: Array | None = None
    body: int = 0
    gain: float = 1.0
    floored: bool = False
    places: NDArray[np.int32] | None = None
    dofs: NDArray[np.int32] | None = None

    def write(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Write the rows at the state of `data`."""
        if self.kind is Kind.JOINTS:
            assert self.wanted is not None
            self.target[:] = self.gain * (self.wanted - self.here[self.places])
        elif self.kind is Kind.BOUNDS:
            assert self.wanted is not None
            assert self.across is not None
            away = self.wanted - self.here[self.places]
            self.matrix[self.dofs] = np.maximum(np.minimum(away[0], 0.0), self.across[0])
            self.target[self.dofs] = np.minimum(np.maximum(away[1], 0.0), self.across[1])
        else:
            self._write_frame(model, data)

    def _write_frame(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        jacobian, error = np.zeros((3, model.nv)), np.zeros(3)
        if self.kind is Kind.POINT:
            mujoco.mj_jac(model, data, jacobian, None, self.here, self.body)
        elif self.kind is Kind.TURN:
            mujoco.mj_jac(model, data, None, jacobian, np.zeros(3), self.body)
        else:
            mujoco.mj_jacSubtreeCom(model, data, jacobian, self.body)
        if self.wanted is not None:
            is_turn = self.kind is Kind.TURN
            error = turn_between(self.here.reshape(3, 3), self.wanted.reshape(3, 3)) if is_turn else self.wanted - self.here
        sides = np.eye(3) if self.across is None else self.across
        if self.axes is not None:
            sides = sides @ self.axes.reshape(3, 3).T
        self.matrix[:], self.target[:] = sides @ jacobian, self.gain * (sides @ error)
        if self.floored:
            np.maximum(self.target, 0.0, out=self.target)


class _Rows(ctypes.Structure):
    """`PosedRows` in posing.hpp."""

    _fields_ = (
        [(name, ctypes.c_int32) for name in ("kind", "body", "count", "floored")]
        + [("gain", ctypes.c_double)]
        + [(name, ctypes.c_void_p) for name in ("here", "wanted", "across", "axes", "places", "dofs", "matrix", "target")]
    )


class _Asked(ctypes.Structure):
    """`Posing` in posing.hpp."""

    _fields_ = [(name, ctypes.c_int32) for name in ("count", "joints")] + [
        (name, ctypes.c_void_p) for name in ("model", "data", *FUNCTIONS, "rows", "scratch")
    ]


class Posing:
    """What of a robot is written where, at every call anew.

    What is wanted is an array of the caller's, looked at at every call. Matrices and targets are written in place; they are
    C-contiguous, as those of a `LiveProblem`.

    Args:
        model: the robot's.
        data: its state, positions and terms for Jacobians up to date at every call (`Robot.update`).
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        if data.model is not model and data.qpos.shape != (model.nq,):
            raise InputError(
                f"data has {data.qpos.shape[0]} positions; expected {model.nq}, as the model: mujoco.MjData(model)."
            )
        self._model, self._data = model, data
        self._rows: list[PosedRows] = []
        self._others: list[Callable[[], object]] = []

    def position(
        self,
        frame: Frame,
        wanted: Array | None,
        matrix: Array,
        target: Array,
        *,
        across: ArrayLike | None = None,
        own_axes: bool = False,
        gain: float = 1.0,
        floored: bool = False,
    ) -> None:
        """Write the Jacobian of a frame's origin, and the way to where it is `wanted` `(3,)` [m].

        Args:
            frame: see `Robot.frame`.
            wanted: None where it is to stay.
            matrix: `(3, nv)`, or as many rows as `across` has.
            target: `(3,)`, likewise.
            across: combinations `(k, 3)` of the three rows to write in their place.
            own_axes: whether these are in the frame's own axes, not the world's.
            gain: of the error.
            floored: whether targets below zero are written as zero: sides of hard rows that dθ = 0 is to keep.

        Raises:
            InputError: an array of another shape, or that cannot be written in place.
        """
        rows = PosedRows(Kind.POINT, matrix, target, getattr(self._data, PLACES[frame.kind])[frame.number], wanted)
        rows.floored = floored
        self._frame(rows, frame, across, own_axes, gain)

    def orientation(
        self,
        frame: Frame,
        wanted: Array | None,
        matrix: Array,
        target: Array,
        *,
        across: ArrayLike | None = None,
        own_axes: bool = False,
        gain: float = 1.0,
    ) -> None:
        """Write the Jacobian of a frame's rotation [rad], and the turn to the one `wanted` `(9,)`, row by row.

        The arguments and errors are those of `position`.
        """
        rows = PosedRows(Kind.TURN, matrix, target, getattr(self._data, TURNS[frame.kind])[frame.number], wanted)
        self._frame(rows, frame, across, own_axes, gain)

    def centre_of_mass(
        self,
        body: int,
        wanted: Array | None,
        matrix: Array,
        target: Array,
        gain: float = 1.0,
        *,
        across: ArrayLike | None = None,
    ) -> None:
        """Write the Jacobian of the centre of mass of a body and all that hangs on it, and the way to `wanted` `(3,)` [m].

        The arguments and errors are those of `position`; combinations are in the world's axes.
        """
        rows = PosedRows(Kind.MASS, matrix, target, self._data.subtree_com[body], wanted, body=body, gain=gain)
        if across is not None:
            rows.across = finite_array("across", across, (None, 3))
        self._three(rows)

    def joints(self, places: ArrayLike, wanted: Array, target: Array, gain: float = 1.0) -> None:
        """Write how far hinges and slides at `places` of q are from where they are `wanted` `(k,)`, and no matrix."""
        at = np.array(places, dtype=np.int32)
        if not ((at >= 0) & (at < self._model.nq)).all():
            raise InputError(f"places are {at.tolist()}; expected numbers from 0 to {self._model.nq - 1}, places in q.")
        _in_place("target", target, at.shape)
        wanted = _readable("wanted", wanted, at.shape)
        self._add(PosedRows(Kind.JOINTS, np.zeros(0), target, self._data.qpos, wanted, gain=gain, places=at))

    def bounds(self, lower: Array, upper: Array, max_step: ArrayLike) -> None:
        """Write bounds that keep limited hinges and slides in their range, none below or above a step of zero.

        Args:
            lower: `(nv,)`.
            upper: `(nv,)`.
            max_step: how far a step goes at most `(nv,)` [rad, m]; also of joints without range.
        """
        nv = self._model.nv
        step = finite_array("max_step", max_step, (nv,))
        _in_place("lower", lower, (nv,))
        _in_place("upper", upper, (nv,))
        lower[:], upper[:] = -step, step
        joints, dofs, places = limited_scalars(self._model)
        ranges = np.array(self._model.jnt_range[joints].T, order="C")
        most = np.array([-step[dofs], step[dofs]])
        rows = PosedRows(Kind.BOUNDS, lower, upper, self._data.qpos, ranges, most)
        rows.places, rows.dofs = np.array(places, dtype=np.int32), np.array(dofs, dtype=np.int32)
        self._add(rows)

    def also(self, write: Callable[[], object]) -> None:
        """Call `write` at every call, too, after all rows: for what is not known here."""
        self._others.append(write)

    def by_python(self) -> None:
        """Write everything, row by row."""
        for rows in self._rows:
            rows.write(self._model, self._data)
        for write in self._others:
            write()

    def __call__(self) -> None:
        """Write everything."""
        if self._compiled is None:
            self.by_python()
            return
        pose, at, _ = self._compiled
        pose(at)
        for write in self._others:
            write()

    @cached_property
    def _compiled(self) -> tuple[Callable[[Any], object], Any, object] | None:
        """The core's function, what it is called with, and the memory that this points to; None if there is no core."""
        core, functions = library().core, mujoco_functions()
        if core is None or functions is None:
            return None
        table = (_Rows * len(self._rows))(*(_row(rows) for rows in self._rows))
        scratch = np.zeros((6, self._model.nv))
        asked = _Asked(
            count=len(self._rows),
            joints=self._model.nv,
            model=self._model._address,
            data=self._data._address,
            rows=ctypes.addressof(table),
            scratch=scratch.ctypes.data,
            **{name: functions[name] for name in FUNCTIONS},
        )
        return core.core_pose, ctypes.byref(asked), (table, scratch, asked)

    def _carrier(self, frame: Frame) -> int:
        return frame.number if frame.kind == "body" else int(getattr(self._model, f"{frame.kind}_bodyid")[frame.number])

    def _frame(self, rows: PosedRows, frame: Frame, across: ArrayLike | None, own_axes: bool, gain: float) -> None:
        rows.body, rows.gain = self._carrier(frame), gain
        if across is not None:
            rows.across = finite_array("across", across, (None, 3))
            rows.axes = getattr(self._data, TURNS[frame.kind])[frame.number] if own_axes else None
        self._three(rows)

    def _three(self, rows: PosedRows) -> None:
        """Take in rows of a point or turn, or combinations of them, if their arrays fit."""
        count = 3 if rows.across is None else len(rows.across)
        _in_place("matrix", rows.matrix, (count, self._model.nv))
        _in_place("target", rows.target, (count,))
        if rows.wanted is not None:
            _readable("wanted", rows.wanted, rows.here.shape)
        self._add(rows)

    def _add(self, rows: PosedRows) -> None:
        self._rows.append(rows)
        self.__dict__.pop("_compiled", None)  # which points to the table of all


def _row(rows: PosedRows) -> _Rows:
    arrays = {
        name: getattr(rows, name) for name in ("here", "wanted", "across", "axes", "places", "dofs", "matrix", "target")
    }
    return _Rows(
        kind=rows.kind,
        body=rows.body,
        count=len(rows.target) if rows.places is None else len(rows.places),
        floored=rows.floored,
        gain=rows.gain,
        **{name: None if array is None else array.ctypes.data for name, array in arrays.items()},
    )


def _readable(name: str, array: Array, shape: tuple[int, ...]) -> Array:
    if not isinstance(array, np.ndarray) or array.dtype != float or array.shape != shape or not array.flags.c_contiguous:
        given = f"an array of shape {array.shape}" if isinstance(array, np.ndarray) else f"of type {type(array).__name__}"
        raise InputError(f"{name} is {given}; expected a C-contiguous array of floats of shape {shape}.")
    return array


def _in_place(name: str, array: Array, shape: tuple[int, ...]) -> None:
    if not _readable(name, array, shape).flags.writeable:
        raise InputError(f"{name} is read-only; expected an array to write to, such as those of a LiveProblem.")
