"""The elimination along a kinematic tree in the compiled core: `solvers/tree/elimination.py`, by the same names."""

import ctypes
import weakref
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.solvers.compiled.library import library, tolerances_of
from prioritized_ik.solvers.tree.factors import Balance, Ending, Factors, TreeRowsOnJoints
from prioritized_ik.tolerances import NOISE, ROUNDING
from prioritized_ik.validation import Array

PARTS, WHITENED, PULLS, DISPLACEMENT, LEFT_BY = range(5)  # `TreeQuestion` in core.cpp


class TreeInput(ctypes.Structure):
    """What the core reads and writes: `TreeInput` in tree_stages.hpp, field by field."""

    _fields_ = (
        [(name, ctypes.c_int32) for name in ("joints", "rows", "levels")]
        + [(name, ctypes.c_double) for name in ("zero", "rounding", "noise")]
        + [
            (name, ctypes.c_void_p)
            for name in (
                *("parents", "row_joints", "row_levels", "angular", "linear", "anchors"),
                *("points", "directions", "roots"),
                *("fixed", "counts", "lengths", "strongest", "weakest", "ranks"),
            )
        ]
    )


_idle: list[ctypes.c_void_p] = []  # what was of use to a problem before: its memory is there already
MOST_IDLE = 4


def taken(core: ctypes.CDLL) -> ctypes.c_void_p:
    """Return the address of what solves problems on trees, one at a time, for its user alone."""
    try:
        return _idle.pop()
    except IndexError:
        address = core.core_tree_new(tolerances_of(core).ctypes.data)
        if not address:
            raise MemoryError("no memory for the compiled core") from None
        return ctypes.c_void_p(address)


def given_back(core: ctypes.CDLL, address: ctypes.c_void_p) -> None:
    """Keep for others, or free, what was `taken`."""
    if len(_idle) < MOST_IDLE:
        _idle.append(address)
    else:
        core.core_tree_delete(address)


