"""The levels of a problem in coordinates of their own, which is at once their strict closed form.

Each `equal` level is cut to its rank in the directions that equalities and the `equal` levels above leave free, once and
for all: W^½ A free = Q R Vᵀ. It then asks for R Vᵀdθ = c, with orthonormal directions V that no level above feels. Levels
stacked so are block triangular (Hanafusa; Nakamura): from the top down, each is met in its own block and disturbs none
above.
Inequalities do not take part in the cut, so that every solver, the closed form, the polish and the certificate share one
and the same problem. Soft levels (`at_most`) have no block: they are rows.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from prioritized_ik.problem import STEP_FLOOR, IKProblem, Level, step_scale
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE, level_decomposition
from prioritized_ik.validation import Array, lengths

#: A row that moves by less than this fraction of its length along every direction left is settled by the levels above:
#: to divide it by its norm would turn rounding into a constraint. Measured along windings, where the fraction takes every
#: value: up to 2e-7 solvers come to different steps of one cost; cutting at 1e-6, their steps break the row by as much.
SETTLED_ROW = 3e-7

#: Rows of unit length count as dependent where they differ by less than this angle: rounding, and not geometry.
DEPENDENT = 1e-9


@dataclass(frozen=True)
class Whitened:
    """What linear rows feel within some directions, in coordinates y in which their least squares is ‖y - qᵀe‖².

    Attributes:
        felt: `(m, r)`: dθ = `felt` @ y.
        unfelt: orthonormal directions `(m, f - r)` that the rows do not feel.
        q: orthonormal `(p, r)`: from the rows' own coordinates to y; None for the identity.
    """

    felt: Array
    unfelt: Array
    q: Array | None

    def project(self, rows: Array) -> Array:
        """Return `rows` `(p,)`, something counted in the rows' own coordinates, in y `(r,)`."""
        return rows if self.q is None else self.q.T @ rows


def whiten(directions: Array, root: Array, free: Array, dependent: float = DEPENDENT) -> Whitened:
    """Return what the rows `root` @ `directions`ᵀ feel within `free`.

    Args:
        directions: of unit length `(m, p)`, in any position to each other.
        root: `(p, p)`, regular.
        free: orthonormal `(m, f)`.
        dependent: directions that differ by less than this angle within `free` count as one.
    """
    seen = directions.T @ free
    if not seen.size:
        return Whitened(free[:, :0], free, np.zeros((len(seen), 0)))
    basis, triangle, _ = scipy.linalg.qr(seen.T, pivoting=True, check_finite=False)
    r = int(np.count_nonzero(np.abs(np.diag(triangle)) > dependent))
    felt, unfelt = free @ basis[:, :r], free @ basis[:, r:]
    q, triangle = np.linalg.qr(root @ (seen @ basis[:, :r]))
    return Whitened(_divided(felt, triangle), unfelt, q)


def _divided(columns: Array, triangle: Array) -> Array:
    """Return `columns` times the inverse of an upper `triangle`."""
    if not columns.shape[1]:
        return columns
    return scipy.linalg.lapack.dtrtrs(triangle, columns.T, trans=1)[0].T


def _pivoted_qr(matrix: Array) -> tuple[Array, Array, NDArray[np.int_]]:
    """Return Q `(k, p)`, R `(p, p)` and the order of the columns of `matrix` `(k, p)`, k >= p; LAPACK without wrapping."""
    p = matrix.shape[1]
    if p == 0:
        return matrix, np.zeros((0, 0)), np.zeros(0, dtype=int)
    packed, order, scales, _, _ = scipy.linalg.lapack.dgeqp3(matrix)
    return scipy.linalg.lapack.dorgqr(packed, scales)[0], np.triu(packed[:p]), order - 1


