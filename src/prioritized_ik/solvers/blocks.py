"""What each level asks for in coordinates of its own, and the rows of all inequalities; `hierarchy` puts them together."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.problem import Level, replaced
from prioritized_ik.solvers.closed_form import Spectrum, level_decomposition
from prioritized_ik.solvers.subspaces import Range, divided, pivoted_qr, range_of
from prioritized_ik.tolerances import DEPENDENT, EPS, PROJECTION, UNSURE
from prioritized_ik.validation import Array, length, lengths, size

HARD = -1  # the level of hard rows


@dataclass(frozen=True)
class Shortfall:
    """What a level still lacks at a step, in the coordinates of what it feels.

    Attributes:
        felt: the level's range within the directions left to it.
        gradient: `(r,)`.
        terms: sizes of the terms of which that is the difference `(r,)`, for their rounding.
        strength: what a step of unit length can do to the level at most.
        leak: what rounding lets through of the gradient that levels above absorb is a rounding of this.
    """

    felt: Range
    gradient: Array
    terms: Array
    strength: float
    leak: float


@dataclass(frozen=True)
class EqualBlock:
    """One `equal` level, cut to its rank p: its cost is ‖`matrix` @ u - `target`‖², but for what no step can change.

    Attributes:
        free: orthonormal directions `(m, f)` that the levels above leave.
        felt: V `(m, p)`, orthonormal, the directions that the level decides.
        root: R `(p, p)`, upper triangular: `matrix` @ `felt`.
        inverse: V R⁻¹ `(m, p)`: the shortest steps that change `matrix` @ u by one.
        matrix: `(p, m)`; zero on everything below the level.
        whitening: Qᵀ W^½ `(p, k)`, from the level's rows to its own coordinates.
        below: orthonormal directions `(m, f - p)` left to the levels below.
        settled: what less of a direction is left by this level and those above is rounding, see `Hierarchy.settled`.
        blur: how far rounding may have turned the directions below, by this level alone: the more the weaker it is.
        spectrum: the singular values, and where they were cut.
        target: c `(p,)`.
        level: whose block it is, in the joint metric.
    """

    free: Array
    felt: Array
    root: Array
    inverse: Array
    matrix: Array
    whitening: Array
    below: Array
    settled: float
    blur: float
    spectrum: Spectrum
    target: Array
    level: Level

    is_soft: ClassVar[bool] = False

    @cached_property
    def demand(self) -> float:
        """Length of W^½ b, out of reach or not."""
        return self.level.demand

    @property
    def weakest(self) -> float:
        """The least singular value that counts; infinite if there is none."""
        return self.spectrum.weakest

    def aimed(self, target: Array) -> "EqualBlock":
        """Return the block with another right-hand side b `(k,)`; the factors stay."""
        return replaced(self, target=self.whitening @ target, level=replaced(self.level, target=target))

    def missing(self, u: Array) -> Array:
        """Return c - N u `(p,)`: what the step still lacks of what the level can reach."""
        return self.target - self.matrix @ u

    @cached_property
    def _range(self) -> Range:
        return Range(self.inverse, self.below, None)

    def within(self, free: Array) -> Range:
        """Return what the level feels within `free`, some or all of the directions that the levels above leave."""
        if free is self.free:
            return self._range
        return range_of(self.felt, self.root, free, max(self.settled, DEPENDENT))

    def wanted(
        self, rows: "PooledRows", upper: Array, active: NDArray[np.bool_], u: Array, free: Array
    ) -> tuple[Range, Array]:
        """Return the level's range within `free`, and the move in it `(r,)` that is its optimum from `u`."""
        felt = self.within(free)
        return felt, felt.project(self.missing(u))

    def shortfall(self, rows: "PooledRows", slack: Array, exceeded: NDArray[np.bool_], u: Array, free: Array) -> Shortfall:
        """Return what the level lacks at `u`."""
        felt, level = self.within(free), self.level
        # A weak direction is a difference of strong rows.
        terms = np.abs(self.whitening) @ (np.abs(level.target) + np.abs(level.matrix) @ np.abs(u))
        strength = size(self.root)
        return Shortfall(felt, -felt.project(self.missing(u)), felt.project_sizes(terms), strength, 0.0)


