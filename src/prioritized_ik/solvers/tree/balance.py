"""How far rows of the levels above, and what is fixed, balance a level's gradient at a step: what its proof is made of."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from prioritized_ik.solvers.tree.factors import HELD, Balance, Factors
from prioritized_ik.tolerances import EPS, FINEST
from prioritized_ik.validation import Array, length

#: [of the sum of the sizes of a sum's terms] What rounding leaves; that of one link's motion is in all rows beyond it alike
ROUNDED = 2.0 * EPS
FINER = FINEST / EPS  # [of the same] with twice the digits


def balance(
    factors: Factors,
    sizes_of_torques: Callable[[Array], Array],
    level: int,
    given: Array,
    sizes: Array,
    rounded: float,
    off: Array,
    *,
    is_held: bool,
) -> Balance:
    """Return how far a level's gradient is balanced.

    Multipliers are of this factorisation, but what they leave is worked out from rows and axes as they are given. The
    lowest of the levels above comes first: its rows are nothing to what those below it decide.

    Args:
        factors: of the face that the step is on.
        sizes_of_torques: returns the sum of the sizes of all terms of the torques of weighted rows times values.
        level: its number; the last level's counts too.
        given: what its rows lack, weighted `(k,)`; of the last level, its gradient u - r `(m,)`.
        sizes: of the terms of that, `(k,)` or `(m,)`.
        rounded: rounding of a term.
        off: how far the step is off what the levels before would have `(m,)`.
        is_held: whether anything is fixed or held, so that multipliers are of interest.
    """
    rows = factors.rows
    is_last, pulls = level == rows.last, np.zeros(len(rows.level))

    def torques(values: Array) -> Array:
        return rows.points.transposed_times(values * rows.roots)

    own_rows = rows.level == level
    rest = given.copy() if is_last else -torques(np.where(own_rows, given, 0.0))
    for above in reversed(range(level)):
        if factors.ranks[above]:
            own = -factors.pulls(above, factors.whitened(above, factors.parts(rest)[above]))
            rest = rest + torques(own)
            pulls += own
    parts = factors.parts(rest)
    decided = parts[-1] if is_last else factors.whitened(level, parts[level])
    blur, moved = off, length(decided)
    if not is_last:
        displacement = factors.displacement(level, decided)
        off, moved = off + displacement, length(displacement)
        blur = torques(np.where(own_rows, rows.roots * rows.points.times(off), 0.0))
    noise = rounded * sizes_of_torques(np.abs(pulls) + (0.0 if is_last else sizes))
    if is_last:
        noise = noise + rounded * sizes
    others = parts[:-1] if is_last else [*parts[:level], *parts[level + 1 :]]
    astray = length(np.array([length(part) for part in others]))
    if is_last:
        feigned = length(noise + np.abs(blur))
    else:
        feigned = length(
            factors.displacement(level, factors.whitened(level, factors.parts(noise * _signs(len(noise)))[level]))
        )
    of_bounds, of_rows = _uncertain(factors, sizes_of_torques, level, noise, blur, is_held=is_held)
    return Balance(rest, pulls, off, of_bounds, float(decided @ decided), moved, astray, length(noise), feigned, of_rows)


def _uncertain(
    factors: Factors,
    sizes_of_torques: Callable[[Array], Array],
    level: int,
    noise: Array,
    blur: Array,
    *,
    is_held: bool,
) -> tuple[Array, float]:
    """Return how uncertain a level's rest is along each joint `(m,)`, and multipliers of held rows.

    Args:
        factors: see `balance`.
        sizes_of_torques: see there.
        level: see there.
        noise: of the rest, by rounding `(m,)`.
        blur: what the step's being off does to the rest `(m,)`.
        is_held: see there.
    """
    of_bounds, of_rows = noise + np.abs(blur), 0.0
    if is_held:
        # What balances uncertain multipliers is as uncertain, and so is what that does to joints at a bound.
        uncertain, unsure = factors.parts(np.where(blur < 0.0, -of_bounds, of_bounds)), np.zeros(len(factors.rows.level))
        for above in range(level):
            if factors.ranks[above]:
                some = np.abs(factors.pulls(above, factors.whitened(above, uncertain[above])))
                own = factors.rows.level == above
                unsure += np.where(own, some + length(some) / np.sqrt(np.count_nonzero(own)), 0.0)
        of_bounds = of_bounds + sizes_of_torques(unsure)
        of_rows = float(unsure[factors.rows.level == HELD].max(initial=0.0))
    return of_bounds, of_rows


def finely(factors: Factors, found: Balance, level: int, rest: Array, off: Array, *, surely: bool) -> Balance:
    """Return the balance with a rest of more digits, and what that could lower.

    The multipliers are those found and those that balance what their rounding leaves.

    Args:
        factors: of the face that the step is on.
        found: the balance in doubles.
        level: its number.
        rest: what the multipliers found leave of the level's gradient `(m,)`, worked out with twice the digits.
        off: how far the step is off what the levels before would have `(m,)`.
        surely: whether what is uncertain is that of so many digits, too, and not that of doubles.
    """
    rows, pulls = factors.rows, found.pulls
    points = rows.points
    noise = FINER * found.of_bounds
    for above in reversed(range(level)):
        if factors.ranks[above]:
            own = -factors.pulls(above, factors.whitened(above, factors.parts(rest)[above]))
            rest, pulls = rest + points.transposed_times(own * rows.roots), pulls + own
            noise = noise + ROUNDED * points.sizes_of_torques(own * rows.roots)
    is_last, parts = level == rows.last, factors.parts(rest)
    decided = parts[-1] if is_last else factors.whitened(level, parts[level])
    blur, moved = off, length(decided)
    if not is_last:
        displacement = factors.displacement(level, decided)
        off, moved = off + displacement, length(displacement)
        blur = points.transposed_times(np.where(rows.level == level, rows.roots**2 * points.times(off), 0.0))
    others = parts[:-1] if is_last else [*parts[:level], *parts[level + 1 :]]
    lower, astray = float(decided @ decided), length(np.array([length(part) for part in others]))
    if not surely:
        return replace(found, rest=rest, pulls=pulls, off=off, lower=lower, moved=moved, astray=astray)
    if is_last:
        feigned = length(noise + np.abs(blur))
    else:
        feigned = length(
            factors.displacement(level, factors.whitened(level, factors.parts(noise * _signs(len(noise)))[level]))
        )

    def sizes_of_torques(values: Array) -> Array:
        return points.sizes_of_torques(values * rows.roots)

    of_bounds, of_rows = _uncertain(factors, sizes_of_torques, level, noise, blur, is_held=True)
    return Balance(rest, pulls, off, of_bounds, lower, moved, astray, length(noise), feigned, of_rows)


def _signs(count: int) -> Array:
    return np.where(np.arange(count) * 7919 % 13 < 6, 1.0, -1.0)
