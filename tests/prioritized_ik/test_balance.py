"""The arithmetic of a proof: rows that are nearly parallel in what is left, and directions turned by rounding."""

import numpy as np
import pytest

from prioritized_ik.problem import IKProblem, Level, Rows
from prioritized_ik.solvers.active_set import face_solution
from prioritized_ik.solvers.balance import Decided, balanced
from prioritized_ik.solvers.certificate import Proof
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.tolerances import EPS, ROUNDING

WEAK = 1e-3  # the weakest direction that a level decides
SETTLED = 1e-9  # of a row, with the rank cut at 1e-4


def split(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows `(5, 8)` of rank 5, what they decide `(8, 5)` and what they leave `(8, 3)`."""
    rng = np.random.default_rng(seed)
    u, _, vt = np.linalg.svd(rng.normal(size=(5, 8)))
    rows = u @ (np.geomspace(1.0, WEAK, 5)[:, None] * vt[:5])
    _, _, vt = np.linalg.svd(rows)
    return rows, vt[:5].T, vt[5:].T


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("angle", [1e-6, 1e-10, 1e-12])
def test_a_turn_of_what_is_left_is_measured_to_the_digits_of_extended_precision(seed, angle):
    rows, decides, free = split(seed)
    decided = Decided()
    decided.add(rows, decides, WEAK)
    assert decided.turn(free) < 4 * EPS / WEAK
    turned = free + angle * np.outer(decides[:, -1], [1.0, 0.0, 0.0])
    assert decided.turn(turned) == pytest.approx(angle, rel=0.01, abs=4 * EPS / WEAK)


def test_a_turn_at_one_level_is_carried_to_the_next():
    rows, _, free = split(0)
    decided = Decided()
    decided.add(rows[:2], np.linalg.svd(rows[:2])[2][:2].T, 1.0)
    below = np.linalg.svd(rows[:2])[2][2:].T
    own = below @ np.linalg.svd(rows[2:] @ below)[2][:3].T
    decided.add(rows[2:], own, WEAK)
    assert decided.turn(free) < 1e-11
    assert decided.turn(free + 1e-8 * np.outer(own[:, 0], [0.0, 1.0, 0.0])) == pytest.approx(1e-8, rel=0.01)


def test_of_parallel_rows_the_one_that_moves_balances_the_gradient():
    rows = np.array([[1e-9, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    basis, held = np.eye(3)[:, :2], np.array([True, True, False])
    for gradient in ([-1.0, -0.5], [1.0, -0.5]):
        balance = balanced(rows, basis, np.array(gradient), held, ROUNDING, extended=False)
        multipliers = balance.net(held) / balance.sizes
        assert np.abs(balance.rest).max() < 1e-15
        assert np.abs(multipliers).sum() < 2.0
        assert multipliers[2] == pytest.approx(0.5)


def test_a_row_that_none_above_holds_never_gets_a_negative_multiplier_for_the_sake_of_smaller_ones():
    rows = np.array([[1.0, 1e-3, 0.0], [1.0, 0.0, 0.0], [-1.0, 1.0, 0.0]])
    basis, held = np.eye(3)[:, :2], np.array([False, True, False])
    for seed in range(50):
        gradient = np.random.default_rng(seed).normal(size=2)
        balance = balanced(rows, basis, gradient, held, ROUNDING, extended=False)
        assert (balance.net(held)[~held] >= 0.0).all()


@pytest.mark.parametrize(("left", "kept_below"), [(1.5 * SETTLED, True), (0.5 * SETTLED, False)])
@pytest.mark.parametrize("spread", [1, 4, 16], ids="over {} joints".format)
def test_whether_a_level_settles_a_row_does_not_depend_on_how_many_joints_share_what_is_left(left, kept_below, spread):
    row = np.zeros((1, 17))
    row[0, 0], row[0, 1 : 1 + spread] = 1.0, left / np.sqrt(spread)
    problem = IKProblem([Level(np.eye(17)[:1], [1.0], name="first joint")], rows=Rows(row, [1.0 - 1e-10], ["row"]))
    u = face_solution(Hierarchy(problem, RANK_TOLERANCE), np.array([True]))
    assert u[0] == pytest.approx(1.0 if kept_below else 1.0 - 1e-10, abs=1e-14)


def test_two_rows_that_say_the_same_of_what_is_left_are_one_there():
    """Either row, alone, leaves more than what settles it; what tells them apart is less."""
    little = 0.3 * SETTLED
    rows = np.array([[0.0, 1.0, 0.0], [1.0, -2.0 * SETTLED, little]])
    rows[1] /= np.linalg.norm(rows[1])
    problem = IKProblem(
        [Level([[1.0, 0.0, 0.0]], [1.0], name="first joint")],
        rows=Rows(rows, [-0.5, 0.5], ["second joint", "both"]),
    )
    hierarchy = Hierarchy(problem, RANK_TOLERANCE)
    u = face_solution(hierarchy, np.array([True, True]))
    proof = Proof(hierarchy, u)
    assert proof.certificate.holds
    assert proof.certificate.held_by[0] == ("second joint", "both")
    assert u == pytest.approx([0.5, -0.5, 0.0], abs=1e-8)
