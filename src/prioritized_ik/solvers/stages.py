"""One level of a problem as one QP, scaled so that every solver can solve it.

A stage starts at the answer of the stage before, `origin`, and moves along `free`, the directions that change nothing
above it: dθ = origin + free w. With J = A free and the decomposition J = J_a J_b (Eq. 6), the QP's variables x = (y, z)
are

    y = R J_b w,  with W^½ J_a = Q R     the residual's own coordinates: the cost is ½‖y - Qᵀ W^½ b‖² and no more,
    z = N w,      N a null space of J_b  the directions this level does not feel: they cost nothing.

This change of variables preconditions the problem (the Hessian is diag(1, 0)) without solving it: the solver gets the
residual objective and every row that can move. Rows are divided by their norms, and y is counted in units of the level's
own target, so that steps of millimetres do not drown in solver tolerances.
"""

from dataclasses import dataclass

import numpy as np
import qpsolvers
import scipy.linalg

from prioritized_ik.problem import IKProblem, Level
from prioritized_ik.solvers.closed_form import level_decomposition, null_space
from prioritized_ik.validation import Array

#: A row that moves by less than this fraction of its length along every free direction is settled by the levels above, and
#: is left out: dividing it by its norm would turn rounding into a constraint.
SETTLED_ROW = 2e-8

#: In the last stage the optimum is within 2 units of x = 0, which is feasible; slacks beyond this can be cut to it
#: without changing the optimum, and interior-point solvers start far off if they are not.
FAR_SLACK = 10.0


@dataclass(frozen=True)
class Stage:
    """One QP in scaled variables x `(v,)`, and the way back: dθ = `origin` + `basis` @ x.

    Attributes:
        problem: minimise ½ xᵀPx + qᵀx subject to Gx <= h: any qpsolvers backend can be called on it.
        origin: dθ at x = 0 `(m,)`.
        basis: `(m, v)`.
        costed: how many of the variables, the first ones, the cost feels.
        as_it_stands: whether a backend must solve exactly this QP, once, with its default options.
    """

    problem: qpsolvers.Problem
    origin: Array
    basis: Array
    costed: int
    as_it_stands: bool = False

    def dtheta(self, x: Array) -> Array:
        """Return the joint step `(m,)` [rad] at the variables `x`."""
        return self.origin + self.basis @ x

    @property
    def unfelt(self) -> Array:
        """Orthonormal joint directions `(m, v - costed)` that this stage's cost does not feel."""
        return self.basis[:, self.costed :]

    @property
    def size(self) -> int:
        """Number of variables v."""
        return self.basis.shape[1]


@dataclass(frozen=True)
class Room:
    """What the levels so far leave to the next.

    Attributes:
        origin: their answer `(m,)` [rad], or zero before the first.
        free: orthonormal directions `(m, f)` that change nothing above.
        rows: the inequality rows that can still move `(r, m)`.
        slack: how far `origin` is from each `(r,)`; not negative, so that `origin` itself is feasible.
    """

    origin: Array
    free: Array
    rows: Array
    slack: Array

    @staticmethod
    def whole(problem: IKProblem) -> "Room":
        """Return the room before the first level: everything."""
        m, rows = problem.joint_count, problem.inequalities
        moving = rows.matrix.any(axis=1)
        return Room(np.zeros(m), np.eye(m), rows.matrix[moving], rows.upper[moving])

    def after(self, origin: Array, free: Array) -> "Room":
        """Return the room once `origin` is reached and only `free` directions are left.

        What the stage just solved broke by rounding, the next may keep.
        """
        slack = self.slack - self.rows @ (origin - self.origin)
        reach = np.linalg.norm(self.rows @ free, axis=1)
        moving = reach > SETTLED_ROW * np.linalg.norm(self.rows, axis=1)
        return Room(origin, free, self.rows[moving], np.maximum(slack[moving], 0.0))


def task_stage(level: Level, room: Room, rank_tolerance: float) -> Stage:
    """Return the QP of one weighted level in the room that the levels above leave.

    Args:
        level: the level to minimise.
        room: where it may move.
        rank_tolerance: relative to the largest singular value of the level's matrix.
    """
    factors = level_decomposition(level, room.free, rank_tolerance)
    root = np.sqrt(level.weights)
    q, r = np.linalg.qr(root[:, None] * factors.j_a)
    target = q.T @ (root * (level.target - level.matrix @ room.origin))
    unit = max(np.linalg.norm(target), np.linalg.norm(root * level.target))
    # J_b of the decomposition by singular values has orthonormal rows, so J_b⁺ = J_bᵀ.
    felt = room.free @ scipy.linalg.solve_triangular(r, factors.j_b, trans="T").T
    return _scaled_stage(room, felt, room.free @ null_space(factors.j_b), target, float(unit) or 1.0, np.inf)


def reference_stage(reference: Array, room: Room) -> Stage:
    """Return the QP of the last level, min ‖dθ - r‖², whose cost feels every variable."""
    target = room.free.T @ (reference - room.origin)
    unit = max(np.linalg.norm(target), np.linalg.norm(room.origin))
    return _scaled_stage(room, room.free, room.free[:, :0], target, float(unit) or 1.0, FAR_SLACK)


def damped_stage(problem: IKProblem, level: Level, damping: float) -> Stage:
    """Return the one QP that mink and pink would solve: min (b - A dθ)ᵀW(b - A dθ) + damping ‖dθ - r‖², in dθ itself.

    A different problem from Eqs. (12) to (14), for comparison: it is not scaled, and is solved as it stands, with
    the solver's default options.
    """
    m, rows = problem.joint_count, problem.inequalities
    weighted = level.weights[:, None] * level.matrix
    hessian = level.matrix.T @ weighted + damping * np.eye(m)
    linear = -weighted.T @ level.target - damping * problem.reference
    # Copies: a problem's arrays are read-only, and some solvers refuse those.
    limits = (np.array(rows.matrix), np.array(rows.upper)) if len(rows.upper) else (None, None)
    qp = qpsolvers.Problem(hessian, linear, *limits)
    return Stage(qp, np.zeros(m), np.eye(m), costed=m, as_it_stands=True)


def _scaled_stage(room: Room, felt: Array, unfelt: Array, target: Array, unit: float, far: float) -> Stage:
    """Return min ½‖y - target / unit‖² with dθ = origin + unit felt y + unfelt z and all rows that can move."""
    costed = felt.shape[1]
    basis = np.hstack([unit * felt, unfelt])
    hessian = np.diag(np.repeat([1.0, 0.0], [costed, unfelt.shape[1]]))
    linear = np.concatenate([-target / unit, np.zeros(unfelt.shape[1])])
    if not len(room.rows):
        return Stage(qpsolvers.Problem(hessian, linear), room.origin, basis, costed)
    rows = room.rows @ basis
    norms = np.linalg.norm(rows, axis=1)
    qp = qpsolvers.Problem(hessian, linear, rows / norms[:, None], np.minimum(room.slack / norms, far))
    return Stage(qp, room.origin, basis, costed)
