"""How far rows balance a level's gradient: the arithmetic of a level's proof, in doubles and with twice their digits.

A level's gradient is put in coordinates in which its cost is ‖·‖². Where rows are nearly parallel, weights far apart or a
level far from what it asks for, doubles do not have the digits that decide; here everything is taken as it is given.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.double_double import DoubleDouble
from prioritized_ik.problem import Level
from prioritized_ik.solvers.subspaces import least_squares, nonnegative_least_squares, pseudoinverse
from prioritized_ik.tolerances import BALANCINGS, DEPENDENT, EPS, FINEST, ROUNDING, TURNS
from prioritized_ik.validation import Array, length, lengths


def farthest(rows: Array, room: Array, basis: Array) -> float:
    """Return how far a step within `basis` `(m, v)` can go that moves `rows` `(t, m)` by anything up to `room` `(t,)`."""
    if not room.any():
        return 0.0
    ways = basis @ pseudoinverse(rows @ basis)
    return float(lengths(ways.T) @ room)


def exact_gradient(level: Level, felt: DoubleDouble, u: Array, *, is_rounded: bool) -> tuple[DoubleDouble, Array]:
    """Return feltᵀ AᵀW(A u - b) `(r,)` with twice the digits of doubles, and a bound on its rounding.

    Where a level's strong rows are far from what they ask for, rounding of the change of coordinates lets a share of that
    through to its weak directions. Here the rows are taken as they are given; if they were rounded once before,
    `is_rounded`, that did so too.
    """
    matrix, (k, m) = DoubleDouble.of(level.matrix), level.matrix.shape
    residual = (matrix @ DoubleDouble.of(u[:, None]) - DoubleDouble.of(level.target[:, None])).times(level.weights[:, None])
    gradient = (felt.T @ (matrix.T @ residual))[:, 0]
    terms = level.weights * (lengths(level.matrix) * length(u) + np.abs(level.target))
    sizes, rows = lengths(felt.high.T), lengths(level.matrix)
    rounding = FINEST * (k + 3 * m) * sizes * float(rows @ terms)
    if is_rounded:
        turned = float(rows @ np.abs(residual.high[:, 0]))
        rounding += 0.5 * EPS * (sizes * turned + level.strength * length(u))
    return gradient, rounding


def exact_basis(level: Level, basis: DoubleDouble, felt: int) -> DoubleDouble:
    """Return a whitened `basis` `(m, v)`, its first `felt` columns as they are, the others as unfelt as digits allow.

    Rounding turns them towards weak directions, where rows with large multipliers would seem to pull for nothing.
    """
    matrix, own, unfelt = DoubleDouble.of(level.matrix), basis[:, :felt], basis[:, felt:]
    for _ in range(TURNS):
        seen = (matrix @ unfelt).times(level.weights[:, None])
        unfelt = unfelt - own @ (own.T @ (matrix.T @ seen))  # not all that is felt at once, which may be wide
    return DoubleDouble(np.hstack([own.high, unfelt.high]), np.hstack([own.low, unfelt.low]))


@dataclass(frozen=True)
class Balance:
    """How far rows can balance a gradient.

    Attributes:
        normals: of the rows, of unit length `(t, v)`.
        sizes: their lengths before `(t,)`.
        multipliers: of the normals `(t,)`, of either sign where a row is held, else not negative.
        rest: what is left `(v,)`.
        rounding: how much of that the rounding of the sum can be `(v,)`.
    """

    normals: Array
    sizes: Array
    multipliers: Array
    rest: Array
    rounding: Array

    @cached_property
    def pulls(self) -> Array:
        """The multipliers of rows of unit length `(t,)`."""
        return self.multipliers / self.sizes

    @cached_property
    def pulled(self) -> float:
        """What rows of unit length pull, together."""
        return float(np.abs(self.pulls).sum())

    def turned(self, off: Array) -> Array:
        """Return the rounding `(v,)` where coordinates can be `off` by so much `(v,)`: their sizes times angles."""
        return self.rounding + off * self.pulled if self.pulled else self.rounding


@dataclass(frozen=True)
class Look:
    """A level's stationarity, in coordinates in which its cost is ‖·‖².

    Attributes:
        balance: how far rows balance the gradient.
        gradient: the level's `(v,)`.
        basis: the coordinates' directions `(m, v)`.
        sizes: their lengths `(v,)`.
        rounding: what rounding can feign of the rest `(v,)`.
        doubtful: how large a multiplier of each row can be that says nothing of a problem of other last digits `(t,)`.
        explained: how long a step that rounding can feign, strong rows in weak directions included.
        blur: how much of the gradient can be rounding of the step itself.
        feigned: how long a step rounding of doubles can feign.
        size: of the terms whose difference the gradient is.
        beyond: the rest beyond its rounding `(v,)`.
        displacement: that, as a step `(m,)`.
        excess: length of the displacement.
    """

    balance: Balance
    gradient: Array
    basis: Array
    sizes: Array
    rounding: Array
    doubtful: Array
    explained: float
    blur: float
    feigned: float
    size: float
    beyond: Array
    displacement: Array
    excess: float

    def falls(self, felt: int, carrying: NDArray[np.bool_], given: float) -> bool:
        """Whether the level's cost falls along what it does not feel, all but the first `felt` coordinates.

        `carrying` rows `(t,)` that hardly move there hold the level only until another one is in the way. What rounding of
        the step, or half a unit in the last place of what is `given`, makes of their multipliers, is none.
        """
        rest = length(self.beyond[felt:])
        if not rest:
            return False
        normals = self.balance.normals
        seen, unseen = lengths(normals[:, :felt]), lengths(normals[:, felt:])
        used = carrying & (seen > 0.0)
        share = float((unseen[used] / seen[used]).max(initial=0.0))
        return bool(used.any()) and rest > self.blur * share + length(self.sizes[felt:]) * given * self.balance.pulled


def balanced(
    rows: Array, basis: Array, gradient: Array, held: NDArray[np.bool_], little: Array, noise: float, blur: Array
) -> Balance:
    """Return how far `rows` `(t, m)` in the coordinates of `basis` `(m, v)` can balance a gradient `(v,)`, in doubles.

    What a row of unit length feels of a coordinate up to `little` `(v,)` is rounding, which could balance anything; and
    what the gradient is off by up to `blur` `(v,)` is not to be balanced.
    """
    cone = rows @ basis
    cone[np.abs(cone) <= little] = 0.0
    normals, sizes = _directed(cone)
    multipliers = _multipliers(normals, sizes, gradient, held)
    if not np.count_nonzero(multipliers):
        return Balance(normals, sizes, multipliers, gradient, np.zeros(len(gradient)))
    balance = _of_multipliers(normals, sizes, gradient, noise, multipliers)
    large = np.abs(multipliers) > length(blur)
    if np.count_nonzero(large) < np.count_nonzero(multipliers):  # the others balance rounding, if these do without
        alone = least_squares(normals[large].T, -gradient)
        if alone is not None and (held[large] | (alone > 0.0)).all():
            multipliers = np.zeros(len(large))
            multipliers[large] = alone
            fewer = _of_multipliers(normals, sizes, gradient, noise, multipliers)
            if (np.abs(fewer.rest) <= blur + fewer.rounding).all():
                return fewer
    return balance


def _of_multipliers(normals: Array, sizes: Array, gradient: Array, noise: float, multipliers: Array) -> Balance:
    rest = gradient + multipliers @ normals
    return Balance(normals, sizes, multipliers, rest, noise * (np.abs(multipliers) @ np.abs(normals)))


def exactly_balanced(
    rows: DoubleDouble, basis: DoubleDouble, gradient: DoubleDouble, held: NDArray[np.bool_], little: Array
) -> Balance:
    """Return the same with twice the digits of doubles, for rows of any length.

    The combination may need digits that doubles do not have, where rows are nearly parallel or weights far apart: it is
    improved until it has them.
    """
    row_lengths = lengths(rows.high)
    exact = rows @ basis
    exact = exact.where(np.abs(exact.high) > little * row_lengths[:, None])
    normals, sizes = _directed(exact.high)
    found = _multipliers(normals, sizes, gradient.high, held)
    net = DoubleDouble.of(found / sizes)
    improved = _improved(net, exact, gradient, held)
    rest, better = (gradient + (shares[None] @ exact)[0] for shares in (net, improved))
    if length(better.high) <= length(rest.high):
        net, rest = improved, better
    terms = (len(basis.high) + len(rows.high)) * float(np.abs(net.high) @ row_lengths) * lengths(basis.high.T)
    rounding = FINEST * terms + 0.5 * EPS * np.abs(rest.high)
    return Balance(normals, sizes / row_lengths, net.rounded * sizes, rest.rounded, rounding)


def _directed(cone: Array) -> tuple[Array, Array]:
    """Return rows of unit length `(t, v)`, and the lengths `(t,)` that they had; those that are zero stay."""
    sizes = lengths(cone)
    sizes[sizes == 0.0] = 1.0
    return cone / sizes[:, None], sizes


def _multipliers(normals: Array, sizes: Array, gradient: Array, held: NDArray[np.bool_]) -> Array:
    """Return the multipliers `(t,)` of `normals` `(t, v)` that balance a gradient best, of either sign if `held`."""
    if not len(normals) or not np.count_nonzero(gradient):
        return np.zeros(len(normals))
    some_held = np.count_nonzero(held)
    found = least_squares(normals.T, -gradient, some=True)
    if found is not None and (held | (found >= 0.0)).all():
        is_unique = np.count_nonzero(found) == len(found)
        if is_unique or length(gradient + found @ normals) <= ROUNDING * length(gradient):
            return _least(normals, sizes, gradient, held, found) if some_held and not is_unique else found
    both, _ = nonnegative_least_squares((np.concatenate([normals, -normals[held]]) if some_held else normals).T, -gradient)
    multipliers = both[: len(normals)]
    if not some_held:
        return multipliers
    multipliers[held] -= both[len(normals) :]
    return _least(normals, sizes, gradient, held, multipliers)


def _least(normals: Array, sizes: Array, gradient: Array, held: NDArray[np.bool_], found: Array) -> Array:
    """Return, of the multipliers `(t,)` that balance a gradient as well as those `found`, by the same rows, the least.

    Where rows are nearly parallel in what is left, some that hardly move there can stand for one that does, with
    multipliers that magnify every rounding.
    """
    used = (found > 0.0) | held
    least = np.zeros(len(normals))
    cone = normals * sizes[:, None]
    least[used] = -sizes[used] * (gradient @ pseudoinverse(cone[used]))
    if (least[~held] < 0.0).any():
        return found
    before, after = length(gradient + found @ normals), length(gradient + least @ normals)
    return found if after > max(before, ROUNDING * length(gradient)) else least


def _improved(net: DoubleDouble, exact: DoubleDouble, gradient: DoubleDouble, held: NDArray[np.bool_]) -> DoubleDouble:
    """Return multipliers of `exact` rows `(t, v)` that balance a gradient better than `net`, by the same rows or fewer.

    What is rounding in `net` has any sign, and by what it takes from the others as large as it seems: it is left out.
    """
    normals, sizes = _directed(exact.high)
    used = net.high != 0.0
    while True:
        improved = net.where(used)
        for _ in range(BALANCINGS):
            missing = -(gradient + (improved[None] @ exact)[0]).rounded
            change = np.zeros(len(used))
            change[used] = np.linalg.lstsq(normals[used].T, missing, rcond=DEPENDENT)[0] / sizes[used]
            improved = improved + DoubleDouble.of(change)
        wrong = used & ~held & (improved.high < 0.0)
        if not wrong.any():
            return improved
        used &= ~wrong
