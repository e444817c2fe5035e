"""Matrices of numbers with twice the digits of doubles, as the unevaluated sum of two (Dekker 1971).

A matrix product is a sum of products of slices, each of so few bits that the product of two rounds nothing (Ozaki, Ogita,
Oishi and Rump 2012): a handful of ordinary matrix products, the same on every platform, which `numpy.longdouble` is not.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.validation import Array

SPLIT = 2.0**27 + 1.0  # halves the bits of a double
SLICES = 5
OF_HIGH = 2  # slices that leave so little of the high part that the low part is added to it without loss
BITS = 53


@dataclass(frozen=True)
class DoubleDouble:
    """A matrix or vector of numbers `high` + `low`, |low| at most half a unit in the last place of |high|.

    Sums and products by doubles are right to 2⁻¹⁰⁰ of their terms, matrix products to `tolerances.FINEST` of the number of
    terms times the largest of the row and the largest of the column.
    """

    high: Array
    low: Array

    @classmethod
    def of(cls, values: Array) -> "DoubleDouble":
        """Return doubles as they are."""
        return cls(values, np.zeros_like(values))

    @property
    def rounded(self) -> Array:
        """The nearest doubles."""
        return self.high + self.low

    @property
    def T(self) -> "DoubleDouble":
        """Transposed."""
        return DoubleDouble(self.high.T, self.low.T)

    def __getitem__(self, index: Any) -> "DoubleDouble":
        """Return a part."""
        return DoubleDouble(self.high[index], self.low[index])

    def where(self, some: NDArray[np.bool_]) -> "DoubleDouble":
        """Return zeros where it is not one of `some`."""
        return DoubleDouble(np.where(some, self.high, 0.0), np.where(some, self.low, 0.0))

    def padded(self, count: int) -> "DoubleDouble":
        """Return a vector with zeros after it, `count` numbers."""
        zeros = np.zeros(count - len(self.high))
        return DoubleDouble(np.append(self.high, zeros), np.append(self.low, zeros))

    def replaced(self, rows: NDArray[np.int_], others: "DoubleDouble") -> "DoubleDouble":
        """Return a matrix with `others` `(t, m)` for its `rows` `(t,)`."""
        high, low = self.high.copy(), self.low.copy()
        high[rows], low[rows] = others.high, others.low
        return DoubleDouble(high, low)

    def __neg__(self) -> "DoubleDouble":
        """Return the negative."""
        return DoubleDouble(-self.high, -self.low)

    def __add__(self, other: "DoubleDouble") -> "DoubleDouble":
        """Return the sum."""
        high, rounding = _sum(self.high, other.high)
        return _normal(high, rounding + (self.low + other.low))

    def __sub__(self, other: "DoubleDouble") -> "DoubleDouble":
        """Return the difference."""
        return self + -other

    def times(self, factors: Array) -> "DoubleDouble":
        """Return the product with doubles, element by element."""
        product = self.high * factors
        (a, b), (c, d) = _halves(self.high), _halves(factors)
        rounding = ((a * c - product) + a * d + b * c) + b * d
        return _normal(product, rounding + self.low * factors)

    def __matmul__(self, other: "DoubleDouble") -> "DoubleDouble":
        """Return the matrix product `(k, n)` of `(k, m)` and `(m, n)`."""
        terms = self.high.shape[1]
        bits = (BITS - int(np.ceil(np.log2(max(terms, 1))))) // 2
        left, right = _slices(self, 1, bits), _slices(other, 0, bits)
        total = DoubleDouble.of(np.zeros((len(self.high), other.high.shape[1])))
        for order in reversed(range(SLICES)):
            for i in range(order + 1):
                if i < len(left) and order - i < len(right):
                    high, rounding = _sum(left[i] @ right[order - i], total.high)
                    total = DoubleDouble(high, total.low + rounding)
        return _normal(total.high, total.low)


def _sum(a: Array, b: Array) -> tuple[Array, Array]:
    """Return the rounded sum, and what rounding took from it."""
    total = a + b
    of_b = total - a
    return total, (a - (total - of_b)) + (b - of_b)


def _normal(high: Array, low: Array) -> DoubleDouble:
    total = high + low
    return DoubleDouble(total, low - (total - high))


def _halves(values: Array) -> tuple[Array, Array]:
    scaled = SPLIT * values
    upper = scaled - (scaled - values)
    return upper, values - upper


def _slices(numbers: DoubleDouble, axis: int, bits: int) -> list[Array]:
    """Return the leading bits of numbers, the next ones, and so on, relative to the largest along an axis."""
    rest, slices = numbers.high, list[Array]()
    for number in range(SLICES):
        if number == OF_HIGH:
            rest = rest + numbers.low
        largest = np.abs(rest).max(axis=axis, keepdims=True, initial=0.0)
        # Added to this, the other bits fall off.
        large = np.ldexp(1.5, np.frexp(largest)[1] + (BITS - 1 - bits))
        leading = (rest + large) - large
        rest = rest - leading
        slices.append(leading)
        if number >= OF_HIGH and not rest.any():
            break
    return slices
