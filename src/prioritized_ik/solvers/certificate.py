"""Proof that a joint step is the lexicographic optimum, from the problem and the step alone, as a bound.

At the optimum every level ℓ has multipliers λ with

    A_ℓᵀW_ℓ(A_ℓ u - b_ℓ) + Σ_{j<ℓ} A_jᵀμ_j + C ᵀλ = 0

over the rows C near the step, where λ_i >= 0 unless a level above already has a positive multiplier for row i, which holds
it for good: read row by row from the top level down, the first multiplier that is not zero is positive. Finding them is a
non-negative least squares problem a level. Given any such λ, weak duality bounds how much lower the level's cost could be
without harm to those above:

    Q_ℓ(u) - Q_ℓ* <= 2 λᵀ slack + 2 Σ |λ_i| leak_i + ‖rest‖²,

with leak_i how far a row that a level above holds can move without costing that level more than its own gap, and the rest
counted in coordinates in which Q_ℓ is ‖·‖² (along directions that the level does not feel: times the size of the step).
Where the levels above are decided to rounding only, the step may be off by v, and the level's cost by
2 (‖A_ℓᵀW_ℓ(A_ℓ u - b_ℓ)‖ + Σ |λ_i|) v + ‖W_ℓ^½ A_ℓ‖² v² more, as rows follow, and by what mending the levels above would
cost it. So complementary slackness is part of the bound: a row merely near cannot carry a multiplier for nothing. A
slack is a rounded sum: that counts, too, and how far it moves the step where rows meet at a sharp angle. What the
conditions leave over is told as a joint displacement as well, because a level may hardly feel what decides the step.

Everything is in the problem's joint metric.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from prioritized_ik.problem import IKProblem, Level
from prioritized_ik.solvers.balance import Look, farthest
from prioritized_ik.solvers.blocks import HARD, EqualBlock, Shortfall
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.solvers.level_proof import LevelProof
from prioritized_ik.solvers.looks import Conditions, Looks
from prioritized_ik.solvers.subspaces import Range
from prioritized_ik.tolerances import CERTIFIED, EPS, GAP, LEAST_DEMAND, NOTHING, OFF, ROUNDING, UNDECIDED
from prioritized_ik.validation import Array, finite_array, length, lengths, size, tolerance_above_rounding

FAR = 1e300  # a row that no level above holds can move any way


@dataclass(frozen=True)
class Certificate:
    """Lexicographic optimality of one step, as bounds; the implicit last level is included.

    Attributes:
        violation: worst violation of a hard row, bound or equality, relative to the step.
        gaps: by level, how much lower its cost (Eq. 10) could be, in its own units, squared.
        relative_gaps: the part that rounding does not explain, relative to what the level asks for or its error, squared.
        stationarity: by level, how much of a step would still lower its cost, beyond what `rounding` explains.
        rounding: by level, how much of a step the rounding of the conditions' own terms can feign, or what room the rows
            with multipliers have leaves open.
        held_by: by level, the names of the rows that hold it back (their multipliers are positive).
        tolerance: what violation and stationarity may reach.
    """

    violation: float
    gaps: tuple[float, ...]
    relative_gaps: tuple[float, ...]
    stationarity: tuple[float, ...]
    rounding: tuple[float, ...]
    held_by: tuple[tuple[str, ...], ...]
    tolerance: float = CERTIFIED

    @property
    def worst(self) -> float:
        """The largest of violation and stationarity."""
        return max(self.violation, *self.stationarity)

    @property
    def variation(self) -> float:
        """How far dθ may be from the one optimum, relative to the step: by rounding, or what room pushing rows have.

        The last level's cost is ‖dθ - r‖² itself: a step that costs so much less is no further away than its root.
        """
        return max(*self.rounding, math.sqrt(self.relative_gaps[-1]))

    @property
    def holds(self) -> bool:
        """Whether the step is proven optimal: no figure above its tolerance, and no room for another step."""
        return self.is_optimal and self.variation <= UNDECIDED

    @property
    def is_optimal(self) -> bool:
        """Whether no level's cost could be lower by more than the tolerances, however flat the optimum may be."""
        return self.worst <= self.tolerance and max(self.relative_gaps[:-1], default=0.0) <= GAP

    def __str__(self) -> str:
        """Return the certificate in one line."""
        if self.holds:
            within = max(self.worst, self.variation)
            return f"proven optimal: gap at most {max(self.relative_gaps):.0e} of a demand, step to within {within:.0e}"
        if self.is_optimal:
            return f"optimal, but the optimum is flat: rounding leaves dθ undecided by {self.variation:.0e} of the step"
        return (
            f"not proven: violation {self.violation:.0e}, gap {max(self.relative_gaps):.0e} of a demand, "
            f"displacement {max(self.stationarity):.0e} of the step"
        )


