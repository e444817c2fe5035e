"""One level of a problem as one QP, scaled so that every solver can solve it.

A stage starts at the answer of the stage before, `origin`, and moves along `free`, the directions that change nothing
above it: dθ = origin + free w. Its variables x = (y, z) are

    y, the coordinates in which the level's cost is ½‖y - t‖² and no more (see `subspaces.Range`),
    z, along the directions this level does not feel: they cost nothing.

This change of variables preconditions the problem (the Hessian is diag(1, 0)) without solving it: the solver gets the
residual objective and every row that can move. Rows are divided by their norms, and y is counted in units of the level's
own target, so that steps of millimetres do not drown in solver tolerances. For a soft level y is the excess itself.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.problem import IKProblem, Level
from prioritized_ik.solvers.blocks import HARD, EqualBlock
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.tolerances import EXCEEDED, FAR_SLACK
from prioritized_ik.validation import Array, lengths

if TYPE_CHECKING:
    import qpsolvers


@dataclass(frozen=True)
class Stage:
    """One QP in scaled variables x `(v,)`, and the way back: dθ = `origin` + `basis` @ x.

    Attributes:
        problem: minimise ½ xᵀPx + qᵀx subject to Gx <= h, and of a stage to be solved as it stands also Ax = b: any
            qpsolvers backend can be called on it.
        origin: dθ at x = 0 `(m,)`.
        basis: `(m, v)`.
        unfelt: orthonormal joint directions `(m, v - costed)` that the cost does not feel.
        place: its position in the fold over levels, from 0.
        row_ids: which of the hierarchy's pooled rows each row of G is `(r,)`.
        exceeded: of a soft level, which of the rows `(r,)` are exceeded at the variables x; None of another.
    """

    problem: "qpsolvers.Problem"
    origin: Array
    basis: Array
    unfelt: Array
    place: int
    row_ids: NDArray[np.int_]
    exceeded: Callable[[Array], NDArray[np.bool_]] | None = None

    def dtheta(self, x: Array) -> Array:
        """Return the step u `(m,)`, in the joint metric, at the variables `x`; dθ where the metric is ones."""
        return self.origin + self.basis @ x

    @property
    def size(self) -> int:
        """Number of variables v."""
        return self.basis.shape[1]

    @property
    def costed(self) -> int:
        """How many of the variables, the first ones, the cost feels."""
        return self.size - self.unfelt.shape[1]


@dataclass(frozen=True)
class FoldState:
    """What the levels so far leave to the next.

    Attributes:
        hierarchy: the problem, its levels cut to their rank.
        place: how many levels there were.
        origin: their answer `(m,)` [rad], or the shortest step that keeps the equalities before the first.
        free: orthonormal directions `(m, f)` that change nothing above.
        row_ids: the pooled rows that count and can still move `(r,)`.
        slack: how far `origin` is from each `(r,)` [rad]; once a stage is solved not negative, so that `origin` itself is
            feasible.
        settled: rows that move by no more than this fraction of their length do not count.
    """

    hierarchy: Hierarchy
    place: int
    origin: Array
    free: Array
    row_ids: NDArray[np.int_]
    slack: Array
    settled: float

    @staticmethod
    def whole(hierarchy: Hierarchy, settled: float = 0.0) -> "FoldState":
        """Return the state before the first level: everything that the equalities leave.

        Args:
            hierarchy: the problem.
            settled: of rows, if more than what is rounding, `hierarchy.settled`.
        """
        settled = max(settled, hierarchy.settled)
        rows, free = hierarchy.rows, hierarchy.free
        hard = np.flatnonzero(rows.level == HARD)
        hard = hard[rows.reach(hard, free) > settled]
        return FoldState(hierarchy, 0, hierarchy.start, free, hard, rows.slack(hierarchy.start)[hard], settled)

    @property
    def rows(self) -> Array:
        """The rows that count `(r, m)`, of unit length."""
        return self.hierarchy.rows.matrix[self.row_ids]

    def after(self, origin: Array, free: Array) -> "FoldState":
        """Return the state once `origin` is reached and only `free` directions are left.

        What the stage just solved broke by rounding, the next may keep. The rows of a soft level just solved join: none may
        be exceeded by more than it is.
        """
        own = np.flatnonzero(self.hierarchy.rows.level == self.place)
        ids = np.concatenate([self.row_ids, own])
        rows = self.hierarchy.rows
        ids = ids[rows.reach(ids, free) > self.settled]
        slack = np.maximum(rows.slack(origin)[ids], 0.0)
        return FoldState(self.hierarchy, self.place + 1, origin, free, ids, slack, self.settled)

    def without(self, free: Array) -> "FoldState":
        """Return the state with only `free` directions left."""
        moving = self.hierarchy.rows.reach(self.row_ids, free) > self.settled
        return replace(self, free=free, row_ids=self.row_ids[moving], slack=self.slack[moving])


def level_stage(state: FoldState) -> Stage:
    """Return the QP of the state's level."""
    level, block = state.hierarchy.problem.levels[state.place], state.hierarchy.blocks[state.place]
    return _equal_stage(level, block, state) if isinstance(block, EqualBlock) else _soft_stage(level, state)


def reference_stage(state: FoldState) -> Stage:
    """Return the QP of the last level, min ‖dθ - r‖², whose cost feels every variable."""
    target = state.free.T @ (state.hierarchy.problem.reference - state.origin)
    unit = max(np.linalg.norm(target), np.linalg.norm(state.origin))
    return _scaled_stage(state, state.free, state.free[:, :0], target, float(unit) or 1.0, FAR_SLACK)


