"""A problem whose numbers stand in one array: what a `LiveProblem` hands out, and what the compiled core reads as it is."""

import ctypes
from collections.abc import Sequence
from itertools import accumulate, compress, pairwise
from typing import Any, NamedTuple

import numpy as np

from prioritized_ik.late import Late
from prioritized_ik.problem import Bounds, Equalities, IKProblem, Level, Rows, trusted
from prioritized_ik.validation import Array


class Parts(NamedTuple):
    """What one array of numbers holds, in its order; the levels one after the other."""

    matrix: Array
    target: Array
    weights: Array
    lower: Array
    upper: Array
    reference: Array
    row_matrix: Array
    row_upper: Array
    equality_matrix: Array
    equality_target: Array

    @staticmethod
    def of(problem: IKProblem) -> "Parts":
        """Return the numbers of a problem."""
        m, levels, bounds = problem.joint_count, problem.levels, problem.bounds
        rows, fixed = problem.rows, problem.equalities
        return Parts(
            np.concatenate([np.zeros((0, m)), *(level.matrix for level in levels)]),
            np.concatenate([np.zeros(0), *(level.target for level in levels)]),
            np.concatenate([np.zeros(0), *(level.weights for level in levels)]),
            bounds.lower, bounds.upper, problem.reference,
            rows.matrix, rows.upper, fixed.matrix, fixed.target,
        )  # fmt: skip


class Layout:
    """What problems of one kind have in common, and where their numbers stand in one array.

    Attributes:
        pattern: a problem with that shape, and with its names, kinds of levels, damping, metric and noise.
        leaves_out: whether problems do not show those of the hard rows that have an infinite side.
        hands_down: whether the optimum of a damped level is handed down.
        levels: the rows of each level.
    """

    def __init__(self, pattern: IKProblem, *, leaves_out: bool = False) -> None:
        self.pattern, self.leaves_out, self.hands_down = pattern, leaves_out, pattern.hands_down
        self.levels = _in_succession([len(level.target) for level in pattern.levels])
        self._pattern_parts = parts = Parts.of(pattern)
        self._shapes = [part.shape for part in parts]
        self._places = _in_succession([part.size for part in parts])
        self._memory: Any = ctypes.c_double * sum(part.size for part in parts)

    def packed(self) -> Array:
        """Return the numbers of the pattern in one array."""
        return np.concatenate([part.ravel() for part in self._pattern_parts])

    def problem(self, numbers: Array) -> "PackedProblem":
        """Return the problem with numbers such as `packed` returns, which are copied."""
        return PackedProblem(self, self._memory.from_buffer_copy(numbers))

    def parts(self, numbers: Array) -> Parts:
        """Return views of an array of numbers."""
        places = zip(self._places, self._shapes, strict=True)
        return Parts(*(numbers[place].reshape(shape) for place, shape in places))


def _in_succession(counts: Sequence[int]) -> list[slice]:
    """Return the places of so many entries each, one after the other."""
    return [slice(start, end) for start, end in pairwise(accumulate(counts, initial=0))]


class PackedProblem(IKProblem):
    """A problem as `Layout` packs it; its parts are made when looked at.

    Args:
        layout: see there.
        memory: all numbers, an array of ctypes, which the compiled core reads where it is; not to be written.
    """

    levels: Any = Late()
    bounds: Any = Late()
    rows: Any = Late()
    reference: Any = Late()
    equalities: Any = Late()
    metric: Any = Late()
    noise: Any = Late()
    layout: Layout
    memory: ctypes.Array[ctypes.c_double]

    def __init__(self, layout: Layout, memory: ctypes.Array[ctypes.c_double]) -> None:
        self.__dict__.update(layout=layout, memory=memory)

    @property
    def pattern(self) -> IKProblem:
        """See `IKProblem.pattern`."""
        return self.layout.pattern

    @property
    def hands_down(self) -> bool:
        """See `IKProblem.hands_down`."""
        return self.layout.hands_down

    @property
    def joint_count(self) -> int:
        """Number of joints m."""
        return self.layout.pattern.joint_count

    def late_fields(self) -> dict[str, Any]:
        """Return the fields that are made late."""
        numbers = np.ctypeslib.as_array(self.memory)
        numbers.setflags(write=False)
        pattern, parts = self.layout.pattern, self.layout.parts(numbers)
        levels = [
            trusted(
                Level,
                matrix=parts.matrix[rows],
                target=parts.target[rows],
                weights=parts.weights[rows],
                name=level.name,
                kind=level.kind,
                damping=level.damping,
                below=level.below,
            )
            for level, rows in zip(pattern.levels, self.layout.levels, strict=True)
        ]
        equal = trusted(
            Equalities, matrix=parts.equality_matrix, target=parts.equality_target, names=pattern.equalities.names
        )
        return {
            "levels": tuple(levels),
            "bounds": trusted(Bounds, lower=parts.lower, upper=parts.upper, names=pattern.bounds.names),
            "rows": self._rows(parts),
            "reference": parts.reference,
            "equalities": equal,
            "metric": pattern.metric,
            "noise": pattern.noise,
        }

    def _rows(self, parts: Parts) -> Rows:
        rows = trusted(Rows, matrix=parts.row_matrix, upper=parts.row_upper, names=self.pattern.rows.names)
        kept = np.isfinite(rows.upper)
        if not self.layout.leaves_out or kept.all():
            return rows
        names = tuple(compress(rows.names, kept.tolist()))
        return trusted(Rows, matrix=rows.matrix[kept], upper=rows.upper[kept], names=names)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to make the same problem elsewhere, without what it was packed by."""
        return _unpacked, (self.late_fields(),)


def _unpacked(fields: dict[str, Any]) -> IKProblem:
    return trusted(IKProblem, **fields)
