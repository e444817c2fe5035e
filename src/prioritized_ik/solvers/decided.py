"""What equalities and levels decide, as they are given, with twice the digits of doubles.

The directions that a level leaves are orthonormal to rounding, and its rows feel that. Where a level below hardly feels
what decides it, or rows push hard, that rounding is more than what they ask for.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from prioritized_ik.double_double import DoubleDouble
from prioritized_ik.tolerances import EPS, FINEST, TURNS
from prioritized_ik.validation import Array


@dataclass(frozen=True)
class Decision:
    """Rows that decide directions.

    Attributes:
        matrix: A `(k, m)`, of any length.
        answered: returns the steps `(m, k)` that answer what the rows lack.
        weakest: the least singular value that counts, of rows of unit length; infinite if there are no rows.
        is_rounded: whether the rows are not those that are given, but rounded once.
    """

    matrix: Array
    answered: Callable[[], Array]
    weakest: float
    is_rounded: bool

    @cached_property
    def answer(self) -> Array:
        """The steps `(m, k)` that answer what the rows lack, worked out when looked at."""
        return self.answered()

    @property
    def turn(self) -> float:
        """How far off directions can still be that were turned to what the rows leave, as an angle."""
        return (0.5 * EPS if self.is_rounded else 2.0 * self.matrix.shape[1] * FINEST) / self.weakest


@dataclass(frozen=True)
class Decided:
    """What equalities and frozen joints decide, then each level in order."""

    decisions: tuple[Decision, ...]

    def turn(self, count: int) -> float:
        """Return how far off directions can still be that were turned to what the first so many leave, as an angle."""
        return max((one.turn for one in self.decisions[:count]), default=0.0)

    def left(self, basis: Array, count: int) -> DoubleDouble:
        """Return `basis` `(m, v)` without what the first so many feel of it: rounding, where it is of directions below."""
        exact = DoubleDouble.of(basis)
        for one in self.decisions[:count]:
            for _ in range(TURNS if one.answer.size else 0):
                exact = exact - DoubleDouble.of(one.answer) @ (DoubleDouble.of(one.matrix) @ exact)
        return exact

    def less(self, rows: DoubleDouble, sizes: Array, combinations: Array, ways: Array, count: int) -> DoubleDouble:
        """Return `rows` `(t, m)` of which combinations do not move along `ways` `(m, w)`, as the first so many leave them.

        The `combinations` `(t, c)` are orthonormal and of rows of unit length; `sizes` `(t,)` are the rows' lengths.
        """
        left = self.left(ways, count)
        moved = DoubleDouble.of((combinations / sizes[:, None]).T) @ (rows @ left)
        return rows - DoubleDouble.of(combinations * sizes[:, None]) @ (moved @ left.T)
