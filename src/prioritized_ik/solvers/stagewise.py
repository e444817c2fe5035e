"""A guess from nothing: the levels one after the other, each by a primal active-set method on its stage.

A stage is min ½‖y - t‖² over x = (y, z) with rows G x <= h, see `stages.py`. The method keeps a working set of independent
rows, moves to the optimum of the face where they hold, adds the first row that blocks the way, and drops the row with the
most negative multiplier; where no step is made it falls back to Bland's rule, which does not cycle but by rounding: back at
the same working set and the same x, it gives up. A start that breaks rows is made feasible first, by the same method on the
excesses of these rows.

Rows with a multiplier are fixed for the levels below, which changes nothing: by complementary slackness they hold at every
optimum of the level. Rows that merely are tight stay inequalities, so that no geometry of wedges has to be decided.
"""

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.solvers.stages import FoldState, Stage, level_stage, reference_stage
from prioritized_ik.solvers.subspaces import null_space
from prioritized_ik.tolerances import DEPENDENT, FAINT, FEASIBLE, FIXING, IDLE, NEGATIVE, ROUNDS, STILL
from prioritized_ik.validation import Array, lengths


def stagewise(hierarchy: Hierarchy, weak: float = DEPENDENT) -> tuple[Array, NDArray[np.bool_]] | None:
    """Return the step `(m,)` that the levels lead to one after the other, and the rows `(r,)` that hold it.

    None if the rows cannot all be kept.

    Args:
        hierarchy: the problem.
        weak: directions along which a stage's cost changes by less than this, on a face, are not followed.
    """
    state, active = FoldState.whole(hierarchy), np.zeros(len(hierarchy.rows.upper), dtype=bool)
    for _ in hierarchy.problem.levels:
        stage = level_stage(state)
        answer = solve_stage(stage, weak)
        if answer is None:
            return None
        x, multipliers = answer
        u = stage.dtheta(x)
        fixed = stage.row_ids[multipliers > max(FIXING * multipliers.max(initial=0.0), FAINT)]
        active[fixed] = True
        state = state.after(u, null_space(hierarchy.rows.matrix[fixed], stage.unfelt))
        if stage.exceeded is not None:  # the excesses of a soft level are unique
            own = stage.row_ids[stage.exceeded(x)]
            active[own] = True
            state = state.without(null_space(hierarchy.rows.matrix[own], state.free))
        if not state.free.shape[1]:
            return u, active
    stage = reference_stage(state)
    answer = solve_stage(stage, weak)
    if answer is None:
        return None
    active[stage.row_ids[answer[1] > 0.0]] = True
    return stage.dtheta(answer[0]), active


def solve_stage(stage: Stage, weak: float = DEPENDENT) -> tuple[Array, Array] | None:
    """Return x `(v,)` and the multipliers `(r,)` of a stage, or None if its rows cannot all be kept."""
    problem = stage.problem
    target = -problem.q[: stage.costed]
    if problem.G is None:
        x = np.zeros(stage.size)
        x[: stage.costed] = target
        return x, np.zeros(0)
    start, upper = np.zeros(stage.size), problem.h
    if (upper < 0.0).any():
        feasible = _feasible(problem.G, upper)
        if feasible is None:
            return None
        start = feasible
    return _primal_active_set(problem.G, upper, target, start, weak)


def _feasible(rows: Array, upper: Array) -> Array | None:
    """Return x `(v,)` that keeps rows of unit length `(n, v)`, or None: min ½‖w‖², w by how much those broken at 0 are."""
    v = rows.shape[1]
    x = np.zeros(v)
    for _ in range(3):  # what is left by rounding is made good once more
        slack = upper - rows @ x
        broken = np.flatnonzero(slack < 0.0)
        unit = float(-slack.min(initial=0.0))
        if not len(broken) or unit <= STILL * float(np.abs(upper).max()):
            return x
        k = len(broken)
        extended = np.zeros((len(rows), k + v))
        extended[:, k:] = rows
        extended[broken, np.arange(k)] = -1.0
        start = np.concatenate([-slack[broken] / unit, np.zeros(v)])
        sizes = lengths(extended)
        found = _primal_active_set(extended / sizes[:, None], slack / unit / sizes, np.zeros(k), start)
        if found is None:
            return None
        x = x + unit * found[0][k:]
    return x if (rows @ x - upper).max() <= FEASIBLE * float(np.abs(upper).max()) else None


def _primal_active_set(
    rows: Array, upper: Array, target: Array, start: Array, weak: float = DEPENDENT
) -> tuple[Array, Array] | None:
    """Return x `(v,)`, the least ½‖x[:r] - target‖² with `rows` `(n, v)` @ x <= `upper`, and the multipliers `(n,)`.

    Args:
        rows: of unit length.
        upper: their sides `(n,)`.
        target: of the first variables `(r,)`.
        start: keeps the rows `(v,)`.
        weak: directions of unit length of which the cost sees less than this are not followed.
    """
    r, x, working, idle = len(target), start, list[int](), 0
    n, v = rows.shape
    visited = set[tuple[bytes, ...]]()
    for _ in range(ROUNDS * (n + v)):
        if idle > IDLE:  # what is here before goes on as before
            here = np.array(working).tobytes(), x.tobytes()
            if here in visited:
                return None
            visited.add(here)
        q, triangle = scipy.linalg.qr(rows[working].T, check_finite=False) if working else (np.eye(v), np.zeros((v, 0)))
        k = len(working)
        null = q[:, k:]
        gradient = np.zeros(v)
        gradient[:r] = x[:r] - target
        move = null @ _minimum_norm(null[:r], -gradient[:r], weak)
        if np.linalg.norm(move) > STILL * (np.linalg.norm(x) + np.linalg.norm(target)):
            rate, slack = rows @ move, np.maximum(upper - rows @ x, 0.0)
            rate[working] = 0.0
            ahead = rate > DEPENDENT * np.linalg.norm(move)
            reach = np.where(ahead, slack, np.inf) / np.where(ahead, rate, 1.0)
            first = float(reach.min(initial=np.inf))
            x = x + min(first, 1.0) * move
            if first < 1.0:
                ties = np.flatnonzero(reach <= first)
                idle = idle + 1 if first == 0.0 else 0
                working.append(int(ties[0] if idle > IDLE else ties[np.argmax(rate[ties])]))
                continue
            gradient[:r] = x[:r] - target
        multipliers = scipy.linalg.solve_triangular(triangle[:k], -q[:, :k].T @ gradient) if k else np.zeros(0)
        negative = np.flatnonzero(multipliers < -NEGATIVE * (np.linalg.norm(target) + np.linalg.norm(x[:r])))
        if not len(negative):
            spread = np.zeros(n)
            spread[working] = np.maximum(multipliers, 0.0)
            return x, spread
        bland = min(negative, key=lambda place: working[place])
        working.pop(int(bland if idle > IDLE else negative[np.argmin(multipliers[negative])]))
    return None


def _minimum_norm(matrix: Array, target: Array, weak: float) -> Array:
    """Return the shortest least-squares solution `(n,)` of `matrix` `(r, n)` w = `target`, parts of orthonormal columns.

    Singular values up to `weak` are none, absolutely: a working set can leave nothing but rounding of a direction.
    """
    if not matrix.size:
        return np.zeros(matrix.shape[1])
    u, s, vt = np.linalg.svd(matrix, full_matrices=False)
    p = int(np.count_nonzero(s > weak))
    return np.asarray(vt[:p].T @ (u[:, :p].T @ target / s[:p]))
