"""An oracle of 150 digits for problems on a kinematic tree: which rows a step may rest on; nothing shared with the library.

Rows are worked out from axes, anchors and points as they are given, to the last bit, so that what depends on each other
does so exactly: links keep their lengths. What rows of unit length feel by less than `ROUNDING` is rounding, and not felt:
by as much, the levels below may move a level's rows, and what that leaves of a residual is not the level's to balance. Rows
that differ by as little are one, and so are sides that differ by as little of what the step moves them: a level that misses
no more is met, and holds nothing.
"""

import decimal
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

import numpy as np
from scipy.optimize import linprog

ROUNDING = 1e-12
#: [of a level's gradient] A multiplier below is none: directions that are not felt give such. Below -5 times it, one pulls.
FAINT = 2e-12
DIGITS = 150
NONE = Decimal(0)

Vector = np.ndarray[Any, np.dtype[Any]]  # of Decimal


@dataclass(frozen=True)
class Verdict:
    """What is true of a face: of the step where some bounds and rows are equalities.

    Attributes:
        u: the strict optimum there `(m,)`.
        slack: the least of all other bounds and rows, as a distance.
        missed: the most by which one is missed that should be an equality.
        pulls: by what hold the step back at no level above and pull at this one: its number and their names.
    """

    u: np.ndarray[Any, np.dtype[np.float64]]
    slack: float
    missed: float
    pulls: tuple[tuple[int, str], ...]

    @property
    def is_optimum(self) -> bool:
        """Whether that is the optimum of the whole problem."""
        return self.slack > -1e-9 and self.missed < 1e-9 and not self.pulls


def judged(problem: Any, names: Iterable[str]) -> Verdict:
    """Return what is true of the face where the bounds and rows of these names are equalities."""
    with decimal.localcontext() as context:
        context.prec = DIGITS
        return _Judge(problem).verdict(tuple(names))


class _Judge:
    def __init__(self, problem: Any) -> None:
        m = problem.joint_count
        self._eye = _exact(np.eye(m))
        rows = [self._eye, -self._eye, *([_rows(problem.rows.points)] if len(problem.rows.upper) else [])]
        uppers = (problem.bounds.upper, -problem.bounds.lower, problem.rows.upper)
        self._rows, self._upper = np.vstack(rows), np.concatenate([_exact(some) for some in uppers])
        bounds = [f"{name} {side}" for side in ("upper", "lower") for name in problem.bounds.names]
        self._names = [*bounds, *problem.rows.names]
        roots = [np.array([w.sqrt() for w in _exact(level.weights)]) for level in problem.levels]
        self._matrices = [_rows(one.points) * w[:, None] for one, w in zip(problem.levels, roots, strict=True)]
        self._targets = [_exact(one.target) * w for one, w in zip(problem.levels, roots, strict=True)]
        self._matrices.append(self._eye)
        self._targets.append(_exact(problem.reference))

    def verdict(self, names: tuple[str, ...]) -> Verdict:
        active = [self._names.index(name) for name in names]
        u, missed = self._face(active)
        slack = self._upper - self._rows @ u
        others = np.delete(slack, active)
        pulls = tuple(self._pulls(u, missed, active))
        return Verdict(u.astype(float), float(min(others)), max((abs(float(slack[i])) for i in active), default=0.0), pulls)

    def _face(self, active: list[int]) -> tuple[Vector, list[Vector]]:
        """Return the optimum of the face, and what each level misses, before those below it move on."""
        rows, free = self._rows[active], self._eye
        u, missed = np.full(len(free), NONE), []
        for matrix, target in [(rows, self._upper[active]), *zip(self._matrices, self._targets, strict=True)]:
            felt, left = _parted(matrix, free)
            if len(felt):
                u = u + felt.T @ _least_squares(matrix @ felt.T, target - matrix @ u)
            free = left
            missed.append(matrix @ u - target)
        return u, missed[1:]

    def _pulls(self, u: Vector, missed: list[Vector], active: list[int]) -> Iterable[tuple[int, str]]:
        """Yield what pulls: multipliers of active rows balance each level's gradient in what the levels above leave."""
        free, held = self._eye, np.zeros(len(active), dtype=bool)
        levels = zip(self._matrices, self._targets, missed, strict=True)
        for number, (matrix, target, missing) in enumerate(levels, 1):
            strength = _length(matrix.ravel())
            if _length(missing) <= Decimal(ROUNDING) * strength * _length(u):
                free = _parted(matrix, free)[1]
                continue
            gradient = matrix.T @ missing
            size = max(_length(gradient), Decimal("1e-10") * strength * _length(target), Decimal("1e-300"))
            found = _multipliers(free @ self._rows[active].T, -(free @ gradient) / size, held)
            for i in np.flatnonzero(~held & (found < -5.0 * FAINT)):
                yield number, self._names[active[i]]
            held |= found > FAINT
            free = _parted(matrix, free)[1]


