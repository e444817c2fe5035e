"""How far rows balance a level's gradient: the arithmetic of a level's proof, in doubles and in extended precision.

A level's gradient is put in coordinates in which its cost is ‖·‖². Where rows are nearly parallel, weights far apart or a
level far from what it asks for, doubles do not have the digits that decide; here everything is taken as it is given.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.problem import Level
from prioritized_ik.solvers.subspaces import Range, nonnegative_least_squares
from prioritized_ik.tolerances import BALANCINGS, DEPENDENT, EPS, HALF_UNIT, ROUNDING, TURNS, UNFELT
from prioritized_ik.validation import Array, length, lengths

Floats = NDArray[np.floating]  # doubles, or in extended precision


def farthest(rows: Array, room: Array, basis: Array) -> float:
    """Return how far a step within `basis` `(m, v)` can go that moves `rows` `(t, m)` by anything up to `room` `(t,)`."""
    if not room.any():
        return 0.0
    ways = basis @ np.linalg.pinv(rows @ basis, rcond=DEPENDENT)
    return float(lengths(ways.T) @ room)


def whitened(range_: Range, *, weakly: bool = False) -> tuple[Array, Array]:
    """Return directions `(m, v)` in which a level's cost is ‖·‖², and their lengths.

    Those it does not feel are there at `UNFELT`, or `weakly`: as little felt as the weakest one that is.
    """
    felt_lengths = lengths(range_.felt.T)
    unfelt = min(felt_lengths, default=1.0) / UNFELT
    if weakly:
        unfelt = max(felt_lengths.max(initial=0.0), unfelt)
    unfelt_lengths = np.full(range_.unfelt.shape[1], unfelt)
    return np.hstack([range_.felt, range_.unfelt * unfelt_lengths]), np.concatenate([felt_lengths, unfelt_lengths])


@dataclass(frozen=True)
class Look:
    """A level's stationarity, in coordinates in which its cost is ‖·‖².

    Attributes:
        balance: how far rows balance the gradient.
        gradient: the level's `(v,)`.
        sizes: lengths of the coordinates' directions `(v,)`.
        rounding: what rounding can feign of the rest `(v,)`.
        beyond: the rest beyond that `(v,)`.
        displacement: as a step `(m,)`.
        explained: how long a step the rounding can feign.
        size: of the terms whose difference the gradient is.
    """

    balance: "Balance"
    gradient: Array
    sizes: Array
    rounding: Array
    beyond: Array
    displacement: Array
    explained: float
    size: float


def exact_gradient(level: Level, felt: Array, u: Array, size: int, blur: Array) -> tuple[Floats, Array]:
    """Return feltᵀ AᵀW(A u - b) `(size,)`, zero beyond what is felt, in extended precision, and a bound on its rounding.

    Where a level's strong rows are far from what they ask for, rounding of the change of coordinates lets a share of that
    through to its weak directions. Here the rows are taken as they are given.
    """
    long = np.longdouble
    (k, m), weights = level.matrix.shape, level.weights
    seen = level.matrix.astype(long) @ felt.astype(long)
    residual = level.matrix.astype(long) @ u.astype(long) - level.target.astype(long)
    gradient = np.zeros(size, long)
    gradient[: felt.shape[1]] = seen.T @ (weights * residual)
    seen_terms, residual_terms = (
        np.abs(level.matrix) @ np.abs(felt),
        np.abs(level.matrix) @ np.abs(u) + np.abs(level.target),
    )
    rounding = (np.abs(seen).T @ (weights * ((m + 1) * residual_terms + (k + 2) * np.abs(residual)))).astype(float)
    rounding += m * (seen_terms.T @ (weights * np.abs(residual))).astype(float)
    blur = blur.copy()
    blur[: felt.shape[1]] = HALF_UNIT * rounding
    return gradient, blur


def exact_basis(level: Level, basis: Array, felt: int) -> Floats:
    """Return a whitened `basis` `(m, v)`, its first `felt` columns as they are, the others as unfelt as digits allow.

    Rounding turns them towards weak directions, where rows with large multipliers would seem to pull for nothing.
    """
    long = np.longdouble
    exact, matrix = basis.astype(long), level.matrix.astype(long)
    seen = matrix @ exact[:, :felt]
    for _ in range(TURNS):
        exact[:, felt:] -= exact[:, :felt] @ (seen.T @ (level.weights[:, None] * (matrix @ exact[:, felt:])))
    return exact


@dataclass
class Decided:
    """What `equal` levels have decided, to see in extended precision how far rounding has turned what they leave.

    Attributes:
        levels: of each, its rows `(k, m)` and the orthonormal directions `(m, p)` that it decides.
        given: how far half a unit in the last place of the rows turns what they leave.
    """

    levels: list[tuple[Array, Array]] = field(default_factory=list)
    given: float = 0.0

    def add(self, matrix: Array, directions: Array, weakest: float) -> None:
        """Count a level, of which the weakest direction is `weakest` relative to its rows."""
        self.levels.append((matrix, directions))
        self.given = max(self.given, 0.5 * EPS / weakest)

    def turn(self, free: Array) -> float:
        """Return how far orthonormal `free` `(m, f)` is from directions that the levels do not feel, as an angle."""
        off = np.zeros(free.shape, np.longdouble)
        for matrix, directions in self.levels:
            seen = (matrix.astype(np.longdouble) @ (free - off)).astype(float)
            off = off + directions @ np.linalg.lstsq(matrix @ directions, seen)[0]
        return self.given + (float(np.linalg.norm(off.astype(float), 2)) if off.size else 0.0)


@dataclass(frozen=True)
class Balance:
    """How far rows can balance a gradient.

    Attributes:
        normals: of the rows, of unit length `(t, v)`.
        sizes: their lengths before `(t,)`.
        combination: of the normals, then of those turned round that may have either sign, not negative.
        rest: what is left `(v,)`.
        rounding: how much of that the rounding of the sum can be `(v,)`.
    """

    normals: Array
    sizes: Array
    combination: Array
    rest: Array
    rounding: Array

    def net(self, held: NDArray[np.bool_]) -> Array:
        """Return the multipliers of the normals `(t,)`, of either sign where a row is `held`."""
        net = self.combination[: len(held)].copy()
        net[held] -= self.combination[len(held) :]
        return net


def _least(cone: Array, gradient: Array, held: NDArray[np.bool_], combination: Array) -> Array:
    """Return, of the combinations that balance a gradient as well by the same rows, the one of the least multipliers.

    Where rows are nearly parallel in what is left, some that hardly move there can stand for one that does, with
    multipliers that magnify every rounding.
    """
    sizes, t = lengths(cone), len(cone)
    used = (combination[:t] > 0.0) | held
    multipliers = np.zeros(t)
    multipliers[used] = np.linalg.lstsq(cone[used].T, -gradient, rcond=DEPENDENT)[0]
    if (multipliers[~held] < 0.0).any():
        return combination
    normals, least = cone / sizes[:, None], sizes * multipliers
    before = gradient + np.vstack([normals, -normals[held]]).T @ combination
    if length(gradient + normals.T @ least) > max(length(before), ROUNDING * length(gradient)):
        return combination
    return np.concatenate([np.maximum(least, 0.0), np.maximum(-least[held], 0.0)])


def balanced(
    rows: Array, basis: Floats, gradient: Floats, held: NDArray[np.bool_], noise: float, *, extended: bool
) -> Balance:
    """Return how far `rows` `(t, m)` in the coordinates of `basis` `(m, v)` can balance a gradient `(v,)`.

    The combination may need digits that doubles do not have, where rows are nearly parallel or weights far apart; in
    `extended` precision it is improved until it has them.
    """
    cone = rows @ basis.astype(float)
    sizes = lengths(cone)
    normals = cone / sizes[:, None]
    signed = np.vstack([normals, -normals[held]])
    combination, rounded = np.zeros(len(signed)), gradient.astype(float)
    if not len(rows) or not rounded.any():
        return Balance(normals, sizes, combination, rounded, np.zeros_like(rounded))
    combination, _ = nonnegative_least_squares(signed.T, -rounded)
    if held.any():
        combination = _least(cone, rounded, held, combination)
    if not extended:
        rest = rounded + signed.T @ combination
        return Balance(normals, sizes, combination, rest, noise * (np.abs(signed).T @ combination))
    long = np.longdouble
    exact = (rows.astype(long) @ basis.astype(long)) / sizes.astype(long)[:, None]
    positive = combination > 0.0
    columns = np.vstack([exact, -exact[held]])[positive].T
    improved = combination[positive].astype(long)
    for _ in range(BALANCINGS):
        missing = -gradient - columns @ improved
        improved = improved + np.linalg.lstsq(signed[positive].T, missing.astype(float))[0]
    if improved.min(initial=0.0) >= 0.0:
        combination[positive] = improved.astype(float)
    else:
        improved = combination[positive].astype(long)
    rest = (gradient + columns @ improved).astype(float)
    terms = len(basis) * (np.abs(rows) @ np.abs(basis)) / sizes[:, None] + (len(improved) + 2) * np.abs(exact)
    sums = np.vstack([terms, terms[held]])[positive].T @ np.abs(improved)
    return Balance(normals, sizes, combination, rest, HALF_UNIT * sums.astype(float) + 0.5 * EPS * np.abs(rest))
