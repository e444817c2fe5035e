"""Proof that a step on a kinematic tree is the lexicographic optimum: the bound of `solvers/certificate.py`, in O(joints).

Multipliers come from the elimination, but what they leave of each level's gradient is worked out anew from the points and
axes as they are given, with products by J and Jᵀ alone: a multiplier that is wrong leaves a rest, wherever it came from.
Only how far the rest could still lower a level's cost, R⁻ᵀ of it, is counted in the elimination's coordinates, which are
orthonormal.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.solvers.certificate import FAR, Certificate
from prioritized_ik.solvers.tree.balance import ROUNDED, finely
from prioritized_ik.solvers.tree.factors import Factors
from prioritized_ik.solvers.tree.posed import PosedOnTree
from prioritized_ik.tolerances import CERTIFIED, GAP, LEAST_DEMAND, MARGIN, NEARLY, NOISE, ROUNDING, UNDECIDED, UNFELT
from prioritized_ik.validation import Array, length

PULLS = 4.0  # [of what rounding leaves]: a multiplier below minus this pulls, and a rest above it is one


@dataclass(frozen=True, eq=False)
class ActiveSet:
    """Which bounds and inequality rows a step rests on.

    Attributes:
        side: of each joint `(m,)`: 1 at its upper bound, -1 at its lower one, 0 if free.
        held: which inequality rows are tight `(c,)`.
    """

    side: NDArray[np.int8]
    held: NDArray[np.bool_]

    @property
    def key(self) -> bytes:
        """What tells it from others."""
        return self.side.tobytes() + self.held.tobytes()

    def without(self, others: "ActiveSet") -> "ActiveSet":
        """Return those that are not among the `others`."""
        return ActiveSet(np.where(others.side != 0, 0, self.side).astype(np.int8), self.held & ~others.held)

    def singly(self) -> "Iterator[ActiveSet]":
        """Yield each by itself."""
        nobody, nothing = np.zeros_like(self.side), np.zeros_like(self.held)
        numbers = np.arange(len(self.side))
        for j in np.flatnonzero(self.side):
            yield ActiveSet(np.where(numbers == j, self.side, nobody), nothing)
        for i in np.flatnonzero(self.held):
            yield ActiveSet(nobody, np.arange(len(self.held)) == i)

    @property
    def count(self) -> int:
        """How many there are."""
        return int(np.count_nonzero(self.side)) + int(np.count_nonzero(self.held))


@dataclass(frozen=True, eq=False)
class TreeLevelProof:
    """One level's optimality; figures as in `solvers.certificate.LevelProof`.

    Attributes:
        gap, demand, excess, rounding, carried: see there.
        bounds: multipliers of the active bounds `(m,)`.
        rows: those of the held inequality rows `(c,)`.
        wrong_bounds, wrong_rows: which of them pull, and so should not be active.
        unclear_bounds, unclear_rows: which pull so little that it may be rounding, or hold a level above by so little.
    """

    gap: float
    demand: float
    excess: float
    rounding: float
    carried: float
    bounds: Array
    rows: Array
    wrong_bounds: NDArray[np.bool_]
    wrong_rows: NDArray[np.bool_]
    unclear_bounds: NDArray[np.bool_]
    unclear_rows: NDArray[np.bool_]

    @property
    def relative_gap(self) -> float:
        """The gap relative to the demand, squared."""
        return self.gap / self.demand**2 if self.gap and self.demand else 0.0

    @property
    def pulls(self) -> bool:
        """Whether an active bound or row holds the level the wrong way round."""
        return bool(self.wrong_bounds.any() or self.wrong_rows.any())

    @property
    def is_unclear(self) -> bool:
        """Whether one may."""
        return bool(self.unclear_bounds.any() or self.unclear_rows.any())


class Digits(Enum):
    """With how many digits a proof is worked out."""

    DOUBLES = 0
    GRADIENTS = 1  # gradients, and what multipliers leave of them, with twice as many; uncertain by the rounding of doubles
    TWICE = 2  # uncertain by as little, too


class TreeProof:
    """The proofs of all levels at a step `u` `(m,)` that rests on `active`, by factors of that face.

    Of those, `sure` ones are known to hold it: the optimum without one of them breaks it. It does so just if the first
    multiplier that the bound or row has, level by level, is positive, however small.

    Attributes:
        active: what the step rests on.
        scale: length that relative figures refer to.
        digits: of what it is worked out with.
        levels: one proof a level, the last level's last; they end with the first that pulls.
    """

    def __init__(
        self,
        posed: PosedOnTree,
        factors: Factors,
        u: Array,
        active: ActiveSet,
        scale: float,
        sure: ActiveSet | None = None,
        *,
        digits: Digits = Digits.DOUBLES,
    ) -> None:
        self.digits = digits
        self._posed, self._factors, self._u, self.active, self.scale = posed, factors, u, active, scale
        m, c = len(u), len(active.held)
        self._frozen = posed.lower == posed.upper
        self._leak_of_bounds, self._leak_of_rows = np.full(m, np.inf), np.full(c, np.inf)
        self._faint_bounds, self._faint_rows = np.zeros(m, dtype=bool), np.zeros(c, dtype=bool)
        self._slack = posed.slack(u)
        self._above = 0.0  # how far rounding can have moved the step at the levels so far
        self._missing = posed.missing(u)
        self._off = np.zeros(m)  # how far the step is off what levels so far would have, as their gradients show
        self._is_held = active.count > 0
        self._sure = (np.zeros(m, dtype=bool), np.zeros(c, dtype=bool)) if sure is None else (sure.side != 0, sure.held)
        self._nothing, self._nobody = (np.zeros(m), np.zeros(c)), (np.zeros(m, dtype=bool), np.zeros(c, dtype=bool))
        self.levels = list(self._prove())

    def _prove(self) -> Iterator[TreeLevelProof]:
        last = len(self._posed.parts)
        for number in range(1, last + 1):
            proof = self._level(number, is_last=number == last)
            yield proof
            if proof.pulls:
                return

    def _level(self, number: int, *, is_last: bool) -> TreeLevelProof:
        posed, factors, u, active = self._posed, self._factors, self._u, self.active
        if is_last:
            given = u - posed.reference
            demand = length(u) + length(posed.reference)
            strength, cost, steepest, sizes = 1.0, length(given), 1.0, np.abs(u) + np.abs(posed.reference)
        else:
            part, given = posed.parts[number], self._missing
            strength, cost = posed.strength(number), length(given[part])
            steepest, sizes = factors.strongest[number] or strength, self._sizes
            demand = max(posed.demand(number), cost, LEAST_DEMAND * strength * self.scale)
            sizes = np.where(posed.level == number, sizes, 0.0)
        found = factors.balance(number, given, sizes, ROUNDED, self._off, is_held=self._is_held)
        if self.digits is not Digits.DOUBLES:
            rest = posed.fine_gradient(number, u, found.pulls)
            found = finely(factors, found, number, rest, self._off, surely=self.digits is Digits.TWICE)
        self._off = found.off
        # Along what a level does not feel its gradient is nothing but rounding: more is a rank gone wrong. So is what its
        # multipliers leave along what levels above decide: more is a multiplier gone wrong.
        unfelt = max(0.0, found.astray - PULLS * found.noise)
        excess = found.moved
        if unfelt:  # how far it goes if it is as flat as `UNFELT` allows
            excess += unfelt / (UNFELT * steepest) ** 2
        gap, loosened = found.lower + 2.0 * unfelt * self.scale, 0.0
        bounds, rows = self._nothing
        wrong_bounds, wrong_rows = unclear_bounds, unclear_rows = self._nobody
        if self._is_held:
            bounds = np.where((active.side == 0) | self._frozen, 0.0, -found.rest * active.side)
            rows = np.where(active.held, found.pulls[posed.parts[0]], 0.0)
            gap += self._slackness(bounds, rows)
            faint = NEARLY * self._faintness(number, found.pulls, given)
            faint_of_rows = faint / posed.lengths[posed.parts[0]]
            wrong_bounds, first_bounds, unclear_bounds = _told(
                bounds, found.of_bounds, faint, self._leak_of_bounds, self._faint_bounds, self._sure[0]
            )
            wrong_rows, first_rows, unclear_rows = _told(
                rows, found.of_rows, faint_of_rows, self._leak_of_rows, self._faint_rows, self._sure[1]
            )
            gap += self._evaded(bounds, rows)
            self._leak_of_bounds[first_bounds] = gap / bounds[first_bounds]
            self._leak_of_rows[first_rows] = gap / rows[first_rows]
            loosened = float(np.abs(self._slack[first_rows]).sum())
        above = self._above
        pulled = float(np.abs(bounds).sum() + np.abs(rows) @ posed.lengths[posed.parts[0]])  # rows follow, too
        carried = 2.0 * (strength * cost + pulled) * above + (strength * above) ** 2
        self._above = max(self._above, found.feigned, loosened)
        rounding = max(found.feigned, loosened)
        told = wrong_bounds, wrong_rows, unclear_bounds, unclear_rows
        return TreeLevelProof(gap, demand, excess, rounding, carried, bounds, rows, *told)

    def _evaded(self, bounds: Array, rows: Array) -> float:
        """Return what the level would gain if all that is sure to hold the step, but pulls here, gave way by all of it."""
        lengths = self._posed.lengths[self._posed.parts[0]]
        pulls = np.where(self._sure[0] & ~np.isfinite(self._leak_of_bounds), np.minimum(bounds, 0.0), 0.0)
        others = np.where(self._sure[1] & ~np.isfinite(self._leak_of_rows), np.minimum(rows, 0.0) * lengths, 0.0)
        return -2.0 * self.scale * float(pulls.sum() + others.sum())

    def _faintness(self, number: int, pulls: Array, given: Array) -> float:
        """Return the largest multiplier, of a row of unit length, that directions can give that no row feels.

        Rows of unit length that feel a direction by less than `NOISE` feel it by rounding.
        """
        posed, of_last = self._posed, 0.0
        values = np.abs(pulls)
        if number == len(posed.parts):
            of_last = length(given)
        else:
            values = values + np.where(posed.level == number, np.abs(given), 0.0)
        return NOISE * (length(values * posed.roots * posed.lengths) + of_last)

    @cached_property
    def _sizes(self) -> Array:
        """How large the terms are whose differences the rows' residuals are, and these, weighted `(k,)`."""
        posed = self._posed
        terms = posed.roots * (np.abs(posed.sides) + posed.sizes_of_terms(self._u))
        return terms + posed.roots * np.abs(self._missing)

    def _slackness(self, bounds: Array, rows: Array) -> float:
        """Return 2 Σ |λ| slack; of rows that a level above holds, times how far they can move."""
        room = np.abs(self._slack)
        room[~self.active.held | (room <= ROUNDING * self.scale)] = 0.0  # a row is tight to rounding
        slack = room * self._posed.lengths[self._posed.parts[0]]
        leak_of_rows = np.minimum(self._leak_of_rows, FAR)
        back_rows, back_bounds = (rows < 0.0) & (leak_of_rows < FAR), (bounds < 0.0) & np.isfinite(self._leak_of_bounds)
        at_bounds = np.where(back_bounds, np.minimum(self._leak_of_bounds, FAR), 0.0)  # bounds are kept to the last bit
        return 2.0 * float(np.abs(rows) @ np.where(back_rows, leak_of_rows, slack) + np.abs(bounds) @ at_bounds)

    @cached_property
    def violation(self) -> float:
        """Worst violation of a bound or row, as a distance."""
        posed, u = self._posed, self._u
        over = max(float((u - posed.upper).max(initial=0.0)), float((posed.lower - u).max(initial=0.0)))
        return max(over, float(-self._slack.min(initial=0.0)))

    @property
    def off(self) -> Array:
        """How far the step is off what the levels would have, as their gradients show `(m,)`."""
        return self._off

    @property
    def excess(self) -> float:
        """The largest displacement that would still lower a level's cost."""
        return max(level.excess for level in self.levels)

    @cached_property
    def certificate(self) -> Certificate:
        """The figures."""
        names, is_flat = self._row_names, self.is_flat
        return Certificate(
            self.violation / self.scale,
            tuple(level.gap + level.carried for level in self.levels),
            tuple(level.relative_gap for level in self.levels),
            tuple(
                0.0 if is_flat and level.excess <= level.rounding else level.excess / self.scale for level in self.levels
            ),
            tuple(level.rounding / self.scale for level in self.levels),
            tuple(names(level) for level in self.levels),
        )

    def _row_names(self, level: TreeLevelProof) -> tuple[str, ...]:
        problem, side = self._posed.problem, self.active.side
        joints = problem.bounds.names
        holding = np.flatnonzero(level.bounds > 0.0)
        bounds = [f"{joints[j]} {'upper' if side[j] > 0 else 'lower'}" for j in holding]
        return (*bounds, *(problem.rows.names[i] for i in np.flatnonzero(level.rows > 0.0)))

    @property
    def is_unclear(self) -> bool:
        """Whether it hangs on what counts as rounding which rows the step rests on.

        An active bound or row pulls by so little, or pulls and holds a level above by so little.
        """
        return any(level.is_unclear for level in self.levels)

    @property
    def holds_with_margin(self) -> bool:
        """Whether the certificate holds with room to spare, as the compiled core asks of its own."""
        levels, scale = self.levels, self.scale
        if len(levels) < len(self._posed.parts) or levels[-1].pulls or self.is_unclear:
            return False
        variation = max(max(level.rounding for level in levels) / scale, math.sqrt(levels[-1].relative_gap))
        return (
            max(self.violation, *(level.excess for level in levels)) <= MARGIN * CERTIFIED * scale
            and max((level.relative_gap for level in levels[:-1]), default=0.0) <= MARGIN * GAP
            and variation <= MARGIN * UNDECIDED
        )

    @property
    def is_flat(self) -> bool:
        """Whether limits hold the step, nothing speaks against it, but rounding moves it by more than itself.

        What its levels could still gain is what rounding feigns, and is nothing of what they ask for. Without limits,
        such a step goes as far as a direction that is felt by rounding takes it, and says nothing.
        """
        levels = self.levels
        if not self._is_held or len(levels) < len(self._posed.parts) or levels[-1].pulls or self.is_unclear:
            return False
        return (
            self.violation <= MARGIN * CERTIFIED * self.scale
            and all(level.excess <= level.rounding for level in levels if level.excess > CERTIFIED * self.scale)
            and all(level.relative_gap <= GAP for level in levels[:-1])
            and max(level.rounding for level in levels) > self.scale
        )

    @property
    def is_held(self) -> bool:
        """Whether a bound or row carries a multiplier at some level."""
        return any(bool((level.bounds > 0.0).any() or (level.rows > 0.0).any()) for level in self.levels)


def _told(
    multipliers: Array,
    uncertain: Array | float,
    faint: Array | float,
    leak: Array,
    is_faint: NDArray[np.bool_],
    is_sure: NDArray[np.bool_],
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which rows pull, which hold the level as the first above, and which pull but not clearly.

    Args:
        multipliers: of active rows `(n,)`.
        uncertain: by how much rounding can have changed them.
        faint: up to where they may be those of a direction that no row feels.
        leak: how far the rows can move that levels above hold `(n,)`, infinite for others.
        is_faint: which rows a level so far holds, but faintly `(n,)`; those that this one does are added.
        is_sure: which are known to hold the step at the first level whose multiplier is one `(n,)`, however faint.
    """
    free = ~np.isfinite(leak)
    pulls = free & (multipliers < -PULLS * uncertain)
    wrong = pulls & (multipliers < -faint) & ~is_faint
    first = free & (((multipliers > uncertain) & (multipliers > faint)) | (is_sure & (multipliers > 0.0)))
    is_faint |= free & ~first & (multipliers > PULLS * uncertain)
    return wrong, first, pulls & ~wrong & ~is_sure