@dataclass(frozen=True)
class SoftBlock:
    """One level of soft inequalities: its rows are among the pooled ones, and it counts those that are exceeded.

    Attributes:
        number: of the level.
        below: orthonormal directions that the levels above leave, as there is no telling yet which it feels.
        demand: length of W^½ b.
    """

    number: int
    below: Array
    demand: float

    is_soft: ClassVar[bool] = True
    weakest: ClassVar[float] = np.inf  # a soft level decides nothing for good

    def wanted(
        self, rows: "PooledRows", upper: Array, active: NDArray[np.bool_], u: Array, free: Array
    ) -> tuple[Range, Array]:
        """Return the range of the level's active rows within `free`, and the move in it `(r,)` to their least squares."""
        own = active & (rows.level == self.number)
        felt = rows.within(own, free)
        return felt, felt.project(rows.strengths[own] * (upper[own] - rows.matrix[own] @ u))

    def shortfall(self, rows: "PooledRows", slack: Array, exceeded: NDArray[np.bool_], u: Array, free: Array) -> Shortfall:
        """Return what the level's exceeded rows lack at `u`."""
        own = exceeded & (rows.level == self.number)
        felt = rows.within(own, free)
        excess = -rows.strengths[own] * slack[own]
        terms = rows.strengths[own] * (np.abs(rows.upper[own]) + np.abs(rows.matrix[own]) @ np.abs(u))
        leak = (1 + self.number) * float(np.linalg.norm(rows.strengths[own] * excess))
        strength = length(rows.strengths[own])
        return Shortfall(felt, felt.project(excess), felt.project_sizes(terms), strength, leak)


Block = EqualBlock | SoftBlock


@dataclass(frozen=True)
class PooledRows:
    """Every inequality of a problem, hard ones first, then the rows of soft levels in order; each of unit length.

    A row's excess and slack are therefore distances in the joint metric.

    Attributes:
        matrix: `(r, m)`, without what is too little of a row to count as a direction.
        drift: `(r, m)`, that little.
        whole: `(r, m)`, both together: the rows as they are.
        upper: `(r,)`.
        level: number of the soft level that a row belongs to `(r,)`; `HARD` for hard rows.
        strengths: √w times the row's length before `(r,)`; of no meaning for hard rows.
        names: `(r,)`.
        given: the rows as they are given `(r, m)`, of any length.
        little: of `equal` levels, by number, the rows of which what they leave is too little to count.
    """

    matrix: Array
    drift: Array
    whole: Array
    upper: Array
    level: NDArray[np.int_]
    strengths: Array
    names: tuple[str, ...]
    given: Array
    little: tuple[tuple[int, NDArray[np.int_]], ...]

    def bounds_among(self, numbers: NDArray[np.int_]) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
        """Return which of the rows of such `numbers` bound one joint, `(b,)`, and the numbers of the joints `(b,)`."""
        some = (self.level[numbers] == HARD) & (np.count_nonzero(self.matrix[numbers], axis=1) == 1)
        bounds = numbers[some]
        return bounds, np.abs(self.matrix[bounds]).argmax(axis=1) if len(bounds) else bounds

    def slack(self, u: Array) -> Array:
        """Return how far `u` is from each row `(r,)`; negative where it is exceeded."""
        return self.upper - self.whole @ u

    def reach(self, numbers: NDArray[np.int_], free: Array) -> Array:
        """Return how far rows move along the `free` directions at most, by number, as a fraction of their length."""
        if free.shape[1] == len(free):  # every direction
            return np.ones(len(numbers))
        return lengths(self.matrix[numbers] @ free)

    def within(self, chosen: NDArray[np.bool_], free: Array) -> Range:
        """Return what the `chosen` rows feel within `free`."""
        return range_of(self.matrix[chosen].T, np.diag(self.strengths[chosen]), free)


def equal_block(level: Level, free: Array, rank_tolerance: float, settled: float, noise: float) -> EqualBlock:
    """Return an `equal` level's block within orthonormal `free` directions `(m, f)`.

    Args:
        level: in the joint metric, without rows that are rounding.
        free: what the levels above leave.
        rank_tolerance: see `closed_form.level_decomposition`.
        settled: what less of a direction is left by the levels above is rounding.
        noise: of rows of unit length.
    """
    # What is settled by rounding alone, not by the rank tolerance, is all that may be cut by the rule of rounding.
    unsure = noise if rank_tolerance else max(noise, settled)
    factors, unfelt, spectrum = level_decomposition(level, free, rank_tolerance, unsure)
    weights = np.sqrt(level.weights)
    q, root, order = pivoted_qr(weights[:, None] * factors.j_a)
    felt = free @ factors.j_b[order].T
    whitening = q.T * weights  # Qᵀ W^½
    matrix = root @ felt.T
    if free.shape[1] < len(free):  # what the levels above decide moves this one too
        whole = whitening @ level.matrix
        matrix = matrix + without(whole, free)
    blur = min(PROJECTION * EPS / spectrum.weakest, UNSURE)
    return EqualBlock(
        free,
        felt,
        root,
        divided(felt, root),
        matrix,
        whitening,
        free @ unfelt,
        max(settled, blur),
        blur,
        spectrum,
        whitening @ level.target,
        level,
    )


def without(matrix: Array, directions: Array) -> Array:
    """Return `matrix` `(k, m)` with nothing felt along orthonormal `directions` `(m, f)`."""
    return matrix - (matrix @ directions) @ directions.T