def _equal_stage(level: Level, block: EqualBlock, state: FoldState) -> Stage:
    felt = block.within(state.free)
    target = felt.project(block.missing(state.origin))
    unit = max(np.linalg.norm(target), np.linalg.norm(np.sqrt(level.weights) * level.target))
    return _scaled_stage(state, felt.felt, felt.unfelt, target, float(unit) or 1.0, np.inf)


def _qp(*sides: Array | None) -> "qpsolvers.Problem":
    """Return the QP of these sides. qpsolvers imports every solver there is, so it waits until a stage is made."""
    import qpsolvers

    return qpsolvers.Problem(*sides)


def _soft_stage(level: Level, state: FoldState) -> Stage:
    """Return min ½‖w‖² over the excesses w `(k,)` of the level's rows, first variables, and all directions left."""
    rows = state.hierarchy.rows
    own = np.flatnonzero(rows.level == state.place)
    slack, strengths = rows.slack(state.origin)[own], rows.strengths[own]
    excess = strengths * np.maximum(-slack, 0.0)  # at x = 0, so that it is feasible
    unit = float(max(np.linalg.norm(excess), np.linalg.norm(np.sqrt(level.weights) * level.target))) or 1.0
    k, f = len(own), state.free.shape[1]
    basis = np.hstack([np.zeros((len(state.origin), k)), state.hierarchy.length * state.free])
    matrix = rows.matrix[np.concatenate([state.row_ids, own])] @ basis
    matrix[len(state.row_ids) :, :k] = -np.diag(unit / strengths)
    upper = np.concatenate([state.slack, slack + excess / strengths])
    norms = lengths(matrix)
    hessian = np.diag(np.repeat([1.0, 0.0], [k, f]))
    linear = np.concatenate([excess / unit, np.zeros(f)])
    qp = _qp(hessian, linear, matrix / norms[:, None], upper / norms)

    def exceeded(x: Array) -> NDArray[np.bool_]:
        return np.concatenate([np.zeros(len(state.row_ids), dtype=bool), x[:k] + excess / unit > EXCEEDED])

    ids = np.concatenate([state.row_ids, own])
    return Stage(qp, state.origin, basis, state.free, state.place, ids, exceeded=exceeded)


def damped_stage(problem: IKProblem, level: Level, damping: float) -> Stage:
    """Return the one QP that mink and pink would solve: min (b - A dθ)ᵀW(b - A dθ) + damping ‖dθ - r‖², in dθ itself.

    A different problem from Eqs. (12) to (14), for comparison: it is not scaled.
    """
    m, rows, fixed = problem.joint_count, problem.inequalities, problem.equalities
    weighted = level.weights[:, None] * level.matrix
    hessian = level.matrix.T @ weighted + damping * np.eye(m)
    linear = -weighted.T @ level.target - damping * problem.reference
    matrix = np.vstack([rows.matrix, fixed.matrix, -fixed.matrix])
    upper = np.concatenate([rows.upper, fixed.target, -fixed.target])
    qp = _qp(hessian, linear, *((matrix, upper) if len(upper) else (None, None)))
    return Stage(qp, np.zeros(m), np.eye(m), np.zeros((m, 0)), 0, np.arange(len(upper)))


def slack_stage(problem: IKProblem, level: Level, damping: float) -> Stage:
    """Return the same optimum as a QP in x = (dθ, s): min sᵀWs + damping ‖dθ - r‖² with A dθ + s = b.

    Where `damped_stage` squares A, here the Hessian is diagonal and A a row of the constraints: no digit is lost before the
    solver starts. Equalities are passed as such, A and b of the QP.
    """
    m, k, rows, fixed = problem.joint_count, len(level.target), problem.inequalities, problem.equalities
    hessian = np.diag(np.concatenate([np.full(m, damping), level.weights]))
    linear = np.concatenate([-damping * problem.reference, np.zeros(k)])
    of_equalities = np.hstack([fixed.matrix, np.zeros((len(fixed.target), k))])
    matrix = np.vstack([np.hstack([level.matrix, np.eye(k)]), of_equalities])
    target = np.concatenate([level.target, fixed.target])
    sides = (np.hstack([rows.matrix, np.zeros((len(rows.upper), k))]), rows.upper) if len(rows.upper) else (None, None)
    qp = _qp(hessian, linear, *sides, matrix, target)
    basis = np.eye(m, m + k)
    return Stage(qp, np.zeros(m), basis, np.zeros((m, 0)), 0, np.arange(len(rows.upper)))


def _scaled_stage(state: FoldState, felt: Array, unfelt: Array, target: Array, unit: float, far: float) -> Stage:
    """Return min ½‖y - target / unit‖² with dθ = origin + unit felt y + unfelt z and all rows that can move."""
    costed = felt.shape[1]
    basis = np.hstack([unit * felt, state.hierarchy.length * unfelt])
    hessian = np.diag(np.repeat([1.0, 0.0], [costed, unfelt.shape[1]]))
    linear = np.concatenate([-target / unit, np.zeros(unfelt.shape[1])])
    if not len(state.row_ids):
        return Stage(_qp(hessian, linear), state.origin, basis, unfelt, state.place, state.row_ids)
    rows = state.rows @ basis
    norms = lengths(rows)
    qp = _qp(hessian, linear, rows / norms[:, None], np.minimum(state.slack / norms, far))
    return Stage(qp, state.origin, basis, unfelt, state.place, state.row_ids)
