"""The kernel: from a guess of the active rows to the lexicographic optimum, whoever made the guess.

Which rows an optimum rests on says on which face of the feasible set it lies. On a face the problem has equalities only and
the strict closed form gives its solution to rounding. If that step breaks a row, or the certificate finds a row that holds
a level the wrong way round, the set is corrected: a primal active-set method, started next to its end. Guesses come from
the last step, from a QP solver's answer, or from `stagewise.py`, which starts from nothing.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.solvers.blocks import HARD
from prioritized_ik.solvers.certificate import Proof
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.solvers.subspaces import Range, are_independent, pseudoinverse, singular_values
from prioritized_ik.tolerances import (
    CERTIFIED,
    DEPENDENT,
    DRIFT,
    GUESS,
    ITERATIONS,
    KEPT,
    REFINABLE,
    REFINEMENTS,
    ROUNDING,
    ROWS_PER_SEARCH,
)
from prioritized_ik.validation import Array, identity, length, lengths

Active = NDArray[np.bool_]


@dataclass(frozen=True)
class Solution:
    """What the active-set method reached.

    Attributes:
        u: the optimum `(m,)`, in the joint metric; if none was found, one that rounding leaves undecided, else the start.
        proof: of that.
        active: the rows that it rests on `(r,)`.
        iterations: how often the set was corrected.
        converged: whether the optimum was found; if not, even a start whose certificate holds is the guess's, not the one
            that all guesses share.
        trace: what was done in turn: "add", "drop" or "instead", and the names of the rows.
    """

    u: Array
    proof: Proof
    active: Active
    iterations: int
    converged: bool
    trace: tuple[tuple[str, tuple[str, ...]], ...] = field(default=(), repr=False)


def guessed(hierarchy: Hierarchy, u: Array) -> Active:
    """Return the rows `(r,)` that a step `(m,)` seems to rest on."""
    return hierarchy.rows.slack(u) <= GUESS * hierarchy.scale(u)


def solve(hierarchy: Hierarchy, active: Active, origin: Array, patience: int | None = None) -> Solution:
    """Return the optimum that the `active` rows `(r,)` lead to, moving from `origin` `(m,)`.

    No set is visited twice: where the rule would return to one, the next best row is dropped. At most so many sets are
    visited as `patience` says, or as many as any guess may need.
    """
    rows, u, visited = hierarchy.rows, origin, set[bytes]()
    trace: list[tuple[str, tuple[str, ...]]] = []
    at_proof = origin
    alternatives: Iterator[Active] = iter(())
    following: Active | None
    flat: tuple[Array, Proof, Active] | None = None  # an optimum, but one that rounding leaves undecided

    def note(what: str, changed: Active) -> None:
        trace.append((what, tuple(rows.names[i] for i in np.flatnonzero(changed))))

    for iterations in range(patience or ITERATIONS * max(1, len(rows.upper) // ROWS_PER_SEARCH)):
        visited.add(active.tobytes())
        target = face_solution(hierarchy, active)
        if not np.isfinite(target).all():
            break
        room = rows.slack(u)
        rate = room - rows.slack(target)
        if not np.isfinite(rate).all():
            break
        blocking = ~active & (rate > room + KEPT * hierarchy.scale(target))
        if blocking.any():
            # Ratio test: how far towards the target each blocking row lets go.
            ahead = blocking & (rate > 0.0)  # the others are broken already, and would stay so
            reach = np.where(blocking, np.where(ahead, np.maximum(room, 0.0), 0.0), np.inf) / np.where(ahead, rate, 1.0)
            first = float(reach.min())
            u = u + first * (target - u)
            note("add", reach <= first)
            following = active | (reach <= first)
            if following.tobytes() in visited:  # the row dropped last was the wrong one
                u = at_proof
                following = next((new for new in alternatives if new.tobytes() not in visited), None)
                if following is None:
                    break
                note("instead", active ^ following)
            active = following
            continue
        u = target
        proof = Proof(hierarchy, u, searching=True)
        if proof.certificate.is_optimal:
            flat = u, proof, active = _from_all_tight_rows(hierarchy, u, proof, active)
            if proof.certificate.holds:
                return Solution(u, proof, active, iterations, converged=True, trace=tuple(trace))
        refined = _refined(hierarchy, u, proof)
        if refined is not None:
            u, proof, active = _from_all_tight_rows(hierarchy, *refined, active)
            return Solution(u, proof, active, iterations, converged=True, trace=tuple(trace))
        at_proof, alternatives = u, _corrected(proof, active)
        following = next((new for new in alternatives if new.tobytes() not in visited), None)
        if following is None:
            break
        note("drop", active & ~following)
        active = following
    if flat is not None:
        return Solution(*flat, len(trace), converged=False, trace=tuple(trace))
    proof = Proof(hierarchy, origin)
    return Solution(origin, proof, proof.ends_on, len(trace), converged=False, trace=tuple(trace))


def face_solution(hierarchy: Hierarchy, active: Active) -> Array:
    """Return the strict closed form `(m,)` of all levels on the face where the `active` pooled rows `(r,)` hold.

    Active hard rows hold as equalities; those of a soft level are least squares at that level.
    """
    u = _face_solution(hierarchy, active, hierarchy.start)
    # What a row gets from directions too weak to count is taken from the first solution.
    drifted = np.abs(hierarchy.rows.drift[active] @ (u - hierarchy.start)).max(initial=0.0)
    u = _face_solution(hierarchy, active, u) if drifted > DRIFT * hierarchy.scale(u) else u
    return _at_bounds(hierarchy, active, u)


def _at_bounds(hierarchy: Hierarchy, active: Active, u: Array) -> Array:
    """Return `u` with joints that are at an `active` bound but for rounding there to the last bit.

    Large multipliers make much of what rounding leaves of a slack.
    """
    rows = hierarchy.rows
    numbers, joints = rows.bounds_among(active.nonzero()[0])
    bounds = rows.upper[numbers] * rows.matrix[numbers, joints]  # which is 1 or -1
    near = np.abs(u[joints] - bounds) <= ROUNDING * length(u)
    u = u.copy()
    u[joints[near]] = bounds[near]
    return u


def _face_solution(hierarchy: Hierarchy, active: Active, drifted: Array) -> Array:
    rows, free = hierarchy.rows, hierarchy.free
    u, upper = hierarchy.start, rows.upper - rows.drift @ drifted
    hard = active & (rows.level == HARD)
    to_hold, sides = rows.matrix[hard], upper[hard]
    for number, block in enumerate(hierarchy.blocks):
        felt, wanted = block.wanted(rows, upper, active, u, free)
        move, combined = _held(hierarchy, number, free, felt, wanted, to_hold, sides - to_hold @ u)
        u = u + felt.felt @ move
        to_hold, sides, free = combined.T @ to_hold, combined.T @ sides, felt.unfelt
    wanted = free.T @ (hierarchy.problem.reference - u)
    last = len(hierarchy.blocks)
    move, _ = _held(hierarchy, last, free, hierarchy.last_range(free), wanted, to_hold, sides - to_hold @ u)
    return u + free @ move


def _held(
    hierarchy: Hierarchy, number: int, free: Array, felt: Range, wanted: Array, to_hold: Array, gaps: Array
) -> tuple[Array, Array]:
    """Return the move y `(r,)` nearest to `wanted` that lets rows be held, and what of them the levels below must hold.

    Combinations of rows that the levels below cannot move are this level's to hold; the others are left to them.

    Args:
        hierarchy: knows what is rounding.
        number: of the level.
        free: the directions left to the level `(m, f)`.
        felt: what it feels of them.
        wanted: its optimum without rows `(r,)`.
        to_hold: rows `(t, m)`.
        gaps: by how much each is to change `(t,)`.

    Returns:
        y, and the combinations `(t, k)` of the rows that are left to the levels below, orthonormal.
    """
    below = to_hold @ felt.unfelt
    if not len(to_hold):
        return wanted, identity(0)
    combinations, k = identity(len(to_hold)), 0
    if below.size:
        least = hierarchy.least(below.shape[1], number)
        moving = lengths(below) > hierarchy.settled_by(number)
        k = int(np.count_nonzero(moving))
        if are_independent(below[moving], least):
            if k == len(below):
                return wanted, combinations
            combinations = combinations[:, np.argsort(~moving, kind="stable")]
        else:
            combinations, strengths, _ = singular_values(below, full=len(below) > below.shape[1])
            k = int(np.count_nonzero(strengths > least))
    mine = combinations[:, k:].T
    mine = mine[lengths(mine @ (to_hold @ free)) > DEPENDENT]  # the rest copies other rows
    if not len(mine):
        return wanted, combinations[:, :k]
    normals = mine @ (to_hold @ felt.felt)
    sizes = lengths(normals)
    sizes[sizes == 0.0] = 1.0
    normals, sides = normals / sizes[:, None], mine @ gaps / sizes
    inverse = pseudoinverse(normals)
    move = wanted + inverse @ (sides - normals @ wanted)
    # Once more: the first time leaves the rounding of `wanted`, which can be large against the move.
    return move + inverse @ (sides - normals @ move), combinations[:, :k]


def _from_all_tight_rows(hierarchy: Hierarchy, u: Array, proof: Proof, active: Active) -> tuple[Array, Proof, Active]:
    """Return the optimum computed from every row that it ends on, its proof, and these rows.

    A guess may lack rows without a multiplier: it leads to the same step, but not to the same bits. Rows that are near, but
    apart, such as the two sides of a set that is thinner than `CERTIFIED`, have no step in common: the guess's stays.
    """
    if (proof.ends_on == active).all():
        return u, proof, active
    same = face_solution(hierarchy, proof.ends_on)
    again = Proof(hierarchy, same, searching=True)
    if np.abs(again.slack[proof.near]).max(initial=0.0) > KEPT * again.scale:
        return u, proof, active
    better = (same, again) if again.certificate.holds else _refined(hierarchy, same, again)
    return (u, proof, active) if better is None else (*better, proof.ends_on)


def _refined(hierarchy: Hierarchy, u: Array, proof: Proof) -> tuple[Array, Proof] | None:
    """Return a step that rounding alone kept from being proven, and its proof; None if that is not what it lacked.

    Where a level is ill-conditioned the proof sees, with twice the digits of doubles, by how much the step is off.
    """
    for _ in range(REFINEMENTS):
        failing = next((level for level in proof.levels if level.excess > CERTIFIED * proof.scale), None)
        if failing is None or failing.excess > max(REFINABLE * proof.scale, failing.feigned):
            return None
        u = _at_bounds(hierarchy, proof.near, u + failing.displacement)
        proof = Proof(hierarchy, u, searching=True)
        if proof.certificate.holds:
            return u, proof
    return None


def _corrected(proof: Proof, active: Active) -> Iterator[Active]:
    """Yield the sets to try in place of `active`: without rows that the face cannot hold, else without one that pulls."""
    loose = active & (proof.slack > CERTIFIED * proof.scale)
    if loose.any():
        yield active & ~loose
    for level in proof.levels:
        if level.fails:
            for worst in level.pulls(active & proof.near):
                following = active.copy()
                following[worst] = False
                yield following
            return
