"""From a guess of the active bounds and rows to the lexicographic optimum on a kinematic tree.

Faces are factored in O(joints), so that sets may change in blocks: what a face's step breaks most becomes active, what
pulls is let go, until nothing changes. Where that takes more than a few corrections, `interior.py` says where to go on
from, in blocks and then by the ratio test, row by row, as in `solvers/active_set.py`; where that is in vain, the search
starts again from zero.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.solvers.tree.certificate import ActiveSet, Digits, TreeProof
from prioritized_ik.solvers.tree.factors import HELD, Ending
from prioritized_ik.solvers.tree.interior import guessed
from prioritized_ik.solvers.tree.posed import PosedOnTree
from prioritized_ik.tolerances import CERTIFIED, CUT_MARGIN, EPS, FLOOR, FREE, KEPT, MARGIN, NOISE, REFINEMENTS
from prioritized_ik.validation import Array, length

SHARE = 0.3  # [of the worst violation] what is broken by less is left for later
FEW = 10  # sets that change in blocks, before an interior point is asked for, which takes as long as about so many
LESS = 1e-1, 1e-2  # [of the level above] what levels weigh there, one after the other
STARTED = 4  # steps of the power method where one singular value at most is more than rounding
TOLD = 10.0  # [of what rounding may do to a step] by how much the optimum without a row breaks it where that tells
ANOTHER = 2.0  # [of the step] an optimum without a row is another one altogether if it is longer than that
MORE = 120  # sets after that which change by one row
BLOCKS = 200  # sets that change in blocks where that was in vain
SINGLES = 3  # [of joints and rows] sets after that which change by one row
ROUNDED_OFF = 1e-6  # [of the step] what a step is off by more is not looked at with more digits
REFINED = 1e-11  # [of the step] what a step is off by less is left
LONG = 1e-3  # [of what levels ask for, by their strength]: steps this long are not short for what levels ask for


@dataclass(frozen=True, eq=False)
class Found:
    """An optimum with its proof.

    Attributes:
        u: `(m,)`, in the joint metric.
        proof: of it.
        active: what it rests on.
        corrections: how often the set was corrected.
    """

    u: Array
    proof: TreeProof
    active: ActiveSet
    corrections: int


class Search:
    """The search for one problem's optimum; None where anything is not clear.

    Args:
        posed: the problem.
        is_tried: whether a few corrections are known to lead to no optimum from where the search is to start.

    Attributes:
        posed: see above.
        has_met_unclear_ranks: whether what a level feels on some face so far is neither clearly zero nor clearly not.
        flat: a step that was met so far whose proof lacks nothing but digits, see `TreeProof.is_flat`.
    """

    def __init__(self, posed: PosedOnTree, *, is_tried: bool = False) -> None:
        self.posed, self._factors, self._is_tried = posed, posed.factors, is_tried
        self.has_met_unclear_ranks = False
        self.flat: Found | None = None
        self._frozen = posed.lower == posed.upper
        self._least: float | None = None
        self._corrections = 0
        self._factored: tuple[bytes, bool] | None = None  # the face that is factored, and whether its ranks are clear

    def nothing(self) -> ActiveSet:
        """Return the set of no row but frozen joints."""
        side = np.where(self._frozen, 1, 0).astype(np.int8)
        return ActiveSet(side, np.zeros(len(self.posed.problem.rows.upper), dtype=bool))

    def has_clear_ranks(self, rank_tolerance: float) -> bool:
        """Whether all singular values that a rank tolerance is to cut are zeros, which have been cut, at every level.

        A value in between has its singular vectors in many joints: the dense form cuts it.
        """
        posed, factors = self.posed, self._factors
        if not self._factor(self.nothing()):
            return False
        for number in range(1, len(posed.parts)):
            zeros = int(np.count_nonzero(~factors.fixed)) - sum(factors.ranks[: number + 1])
            most = length(posed.lengths[posed.parts[number]])  # of the squares of all singular values
            if self._cuts_zeros_alone(number, zeros, rank_tolerance * most):
                continue
            largest = posed.norm_of_matrix(number)
            # The power method ends below the largest, by less than a hundredth.
            cuts = rank_tolerance * largest * (1.0 - CUT_MARGIN), rank_tolerance * min(most, 1.01 * largest)
            if not all(self._cuts_zeros_alone(number, zeros, cut) for cut in cuts):
                return False
        return True

    def _cuts_zeros_alone(self, number: int, zeros: int, cut: float) -> bool:
        return self._factors.count_below(number, cut) == zeros

    def face(self, active: ActiveSet) -> Array | None:
        """Return the step u `(m,)` where the `active` bounds and rows hold as equalities; None if that is not clear."""
        posed, factors = self.posed, self._factors
        if not self._factor(active):
            return None
        values = np.where(active.side > 0, posed.upper, np.where(active.side < 0, posed.lower, 0.0))
        u = factors.solve(values, self._sides(posed.sides, active), posed.reference)
        if not np.isfinite(u).all():
            return None
        missed = np.abs(posed.slack(u)[active.held])
        return None if missed.max(initial=0.0) > CERTIFIED * max(length(u), 1e-300) else u

    def _proven(self, u: Array, active: ActiveSet, scale: float) -> tuple[Array, TreeProof]:
        """Return a face's step and its proof, once what the first solution leaves is mended; the face stays factored."""
        posed, factors, fixed = self.posed, self._factors, active.side != 0
        proof, before = TreeProof(posed, factors, u, active, scale), np.inf
        for _ in range(REFINEMENTS):
            excess = proof.excess
            if excess <= REFINED * scale or excess > 0.5 * before:
                break
            before = excess
            more = factors.solve(np.zeros(len(u)), self._sides(posed.missing(u), active), posed.reference - u)
            if length(more) <= REFINED * scale:  # what is in excess is rounding of the multipliers
                break
            u = np.where(fixed, u, u + more)
            proof = TreeProof(posed, factors, u, active, scale)
        return u, proof

    def _finely(self, u: Array, proof: TreeProof, active: ActiveSet) -> tuple[Array, TreeProof]:
        """Return a face's step and its proof by gradients with twice the digits, if its excess may be rounding.

        Where levels miss far more than the step makes up for, doubles do not have the digits to show how far it is off.
        What mends a level moves those below, along what they feel weakly: these come next.
        """
        least, most = MARGIN * CERTIFIED * proof.scale, ROUNDED_OFF * proof.scale
        if least < proof.excess <= most:
            u, proof = self._mended(u, proof, active, Digits.GRADIENTS)
        if proof.holds_with_margin or proof.is_unclear or proof.excess > most:
            return u, proof
        return self._mended(u, proof, active, Digits.TWICE)

    def _mended(self, u: Array, proof: TreeProof, active: ActiveSet, digits: Digits) -> tuple[Array, TreeProof]:
        """Return a face's step, moved by what its proof of so many digits says that it is off by, and that proof."""
        best, scale = (u, proof), proof.scale
        for turn in range(REFINEMENTS):
            finer = TreeProof(self.posed, self._factors, u, active, scale, digits=digits)
            if turn == 0 or finer.excess < best[1].excess:
                best = u, finer
            if finer.excess <= MARGIN * CERTIFIED * scale:
                break
            u = np.where(active.side != 0, u, u - finer.off)
        return best

    def _told(self, u: Array, proof: TreeProof, active: ActiveSet) -> TreeProof:
        """Return the proof once bounds and rows that may hold the step, or pull, were let go, each by itself.

        Those that are broken then hold it; if any is not, or if that makes another step of it altogether, along directions
        that levels hardly feel, the proof is as it was.
        """
        unclear, scale = _unclear(proof), proof.scale
        least = scale * max(CERTIFIED, TOLD * max(level.rounding for level in proof.levels) / scale)
        if unclear.count <= FEW and all(self._beyond(one, active, scale) > least for one in unclear.singly()):
            self._factor(active)
            return TreeProof(self.posed, self._factors, u, active, scale, unclear, digits=proof.digits)
        return proof

    def _beyond(self, one: ActiveSet, active: ActiveSet, scale: float) -> float:
        """Return how far the step that does not rest on `one` bound or row of those that are `active` is beyond it."""
        posed, u = self.posed, self.face(active.without(one))
        if u is None or length(u) > ANOTHER * scale:
            return -np.inf
        upper, lower = (u - posed.upper)[one.side > 0], (posed.lower - u)[one.side < 0]
        return float(np.concatenate([upper, lower, -posed.slack(u)[one.held]]).max())

    def _sides(self, sides: Array, active: ActiveSet) -> Array:
        """Return right-hand sides `(k,)` without those of inequality rows that are not held, which may be infinite."""
        kept = sides.copy()
        kept[self.posed.parts[0]][~active.held] = 0.0
        return kept

    def _factor(self, active: ActiveSet) -> bool:
        if self._factored is None or self._factored[0] != active.key:
            held = np.zeros(len(self.posed.level), dtype=bool)
            held[self.posed.parts[0]] = active.held
            is_clear = self._factors.factor(active.side != 0, held) is Ending.CLEAR
            is_clear = is_clear and (self.posed.zero <= NOISE or self._feels_what_it_decides(held))
            self.has_met_unclear_ranks |= not is_clear
            self._factored = active.key, is_clear
        return self._factored[1]

    def _feels_what_it_decides(self, held: NDArray[np.bool_]) -> bool:
        """Whether what levels feel of directions that they do not decide is rounding."""
        posed, alike = self.posed, self.posed.factors_alike
        alike.factor(self._factors.fixed, held)  # which decides the same
        for level in range(len(posed.parts)):
            rows = (posed.level == level) & (alike.rows.roots > 0.0) & ((level != HELD) | held)
            if rows.any() and not self._is_rounding(level, np.where(rows, alike.rows.roots, 0.0)):
                return False
        return True

    def _is_rounding(self, level: int, roots: Array) -> bool:
        """Whether no combination of a level's rows, at unit length, is more than rounding where the level decides nothing.

        What it does decide may make up for what a direction is felt; the power method finds the largest of what is left.
        Where levels above decide by little, rounding turns what they leave by as much more, and what is felt of that is
        rounding.

        Args:
            level: its number.
            roots: what brings its rows to unit length `(k,)`, zero for others.
        """
        posed, alike, largest = self.posed, self.posed.factors_alike, 0.0
        u = alike.left_by(level, np.random.default_rng(0).standard_normal(posed.tree.joint_count))
        for _ in range(STARTED):
            if (size := length(u)) == 0.0:
                break
            u = u / size
            gradient = posed.rows.transposed_times(roots**2 * alike.motions(u)[0])
            best = u - alike.displacement(level, alike.whitened(level, alike.parts(gradient)[level]))
            felt = roots * alike.motions(best)[0]
            largest = max(largest, length(felt))
            u = alike.left_by(level, posed.rows.transposed_times(roots * felt))
        return largest <= max(NOISE, EPS / min(alike.weakest[:level], default=np.inf))

    @property
    def ranks(self) -> list[int] | None:
        """Ranks of the levels where only frozen joints are active; None if they are not clear."""
        return list(self._factors.ranks) if self._factor(self.nothing()) else None

    def closed_form(self) -> tuple[Found | None, Array | None]:
        """Return the closed form if it breaks no row, with its proof; and the step in any case."""
        active = self.nothing()
        u = self.face(active)
        if u is None:
            return None, None
        scale = self._scale(u, active)
        if self._worst(u) < -FREE * scale:
            return None, u
        u, proof = self._finely(*self._proven(u, active, scale), active)
        return self._if_proven(Found(u, proof, active, 0)), u

    def _if_proven(self, found: Found) -> Found | None:
        """Return a step whose proof holds with margin; keep one that lacks nothing but digits."""
        if found.proof.holds_with_margin:
            return found
        if found.proof.is_flat:
            self.flat = found
        return None

    def optimum(self, active: ActiveSet) -> Found | None:
        """Return the optimum that the search from `active` comes to.

        Where a few corrections do not find it, an interior point says where to go on from.
        """
        self._corrections = FEW if self._is_tried else 0
        found = None if self._is_tried else self._in_blocks(active, FEW)
        for less in LESS[: len(self.posed.parts) - 1]:  # one level has none below it
            if found is None and self.flat is None and (inside := guessed(self.posed, less)) is not None:
                found = self._in_blocks(inside.active, FEW) or self._one_by_one(inside.u, inside.active, MORE)
        if found is not None or self.flat is not None:  # no other set has more digits
            return found
        return self._in_blocks(active, BLOCKS) or self._from_zero()

    def _in_blocks(self, active: ActiveSet, most: int) -> Found | None:
        """Return the optimum that at most so many corrections come to, each of all rows that call for it."""
        visited: set[bytes] = set()
        share = SHARE
        for _ in range(most):
            visited.add(active.key)
            u = self.face(active)
            if u is None:  # so many rows that no step keeps them all
                return None
            scale = self._scale(u, active)
            broken = self._broken(u, active, KEPT * scale)
            u, proof = self._proven(u, active, scale)
            if not broken.count and not proof.levels[-1].pulls:
                u, proof = self._finely(u, proof, active)
            last = proof.levels[-1]
            if not broken.count and not last.pulls:
                if proof.is_unclear:
                    proof = self._told(u, proof, active)
                if not proof.is_unclear:
                    return self._if_proven(Found(u, proof, active, self._corrections))
            if last.pulls:
                following = _without_pulling(proof, active)
            elif not broken.count:
                following = active.without(_unclear(proof))  # let go, they may stay where they are, to rounding
            else:
                following = self._with_worst(u, active, broken, share)
            if following.key in visited:
                share = 1.0
                following = self._with_worst(u, active, broken, share) if broken.count else following
                if following.key in visited:
                    return None
            active, self._corrections = following, self._corrections + 1
        return None

    def _with_worst(self, u: Array, active: ActiveSet, broken: ActiveSet, share: float) -> ActiveSet:
        """Return `active` and those of the `broken` bounds and rows that are broken by a `share` of the worst at least."""
        posed = self.posed
        over = np.where(broken.side > 0, u - posed.upper, np.where(broken.side < 0, posed.lower - u, 0.0))
        short = np.where(broken.held, -posed.slack(u), 0.0)
        least = share * max(float(over.max(initial=0.0)), float(short.max(initial=0.0)))
        chosen = (broken.side != 0) & (over >= least)
        return ActiveSet(
            np.where(chosen, broken.side, active.side).astype(np.int8), active.held | (broken.held & (short >= least))
        )

    def _from_zero(self) -> Found | None:
        """Return the optimum by the ratio test, from zero, which must be feasible."""
        u = np.where(self._frozen, self.posed.lower, 0.0)
        if self._worst(u) < 0.0:
            return None
        return self._one_by_one(u, self.nothing(), SINGLES * (len(u) + len(self.posed.problem.rows.upper)))

    def _one_by_one(self, u: Array, active: ActiveSet, most: int) -> Found | None:
        """Return the optimum by the ratio test, from a feasible step on a face, in so many corrections at most."""
        dropped: dict[
            bytes, int
        ] = {}  # of sets whose step was reached, how many of the rows that pull were dropped in turn
        for _ in range(most):
            target = self.face(active)
            if target is None:
                return None
            scale = self._scale(target, active)
            broken = self._broken(target, active, KEPT * scale)
            if broken.count:
                u, active = self._towards(u, target, active, broken)
                self._corrections += 1
                continue
            u, proof = self._proven(target, active, scale)
            if not proof.levels[-1].pulls:
                u, proof = self._finely(u, proof, active)
            if not proof.levels[-1].pulls:
                return self._if_proven(Found(u, proof, active, self._corrections))
            # Back at a set, the row that was dropped there holds a level above by less than rounding shows: then the next.
            turn = dropped.get(active.key, 0)
            dropped[active.key] = turn + 1
            following = _without_one(proof, active, turn)
            if following is None:
                return None
            active, self._corrections = following, self._corrections + 1
        return None

    def _towards(self, u: Array, target: Array, active: ActiveSet, broken: ActiveSet) -> tuple[Array, ActiveSet]:
        """Return how far towards `target` the blocking rows let go, and the set with those that block first."""
        posed, move = self.posed, target - u
        up, down = broken.side > 0, broken.side < 0
        reach = np.full(len(u), np.inf)
        reach[up] = np.maximum(posed.upper[up] - u[up], 0.0) / move[up]
        reach[down] = np.maximum(u[down] - posed.lower[down], 0.0) / -move[down]
        here, there = posed.slack(u), posed.slack(target)
        along = np.full(len(here), np.inf)
        along[broken.held] = np.maximum(here[broken.held], 0.0) / np.maximum(here - there, 1e-300)[broken.held]
        first = min(float(reach.min(initial=np.inf)), float(along.min(initial=np.inf)))
        return u + first * move, ActiveSet(
            np.where(reach <= first, broken.side, active.side).astype(np.int8), active.held | (along <= first)
        )

    def _broken(self, u: Array, active: ActiveSet, kept: float) -> ActiveSet:
        """Return the bounds and rows, not active yet, that a step breaks by more than `kept`."""
        posed = self.posed
        free = active.side == 0
        side = np.where(free & (u > posed.upper + kept), 1, np.where(free & (u < posed.lower - kept), -1, 0))
        return ActiveSet(side.astype(np.int8), ~active.held & (posed.slack(u) < -kept))

    def _worst(self, u: Array) -> float:
        posed = self.posed
        room = min(float((posed.upper - u).min(initial=np.inf)), float((u - posed.lower).min(initial=np.inf)))
        return min(room, float(posed.slack(u).min(initial=np.inf)))

    def _scale(self, u: Array, active: ActiveSet) -> float:
        """Return what figures of a step are relative to: its length, or a share of the least that a level asks for.

        Not of the closed form's length, as `Hierarchy.scale`: nearly straight arms make that 1e13 rad here, and a step
        relative to it might break any limit.
        """
        size = length(u)
        if self._least is None:
            numbers = range(1, len(self.posed.parts))
            wanted, strength = max(map(self.posed.demand, numbers)), max(map(self.posed.strength, numbers))
            if size * strength > LONG * wanted:
                return size
            asked = [self.posed.demand(i) / self.posed.strength(i) for i in numbers if self.posed.strength(i) > 0.0]
            self._least = max(0.0, *asked)
        return max(size, FLOOR * self._least) or 1.0


