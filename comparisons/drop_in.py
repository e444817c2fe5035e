"""mink and its drop-in on the same calls with mink's default damping, and which of them is right.

The reference is the optimum of the very QP that mink poses, from the doubles of its tasks and limits, in sixty digits: the
products that mink's own assembly rounds are taken exactly. Its damping of 1e-12 is far below what JᵀWJ can hold beside 1 in
double precision, so that near a singularity the answer is decided by rounding.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal, localcontext

import mink
import numpy as np

from comparisons.exact_qp import DIGITS, Decimals, decimals, minimise
from comparisons.mink_scenes import DT, MACHINES, SCENARIOS, Machine, Scene, scene
from prioritized_ik.mink import step_ik
from prioritized_ik.solvers.backends.qpsolvers_ import SOLVER_ERRORS
from prioritized_ik.solvers.methods import DAMPING
from prioritized_ik.validation import Array

SOLVERS = ("daqp", "proxqp", "quadprog")  # that mink is asked with
SAME = 1e-6  # of the velocity: nearer than this both count as the same


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        machine: the robot.
        scenario: one of `SCENARIOS`.
        count: calls.
        difference: largest distance of mink's answers from ours, of the velocity, by solver.
        mink: their largest distance from the reference, likewise.
        failed: calls that mink gave no answer to, by solver.
        ours: largest distance of our answers from the reference.
        nearer: calls in which each answer of mink's that is further than `SAME` from ours is further from the reference.
        apart: calls in which there is such an answer.
        certified: calls in which our certificate holds.
    """

    machine: str
    scenario: str
    count: int
    difference: dict[str, float]
    mink: dict[str, float]
    failed: dict[str, int]
    ours: float
    nearer: int
    apart: int
    certified: int


def reference(given: Scene, damping: float = DAMPING) -> Array | None:
    """Return the exact Δq `(nv,)` of the QP that mink poses, rounded to doubles; None if no step keeps the limits."""
    configuration, nv = given.configuration, given.configuration.nv
    with localcontext(prec=DIGITS):
        hessian, linear = decimals(np.zeros((nv, nv))), decimals(np.zeros(nv))
        diagonal = Decimal(damping)
        for task in given.tasks:
            error, matrix = decimals(task.compute_error(configuration)), decimals(task.compute_jacobian(configuration))
            weights = decimals(task.cost) ** 2
            target = -Decimal(task.gain) * error
            hessian = hessian + matrix.T @ (weights[:, None] * matrix)
            linear = linear - matrix.T @ (weights * target)
            diagonal += Decimal(task.lm_damping) * (target @ (weights * target))
        hessian = hessian + diagonal * decimals(np.eye(nv))
        found = minimise(hessian, linear, *_rows(given))
    return None if found is None else found.x.astype(float)


def _rows(given: Scene) -> tuple[Decimals, Decimals]:
    """Return mink's rows G `(r, nv)` and sides h `(r,)`, without those that never bind."""
    matrices, sides = [np.zeros((0, given.configuration.nv))], [np.zeros(0)]
    for limit in given.limits:
        matrix, side = limit.compute_qp_inequalities(given.configuration, DT)
        if matrix is not None:
            real = np.isfinite(side) & matrix.any(axis=1)
            matrices.append(matrix[real])
            sides.append(side[real])
    return decimals(np.vstack(matrices)), decimals(np.concatenate(sides))


def by_mink(given: Scene, solver: str, damping: float = DAMPING) -> Array | None:
    """Return mink's Δq `(nv,)`, None if it fails."""
    try:
        velocity = mink.solve_ik(given.configuration, given.tasks, DT, solver, damping, limits=given.limits)
    except (mink.MinkError, *SOLVER_ERRORS):
        return None
    dq = np.asarray(velocity) * DT
    return dq if np.isfinite(dq).all() else None


def measure(machine: Machine, scenario: str, count: int, damping: float = DAMPING) -> Row:
    """Return how far mink and its drop-in are from each other and from the reference in `count` random calls."""
    difference, theirs = dict.fromkeys(SOLVERS, 0.0), dict.fromkeys(SOLVERS, 0.0)
    failed = dict.fromkeys(SOLVERS, 0)
    ours = 0.0
    nearer = apart = certified = 0
    for seed in range(count):
        given = scene(machine, scenario, seed, posture=False)
        exact = reference(given, damping)
        assert exact is not None  # the scenes rest inside their limits
        answers = {solver: by_mink(given, solver, damping) for solver in SOLVERS}
        step = step_ik(given.configuration, given.tasks, DT, damping=damping, limits=given.limits)
        assert step.dtheta is not None
        certified += step.certificate is not None and bool(step.certificate.holds)
        off = _distance(step.dtheta, exact)
        ours = max(ours, off)
        others = []
        for solver, dq in answers.items():
            if dq is None:
                failed[solver] += 1
                continue
            theirs[solver] = max(theirs[solver], _distance(dq, exact))
            difference[solver] = max(difference[solver], _distance(dq, step.dtheta))
            if _distance(dq, step.dtheta) > SAME:
                others.append(_distance(dq, exact))
        apart += bool(others)
        nearer += bool(others) and min(others) > off
    return Row(machine.name, scenario, count, difference, theirs, failed, ours, nearer, apart, certified)


def measure_all(count: int, machines: Sequence[Machine] = MACHINES) -> list[Row]:
    """Return one row a robot and scenario."""
    return [measure(machine, scenario, count) for machine in machines for scenario in SCENARIOS]


def _distance(dq: Array, exact: Array) -> float:
    """Return how far a step is from another, as a fraction of that."""
    return float(np.linalg.norm(dq - exact) / (np.linalg.norm(exact) or 1.0))
