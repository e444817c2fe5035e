"""One level of a problem on a kinematic tree as one sparse QP.

A stage starts at the answer of the stage before, `origin`, and its variables are x = (y, d, ω_1, v_1, ω_2, …): what the
level lacks, y = W^½ (A u - b), so that the cost is ½‖y‖² and W is squared nowhere; the step d from the origin; and the
motions of the links that go with it, see `motion.py`. What a level above achieved is kept by A_j d = 0, which the origin
does to the last digit, and a bound or row that a level above rests on is an equality from then on. Rows are divided by
their norms, y is counted in what the level lacks at the origin, and d in the size of step that the levels ask for. The last
stage has no y: its cost is ½‖d - (r - origin)‖².

Unlike `solvers.stages` no level is cut to its rank, as that would take a factorisation of the whole level: a rank tolerance
is the kernel's, which starts from these answers.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from prioritized_ik.errors import InputError
from prioritized_ik.kinematic_tree import BASE, KinematicTree, PointRows
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.lifted.motion import LinkMotions
from prioritized_ik.tolerances import GUESS, HELD_MULTIPLIER, HELD_SLACK
from prioritized_ik.tree_problem import TreeLevel, TreeRows
from prioritized_ik.validation import Array, length

if TYPE_CHECKING:
    import qpsolvers

Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class LiftedStage:
    """One sparse QP, and the way back: u = `origin` + `basis` @ x.

    Attributes:
        problem: minimise ½ xᵀPx + qᵀx subject to Gx <= h, Ax = b and lb <= x <= ub, all matrices sparse by columns.
        origin: u at x = 0 `(m,)`, in the joint metric.
        basis: sparse `(m, v)`.
        costed: how many of the variables, the first ones, the cost feels.
        place: its position in the fold over levels, from 0.
        row_ids: which of the problem's inequality rows each row of G is `(r,)`.
        joints: the variables that are joints' steps.
    """

    problem: "qpsolvers.Problem"
    origin: Array
    basis: scipy.sparse.csr_matrix
    costed: int
    place: int
    row_ids: NDArray[np.int_]
    joints: slice

    def dtheta(self, x: Array) -> Array:
        """Return the step u `(m,)`, in the joint metric, at the variables `x`."""
        return self.origin + self.basis @ x

    @property
    def size(self) -> int:
        """Number of variables v."""
        return self.basis.shape[1]


class LiftedProblem:
    """A problem on a kinematic tree in its joint metric, as the stages need it.

    Attributes:
        problem: as it was given.
        levels: its levels.
        motions: of the links that levels and rows concern.
        lower, upper, reference: in the metric `(m,)`.
        contacts: inequality rows of points that move `(r,)`.
        sides: of these `(r,)`.
        step: size of step that the levels ask for, as far as the bounds allow it [of the metric].

    Raises:
        InputError: there is no tree; the message says what holds a matrix.
    """

    def __init__(self, problem: IKProblem) -> None:
        tree = required_tree(problem)
        root = problem.metric_root
        self.problem = problem
        self.levels = [level for level in problem.levels if isinstance(level, TreeLevel)]
        self._tree = tree if bool((root == 1.0).all()) else tree.scaled(1.0 / root)
        bounds = problem.bounds
        self.lower, self.upper, self.reference = bounds.lower * root, bounds.upper * root, problem.reference * root
        rows = problem.rows.points if isinstance(problem.rows, TreeRows) else self.levels[0].points[:0]
        self._real = np.isfinite(problem.rows.upper) & (rows.joints != BASE)
        self.contacts, self.sides = rows[self._real].on(self._tree), problem.rows.upper[self._real]
        self._points = [level.points.on(self._tree) for level in self.levels]
        self.motions = LinkMotions.of(self._tree, _joined(self._tree, [*self._points, self.contacts]))

    @cached_property
    def counted(self) -> list[Mask]:
        """Which of each level's rows say anything: those of a weight, on points that move."""
        return [(level.weights > 0.0) & (level.points.joints != BASE) for level in self.levels]

    @cached_property
    def rows(self) -> list[scipy.sparse.csc_matrix]:
        """Each level's rows that count, of the links' motions, of unit length; `norms` has what they were divided by."""
        return [
            _scaled(self.motions.rows_of(self._points[i][kept]), 1.0 / self.norms[i]) for i, kept in enumerate(self.counted)
        ]

    @cached_property
    def norms(self) -> list[Array]:
        """Length of each of these rows `(k,)`, per `unit`."""
        return [self._lengths(points[kept]) for points, kept in zip(self._points, self.counted, strict=True)]

    @cached_property
    def contact_norms(self) -> Array:
        """Length of each inequality row `(r,)`, per `unit`."""
        return self._lengths(self.contacts)

    @cached_property
    def contact_rows(self) -> scipy.sparse.csr_matrix:
        """The inequality rows of the links' motions, of unit length."""
        return _scaled(self.motions.rows_of(self.contacts), 1.0 / self.contact_norms).tocsr()

    @cached_property
    def step(self) -> float:
        """Size of step that the levels ask for, as far as the bounds allow it."""
        asked = [
            float(np.abs(level.target[kept] / norms).max(initial=0.0)) / self.motions.unit
            for level, kept, norms in zip(self.levels, self.counted, self.norms, strict=True)
        ]
        wanted = max(asked) or float(np.abs(self.reference).max(initial=0.0))
        sides = np.abs(np.concatenate([self.lower, self.upper]))
        allowed = float(sides[np.isfinite(sides)].max(initial=0.0))
        return (min(wanted, allowed) if allowed and wanted else wanted or allowed) or 1.0

    def missing(self, number: int, u: Array) -> Array:
        """Return what each row of a level that counts lacks at `u`, b - A u `(k,)`."""
        kept = self.counted[number]
        return self.levels[number].target[kept] - self._points[number][kept].times(u)

    def slack(self, u: Array) -> Array:
        """Return how far `u` is from each inequality row, in the row's own unit `(r,)`."""
        return self.sides - self.contacts.times(u)

    def rests_on(self, u: Array) -> tuple[str, ...]:
        """Return the names of the bounds and rows that a step `(m,)` seems to rest on, those of frozen joints left out."""
        near, names, free = GUESS * length(u), self.problem.bounds.names, self.lower != self.upper
        rows = np.flatnonzero(self._real)
        close = self.slack(u) <= near * self.motions.unit * self.contact_norms
        return (
            *(f"{names[j]} upper" for j in np.flatnonzero(free & (self.upper - u <= near))),
            *(f"{names[j]} lower" for j in np.flatnonzero(free & (u - self.lower <= near))),
            *(self.problem.rows.names[i] for i in rows[close]),
        )

    def _lengths(self, points: PointRows) -> Array:
        rows = self.motions.rows_of(points)
        squares = np.asarray(rows.multiply(rows).sum(axis=1)).ravel()
        return np.where(squares > 0.0, np.sqrt(squares), 1.0)


