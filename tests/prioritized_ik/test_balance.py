"""The arithmetic of a proof: rows that are nearly parallel in what is left, and directions turned by rounding."""

from functools import partial

import numpy as np
import pytest

from prioritized_ik.double_double import DoubleDouble
from prioritized_ik.problem import IKProblem, Level, Rows
from prioritized_ik.solvers.active_set import face_solution
from prioritized_ik.solvers.balance import balanced, exactly_balanced
from prioritized_ik.solvers.certificate import Proof
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.decided import Decided, Decision
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


def answer(rows: np.ndarray, decides: np.ndarray) -> np.ndarray:
    return decides @ np.linalg.pinv(rows @ decides)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("angle", [0.0, 1e-10, 1e-6])
def test_what_is_left_is_turned_back_to_where_rows_do_not_feel_it_to_their_last_digit(seed, angle):
    rows, decides, free = split(seed)
    decided = Decided((Decision(rows, partial(answer, rows, decides), WEAK, is_rounded=False),))
    turned = free + angle * np.outer(decides[:, -1], [1.0, 0.0, 0.0])
    left = decided.left(turned, 1)
    felt = np.abs((DoubleDouble.of(rows) @ left).rounded).max()
    assert felt < WEAK * decided.turn(1) < 1e-24
    assert np.abs(rows @ turned).max() > 1e6 * felt
    assert np.abs(left.rounded - free).max() < 1e-12


def test_what_one_level_leaves_stays_so_where_the_next_one_is_left_too():
    rows, _, free = split(0)
    first = np.linalg.svd(rows[:2])[2]
    own = first[2:].T @ np.linalg.svd(rows[2:] @ first[2:].T)[2][:3].T
    one = Decision(rows[:2], partial(answer, rows[:2], first[:2].T), 1.0, is_rounded=False)
    decided = Decided((one, Decision(rows[2:], partial(answer, rows[2:], own), WEAK, is_rounded=False)))
    turned = free + 1e-8 * np.outer(own[:, 0] + first[0], [0.0, 1.0, 0.0])
    assert np.abs((DoubleDouble.of(rows) @ decided.left(turned, 2)).rounded).max() < 1e-24
    assert np.abs((DoubleDouble.of(rows[2:]) @ decided.left(turned, 1)).rounded).max() > 1e-12


def test_rows_that_a_metric_rounded_leave_half_a_unit_in_their_last_place():
    rows, decides, _ = split(0)
    decided = Decided((Decision(rows, partial(answer, rows, decides), WEAK, is_rounded=True),))
    assert decided.turn(1) == 0.5 * EPS / WEAK


def test_of_parallel_rows_the_one_that_moves_balances_the_gradient():
    rows = np.array([[1e-9, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    basis, held = np.eye(3)[:, :2], np.array([True, True, False])
    for gradient in ([-1.0, -0.5], [1.0, -0.5]):
        balance = balanced(rows, basis, np.array(gradient), held, np.zeros(2), ROUNDING, np.zeros(2))
        multipliers = balance.multipliers / balance.sizes
        assert np.abs(balance.rest).max() < 1e-15
        assert np.abs(multipliers).sum() < 2.0
        assert multipliers[2] == pytest.approx(0.5)


def test_a_row_that_none_above_holds_never_gets_a_negative_multiplier_for_the_sake_of_smaller_ones():
    rows = np.array([[1.0, 1e-3, 0.0], [1.0, 0.0, 0.0], [-1.0, 1.0, 0.0]])
    basis, held = np.eye(3)[:, :2], np.array([False, True, False])
    for seed in range(50):
        gradient = np.random.default_rng(seed).normal(size=2)
        balance = balanced(rows, basis, gradient, held, np.zeros(2), ROUNDING, np.zeros(2))
        assert (balance.multipliers[~held] >= 0.0).all()


def test_what_is_rounding_of_a_row_balances_nothing():
    """Either row moves the first joint alone, but for rounding, which would balance everything."""
    rows = np.array([[1.0, 1e-9, 0.0], [1.0, -1e-9, 0.0]])
    basis, gradient, held = np.eye(3)[:, :2], np.array([-1.0, -1e-3]), np.array([True, True])
    assert np.abs(balanced(rows, basis, gradient, held, np.zeros(2), ROUNDING, np.zeros(2)).rest).max() < 1e-9
    assert balanced(rows, basis, gradient, held, np.full(2, 1e-8), ROUNDING, np.zeros(2)).rest == pytest.approx(
        [0.0, -1e-3]
    )
    twofold = [DoubleDouble.of(numbers) for numbers in (rows, basis, gradient)]
    assert exactly_balanced(*twofold, held, np.zeros(2)).rest == pytest.approx([0.0, 0.0], abs=1e-20)
    assert exactly_balanced(*twofold, held, np.full(2, 1e-8)).rest == pytest.approx([0.0, -1e-3])


def test_a_share_that_is_rounding_is_left_out_and_the_others_balance_to_the_last_digit():
    """The first row alone balances the gradient; in doubles the others seem to have a share."""
    rng = np.random.default_rng(3)
    for _ in range(50):
        rows = rng.normal(size=(4, 5))
        rows[1:] -= rows[1:] @ np.outer(rows[0], rows[0]) / (rows[0] @ rows[0])
        gradient = DoubleDouble.of(rows[0]).times(np.full(5, -1.0 / 3.0))
        balance = exactly_balanced(
            DoubleDouble.of(rows), DoubleDouble.of(np.eye(5)), gradient, np.zeros(4, dtype=bool), np.zeros(5)
        )
        assert np.abs(balance.rest).max() < 1e-28
        assert (balance.multipliers[1:] >= 0.0).all()
        assert balance.multipliers[0] == pytest.approx(np.linalg.norm(rows[0]) / 3.0)


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
