"""Table 5: damping bias: how far the damped step is from Eqs. 12-14, by damping, method and weights."""

from collections.abc import Callable
from functools import partial
from typing import Any, cast

import numpy as np
import scipy.linalg

from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.jobs import Job, Results
from paper_repro.make.table import Cell, Column, Table
from paper_repro.measure.replays import median, relative, sampled, windings
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.methods import OneQp
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.validation import Array

DAMPINGS = tuple(10.0**power for power in range(-16, -1))
WEIGHTS = {"eq23": "Eq. 23", "eq24": "Eq. 24"}

#: An active-set method whose answers know rounding only, no tolerance, so that what is seen is the formulation's.
SOLVER = "quadprog"

NORMAL, ORTHOGONAL, DAMPED, SLACK = "normal equations", "orthogonal", f"damped QP, {SOLVER}", f"slack QP, {SOLVER}"


def by_normal_equations(problem: IKProblem, damping: float) -> Array | None:
    """(JᵀWJ + damping I)⁻¹ JᵀW dX* `(m,)` by Cholesky factors; None where rounding left the matrix indefinite."""
    (level,) = problem.levels
    weighted = level.weights[:, None] * level.matrix
    hessian = level.matrix.T @ weighted + damping * np.eye(problem.joint_count)
    try:
        factor = scipy.linalg.cho_factor(hessian)
    except scipy.linalg.LinAlgError:
        return None
    return np.asarray(scipy.linalg.cho_solve(factor, weighted.T @ level.target))


def by_orthogonal_factors(problem: IKProblem, damping: float) -> Array | None:
    """The same `(m,)` by QR of W^½ J over damping^½ I, without a product of the two."""
    (level,) = problem.levels
    root = np.sqrt(level.weights)
    stacked = np.vstack([root[:, None] * level.matrix, np.sqrt(damping) * np.eye(problem.joint_count)])
    q, r = np.linalg.qr(stacked)
    return np.asarray(scipy.linalg.solve_triangular(r, q[: len(root)].T @ (root * level.target)))


def by_qp(formulation: str, problem: IKProblem, damping: float) -> Array | None:
    """The same `(m,)` as one QP with all rows, as it stands; None if the solver fails."""
    method = cast(OneQp, get_method(f"{formulation}:{SOLVER}"))
    stage = method.stage(problem, SolveOptions(damping=damping))
    x = method.backend.solve_once(stage).x
    return None if x is None else stage.dtheta(x)


METHODS: dict[str, Callable[[IKProblem, float], Array | None]] = {
    NORMAL: by_normal_equations,
    ORTHOGONAL: by_orthogonal_factors,
    DAMPED: partial(by_qp, "damped"),
    SLACK: partial(by_qp, "slack"),
}


def biases_job(scale: Scale, weights: str) -> Job:
    """Return the job of one kind of weights: see `biases`."""
    return Job(biases, {"windings": list(windings(scale, weights)), "steps": scale.steps})


def biases(windings: list[str], steps: int) -> list[dict[str, Any]]:
    """Return, by `damping` and `method`, `errors` of dθ on the free steps, relative, and how many `failed`."""
    free = [posed for winding in windings for posed in sampled(winding, steps) if posed.item.free]
    rows = []
    for damping in DAMPINGS:
        for name, method in METHODS.items():
            answers = [(posed, method(posed.cut_problem, damping)) for posed in free]
            errors = [relative(answer, posed.item.dtheta) for posed, answer in answers if answer is not None]
            failed = len(free) - len(errors)
            rows.append({"damping": damping, "method": name, "errors": errors, "failed": failed})
    return rows


def jobs(scale: Scale) -> list[Job]:
    """Return one job a kind of weights."""
    return [biases_job(scale, weights) for weights in WEIGHTS]


COLUMNS = (
    Column("weights", "weights"),
    Column("damping", "damping δ", ".0e"),
    *(
        Column(f"{key}_{figure}", f"{title}, {figure}", ".0e")
        for key, title in (("normal", NORMAL), ("orthogonal", ORTHOGONAL), ("damped_qp", DAMPED), ("slack_qp", SLACK))
        for figure in ("median", "max")
    ),
    Column("failed", "failed"),
)


def build(scale: Scale, results: Results) -> Table:
    """Return one row a kind of weights and damping."""
    rows: list[tuple[Cell, ...]] = []
    best = []
    for weights, equation in WEIGHTS.items():
        found = results[biases_job(scale, weights)]
        for damping in DAMPINGS:
            of = {row["method"]: row for row in found if row["damping"] == damping}
            figures = [(median(of[name]["errors"]), max(of[name]["errors"], default=None)) for name in METHODS]
            failed = ", ".join(str(of[name]["failed"]) for name in METHODS)
            rows.append((equation, damping, *(figure for pair in figures for figure in pair), failed))
        count = len(found[0]["errors"]) + found[0]["failed"]
        for name in METHODS:
            worst = [(max(row["errors"]), row["damping"]) for row in found if row["method"] == name and not row["failed"]]
            if worst:
                best.append(f"{name} with {equation} {min(worst)[0]:.0e} at δ = {min(worst)[1]:.0e} ({count} free steps)")
    notes = (
        f"Rank tolerance {RANK_TOLERANCE:g}. Failed: steps without an answer, in the order of the methods; errors are of "
        f"the others. Least of the largest errors, of dampings at which no step fails: {'; '.join(best)}."
    )
    return Table(COLUMNS, tuple(rows), notes)


CAPTION = f"""\
Relative error of dθ against Eqs. 12–14, median and maximum over the recorded steps on which no row binds, when the
least norm is left to a damping term: min (dX\\* − J dθ)ᵀW(dX\\* − J dθ) + δ‖dθ‖². Solved by Cholesky factors of JᵀWJ +
δI (normal equations), by QR of W^½J stacked on δ^½I (orthogonal), and by {SOLVER}, an active-set QP solver whose
answers know rounding only, as the damped and as the slack QP, limits and contact rows included. Windings with the
weights of Eq. 23 and of Eq. 24 are recorded apart; J is cut to the rank that all share.

**To see:** from the largest δ down, the bias falls in proportion to δ until rounding takes over and rises as 1/δ. On
the worst steps rounding is larger where JᵀWJ is formed, and below some δ its Cholesky factors do not exist; without the
square of J there is always an answer. On the median step either can be ahead: rounding along directions that a step
does not use does no harm. The best δ hangs on weights, method and pose, and leaves the error in the last line on some
step. A least norm that is a level of its own needs no δ (table 4, lexicographic).

It does *not* show the tolerance of a solver, which table 4 does: few solvers are as exact as this one."""

ARTEFACT = Artefact("table-5", "Table 5: damping: bias against rounding", CAPTION, jobs, build)