def certify(
    problem: IKProblem, dtheta: ArrayLike, rank_tolerance: float = 0.0, tolerance: float = CERTIFIED
) -> Certificate:
    """Return the certificate of any step, from whatever solver.

    A damped level is taken as its rows, √δ dθ among them; see `damping.handed_down` for one whose optimum is handed on.

    Args:
        problem: what the step is to solve.
        dtheta: the step `(m,)` [rad].
        rank_tolerance: shared with the solve: the problem's levels are cut to this rank.
        tolerance: what the figures may reach, relative to the step.

    Raises:
        InputError: a step of another length or not finite, a tolerance out of range.
    """
    step = finite_array("dtheta", dtheta, (problem.joint_count,))
    tolerance_above_rounding("tolerance", tolerance)
    return Proof(Hierarchy(problem, rank_tolerance), problem.to_metric(step), tolerance).certificate


class Proof:
    """The proofs of all levels at one step, and the certificate that sums them up.

    Attributes:
        near: which pooled rows the step ends on `(r,)`; broken hard ones count too.
        exceeded: which rows of soft levels it exceeds `(r,)`.
        levels: one proof a level, the last level's last; in a search, none after the first whose step would still lower
            its cost: nothing that follows could make this an optimum.
    """

    def __init__(self, hierarchy: Hierarchy, u: Array, tolerance: float = CERTIFIED, *, searching: bool = False) -> None:
        self._hierarchy = hierarchy
        self._u = u
        self.tolerance = tolerance
        self.scale = hierarchy.scale(u)
        rows = hierarchy.rows
        self.slack = rows.slack(u)
        near = tolerance * self.scale
        self.near = (self.slack <= near) & ((rows.level == HARD) | (self.slack >= -near))
        self.exceeded = (rows.level != HARD) & (self.slack < -near)
        #: How far a row can move that a level above holds, infinite for those that none holds.
        self._leak = np.full(len(rows.upper), np.inf)
        self._looks = Looks(hierarchy, u, self.scale, tolerance)
        #: Which rows it breaks beyond rounding.
        self._broken = ((self.slack < -ROUNDING * self.scale) & ~self.exceeded).nonzero()[0]
        #: How far a slack can be off: its sum is rounded, and its row may have been.
        self._rounding_of_slacks = (1.0 if hierarchy.is_rounded else 0.5) * EPS * length(u)
        self._turned = 0.0  # how far that moves the step where rows that hold meet at sharp angles
        self._off = 0.0  # by how much the step is off at the levels so far, in what they decide
        self._above = 0.0  # how far rounding can have moved the step at the levels so far
        #: How far the step may go within the room that rows have: what is broken of hard ones, to begin with.
        self._loose = float(-self.slack.min(initial=0.0, where=rows.level == HARD))
        #: The displacement that would mend the levels so far, however little; equalities and frozen joints come first.
        self._handed = self._keeping()
        self.levels: list[LevelProof] = []
        for level in self._prove():
            self.levels.append(level)
            if searching and level.is_off:
                break

    @cached_property
    def certificate(self) -> Certificate:
        """The figures."""
        names = self._hierarchy.rows.names
        return Certificate(
            self._violation() / self.scale,
            tuple(level.gap + level.carried for level in self.levels),
            tuple(level.relative_gap for level in self.levels),
            tuple(level.excess / self.scale for level in self.levels),
            tuple(level.rounding / self.scale for level in self.levels),
            tuple(tuple(names[i] for i in (level.multipliers > 0.0).nonzero()[0]) for level in self.levels),
            self.tolerance,
        )

    def _keeping(self) -> Array:
        """Return the displacement `(m,)` that would keep equalities and frozen joints; zero if that is rounding."""
        kept = self._hierarchy.kept
        if not len(kept.matrix):
            return np.zeros(len(self._u))
        displacement = kept.answer @ (kept.matrix @ (kept.start - self._u))
        return displacement if length(displacement) > ROUNDING * self.scale else np.zeros(len(displacement))

    @property
    def ends_on(self) -> NDArray[np.bool_]:
        """Which pooled rows `(r,)` the step ends on, those of soft levels that it exceeds included."""
        return self.near | self.exceeded

    def _violation(self) -> float:
        hierarchy, rows = self._hierarchy, self._hierarchy.rows
        equalities = hierarchy.problem.equalities
        worst = abs(float(self.slack.min(initial=0.0, where=rows.level == HARD)))
        if not len(equalities.target):
            return worst
        off = np.abs(equalities.matrix @ self._u - equalities.target) / lengths(equalities.matrix)
        return max(worst, float(off.max()))

    def _prove(self) -> Iterator[LevelProof]:
        hierarchy, rows, u = self._hierarchy, self._hierarchy.rows, self._u
        free, near = hierarchy.free, (self.near & (rows.level == HARD)).nonzero()[0]
        for number, (level, block) in enumerate(zip(hierarchy.problem.levels, hierarchy.blocks, strict=True)):
            shortfall = block.shortfall(rows, self.slack, self.exceeded, u, free)
            depend = self._looks.settle(near, shortfall.felt.unfelt, number)
            yield self._proof(level, block.demand, shortfall, free, near, number)
            if isinstance(block, EqualBlock):
                free = shortfall.felt.unfelt
                self._looks.passed(block, number)
            else:
                # None may be exceeded by more than it is, and none by less without costing the level: they hold.
                own = self.exceeded & (rows.level == number)
                free = shortfall.felt.unfelt if np.count_nonzero(own) else free
                near, depend = np.concatenate([near, np.flatnonzero(self.near & (rows.level == number))]), True
            # Rows that hold a level hold it by themselves: what they leave together is not for others to tell.
            if depend:
                self._looks.settle(np.isfinite(self._leak).nonzero()[0], free, number)
        reference = hierarchy.problem.reference
        terms = np.abs(free.T) @ (np.abs(u) + np.abs(reference))
        longest = length(u) + length(reference)
        last = Shortfall(hierarchy.last_range(free), free.T @ (u - reference), terms, 1.0, 0.0)
        yield self._proof(hierarchy.last_level, longest, last, free, near, len(hierarchy.blocks))

    def _proof(
        self,
        level: Level,
        demand: float,
        shortfall: Shortfall,
        free: Array,
        near: NDArray[np.int_],
        number: int,
    ) -> LevelProof:
        """Return the proof of a level from what it lacks in `free` and the numbers of the rows that may hold it back."""
        if len(near):
            near = near[lengths(self._looks.rows[near] @ free) > self._hierarchy.settled_by(number - 1)]
        held = np.isfinite(self._leak[near])  # by a level above: of either sign here
        residual, felt = level.residual(self._u), shortfall.felt.felt
        pulled = level.weights * residual
        cost, steepness = float(residual @ pulled), 2.0 * length(pulled @ level.matrix)
        follows = level.strength * size(felt)
        look = self._looks.at(Conditions(level, shortfall, near, held, cost, follows, steepness, number))
        excess, rounding = look.excess, float(look.rounding @ look.rounding)
        gap = carried = 0.0
        if look.excess:
            # Along what it does not feel a level's cost falls as far as steps of this size go.
            unfelt = length((look.beyond / look.sizes)[felt.shape[1] :])
            gap = float(look.beyond @ look.beyond) + 2.0 * unfelt * self.scale
        if not excess > OFF * self.scale:  # what a displacement mends that is rounding of the step
            excess, gap, carried = 0.0, 0.0, gap
        multipliers, pull, loosened = np.zeros(len(self.slack)), look.balance.pulls, self._restored(free, number)
        if np.count_nonzero(pull):
            slack, back, force = np.abs(self.slack[near]), held & (pull < 0.0), np.abs(pull)
            # Weak duality, see above. What is not apart is on its row but for the rounding of the step itself.
            apart = np.where(slack > ROUNDING * self.scale, slack, 0.0)
            room = np.where(back, np.minimum(self._leak[near], FAR), apart)
            gap += 2.0 * float(force @ room)
            carried += 2.0 * float(force @ (slack - apart)) + 2.0 * float(force.sum()) * self._rounding_of_slacks
            net = np.abs(look.balance.multipliers)
            counts = net > np.maximum(NOTHING * (look.size + net.sum() + shortfall.strength * self.scale), look.doubtful)
            multipliers[near] = np.where(counts, pull, 0.0)
            first = near[~held & (multipliers[near] > 0.0)]
            self._leak[first] = (gap + rounding) / multipliers[first]
            carrying = counts & ~back
            if np.count_nonzero(carrying):
                rounded = np.full(np.count_nonzero(carrying), self._rounding_of_slacks)
                self._turned = max(self._turned, farthest(self._looks.rows[near[carrying]], rounded, free))
                far = self._loosened(near[carrying], force[carrying], shortfall.felt, free, number)
                self._loose = max(self._loose, self._evaded(near[carrying], look, shortfall.felt, number))
                if look.falls(felt.shape[1], carrying, self._hierarchy.turned_as_given(number)):
                    far = max(far, self.scale)  # until a row is in the way, which may be as far as that
                loosened = max(loosened, far)
        drawn, above, handed = self._follow(level, pulled, felt, near, pull, look.displacement)
        self._off, self._above = drawn + excess, max(above, look.explained, loosened)
        carried += rounding + handed + (level.strength * above) ** 2 + (level.strength * self._turned) ** 2
        carried += (steepness + 2.0 * look.balance.pulled) * (above + self._turned)
        return LevelProof(
            level.name,
            gap,
            carried,
            max(demand, math.sqrt(cost), LEAST_DEMAND * shortfall.strength * self.scale),
            look.displacement,
            look.feigned,
            max(look.explained, loosened, self._off),
            multipliers,
            look.gradient,
            near,
            look.balance.normals,
            self.scale,
            self.tolerance,
        )

    def _follow(
        self, level: Level, pulled: Array, felt: Array, near: NDArray[np.int_], pull: Array, displacement: Array
    ) -> tuple[float, float, float]:
        """Return how far a level follows what those above are off by, beyond rounding and with it, and what that costs it.

        The weaker it is, the more it moves; rows that pull follow, too. Its own `displacement` is for those below. Its
        weighted residual is `pulled` `(k,)`.
        """
        amplified = 1.0
        if self._off or self._above:
            amplified += size(felt @ (((felt.T @ level.matrix.T) * level.weights) @ level.matrix))
        drawn, handed = self._off * amplified, 0.0
        if np.count_nonzero(self._handed):
            moved = level.matrix @ self._handed
            handed = 2.0 * abs(float(pulled @ moved)) + float(level.weights @ moved**2)
            handed += 2.0 * float(np.abs(pull) @ np.abs(self._looks.rows[near] @ self._handed))
            # What the level does about what its rows lack.
            self._handed = self._handed - felt @ (felt.T @ (level.matrix.T @ (level.weights * moved)))
        self._handed = self._handed + displacement
        return drawn, max(self._above * amplified, drawn), handed

    def _restored(self, free: Array, number: int) -> float:
        """Return how far the step has to go within `free` `(m, v)` to keep the rows that it breaks within tolerance.

        A row that hardly moves there is broken by little where the step is far from any that keeps it.
        """
        broken = self._broken[self._hierarchy.rows.level[self._broken] < number]
        if not len(broken):
            return 0.0
        moves = lengths(self._looks.rows[broken] @ free)
        there = moves > self._hierarchy.settled_by(number - 1)
        return float((-self.slack[broken][there] / moves[there]).max(initial=0.0))

    def _evaded(self, carrying: NDArray[np.int_], look: Look, range_: Range, number: int) -> float:
        """Return how far the level moves if `carrying` rows `(t,)` hold it only as far as its unfelt directions allow.

        A row holds a level for good where no direction that the level does not feel moves it. What is left of the gradient
        along these is a share of the multipliers that nothing holds: the level takes a way around the rows, however long.
        """
        left = length((look.beyond / look.sizes)[range_.felt.shape[1] :])
        if not left:
            return 0.0
        normals = self._looks.rows[carrying]
        moves = lengths(normals @ range_.unfelt)
        evading = moves > self._hierarchy.settled_by(number)
        if not evading.any():
            return 0.0
        return left / float(moves[evading].min()) * float(lengths(normals[evading] @ range_.felt @ range_.felt.T).max())

    def _loosened(self, carrying: NDArray[np.int_], multipliers: Array, range_: Range, free: Array, number: int) -> float:
        """Return how far the step may go while the `carrying` rows `(t,)` share out the room that they have.

        A level gains Σ λ_i (the room that row i loses), which is not negative: a row may lose its room, or gain what that
        of the others is worth. What levels above leave open moves all of them. Along what the level does not feel, but for
        rows that this does not move; or where the level's cost rises least.
        """
        slack = np.abs(self.slack[carrying])
        # What would mend the levels above moves a row, which may be in its way: the way around it is longer.
        loose = (self._loose if self._loose > ROUNDING * self.scale else 0.0) + length(self._handed)
        room = np.where(slack > ROUNDING * self.scale, slack, 0.0) + loose
        worth = multipliers * room
        room = np.maximum(room, np.minimum((worth.sum() - worth) / multipliers, self.tolerance * self.scale))
        normals, far, has_room = self._looks.rows[carrying], 0.0, np.count_nonzero(room) > 0
        unfelt = lengths(normals @ range_.unfelt)
        moves = unfelt > self._hierarchy.settled_by(number)
        for among, way in ((moves, range_.unfelt), (~moves, free)):
            if np.count_nonzero(among):
                apart = float(
                    (slack[among] / (unfelt[among] if way is range_.unfelt else lengths(normals[among] @ way))).sum()
                )
                far += max(apart, farthest(normals[among], room[among], way)) if has_room else apart
        if not has_room:
            return far
        loosened = max(far, farthest(normals, room, range_.whitened[0]))
        self._loose = max(self._loose, loosened)
        return loosened
