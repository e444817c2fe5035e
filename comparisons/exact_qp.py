"""Strictly convex QPs in decimal numbers of many digits: a reference that shares nothing with any solver here.

The dual method of Goldfarb and Idnani (1983): from the optimum without rows, the most violated row is taken in, at the
cost of those whose multipliers it drives to zero, until none is violated. With sixty digits no step of it is in doubt.
"""

from dataclasses import dataclass
from decimal import Decimal, localcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray

Decimals = NDArray[Any]  # of Decimal

DIGITS = 60
ZERO = Decimal("1e-40")  # relative: far above the rounding of sixty digits, far below that of doubles


@dataclass(frozen=True)
class Optimum:
    """The one x that minimises ½ xᵀHx + cᵀx subject to Gx <= h.

    Attributes:
        x: `(n,)`.
        multipliers: of the rows `(r,)`, not negative: Hx + c + Gᵀ multipliers = 0.
    """

    x: Decimals
    multipliers: Decimals


def decimals(values: Any) -> Decimals:
    """Return the same numbers as decimals, exactly."""
    return np.frompyfunc(lambda value: Decimal(float(value)), 1, 1)(np.asarray(values, dtype=float))


def minimise(hessian: Decimals, linear: Decimals, matrix: Decimals, sides: Decimals) -> Optimum | None:
    """Return the optimum, None if no x keeps all rows.

    Args:
        hessian: H `(n, n)`, positive definite.
        linear: c `(n,)`.
        matrix: G `(r, n)`, no row of zeros.
        sides: h `(r,)`.
    """
    with localcontext(prec=DIGITS):
        inverse = _solved(hessian, decimals(np.eye(len(linear))))
        x = -inverse @ linear
        active: list[int] = []
        multipliers: list[Decimal] = []
        sizes = np.abs(matrix).sum(axis=1)
        while True:
            excess = (matrix @ x - sides) / sizes if len(sides) else np.zeros(0)
            worst = int(np.argmax(excess)) if len(sides) else -1
            if worst < 0 or excess[worst] <= ZERO:
                found = decimals(np.zeros(len(sides)))
                found[active] = multipliers
                return Optimum(x, found)
            taken = _taken_in(inverse, matrix, sides, worst, x, active, multipliers)
            if taken is None:
                return None
            x = taken


def _taken_in(
    inverse: Decimals,
    matrix: Decimals,
    sides: Decimals,
    entering: int,
    x: Decimals,
    active: list[int],
    multipliers: list[Decimal],
) -> Decimals | None:
    """Return x with row `entering` tight, `active` and `multipliers` changed in place; None if no x keeps the rows."""
    row, multiplier = matrix[entering], Decimal(0)
    whole = row @ (inverse @ row)
    while True:
        across = matrix[active] @ inverse  # (a, n)
        share = _solved(across @ matrix[active].T, across @ row) if active else decimals(np.zeros(0))
        direction = across.T @ share - inverse @ row if active else -inverse @ row
        rate = -(row @ direction)
        full = (row @ x - sides[entering]) / rate if rate > ZERO * whole else None
        falling = [(u / s, place) for place, (u, s) in enumerate(zip(multipliers, share, strict=True)) if s > 0]
        partial, leaving = min(falling, default=(None, -1))
        if full is None and partial is None:
            return None
        blocked = partial is not None and (full is None or partial < full)
        step = partial if blocked else full
        assert step is not None
        if full is not None:
            x = x + step * direction
        multiplier += step
        multipliers[:] = [u - step * s for u, s in zip(multipliers, share, strict=True)]
        if not blocked:
            active.append(entering)
            multipliers.append(multiplier)
            return x
        del active[leaving], multipliers[leaving]


def _solved(matrix: Decimals, right: Decimals) -> Decimals:
    """Return matrix⁻¹ right by Gauss-Jordan elimination with pivoting."""
    n = len(matrix)
    table = np.hstack([matrix, right.reshape(n, -1)])
    for column in range(n):
        pivot = column + int(np.argmax(np.abs(table[column:, column])))
        table[[column, pivot]] = table[[pivot, column]]
        table[column] = table[column] / table[column, column]
        for other in range(n):
            if other != column and table[other, column]:
                table[other] = table[other] - table[other, column] * table[column]
    return table[:, n:].reshape(right.shape)
