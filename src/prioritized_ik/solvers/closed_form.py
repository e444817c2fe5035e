"""The paper's closed form (Sec. 3, Eqs. 6-17), one function an equation.

dX_v = J dθ with J `(L, m)` of rank p is solved in two steps: J = J_a J_b with both factors of full rank p; then weighted
least squares for dX_b = J_b dθ, and the least-norm dθ for that. No product JᵀWJ is formed: weights 200 and 0.01 alone
would square to a condition number near 2e8.

Shapes throughout: J_a `(L, p)` and J_b `(p, m)`, both of full rank; `weights`, the diagonal of W, `(L,)`; `dx_desired`
`(L,)` [m]; `dx_b` `(p,)`; `reference`, r, `(m,)` [rad].
"""

import math
from dataclasses import dataclass
from enum import Enum
from functools import cached_property

import numpy as np
import scipy.linalg

from prioritized_ik.errors import InputError
from prioritized_ik.problem import Level
from prioritized_ik.solvers.subspaces import about_largest, clear_range, singular_values
from prioritized_ik.tolerances import EMPTY, NOISE, WEAKEST
from prioritized_ik.validation import Array, fraction, identity, lengths

#: The rank tolerance of everything that reproduces the paper: singular values up to this fraction of the largest count as
#: zero. Along the windings of the 17-link arm the 34th is below
#: 1e-6 of the first in 18 % of the steps (straight or planar poses: rank 33), above 1e-4 in 79 %, and in between in 3 %. A
#: joint step of 0.1 rad moves an end point by less than 0.05 mm along a direction below 1e-4. Its share of the cost, 1e-8
#: and less, is what solvers then differ about.
RANK_TOLERANCE = 1e-4


class TaskCase(Enum):
    """The three cases of Fig. 3, told apart by the rank p of J `(L, m)`."""

    REDUNDANT = "p = L: every desired displacement is reached, Eq. (16) applies"
    OVERCONSTRAINED = "p = m: one joint step is best, Eq. (17) applies"
    SINGULAR = "p < L and p < m: only Eqs. (12) and (14) together apply"


@dataclass(frozen=True)
class RankDecomposition:
    """J = J_a J_b (Eq. 6): `j_a` `(L, p)` of full column rank, `j_b` `(p, m)` of full row rank."""

    j_a: Array
    j_b: Array

    @property
    def rank(self) -> int:
        """The rank p."""
        return self.j_a.shape[1]


def rank_decomposition_svd(jacobian: Array, rank_tolerance: float = RANK_TOLERANCE) -> RankDecomposition:
    """Eq. (6) by singular values: J_a = U S, J_b = Vᵀ with orthonormal rows.

    Args:
        jacobian: J `(L, m)`.
        rank_tolerance: singular values up to this fraction of the largest are dropped.
    """
    u, s, vt = np.linalg.svd(jacobian, full_matrices=False)
    p = int(np.count_nonzero(s > fraction("rank_tolerance", rank_tolerance) * s.max(initial=0.0)))
    return RankDecomposition(u[:, :p] * s[:p], vt[:p])


def rank_decomposition_qr(jacobian: Array, rank_tolerance: float = RANK_TOLERANCE) -> RankDecomposition:
    """Eq. (6) by QR with column pivoting: J P = Q R, J_a = Q, J_b = R Pᵀ.

    The answer of Eqs. 12 and 14 is that of `rank_decomposition_svd` as long as what is dropped is rounding: the two drop
    different directions where it is not.
    """
    q, r, pivots = scipy.linalg.qr(jacobian, mode="economic", pivoting=True)
    diagonal = np.abs(np.diag(r))
    p = int(np.count_nonzero(diagonal > fraction("rank_tolerance", rank_tolerance) * diagonal[0])) if diagonal.size else 0
    j_b = np.empty((p, jacobian.shape[1]))
    j_b[:, pivots] = r[:p]
    return RankDecomposition(q[:, :p], j_b)