@dataclass(frozen=True, eq=False)
class LiftedState:
    """What the levels so far leave to the next.

    Attributes:
        lifted: the problem.
        place: how many levels there were.
        origin: their answer `(m,)`.
        lower, upper: how far the origin is from the bounds `(m,)`; once a stage is solved of the wrong sign nowhere.
        slack: how far it is from each inequality row `(r,)`; likewise.
        held_joints: which joints rest on a bound for good `(m,)`.
        held_rows: on which rows it rests for good `(r,)`.
    """

    lifted: LiftedProblem
    place: int
    origin: Array
    lower: Array
    upper: Array
    slack: Array
    held_joints: Mask
    held_rows: Mask

    @staticmethod
    def whole(lifted: LiftedProblem) -> "LiftedState":
        """Return the state before the first level."""
        frozen = lifted.lower == lifted.upper
        origin = np.where(frozen, lifted.lower, 0.0)
        slack = lifted.slack(origin)
        return LiftedState(
            lifted, 0, origin, lifted.lower - origin, lifted.upper - origin, slack, frozen, np.zeros(len(slack), dtype=bool)
        )

    @property
    def is_feasible(self) -> bool:
        """Whether the origin itself keeps every bound and row."""
        return bool((self.lower <= 0.0).all() and (self.upper >= 0.0).all() and (self.slack >= 0.0).all())

    def after(self, stage: LiftedStage, x: Array, of_bounds: Array, of_rows: Array) -> "LiftedState":
        """Return the state once a stage is solved. What it rests on with a multiplier holds for the levels below.

        Args:
            stage: that was solved.
            x: its optimum `(v,)`.
            of_bounds: multipliers of the variables' bounds `(v,)`, above zero at upper ones.
            of_rows: multipliers of its rows `(r,)`.
        """
        lifted, origin = self.lifted, stage.dtheta(x)
        lower = np.minimum(lifted.lower - origin, 0.0)
        upper = np.maximum(lifted.upper - origin, 0.0)
        slack = np.maximum(lifted.slack(origin), 0.0)
        pulls, rows = np.abs(of_bounds[stage.joints]), np.zeros(len(slack))
        rows[stage.row_ids] = of_rows
        least = HELD_MULTIPLIER * max(float(pulls.max(initial=0.0)), float(rows.max(initial=0.0)), 1.0)
        room = np.where(of_bounds[stage.joints] > 0.0, upper, -lower) / lifted.step
        room_of_rows = slack / (lifted.step * lifted.motions.unit * lifted.contact_norms)
        return LiftedState(
            lifted,
            self.place + 1,
            origin,
            lower,
            upper,
            slack,
            self.held_joints | _rested_on(pulls, room, least),
            self.held_rows | _rested_on(rows, room_of_rows, least),
        )

    def skipped(self) -> "LiftedState":
        """Return the state after a level that the origin already is the optimum of."""
        return replace(self, place=self.place + 1)


