"""The reference solution: a problem as one would write it on paper, handed to CVXPY stage by stage.

It shares no code with the solvers of this package, so that a mistake would have to be made twice to go unseen. Slow and
readable is the aim. Each level is one stage,

    minimise ‖W^½ (A dθ - b)‖², or ‖W^½ max(A dθ - b, 0)‖² of an `at_most` level,
    subject to every bound, row and equality, and to what the levels above have reached,

and the last stage is the level dθ = r. What a level has reached at its optimum dθ_ℓ is kept by all stages after it:

    A dθ = A dθ_ℓ               of an `equal` level;
    A dθ <= max(b, A dθ_ℓ)      of an `at_most` level, as equalities where dθ_ℓ exceeds b, because the excess is unique;
    g dθ = h                    for each row that the level pushes against (its multiplier is positive): by
                                complementary slackness it is tight at every optimum of the level.

The last line restricts nothing. It is there because rows that cannot but stay tight, written as inequalities, leave a
feasible set without interior, on which solvers stall. All equalities together are V dθ = V dθ_ℓ with V an orthonormal
basis of them all, because solvers stumble over equalities that say the same twice.

There is no rank tolerance here beyond rounding. A level whose matrix has singular values between rounding and a solver's
rank tolerance, by itself or in the directions that the levels above leave free, is not the same problem to the two: hand
it over with its matrix cut to the rank that counts (`j_a @ j_b` of its decomposition).
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cvxpy as cp
import numpy as np

from prioritized_ik.errors import WitnessError
from prioritized_ik.problem import IKProblem, Level
from prioritized_ik.validation import Array, one_of

#: How each solver is told how accurate its answer must be. Clarabel's own scaling stalls on stages that are scaled already;
#: a little more regularisation and shorter steps than its defaults take it to 1e-14 without stalling (all 340 problems of
#: a trial, against 338). OSQP's polishing prints. Left out are CVXPY's other free QP solvers. Of 30 hierarchies, CVXOPT
#: fails on 14 and HiGHS on 6; ECOS's epigraph cone, HiGHS and DAQP's proximal term blur dθ by up to 1e-4, 5e-3 and 0.3 of
#: itself, where those of this list are right to 6e-7; QPALM 1.3 crashes the interpreter.
OPTIONS: dict[str, Callable[[float], dict[str, Any]]] = {
    "CLARABEL": lambda tolerance: {
        **dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), tolerance),
        "equilibrate_enable": False,
        "static_regularization_constant": 1e-7,
        "max_step_fraction": 0.9,
    },
    "OSQP": lambda tolerance: {"eps_abs": tolerance, "eps_rel": tolerance, "max_iter": 200_000, "polishing": False},
    "PIQP": lambda tolerance: dict.fromkeys(
        ("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"), tolerance
    ),
    "PROXQP": lambda tolerance: {"eps_abs": tolerance},
    "SCS": lambda tolerance: {"eps_abs": tolerance, "eps_rel": tolerance, "max_iters": 200_000},
}

#: Asked for in turn, until the solver says that it got there. Interior points take the finest, and need it: a tight row
#: without a multiplier is left with the root of the tolerance. The others would only run on.
TOLERANCES = (1e-14, 1e-13, 1e-12, 1e-10, 1e-8)
INTERIOR_POINT = ("CLARABEL", "PIQP")
OTHERS_FINEST = 1e-12

ROUNDING = 1e-10  # a part of a row smaller than this fraction of it is rounding
CLEAR = 1e-6  # in units of the step: a row this near to its side is tight, and one over it by more is violated
PUSH = 1e-6  # multipliers above this are positive: solvers leave 1e-9 on idle rows
LEAST_COST = 1e-3  # a level's cost counts in units of itself, but not in smaller ones than this fraction of all it can do
UNIT_FITS = 10.0  # a step up to this many times longer or shorter than its unit is of order one
COARSE = 1e-3  # a guess of how long a step is leaves out singular values below this fraction of the largest
NOTHING = 1e-6  # of its unit: a step shorter than this is what solvers leave of zero, not the measure of another unit
PASSES = 4  # solves in search of a unit that fits


def witness_solvers() -> tuple[str, ...]:
    """Return the names of the installed QP solvers that `witness_step` can use, as CVXPY writes them."""
    installed = cp.installed_solvers()
    return tuple(name for name in OPTIONS if name in installed)


def witness_step(problem: IKProblem, solver: str = "CLARABEL") -> Array:
    """Return the joint step dθ `(m,)` [rad] that is optimal at every level, by CVXPY.

    Stages are compiled once for each shape (numbers of joints and of rows), and kept; one call at a time.

    Args:
        problem: with matrices cut to the rank that counts, see above.
        solver: one of `witness_solvers()`.

    Raises:
        InputError: unknown solver, or not installed.
        WitnessError: a stage was not solved to optimality, for instance because the hard rows contradict each other.
    """
    one_of("witness solver", solver, witness_solvers())
    unit, passes = _first_unit(problem), list[_Pass]()
    while not passes or (len(passes) < PASSES and not 1.0 / UNIT_FITS <= passes[-1].length <= UNIT_FITS):
        passes.append(_solve_in_units(problem, solver, unit))
        unit *= passes[-1].length
    best = min(passes, key=lambda one: one.accuracy)
    if best.failure is not None:
        raise best.failure
    return best.dtheta


@dataclass(frozen=True)
class _Pass:
    """What came of solving all stages, or all up to one that failed, with dθ in one unit.

    Attributes:
        dtheta: of the last stage that was solved `(m,)` [rad].
        unit: [rad].
        tolerance: of the least accurate stage; infinite if one failed.
        failure: why one failed.
    """

    dtheta: Array
    unit: float
    tolerance: float
    failure: WitnessError | None = None

    @property
    def length(self) -> float:
        """‖dθ‖ in units; 1 if there is no step to speak of, which any unit fits."""
        length = float(np.linalg.norm(self.dtheta)) / self.unit
        return length if length > NOTHING else 1.0

    @property
    def accuracy(self) -> float:
        """The tolerance, worse by the square of what the unit is off: tolerances are of costs, which are squares."""
        return self.tolerance * max(self.length, 1.0 / self.length) ** 2


def _first_unit(problem: IKProblem) -> float:
    """Return a guess of ‖dθ‖ [rad]: the longest that a level asks for, cut to the bounds, or that a row does."""
    wishes = [problem.reference]
    for level in problem.levels:
        asking = level.target < 0.0 if level.is_soft else np.full(len(level.target), True)
        wishes.append(np.linalg.lstsq(level.matrix[asking], level.target[asking], rcond=COARSE)[0])
    lengths = [np.linalg.norm(np.clip(wish, problem.bounds.lower, problem.bounds.upper)) for wish in wishes]
    _, sides = _normalised(problem.inequalities.matrix, problem.inequalities.upper)
    _, wanted = _normalised(problem.equalities.matrix, problem.equalities.target)
    return float(max(*lengths, (-sides).max(initial=0.0), np.abs(wanted).max(initial=0.0))) or 1.0


def _solve_in_units(problem: IKProblem, solver: str, unit: float) -> _Pass:
    """Solve stage after stage for x = dθ / unit."""
    m = problem.joint_count
    rows, sides = _normalised(problem.inequalities.matrix, problem.inequalities.upper / unit)
    equal, wanted = _normalised(problem.equalities.matrix, problem.equalities.target / unit)
    x = np.asarray(np.linalg.lstsq(equal, wanted, rcond=ROUNDING)[0], dtype=float)
    if np.abs(equal @ x - wanted).max(initial=0.0) > CLEAR:
        words = "the hard equalities contradict each other; look for the conflict and drop one of them."
        return _Pass(unit * x, unit, np.inf, WitnessError(words))
    fixed, worst = _basis(np.zeros((0, m)), equal), 0.0
    for level in (*problem.levels, Level(np.eye(m), problem.reference, name="reference")):
        stage = _compiled(_Shape(m, len(rows), len(fixed), len(level.target), level.is_soft))
        root, target = np.sqrt(level.weights), level.target / unit
        matrix = root[:, None] * level.matrix
        near = x / max(1.0, float(np.linalg.norm(x)))  # what a level leaves undecided can have run far off
        size = max(np.sqrt(level.cost(unit * near)) / unit, LEAST_COST * np.linalg.norm(matrix, 2)) or 1.0
        values = {"matrix": matrix / size, "target": root * target / size}
        values |= {"rows": rows, "sides": sides, "fixed": fixed, "reached": fixed @ x}
        try:
            x, multipliers, tolerance = stage.solve(solver, level.name, values)
        except WitnessError as failure:
            return _Pass(unit * x, unit, np.inf, failure)
        worst = max(worst, tolerance)

        fixed = _basis(fixed, rows[(multipliers > PUSH) & (sides - rows @ x < CLEAR)])
        if level.is_soft:
            soft, most = _normalised(level.matrix, target)
            violated = soft @ x > most + CLEAR
            fixed = _basis(fixed, soft[violated])
            rows, sides = np.vstack([rows, soft[~violated]]), np.append(sides, most[~violated])
        else:
            fixed = _basis(fixed, level.matrix)
        if len(fixed) == m:
            break
        moving = np.linalg.norm(rows - rows @ fixed.T @ fixed, axis=1) > ROUNDING
        # A row that this stage broke by rounding the next may break as well, so that x is feasible there.
        rows, sides = rows[moving], np.maximum(sides, rows @ x)[moving]
    return _Pass(unit * x, unit, worst)


@dataclass(frozen=True)
class _Shape:
    """All that the text of a stage depends on: stages of one shape differ only in their numbers."""

    joints: int
    rows: int
    fixed: int
    height: int  # rows of the level's matrix
    soft: bool


class _Stage:
    """One stage as CVXPY sees it, its numbers left open."""

    def __init__(self, shape: _Shape) -> None:
        m = shape.joints
        self.x = cp.Variable(m)
        self.numbers = {"matrix": cp.Parameter((shape.height, m)), "target": cp.Parameter(shape.height)}
        self.inequality = None
        constraints = []
        if shape.rows:
            self.numbers |= {"rows": cp.Parameter((shape.rows, m)), "sides": cp.Parameter(shape.rows)}
            self.inequality = self.numbers["rows"] @ self.x <= self.numbers["sides"]
            constraints.append(self.inequality)
        if shape.fixed:
            self.numbers |= {"fixed": cp.Parameter((shape.fixed, m)), "reached": cp.Parameter(shape.fixed)}
            constraints.append(self.numbers["fixed"] @ self.x == self.numbers["reached"])
        residual = self.numbers["matrix"] @ self.x - self.numbers["target"]
        if shape.soft:
            # The least square at or above the residual is that of its positive part. `cp.pos` would say excess >= 0 on
            # top, a row that is tight without a multiplier wherever the level is met; Clarabel stalls on those.
            excess = cp.Variable(shape.height)
            constraints.append(residual <= excess)
            residual = excess
        self.problem = cp.Problem(cp.Minimize(cp.sum_squares(residual)), constraints)

    def solve(self, solver: str, name: str, values: dict[str, Array]) -> tuple[Array, Array, float]:
        """Return x `(m,)`, the multipliers of the rows, and the tolerance that was met."""
        for key, parameter in self.numbers.items():
            parameter.value = values[key]
        finest = 0.0 if solver in INTERIOR_POINT else OTHERS_FINEST
        for tolerance in (one for one in TOLERANCES if one >= finest):
            said = self._ask(solver, tolerance)
            if said == cp.OPTIMAL:
                break
        else:
            raise WitnessError(
                f"{solver} on level {name!r}: {said}; expected {cp.OPTIMAL}. "
                "Look for rows that contradict each other, or try another solver."
            )
        x = np.array(self.x.value)
        multipliers = np.zeros(0) if self.inequality is None else np.array(self.inequality.dual_value)
        if not (np.isfinite(x).all() and np.isfinite(multipliers).all()):
            raise WitnessError(f"{solver} on level {name!r}: an answer that is not finite. Try another solver.")
        return x, multipliers, tolerance

    def _ask(self, solver: str, tolerance: float) -> str:
        """Return the status, or what the solver said instead of one."""
        with warnings.catch_warnings():
            # CVXPY warns of inaccurate answers, which are not taken here, and of how long it compiles many parameters.
            warnings.simplefilter("ignore", UserWarning)
            try:
                self.problem.solve(solver=solver, warm_start=False, enforce_dpp=True, **OPTIONS[solver](tolerance))
            except cp.error.SolverError as error:
                return str(error)
        return str(self.problem.status)


@lru_cache(maxsize=128)
def _compiled(shape: _Shape) -> _Stage:
    """Return the stage of a shape; CVXPY compiles it at its first solve and keeps that too."""
    return _Stage(shape)


def _normalised(matrix: Array, side: Array) -> tuple[Array, Array]:
    """Return rows of length one, and their sides to match; rows of zeros, which say nothing, are left out."""
    lengths = np.linalg.norm(matrix, axis=1)
    some = lengths > 0.0
    return matrix[some] / lengths[some, None], side[some] / lengths[some]


def _basis(basis: Array, rows: Array) -> Array:
    """Return `basis`, orthonormal rows `(p, m)`, with what `rows` adds to it."""
    if not rows.any():
        return basis
    rest = rows - rows @ basis.T @ basis
    rest = rest - rest @ basis.T @ basis  # once more: the first time leaves rounding along the basis
    _, strengths, directions = np.linalg.svd(rest, full_matrices=False)
    return np.vstack([basis, directions[strengths > ROUNDING * np.linalg.norm(rows, 2)]])