def task_case(jacobian: Array, rank_tolerance: float = RANK_TOLERANCE) -> TaskCase:
    """Return which case of Fig. 3 the stacked Jacobian `(L, m)` is."""
    rank = rank_decomposition_svd(jacobian, rank_tolerance).rank
    if rank == jacobian.shape[0]:
        return TaskCase.REDUNDANT
    return TaskCase.OVERCONSTRAINED if rank == jacobian.shape[1] else TaskCase.SINGULAR


def weighted_cost(j_a: Array, weights: Array, dx_desired: Array, dx_b: Array) -> float:
    """Eq. (10): Q = (dX_v* - J_a dX_b)ᵀ W (dX_v* - J_a dX_b)."""
    residual = dx_desired - j_a @ dx_b
    return float(residual @ (weights * residual))


def weighted_optimum(j_a: Array, weights: Array, dx_desired: Array) -> Array:
    """Eq. (12): dX_b = (J_aᵀWJ_a)⁻¹ J_aᵀW dX_v* `(p,)`, by a QR of W^½ J_a.

    Args:
        j_a: J_a `(L, p)`.
        weights: diagonal of W `(L,)`.
        dx_desired: dX_v* `(L,)` [m].
    """
    root = np.sqrt(weights)
    q, r = np.linalg.qr(root[:, None] * j_a)
    return scipy.linalg.solve_triangular(r, q.T @ (root * dx_desired))


def general_solution(j_b: Array, dx_b: Array, reference: Array) -> Array:
    """Eq. (13): dθ = J_b⁺ dX_b + (I - J_b⁺J_b) r `(m,)`: of all dθ with J_b dθ = dX_b, the nearest to r."""
    q, r = np.linalg.qr(j_b.T)  # J_b⁺ = Q R⁻ᵀ
    return q @ scipy.linalg.solve_triangular(r, dx_b, trans="T") + reference - q @ (q.T @ reference)


def minimum_norm_solution(j_b: Array, dx_b: Array) -> Array:
    """Eq. (14): dθ = J_b⁺ dX_b `(m,)`, Eq. (13) with r = 0."""
    return general_solution(j_b, dx_b, np.zeros(j_b.shape[1]))


def resulting_displacement(j_a: Array, weights: Array, dx_desired: Array) -> Array:
    """Eq. (15): dX_v = J_a (J_aᵀWJ_a)⁻¹ J_aᵀW dX_v* `(L,)`, what the end points really do."""
    return j_a @ weighted_optimum(j_a, weights, dx_desired)


def redundant_solution(jacobian: Array, dx_desired: Array, rank_tolerance: float = RANK_TOLERANCE) -> Array:
    """Eq. (16): dθ = J⁺ dX_v* `(m,)`, for J of full row rank (Fig. 3a).

    Raises:
        InputError: J is of another case; Eqs. (12) and (14) apply to all.
    """
    _require(TaskCase.REDUNDANT, jacobian, rank_tolerance, "Eq. (16)")
    return minimum_norm_solution(jacobian, dx_desired)


def overconstrained_solution(
    jacobian: Array, weights: Array, dx_desired: Array, rank_tolerance: float = RANK_TOLERANCE
) -> Array:
    """Eq. (17): dθ = (JᵀWJ)⁻¹ JᵀW dX_v* `(m,)`, for J of full column rank (Fig. 3b).

    Raises:
        InputError: J is of another case. A plain solve with a singular JᵀWJ would return a step dozens of times too long
            without any error.
    """
    _require(TaskCase.OVERCONSTRAINED, jacobian, rank_tolerance, "Eq. (17)")
    return weighted_optimum(jacobian, weights, dx_desired)


