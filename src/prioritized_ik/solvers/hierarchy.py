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
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.double_double import DoubleDouble
from prioritized_ik.problem import IKProblem, Level, replaced, trusted_level
from prioritized_ik.solvers.blocks import HARD, Block, EqualBlock, PooledRows, SoftBlock, equal_block, without
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.decided import Decided, Decision
from prioritized_ik.solvers.subspaces import Range
from prioritized_ik.tolerances import (
    AMPLE,
    DEPENDENT,
    EPS,
    FEASIBLE,
    FLOOR,
    SETTLED_PER_RANK_TOLERANCE,
)
from prioritized_ik.validation import Array, distinct, identity, length, lengths, ones, tolerance_above_rounding


@dataclass(frozen=True)
class Kept:
    """What equalities and frozen joints keep.

    Attributes:
        start: the shortest step `(m,)` that keeps them, as far as they can be kept.
        free: orthonormal directions `(m, f)` that they leave.
        matrix: the rows `(e, m)`, of any length.
        answer: the steps `(m, e)` that answer what the rows lack.
        weakest: the least singular value that counts, of rows of unit length; infinite if there are none.
    """

    start: Array
    free: Array
    matrix: Array
    answer: Array
    weakest: float


class Hierarchy:
    """A problem and its levels' blocks, in the problem's joint metric.

    Attributes:
        problem: the problem in its metric, without what is rounding.
        rank_tolerance: what weak directions of a level count as none, see `closed_form.level_decomposition`; 0: only
            rounding.
        is_rounded: whether rows are not those that the user gave, but divided by the root of a metric.
        zeros: names of rows that were left out as rounding.
        kept: what equalities and frozen joints keep, with the `start` and the `free` directions of every solve.
        blocks: one a level.
        rest: orthonormal directions `(m, f)` that no `equal` level feels: they are the reference's.
        settled: a row that moves by less than this fraction of its length along every direction left is settled by the
            levels above: to divide it by its norm would turn rounding into a constraint.
    """

    def __init__(self, problem: IKProblem, rank_tolerance: float = 0.0) -> None:
        if rank_tolerance:
            tolerance_above_rounding("rank_tolerance", rank_tolerance)
        self._given = problem.in_metric
        self.is_rounded = self._given is not problem
        self.problem, self.zeros, self._row_numbers = _without_rounding(self._given)
        self.rank_tolerance = rank_tolerance
        self.kept = _kept(self.problem)
        self.start, self.free = self.kept.start, self.kept.free
        self.blocks: list[Block] = []
        self.rest = self.free
        self.settled = max(problem.noise, SETTLED_PER_RANK_TOLERANCE * rank_tolerance)
        # By no level, by the first, by the first two, …
        self._settled, self._weakest = [self.settled], [self.kept.weakest]
        for number, level in enumerate(self.problem.levels):
            block: Block
            if level.is_soft:
                block = SoftBlock(number, self.rest, level.demand)
            else:
                block = equal_block(level, self.rest, rank_tolerance, self.settled, problem.noise)
                self.settled = block.settled
            self.blocks.append(block)
            self._settled.append(self.settled)
            self._weakest.append(min(self._weakest[-1], block.weakest))
            self.rest = block.below

    def is_cut(self, number: int) -> bool:
        """Whether the rank tolerance cut more than zeros of a level, by number, which is then not solved as it is given."""
        block = self.blocks[number] if number < len(self.blocks) else None
        return bool(self.rank_tolerance) and isinstance(block, EqualBlock) and not block.spectrum.is_clear

    @cached_property
    def decided(self) -> Decided:
        """What equalities and frozen joints decide, then what each level does: nothing if it is soft."""
        kept = self.kept
        decisions = [Decision(kept.matrix, lambda: kept.answer, kept.weakest, self.is_rounded)]
        for number, (level, block) in enumerate(zip(self.problem.levels, self.blocks, strict=True)):
            if not isinstance(block, EqualBlock) or not block.spectrum.rank:
                none = level.matrix[:0]
                decisions.append(Decision(none, partial(np.transpose, none), np.inf, is_rounded=False))
                continue
            is_cut = self.is_cut(number)
            answered = partial(_answer_without_weights, level, block) if is_cut else partial(_answer, block)
            decisions.append(Decision(level.matrix, answered, block.spectrum.weakest, self.is_rounded or is_cut))
        return Decided(tuple(decisions))

    @cached_property
    def last_level(self) -> Level:
        """The implicit one."""
        m = self.problem.joint_count
        return trusted_level(identity(m), self.problem.reference, ones(m), "last level")

    @cached_property
    def _range_of_rest(self) -> Range:
        return Range(self.rest, self.rest[:, :0], None)

    def last_range(self, free: Array) -> Range:
        """Return what the last level feels: all of `free`, the directions `(m, f)` that are left to it."""
        return self._range_of_rest if free is self.rest else Range(free, free[:, :0], None)

    @cached_property
    def exact_directions(self) -> dict[int, DoubleDouble]:
        """Directions of levels, by number, that proofs have worked out with twice the digits of doubles."""
        return {}

    @cached_property
    def exact_rows(self) -> DoubleDouble:
        """What `rows.matrix` is before rows are rounded to unit length `(r, m)`.

        A level that hardly feels what a row leaves makes much of half a unit in the last place of a row that it pushes.
        """
        exact = DoubleDouble.of(self.rows.given)
        for number, little in self.rows.little:
            block = self.blocks[number]
            own = exact[little]
            less = self.decided.less(own, lengths(own.high), np.eye(len(little)), block.below, 2 + number)
            exact = exact.replaced(little, less)
        return exact

    @cached_property
    def impossible(self) -> tuple[str, ...]:
        """Names of hard rows that are rounding, so that no step moves them, but whose sides are beyond what is kept."""
        given = self._given
        if given.real_rows.all() and not len(given.equalities.target):
            return ()
        return impossible_rows(given, FEASIBLE * given.longest_row * self.length)

    def settled_by(self, number: int) -> float:
        """What less of a row is left by the levels up to a number is rounding; a weak level below settles nothing above."""
        return self._settled[min(number + 1, len(self.blocks))]

    def turned_as_given(self, number: int) -> float:
        """How far half a unit in the last place of what is given turns the directions that levels up to a number leave."""
        return 0.5 * EPS / self._weakest[min(number + 1, len(self.blocks))]

    def least(self, directions: int, number: int) -> float:
        """What a combination of rows moves at least along so many directions where it is not settled up to a level.

        Rounding is of every entry; what a rank tolerance settles is of a row as a whole.
        """
        settled = self.settled_by(number)
        return settled if self.rank_tolerance else settled * math.sqrt(directions)

    def scale(self, u: Array) -> float:
        """Return what relative figures of a step count against: ‖u‖, at least `FLOOR` of what the levels ask for."""
        return max(length(u), FLOOR * self.length / AMPLE) or 1.0

    @cached_property
    def rows(self) -> PooledRows:
        """Every inequality of the problem. Rows that a level settles are cut to it."""
        hard = self.problem.inequalities
        matrices, uppers, names = [hard.matrix], [hard.upper], hard.names
        numbers, roots, sizes = [np.full(len(hard.upper), HARD)], [ones(len(hard.upper))], [self.problem.row_lengths]
        soft_names = iter(distinct(level.name for level in self.problem.levels if level.is_soft))
        for number, (level, rows) in enumerate(zip(self.problem.levels, self._row_numbers, strict=True)):
            if level.is_soft:
                matrices.append(level.matrix)
                uppers.append(level.target)
                called = next(soft_names)
                names += tuple([f"{called} row {i + 1}" for i in rows])
                numbers.append(np.full(len(level.target), number))
                roots.append(np.sqrt(level.weights))
                sizes.append(level.row_lengths)
        given, long = np.concatenate(matrices), np.concatenate(sizes)
        whole = given / long[:, None]
        matrix, drift = whole.copy(), np.zeros(whole.shape)
        few: list[tuple[int, NDArray[np.int_]]] = []
        for number, block in enumerate(self.blocks):
            if isinstance(block, EqualBlock):
                moved = matrix @ block.below
                little = (lengths(moved) <= block.settled).nonzero()[0]
                if len(little):
                    left = moved[little] @ block.below.T
                    drift[little] += left
                    matrix[little] -= left
                    few.append((number, little))
        return PooledRows(
            matrix,
            drift,
            whole,
            np.concatenate(uppers) / long,
            np.concatenate(numbers),
            np.concatenate(roots) * long,
            names,
            given,
            tuple(few),
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
                least.append(block.demand / level.strength if level.strength > 0.0 else 0.0)
        return max(least)

    @cached_property
    def cut_problem(self) -> IKProblem:
        """The problem in its metric, `equal` levels cut to their rank, for solvers that know no rank tolerance."""
        levels = (
            level if isinstance(block, SoftBlock) else replaced(level, matrix=without(level.matrix, block.below))
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


def _answer(block: EqualBlock) -> Array:
    """Return the steps `(m, k)` that answer what a level's rows lack."""
    return block.inverse @ block.whitening


def _answer_without_weights(level: Level, block: EqualBlock) -> Array:
    """Return the same of a level that is cut: what is cut is orthogonal to the rest without weights."""
    return np.asarray(block.felt @ np.linalg.pinv(level.matrix @ block.felt))


def strict_solution(levels: Sequence[Level], reference: Array, rank_tolerance: float = RANK_TOLERANCE) -> Array:
    """Return the joint step `(m,)` of all levels in strict order, then the nearest to `reference`, without inequalities.

    Each level is solved by Eqs. (12) and (14) in the directions that the levels before it leave free. With one level it
    is Eqs. (12) and (13). The rank is cut as in all that reproduces the paper, unless told otherwise.
    """
    return Hierarchy(IKProblem(levels, reference=reference), rank_tolerance).closed_form


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
        sizes = level.row_lengths
        real = sizes > zero
        if not real.all():
            zeros += [f"{level.name} row {i + 1}" for i in np.flatnonzero((0.0 < sizes) & ~real)]
        kept = real & (level.weights > 0.0) & np.isfinite(level.target)
        numbers.append(kept.nonzero()[0])
        if level.damping:
            matrix = np.vstack([level.matrix[kept], np.sqrt(level.damping) * np.eye(m)])
            target, weights = np.append(level.target[kept], np.zeros(m)), np.append(level.weights[kept], np.ones(m))
            level = replaced(level, matrix=matrix, target=target, weights=weights, damping=0.0)
        elif not kept.all():
            level = replaced(level, matrix=level.matrix[kept], target=level.target[kept], weights=level.weights[kept])
        levels.append(level)
    finite, fixed = np.isfinite(problem.rows.upper), problem.equality_lengths > zero
    if problem.real_rows.all() and finite.all() and fixed.all():
        is_same = all([one is other for one, other in zip(levels, problem.levels, strict=True)])
        return problem if is_same else problem.with_levels(levels), tuple(zeros), numbers
    hard = problem.inequalities
    of_rows = slice(len(hard.upper) - np.count_nonzero(finite), None)
    some = finite
    some[some] = problem.real_rows[of_rows]
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


def _kept(problem: IKProblem) -> Kept:
    """Return what equalities and frozen joints keep.

    Rows that say the same to within `DEPENDENT` are kept in the sense of least squares.
    """
    m, bounds, equalities = problem.joint_count, problem.bounds, problem.equalities
    frozen, unit = (bounds.lower == bounds.upper).nonzero()[0], identity(m)
    if not len(frozen) and not len(equalities.target):
        return Kept(np.zeros(m), unit, equalities.matrix, equalities.matrix.T, np.inf)
    given = np.vstack([unit[frozen], equalities.matrix])
    sizes = lengths(given)
    target = np.concatenate([bounds.lower[frozen], equalities.target])
    u, s, vt = np.linalg.svd(given / sizes[:, None], full_matrices=True)
    p = int(np.count_nonzero(s > max(DEPENDENT, problem.noise) * s[0]))
    answer = vt[:p].T @ (u[:, :p].T / s[:p, None]) / sizes
    start = answer @ target
    start[frozen] = bounds.lower[frozen]
    return Kept(start, vt[p:].T.copy(), given, answer, float(s[p - 1]))
