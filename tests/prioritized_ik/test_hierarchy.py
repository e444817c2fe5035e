"""The levels' own coordinates: blocks, strict closed form, equalities and pooled rows."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from arms import Bench
from hierarchies import random_hierarchy
from oracles import norm_error, requests, svd_oracle
from tolerances import ORACLE, ROUNDING, SABOTAGE

from prioritized_ik.errors import InputError
from prioritized_ik.problem import Bounds, Equalities, IKProblem, Level, Rows
from prioritized_ik.solvers.blocks import HARD, EqualBlock, SoftBlock
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE, general_solution, rank_decomposition_svd, weighted_optimum
from prioritized_ik.solvers.compiled.workspace import Sizes, workspace_for
from prioritized_ik.solvers.hierarchy import Hierarchy, strict_solution
from prioritized_ik.solvers.solve import solve
from prioritized_ik.solvers.step import StepStatus
from prioritized_ik.tolerances import AMPLE, DEPENDENT, EPS, FLOOR, NOISE
from prioritized_ik.weights import FREE

#: The planted problems' singular values are above 3e-3 of the largest, or zero: the cut is no matter of taste.
CUT = 1e-7
SEEDS = range(40)

#: Of a level's cost: squares of sums over rows under weights six decades apart, subtracted from each other; measured 4e-13.
COST = 1e-11


def hierarchy_of(seed: int) -> Hierarchy:
    return Hierarchy(random_hierarchy(seed, joints=(2, 25)).problem, CUT)


def blocks_of(hierarchy: Hierarchy) -> list[tuple[Level, EqualBlock]]:
    pairs = zip(hierarchy.problem.levels, hierarchy.blocks, strict=True)
    return [(level, block) for level, block in pairs if isinstance(block, EqualBlock)]


def random_level(rng: np.random.Generator, rows: int, joints: int) -> Level:
    return Level(rng.normal(size=(rows, joints)), rng.normal(size=rows), rng.uniform(0.5, 50.0, rows))


def assert_orthonormal(*bases: np.ndarray) -> None:
    """The columns of all `bases` together are orthonormal."""
    whole = np.hstack(bases)
    assert np.abs(whole.T @ whole - np.eye(whole.shape[1])).max(initial=0.0) <= ROUNDING


# Blocks.


@pytest.mark.parametrize("seed", SEEDS)
def test_felt_directions_of_all_levels_and_the_rest_are_one_orthonormal_basis_of_what_equalities_leave(seed):
    hierarchy = hierarchy_of(seed)
    felt = [block.felt for _, block in blocks_of(hierarchy)]
    assert_orthonormal(*felt, hierarchy.rest)
    whole = np.hstack([*felt, hierarchy.rest])
    assert whole @ whole.T == pytest.approx(hierarchy.free @ hierarchy.free.T, abs=ROUNDING)


@pytest.mark.parametrize("seed", SEEDS)
def test_no_level_feels_a_direction_that_belongs_to_one_below(seed):
    hierarchy = hierarchy_of(seed)
    for level, block in blocks_of(hierarchy):
        assert_orthonormal(block.felt, block.below)
        for rows in (level.matrix, block.matrix):
            if rows.any():
                assert np.linalg.norm(rows @ block.below) <= ROUNDING * np.linalg.norm(rows)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_level_has_what_the_one_above_leaves(seed):
    hierarchy = hierarchy_of(seed)
    free = hierarchy.free
    for block in hierarchy.blocks:
        if isinstance(block, EqualBlock):
            assert block.free is free
            assert block.felt.shape[1] + block.below.shape[1] == free.shape[1]
            free = block.below
    assert hierarchy.rest is free


@pytest.mark.parametrize("seed", SEEDS)
def test_a_block_is_triangular_in_its_felt_directions_and_its_inverse_undoes_it(seed):
    for _, block in blocks_of(hierarchy_of(seed)):
        size, p = np.linalg.norm(block.matrix), len(block.target)
        assert np.array_equal(block.root, np.triu(block.root))
        assert np.abs(block.matrix @ block.felt - block.root).max(initial=0.0) <= ROUNDING * size
        assert np.abs(block.matrix @ block.inverse - np.eye(p)).max(initial=0.0) <= ROUNDING * conditioning(block)
        outside = block.inverse - block.felt @ (block.felt.T @ block.inverse)
        assert np.linalg.norm(outside) <= ROUNDING * np.linalg.norm(block.inverse)


def conditioning(block: EqualBlock) -> float:
    """What rounding grows by on the way through R⁻¹: up to 5e4, with weights six decades apart."""
    return float(np.linalg.cond(block.root)) if block.root.size else 1.0


@pytest.mark.parametrize("seed", SEEDS)
def test_a_blocks_inverse_changes_nothing_above_it(seed):
    hierarchy = hierarchy_of(seed)
    blocks = [block for _, block in blocks_of(hierarchy)]
    for i, lower in enumerate(blocks):
        for upper in blocks[:i]:
            moved = np.linalg.norm(upper.matrix @ lower.inverse)
            assert moved <= ROUNDING * np.linalg.norm(upper.matrix) * np.linalg.norm(lower.inverse)


def cost_gaps(level: Level, block: EqualBlock, seed: int) -> list[float]:
    """By how much cost and block differ along steps that agree on all that the levels above decide, relatively."""
    rng = np.random.default_rng(seed)
    base = rng.normal(size=len(block.free))
    gaps = []
    steps = [base + block.free @ rng.normal(size=block.free.shape[1]) for _ in range(5)]
    costs = [level.cost(step) for step in steps]
    blocks = [float(np.sum(block.missing(step) ** 2)) for step in steps]
    for i in range(1, 5):
        gaps.append(((costs[i] - costs[0]) - (blocks[i] - blocks[0])) / max(*costs, 1e-300))
    return gaps


@pytest.mark.parametrize("seed", SEEDS)
def test_a_levels_cost_is_that_of_its_block_but_for_a_constant(seed):
    for level, block in blocks_of(hierarchy_of(seed)):
        assert np.abs(cost_gaps(level, block, seed)).max() <= COST


def test_a_block_of_other_weights_has_another_cost():
    rng = np.random.default_rng(3)
    level = random_level(rng, 4, 6)
    other = Level(level.matrix, level.target, level.weights * [1.0 + SABOTAGE, 1.0, 1.0, 1.0])
    (block,) = Hierarchy(IKProblem([level])).blocks
    assert np.abs(cost_gaps(level, block, 0)).max() <= ROUNDING
    assert np.abs(cost_gaps(other, block, 0)).max() > 1e3 * ROUNDING


def test_what_a_block_misses_is_what_is_left_of_its_target():
    level = Level([[2.0, 0.0, 0.0], [0.0, 3.0, 0.0]], [4.0, 6.0], [1.0, 9.0])
    (block,) = Hierarchy(IKProblem([level])).blocks
    assert np.linalg.norm(block.missing(np.zeros(3))) == pytest.approx(np.hypot(4.0, 18.0), rel=1e-15)
    assert np.linalg.norm(block.missing(np.array([2.0, 1.0, 7.0]))) == pytest.approx(9.0, rel=1e-15)
    assert block.missing(np.array([2.0, 2.0, 7.0])) == pytest.approx([0.0, 0.0], abs=ROUNDING)
    assert block.demand == pytest.approx(np.hypot(4.0, 18.0), rel=1e-15)


def test_a_target_out_of_reach_does_not_make_a_block_miss_anything_but_counts_as_demand():
    level = Level([[1.0, 0.0], [1.0, 0.0]], [1.0, -1.0])
    (block,) = Hierarchy(IKProblem([level])).blocks
    assert block.missing(np.zeros(2)) == pytest.approx([0.0], abs=ROUNDING)
    assert block.demand == pytest.approx(np.sqrt(2.0), rel=1e-15)


def test_a_blocks_shortfall_is_the_gradient_of_half_its_cost_and_tells_how_large_its_terms_are():
    rng = np.random.default_rng(4)
    level = random_level(rng, 3, 5)
    hierarchy = Hierarchy(IKProblem([level]))
    (block,) = hierarchy.blocks
    none = np.zeros(0)
    for u in rng.normal(size=(5, 5)):
        found = block.shortfall(hierarchy.rows, none, none.astype(bool), u, block.free)
        gradient = found.felt.felt.T @ level.matrix.T @ (level.weights * (level.matrix @ u - level.target))
        most = block.demand + found.strength * np.linalg.norm(u)
        assert found.gradient == pytest.approx(gradient, rel=1e-12, abs=ROUNDING * most)
        assert (found.terms >= np.abs(found.gradient) * (1.0 - ROUNDING)).all()
        assert np.linalg.norm(found.gradient) <= most


def test_half_a_unit_of_what_is_given_turns_what_levels_leave_by_as_much_as_the_weakest_so_far():
    rows = np.diag([1.0, 1e-3, 1.0, 1e-6])
    soft = Level(rows[2:3], [1.0], kind="at_most")
    hierarchy = Hierarchy(IKProblem([Level(rows[:2], np.ones(2)), soft, Level(rows[2:], np.ones(2))]), 1e-8)
    turned = [hierarchy.turned_as_given(number) for number in (-1, 0, 1, 2, 3)]
    assert turned[0] == 0.0
    assert turned[1:] == pytest.approx([500.0 * EPS] * 2 + [5e5 * EPS] * 2, rel=0.1)


@pytest.mark.parametrize("seed", range(10))
def test_a_block_aimed_at_another_target_is_that_of_a_fresh_factorisation(seed):
    rng = np.random.default_rng(seed)
    levels = [random_level(rng, 2, 7), Level(rng.normal(size=(4, 2)) @ rng.normal(size=(2, 7)), rng.normal(size=4))]
    other = [Level(one.matrix, rng.normal(size=len(one.target)), one.weights) for one in levels]
    blocks, fresh = (Hierarchy(IKProblem(some)).blocks for some in (levels, other))
    for level, block, truth in zip(other, blocks, fresh, strict=True):
        aimed = block.aimed(level.target)
        for name in ("free", "felt", "root", "inverse", "matrix", "whitening", "below", "target"):
            assert np.array_equal(getattr(aimed, name), getattr(truth, name)), name
        assert aimed.demand == pytest.approx(truth.demand, rel=1e-15)
        assert aimed.settled == truth.settled
        assert aimed.root is block.root
        assert not np.array_equal(aimed.target, block.target)


def test_a_level_that_the_levels_above_settle_has_an_empty_block():
    levels = [Level(np.eye(3)[:2], [1.0, 2.0]), Level([[1.0, 1.0, 0.0]], [9.0]), Level(np.zeros((2, 3)), [1.0, 1.0])]
    _, settled, blind = Hierarchy(IKProblem(levels)).blocks
    for block in (settled, blind):
        assert block.felt.shape == (3, 0)
        assert block.matrix.shape == (0, 3)
        assert block.missing(np.ones(3)).shape == (0,)
        assert np.array_equal(block.below @ block.below.T, np.diag([0.0, 0.0, 1.0]))


def test_soft_levels_take_no_direction():
    levels = [Level(np.eye(3), np.ones(3), kind="at_most"), Level([[1.0, 0.0, 0.0]], [1.0])]
    hierarchy = Hierarchy(IKProblem(levels))
    soft, block = hierarchy.blocks
    assert isinstance(soft, SoftBlock)
    assert soft.is_soft
    assert not block.is_soft
    assert soft.below is block.free is hierarchy.free
    assert soft.demand == pytest.approx(np.sqrt(3.0), rel=1e-15)
    assert hierarchy.rest.shape == (3, 2)


def test_inequalities_take_no_part_in_the_cut():
    level = random_level(np.random.default_rng(0), 2, 4)
    rows = Rows([[1.0, 0.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0]], [0.0, 0.0])
    free, bound = Hierarchy(IKProblem([level])), Hierarchy(IKProblem([level], Bounds([-1.0] * 4, [0.0] * 4), rows))
    for name in ("free", "felt", "root", "inverse", "matrix", "target", "below"):
        assert np.array_equal(getattr(free.blocks[0], name), getattr(bound.blocks[0], name)), name
    assert np.array_equal(free.closed_form, bound.closed_form)


# Rank.


@pytest.mark.parametrize("weights", [[1.0, 1.0], [1e12, 1.0], [1.0, 1e12], [1e-12, 1.0], [1.0, 1e-12]])
def test_the_rank_of_a_level_is_that_of_its_matrix_whatever_its_weights(weights):
    for small, rank in ((1e-3, 2), (1e-5, 1)):
        (block,) = Hierarchy(IKProblem([Level(np.diag([1.0, small]), [1.0, 1.0], weights)]), 1e-4).blocks
        assert block.felt.shape[1] == rank


@pytest.mark.parametrize("seed", range(10))
def test_the_directions_of_all_levels_are_the_same_whatever_the_weights(seed):
    rng = np.random.default_rng(seed)
    levels = [Level(rng.normal(size=(4, 2)) @ rng.normal(size=(2, 8)), rng.normal(size=4)) for _ in range(3)]
    weighted = [Level(level.matrix, level.target, 10.0 ** rng.uniform(-3.0, 3.0, 4)) for level in levels]
    for one, other in zip(Hierarchy(IKProblem(levels)).blocks, Hierarchy(IKProblem(weighted)).blocks, strict=True):
        assert one.felt.shape == (8, 2)
        assert one.felt @ one.felt.T == pytest.approx(other.felt @ other.felt.T, abs=ROUNDING)


def test_a_lower_level_counts_its_rank_against_all_that_its_matrix_can_do():
    above = Level([[1.0, 0.0]], [1.0])
    for slope, rank in ((1e-3, 1), (1e-5, 0)):
        block = Hierarchy(IKProblem([above, Level([[1.0, slope]], [1.0])]), 1e-4).blocks[1]
        assert block.felt.shape[1] == rank


@pytest.mark.parametrize("bad", [-1e-9, 1.0, np.nan])
def test_a_rank_tolerance_out_of_range_is_refused(bad):
    with pytest.raises(InputError, match=f"rank_tolerance is {bad}; expected a number above 0 and below 1"):
        Hierarchy(IKProblem([Level(np.eye(2), np.ones(2))]), bad)


# The closed form.


def projected_least_squares(problem: IKProblem) -> np.ndarray:
    """Equalities and levels in strict order, then the reference, by pseudo-inverses of weighted matrices in projectors."""
    m = problem.joint_count
    equalities = problem.equalities
    scales = np.linalg.norm(equalities.matrix, axis=1)
    levels = [(equalities.matrix / scales[:, None], equalities.target / scales)]
    levels += [(np.sqrt(one.weights)[:, None] * one.matrix, np.sqrt(one.weights) * one.target) for one in problem.levels]
    dtheta, projector = np.zeros(m), np.eye(m)
    for matrix, target in levels:
        u, s, vt = np.linalg.svd(matrix @ projector, full_matrices=False)
        p = np.count_nonzero(s > 1e-8 * np.linalg.norm(matrix, 2)) if matrix.any() else 0
        dtheta = dtheta + vt[:p].T @ (u[:, :p].T @ (target - matrix @ dtheta) / s[:p])
        projector = projector - vt[:p].T @ vt[:p]
    return dtheta + projector @ (problem.reference - dtheta)


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("count", [1, 2, 3, 5, 8])
def test_the_closed_form_of_any_number_of_levels_is_the_recursion_of_pseudo_inverses(count, seed):
    rng = np.random.default_rng([seed, count])
    levels = []
    for _ in range(count):
        k, p = int(rng.integers(1, 5)), int(rng.integers(1, 3))
        matrix = rng.normal(size=(k, p)) @ rng.normal(size=(p, 9))
        levels.append(Level(matrix, rng.normal(size=k), rng.uniform(0.1, 10.0, k)))
    equal = Equalities(rng.normal(size=(1, 9)), rng.normal(size=1))
    problem = IKProblem(levels, reference=rng.normal(size=9), equalities=equal)
    assert norm_error(Hierarchy(problem, 1e-6).closed_form, projected_least_squares(problem)) <= ORACLE


def test_the_recursion_tells_a_target_that_is_off_by_a_thousandth():
    rng = np.random.default_rng(1)
    levels = [random_level(rng, 2, 7) for _ in range(3)]
    problem = IKProblem(levels)
    off = IKProblem([*levels[:2], Level(levels[2].matrix, (1.0 + SABOTAGE) * levels[2].target, levels[2].weights)])
    assert norm_error(Hierarchy(problem).closed_form, projected_least_squares(problem)) <= ORACLE
    assert norm_error(Hierarchy(off).closed_form, projected_least_squares(problem)) > 1e3 * ORACLE


@pytest.mark.parametrize("seed", range(20))
def test_the_closed_form_is_the_planted_optimum_where_no_row_presses(seed):
    features = {"equalities", "overlap", "conflict", "dependent", "scales"}
    known = random_hierarchy(seed, features, joints=(3, 40))
    assert not known.presses
    assert norm_error(Hierarchy(known.problem, CUT).closed_form, known.dtheta) <= ORACLE


@pytest.mark.parametrize("kind", FREE)
def test_strict_solution_of_one_level_equals_the_weighted_pseudoinverse_in_200_poses(paper_arm: Bench, kind: str) -> None:
    worst = max(
        norm_error(strict_solution([Level(j, dx, w)], np.zeros(49)), svd_oracle(j, w, dx))
        for j, w, dx in requests(paper_arm, kind, 200, seed=51)
    )
    assert worst < ORACLE


def test_strict_solution_of_one_level_is_eqs_12_and_13(paper_arm: Bench) -> None:
    jacobian, weights, desired = next(requests(paper_arm, "eq24", 1, seed=61))
    reference = np.random.default_rng(61).normal(scale=0.1, size=49)
    factors = rank_decomposition_svd(jacobian)
    found = strict_solution([Level(jacobian, desired, weights)], reference)
    truth = general_solution(factors.j_b, weighted_optimum(factors.j_a, weights, desired), reference)
    assert norm_error(found, truth) < ORACLE


@pytest.mark.parametrize("seed", range(10))
def test_strict_solution_of_two_levels_is_the_null_space_formula_of_siciliano_and_slotine(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first, second = random_level(rng, 3, 9), random_level(rng, 4, 9)
    reference = rng.normal(size=9)
    up = np.linalg.pinv(first.matrix)
    dtheta = up @ first.target
    within = second.matrix @ (np.eye(9) - up @ first.matrix)
    dtheta = dtheta + np.linalg.pinv(within, rcond=1e-9) @ (second.target - second.matrix @ dtheta)
    both = np.vstack([first.matrix, second.matrix])
    truth = dtheta + (np.eye(9) - np.linalg.pinv(both) @ both) @ reference
    assert norm_error(strict_solution([first, second], reference), truth) < ORACLE


@pytest.mark.parametrize("seed", range(5))
def test_strict_solution_when_the_second_level_conflicts_is_the_weighted_null_space_formula(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first, second = random_level(rng, 4, 6), random_level(rng, 5, 6)
    up = np.linalg.pinv(first.matrix)
    dtheta = up @ first.target
    root = np.sqrt(second.weights)
    within = root[:, None] * second.matrix @ (np.eye(6) - up @ first.matrix)
    truth = dtheta + np.linalg.pinv(within, rcond=1e-9) @ (root * (second.target - second.matrix @ dtheta))
    found = strict_solution([first, second], np.zeros(6))
    assert norm_error(found, truth) < ORACLE
    assert norm_error(first.matrix @ found, first.target) < ORACLE


def test_strict_solution_in_the_other_order_of_conflicting_levels_is_another_step() -> None:
    rng = np.random.default_rng(62)
    first, second = random_level(rng, 4, 6), random_level(rng, 5, 6)
    one, other = (strict_solution(levels, np.zeros(6)) for levels in ([first, second], [second, first]))
    assert norm_error(one, other) > SABOTAGE


def test_strict_solution_a_second_level_that_contradicts_the_first_changes_nothing() -> None:
    first = random_level(np.random.default_rng(63), 3, 6)
    contrary = Level(first.matrix, -first.target)
    alone = strict_solution([first], np.zeros(6))
    assert norm_error(strict_solution([first, contrary], np.zeros(6)), alone) < ORACLE


def test_strict_solution_ignores_levels_and_reference_once_no_direction_is_free() -> None:
    rng = np.random.default_rng(64)
    full = random_level(rng, 6, 6)
    found = strict_solution([full, random_level(rng, 2, 6)], rng.normal(size=6))
    assert norm_error(found, np.linalg.solve(full.matrix, full.target)) < ORACLE


def test_the_cut_problem_has_the_same_optimum_without_a_rank_tolerance() -> None:
    rng = np.random.default_rng(65)
    weak = np.diag([1.0, 1e-5, 0.0, 0.0, 0.0, 0.0])[:2] @ np.linalg.qr(rng.normal(size=(6, 6)))[0]
    levels = [Level(weak, [1.0, 2.0]), random_level(rng, 3, 6), Level(rng.normal(size=(2, 6)), np.zeros(2), kind="at_most")]
    problem = IKProblem(levels, Bounds([-9.0] * 6, [9.0] * 6), reference=rng.normal(size=6))
    hierarchy = Hierarchy(problem, 1e-4)
    cut = hierarchy.cut_problem
    assert norm_error(Hierarchy(problem, 1e-9).closed_form, hierarchy.closed_form) > SABOTAGE  # it matters
    assert norm_error(Hierarchy(cut, 1e-9).closed_form, hierarchy.closed_form) <= ORACLE
    for level, block in zip(cut.levels, hierarchy.blocks, strict=True):
        assert isinstance(block, SoftBlock) or np.abs(level.matrix @ block.below).max() <= ROUNDING
    assert cut.levels[2] is problem.levels[2]
    assert cut.bounds is problem.bounds
    assert np.array_equal(cut.reference, problem.reference)


# The spectrum.


def test_without_a_rank_tolerance_a_block_keeps_all_that_is_not_rounding_and_says_what_it_cut():
    level = Level([[3.0, 0.0, 0.0], [0.0, 1e-9, 0.0], [5.0, 1e-13, 0.0]], [1.0, 2.0, 3.0])
    (block,) = Hierarchy(IKProblem([level])).blocks
    assert block.spectrum.kept == pytest.approx([np.sqrt(2.0), 1.0], rel=1e-12)
    assert block.spectrum.cut == pytest.approx([0.0], abs=1e-14)
    assert block.spectrum.relative_to == "a row's length"
    assert block.felt.shape == (3, 2)


def test_rows_that_differ_by_rounding_only_are_one():
    for angle, rank in ((1e-13, 1), (1e-11, 2)):
        (block,) = Hierarchy(IKProblem([Level([[1.0, 0.0], [1.0, angle]], [1.0, 1.0])])).blocks
        assert block.felt.shape[1] == rank
        whole = np.concatenate([block.spectrum.kept, block.spectrum.cut])
        assert whole == pytest.approx([np.sqrt(2.0), angle / np.sqrt(2.0)], rel=1e-3)


def test_with_a_rank_tolerance_singular_values_are_relative_to_the_largest_of_the_matrix():
    level = Level(np.diag([2.0, 2e-3, 2e-6]), np.ones(3))
    (block,) = Hierarchy(IKProblem([level]), 1e-4).blocks
    assert block.spectrum.kept == pytest.approx([1.0, 1e-3], rel=1e-12)
    assert block.spectrum.cut == pytest.approx([1e-6], rel=1e-9)
    assert block.spectrum.relative_to == "the largest of the matrix"
    assert np.abs(block.spectrum.cut_rows) == pytest.approx(np.array([[0.0, 0.0, 1.0]]), abs=ROUNDING)


def test_what_the_levels_above_took_of_a_matrix_still_counts_as_its_largest_value():
    levels = [Level([[1.0, 0.0, 0.0]], [1.0]), Level(np.diag([10.0, 1.0, 1e-5]), np.ones(3))]
    block = Hierarchy(IKProblem(levels), 1e-4).blocks[1]
    assert block.spectrum.kept == pytest.approx([0.1], rel=1e-12)
    assert block.spectrum.cut[0] == pytest.approx(1e-6, rel=1e-9)


@pytest.mark.parametrize("c", [10.0**-n for n in range(1, 7)])
def test_regularisation_by_short_rows_and_by_light_ones_gives_the_same_blocks(c):
    rng = np.random.default_rng(16)
    j = (rng.integers(-3, 4, size=(4, 2)) @ rng.integers(-3, 4, size=(2, 6))).astype(float)  # of rank 2 to the last bit
    assert np.linalg.matrix_rank(j) == 2
    desired, posture = j @ rng.normal(size=6), rng.normal(size=6)  # out of reach, rounding grows with 1/c²
    below = random_level(rng, 2, 6)
    as_rows = Level(np.vstack([j, c * np.eye(6)]), np.append(desired, c * posture))
    as_weights = Level(np.vstack([j, np.eye(6)]), np.append(desired, posture), np.append(np.ones(4), np.full(6, c**2)))
    one, other = (Hierarchy(IKProblem([level, below])) for level in (as_rows, as_weights))
    for block, same in zip(one.blocks, other.blocks, strict=True):
        assert block.felt.shape == same.felt.shape
        assert block.matrix.T @ block.matrix == pytest.approx(same.matrix.T @ same.matrix, rel=1e-9, abs=ROUNDING)
    assert one.blocks[0].felt.shape == (6, 6)
    # Along what J does not feel the answer is the posture, however small c.
    assert norm_error(one.closed_form, other.closed_form) <= 1e-9
    null = np.linalg.svd(j)[2][2:]
    assert null @ one.closed_form == pytest.approx(null @ posture, abs=1e-9)


UNITS = {"mm": 1e3, "nm": 1e9, "km": 1e-3, "each its own": 10.0 ** np.array([3.0, -3.0, 6.0, 0.0])}


@pytest.mark.parametrize("factor", UNITS.values(), ids=UNITS.keys())
@pytest.mark.parametrize("seed", range(5))
def test_rows_in_other_units_beside_radians_give_the_same_closed_form_where_weights_make_up_for_them(factor, seed):
    rng = np.random.default_rng(seed)
    jacobian, desired, weights = rng.normal(size=(4, 7)), rng.normal(size=4), rng.uniform(0.5, 50.0, 4)
    angles, below = random_level(rng, 2, 7), random_level(rng, 3, 7)
    mixed = np.vstack([jacobian, angles.matrix])
    targets, all_weights = np.append(desired, angles.target), np.append(weights, angles.weights)
    units = np.append(factor * np.ones(4), [1.0, 1.0])
    reference = rng.normal(size=7)
    one = IKProblem([Level(mixed, targets, all_weights), below], reference=reference)
    other = IKProblem([Level(units[:, None] * mixed, units * targets, all_weights / units**2), below], reference=reference)
    assert norm_error(Hierarchy(other).closed_form, Hierarchy(one).closed_form) <= 1e-9


# The joint metric.


def some_metric(kind: str, m: int, rng: np.random.Generator) -> np.ndarray:
    """A metric over four decades, of a robot whose joints are counted in different units; coupled if `kind` is full."""
    diagonal = 10.0 ** rng.uniform(-2.0, 2.0, m)
    if kind == "diagonal":
        return diagonal
    turn = np.linalg.qr(rng.normal(size=(m, m)))[0]
    matrix = turn * diagonal @ turn.T
    return (matrix + matrix.T) / 2.0


def least_in_metric(problem: IKProblem) -> np.ndarray:
    """Levels in strict order by their null spaces, then the step nearest to the reference in the metric, from dθ itself."""
    m = problem.joint_count
    metric = np.diag(problem.metric) if problem.metric.ndim == 1 else problem.metric
    levels = [(problem.equalities.matrix, problem.equalities.target)]
    levels += [(np.sqrt(one.weights)[:, None] * one.matrix, np.sqrt(one.weights) * one.target) for one in problem.levels]
    dtheta, free = np.zeros(m), np.eye(m)
    for matrix, target in levels:
        if len(target) and free.shape[1]:
            seen = matrix @ free
            _, s, vt = np.linalg.svd(seen)
            dtheta = dtheta + free @ np.linalg.lstsq(seen, target - matrix @ dtheta, rcond=1e-9)[0]
            free = free @ vt[np.count_nonzero(s > 1e-9 * s[0]) :].T
    away = problem.reference - dtheta
    return dtheta + free @ np.linalg.solve(free.T @ metric @ free, free.T @ metric @ away)


def metric_problem(kind: str, seed: int) -> IKProblem:
    rng = np.random.default_rng([seed, len(kind)])
    levels = [random_level(rng, 2, 8), Level(rng.normal(size=(3, 2)) @ rng.normal(size=(2, 8)), rng.normal(size=3))]
    equal = Equalities(rng.normal(size=(1, 8)), rng.normal(size=1))
    return IKProblem(levels, reference=rng.normal(size=8), equalities=equal, metric=some_metric(kind, 8, rng))


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("kind", ["diagonal", "full"])
def test_the_closed_form_in_a_metric_is_the_weighted_least_norm(kind, seed):
    problem = metric_problem(kind, seed)
    found = problem.from_metric(Hierarchy(problem).closed_form)
    assert norm_error(found, least_in_metric(problem)) <= ORACLE


@pytest.mark.parametrize("kind", ["diagonal", "full"])
def test_another_metric_is_another_step_and_one_that_is_off_by_a_thousandth_is_found_out(kind):
    problem = metric_problem(kind, 0)
    truth = least_in_metric(problem)
    plain = IKProblem(problem.levels, reference=problem.reference, equalities=problem.equalities)
    assert norm_error(Hierarchy(plain).closed_form, truth) > SABOTAGE
    off = problem.metric.copy()
    off[(0, 0)[: off.ndim]] *= 1.0 + SABOTAGE
    other = IKProblem(problem.levels, reference=problem.reference, equalities=problem.equalities, metric=off)
    assert norm_error(other.from_metric(Hierarchy(other).closed_form), truth) > 1e3 * ORACLE


def test_a_metric_scaled_as_a_whole_changes_no_step():
    problem = metric_problem("full", 1)
    scaled = IKProblem(
        problem.levels, reference=problem.reference, equalities=problem.equalities, metric=1e6 * problem.metric
    )
    one, other = (each.from_metric(Hierarchy(each).closed_form) for each in (problem, scaled))
    assert norm_error(other, one) <= ORACLE


@pytest.mark.parametrize("kind", ["diagonal", "full"])
def test_joints_frozen_in_a_metric_are_where_they_are_frozen(kind):
    problem = metric_problem(kind, 2)
    lower = np.full(8, -np.inf)
    lower[[1, 4]] = 0.3, -0.2
    bounds = Bounds(lower, np.where(np.isfinite(lower), lower, np.inf))
    rest = {"reference": problem.reference, "metric": problem.metric}
    frozen = IKProblem(problem.levels[1:], bounds, **rest)
    equal = IKProblem(problem.levels[1:], equalities=Equalities(np.eye(8)[[1, 4]], [0.3, -0.2]), **rest)
    step = solve(frozen).dtheta
    assert step[[1, 4]] == pytest.approx([0.3, -0.2], rel=1e-12)
    assert norm_error(step, least_in_metric(equal)) <= ORACLE


@pytest.mark.parametrize("kind", ["diagonal", "full"])
def test_pooled_rows_in_a_metric_are_distances_in_it(kind):
    problem = metric_problem(kind, 3)
    rng = np.random.default_rng(3)
    rows = Rows(rng.normal(size=(2, 8)), rng.uniform(0.1, 1.0, 2))
    lower = np.append(-rng.uniform(0.1, 1.0, 4), np.full(4, -np.inf))
    bounded = IKProblem([], Bounds(lower, np.full(8, 2.0)), rows, metric=problem.metric)
    inverse = np.linalg.inv(np.diag(problem.metric) if kind == "diagonal" else problem.metric)
    pooled, hard = Hierarchy(bounded).rows, bounded.inequalities
    assert pooled.names == hard.names
    for step in rng.normal(size=(5, 8)):
        distances = [(h - g @ step) / np.sqrt(g @ inverse @ g) for g, h in zip(hard.matrix, hard.upper, strict=True)]
        assert pooled.slack(bounded.to_metric(step)) == pytest.approx(np.array(distances), rel=1e-9, abs=1e-11)


def best_of_all_faces(problem: IKProblem) -> np.ndarray:
    """The step nearest to the reference that keeps every row, from all sets of rows that could be equalities."""
    rows = problem.inequalities
    best, shortest = None, np.inf
    for count in range(4):
        for chosen in itertools.combinations(range(len(rows.upper)), count):
            face = Equalities(rows.matrix[list(chosen)], rows.upper[list(chosen)])
            step = least_in_metric(
                IKProblem(problem.levels, reference=problem.reference, equalities=face, metric=problem.metric)
            )
            away = problem.to_metric(step - problem.reference)
            off = problem.levels[0].cost(step)
            keeps = (rows.matrix @ step <= rows.upper + 1e-9).all() and off <= 1e-18
            if keeps and np.linalg.norm(away) < shortest:
                best, shortest = step, float(np.linalg.norm(away))
    assert best is not None
    return best


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("kind", ["diagonal", "full"])
def test_bounds_and_rows_in_a_metric_hold_the_step_that_is_nearest_in_it(kind, seed):
    rng = np.random.default_rng([seed, len(kind)])
    bounds, rows = Bounds(np.full(4, -0.5), np.full(4, 0.5)), Rows(rng.normal(size=(2, 4)), [0.2, 0.3])
    level = Level(rng.normal(size=(1, 4)), [0.1])
    problem = IKProblem([level], bounds, rows, rng.normal(size=4), metric=some_metric(kind, 4, rng))
    step = solve(problem)
    assert step.status is StepStatus.SOLVED
    assert norm_error(step.dtheta, best_of_all_faces(problem)) <= 1e-9


# What a step is likely to measure.


def likely_length(level: Level, **parts: object) -> float:
    return Hierarchy(IKProblem([level], **parts)).length / AMPLE


def test_a_step_is_likely_to_measure_what_the_closed_form_does_where_no_row_is_near():
    assert likely_length(Level([[1.0, 0.0]], [0.3]), reference=[0.0, 0.4]) == pytest.approx(0.5, rel=1e-15)


def test_a_step_is_likely_to_measure_what_half_of_the_rows_leave_where_that_is_shorter():
    level, far = Level([[1.0, 0.0]], [0.3]), {"reference": [0.0, 0.4]}
    assert likely_length(level, bounds=Bounds([-0.1, -0.2], [0.3, 0.2]), **far) == pytest.approx(0.2, rel=1e-15)
    # Rows that standing still exceeds, or ends on, leave nothing to measure by.
    assert likely_length(level, bounds=Bounds([0.0, 0.1], [0.3, 0.2]), **far) == pytest.approx(0.3, rel=1e-15)


@pytest.mark.parametrize("size", [1e-12, 1e-7, 1.0, 1e9])
def test_a_step_of_any_size_is_likely_to_measure_what_it_does(size):
    for parts in ({}, {"bounds": Bounds(np.full(2, -2.0 * size), np.full(2, 2.0 * size))}):
        assert likely_length(Level([[1.0, 0.0]], [size]), **parts) == pytest.approx(size, rel=1e-15)


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e9])
def test_a_step_is_likely_to_measure_the_way_out_of_the_row_that_is_broken_most(size):
    level = Level([[1.0, 0.0], [0.0, 2.0]], [-size, -6.0 * size], kind="at_most")
    assert likely_length(level) == pytest.approx(3.0 * size, rel=1e-15)


def test_where_nothing_is_asked_for_the_unit_is_one():
    assert Hierarchy(IKProblem([Level([[1.0, 0.0]], [0.0])])).length == 1.0


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_figures_of_a_step_count_against_its_length_and_of_one_near_zero_against_a_billionth_of_what_is_asked_for(size):
    hierarchy = Hierarchy(IKProblem([Level([[1.0, 0.0]], [size])]))
    assert hierarchy.scale(size * np.array([3.0, 4.0])) == pytest.approx(5.0 * size, rel=1e-15)
    for u in (np.zeros(2), np.array([0.0, 1e-12 * size])):
        assert hierarchy.scale(u) == pytest.approx(FLOOR * size, rel=1e-15)


# Equalities.


def with_equalities(matrix: object, target: object, joints: int = 4) -> Hierarchy:
    return Hierarchy(IKProblem([Level(np.eye(joints)[:1], [0.0])], equalities=Equalities(matrix, target)))


def test_without_equalities_everything_is_free_and_the_start_is_standing_still():
    hierarchy = Hierarchy(IKProblem([Level(np.eye(3), np.ones(3))]))
    assert np.array_equal(hierarchy.start, np.zeros(3))
    assert np.array_equal(hierarchy.free, np.eye(3))


def test_the_start_is_the_shortest_step_that_keeps_the_equalities():
    matrix, target = np.random.default_rng(5).normal(size=(2, 6)), np.array([1.0, -2.0])
    hierarchy = with_equalities(matrix, target, 6)
    assert hierarchy.start == pytest.approx(np.linalg.pinv(matrix) @ target, abs=ROUNDING)
    assert np.abs(matrix @ hierarchy.free).max() <= ROUNDING
    assert_orthonormal(hierarchy.free, np.linalg.qr(matrix.T)[0])
    assert matrix @ hierarchy.closed_form == pytest.approx(target, abs=ROUNDING)


@pytest.mark.parametrize("length", [1e-6, 1.0, 1e6])
def test_equalities_that_say_the_same_twice_change_nothing(length):
    matrix = np.random.default_rng(6).normal(size=(2, 5))
    target = np.array([1.0, -2.0])
    once = with_equalities(matrix, target, 5)
    combined = 0.3 * matrix[0] - 0.9 * matrix[1]
    again = np.vstack([matrix, length * matrix[0], -length * combined])
    twice = with_equalities(again, np.append(target, [length * 1.0, -length * (0.3 * 1.0 + 0.9 * 2.0)]), 5)
    assert twice.start == pytest.approx(once.start, abs=ROUNDING)
    assert twice.free @ twice.free.T == pytest.approx(once.free @ once.free.T, abs=ROUNDING)
    assert twice.closed_form == pytest.approx(once.closed_form, abs=ROUNDING)


def test_equalities_of_any_length_above_the_noise_count_alike():
    matrix, target = np.random.default_rng(7).normal(size=(3, 5)), np.array([1.0, -2.0, 0.5])
    scales = np.array([1e-5, 1.0, 1e6])
    one, other = with_equalities(matrix, target, 5), with_equalities(scales[:, None] * matrix, scales * target, 5)
    assert other.start == pytest.approx(one.start, abs=ROUNDING)
    assert other.free.shape == (5, 2)
    assert other.zeros == ()


def test_equalities_that_contradict_each_other_are_kept_as_far_as_they_can_be():
    hierarchy = with_equalities([[1.0, 0.0], [1.0, 0.0], [0.0, 2.0]], [1.0, 3.0, 4.0], 2)
    assert hierarchy.start == pytest.approx([2.0, 2.0], abs=ROUNDING)
    assert hierarchy.free.shape == (2, 0)


def test_equalities_of_zeros_say_nothing():
    hierarchy = with_equalities([[0.0, 0.0], [0.0, 3.0]], [0.0, 6.0], 2)
    assert hierarchy.start == pytest.approx([0.0, 2.0], abs=ROUNDING)
    assert np.abs(hierarchy.free) == pytest.approx(np.array([[1.0], [0.0]]), abs=ROUNDING)
    assert np.array_equal(with_equalities(np.zeros((1, 2)), [0.0], 2).free, np.eye(2))


def test_equalities_that_are_nearly_parallel_are_one_below_rounding_and_two_above():
    for angle, left in ((10.0 * DEPENDENT, 1), (0.1 * DEPENDENT, 2)):
        assert with_equalities([[1.0, 0.0, 0.0], [1.0, angle, 0.0]], [1.0, 1.0], 3).free.shape[1] == left


def test_equalities_that_differ_by_less_than_what_counts_are_kept_in_the_middle():
    hierarchy = with_equalities([[1.0, 0.0], [1.0, 0.1 * DEPENDENT]], [1.0, 1.0 + 1e-9], 2)
    assert hierarchy.start == pytest.approx([1.0 + 0.5e-9, 0.0], abs=ROUNDING)
    assert hierarchy.free.shape == (2, 1)


# Frozen joints.


def with_frozen(lower: object, upper: object, **parts: object) -> Hierarchy:
    return Hierarchy(IKProblem([Level([[1.0, 1.0, 1.0]], [6.0])], Bounds(lower, upper, ["hip", "knee", "ankle"]), **parts))


def test_a_frozen_joint_is_an_equality():
    hierarchy = with_frozen([-9.0, 2.0, -9.0], [9.0, 2.0, 9.0])
    assert np.array_equal(hierarchy.start, [0.0, 2.0, 0.0])
    assert hierarchy.free @ hierarchy.free.T == pytest.approx(np.diag([1.0, 0.0, 1.0]), abs=ROUNDING)
    assert hierarchy.closed_form == pytest.approx([2.0, 2.0, 2.0], abs=ROUNDING)
    assert hierarchy.closed_form[1] == 2.0


def test_frozen_joints_and_equalities_are_kept_together():
    hierarchy = with_frozen([-9.0, 2.0, -9.0], [9.0, 2.0, 9.0], equalities=Equalities([[1.0, 1.0, 0.0]], [3.0]))
    assert hierarchy.start == pytest.approx([1.0, 2.0, 0.0], abs=ROUNDING)
    assert hierarchy.free.shape == (3, 1)
    assert hierarchy.closed_form == pytest.approx([1.0, 2.0, 3.0], abs=ROUNDING)


def test_where_all_joints_are_frozen_nothing_is_free():
    hierarchy = with_frozen([1.0, 2.0, 0.0], [1.0, 2.0, 0.0])
    assert hierarchy.free.shape == (3, 0)
    assert np.array_equal(hierarchy.closed_form, [1.0, 2.0, 0.0])


def test_a_frozen_joint_is_the_same_as_the_equality_that_says_so():
    rng = np.random.default_rng(12)
    levels, reference = [random_level(rng, 2, 5), random_level(rng, 2, 5)], rng.normal(size=5)
    lower = np.array([-np.inf, 0.3, -np.inf, -0.1, -np.inf])
    frozen = Bounds(lower, np.where(np.isfinite(lower), lower, np.inf))
    equal = Equalities(np.eye(5)[[1, 3]], [0.3, -0.1])
    one = Hierarchy(IKProblem(levels, frozen, reference=reference))
    other = Hierarchy(IKProblem(levels, equalities=equal, reference=reference))
    assert one.closed_form == pytest.approx(other.closed_form, abs=ORACLE)


# Rows that mean nothing.


MEANINGLESS = {
    "an empty level": Level(np.zeros((0, 4)), []),
    "an empty soft level": Level(np.zeros((0, 4)), [], kind="at_most"),
    "a level without weight": Level(np.ones((2, 4)), [9.0, -9.0], [0.0, 0.0]),
    "a soft level without weight": Level(np.ones((2, 4)), [-9.0, -9.0], [0.0, 0.0], kind="at_most"),
    "a soft level without a finite side": Level(np.ones((2, 4)), [np.inf, np.inf], kind="at_most"),
    "a level of zeros": Level(np.zeros((2, 4)), [9.0, -9.0]),
}


@pytest.mark.parametrize("nothing", MEANINGLESS.values(), ids=MEANINGLESS.keys())
@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_level_that_means_nothing_changes_no_closed_form_wherever_it_stands(nothing, place):
    rng = np.random.default_rng(13)
    levels, reference = [random_level(rng, 1, 4), random_level(rng, 2, 4)], rng.normal(size=4)
    without = Hierarchy(IKProblem(levels, reference=reference))
    hierarchy = Hierarchy(IKProblem([*levels[:place], nothing, *levels[place:]], reference=reference))
    assert np.array_equal(hierarchy.closed_form, without.closed_form)
    assert hierarchy.rows.names == ()
    assert hierarchy.zeros == ()


def test_rows_of_weight_zero_are_as_good_as_left_out():
    rng = np.random.default_rng(14)
    level = random_level(rng, 4, 6)
    weights = level.weights * [1.0, 0.0, 1.0, 0.0]
    one = Hierarchy(IKProblem([Level(level.matrix, level.target, weights)]))
    other = Hierarchy(IKProblem([Level(level.matrix[::2], level.target[::2], level.weights[::2])]))
    assert one.rest.shape == (6, 4)
    assert np.array_equal(one.closed_form, other.closed_form)


def test_soft_rows_that_are_left_keep_their_numbers():
    level = Level(np.eye(4), [1.0, np.inf, 2.0, 3.0], [1.0, 1.0, 0.0, 1.0], "room", "at_most")
    rows = Hierarchy(IKProblem([level])).rows
    assert rows.names == ("room row 1", "room row 4")
    assert rows.upper.tolist() == [1.0, 3.0]


def test_without_any_level_the_step_is_the_reference_as_far_as_equalities_allow():
    assert np.array_equal(Hierarchy(IKProblem([], reference=[1.0, 2.0])).closed_form, [1.0, 2.0])
    hierarchy = Hierarchy(IKProblem([], equalities=Equalities([[1.0, 1.0]], [1.0]), reference=[1.0, 2.0]))
    assert hierarchy.closed_form == pytest.approx([0.0, 1.0], abs=ROUNDING)
    assert hierarchy.blocks == []


@pytest.mark.parametrize("size", [1e-17, 1e-15, 1.3e-14])
def test_rows_of_rounding_beside_rows_of_one_are_left_out_and_named(size):
    rng = np.random.default_rng(15)
    level, extra = random_level(rng, 2, 5), size * np.eye(5)[:1]
    whole = np.vstack([level.matrix / np.linalg.norm(level.matrix, axis=1)[:, None], extra])
    levels = [
        Level(whole, [*level.target, 1.0], name="reach"),
        Level(extra, [-1.0], name="room", kind="at_most"),
        Level(extra, [1.0], name="posture"),
    ]
    problem = IKProblem(levels, rows=Rows(extra, [1.0], ["contact"]), equalities=Equalities(extra, [0.0], ["hold"]))
    hierarchy = Hierarchy(problem)
    assert hierarchy.zeros == ("reach row 3", "room row 1", "posture row 1", "contact", "hold")
    assert hierarchy.rows.names == ()
    without = Hierarchy(IKProblem([Level(whole[:2], level.target)]))
    assert np.array_equal(hierarchy.closed_form, without.closed_form)
    assert hierarchy.impossible == ()


def test_rows_just_above_rounding_count():
    levels = [Level([[1.0, 0.0], [0.0, 1.6e-14]], [1.0, 1.6e-14])]
    hierarchy = Hierarchy(IKProblem(levels))
    assert hierarchy.zeros == ()
    assert hierarchy.closed_form == pytest.approx([1.0, 1.0], rel=1e-12)


def test_of_noisier_data_more_is_rounding():
    level = Level([[1.0, 0.0], [0.0, 1e-7]], [1.0, 1.0], name="reach")
    assert Hierarchy(IKProblem([level], noise=1e-6)).zeros == ("reach row 2",)
    assert Hierarchy(IKProblem([level])).zeros == ()


def test_rows_of_rounding_whose_sides_no_step_can_keep_are_named_as_impossible():
    rows = Rows([[1e-17, 0.0], [1.0, 0.0]], [-1.0, 5.0], ["never", "floor"])
    fixed = Equalities([[0.0, 1e-17]], [2.0], ["hold"])
    assert Hierarchy(IKProblem([Level(np.eye(2), np.ones(2))], rows=rows, equalities=fixed)).impossible == ("never", "hold")


def test_rows_of_nothing_but_zeros_are_left_out_without_a_word():
    level = Level([[1.0, 0.0], [0.0, 0.0]], [1.0, 5.0])
    problem = IKProblem([level], rows=Rows(np.zeros((1, 2)), [1.0]), equalities=Equalities(np.zeros((1, 2)), [0.0]))
    assert Hierarchy(problem).zeros == ()
    assert Hierarchy(problem).closed_form == pytest.approx([1.0, 0.0], abs=ROUNDING)


# Rows.


@pytest.fixture
def pooled() -> Hierarchy:
    """Hard rows, one of them all zero, and two soft levels around one of equality."""
    return Hierarchy(
        IKProblem(
            [
                Level([[0.0, 2.0]], [1.0], [9.0], "speed", "at_most"),
                Level([[1.0, 1.0]], [1.0]),
                Level([[0.0, 0.0], [3.0, 4.0]], [1.0, 10.0], [1.0, 0.25], "room", "at_most"),
            ],
            Bounds([-1.0, -np.inf], [np.inf, 2.0], ["hip", "knee"]),
            Rows([[3.0, 4.0], [0.0, 0.0], [0.0, -5.0]], [5.0, 7.0, 1.0], ["contact", "nothing", "floor"]),
        )
    )


def test_pooled_rows_are_the_hard_ones_and_then_those_of_soft_levels_in_order(pooled):
    rows = pooled.rows
    assert rows.names == ("knee upper", "hip lower", "contact", "floor", "speed row 1", "room row 2")
    assert rows.level.tolist() == [HARD, HARD, HARD, HARD, 0, 2]


def test_pooled_rows_have_length_one_so_that_slack_is_a_distance(pooled):
    rows = pooled.rows
    assert rows.matrix.tolist() == [[0.0, 1.0], [-1.0, 0.0], [0.6, 0.8], [0.0, -1.0], [0.0, 1.0], [0.6, 0.8]]
    assert rows.upper.tolist() == [2.0, 1.0, 1.0, 0.2, 0.5, 2.0]
    assert rows.slack(np.array([1.0, 2.0])) == pytest.approx([0.0, 2.0, -1.2, 2.2, -1.5, -0.2], abs=ROUNDING)


def test_strengths_are_the_root_of_the_weight_times_the_length_of_a_row(pooled):
    assert pooled.rows.strengths[4:].tolist() == [3.0 * 2.0, 0.5 * 5.0]


def test_a_soft_levels_cost_is_that_of_its_pooled_rows(pooled):
    rows = pooled.rows
    for dtheta in np.random.default_rng(8).normal(scale=5.0, size=(20, 2)):
        excess = rows.strengths * np.maximum(-rows.slack(dtheta), 0.0)
        for number in (0, 2):
            cost = pooled.problem.levels[number].cost(dtheta)  # its row of zeros exceeds nothing
            assert float(np.sum(excess[rows.level == number] ** 2)) == pytest.approx(cost, rel=ROUNDING)


@pytest.mark.parametrize("seed", SEEDS)
def test_pooled_rows_and_what_is_cut_from_them_are_the_rows_themselves(seed):
    hierarchy = hierarchy_of(seed)
    problem, rows = hierarchy.problem, hierarchy.rows
    soft = [level for level in problem.levels if level.is_soft]
    matrix = np.vstack([problem.inequalities.matrix, *(level.matrix for level in soft)])
    side = np.concatenate([problem.inequalities.upper, *(level.target for level in soft)])
    lengths = np.linalg.norm(matrix, axis=1)
    matrix, side, lengths = matrix[lengths > 0.0], side[lengths > 0.0], lengths[lengths > 0.0]
    assert (rows.matrix + rows.drift) * lengths[:, None] == pytest.approx(matrix, abs=ROUNDING * max(lengths, default=1.0))
    assert np.linalg.norm(rows.matrix, axis=1) == pytest.approx(np.ones(len(side)), abs=ROUNDING)
    assert np.linalg.norm(rows.drift, axis=1).max(initial=0.0) <= hierarchy.settled
    dtheta = np.random.default_rng(seed).normal(size=problem.joint_count)
    assert rows.slack(dtheta) == pytest.approx((side - matrix @ dtheta) / lengths, rel=1e-9, abs=ROUNDING)


def nearly_settled(component: float, rank_tolerance: float) -> Hierarchy:
    """A row that moves by `component` in what its first level leaves free."""
    levels = [Level([[1.0, 0.0, 0.0]], [1.0]), Level([[0.0, 1.0, 0.0]], [1.0])]
    return Hierarchy(IKProblem(levels, rows=Rows([[1.0, component, 0.0]], [1.0])), rank_tolerance)


#: Rank tolerance, and what less of a row than that is settled: the noise, or a hundred-thousandth of the tolerance.
SETTLED = [(0.0, NOISE), (1e-4, 1e-9), (1e-2, 1e-7)]


@pytest.mark.parametrize(("rank_tolerance", "settled"), SETTLED)
def test_what_is_settled_is_relative_to_the_rank_tolerance_and_at_least_the_noise(rank_tolerance, settled):
    assert nearly_settled(0.0, rank_tolerance).settled == pytest.approx(settled, rel=1e-12)


def test_of_noisier_data_more_is_settled():
    assert Hierarchy(IKProblem([Level(np.eye(2), np.ones(2))], noise=1e-6)).settled == 1e-6


def test_a_level_that_keeps_a_weak_direction_leaves_it_blurred_so_that_more_is_settled_below():
    levels = [Level([[1.0, 0.0, 0.0], [1.0, weak, 0.0]], [1.0, 1.0]) for weak in (1e-2, 1e-6)]
    strong, weak = (Hierarchy(IKProblem([level])).settled for level in levels)
    assert strong == NOISE
    assert 1e-10 < weak < 1e-8


@pytest.mark.parametrize(("rank_tolerance", "settled"), SETTLED)
def test_a_row_that_the_levels_above_have_nearly_settled_is_cut_to_them(rank_tolerance, settled):
    component = 0.5 * settled
    rows = nearly_settled(component, rank_tolerance).rows
    assert rows.matrix == pytest.approx(np.array([[1.0, 0.0, 0.0]]), abs=1e-14)
    assert rows.drift == pytest.approx(np.array([[0.0, component, 0.0]]), rel=1e-9, abs=1e-16)
    assert rows.slack(np.array([0.0, 1.0, 0.0])) == pytest.approx([1.0 - component], abs=1e-14)


@pytest.mark.parametrize(("rank_tolerance", "settled"), SETTLED)
def test_a_row_that_the_levels_above_have_not_settled_is_whole(rank_tolerance, settled):
    rows = nearly_settled(2.0 * settled, rank_tolerance).rows
    assert not rows.drift.any()
    assert rows.matrix[0, 1] == pytest.approx(2.0 * settled, rel=1e-9)


def test_a_row_is_cut_at_every_level_that_has_nearly_settled_it():
    # At half of what counts the first level leaves it too little; what it has of the third joint is part of that little.
    levels = [Level([[1.0, 0.0, 0.0]], [1.0]), Level([[0.0, 1.0, 0.0]], [1.0])]
    little = 0.5e-9
    given = Rows([[1.0, 1e-3, little], [1.0, little, little]], [1.0, 1.0])
    rows = Hierarchy(IKProblem(levels, rows=given), 1e-4).rows
    assert rows.drift[0] == pytest.approx([0.0, 0.0, little], rel=1e-5, abs=1e-16)
    assert rows.drift[1] == pytest.approx([0.0, little, little], rel=1e-5, abs=1e-16)


def test_reach_is_how_far_rows_move_in_the_free_directions(pooled):
    assert pooled.rows.reach(np.array([0, 2]), np.array([[1.0], [0.0]])) == pytest.approx([0.0, 0.6], abs=ROUNDING)
    assert pooled.rows.reach(np.array([], dtype=int), np.eye(2)).shape == (0,)


# Within fewer directions.


@pytest.mark.parametrize("seed", SEEDS)
def test_a_block_within_fewer_directions_is_that_of_the_same_cost(seed):
    rng = np.random.default_rng(seed)
    for _, block in blocks_of(hierarchy_of(seed)):
        f = block.free.shape[1]
        if f < 2:
            continue
        free = block.free @ np.linalg.qr(rng.normal(size=(f, f - 1)))[0]
        found = block.within(free)
        assert found.felt.shape[1] + found.unfelt.shape[1] == f - 1
        assert np.linalg.norm(block.matrix @ found.unfelt) <= ROUNDING * np.linalg.norm(block.matrix)
        if found.felt.shape[1]:
            moved = block.matrix @ found.felt
            assert moved.T @ moved == pytest.approx(np.eye(found.felt.shape[1]), abs=ROUNDING * conditioning(block))


@pytest.mark.parametrize("seed", SEEDS)
def test_within_all_that_it_has_a_block_is_itself(seed):
    for _, block in blocks_of(hierarchy_of(seed)):
        own, copy = block.within(block.free), block.within(block.free.copy())
        assert own.felt is block.inverse
        assert own.unfelt is block.below
        assert copy.unfelt @ copy.unfelt.T == pytest.approx(block.below @ block.below.T, abs=ROUNDING)
        size = np.linalg.norm(block.inverse) ** 2
        assert copy.felt @ copy.felt.T == pytest.approx(own.felt @ own.felt.T, abs=ROUNDING * size)


# Sabotage.


@pytest.mark.parametrize("part", ["felt", "root", "inverse", "matrix", "below"])
def test_a_block_that_is_wrong_by_a_thousandth_in_any_part_is_found_out(part):
    rng = np.random.default_rng(9)
    hierarchy = Hierarchy(IKProblem([random_level(rng, 3, 6), random_level(rng, 2, 6)]))
    level, block = blocks_of(hierarchy)[1]
    right = getattr(block, part)
    wrong = replace(block, **{part: right + SABOTAGE * rng.normal(size=right.shape) * np.abs(right).max()})

    def errors(block: EqualBlock) -> tuple[float, ...]:
        whole = np.hstack([block.felt, block.below])
        return (
            np.abs(whole.T @ whole - np.eye(whole.shape[1])).max(),
            np.abs(block.matrix @ block.felt - block.root).max(),
            np.abs(block.matrix @ block.inverse - np.eye(2)).max(),
            np.abs(block.matrix @ block.below).max(),
            np.abs(cost_gaps(level, block, 0)).max(),
        )

    assert max(errors(block)) <= ROUNDING * conditioning(block) * np.linalg.norm(block.matrix)
    assert max(errors(wrong)) > 1e-2 * SABOTAGE


def test_rows_of_soft_levels_with_one_name_are_told_apart_in_both_forms():
    soft = [Level(np.eye(2), [1.0, -side], kind="at_most") for side in (1.0, 2.0)]
    problem = IKProblem([*soft, Level(np.eye(2), [0.5, 0.5])], Bounds([-3.0] * 2, [3.0] * 2))
    names = ("task row 1", "task row 2", "task (2) row 1", "task (2) row 2")
    assert Hierarchy(problem, RANK_TOLERANCE).rows.names[-4:] == names
    space = workspace_for(Sizes.of(problem))
    space.name(problem)
    assert space.names[-4:] == names