@dataclass(frozen=True)
class Spectrum:
    """Singular values of a level's matrix in the directions left to it, and where they were cut; worked out when looked at.

    Attributes:
        matrix: the level's, in the directions left to it `(k, f)`, as it is cut.
        whole: the level's `(k, m)`, whose largest singular value they are relative to; None for a row's length.
        rank: how many singular values count.
        weakest: about the least of them, relative to that; infinite if there is none.
        is_clear: whether all others are zeros, but for rounding.
    """

    matrix: Array
    whole: Array | None
    rank: int
    weakest: float
    is_clear: bool

    @cached_property
    def _decomposed(self) -> tuple[Array, Array]:
        u, s, _ = np.linalg.svd(self.matrix, full_matrices=False)
        return u, s / largest_singular_value(self.whole)

    @property
    def kept(self) -> Array:
        """Those that count, relative to `relative_to`, the largest first."""
        return self._decomposed[1][: self.rank]

    @property
    def cut(self) -> Array:
        """Those taken for zero."""
        return self._decomposed[1][self.rank :]

    @property
    def cut_rows(self) -> Array:
        """Orthonormal combinations of the rows `(c, k)`, one each value cut, with weights and lengths as given."""
        return self._decomposed[0][:, self.rank :].T

    @property
    def relative_to(self) -> str:
        """What 1 is: the largest of the whole matrix, or a row's length where only rounding is cut."""
        return "a row's length" if self.whole is None else "the largest of the matrix"


def largest_singular_value(matrix: Array | None) -> float:
    """Return the largest singular value of a matrix `(k, m)`; 1 if there is none, or all are zero."""
    return float(np.linalg.norm(matrix, 2) if matrix is not None and matrix.size else 0.0) or 1.0


def level_decomposition(
    level: Level, free: Array, rank_tolerance: float, noise: float = NOISE
) -> tuple[RankDecomposition, Array, Spectrum]:
    """Eq. (6) of what a level can still do in orthonormal `free` directions `(m, f)`, and what it cannot.

    Two rules. What is rounding is always cut, counted in rows of unit length, so that it depends neither on the units of
    rows nor on weights: singular values up to `noise`. What is weak but real is cut only if the caller says so:
    singular values up to `rank_tolerance` of the largest of the level's matrix as it stands.

    The paper's winding needs the second rule: at a straight arm a row is as short as its direction is weak, so that no
    scaling of rows can tell a weak direction from one in smaller units; the user can.

    A QR with pivoting of the rows decides where what it leaves is zero and the rest far from the cut. Elsewhere singular
    values do.

    Returns:
        J_a `(k, p)` and J_b `(p, f)`, whose rows are orthonormal; a basis `(f, f - p)` of what the level does not feel; and
        the singular values.
    """
    matrix, whole = level.matrix if free is identity(len(free)) else level.matrix @ free, None
    limit = max(rank_tolerance, noise)
    if rank_tolerance:
        seen, whole = matrix, level.matrix
        most = math.sqrt(np.vdot(whole, whole))  # at least the largest singular value
    else:
        sizes = lengths(level.matrix)
        seen, most = matrix / np.where(sizes > 0.0, sizes, 1.0)[:, None], 1.0
    clear = clear_range(seen, max(limit, WEAKEST) * most)
    if clear is not None:
        basis, p, weakest = clear
        weakest /= 1.0 if whole is None else about_largest(whole)
        return (
            RankDecomposition(matrix @ basis[:, :p], basis[:, :p].T),
            basis[:, p:],
            Spectrum(seen, whole, p, weakest, True),
        )
    _, s, vt = singular_values(seen, full=len(matrix) < free.shape[1])
    s = s / ((s.max(initial=0.0) or 1.0) if seen is whole else largest_singular_value(whole))
    p = int(np.count_nonzero(s > limit))
    weakest = float(s[p - 1]) if p else np.inf
    # Not U S: its rounding, relative to all of J, would be magnified by the weights.
    factors = RankDecomposition(matrix @ vt[:p].T, vt[:p])
    return factors, vt[p:].T, Spectrum(seen, whole, p, weakest, not (s[p:] > EMPTY).any())


def _require(case: TaskCase, jacobian: Array, rank_tolerance: float, equation: str) -> None:
    found = task_case(jacobian, rank_tolerance)
    square_full = jacobian.shape[0] == jacobian.shape[1] and found is TaskCase.REDUNDANT
    if found is not case and not square_full:
        raise InputError(
            f"{equation} needs the case {case.name} of Fig. 3, but J {jacobian.shape} is {found.name} ({found.value}); "
            "use Eqs. (12) and (14), which apply to every case."
        )
