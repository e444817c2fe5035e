"""The levels of a problem in coordinates of their own, which is at once their strict closed form.

Everything here is in the problem's joint metric: u = L dθ with LᵀL = M, so that lengths mean something. Each `equal` level
is cut to its rank in the directions that equalities and the `equal` levels above leave free, once and for all:
W^½ A free = Q R Vᵀ. It then asks for R Vᵀu = c, with orthonormal directions V that no level above feels. Levels stacked so
are block triangular (Hanafusa; Nakamura): from the top down, each is met in its own block and disturbs none above.
Inequalities do not take part in the cut, so that every solver, the closed form, the active set and the certificate share
one and the same problem. Soft levels (`at_most`) have no block of their own directions: they are rows.

What is rounding is left out before: rows no longer than `IKProblem.zero_length`, rows without weight, infinite sides.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.problem import IKProblem, Level, replaced
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE, Spectrum, level_decomposition
from prioritized_ik.solvers.subspaces import Range, divided, pivoted_qr, range_of
from prioritized_ik.tolerances import AMPLE, DEPENDENT, EPS, FEASIBLE, FLOOR, PROJECTION, SETTLED_PER_RANK_TOLERANCE, UNSURE
from prioritized_ik.validation import Array, distinct, length, lengths, tolerance_above_rounding

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
        terms: sizes of the terms that make up the target `(p,)`.
        spread: sizes of the terms that make up the matrix `(p, m)`: a weak direction is a difference of strong rows.
        demand: length of W^½ b, out of reach or not.
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
    terms: Array
    spread: Array
    demand: float

    is_soft: ClassVar[bool] = False

    def aimed(self, target: Array, weights: Array) -> "EqualBlock":
        """Return the block with another right-hand side b `(k,)`; the factors stay."""
        terms = np.abs(self.whitening) @ np.abs(target)
        return replaced(self, target=self.whitening @ target, terms=terms, demand=length(np.sqrt(weights) * target))

    def missing(self, u: Array) -> Array:
        """Return c - N u `(p,)`: what the step still lacks of what the level can reach."""
        return self.target - self.matrix @ u

    def within(self, free: Array) -> Range:
        """Return what the level feels within `free`, some or all of the directions that the levels above leave."""
        if free is self.free:
            return Range(self.inverse, self.below, None)
        return range_of(self.felt, self.root, free, max(self.settled, DEPENDENT))

    def wanted(
        self, rows: "PooledRows", upper: Array, active: NDArray[np.bool_], u: Array, free: Array
    ) -> tuple[Range, Array]:
        """Return the level's range within `free`, and the move in it `(r,)` that is its optimum from `u`."""
        felt = self.within(free)
        return felt, felt.project(self.missing(u))

    def shortfall(self, rows: "PooledRows", slack: Array, exceeded: NDArray[np.bool_], u: Array, free: Array) -> Shortfall:
        """Return what the level lacks at `u`."""
        felt = self.within(free)
        terms = self.terms + self.spread @ np.abs(u)
        strength = float(np.linalg.norm(self.root))
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
        drift: `(r, m)`, that little; the rows are `matrix` + `drift`.
        upper: `(r,)`.
        level: number of the soft level that a row belongs to `(r,)`; `HARD` for hard rows.
        strengths: √w times the row's length before `(r,)`; of no meaning for hard rows.
        names: `(r,)`.
    """

    matrix: Array
    drift: Array
    upper: Array
    level: NDArray[np.int_]
    strengths: Array
    names: tuple[str, ...]

    @cached_property
    def joint(self) -> NDArray[np.int_]:
        """By row the number of the joint that it bounds `(r,)`; negative for rows of soft levels and of several joints."""
        bounds = (self.level == HARD) & (np.count_nonzero(self.matrix, axis=1) == 1)
        return np.where(bounds, np.abs(self.matrix).argmax(axis=1), -1)

    def slack(self, u: Array) -> Array:
        """Return how far `u` is from each row `(r,)`; negative where it is exceeded."""
        return self.upper - self.matrix @ u - self.drift @ u

    def reach(self, numbers: NDArray[np.int_], free: Array) -> Array:
        """Return how far rows move along the `free` directions at most, by number, as a fraction of their length."""
        if free.shape[1] == len(free):  # every direction
            return np.ones(len(numbers))
        return lengths(self.matrix[numbers] @ free)

    def within(self, chosen: NDArray[np.bool_], free: Array) -> Range:
        """Return what the `chosen` rows feel within `free`."""
        return range_of(self.matrix[chosen].T, np.diag(self.strengths[chosen]), free)


class Hierarchy:
    """A problem and its levels' blocks, in the problem's joint metric.

    Attributes:
        problem: the problem in its metric, without what is rounding.
        rank_tolerance: what weak directions of a level count as none, see `closed_form.level_decomposition`; 0: only
            rounding.
        zeros: names of rows that were left out as rounding.
        start: the shortest step `(m,)` that keeps equalities and frozen joints, as far as they can be kept.
        free: orthonormal directions `(m, f)` that these leave.
        blocks: one a level.
        rest: orthonormal directions `(m, f)` that no `equal` level feels: they are the reference's.
        settled: a row that moves by less than this fraction of its length along every direction left is settled by the
            levels above: to divide it by its norm would turn rounding into a constraint.
    """

    def __init__(self, problem: IKProblem, rank_tolerance: float = 0.0) -> None:
        if rank_tolerance:
            tolerance_above_rounding("rank_tolerance", rank_tolerance)
        self._given = problem.in_metric
        self.problem, self.zeros, self._row_numbers = _without_rounding(self._given)
        self.rank_tolerance = rank_tolerance
        self.start, self.free = _kept(self.problem)
        self.blocks: list[Block] = []
        self.rest = self.free
        self.settled = max(problem.noise, SETTLED_PER_RANK_TOLERANCE * rank_tolerance)
        for number, level in enumerate(self.problem.levels):
            block: Block
            if level.is_soft:
                block = SoftBlock(number, self.rest, level.demand)
            else:
                block = _equal_block(level, self.rest, rank_tolerance, self.settled, problem.noise)
                self.settled = block.settled
            self.blocks.append(block)
            self.rest = block.below

    @cached_property
    def impossible(self) -> tuple[str, ...]:
        """Names of hard rows that are rounding, so that no step moves them, but whose sides are beyond what is kept."""
        return impossible_rows(self._given, FEASIBLE * self._given.longest_row * self.length)

    def least(self, directions: int) -> float:
        """What a combination of rows moves at least along so many directions where it is not settled.

        Rounding is of every entry; what a rank tolerance settles is of a row as a whole.
        """
        return self.settled if self.rank_tolerance else self.settled * math.sqrt(directions)

    def scale(self, u: Array) -> float:
        """Return what relative figures of a step count against: ‖u‖, at least `FLOOR` of what the levels ask for."""
        return max(length(u), FLOOR * self.length / AMPLE) or 1.0

    @cached_property
    def rows(self) -> PooledRows:
        """Every inequality of the problem. Rows that a level settles are cut to it."""
        hard = self.problem.inequalities
        matrices, uppers, names = [hard.matrix], [hard.upper], list(hard.names)
        numbers, roots = [np.full(len(hard.upper), HARD)], [np.ones(len(hard.upper))]
        soft_names = iter(distinct(level.name for level in self.problem.levels if level.is_soft))
        for number, (level, rows) in enumerate(zip(self.problem.levels, self._row_numbers, strict=True)):
            if level.is_soft:
                matrices.append(level.matrix)
                uppers.append(level.target)
                called = next(soft_names)
                names += [f"{called} row {i + 1}" for i in rows]
                numbers.append(np.full(len(level.target), number))
                roots.append(np.sqrt(level.weights))
        matrix = np.vstack(matrices)
        sizes = lengths(matrix)
        unit = matrix / sizes[:, None]
        drift = np.zeros_like(unit)
        for block in self.blocks:
            if isinstance(block, EqualBlock):
                moved = unit @ block.below
                little = lengths(moved) <= block.settled
                if little.any():
                    drift[little] += moved[little] @ block.below.T
                    unit[little] -= moved[little] @ block.below.T
        return PooledRows(
            unit,
            drift,
            np.concatenate(uppers) / sizes,
            np.concatenate(numbers),
            np.concatenate(roots) * sizes,
            tuple(names),
        )

    @cached_property
    def length(self) -> float:
        """What the step may measure, with room: the closed form or the way out of broken rows; the median slack if less."""
        slack = self.rows.slack(self.start)
        likely = max(length(self.closed_form), self._asked, float(-slack.min(initial=0.0)))
        slack = np.sort(slack[slack > 0.0])
        return AMPLE * (min(likely, float(slack[len(slack) // 2])) if len(slack) else likely) or 1.0

    @property
    def _asked(self) -> float:
        """The shortest step that could give any `equal` level what it asks for, were all its rows along it.

        Robots at rest, whose targets are out of reach, take none; but rounding of what is asked for is no shorter.
        """
        least = [0.0]
        for level, block in zip(self.problem.levels, self.blocks, strict=True):
            if isinstance(block, EqualBlock) and block.demand > 0.0:
                strength = length(np.sqrt(level.weights) * lengths(level.matrix))
                least.append(block.demand / strength if strength > 0.0 else 0.0)
        return max(least)

    @cached_property
    def cut_problem(self) -> IKProblem:
        """The problem in its metric, `equal` levels cut to their rank, for solvers that know no rank tolerance."""
        levels = (
            level if isinstance(block, SoftBlock) else replaced(level, matrix=_without(level.matrix, block.below))
            for level, block in zip(self.problem.levels, self.blocks, strict=True)
        )
        return self.problem.with_levels(tuple(levels))

    @cached_property
    def closed_form(self) -> Array:
        """The step `(m,)` of all `equal` levels in strict order, then nearest to the reference, without inequalities."""
        u = self.start
        for block in self.blocks:
            if isinstance(block, EqualBlock):
                u = u + block.inverse @ block.missing(u)
        return u + self.rest @ (self.rest.T @ (self.problem.reference - u))


def strict_solution(levels: Sequence[Level], reference: Array, rank_tolerance: float = RANK_TOLERANCE) -> Array:
    """Return the joint step `(m,)` of all levels in strict order, then the nearest to `reference`, without inequalities.

    Each level is solved by Eqs. (12) and (14) in the directions that the levels before it leave free. With one level it
    is Eqs. (12) and (13). The rank is cut as in all that reproduces the paper, unless told otherwise.
    """
    return Hierarchy(IKProblem(levels, reference=reference), rank_tolerance).closed_form


def _without(matrix: Array, directions: Array) -> Array:
    """Return `matrix` `(k, m)` with nothing felt along orthonormal `directions` `(m, f)`."""
    return matrix - (matrix @ directions) @ directions.T


def impossible_rows(problem: IKProblem, allowed: float) -> tuple[str, ...]:
    """Return the names of hard rows of a problem in its metric that are rounding, and broken by more than `allowed`."""
    zero, hard, fixed = problem.zero_length, problem.inequalities, problem.equalities
    broken = [hard.names[i] for i in np.flatnonzero(~problem.real_rows & (hard.upper < -allowed))]
    sides = zip(fixed.names, problem.equality_lengths, fixed.target, strict=True)
    return (*broken, *(name for name, size, side in sides if size <= zero and abs(side) > allowed))


def _without_rounding(problem: IKProblem) -> tuple[IKProblem, tuple[str, ...], list[NDArray[np.int_]]]:
    """Return a problem without rows that mean nothing, the names of those that are rounding, and each level's rows left.

    Damping becomes rows of the level, √δ u = 0.
    """
    zero, m = problem.zero_length, problem.joint_count
    zeros: list[str] = []
    levels, numbers = [], []
    for level in problem.levels:
        sizes = lengths(level.matrix)
        zeros += [f"{level.name} row {i + 1}" for i in np.flatnonzero((0.0 < sizes) & (sizes <= zero))]
        kept = (sizes > zero) & (level.weights > 0.0) & np.isfinite(level.target)
        numbers.append(np.flatnonzero(kept))
        if level.damping:
            matrix = np.vstack([level.matrix[kept], np.sqrt(level.damping) * np.eye(m)])
            target, weights = np.append(level.target[kept], np.zeros(m)), np.append(level.weights[kept], np.ones(m))
            level = replaced(level, matrix=matrix, target=target, weights=weights, damping=0.0)
        elif not kept.all():
            level = replaced(level, matrix=level.matrix[kept], target=level.target[kept], weights=level.weights[kept])
        levels.append(level)
    hard = problem.inequalities
    of_rows = slice(len(hard.upper) - int(np.isfinite(problem.rows.upper).sum()), None)
    some = np.isfinite(problem.rows.upper)
    some[some] = problem.real_rows[of_rows]
    fixed = problem.equality_lengths > zero
    little = ~problem.real_rows & (problem.row_lengths > 0.0)
    zeros += [hard.names[i] for i in np.flatnonzero(little)]
    zeros += [
        name for name, size in zip(problem.equalities.names, problem.equality_lengths, strict=True) if 0.0 < size <= zero
    ]
    rows, equalities = problem.rows, problem.equalities
    if not some.all():
        names = tuple(name for name, keep in zip(rows.names, some, strict=True) if keep)
        rows = replaced(rows, matrix=rows.matrix[some], upper=rows.upper[some], names=names)
    if not fixed.all():
        names = tuple(name for name, keep in zip(equalities.names, fixed, strict=True) if keep)
        equalities = replaced(equalities, matrix=equalities.matrix[fixed], target=equalities.target[fixed], names=names)
    return replaced(problem, levels=tuple(levels), rows=rows, equalities=equalities), tuple(zeros), numbers


def _equal_block(level: Level, free: Array, rank_tolerance: float, settled: float, noise: float) -> EqualBlock:
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
        matrix = matrix + _without(whole, free)
    blur = min(PROJECTION * EPS / float(spectrum.kept[-1]), UNSURE) if len(spectrum.kept) else 0.0
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
        np.abs(whitening) @ np.abs(level.target),
        np.abs(whitening) @ np.abs(level.matrix),
        level.demand,
    )


def _kept(problem: IKProblem) -> tuple[Array, Array]:
    """Return the shortest step that keeps equalities and frozen joints, and the directions that they leave free.

    Rows that say the same to within `DEPENDENT` are kept in the sense of least squares.
    """
    m, bounds, equalities = problem.joint_count, problem.bounds, problem.equalities
    frozen = np.flatnonzero(bounds.lower == bounds.upper)
    if not len(frozen) and not len(equalities.target):
        return np.zeros(m), np.eye(m)
    sizes = lengths(equalities.matrix)
    matrix = np.vstack([np.eye(m)[frozen], equalities.matrix / sizes[:, None]])
    target = np.concatenate([bounds.lower[frozen], equalities.target / sizes])
    u, s, vt = np.linalg.svd(matrix, full_matrices=True)
    p = int(np.count_nonzero(s > max(DEPENDENT, problem.noise) * s[0]))
    start = vt[:p].T @ (u[:, :p].T @ target / s[:p])
    start[frozen] = bounds.lower[frozen]
    return start, vt[p:].T.copy()