def _without_pulling(proof: TreeProof, active: ActiveSet) -> ActiveSet:
    last = proof.levels[-1]
    return ActiveSet(np.where(last.wrong_bounds, 0, active.side).astype(np.int8), active.held & ~last.wrong_rows)


def _unclear(proof: TreeProof) -> ActiveSet:
    """Return what pulls but not clearly."""
    bounds = np.logical_or.reduce([level.unclear_bounds for level in proof.levels])
    rows = np.logical_or.reduce([level.unclear_rows for level in proof.levels])
    return ActiveSet(np.where(bounds, proof.active.side, 0).astype(np.int8), rows)


def _without_one(proof: TreeProof, active: ActiveSet, turn: int) -> ActiveSet | None:
    """Return the set without one of the rows that pull, the most first, by turns; None after the last."""
    last, m = proof.levels[-1], len(active.side)
    pulls = np.concatenate([np.where(last.wrong_bounds, last.bounds, 0.0), np.where(last.wrong_rows, last.rows, 0.0)])
    if turn >= np.count_nonzero(pulls):
        return None
    place = int(np.argsort(pulls)[turn])
    side, held = active.side.copy(), active.held.copy()
    if place < m:
        side[place] = 0
    else:
        held[place - m] = False
    return ActiveSet(side, held)