@dataclass(frozen=True)
class Task:
    """One `equal` level, cut to its rank p: its cost is ‖`matrix` @ dθ - `target`‖², but for what no step can change.

    Attributes:
        free: orthonormal directions `(m, f)` that the levels above leave.
        felt: V `(m, p)`, orthonormal, the directions that the level decides.
        root: R `(p, p)`, upper triangular: `matrix` @ `felt`.
        inverse: V R⁻¹ `(m, p)`: the shortest steps that change `matrix` @ dθ by one.
        matrix: `(p, m)`; zero on everything below the level.
        target: c `(p,)`.
        below: orthonormal directions `(m, f - p)` left to the levels below.
        demand: length of W^½ b, out of reach or not.
    """

    free: Array
    felt: Array
    root: Array
    inverse: Array
    matrix: Array
    target: Array
    below: Array
    demand: float

    def size(self, length: float) -> float:
        """Return the size of what is subtracted in `missing` for a step of some `length` [rad]."""
        return self.demand + float(np.linalg.norm(self.root)) * length

    def missing(self, dtheta: Array) -> Array:
        """Return c - N dθ `(p,)`: what the step still lacks of what the level can reach."""
        return self.target - self.matrix @ dtheta

    def within(self, free: Array) -> Whitened:
        """Return what the level feels within `free`, some or all of the directions that the levels above leave."""
        if free is self.free:
            return Whitened(self.inverse, self.below, None)
        return whiten(self.felt, self.root, free, SETTLED_ROW)


@dataclass(frozen=True)
class PooledRows:
    """Every inequality of a problem, hard ones first, then the rows of soft levels in order; each of unit length.

    A row's excess and slack are therefore distances in joint space [rad].

    Attributes:
        matrix: `(r, m)`, without what is too little of a row to count as a direction.
        drift: `(r, m)`, that little; the rows are `matrix` + `drift`.
        upper: `(r,)`.
        level: number of the soft level that a row belongs to `(r,)`; `HARD` for hard rows.
        strengths: √w times the row's length before `(r,)`; of no meaning for hard rows.
        names: `(r,)`.
    """

    matrix: Array
    drift: Array
    upper: Array
    level: NDArray[np.int_]
    strengths: Array
    names: tuple[str, ...]

    def slack(self, dtheta: Array) -> Array:
        """Return how far `dtheta` is from each row `(r,)` [rad]; negative where it is exceeded."""
        return self.upper - self.matrix @ dtheta - self.drift @ dtheta

    def reach(self, numbers: NDArray[np.int_], free: Array) -> Array:
        """Return how far rows move along the `free` directions at most, by number, as a fraction of their length."""
        if free.shape[1] == len(free):  # every direction
            return np.ones(len(numbers))
        return lengths(self.matrix[numbers] @ free)

    def within(self, chosen: NDArray[np.bool_], free: Array) -> Whitened:
        """Return what the `chosen` rows feel within `free`."""
        return whiten(self.matrix[chosen].T, np.diag(self.strengths[chosen]), free)


HARD = -1

AMPLE = 3.0  # OSQP loses steps where a step measures one unit or more, ProxQP where it measures a tenth


