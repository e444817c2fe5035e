"""How far rows balance the gradients of a step's levels: in doubles, or where these cannot tell with twice their digits.

From the top level down, each look knows what the levels above settle of rows, and how far rounding may have turned the
directions that they leave.
"""

import math

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.problem import Level
from prioritized_ik.solvers.balance import Balance, Look, balanced, exact_basis, exact_gradient, exactly_balanced, whitened
from prioritized_ik.solvers.blocks import EqualBlock, Shortfall
from prioritized_ik.solvers.double_double import DoubleDouble
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.tolerances import EPS, FINEST, LEAKS, NOISE, PROJECTION, ROUNDING, UNDECIDED
from prioritized_ik.validation import Array, length, lengths


class Looks:
    """The looks at one step's levels, one after the other.

    Attributes:
        rows: the pooled ones `(r, m)`, without what several together have left of them where that settles them.
    """

    def __init__(self, hierarchy: Hierarchy, u: Array, scale: float, tolerance: float) -> None:
        self._hierarchy = hierarchy
        self._u = u
        self._scale = scale
        self._tolerance = tolerance
        self.rows = hierarchy.rows.matrix.copy()
        self._settled: list[tuple[NDArray[np.int_], Array, Array, int]] = []  # what is left out of them
        #: How far rounding may have turned the directions that the levels so far leave, for rows and for levels below.
        self._blur = self._blur_as_given = PROJECTION * EPS / hierarchy.kept.weakest

    def settle(self, near: NDArray[np.int_], unfelt: Array, number: int) -> None:
        """Leave out of `near` rows what `unfelt` directions move of combinations that a level settles, as the kernel does.

        Two rows that say the same of what is left, but for that little, are one row there.
        """
        if not len(near) or not unfelt.shape[1]:
            return
        combinations, strengths, directions = np.linalg.svd(self.rows[near] @ unfelt, full_matrices=False)
        few = strengths <= self._hierarchy.least(unfelt.shape[1], number)
        if few.any():
            ways = unfelt @ directions[few].T
            self.rows[near] -= (combinations[:, few] * strengths[few]) @ ways.T
            self._settled.append((near, combinations[:, few], ways, 2 + number))

    def passed(self, block: EqualBlock, number: int) -> None:
        """Go on to the levels below."""
        self._blur = max(self._blur, block.blur)
        # What is cut is none, by decree, for the levels below.
        own = PROJECTION * EPS if self._hierarchy.is_cut(number) else block.blur
        self._blur_as_given = max(self._blur_as_given, own)

    def at(
        self,
        level: Level,
        shortfall: Shortfall,
        near: NDArray[np.int_],
        held: NDArray[np.bool_],
        follows: float,
        steepness: float,
        number: int,
    ) -> Look:
        """Return how far rows balance a level's gradient: in doubles, or where these cannot tell with twice the digits."""
        felt, noise = shortfall.felt.felt, self._hierarchy.problem.noise
        unit = noise if noise > NOISE else ROUNDING
        # A level's strong rows, far from what they ask for, leave rounding in its weak directions.
        leaks = EPS * follows * math.sqrt(level.cost(self._u)) * float(lengths(felt.T).max(initial=0.0))
        basis, sizes = whitened(shortfall.felt)
        turns, turn_as_given = self._turns(number, felt.shape[1], len(sizes))
        gradient, blur = _in_doubles(shortfall, sizes, unit)
        lacking = np.where(np.abs(gradient) > blur, gradient, 0.0)  # rows have not to balance rounding
        balance = balanced(self.rows[near], basis, lacking, held, sizes * turns, unit)
        rounding = blur + balance.turned(sizes, turns) + 0.5 * steepness * turn_as_given * sizes
        feigned = max(float(np.linalg.norm(sizes * rounding)), leaks)
        doubtful = self._doubtful(balance, sizes, number, felt.shape[1])
        look = Look(
            balance, gradient, basis, sizes, rounding, doubtful, feigned, length(blur), feigned, length(shortfall.terms)
        )
        off = max(feigned / UNDECIDED, length(look.displacement) / self._tolerance, leaks / LEAKS)
        if noise > NOISE or off <= self._scale:  # more digits of data that are off in the seventh tell nothing
            return look
        return self._closer(level, shortfall, near, held, steepness, feigned, number)

    def _closer(
        self,
        level: Level,
        shortfall: Shortfall,
        near: NDArray[np.int_],
        held: NDArray[np.bool_],
        steepness: float,
        feigned: float,
        number: int,
    ) -> Look:
        """Return the same with twice the digits of doubles, from rows as they are given."""
        felt = shortfall.felt.felt.shape[1]
        basis, sizes = whitened(shortfall.felt, weakly=not level.is_soft)
        turns, turn_as_given = self._turns(number, felt, len(sizes), closer=True)
        solved = self._hierarchy.cut_problem.levels[number] if self._hierarchy.is_cut(number) else level
        directions = self._directions(solved, shortfall, basis, number)
        rounded, blur = _in_doubles(shortfall, sizes, ROUNDING)
        of_step, gradient = length(blur), DoubleDouble.of(rounded)
        if not level.is_soft:
            own, blur[:felt] = exact_gradient(solved, directions[:, :felt], self._u)
            gradient = own.padded(len(sizes))
        lacking = gradient.where(np.abs(gradient.high) > blur)
        balance = exactly_balanced(self._exact_rows(near), directions, lacking, held, sizes * turns)
        rounding = blur + balance.turned(sizes, turns) + 0.5 * steepness * turn_as_given * sizes
        doubtful, explained = self._doubtful(balance, sizes, number, felt), float(np.linalg.norm(sizes * rounding))
        size = length(shortfall.terms)
        return Look(balance, gradient.high, basis, sizes, rounding, doubtful, explained, of_step, feigned, size)

    def _directions(self, level: Level, shortfall: Shortfall, basis: Array, number: int) -> DoubleDouble:
        """Return what a `basis` `(m, v)` of a level is as the levels above leave it, and as it is felt.

        Where no soft level is in between, that is the same at every step.
        """
        hierarchy, felt = self._hierarchy, shortfall.felt.felt
        block = hierarchy.blocks[number] if number < len(hierarchy.blocks) else None
        is_known = felt is (block.inverse if isinstance(block, EqualBlock) else hierarchy.rest)
        if is_known and number in hierarchy.exact_directions:
            return hierarchy.exact_directions[number]
        directions = hierarchy.decided.left(basis, 1 + number)
        if not level.is_soft:
            directions = exact_basis(level, directions, felt.shape[1])
        if is_known:
            hierarchy.exact_directions[number] = directions
        return directions

    def _doubtful(self, balance: Balance, sizes: Array, number: int, felt: int) -> Array:
        """Return how large a multiplier of each row `(t,)` half a unit in the last place of what is given can make."""
        decided = self._hierarchy.decided
        turns = np.full(len(sizes), decided.given(1 + number))
        turns[felt:] = decided.given(2 + number)
        return np.abs(balance.normals) @ balance.turned(sizes, turns)

    def _exact_rows(self, near: NDArray[np.int_]) -> DoubleDouble:
        """Return the rows `near` `(t, m)` as they are given, of any length, without what is settled of them."""
        exact, sizes = self._hierarchy.exact_rows, lengths(self._hierarchy.rows.given)
        for numbers, combinations, ways, count in self._settled:
            less = self._hierarchy.decided.less(exact[numbers], sizes[numbers], combinations, ways, count)
            exact = exact.replaced(numbers, less)
        return exact[near]

    def _turns(self, number: int, felt: int, count: int, *, closer: bool = False) -> tuple[Array, float]:
        """Return how far off a level's directions `(v,)` can be, the first so many felt, for rows; and for levels above.

        What a level does not feel is as far off as it is weak.
        """
        blocks = self._hierarchy.blocks
        block = blocks[number] if number < len(blocks) else None
        above, as_given = self._blur, self._blur_as_given
        own = max(above, block.blur if isinstance(block, EqualBlock) else 0.0)
        if closer:
            decided = self._hierarchy.decided
            above, as_given = (min(blur, decided.turn(1 + number)) for blur in (above, as_given))
            own = min(own, decided.turn(2 + number))
        turns = np.full(count, above + PROJECTION * (FINEST if closer else EPS))
        turns[felt:] = np.maximum(turns[felt:], own)
        return turns, as_given


def _in_doubles(shortfall: Shortfall, sizes: Array, unit: float) -> tuple[Array, Array]:
    """Return a level's gradient in coordinates of such `sizes` `(v,)`, and its rounding; what it does not feel is zero."""
    felt = len(shortfall.gradient)
    gradient = np.concatenate([shortfall.gradient, np.zeros(len(sizes) - felt)])
    strongest = max(sizes[:felt], default=0.0)
    terms = np.concatenate([shortfall.terms + shortfall.leak * strongest, shortfall.leak * sizes[felt:]])
    return gradient, unit * terms
