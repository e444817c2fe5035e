"""The closed form, Eqs. (6) to (17), against oracles that share no code with it."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from arms import Bench, relative_error
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import Request, eqs_12_and_14, norm_error, requests, svd_oracle
from tolerances import ORACLE, ROUNDING, SABOTAGE

from prioritized_ik.errors import InputError
from prioritized_ik.models import PLANAR_ARM
from prioritized_ik.problem import Level
from prioritized_ik.solvers.closed_form import (
    RANK_TOLERANCE,
    RankDecomposition,
    TaskCase,
    general_solution,
    level_decomposition,
    minimum_norm_solution,
    overconstrained_solution,
    rank_decomposition_qr,
    rank_decomposition_svd,
    redundant_solution,
    resulting_displacement,
    task_case,
    weighted_cost,
    weighted_optimum,
)
from prioritized_ik.weights import FREE, diagonal_of_weights, winding_weights

FACTORISATIONS = [rank_decomposition_svd, rank_decomposition_qr]


def spread(jacobian: np.ndarray) -> float:
    """σ_34 / σ_1."""
    s = np.linalg.svd(jacobian, compute_uv=False)
    return float(s[33] / s[0])


#: Exact numbers are whole ones, in units of 2^-256: 77 digits after the point, of which all that follows leaves fifty.
POINT = 256


@np.vectorize(otypes=[object])
def exactly(number: float) -> int:
    top, bottom = float(number).as_integer_ratio()
    return (top << POINT) // bottom


def product(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return (one @ other) >> POINT


def root(number: int) -> int:
    return math.isqrt(number << POINT)


def exact_tangents(direction: np.ndarray) -> np.ndarray:
    """Two directions `(3, 2)` square to `direction`."""
    first = np.cross(direction, exactly(np.eye(3)[np.argmin(np.abs(direction.astype(float)))])) >> POINT
    second = np.cross(direction, first) >> POINT
    return np.column_stack([(tangent << POINT) // root(product(tangent, tangent)) for tangent in (first, second)])


def exact_spd_solve(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve by Cholesky."""
    rest, x, n = matrix.copy(), right.copy(), len(right)
    factor = np.zeros((n, n), dtype=object)
    for j in range(n):
        factor[j, j] = root(rest[j, j])
        factor[j + 1 :, j] = (rest[j + 1 :, j] << POINT) // factor[j, j]
        rest[j + 1 :, j + 1 :] -= np.outer(factor[j + 1 :, j], factor[j + 1 :, j]) >> POINT
    for i in range(n):
        x[i] = ((x[i] - (factor[i, :i] @ x[:i] >> POINT)) << POINT) // factor[i, i]
    for i in reversed(range(n)):
        x[i] = ((x[i] - (factor[i + 1 :, i] @ x[i + 1 :] >> POINT)) << POINT) // factor[i, i]
    return x