class Hierarchy:
    """A problem and its levels' blocks.

    Attributes:
        problem: the problem.
        rank_tolerance: what singular values count as zero, relative to the largest of the level's matrix.
        start: the shortest step `(m,)` that keeps the equalities, as far as they can be kept.
        free: orthonormal directions `(m, f)` that the equalities leave.
        tasks: one entry a level; None for a soft one.
        rest: orthonormal directions `(m, f)` that no `equal` level feels: they are the reference's.
    """

    def __init__(self, problem: IKProblem, rank_tolerance: float = RANK_TOLERANCE) -> None:
        self.problem = problem
        self.rank_tolerance = rank_tolerance
        self.start, self.free = _kept(problem)
        self.tasks: list[Task | None] = []
        self.rest = self.free
        for level in problem.levels:
            task = None if level.is_soft else _task(level, self.rest, rank_tolerance)
            self.tasks.append(task)
            self.rest = self.rest if task is None else task.below

    @cached_property
    def rows(self) -> PooledRows:
        """Every inequality of the problem. Rows that are all zero are left out, and rows that a level settles cut to it."""
        hard = self.problem.inequalities
        matrices, uppers, names = [hard.matrix], [hard.upper], list(hard.names)
        numbers, roots = [np.full(len(hard.upper), HARD)], [np.ones(len(hard.upper))]
        for number, level in enumerate(self.problem.levels):
            if level.is_soft:
                matrices.append(level.matrix)
                uppers.append(level.target)
                names += [f"{level.name} row {i + 1}" for i in range(len(level.target))]
                numbers.append(np.full(len(level.target), number))
                roots.append(np.sqrt(level.weights))
        matrix = np.vstack(matrices)
        sizes = lengths(matrix)
        real = sizes > 0.0
        sizes = sizes[real]
        unit = matrix[real] / sizes[:, None]
        drift = np.zeros_like(unit)
        for task in self.tasks:
            if task is not None:
                moved = unit @ task.below
                settled = lengths(moved) <= SETTLED_ROW
                if settled.any():
                    drift[settled] += moved[settled] @ task.below.T
                    unit[settled] -= moved[settled] @ task.below.T
        return PooledRows(
            unit,
            drift,
            np.concatenate(uppers)[real] / sizes,
            np.concatenate(numbers)[real],
            np.concatenate(roots)[real] * sizes,
            tuple(names) if real.all() else tuple(name for name, kept in zip(names, real, strict=True) if kept),
        )

    @cached_property
    def length(self) -> float:
        """What the step may measure [rad]: the closed form, or the median of the rows' slacks if it is less, with room."""
        slack = self.rows.slack(self.start)
        slack = np.sort(slack[slack > 0.0])
        likely = step_scale(self.closed_form)
        return AMPLE * (min(likely, max(STEP_FLOOR, float(slack[len(slack) // 2]))) if len(slack) else likely)

    @cached_property
    def cut_problem(self) -> IKProblem:
        """The problem with every `equal` level's matrix cut to its rank, for solvers that know no rank tolerance."""
        problem = self.problem
        levels = [
            level if task is None else Level(_without(level.matrix, task.below), level.target, level.weights, level.name)
            for level, task in zip(problem.levels, self.tasks, strict=True)
        ]
        return IKProblem(levels, problem.bounds, problem.rows, problem.reference, problem.equalities)

    @cached_property
    def closed_form(self) -> Array:
        """The step `(m,)` of all `equal` levels in strict order, then nearest to the reference, without inequalities."""
        dtheta = self.start
        for task in self.tasks:
            if task is not None:
                dtheta = dtheta + task.inverse @ task.missing(dtheta)
        return dtheta + self.rest @ (self.rest.T @ (self.problem.reference - dtheta))


def strict_solution(levels: Sequence[Level], reference: Array, rank_tolerance: float = RANK_TOLERANCE) -> Array:
    """Return the joint step `(m,)` of all levels in strict order, then the nearest to `reference`, without inequalities.

    Each level is solved by Eqs. (12) and (14) in the directions that the levels before it leave free. With one level it
    is Eqs. (12) and (13).
    """
    return Hierarchy(IKProblem(levels, reference=reference), rank_tolerance).closed_form


def _without(matrix: Array, directions: Array) -> Array:
    """Return `matrix` `(k, m)` with nothing felt along orthonormal `directions` `(m, f)`."""
    return matrix - (matrix @ directions) @ directions.T


def _task(level: Level, free: Array, rank_tolerance: float) -> Task:
    factors, unfelt = level_decomposition(level, free, rank_tolerance)
    weights = np.sqrt(level.weights)
    q, root, order = _pivoted_qr(weights[:, None] * factors.j_a)
    felt = free @ factors.j_b[order].T
    whitening = q.T * weights  # Qᵀ W^½
    matrix = root @ felt.T
    if free.shape[1] < len(free):  # what the levels above decide moves this one too
        whole = whitening @ level.matrix
        matrix = matrix + _without(whole, free)
    target, demand = whitening @ level.target, float(np.linalg.norm(weights * level.target))
    return Task(free, felt, root, _divided(felt, root), matrix, target, free @ unfelt, demand)


def _kept(problem: IKProblem) -> tuple[Array, Array]:
    """Return the shortest step that keeps the equalities, and the directions that they leave free."""
    m, equalities = problem.joint_count, problem.equalities
    sizes = lengths(equalities.matrix)
    real = sizes > 0.0
    if not real.any():
        return np.zeros(m), np.eye(m)
    u, s, vt = np.linalg.svd(equalities.matrix[real] / sizes[real, None], full_matrices=True)
    p = int(np.count_nonzero(s > DEPENDENT * s[0]))
    start = vt[:p].T @ (u[:, :p].T @ (equalities.target[real] / sizes[real]) / s[:p])
    return start, vt[p:].T.copy()