class CompiledElimination(Factors):
    """`Elimination` in the compiled core; one problem's faces, one after the other, in the same memory."""

    def __init__(self, rows: TreeRowsOnJoints) -> None:
        core = library().core
        assert core is not None
        self.rows = rows
        self._core = core
        self._address = taken(core)
        weakref.finalize(self, given_back, core, self._address)
        points, tree = rows.points, rows.points.tree
        m, k = tree.joint_count, len(points)
        self.fixed, self._counts = np.zeros(m, dtype=bool), np.zeros(k, dtype=bool)
        self._lengths, self._strongest, self._weakest = np.zeros(k), np.zeros(rows.levels + 1), np.zeros(rows.levels + 1)
        self._ranks = np.zeros(rows.levels + 1, dtype=np.int32)
        self._kept: dict[str, NDArray[Any]] = {  # whose memory the input points to
            "parents": np.asarray(tree.parents, dtype=np.int32),
            "row_joints": np.asarray(points.joints, dtype=np.int32),
            "row_levels": np.asarray(rows.level, dtype=np.int32),
            "angular": np.ascontiguousarray(tree.angular, dtype=float),
            "linear": np.ascontiguousarray(tree.linear, dtype=float),
            "anchors": np.ascontiguousarray(tree.anchors, dtype=float),
            "points": np.ascontiguousarray(points.points, dtype=float),
            "directions": np.ascontiguousarray(points.directions, dtype=float),
            "roots": np.ascontiguousarray(rows.roots),
            "fixed": self.fixed,
            "counts": self._counts,
            "lengths": self._lengths,
            "strongest": self._strongest,
            "weakest": self._weakest,
            "ranks": self._ranks,
        }
        addresses = {name: array.ctypes.data for name, array in self._kept.items()}
        sizes = {"joints": m, "rows": k, "levels": rows.levels}
        self._input = TreeInput(**sizes, zero=rows.zero, rounding=ROUNDING, noise=NOISE, **addresses)
        checked(core.core_tree_pose(self._address, ctypes.byref(self._input)))

    def factor(self, fixed: NDArray[np.bool_], held: NDArray[np.bool_]) -> Ending:
        """See `Elimination.factor`."""
        self.fixed[:] = fixed
        np.logical_or(self.rows.level != 0, held, out=self._counts)
        ending = Ending(checked(self._core.core_tree_factor(self._address)))
        self.ranks, self.strongest = self._ranks.tolist(), self._strongest.tolist()
        self.weakest = self._weakest.tolist()
        sizes = [*self.ranks, len(fixed) - int(np.count_nonzero(fixed)) - sum(self.ranks)]
        ends = np.cumsum(sizes).tolist()
        self._parts = [slice(end - size, end) for end, size in zip(ends, sizes, strict=True)]
        return ending

    def solve(self, values: Array, sides: Array, reference: Array) -> Array:
        """See `Elimination.solve`."""
        given = [np.ascontiguousarray(array, dtype=float) for array in (values, sides, reference)]
        u = np.empty(len(values))
        checked(self._core.core_tree_solve(self._address, *(array.ctypes.data for array in given), _place(u)))
        return u

    def motions(self, u: Array) -> tuple[Array, Array]:
        """See `Factors.motions`."""
        u, motions, sizes = np.ascontiguousarray(u, dtype=float), np.empty(len(self._counts)), np.empty(len(self._counts))
        checked(self._core.core_tree_motions(self._address, u.ctypes.data, _place(motions), _place(sizes)))
        return motions, sizes

    def damp(self, row_weights: Array, joint_weights: Array) -> None:
        """See `Factors.damp`."""
        checked(self._core.core_tree_damped(self._address, row_weights.ctypes.data, joint_weights.ctypes.data, None))

    def damped(self, row_sides: Array, joint_sides: Array) -> Array:
        """See `Factors.damped`."""
        u, given = np.empty(len(joint_sides)), (row_sides.ctypes.data, joint_sides.ctypes.data)
        checked(self._core.core_tree_damped(self._address, *given, _place(u)))
        return u

    def parts(self, gradient: Array) -> list[Array]:
        """See `Elimination.parts`."""
        whole = self._asked(PARTS, 0, gradient, self._parts[-1].stop)
        return [whole[part] for part in self._parts]

    def whitened(self, level: int, part: Array) -> Array:
        """See `Elimination.whitened`."""
        return self._asked(WHITENED, level, part, len(part))

    def pulls(self, level: int, whitened: Array) -> Array:
        """See `Elimination.pulls`."""
        return self._asked(PULLS, level, whitened, len(self.rows.level))

    def displacement(self, level: int, whitened: Array) -> Array:
        """See `Elimination.displacement`."""
        return self._asked(DISPLACEMENT, level, whitened, len(self.fixed))

    def left_by(self, level: int, step: Array) -> Array:
        """See `Factors.left_by`."""
        return self._asked(LEFT_BY, level, step, len(self.fixed))

    def balance(self, level: int, given: Array, sizes: Array, rounded: float, off: Array, *, is_held: bool) -> Balance:
        """See `Factors.balance`, which this does in one go."""
        arrays = [np.ascontiguousarray(array, dtype=float) for array in (given, sizes)]
        m, k = len(self.fixed), len(self.rows.level)
        made = [off.copy(), np.empty(m), np.empty(k), np.empty(m), np.empty(6)]
        addresses = [*(array.ctypes.data for array in arrays), *map(_place, made)]
        checked(self._core.core_tree_balance(self._address, level, is_held, rounded, *addresses))
        off, rest, pulls, of_bounds, figures = made
        return Balance(rest, pulls, off, of_bounds, *figures.tolist())

    def row_lengths(self) -> Array:
        """See `Elimination.row_lengths`."""
        return self._lengths

    def count_below(self, level: int, tau: float) -> int | None:
        """See `Elimination.count_below`."""
        count: int = self._core.core_tree_count_below(self._address, level, tau)
        return None if count == -1 else checked(count)

    @property
    def memory(self) -> float:
        """What the core holds for it [B]."""
        return float(self._core.core_tree_memory(self._address))

    def _asked(self, question: int, level: int, given: Array, count: int) -> Array:
        given = np.ascontiguousarray(given, dtype=float)
        out = np.empty(count)
        checked(self._core.core_tree_ask(self._address, question, level, given.ctypes.data, _place(out)))
        return out


def _place(array: NDArray[Any]) -> int:
    """Return the address of an array that is written to; `array.ctypes.data` takes several times as long."""
    return ctypes.addressof(ctypes.c_char.from_buffer(array.data)) if array.size else 0


def checked(answer: int) -> int:
    """Return the core's answer, which is negative if memory ran out."""
    if answer < 0:
        raise MemoryError("no memory for the compiled core")
    return answer
