"""How far rows balance the gradients of a step's levels: in doubles, or where these cannot tell with twice their digits.

From the top level down, each look knows what the levels above settle of rows, and how far rounding may have turned the
directions that they leave.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.double_double import DoubleDouble
from prioritized_ik.problem import Level
from prioritized_ik.solvers.balance import Balance, Look, balanced, exact_basis, exact_gradient, exactly_balanced
from prioritized_ik.solvers.blocks import EqualBlock, Shortfall
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.solvers.subspaces import are_independent, singular_values
from prioritized_ik.tolerances import EPS, FINEST, LEAKS, NOISE, PLAIN, PROJECTION, ROUNDING, UNDECIDED
from prioritized_ik.validation import Array, length, lengths


@dataclass(frozen=True)
class Conditions:
    """What a level's rows are to balance at one step.

    Attributes:
        level: see `problem`; the last level has one of its own.
        shortfall: what it lacks.
        near: numbers of the rows that may hold it back `(t,)`.
        held: which of them a level above holds `(t,)`: of either sign here.
        cost: the level's.
        follows: how far the level moves with what levels above leave open.
        steepness: length of the gradient of its cost.
        number: of the level.
    """

    level: Level
    shortfall: Shortfall
    near: NDArray[np.int_]
    held: NDArray[np.bool_]
    cost: float
    follows: float
    steepness: float
    number: int


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
        self.rows = hierarchy.rows.matrix
        self._settled: list[tuple[NDArray[np.int_], Array, Array, int]] = []  # what is left out of them
        #: How far rounding may have turned the directions that the levels so far leave, for rows and for levels below.
        self._blur = self._blur_as_given = PROJECTION * EPS / hierarchy.kept.weakest

    def settle(self, near: NDArray[np.int_], unfelt: Array, number: int) -> bool:
        """Leave out of `near` rows what `unfelt` directions move of combinations that a level settles, as the kernel does.

        Two rows that say the same of what is left, but for that little, are one row there. Returns whether there may be any
        such combination, of these rows or of some of them.
        """
        if not len(near) or not unfelt.shape[1]:
            return False
        moves, least = self.rows[near] @ unfelt, self._hierarchy.least(unfelt.shape[1], number)
        apart = lengths(moves) > self._hierarchy.settled_by(number)  # the others are settled by themselves
        near, moves = near[apart], moves[apart]
        if are_independent(moves, least):
            return False
        combinations, strengths, directions = singular_values(moves)
        few = strengths <= least
        if np.count_nonzero(few):
            ways = unfelt @ directions[few].T
            if not self._settled:
                self.rows = self.rows.copy()
            self.rows[near] -= (combinations[:, few] * strengths[few]) @ ways.T
            self._settled.append((near, combinations[:, few], ways, 2 + number))
        return True

    def passed(self, block: EqualBlock, number: int) -> None:
        """Go on to the levels below."""
        self._blur = max(self._blur, block.blur)
        # What is cut is none, by decree, for the levels below.
        own = PROJECTION * EPS if self._hierarchy.is_cut(number) else block.blur
        self._blur_as_given = max(self._blur_as_given, own)

    def at(self, asked: Conditions) -> Look:
        """Return how far rows balance a level's gradient: in doubles, or where these cannot tell with twice the digits."""
        look, leaks = self._in_doubles(asked)
        off = max(look.feigned / UNDECIDED, look.excess / self._tolerance, leaks / LEAKS)
        # More digits of data that are off in the seventh tell nothing.
        if self._hierarchy.problem.noise > NOISE or off <= self._scale or self._is_plainly_off(asked, look):
            return look
        return self._closer(asked, look.feigned)

    def _is_plainly_off(self, asked: Conditions, look: Look) -> bool:
        """Whether doubles tell how far the step is off: by far more than rounding feigns, as most that a search visits."""

        def is_told(seen: Look) -> bool:
            return seen.excess > PLAIN * seen.feigned

        # What of a row was taken for rounding could balance the gradient, were it none.
        return is_told(look) and is_told(self._in_doubles(asked, whole=True)[0])

    def _in_doubles(self, asked: Conditions, *, whole: bool = False) -> tuple[Look, float]:
        """Return the look in doubles, of `whole` rows or without what may be their rounding, and how far a level leaks."""
        shortfall, number = asked.shortfall, asked.number
        felt, noise = shortfall.felt.felt, self._hierarchy.problem.noise
        unit = noise if noise > NOISE else ROUNDING
        basis, sizes = shortfall.felt.whitened
        # A level's strong rows, far from what they ask for, leave rounding in its weak directions.
        leaks = EPS * asked.follows * math.sqrt(asked.cost) * float(sizes[: felt.shape[1]].max(initial=0.0))
        off, turn_as_given = self._turned(number, felt.shape[1], sizes)
        gradient, blur = _gradient(shortfall, sizes, unit)
        lacking = np.where(np.abs(gradient) > blur, gradient, 0.0)  # rows have not to balance rounding
        little = np.zeros(len(sizes)) if whole else off
        balance = balanced(self.rows[asked.near], basis, lacking, asked.held, little, unit, blur)
        rounding = blur + balance.turned(off) + 0.5 * asked.steepness * turn_as_given * sizes
        feigned = max(length(sizes * rounding), leaks)
        return self._look(asked, balance, gradient, basis, sizes, rounding, feigned, length(blur), feigned), leaks

    def _closer(self, asked: Conditions, feigned: float) -> Look:
        """Return the same with twice the digits of doubles, from rows as they are given."""
        level, shortfall, number = asked.level, asked.shortfall, asked.number
        felt = shortfall.felt.felt.shape[1]
        basis, sizes = shortfall.felt.whitened if level.is_soft else shortfall.felt.weakly_whitened
        off, turn_as_given = self._turned(number, felt, sizes, closer=True)
        solved = self._hierarchy.cut_problem.levels[number] if self._hierarchy.is_cut(number) else level
        directions = self._directions(solved, shortfall, basis, number)
        rounded, blur = _gradient(shortfall, sizes, ROUNDING)
        of_step, gradient = length(blur), DoubleDouble.of(rounded)
        if not level.is_soft:
            own, blur[:felt] = exact_gradient(solved, directions[:, :felt], self._u, is_rounded=self._hierarchy.is_rounded)
            gradient = own.padded(len(sizes))
        lacking = gradient.where(np.abs(gradient.high) > blur)
        balance = exactly_balanced(self._exact_rows(asked.near), directions, lacking, asked.held, off)
        rounding = blur + balance.turned(off) + 0.5 * asked.steepness * turn_as_given * sizes
        explained = length(sizes * rounding)
        return self._look(asked, balance, gradient.high, basis, sizes, rounding, explained, of_step, feigned)

    def _look(
        self,
        asked: Conditions,
        balance: Balance,
        gradient: Array,
        basis: Array,
        sizes: Array,
        rounding: Array,
        explained: float,
        blur: float,
        feigned: float,
    ) -> Look:
        doubtful = self._doubtful(balance, sizes, asked.number, asked.shortfall.felt.felt.shape[1])
        size, rest = length(asked.shortfall.terms), balance.rest
        beyond = rest - np.minimum(np.maximum(rest, -rounding), rounding)
        displacement = -(basis @ beyond)
        return Look(
            balance,
            gradient,
            basis,
            sizes,
            rounding,
            doubtful,
            explained,
            blur,
            feigned,
            size,
            beyond,
            displacement,
            length(displacement),
        )

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
        if not np.count_nonzero(balance.multipliers):
            return np.zeros(len(balance.multipliers))
        off = sizes.copy()
        off[:felt] *= self._hierarchy.turned_as_given(number - 1)
        off[felt:] *= self._hierarchy.turned_as_given(number)
        return np.abs(balance.normals) @ balance.turned(off)

    def _exact_rows(self, near: NDArray[np.int_]) -> DoubleDouble:
        """Return the rows `near` `(t, m)` as they are given, of any length, without what is settled of them."""
        exact, sizes = self._hierarchy.exact_rows, lengths(self._hierarchy.rows.given)
        for numbers, combinations, ways, count in self._settled:
            less = self._hierarchy.decided.less(exact[numbers], sizes[numbers], combinations, ways, count)
            exact = exact.replaced(numbers, less)
        return exact[near]

    def _turned(self, number: int, felt: int, sizes: Array, *, closer: bool = False) -> tuple[Array, float]:
        """Return how far off coordinates of such `sizes` `(v,)` can be, the first so many felt; and levels above, an angle.

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
        finest = 0.5 * EPS if self._hierarchy.is_rounded else PROJECTION * FINEST
        off, least = sizes.copy(), above + (finest if closer else PROJECTION * EPS)
        off[:felt] *= least
        off[felt:] *= max(least, own)
        return off, as_given


def _gradient(shortfall: Shortfall, sizes: Array, unit: float) -> tuple[Array, Array]:
    """Return a level's gradient in coordinates of such `sizes` `(v,)`, and its rounding; what it does not feel is zero."""
    felt = len(shortfall.gradient)
    gradient, terms = np.zeros(len(sizes)), shortfall.leak * sizes
    gradient[:felt] = shortfall.gradient
    terms[:felt] = shortfall.terms + terms[:felt].max(initial=0.0)
    return gradient, unit * terms
