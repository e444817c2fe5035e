"""Two conflicting tasks: how near does one weighted level come to two strict ones, as the ratio of the weights grows?

In exact arithmetic the distance falls as one over the ratio. How far a method can follow depends on how it solves:
orthogonal factors of W^½ J see the square root of the ratio and of the cost; the normal equations JᵀWJ see all of both, so
that the lighter task and the directions without any drown in the rounding of the heavier one. The slack QP does not
square J either, but how much of that arrives is up to the solver, called as it stands with its default options.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import mujoco
import numpy as np

from prioritized_ik.errors import SolverUnavailableError, StepNotFoundError
from prioritized_ik.models import Arm, update_kinematics
from prioritized_ik.problem import IKProblem, Level
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.methods import DAMPING
from prioritized_ik.solvers.solve import solve
from prioritized_ik.solvers.step import JointStep
from prioritized_ik.validation import Array
from prioritized_ik.virtual_arms import VirtualArms

POSTURE = "arched"

#: The ends of neighbouring links and what is asked of them [m]. Both want their own way along the link between them,
#: whose length does not change; the first is the more important.
TASKS = (("end_17", (0.005, 0.01, 0.0)), ("end_16", (-0.005, 0.0, 0.005)))

RATIOS = tuple(10.0**power for power in range(13))
SOLVER = "daqp"
SLACK_SOLVERS = (SOLVER, "quadprog")  # one that stops at a tolerance, and one that knows only rounding

CUT = SolveOptions(rank_tolerance=RANK_TOLERANCE)
QP_ALONE = SolveOptions(rank_tolerance=RANK_TOLERANCE, closed_form_first=False, polish=False)

ORTHOGONAL = "orthogonal factors"
PINV = "normal equations, pinv"
DAMPED = "normal equations, damped"
QP = f"QP, {SOLVER}"
SLACK = "slack QP, {}"


@dataclass(frozen=True)
class Row:
    """One answer, as its distance from the strict closed form.

    Attributes:
        method: how it was computed.
        ratio: of the first task's weight to the second's; None where the two are strict levels.
        dtheta: ‖dθ - dθ_strict‖ / ‖dθ_strict‖; None if the solve failed.
        level_1, level_2: of each task's residual, relative to what it asks: ‖J (dθ - dθ_strict)‖ / ‖dX*‖.
        failure: why there is no step; empty otherwise.
    """

    method: str
    ratio: float | None
    dtheta: float | None = None
    level_1: float | None = None
    level_2: float | None = None
    failure: str = ""


def conflicting_levels() -> tuple[Level, Level]:
    """Return the two tasks as levels, weights 1."""
    arm = Arm()
    model = arm.spec().compile()
    data = mujoco.MjData(model)
    update_kinematics(model, data, arm.posture(POSTURE))
    first, second = (Level(VirtualArms(model, [end]).jacobian(data), demand, name=end) for end, demand in TASKS)
    return first, second


def weighted(first: Level, second: Level, ratio: float) -> Level:
    """Return both levels as one, the first one's rows weighing `ratio`."""
    return Level(
        np.vstack([first.matrix, second.matrix]),
        np.concatenate([first.target, second.target]),
        np.concatenate([ratio * first.weights, second.weights]),
    )


def by_orthogonal_factors(*levels: Level) -> Array:
    """Eqs. (12) and (14), of several levels in strict order: the library's answer where there are no rows `(m,)`."""
    return _found(solve(IKProblem(levels), SOLVER, CUT))


def by_pinv(level: Level) -> Array:
    """(JᵀWJ)⁺ JᵀW dX* `(m,)`, with NumPy's own tolerance."""
    hessian, linear = _normal_equations(level)
    return np.asarray(np.linalg.pinv(hessian) @ linear, dtype=float)


def by_damping(level: Level) -> Array:
    """(JᵀWJ + damping I)⁻¹ JᵀW dX* `(m,)`."""
    hessian, linear = _normal_equations(level)
    return np.asarray(np.linalg.solve(hessian + DAMPING * np.eye(len(linear)), linear), dtype=float)


def by_qp(*levels: Level) -> Array:
    """The lexicographic QP of the levels, then of the least norm `(m,)`."""
    return _found(solve(IKProblem(levels), SOLVER, QP_ALONE))


def by_slack_qp(solver: str, level: Level) -> Array:
    """The least of sᵀWs + damping ‖dθ‖² subject to J dθ + s = dX*: `by_damping` without the product JᵀWJ `(m,)`."""
    return _found(solve(IKProblem([level]), f"slack:{solver}", SolveOptions(damping=DAMPING)))


METHODS: dict[str, Callable[[Level], Array]] = {
    ORTHOGONAL: by_orthogonal_factors,
    PINV: by_pinv,
    DAMPED: by_damping,
    QP: by_qp,
    **{SLACK.format(solver): partial(by_slack_qp, solver) for solver in SLACK_SOLVERS},
}


def measure() -> list[Row]:
    """Return one row a method and ratio, and one for the strict levels by the QP."""
    first, second = conflicting_levels()
    strict = by_orthogonal_factors(first, second)

    def judge(method: str, ratio: float | None, answer: Callable[[], Array]) -> Row:
        try:
            dtheta = answer()
        except (StepNotFoundError, SolverUnavailableError, np.linalg.LinAlgError) as error:
            return Row(method, ratio, failure=str(error))
        if not np.isfinite(dtheta).all():
            return Row(method, ratio, failure="values that are not finite")
        off = dtheta - strict
        one, two = (np.linalg.norm(level.matrix @ off) / np.linalg.norm(level.target) for level in (first, second))
        return Row(method, ratio, float(np.linalg.norm(off) / np.linalg.norm(strict)), float(one), float(two))

    rows = []
    for ratio in RATIOS:
        level = weighted(first, second, ratio)
        rows += [judge(name, ratio, partial(method, level)) for name, method in METHODS.items()]
    return [*rows, judge(QP, None, partial(by_qp, first, second))]


def closest(rows: list[Row], method: str) -> Row | None:
    """Return the row at which a method comes nearest to the strict step by weights; None if it never gave a step."""
    found = [(row.dtheta, row) for row in rows if row.method == method and row.ratio is not None and row.dtheta is not None]
    return min(found, key=lambda pair: pair[0])[1] if found else None


def _normal_equations(level: Level) -> tuple[Array, Array]:
    """Return JᵀWJ `(m, m)` and JᵀW dX* `(m,)`."""
    weighed: Array = level.weights[:, None] * level.matrix
    return level.matrix.T @ weighed, weighed.T @ level.target


def _found(step: JointStep) -> Array:
    assert step.dtheta is not None  # solve raises otherwise
    return step.dtheta
