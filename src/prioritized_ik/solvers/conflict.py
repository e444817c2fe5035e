"""Hard rows that contradict each other: which, and by how much.

With every bound, row and equality as a row g dθ <= h of length ‖g‖ = 1 (an equality as two), the least violation that a
step can do with is that of the linear program

    minimise t over dθ and t >= 0, subject to g dθ - t <= h for every row,

a distance in joint space. If t > 0, the rows with a multiplier λ > 0 there contradict each other by themselves: Σ λ g = 0
and Σ λ = 1, so every step breaks them by t = -Σ λ h on average (Farkas). Of these, one after the other is dropped while
the rest still contradict each other.
"""

from dataclasses import dataclass

import numpy as np

from prioritized_ik.errors import PrioritizedIkError
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.hierarchy import impossible_rows
from prioritized_ik.tolerances import FEASIBLE, PASSES, PUSHING, RESOLVED, ROUNDING
from prioritized_ik.validation import Array, lengths


@dataclass(frozen=True)
class Conflict:
    """Hard rows that no step keeps together.

    Attributes:
        names: of bounds, rows and equalities, so few that a step keeps all but any one of them.
        excess: by how much the worst of them is broken at best, as a distance in joint space [rad].
    """

    names: tuple[str, ...]
    excess: float

    @property
    def text(self) -> str:
        """What is wrong and what to do about it."""
        names = ", ".join(repr(name) for name in self.names)
        if self.excess == float("inf"):
            return (
                f"{names} is moved by no joint, its coefficients are rounding, and is broken by every step; leave it out."
            )
        return (
            f"no step keeps all of {names}: at best one is broken by {self.excess:.3g} rad, as a joint distance. "
            f"Widen each by that much, drop one, or make them soft with problem.softened({list(self.names)!r})."
        )

    def __str__(self) -> str:
        """Return `text`."""
        return self.text


def find_conflict(problem: IKProblem) -> Conflict | None:
    """Return hard rows of `problem` that contradict each other, or None if a step keeps them all.

    Raises:
        PrioritizedIkError: HiGHS did not solve a linear program, though all that it is given have a solution.
    """
    hard = _hard_rows(problem)
    likely = float(np.abs(hard.sides).max(initial=0.0)) or 1.0
    never = impossible_rows(problem.in_metric, FEASIBLE * likely * problem.in_metric.longest_row)
    if never:
        return Conflict(never[:1], float("inf"))
    violation = _least_violation(hard)
    if violation is None:
        return None
    suspects = hard.only(set(hard.owners[violation.pushing].tolist()))
    if _least_violation(suspects) is None:  # a multiplier that mattered was too small to tell
        suspects = hard
    for owner in dict.fromkeys(suspects.owners.tolist()):
        rest = suspects.only(set(suspects.owners.tolist()) - {owner})
        if _least_violation(rest) is not None:
            suspects = rest
    violation = _least_violation(suspects) or violation
    names = (*problem.inequalities.names, *problem.equalities.names)
    return Conflict(tuple(names[owner] for owner in dict.fromkeys(suspects.owners.tolist())), violation.excess)


@dataclass(frozen=True)
class _HardRows:
    """Rows of length one, matrix `(n, m)` @ dθ <= sides `(n,)`, and which name each belongs to, `owners` `(n,)`."""

    matrix: Array
    sides: Array
    owners: np.ndarray[tuple[int], np.dtype[np.int64]]

    def only(self, owners: set[int]) -> "_HardRows":
        """Return the rows of these owners."""
        kept = np.isin(self.owners, sorted(owners))
        return _HardRows(self.matrix[kept], self.sides[kept], self.owners[kept])


def _hard_rows(problem: IKProblem) -> _HardRows:
    """Return all hard rows but those of zeros, which every step keeps."""
    problem = problem.in_metric
    rows, equal = problem.inequalities, problem.equalities
    matrix = np.vstack([rows.matrix, equal.matrix, -equal.matrix])
    sides = np.concatenate([rows.upper, equal.target, -equal.target])
    equal_owners = len(rows.upper) + np.arange(len(equal.target))
    owners = np.concatenate([np.arange(len(rows.upper)), equal_owners, equal_owners])
    sizes = lengths(matrix)
    fixed = problem.equality_lengths > problem.zero_length
    some = np.concatenate([problem.real_rows, fixed, fixed])
    return _HardRows(matrix[some] / sizes[some, None], sides[some] / sizes[some], owners[some])


@dataclass(frozen=True)
class _Violation:
    """The least violation [rad], and which rows `(n,)` no step can do better against."""

    excess: float
    pushing: np.ndarray[tuple[int], np.dtype[np.bool_]]


def _least_violation(hard: _HardRows) -> _Violation | None:
    """Return the least violation of all rows, or None if a step keeps them.

    The linear program is solved for the way from the best step so far, in units of that step's violation, until what is
    left of it is a fair part of the unit: HiGHS's tolerances are absolute, and steps can be as short as 1e-4 rad.
    """
    dtheta, found = np.zeros(hard.matrix.shape[1]), None
    for _ in range(PASSES):
        slack = hard.sides - hard.matrix @ dtheta
        rounding = ROUNDING * float(np.linalg.norm(dtheta))
        if (slack >= -np.maximum(FEASIBLE * np.abs(hard.sides), rounding)).all():
            return None
        if found is not None:
            return found
        worst = float(-slack.min())
        way, left, multipliers = _linear_program(hard.matrix, slack / worst)
        dtheta = dtheta + worst * way
        if left > RESOLVED:
            found = _Violation(worst * left, multipliers > PUSHING)
    return found


def _linear_program(matrix: Array, sides: Array) -> tuple[Array, float, Array]:
    """Return x `(m,)`, t and multipliers `(n,)` of: minimise t >= 0 subject to matrix @ x - t <= sides."""
    from scipy.optimize import linprog  # see `subspaces.nonnegative_least_squares`

    n, m = matrix.shape
    for method in ("highs-ds", "highs-ipm"):
        result = linprog(
            c=np.append(np.zeros(m), 1.0),
            A_ub=np.hstack([matrix, -np.ones((n, 1))]),
            b_ub=sides,
            bounds=[(None, None)] * m + [(0.0, None)],
            method=method,
        )
        if result.status == 0:
            return result.x[:m], float(result.x[m]), -result.ineqlin.marginals
    raise PrioritizedIkError(f"HiGHS could not tell whether the hard rows contradict each other: {result.message}")