def level_stage(state: LiftedState) -> LiftedStage | None:
    """Return the QP of the state's level; None if the origin lacks nothing of it and is feasible."""
    lifted, number = state.lifted, state.place
    rows, norms, kept = lifted.rows[number], lifted.norms[number], lifted.counted[number]
    roots, lacking = np.sqrt(lifted.levels[number].weights[kept]), lifted.missing(number, state.origin)
    unit = length(roots * lacking) or length(roots * lifted.levels[number].target[kept])
    if state.is_feasible and not (roots * lacking).any():
        return None
    per_row = lifted.step * lifted.motions.unit * norms  # what a row makes of its variables
    factors = roots * per_row / (unit or 1.0)
    own = scipy.sparse.hstack([scipy.sparse.diags(-1.0 / factors), rows])
    hessian = np.repeat([1.0, 0.0], [len(norms), lifted.motions.size])
    target = lacking / per_row
    return _stage(state, hessian, np.zeros(len(hessian)), own, target, lifted.step)


def reference_stage(state: LiftedState) -> LiftedStage:
    """Return the QP of the last level, min ‖u - r‖²."""
    lifted = state.lifted
    target = lifted.reference - state.origin
    step = max(float(np.abs(target).max()), float(np.abs(state.origin).max())) or 1.0
    hessian, linear = np.zeros(lifted.motions.size), np.zeros(lifted.motions.size)
    hessian[: len(target)], linear[: len(target)] = 1.0, -target / step
    return _stage(state, hessian, linear, None, np.zeros(0), step)


