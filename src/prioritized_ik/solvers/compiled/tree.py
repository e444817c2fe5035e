"""The elimination along a kinematic tree in the compiled core: `solvers/tree/elimination.py`, by the same names."""

import ctypes
import weakref
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.solvers.compiled.library import library
from prioritized_ik.solvers.tree.elimination import Ending, Factors, TreeRowsOnJoints
from prioritized_ik.tolerances import TREE_CLEAR, TREE_ZERO
from prioritized_ik.validation import Array

REDUCED, MULTIPLIERS, DISPLACEMENT = range(3)  # `TreeQuestion` in core.cpp


class TreeInput(ctypes.Structure):
    """What the core reads and writes: `TreeInput` in tree.hpp, field by field."""

    _fields_ = (
        [(name, ctypes.c_int32) for name in ("joints", "rows", "levels")]
        + [(name, ctypes.c_double) for name in ("zero", "clear")]
        + [
            (name, ctypes.c_void_p)
            for name in (
                *("parents", "row_joints", "row_levels", "axes", "arms", "covectors"),
                *("fixed", "counts", "owner", "pivot"),
            )
        ]
    )


class CompiledElimination(Factors):
    """`Elimination` in the compiled core; one problem's faces, one after the other, in the same memory."""

    def __init__(self, rows: TreeRowsOnJoints) -> None:
        core = library().core
        assert core is not None
        self.rows = rows
        self._core = core
        address = core.core_tree_new()
        if not address:
            raise MemoryError("no memory for the compiled core")
        self._address = ctypes.c_void_p(address)
        weakref.finalize(self, core.core_tree_delete, self._address)
        m, k = rows.tree.joint_count, len(rows.joints)
        self.owner, self.pivot = np.zeros(m, dtype=np.int32), np.ones(m)
        self.fixed, self._counts = np.zeros(m, dtype=bool), np.zeros(k, dtype=bool)
        kept: dict[str, NDArray[Any]] = {
            "parents": np.asarray(rows.tree.parents, dtype=np.int32),
            "row_joints": np.asarray(rows.joints, dtype=np.int32),
            "row_levels": np.asarray(rows.level, dtype=np.int32),
            "axes": rows.axes,
            "arms": rows.arms,
            "covectors": np.ascontiguousarray(rows.covectors),
            "fixed": self.fixed,
            "counts": self._counts,
            "owner": self.owner,
            "pivot": self.pivot,
        }
        self._kept = kept  # whose memory the input points to
        addresses = {name: array.ctypes.data for name, array in kept.items()}
        self._input = TreeInput(joints=m, rows=k, levels=rows.levels, zero=TREE_ZERO, clear=TREE_CLEAR, **addresses)

    def factor(self, fixed: NDArray[np.bool_], held: NDArray[np.bool_]) -> Ending:
        """See `Elimination.factor`."""
        self.fixed[:] = fixed
        np.logical_or(self.rows.level != 0, held, out=self._counts)
        return Ending(self._checked(self._core.core_tree_factor(self._address, ctypes.byref(self._input))))

    def solve(self, values: Array, sides: Array, reference: Array) -> tuple[Array, float]:
        """See `Elimination.solve`."""
        given = [np.ascontiguousarray(array, dtype=float) for array in (values, sides, reference)]
        u = np.empty(len(values))
        missed = self._core.core_tree_solve(self._address, *(array.ctypes.data for array in given), u.ctypes.data)
        self._checked(missed)
        return u, float(missed)

    def reduced(self, level: int, gradient: Array) -> Array:
        """See `Elimination.reduced`."""
        return self._asked(REDUCED, level, gradient, len(gradient))

    def multipliers(self, level: int, reduced: Array) -> Array:
        """See `Elimination.multipliers`."""
        return self._asked(MULTIPLIERS, level, reduced, len(self.rows.joints))

    def displacement(self, level: int, whitened: Array) -> Array:
        """See `Elimination.displacement`."""
        return self._asked(DISPLACEMENT, level, whitened, len(whitened))

    def row_lengths(self) -> Array:
        """Return the length of each row of the matrix without weights `(k,)`."""
        given, out = np.ascontiguousarray(self.rows.given), np.empty(len(self.rows.joints))
        self._checked(self._core.core_tree_row_lengths(ctypes.byref(self._input), given.ctypes.data, out.ctypes.data))
        return out

    def count_below(self, level: int, tau: float) -> int | None:
        """See `Elimination.count_below`."""
        given = np.ascontiguousarray(self.rows.given)
        count: int = self._core.core_tree_count_below(self._address, level, given.ctypes.data, tau)
        return None if count == -1 else self._checked(count)

    @property
    def memory(self) -> float:
        """What the core holds for it [B]."""
        return float(self._core.core_tree_memory(self._address))

    def _asked(self, question: int, level: int, given: Array, count: int) -> Array:
        given = np.ascontiguousarray(given, dtype=float)
        out = np.empty(count)
        self._checked(self._core.core_tree_ask(self._address, question, level, given.ctypes.data, out.ctypes.data))
        return out

    @staticmethod
    def _checked(answer: float) -> int:
        if answer < 0:
            raise MemoryError("no memory for the compiled core")
        return int(answer)
