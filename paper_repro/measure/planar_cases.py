"""The three cases of Fig. 3 on the five-link planar arm: which points, what is asked, and what Eqs. 12-17 give."""

from dataclasses import dataclass

import numpy as np

from paper_repro.measure.posed import PosedArm
from prioritized_ik.errors import InputError
from prioritized_ik.models import PLANAR_ARM
from prioritized_ik.solvers import closed_form as solve
from prioritized_ik.validation import Array
from prioritized_ik.virtual_arms import EndPoint
from prioritized_ik.weights import diagonal_of_weights

PLANAR = PLANAR_ARM
POSE = np.array([0.9, -0.55, -0.6, 0.75, -0.5])  # [rad] bent at every joint, so that only the points decide on the rank

MOVE = 0.01  # [m] asked of every end point
VIRTUAL_WEIGHT, ACTUAL_WEIGHT = 20.0, 1.0  # those of Eq. (24) for the arm to move and the others


@dataclass(frozen=True)
class Case:
    """One case.

    Attributes:
        title: what the paper calls it.
        points: its virtual end points, the actual one last; sites, or `middle of link i`.
    """

    title: str
    points: tuple[str, ...]


#: Fig. 3 (c) has its virtual end point "on the fifth link" with "one joint between" it and the actual one: at joint 5.
CASES = {
    "a": Case("redundant", ("end_3", "end_5")),
    "b": Case("overconstrained", ("end_1", "end_2", "end_3", "end_4", "end_5")),
    "c": Case("singular", ("end_4", "end_5")),
}


def case_arm(case: Case, q: Array = POSE, points: list[str] | None = None) -> PosedArm:
    """Return the planar arm with a case's end points at joint positions `q` `(5,)` [rad], or with other `points`."""
    return PosedArm.of(PLANAR, q, [_end_point(name) for name in points or case.points], "xy")


def _end_point(name: str) -> EndPoint | str:
    """Return a site by its name, or the middle of a link: its geom's own place."""
    return EndPoint("geom", f"link_{name.split()[-1]}") if name.startswith("middle") else name


@dataclass(frozen=True)
class Answer:
    """What one equation gives for a case.

    Attributes:
        equation: which.
        applies: whether the case is the equation's.
        dtheta: the step `(5,)` [rad], by the equation's own formula where the library refuses; None if that breaks down.
        library: what the library does: `answers`, or `refuses`.
    """

    equation: str
    applies: bool
    dtheta: Array | None
    library: str


def request_of(case: Case) -> tuple[Array, Array]:
    """Return diag W `(L,)` and dX_v* `(L,)` [m] of a case: every end point is to move by `MOVE`, each its own way."""
    n = len(case.points)
    angles = np.random.default_rng(n).uniform(-np.pi, np.pi, n)
    weights = [*[VIRTUAL_WEIGHT] * (n - 1), ACTUAL_WEIGHT]
    return diagonal_of_weights(weights, 2), MOVE * np.column_stack([np.cos(angles), np.sin(angles)]).ravel()


def answers(case: Case) -> list[Answer]:
    """Return what Eqs. 12 with 14, 16 and 17 give for a case."""
    jacobian = case_arm(case).jacobian
    weights, desired = request_of(case)
    factors = solve.rank_decomposition_svd(jacobian)
    both = solve.minimum_norm_solution(factors.j_b, solve.weighted_optimum(factors.j_a, weights, desired))
    return [Answer("12 and 14", True, both, "answers"), _eq_16(jacobian, desired), _eq_17(jacobian, weights, desired)]


def _eq_16(jacobian: Array, desired: Array) -> Answer:
    try:
        return Answer("16: J⁺ dX_v*", True, solve.redundant_solution(jacobian, desired), "answers")
    except InputError:
        step: Array = np.linalg.pinv(jacobian, rcond=solve.RANK_TOLERANCE) @ desired
        return Answer("16: J⁺ dX_v*", False, step, "refuses")


def _eq_17(jacobian: Array, weights: Array, desired: Array) -> Answer:
    equation = "17: (JᵀWJ)⁻¹JᵀW dX_v*"
    try:
        return Answer(equation, True, solve.overconstrained_solution(jacobian, weights, desired), "answers")
    except InputError:
        gram = jacobian.T @ (weights[:, None] * jacobian)
        try:
            step = np.asarray(np.linalg.solve(gram, jacobian.T @ (weights * desired)), dtype=float)
        except np.linalg.LinAlgError:
            return Answer(equation, False, None, "refuses")
        return Answer(equation, False, step, "refuses")