def _stage(
    state: LiftedState, hessian: Array, linear: Array, own: scipy.sparse.spmatrix | None, target: Array, step: float
) -> LiftedStage:
    """Return the QP of a diagonal `hessian` and of the rows of the level itself, if it has `own` ones."""
    import qpsolvers  # imports every solver there is, so it waits until a stage is made

    lifted, m = state.lifted, len(state.origin)
    k = len(hessian) - lifted.motions.size
    kept = [lifted.motions.equations, *lifted.rows[: state.place]]
    kept.append(scipy.sparse.eye(lifted.motions.size, format="csr")[np.flatnonzero(state.held_joints)])
    kept.append(lifted.contact_rows[state.held_rows])
    above = scipy.sparse.vstack(kept)
    equalities = scipy.sparse.hstack([scipy.sparse.csc_matrix((above.shape[0], k)), above])
    sides = np.zeros(above.shape[0])
    if own is not None:
        equalities, sides = scipy.sparse.vstack([equalities, own]), np.concatenate([sides, target])
    free = ~state.held_rows
    rows, upper = None, None
    if free.any():
        some = lifted.contact_rows[free]
        rows = scipy.sparse.hstack([scipy.sparse.csc_matrix((some.shape[0], k)), some]).tocsc()
        upper = state.slack[free] / (step * lifted.motions.unit * lifted.contact_norms[free])
    least, most = np.full(len(hessian), -np.inf), np.full(len(hessian), np.inf)
    joints, loose = slice(k, k + m), ~state.held_joints
    least[joints][loose], most[joints][loose] = state.lower[loose] / step, state.upper[loose] / step
    qp = qpsolvers.Problem(scipy.sparse.diags(hessian).tocsc(), linear, rows, upper, equalities.tocsc(), sides, least, most)
    basis = scipy.sparse.eye(m, len(hessian), k=k, format="csr") * step
    return LiftedStage(qp, state.origin, basis, int(hessian.sum()), state.place, np.flatnonzero(free), joints)


def required_tree(problem: IKProblem) -> KinematicTree:
    """Return the tree of a problem all of whose levels and rows are on it.

    Raises:
        InputError: there is none; the message says what holds a matrix, or another tree.
    """
    parts: list[tuple[str, object]] = [(f"level {level.name!r}", level) for level in problem.levels]
    parts += [("the inequality rows", problem.rows)] if len(problem.rows.upper) else []
    held = "a matrix, and the lifted form is made of a kinematic tree"
    tree: KinematicTree | None = None
    for what, part in parts:
        if not isinstance(part, TreeLevel | TreeRows):
            kind = "TreeLevel" if what.startswith("level") else "TreeRows"
            soft = ", soft inequalities," if getattr(part, "is_soft", False) else ""
            raise InputError(f"{what}{soft} holds {held}; give it as {kind}, or solve by 'lexicographic'.")
        if tree is not None and part.points.tree is not tree:
            raise InputError(f"{what} is on another kinematic tree than {parts[0][0]}; expected one tree for all.")
        tree = part.points.tree
    if tree is None or not problem.levels:
        raise InputError("the problem has no level, and so no kinematic tree to lift; solve it by 'lexicographic'.")
    if len(problem.equalities.target):
        raise InputError(f"equality {problem.equalities.names[0]!r} holds {held}; solve by 'lexicographic'.")
    if problem.metric.ndim != 1:
        raise InputError("the metric is a matrix, which couples all joints; the lifted form takes a diagonal one `(m,)`.")
    return tree


def _rested_on(multipliers: Array, room: Array, least: float) -> Mask:
    """Return on which bounds or rows a stage rests: of multiplier and room left, one is zero: the room."""
    return (multipliers > np.maximum(room, least)) & (room <= HELD_SLACK)


def _joined(tree: KinematicTree, parts: list[PointRows]) -> PointRows:
    return PointRows.trusted(
        tree,
        np.concatenate([part.joints for part in parts]),
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.directions for part in parts]),
    )


def _scaled(matrix: scipy.sparse.spmatrix, factors: Array) -> scipy.sparse.csc_matrix:
    """Return the rows of a sparse `matrix` times `factors`."""
    return (scipy.sparse.diags(factors) @ matrix).tocsc()