def _multipliers(normals: Vector, side: Vector, held: Any) -> Any:
    """Return λ with `normals` @ λ = `side`, those that are not `held` at least zero, and as many above as may be."""
    moving = [j for j in range(normals.shape[1]) if _length(normals[:, j]) > ROUNDING]  # levels above settle the others
    chosen = _independent(normals[:, moving].T)
    basis = [moving[i] for i in chosen]
    found = np.zeros(normals.shape[1])
    if not basis:
        return found
    own = normals[:, basis]
    found[basis] = _least_squares(own, side).astype(float)
    rest = [j for j in moving if j not in basis]
    signed = np.flatnonzero(~held)
    if rest and len(signed):
        ways = np.zeros((len(found), len(rest)))
        for i, j in enumerate(rest):
            ways[j, i] = 1.0
            ways[basis, i] = -_least_squares(own, normals[:, j]).astype(float)
        n, c = len(rest), len(signed)
        # The sum of the λ, each up to a bit, is the largest.
        best = linprog(
            np.r_[np.zeros(n), -np.ones(c)],
            A_ub=np.hstack([-ways[signed], np.eye(c)]),
            b_ub=found[signed] + 1e-13,
            bounds=[(None, None)] * n + [(0.0, 1e-2)] * c,
        )
        if best.x is not None:
            found += ways @ best.x[:n]
    return found


def _rows(points: Any) -> Vector:
    """Return the matrix `(k, m)` of rows of points on a tree."""
    tree, m = points.tree, points.tree.joint_count
    angular, linear, anchors = _exact(tree.angular), _exact(tree.linear), _exact(tree.anchors)
    at, along = _exact(points.points), _exact(points.directions)
    out = np.full((len(at), m), NONE)
    for i, joint in enumerate(points.joints.tolist()):
        while joint >= 0:
            out[i, joint] = along[i] @ (_crossed(angular[joint], at[i] - anchors[joint]) + linear[joint])
            joint = int(tree.parents[joint])
    return out


def _parted(matrix: Vector, free: Vector) -> tuple[Vector, Vector]:
    """Return orthonormal rows of what a matrix feels of `free` directions, orthonormal rows too, and of what it leaves."""
    sizes = [max(_length(row), Decimal("1e-300")) for row in matrix]
    seen = np.array([row / size for row, size in zip(matrix, sizes, strict=True)]).reshape(matrix.shape) @ free.T
    felt = _orthonormal(seen, len(seen))
    left = _orthonormal(_exact(np.eye(len(free))) - felt.T @ felt, len(free) - len(felt))
    return felt @ free, left @ free


def _orthonormal(rows: Vector, most: int) -> Vector:
    """Return orthonormal rows that span `rows` `(n, m)`, `most` of them at most, the longest first."""
    found: list[Vector] = []
    left = list(rows)
    while left and len(found) < most:
        sizes = [_length(row) for row in left]
        best = max(range(len(left)), key=sizes.__getitem__)
        if sizes[best] <= ROUNDING:
            break
        unit = left.pop(best) / sizes[best]
        for one in found:
            unit = unit - (one @ unit) * one
        found.append(unit / _length(unit))
        left = [row - (row @ found[-1]) * found[-1] for row in left]
    return np.array(found, dtype=object).reshape(len(found), rows.shape[1])


def _independent(rows: Vector) -> list[int]:
    """Return the numbers of rows that span all `rows`, the longest first."""
    chosen: list[int] = []
    left = dict(enumerate(rows))
    while left:
        best = max(left, key=lambda i: _length(left[i]))
        row = left.pop(best)
        size = _length(row)
        if size <= ROUNDING:
            break
        chosen.append(best)
        left = {i: other - (other @ row) / size**2 * row for i, other in left.items()}
    return chosen


def _least_squares(matrix: Vector, side: Vector) -> Vector:
    """Return x nearest to `matrix` @ x = `side`, of full column rank, by the normal equations: there are digits to lose."""
    table = np.hstack([matrix.T @ matrix, (matrix.T @ side)[:, None]])
    n = len(table)
    for k in range(n):
        best = max(range(k, n), key=lambda i: abs(table[i, k]))
        table[[k, best]] = table[[best, k]]
        table[k] = table[k] / table[k, k]
        for i in range(n):
            if i != k:
                table[i] = table[i] - table[i, k] * table[k]
    return table[:, n]


def _crossed(a: Sequence[Decimal], b: Sequence[Decimal]) -> Vector:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _length(vector: Vector) -> Decimal:
    return Decimal(sum(vector * vector, NONE)).sqrt()


def _exact(values: Any) -> Vector:
    array = np.asarray(values, dtype=float)
    return np.array([Decimal(value) for value in array.ravel().tolist()], dtype=object).reshape(array.shape)
