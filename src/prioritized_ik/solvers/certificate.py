"""Proof that a joint step is the lexicographic optimum, from the problem and the step alone.

At the optimum every level ℓ has multipliers λ with

    A_ℓᵀW_ℓ(A_ℓ dθ - b_ℓ) + Σ_{j<ℓ} A_jᵀμ_j + C ᵀλ = 0

over the tight rows C, where λ_i >= 0 unless a level above has already settled row i: read row by row from the top level
down, the first multiplier that is not zero is positive. Whether such multipliers exist is a non-negative least squares
problem a level. What it leaves over is counted as the joint displacement that would still lower the level's cost, so that
the figure means the same on directions that the level hardly feels; it is zero exactly where the conditions hold, signs
included.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from prioritized_ik.problem import IKProblem, step_scale
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.cones import directions_left, nonnegative_least_squares
from prioritized_ik.solvers.hierarchy import HARD, SETTLED_ROW, Hierarchy, Whitened
from prioritized_ik.validation import Array, finite_array, fraction, length, lengths

#: A certificate holds if every figure of it, relative to the step, is at most this.
CERTIFIED = 1e-8

#: A direction without cost counts as felt this much weaker than the level's strongest, so that a descent along it shows.
UNFELT = 1e-2

#: The conditions are differences of large terms where a level wants far more than the rows allow; this fraction of the
#: terms is noise: sixty products of two doubles each.
ROUNDING = 64 * float(np.finfo(float).eps)

FEIGNED = 1e-2  # of a step: where rounding can feign more than this, nothing is proven

NOTHING = 1e-12  # a multiplier below this fraction of a level's terms is none

NARROW = 1e-9  # a wedge between tight rows that is narrower than this is rounding


@dataclass(frozen=True)
class LevelProof:
    """One level's optimality.

    Attributes:
        level: its name.
        displacement: what would still lower the level's cost without harm to those above `(m,)` [rad], beyond rounding.
        rounding: how long a displacement the rounding of the conditions' own terms explains [rad].
        multipliers: λ `(r,)` of the pooled rows; zero for those that do not hold the level back.
        gradient: the level's, in scaled coordinates `(v,)`.
        tight: numbers of the rows that may hold it back `(t,)`.
        normals: those rows in the same coordinates `(t, v)`, of unit length.
    """

    level: str
    displacement: Array
    rounding: float
    multipliers: Array
    gradient: Array
    tight: NDArray[np.int_]
    normals: Array

    def pulls(self, active: NDArray[np.bool_]) -> int | None:
        """Return the number of the `active` row that pulls most: its multiplier is negative if all are to be equalities."""
        among = active[self.tight]
        if not among.any():
            return None
        signed = np.linalg.lstsq(self.normals[among].T, -self.gradient)[0]
        worst = int(np.argmin(signed))
        return int(self.tight[among][worst]) if signed[worst] < 0.0 else None

    @cached_property
    def excess(self) -> float:
        """Length of the displacement [rad]."""
        return length(self.displacement)


@dataclass(frozen=True)
class Certificate:
    """Lexicographic optimality of one step; figures are fractions of the step, which counts as 1e-4 rad at least.

    Attributes:
        violation: worst violation of a hard row, bound or equality.
        stationarity: by level, the implicit last one included: how much of a step would still lower its cost, beyond what
            `rounding` explains.
        rounding: by level, how much of a step the rounding of the conditions' own terms can feign.
        held_by: by level, the names of the rows that hold it back (their multipliers are positive).
        tolerance: what figures may reach.
    """

    violation: float
    stationarity: tuple[float, ...]
    rounding: tuple[float, ...]
    held_by: tuple[tuple[str, ...], ...]
    tolerance: float = CERTIFIED

    @property
    def worst(self) -> float:
        """The largest of the figures."""
        return max(self.violation, *self.stationarity)

    @property
    def holds(self) -> bool:
        """Whether the step is proven optimal."""
        return self.worst <= self.tolerance and max(self.rounding) <= FEIGNED


def certify(
    problem: IKProblem, dtheta: ArrayLike, rank_tolerance: float = RANK_TOLERANCE, tolerance: float = CERTIFIED
) -> Certificate:
    """Return the certificate of any step, from whatever solver.

    Args:
        problem: what the step is to solve.
        dtheta: the step `(m,)` [rad].
        rank_tolerance: shared with the solve: the problem's levels are cut to this rank.
        tolerance: what the figures may reach, relative to the step.

    Raises:
        InputError: a step of another length or not finite, a tolerance out of range.
    """
    step = finite_array("dtheta", dtheta, (problem.joint_count,))
    fraction("tolerance", tolerance)
    return Proof(Hierarchy(problem, rank_tolerance), step, tolerance).certificate


class Proof:
    """The proofs of all levels at one step, and the certificate that sums them up.

    Attributes:
        tight: which pooled rows the step ends on `(r,)`; broken hard ones count too.
        levels: one proof a level, the last level's last.
        free: orthonormal directions `(m, f)` that all levels but the last leave.
    """

    def __init__(self, hierarchy: Hierarchy, dtheta: Array, tolerance: float = CERTIFIED) -> None:
        self._hierarchy = hierarchy
        self._dtheta = dtheta
        self.tolerance = tolerance
        self.scale = step_scale(dtheta)
        rows = hierarchy.rows
        self.slack = rows.slack(dtheta)
        near = tolerance * self.scale
        self.tight = (self.slack <= near) & ((rows.level == HARD) | (self.slack >= -near))
        self.exceeded = (rows.level != HARD) & (self.slack < -near)
        self.levels = list(self._prove())

    @cached_property
    def certificate(self) -> Certificate:
        """The figures."""
        names = self._hierarchy.rows.names
        return Certificate(
            self._hierarchy.problem.relative_violation(self._dtheta),
            tuple(level.excess / self.scale for level in self.levels),
            tuple(level.rounding / self.scale for level in self.levels),
            tuple(tuple(names[i] for i in np.flatnonzero(level.multipliers)) for level in self.levels),
            self.tolerance,
        )

    @property
    def ends_on(self) -> NDArray[np.bool_]:
        """Which pooled rows `(r,)` the step ends on, those of soft levels that it exceeds included."""
        return self.tight | self.exceeded

    def _prove(self) -> Iterator[LevelProof]:
        hierarchy, rows, free, dtheta = self._hierarchy, self._hierarchy.rows, self._hierarchy.free, self._dtheta
        size_of_step = length(dtheta)
        tight = np.flatnonzero(self.tight & (rows.level == HARD))
        free = directions_left(free, rows.matrix[tight], NARROW)
        for number, (level, task) in enumerate(zip(hierarchy.problem.levels, hierarchy.tasks, strict=True)):
            if task is not None:
                felt = task.within(free)
                yield self._proof(
                    level.name, felt, -felt.project(task.missing(dtheta)), task.size(size_of_step), 0.0, free, tight
                )
            else:
                own = self.exceeded & (rows.level == number)
                felt = rows.within(own, free)
                excess = -rows.strengths[own] * self.slack[own]
                size = float(np.linalg.norm(rows.strengths[own] * (np.abs(rows.upper[own]) + size_of_step)))
                leak = (1 + number) * float(np.linalg.norm(rows.strengths[own] * excess))
                yield self._proof(level.name, felt, felt.project(excess), size, leak, free, tight)
                tight = np.concatenate([tight, np.flatnonzero(self.tight & (rows.level == number))])
            free = directions_left(felt.unfelt, rows.matrix[tight], NARROW)
        self.free = free
        last, reference = Whitened(free, free[:, :0], None), hierarchy.problem.reference
        size = size_of_step + length(reference)
        yield self._proof("last level", last, free.T @ (dtheta - reference), size, 0.0, free, tight)

    def _proof(
        self, name: str, felt: Whitened, lacking: Array, size: float, leak: float, free: Array, tight: NDArray[np.int_]
    ) -> LevelProof:
        """Return the proof of a level.

        Args:
            name: the level's.
            felt: what it feels of the directions left to it.
            lacking: its gradient `(r,)` in the coordinates of `felt`.
            size: of the terms of which that is the difference.
            leak: what rounding lets through of the gradient that levels above absorb is a rounding of this.
            free: the directions left to it `(m, f)`.
            tight: numbers of the rows that may hold it back.
        """
        rows = self._hierarchy.rows
        felt_lengths = lengths(felt.felt.T)
        unfelt_lengths = np.full(felt.unfelt.shape[1], min(felt_lengths, default=1.0) / UNFELT)
        basis = np.hstack([felt.felt, felt.unfelt * unfelt_lengths])
        gradient = np.concatenate([lacking, np.zeros_like(unfelt_lengths)])
        felt_terms = np.full(len(lacking), size + leak * max(felt_lengths, default=0.0))
        terms = np.concatenate([felt_terms, size / UNFELT + leak * unfelt_lengths])
        tight = tight[rows.reach(tight, free) > SETTLED_ROW]
        cone = rows.matrix[tight] @ basis
        sizes = lengths(cone)
        normals = cone / sizes[:, None]
        combination = np.zeros(len(tight))
        if len(tight) and lacking.any():
            combination, _ = nonnegative_least_squares(normals.T, -gradient)
        rest = gradient + normals.T @ combination
        rounding = ROUNDING * (terms + np.abs(normals).T @ combination)
        explained = float(np.linalg.norm(np.concatenate([felt_lengths, unfelt_lengths]) * rounding))
        beyond = np.sign(rest) * np.maximum(np.abs(rest) - rounding, 0.0)
        multipliers = np.zeros(len(rows.upper))
        multipliers[tight] = np.where(combination > NOTHING * (size + combination.sum()), combination / sizes, 0.0)
        return LevelProof(name, -(basis @ beyond), explained, multipliers, gradient, tight, normals)