def test_exact_numbers_solve_a_system_whose_answer_is_known() -> None:
    # A Hilbert matrix: doubles leave of the answer, all ones, four digits of sixteen.
    hilbert = np.array([[(1 << POINT) // (i + j + 1) for j in range(9)] for i in range(9)], dtype=object)
    found = exact_spd_solve(hilbert, hilbert.sum(axis=1)) - (1 << POINT)
    assert max(abs(int(off)) for off in found) < (1 << POINT) // 10**50


def exact_oracle(bench: Bench, jacobian: np.ndarray, weights: np.ndarray, desired: np.ndarray) -> np.ndarray:
    """Eqs. (12) and (14) by their Gram matrices in 50 digits.

    The factors of Eq. (6) come from geometry, not from a decomposition: relative to the link end before it, a link end
    moves along two tangents, so that J_b holds 2·17 = 34 tangential velocities and J_a adds them up along the arm.
    """
    directions = exactly(bench.data.xmat[1:].reshape(17, 3, 3)[:, :, 0])
    blocks = exactly(jacobian).reshape(17, 3, 49)
    j_a, j_b = exactly(np.zeros((51, 34))), exactly(np.zeros((34, 49)))
    for i, direction in enumerate(directions):
        tangents = exact_tangents(direction)
        j_b[2 * i : 2 * i + 2] = product(tangents.T, blocks[i] - (blocks[i - 1] if i else 0))
        for outer in range(i, 17):
            j_a[3 * outer : 3 * outer + 3, 2 * i : 2 * i + 2] = tangents
    assert np.abs((product(j_a, j_b) / (1 << POINT)).astype(float) - jacobian).max() < ROUNDING
    weighted = (exactly(weights)[:, None] * j_a) >> POINT
    dx_b = exact_spd_solve(product(j_a.T, weighted), product(weighted.T, exactly(desired)))
    return (product(j_b.T, exact_spd_solve(product(j_b, j_b.T), dx_b)) / (1 << POINT)).astype(float)


# Eq. (6)


@pytest.mark.parametrize("factorise", FACTORISATIONS)
def test_eq6_the_factors_multiply_to_the_jacobian_and_have_full_rank(
    paper_arm: Bench, factorise: Callable[..., RankDecomposition]
) -> None:
    for q in paper_arm.general_poses(20, seed=31):
        jacobian = paper_arm.jacobian(q)
        factors = factorise(jacobian)
        assert (factors.j_a.shape, factors.j_b.shape) == ((51, 34), (34, 49))
        assert relative_error(factors.j_a @ factors.j_b, jacobian) < ROUNDING
        assert np.linalg.matrix_rank(factors.j_a) == np.linalg.matrix_rank(factors.j_b) == 34


@pytest.mark.parametrize("kind", FREE)
def test_eq6_the_answer_does_not_depend_on_the_factorisation(paper_arm: Bench, kind: str) -> None:
    for jacobian, weights, _ in requests(paper_arm, kind, 50, seed=32):
        # A request that the arm can meet: with others, the factors' own rounding is magnified (see below).
        desired = jacobian @ np.random.default_rng(32).normal(scale=1e-3, size=49)
        by_svd, by_qr = (eqs_12_and_14(factorise(jacobian), weights, desired) for factorise in FACTORISATIONS)
        assert norm_error(by_qr, by_svd) < ORACLE


@pytest.mark.parametrize("factorise", FACTORISATIONS)
@given(rank=st.integers(0, 4), rows=st.integers(4, 7), columns=st.integers(4, 7), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=40, derandomize=True, deadline=None)
def test_eq6_finds_the_rank_that_a_product_was_built_with(
    factorise: Callable[..., RankDecomposition], rank: int, rows: int, columns: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    left, right = (np.linalg.qr(rng.normal(size=(n, n)))[0][:, :rank] for n in (rows, columns))
    matrix = left * rng.uniform(0.5, 2.0, rank) @ right.T
    factors = factorise(matrix)
    assert factors.rank == rank
    assert np.abs(factors.j_a @ factors.j_b - matrix).max() < ROUNDING


def test_eq6_drops_singular_values_up_to_the_tolerance() -> None:
    matrix = np.diag([1.0, 1e-3, 1e-5, 1e-7])
    assert [rank_decomposition_svd(matrix, t).rank for t in (1e-8, 1e-6, 1e-4, 1e-2)] == [4, 3, 2, 1]
    assert [rank_decomposition_qr(matrix, t).rank for t in (1e-8, 1e-6, 1e-4, 1e-2)] == [4, 3, 2, 1]


def test_a_lower_level_counts_its_rank_against_all_it_could_do() -> None:
    level = Level(np.diag([1.0, 1e-9]), np.zeros(2))
    factors, unfelt, _ = level_decomposition(level, np.eye(2)[:, 1:], 1e-6)
    assert (factors.rank, unfelt.shape) == (0, (1, 1))


def test_a_levels_factors_give_its_matrix() -> None:
    matrix = np.random.default_rng(0).normal(size=(5, 3))
    factors, _, _ = level_decomposition(Level(matrix, np.zeros(5)), np.eye(3), 1e-6)
    assert relative_error(factors.j_a @ factors.j_b, matrix) <= 1e-14
    assert relative_error(factors.j_b @ factors.j_b.T, np.eye(3)) <= 1e-14


def test_a_levels_factors_are_those_of_its_matrix_whatever_the_weights() -> None:
    matrix = np.random.default_rng(0).normal(size=(5, 3)) * [1.0, 1.0, 1e-5]
    for weights in (np.ones(5), [200.0, 20.0, 1.0, 0.01, 0.01], [1e-9, 1e9, 1.0, 1e-9, 1e9]):
        for tolerance, rank in ((1e-3, 2), (1e-7, 3)):
            unweighted, _, _ = level_decomposition(Level(matrix, np.zeros(5)), np.eye(3), tolerance)
            factors, _, _ = level_decomposition(Level(matrix, np.zeros(5), weights), np.eye(3), tolerance)
            assert factors.rank == rank
            assert np.array_equal(factors.j_a, unweighted.j_a)
            assert np.array_equal(factors.j_b, unweighted.j_b)


@pytest.mark.parametrize(("rows", "rank"), [(7, 4), (5, 2), (2, 2), (3, 0)])
def test_what_a_level_does_not_feel_completes_what_it_feels(rows: int, rank: int) -> None:
    rng = np.random.default_rng(rows)
    matrix = rng.normal(size=(rows, rank)) @ rng.normal(size=(rank, 6))
    free = np.linalg.qr(rng.normal(size=(6, 5)))[0]
    factors, unfelt, _ = level_decomposition(Level(matrix, np.zeros(rows)), free, 1e-6)
    whole = np.hstack([factors.j_b.T, unfelt])
    assert factors.rank == rank
    assert np.abs(whole.T @ whole - np.eye(5)).max() < ROUNDING
    assert np.abs(matrix @ free @ unfelt).max() < ROUNDING * max(1.0, np.abs(matrix).max())


def test_a_level_without_rank_tolerance_is_cut_where_only_rounding_is_left_whatever_the_units_of_its_rows() -> None:
    matrix = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.6, 0.8, 1e-14]])
    for units in (np.ones(3), [1e-9, 1.0, 1e9], [1e3, 1e-3, 1.0]):
        level = Level(np.array(units)[:, None] * matrix, np.zeros(3))
        factors, unfelt, spectrum = level_decomposition(level, np.eye(3), 0.0)
        assert factors.rank == 2
        assert np.abs(unfelt) == pytest.approx(np.eye(3)[:, 2:], abs=1e-13)
        assert spectrum.kept == pytest.approx([np.sqrt(2.0), 1.0], rel=ROUNDING)
        assert spectrum.cut[0] < ROUNDING
        assert spectrum.relative_to == "a row's length"


def test_a_level_cut_to_a_rank_tolerance_tells_the_values_kept_and_cut_relative_to_its_largest() -> None:
    level = Level(3.0 * np.diag([1.0, 1e-3, 1e-5, 1e-7]), np.zeros(4))
    for tolerance, rank in ((1e-8, 4), (1e-6, 3), (1e-4, 2), (1e-2, 1)):
        factors, _, spectrum = level_decomposition(level, np.eye(4), tolerance)
        assert factors.rank == len(spectrum.kept) == rank
        assert [*spectrum.kept, *spectrum.cut] == pytest.approx([1.0, 1e-3, 1e-5, 1e-7], rel=1e-9)
        assert np.abs(spectrum.cut_rows) == pytest.approx(np.eye(4)[rank:], abs=ROUNDING)
        assert spectrum.relative_to == "the largest of the matrix"


@pytest.mark.parametrize("tolerance", [0.0, 1e-6])
def test_a_level_without_rows_or_of_zeros_decides_nothing(tolerance: float) -> None:
    for rows in (0, 2):
        factors, unfelt, spectrum = level_decomposition(Level(np.zeros((rows, 3)), np.zeros(rows)), np.eye(3), tolerance)
        assert factors.j_a.shape == (rows, 0)
        assert factors.j_b.shape == (0, 3)
        assert np.abs(unfelt @ unfelt.T - np.eye(3)).max() < ROUNDING
        assert len(spectrum.kept) == 0


@pytest.mark.parametrize("bad", [0.0, 1.0, -1e-6, np.nan])
@pytest.mark.parametrize("factorise", [*FACTORISATIONS, task_case])
def test_a_rank_tolerance_outside_zero_to_one_is_refused(factorise: Callable[..., object], bad: float) -> None:
    with pytest.raises(InputError, match=f"rank_tolerance is {bad!r}; expected a number above 0 and below 1"):
        factorise(np.eye(2), bad)


# Fig. 3


@pytest.fixture(scope="module")
def planar() -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """J, weights and dX* of the three cases of Fig. 3."""
    rng = np.random.default_rng(41)
    q = rng.uniform(0.2, 0.8, 5)
    cases = {}
    for case, links in {"a": (3, 5), "b": (1, 2, 3, 4, 5), "c": (4, 5)}.items():
        jacobian = Bench.of(PLANAR_ARM, "xy", [f"end_{link}" for link in links]).jacobian(q)
        weights = diagonal_of_weights(rng.uniform(0.5, 50.0, len(links)), 2)
        cases[case] = (jacobian, weights, rng.normal(scale=1e-3, size=len(weights)))
    return cases


def test_fig3a_end_points_at_links_3_and_5_are_redundant_and_eq16_applies(planar: dict[str, Request]) -> None:
    jacobian, weights, desired = planar["a"]
    assert jacobian.shape == (4, 5)
    assert task_case(jacobian) is TaskCase.REDUNDANT
    found = redundant_solution(jacobian, desired)
    assert norm_error(found, np.linalg.pinv(jacobian) @ desired) < ROUNDING
    assert norm_error(eqs_12_and_14(rank_decomposition_svd(jacobian), weights, desired), found) < ORACLE
    assert norm_error(jacobian @ found, desired) < ROUNDING


def test_fig3b_end_points_at_all_links_are_overconstrained_and_eq17_applies(planar: dict[str, Request]) -> None:
    jacobian, weights, desired = planar["b"]
    assert jacobian.shape == (10, 5)
    assert task_case(jacobian) is TaskCase.OVERCONSTRAINED
    found = overconstrained_solution(jacobian, weights, desired)
    weighted = weights[:, None] * jacobian
    assert norm_error(found, np.linalg.solve(jacobian.T @ weighted, weighted.T @ desired)) < ORACLE
    assert norm_error(eqs_12_and_14(rank_decomposition_svd(jacobian), weights, desired), found) < ORACLE


def test_fig3c_end_points_at_links_4_and_5_are_singular_and_neither_eq16_nor_eq17_applies(
    planar: dict[str, Request],
) -> None:
    jacobian, weights, desired = planar["c"]
    assert jacobian.shape == (4, 5)
    assert rank_decomposition_svd(jacobian).rank == 3
    assert task_case(jacobian) is TaskCase.SINGULAR
    with pytest.raises(InputError, match=r"Eq. \(16\) needs the case REDUNDANT of Fig. 3, but J \(4, 5\) is SINGULAR"):
        redundant_solution(jacobian, desired)
    with pytest.raises(
        InputError, match=r"Eq. \(17\) needs the case OVERCONSTRAINED of Fig. 3, but J \(4, 5\) is SINGULAR"
    ):
        overconstrained_solution(jacobian, weights, desired)


def test_fig3c_is_solved_by_eqs_12_and_14_together(planar: dict[str, Request]) -> None:
    jacobian, weights, desired = planar["c"]
    root = np.sqrt(weights)
    truth = np.linalg.pinv(root[:, None] * jacobian, rcond=1e-9) @ (root * desired)
    for factorise in FACTORISATIONS:
        assert norm_error(eqs_12_and_14(factorise(jacobian), weights, desired), truth) < ORACLE


def test_eq16_refuses_the_overconstrained_and_eq17_the_redundant_case(planar: dict[str, Request]) -> None:
    with pytest.raises(InputError, match=r"Eq. \(16\) .* is OVERCONSTRAINED"):
        redundant_solution(planar["b"][0], planar["b"][2])
    with pytest.raises(InputError, match=r"Eq. \(17\) .* is REDUNDANT"):
        overconstrained_solution(*planar["a"])


def test_eqs_16_and_17_both_apply_to_a_square_jacobian_of_full_rank() -> None:
    rng = np.random.default_rng(42)
    jacobian, weights, desired = rng.normal(size=(5, 5)), rng.uniform(0.5, 50.0, 5), rng.normal(size=5)
    truth = np.linalg.solve(jacobian, desired)
    assert norm_error(redundant_solution(jacobian, desired), truth) < ORACLE
    assert norm_error(overconstrained_solution(jacobian, weights, desired), truth) < ORACLE


def test_the_paper_arm_is_always_the_singular_case(paper_arm: Bench) -> None:
    assert all(task_case(paper_arm.jacobian(q)) is TaskCase.SINGULAR for q in paper_arm.general_poses(20, seed=43))
    assert task_case(paper_arm.jacobian(np.zeros(49))) is TaskCase.SINGULAR


def test_eq17_solved_plainly_on_the_paper_arm_gives_a_wildly_longer_step_or_none(paper_arm: Bench) -> None:
    for name, seed in (("arched", 0), ("random", 1), ("random", 2), ("random", 3)):
        jacobian = paper_arm.jacobian(paper_arm.arm.posture(name, seed))
        weights = diagonal_of_weights(winding_weights(6, 17), 3)
        desired = np.zeros((17, 3))
        desired[6, 2] = -4e-3
        best = eqs_12_and_14(rank_decomposition_svd(jacobian), weights, desired.ravel())
        weighted = weights[:, None] * jacobian
        try:
            plain = np.linalg.norm(np.linalg.solve(jacobian.T @ weighted, weighted.T @ desired.ravel()))
        except np.linalg.LinAlgError:
            plain = np.inf
        assert np.linalg.norm(best) < 0.3
        assert plain > 10.0 * np.linalg.norm(best)


# Eqs. (10) to (15)


@pytest.mark.parametrize("kind", FREE)
def test_eqs_12_and_14_equal_the_weighted_pseudoinverse_in_200_poses(paper_arm: Bench, kind: str) -> None:
    worst = 0.0
    for jacobian, weights, desired in requests(paper_arm, kind, 200, seed=51):
        factors, _, _ = level_decomposition(Level(jacobian, desired, weights), np.eye(49), RANK_TOLERANCE)
        assert factors.rank == 34
        truth = svd_oracle(jacobian, weights, desired)
        worst = max(worst, norm_error(eqs_12_and_14(factors, weights, desired), truth))
    assert worst < ORACLE


@pytest.mark.parametrize("factorise", FACTORISATIONS)
@pytest.mark.parametrize("kind", FREE)
def test_eqs_12_and_14_meet_requests_that_can_be_met_in_200_poses(
    paper_arm: Bench, kind: str, factorise: Callable[..., RankDecomposition]
) -> None:
    rng = np.random.default_rng(53)
    for jacobian, weights, _ in requests(paper_arm, kind, 200, seed=53):
        desired = jacobian @ rng.normal(scale=1e-3, size=49)
        found = eqs_12_and_14(factorise(jacobian), weights, desired)
        assert norm_error(found, svd_oracle(jacobian, weights, desired)) < ORACLE


@pytest.mark.parametrize("kind", FREE)
def test_eqs_12_and_14_equal_a_fifty_digit_solution_in_the_15_worst_of_200_poses(paper_arm: Bench, kind: str) -> None:
    """Of the 200 poses of the tests above, the 15 nearest to a singular one, for each of both weightings: 30 in all."""
    poses = zip(paper_arm.general_poses(200, seed=51), requests(paper_arm, kind, 200, seed=51), strict=True)
    for q, (jacobian, weights, desired) in sorted(poses, key=lambda pose: spread(pose[1][0]))[:15]:
        assert np.array_equal(paper_arm.jacobian(q), jacobian)
        factors, _, _ = level_decomposition(Level(jacobian, desired, weights), np.eye(49), RANK_TOLERANCE)
        truth = exact_oracle(paper_arm, jacobian, weights, desired)
        assert norm_error(eqs_12_and_14(factors, weights, desired), truth) < ORACLE
        assert norm_error(svd_oracle(jacobian, weights, desired), truth) < ORACLE


def test_a_solution_with_one_weight_wrong_by_a_thousandth_fails_the_oracle(paper_arm: Bench) -> None:
    jacobian, weights, desired = next(requests(paper_arm, "eq24", 1, seed=54))
    wrong = weights.copy()
    wrong[0] *= 1.0 + SABOTAGE
    found = eqs_12_and_14(rank_decomposition_svd(jacobian), wrong, desired)
    assert norm_error(found, svd_oracle(jacobian, weights, desired)) > ORACLE


def test_eq10_is_the_weighted_sum_of_squares() -> None:
    assert weighted_cost(np.eye(2), np.array([2.0, 3.0]), np.array([1.0, 1.0]), np.array([0.0, 3.0])) == 14.0


@pytest.mark.parametrize("kind", FREE)
def test_eq12_minimises_the_cost_of_eq10(paper_arm: Bench, kind: str) -> None:
    rng = np.random.default_rng(55)
    for jacobian, weights, desired in requests(paper_arm, kind, 10, seed=55):
        j_a = rank_decomposition_svd(jacobian).j_a
        best = weighted_optimum(j_a, weights, desired)
        least = weighted_cost(j_a, weights, desired, best)
        for scale in (1e-1, 1e-2, 1e-3):
            for direction in rng.normal(size=(10, 34)):
                other = best + scale * np.linalg.norm(best) * direction
                assert weighted_cost(j_a, weights, desired, other) > least


def test_eq12_of_another_weighting_costs_more_by_eq10(paper_arm: Bench) -> None:
    jacobian, weights, desired = next(requests(paper_arm, "eq24", 1, seed=56))
    j_a = rank_decomposition_svd(jacobian).j_a
    least = weighted_cost(j_a, weights, desired, weighted_optimum(j_a, weights, desired))
    unweighted = weighted_optimum(j_a, np.ones(51), desired)
    assert weighted_cost(j_a, weights, desired, unweighted) > (1.0 + SABOTAGE) * least


@pytest.mark.parametrize("kind", FREE)
def test_eq13_is_the_step_nearest_to_the_reference_among_those_that_reach_dx_b(paper_arm: Bench, kind: str) -> None:
    rng = np.random.default_rng(57)
    for jacobian, weights, desired in requests(paper_arm, kind, 20, seed=57):
        factors = rank_decomposition_qr(jacobian)
        dx_b, reference = weighted_optimum(factors.j_a, weights, desired), rng.normal(scale=0.1, size=49)
        zero = np.zeros((34, 34))
        kkt = np.block([[np.eye(49), factors.j_b.T], [factors.j_b, zero]])
        truth = np.linalg.solve(kkt, np.concatenate([reference, dx_b]))[:49]
        found = general_solution(factors.j_b, dx_b, reference)
        assert norm_error(found, truth) < ORACLE
        assert norm_error(factors.j_b @ found, dx_b) < ORACLE


def test_eq13_with_no_reference_is_eq14(paper_arm: Bench) -> None:
    jacobian, weights, desired = next(requests(paper_arm, "eq23", 1, seed=58))
    factors = rank_decomposition_qr(jacobian)
    dx_b = weighted_optimum(factors.j_a, weights, desired)
    least = minimum_norm_solution(factors.j_b, dx_b)
    assert np.array_equal(general_solution(factors.j_b, dx_b, np.zeros(49)), least)
    assert norm_error(least, np.linalg.pinv(factors.j_b) @ dx_b) < ORACLE


def test_eq13_a_reference_along_the_null_space_is_followed_and_one_across_it_is_not() -> None:
    j_b = np.array([[1.0, 0.0, 0.0]])
    assert general_solution(j_b, np.array([0.5]), np.array([9.0, 2.0, 3.0])) == pytest.approx([0.5, 2.0, 3.0])


@pytest.mark.parametrize("kind", FREE)
def test_eq15_is_where_the_end_points_go_under_eqs_12_and_14(paper_arm: Bench, kind: str) -> None:
    for jacobian, weights, desired in requests(paper_arm, kind, 20, seed=59):
        factors = rank_decomposition_svd(jacobian)
        moved = jacobian @ eqs_12_and_14(factors, weights, desired)
        assert norm_error(resulting_displacement(factors.j_a, weights, desired), moved) < ORACLE


def test_eq15_gives_the_request_itself_when_it_can_be_met(planar: dict[str, Request]) -> None:
    jacobian, weights, desired = planar["a"]
    found = resulting_displacement(rank_decomposition_svd(jacobian).j_a, weights, desired)
    assert norm_error(found, desired) < ORACLE


@pytest.mark.parametrize("bend", [0.1, 0.01, 0.001])
def test_a_request_costs_the_inverse_of_the_distance_to_a_singular_pose_unless_truncated(
    paper_arm: Bench, bend: float
) -> None:
    q = next(paper_arm.general_poses(1, seed=60))
    costs = []
    for angle in (bend, bend / 10.0):
        q[48] = angle
        jacobian = paper_arm.jacobian(q)
        desired = 1e-3 * np.linalg.svd(jacobian)[0][:, 33]
        costs.append(np.linalg.norm(eqs_12_and_14(rank_decomposition_svd(jacobian, 1e-9), np.ones(51), desired)))
        truncated = eqs_12_and_14(rank_decomposition_svd(jacobian, 0.01), np.ones(51), desired)
        assert np.linalg.norm(truncated) < ORACLE
    assert costs[1] / costs[0] == pytest.approx(10.0, rel=0.2)
