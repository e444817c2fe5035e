"""From a solver's answer to the exact optimum, which does not depend on the solver.

The rows that the answer rests on say which face of the feasible set the optimum lies on. On it the problem has equalities
only and the closed form gives its solution to rounding. If that step breaks a row, or the certificate finds a row that
holds a level the wrong way round, the guess is repaired: a primal active-set method, started next to its end.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from prioritized_ik.problem import step_scale
from prioritized_ik.solvers.certificate import CERTIFIED, Proof
from prioritized_ik.solvers.hierarchy import DEPENDENT, HARD, SETTLED_ROW, Hierarchy, Whitened
from prioritized_ik.validation import Array, lengths

REPAIRS = 60  # of the guessed face, before the polish gives up
GUESS = 1e-6  # a row nearer than this to the solver's answer, relative to the step, is guessed to be tight
DRIFT = 1e-14  # what a row moves by directions too weak to count, relative to the step, that is rounding
KEPT = 1e-10  # a row exceeded by less than this, relative to the step, is kept: rounding


@dataclass(frozen=True)
class Polished:
    """What a polish reached.

    Attributes:
        dtheta: the exact optimum `(m,)` [rad]; the solver's answer if none was found.
        proof: of that.
        repairs: how many the guess took.
        ended: whether the optimum was found; if not, even an answer whose certificate holds is the solver's, not the one
            that all solvers share.
    """

    dtheta: Array
    proof: Proof
    repairs: int
    ended: bool


def polish(hierarchy: Hierarchy, answer: Array) -> Polished:
    """Return the exact optimum next to a solver's `answer` `(m,)`, or, if none is found, the answer with its figures."""
    rows, dtheta = hierarchy.rows, answer
    active = rows.slack(answer) <= GUESS * step_scale(answer)
    for repairs in range(REPAIRS):
        target = face_solution(hierarchy, active)
        room = rows.slack(dtheta)
        rate = room - rows.slack(target)
        blocked = ~active & (rate > room + KEPT * step_scale(target))
        if blocked.any():
            reach = np.where(blocked, np.maximum(room, 0.0), np.inf) / np.where(blocked, rate, 1.0)
            first = float(reach.min())
            dtheta = dtheta + first * (target - dtheta)
            active = active | (reach <= first)
            continue
        dtheta = target
        proof = Proof(hierarchy, dtheta)
        if proof.certificate.holds:
            return Polished(*_from_all_tight_rows(hierarchy, dtheta, proof, active), repairs, ended=True)
        wrong = _wrong(proof, active)
        if not len(wrong):
            return Polished(answer, Proof(hierarchy, answer), repairs, ended=False)
        active[wrong] = False
    return Polished(answer, Proof(hierarchy, answer), REPAIRS, ended=False)


def face_solution(hierarchy: Hierarchy, active: NDArray[np.bool_]) -> Array:
    """Return the strict closed form `(m,)` of all levels on the face where the `active` pooled rows `(r,)` hold.

    Active hard rows hold as equalities; those of a soft level are least squares at that level.
    """
    dtheta = _face_solution(hierarchy, active, hierarchy.start)
    # What a row gets from directions too weak to count is taken from the first solution.
    drifted = np.abs(hierarchy.rows.drift[active] @ (dtheta - hierarchy.start)).max(initial=0.0)
    return _face_solution(hierarchy, active, dtheta) if drifted > DRIFT * step_scale(dtheta) else dtheta


def _face_solution(hierarchy: Hierarchy, active: NDArray[np.bool_], drifted: Array) -> Array:
    rows, free = hierarchy.rows, hierarchy.free
    dtheta, upper = hierarchy.start, rows.upper - rows.drift @ drifted
    hard = active & (rows.level == HARD)
    to_hold, sides = rows.matrix[hard], upper[hard]
    for number, task in enumerate(hierarchy.tasks):
        if task is not None:
            felt = task.within(free)
            wanted = felt.project(task.missing(dtheta))
        else:
            own = active & (rows.level == number)
            felt = rows.within(own, free)
            wanted = felt.project(rows.strengths[own] * (upper[own] - rows.matrix[own] @ dtheta))
        move, combined = _held(free, felt, wanted, to_hold, sides - to_hold @ dtheta)
        dtheta = dtheta + felt.felt @ move
        to_hold, sides, free = combined.T @ to_hold, combined.T @ sides, felt.unfelt
    wanted = free.T @ (hierarchy.problem.reference - dtheta)
    move, _ = _held(free, Whitened(free, free[:, :0], None), wanted, to_hold, sides - to_hold @ dtheta)
    return dtheta + free @ move


def _held(free: Array, felt: Whitened, wanted: Array, to_hold: Array, gaps: Array) -> tuple[Array, Array]:
    """Return the move y `(r,)` nearest to `wanted` that lets rows be held, and what of them the levels below must hold.

    Combinations of rows that the levels below cannot move are this level's to hold; the others are left to them.

    Args:
        free: the directions left to the level `(m, f)`.
        felt: what it feels of them.
        wanted: its optimum without rows `(r,)`.
        to_hold: rows `(t, m)`.
        gaps: by how much each is to change `(t,)`.

    Returns:
        y, and the combinations `(t, k)` of the rows that are left to the levels below, orthonormal.
    """
    below = to_hold @ felt.unfelt
    combinations, k = np.eye(len(to_hold)), 0
    if below.size:
        combinations, triangle, _ = scipy.linalg.qr(below, pivoting=True, check_finite=False)
        k = int(np.count_nonzero(np.abs(np.diag(triangle)) > SETTLED_ROW))
    mine = combinations[:, k:].T
    mine = mine[lengths(mine @ (to_hold @ free)) > DEPENDENT]  # the rest copies other rows
    if not len(mine):
        return wanted, combinations[:, :k]
    normals = mine @ (to_hold @ felt.felt)
    sizes = lengths(normals)
    normals, sides = normals / sizes[:, None], mine @ gaps / sizes
    inverse = np.linalg.pinv(normals, rcond=DEPENDENT)
    move = wanted + inverse @ (sides - normals @ wanted)
    # Once more: the first time leaves the rounding of `wanted`, which can be large against the move.
    return move + inverse @ (sides - normals @ move), combinations[:, :k]


def _from_all_tight_rows(
    hierarchy: Hierarchy, dtheta: Array, proof: Proof, active: NDArray[np.bool_]
) -> tuple[Array, Proof]:
    """Return the optimum computed from every row that it ends on, and its proof.

    A guess may lack rows without a multiplier: it leads to the same step, but not to the same bits.
    """
    if (proof.ends_on == active).all():
        return dtheta, proof
    same = face_solution(hierarchy, proof.ends_on)
    again = Proof(hierarchy, same)
    return (same, again) if again.certificate.holds else (dtheta, proof)


def _wrong(proof: Proof, active: NDArray[np.bool_]) -> NDArray[np.int_]:
    """Return the numbers of active rows to drop: those that the face cannot hold, else the one that pulls most."""
    loose = np.flatnonzero(active & (proof.slack > CERTIFIED * proof.scale))
    if len(loose):
        return loose
    failing = next((level for level in proof.levels if level.excess > CERTIFIED * proof.scale), None)
    worst = None if failing is None else failing.pulls(active & proof.tight)
    return np.array([] if worst is None else [worst], dtype=int)
