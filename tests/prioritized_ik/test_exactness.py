"""Where the answer is a formula, the solve gives it to rounding; and a step that is not the optimum gets no certificate."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from hierarchies import EVERYTHING, KnownHierarchy, Press, random_hierarchy, settled_before, solution_on
from oracles import norm_error
from tolerances import ORACLE, ROUNDING
from winding_fixtures import AS_RECORDED, QP_ONLY, constrained_steps, free_steps

from prioritized_ik.problem import Bounds, IKProblem, Level, Rows
from prioritized_ik.solvers.certificate import certify
from prioritized_ik.solvers.closed_form import (
    RANK_TOLERANCE,
    general_solution,
    minimum_norm_solution,
    rank_decomposition_svd,
    weighted_optimum,
)
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.solvers.solve import solve
from prioritized_ik.solvers.step import StepStatus

BOTH_WAYS = {"closed form first": SolveOptions(), "by the QP": QP_ONLY}
both_ways = pytest.mark.parametrize("options", BOTH_WAYS.values(), ids=BOTH_WAYS.keys())
SHAPES = [(3, 7, 3), (9, 5, 5), (8, 6, 4), (1, 1, 1), (12, 12, 12), (51, 49, 34)]  # rows, joints, rank

SABOTAGED = 1e-4  # of a step: far above the certificate's 1e-8, far below what anyone would see
BROKEN = 1e-6  # of a step: a bound exceeded by this is what the solve still accepts, and the certificate does not
ELSEWHERE = 1e-3  # of a step: another answer, and not the same one by another way


def matrix_of_rank(rng: np.random.Generator, rows: int, joints: int, rank: int) -> np.ndarray:
    """A matrix whose singular values that are not zero lie between 0.3 and 1: nothing here is a matter of conditioning."""
    left = np.linalg.qr(rng.normal(size=(rows, rank)))[0]
    right = np.linalg.qr(rng.normal(size=(joints, rank)))[0]
    return (left * rng.uniform(0.3, 1.0, rank)) @ right.T


# One level: Eqs. (12) to (14).


def one_level(shape: tuple[int, int, int], seed: int) -> Level:
    rng = np.random.default_rng([seed, *shape])
    return Level(matrix_of_rank(rng, *shape), rng.normal(size=shape[0]), rng.uniform(0.5, 2.0, shape[0]))


@both_ways
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("seed", range(5))
def test_one_level_is_eqs_12_and_14(shape, seed, options):
    level = one_level(shape, seed)
    factors = rank_decomposition_svd(level.matrix)
    wanted = minimum_norm_solution(factors.j_b, weighted_optimum(factors.j_a, level.weights, level.target))
    assert norm_error(solve(IKProblem([level]), "daqp", options).dtheta, wanted) <= ROUNDING


@both_ways
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("seed", range(5))
def test_one_level_with_a_reference_is_eqs_12_and_13(shape, seed, options):
    level = one_level(shape, seed)
    reference = np.random.default_rng(seed).normal(size=shape[1])
    factors = rank_decomposition_svd(level.matrix)
    wanted = general_solution(factors.j_b, weighted_optimum(factors.j_a, level.weights, level.target), reference)
    step = solve(IKProblem([level], reference=reference), "daqp", options)
    assert norm_error(step.dtheta, wanted) <= ROUNDING


@both_ways
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("seed", range(5))
def test_one_level_is_the_weighted_pseudo_inverse(shape, seed, options):
    level = one_level(shape, seed)
    root = np.sqrt(level.weights)
    wanted = np.linalg.pinv(root[:, None] * level.matrix, rcond=1e-9) @ (root * level.target)
    assert norm_error(solve(IKProblem([level]), "daqp", options).dtheta, wanted) <= ROUNDING


@both_ways
def test_the_free_steps_of_a_winding_are_eqs_12_and_13(options):
    options = replace(options, rank_tolerance=RANK_TOLERANCE)
    for problem in free_steps():
        (level,) = problem.levels
        factors = rank_decomposition_svd(level.matrix)
        dx_b = weighted_optimum(factors.j_a, level.weights, level.target)
        wanted = general_solution(factors.j_b, dx_b, problem.reference)
        assert norm_error(solve(problem, "daqp", options).dtheta, wanted) <= ORACLE


# More levels: the formulas of Nakamura, and Siciliano and Slotine.


def siciliano_slotine(levels: list[Level], reference: np.ndarray) -> np.ndarray:
    """dθ_i = dθ_{i-1} + (J_i P_{i-1})⁺(b_i - J_i dθ_{i-1}), P_i = P_{i-1} - (J_i P_{i-1})⁺J_i P_{i-1}; at last dθ + P r."""
    m = len(reference)
    dtheta, projector = np.zeros(m), np.eye(m)
    for level in levels:
        root = np.sqrt(level.weights)[:, None]
        within = root * level.matrix @ projector
        inverse = pseudo_inverse(within, np.linalg.norm(root * level.matrix, 2))
        dtheta = dtheta + inverse @ (root[:, 0] * (level.target - level.matrix @ dtheta))
        projector = projector - inverse @ within
    return dtheta + projector @ reference


def pseudo_inverse(matrix: np.ndarray, size: float) -> np.ndarray:
    """Of what is not rounding next to `size`: a level with nothing left to decide is all rounding."""
    u, s, vt = np.linalg.svd(matrix, full_matrices=False)
    p = np.count_nonzero(s > 1e-9 * size)
    return (vt[:p].T / s[:p]) @ u[:, :p].T


def nakamura(first: Level, second: Level) -> np.ndarray:
    """dθ = J₁⁺b₁ + (J₂P₁)⁺(b₂ - J₂J₁⁺b₁), P₁ = I - J₁⁺J₁."""
    j1, j2 = first.matrix, second.matrix
    up = np.linalg.pinv(j1)
    projector = np.eye(j1.shape[1]) - up @ j1
    return up @ first.target + np.linalg.pinv(j2 @ projector, rcond=1e-9) @ (second.target - j2 @ up @ first.target)


def some_levels(seed: int, ranks: list[int], joints: int, extra: int = 0) -> list[Level]:
    """Levels of the given ranks, of `extra` rows more than that and then of weights that matter."""
    rng = np.random.default_rng([seed, joints, *ranks])
    shapes = [(rank + extra, joints, rank) for rank in ranks]
    return [
        Level(matrix_of_rank(rng, *shape), rng.normal(size=shape[0]), rng.uniform(0.5, 2.0, shape[0]) if extra else None)
        for shape in shapes
    ]


@both_ways
@pytest.mark.parametrize("seed", range(10))
def test_two_levels_are_the_formula_of_nakamura(seed, options):
    first, second = some_levels(seed, [3, 4], 9)
    step = solve(IKProblem([first, second]), "daqp", options)
    assert norm_error(step.dtheta, nakamura(first, second)) <= ORACLE


@both_ways
@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("ranks", [[3, 4], [4, 4], [2, 3, 3], [2, 2, 2, 2, 1]])
def test_levels_are_the_formula_of_siciliano_and_slotine_with_the_reference_last(seed, ranks, options):
    # [4, 4] and [2, 3, 3] of 7 joints conflict in the last level; the formula holds all the same.
    levels = some_levels(seed, ranks, 7)
    reference = np.random.default_rng(seed).normal(size=7)
    step = solve(IKProblem(levels, reference=reference), "daqp", options)
    assert norm_error(step.dtheta, siciliano_slotine(levels, reference)) <= ORACLE


@both_ways
@pytest.mark.parametrize("seed", range(10))
def test_levels_of_more_rows_than_rank_are_the_weighted_formula(seed, options):
    levels = some_levels(seed, [3, 2, 3], 10, extra=2)
    reference = np.random.default_rng(seed).normal(size=10)
    step = solve(IKProblem(levels, reference=reference), "daqp", options)
    assert norm_error(step.dtheta, siciliano_slotine(levels, reference)) <= ORACLE


@both_ways
@pytest.mark.parametrize("seed", range(10))
def test_a_level_below_that_repeats_and_contradicts_one_above_changes_only_what_is_new_in_it(seed, options):
    first, second = some_levels(seed, [3, 2], 8)
    rng = np.random.default_rng(seed)
    repeated = Level(np.vstack([first.matrix, second.matrix]), np.append(rng.normal(size=3), second.target))
    one, other = (solve(IKProblem([first, level]), "daqp", options).dtheta for level in (repeated, second))
    assert norm_error(first.matrix @ one, first.target) <= ORACLE
    assert norm_error(one, siciliano_slotine([first, repeated], np.zeros(8))) <= ORACLE
    assert norm_error(other, siciliano_slotine([first, second], np.zeros(8))) <= ORACLE


@both_ways
@pytest.mark.parametrize("seed", range(5))
def test_a_large_weight_approaches_the_strict_order_as_fast_as_one_over_itself(seed, options):
    first, second = some_levels(seed, [4, 4], 6)
    strict = solve(IKProblem([first, second]), "daqp", options).dtheta
    matrix, target = np.vstack([first.matrix, second.matrix]), np.append(first.target, second.target)
    gaps = []
    for k in range(2, 9):
        weighted = Level(matrix, target, np.repeat([10.0**k, 1.0], 4))
        gaps.append(norm_error(solve(IKProblem([weighted]), "daqp", options).dtheta, strict))
    assert gaps[0] > SABOTAGED
    # Each decade of weight takes nine tenths off the gap, down to 1e-8 where 16 digits hold eight decades of weight.
    ratios = np.array(gaps[1:]) / np.array(gaps[:-1])
    assert ratios == pytest.approx(np.full(6, 0.1), rel=0.1)


def test_a_hard_row_that_holds_nothing_back_leaves_the_formula():
    levels = some_levels(0, [3, 2], 8)
    wanted = siciliano_slotine(levels, np.zeros(8))
    rows = Rows(np.eye(8)[:2], wanted[:2] + 1.0)
    step = solve(IKProblem(levels, rows=rows), "daqp", QP_ONLY)
    assert norm_error(step.dtheta, wanted) <= ORACLE
    assert step.tight_rows == ()


# Sabotage: what is not the optimum gets no certificate.

SEEDS = range(30)
FAMILIES = {
    "every feature": lambda seed: random_hierarchy(seed, joints=(3, 25)),
    "no weights": lambda seed: random_hierarchy(
        seed, EVERYTHING - {"weights", "degenerate"}, joints=(3, 25), levels=(1, 4)
    ),
}


@pytest.fixture(params=FAMILIES.values(), ids=FAMILIES.keys())
def family(request: pytest.FixtureRequest) -> Callable[[int], KnownHierarchy]:
    """How to make the known problem of a seed."""
    return request.param


@pytest.mark.parametrize("seed", SEEDS)
def test_the_planted_optimum_itself_is_certified(seed, family):
    known = family(seed)
    assert certify(known.problem, known.dtheta).holds


def shifts(known: KnownHierarchy) -> Iterator[np.ndarray]:
    """Steps that keep every row and are off by `SABOTAGED`: for each level in what only it and those below it decide."""
    problem, x = known.problem, known.dtheta
    rng = np.random.default_rng(known.seed)
    hard = problem.inequalities
    tight = hard.upper - hard.matrix @ x <= 1e-9 * np.linalg.norm(x) * np.linalg.norm(hard.matrix, axis=1)
    held = np.vstack([hard.matrix[tight], problem.equalities.matrix])
    for number in range(len(problem.levels) + 1):
        settled = settled_before(known, number)
        kept = np.linalg.svd(np.vstack([settled.T, held]), full_matrices=True)
        free = kept[2][np.count_nonzero(kept[1] > 1e-9) :]
        felt = problem.levels[number].matrix if number < len(problem.levels) else np.eye(len(x))
        for direction in (
            free.T @ (free @ rng.normal(size=len(x))),
            free.T @ (free @ (felt.T @ rng.normal(size=len(felt)))),
        ):
            length = np.linalg.norm(direction)
            if length > 1e-9:
                shifted = x + SABOTAGED * np.linalg.norm(x) * direction / length
                if problem.relative_violation(shifted) <= 1e-12:
                    yield shifted


@pytest.mark.parametrize("seed", SEEDS)
def test_a_step_moved_by_a_ten_thousandth_along_its_rows_is_not_certified(seed, family):
    known = family(seed)
    for shifted in shifts(known):
        assert not certify(known.problem, shifted).holds


def test_there_are_such_steps_at_every_level(family):
    assert sum(len(list(shifts(family(seed)))) for seed in SEEDS) >= 3 * len(SEEDS)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_step_drawn_back_from_its_rows_is_not_certified(seed, family):
    known = family(seed)
    inside = known.dtheta * (1.0 - SABOTAGED)
    assert not certify(known.problem, inside).holds


@pytest.mark.parametrize("seed", SEEDS)
def test_a_step_without_one_of_its_rows_is_not_certified(seed, family):
    known = family(seed)
    for i in range(len(known.presses)):
        wrong = solution_on(known.problem, (*known.presses[:i], *known.presses[i + 1 :]), known.dtheta)
        if norm_error(wrong, known.dtheta) > SABOTAGED:
            assert not certify(known.problem, wrong).holds


@pytest.mark.parametrize("seed", SEEDS)
def test_a_step_held_by_a_row_that_does_not_press_is_not_certified(seed, family):
    known = family(seed)
    pressed = {press.index for press in known.presses if press.kind == "row"}
    for index in set(range(len(known.problem.rows.upper))) - pressed:
        held = (Press(0, "row", index, 1.0), *known.presses)
        wrong = solution_on(known.problem, held, known.dtheta)
        if norm_error(wrong, known.dtheta) > SABOTAGED:
            assert not certify(known.problem, wrong).holds


@pytest.mark.parametrize("seed", SEEDS)
def test_the_optimum_of_the_levels_in_another_order_is_not_certified(seed, family):
    known = family(seed)
    levels = known.problem.levels
    for i in range(len(levels) - 1):
        swapped = (*levels[:i], levels[i + 1], levels[i], *levels[i + 2 :])
        problem = known.problem
        other = IKProblem(swapped, problem.bounds, problem.rows, problem.reference, problem.equalities)
        step = get_method("daqp").step(other, QP_ONLY)
        if step.status is StepStatus.SOLVED and norm_error(step.dtheta, known.dtheta) > ELSEWHERE:
            assert not certify(problem, step.dtheta).holds


@pytest.mark.parametrize("seed", range(10))
def test_a_step_that_exceeds_a_bound_by_a_millionth_is_not_certified(seed):
    rng = np.random.default_rng(seed)
    level = Level(np.eye(4), 2.0 + rng.uniform(0.0, 1.0, 4))
    bounds = Bounds(np.full(4, -1.0), np.append(rng.uniform(0.2, 1.0, 2), [np.inf, np.inf]))
    optimum = np.minimum(level.target, bounds.upper)
    problem = IKProblem([level], bounds)
    assert certify(problem, optimum).holds
    beyond = optimum + np.array([BROKEN * np.linalg.norm(optimum), 0.0, 0.0, 0.0])
    certificate = certify(problem, beyond)
    assert certificate.violation == pytest.approx(BROKEN, rel=1e-3)
    assert not certificate.holds


@pytest.mark.parametrize("seed", SEEDS)
def test_a_step_that_exceeds_an_equality_by_a_millionth_is_not_certified(seed, family):
    known = family(seed)
    for row in known.problem.equalities.matrix:
        beyond = known.dtheta + BROKEN * np.linalg.norm(known.dtheta) * row / np.linalg.norm(row)
        assert not certify(known.problem, beyond).holds


@pytest.mark.parametrize("angle", np.linspace(0.1, 3.0, 7))
def test_rows_that_settle_a_direction_do_not_stand_in_for_missing_multipliers(angle):
    # Two opposite rows leave one line. What rounding leaves of them along it is no row.
    along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    problem = IKProblem([Level(along[None], [1.0])], rows=Rows(np.array([across, -0.37 * across]), np.zeros(2)))
    assert certify(problem, along).holds
    for wrong in (0.5, 0.999, 1.001, 3.0):
        assert not certify(problem, wrong * along).holds


@pytest.mark.parametrize("seed", range(10))
def test_rows_settled_by_a_level_above_do_not_stand_in_for_missing_multipliers(seed):
    # The rows are combinations of the first level's, which leaves one direction: they do not move along it.
    rng = np.random.default_rng(seed)
    basis = np.linalg.qr(rng.normal(size=(4, 4)))[0]
    above, last = basis[:3], basis[3]
    rows = rng.normal(size=(6, 3)) @ above
    optimum = above.T @ rng.normal(size=3) + last
    problem = IKProblem([Level(above, above @ optimum), Level(last[None], [1.0])], rows=Rows(rows, rows @ optimum))
    assert certify(problem, optimum).holds
    for wrong in (-0.5, 1e-4, 1.0):
        assert not certify(problem, optimum + wrong * last).holds


@pytest.mark.parametrize("seed", range(10))
def test_a_multiplier_of_the_wrong_sign_is_not_certified(seed):
    # On the row but on the wrong side of it: the level would rather leave it.
    rng = np.random.default_rng(seed)
    row = rng.normal(size=5)
    row /= np.linalg.norm(row)
    inside = rng.normal(size=5)
    problem = IKProblem([Level(np.eye(5), inside - row * (inside @ row) - 0.3 * row)], rows=Rows(row[None], [0.0]))
    on_row = inside - row * (inside @ row)
    assert not certify(problem, on_row).holds
    assert certify(problem, problem.levels[0].target).holds


def test_the_constrained_steps_of_a_winding_lose_their_certificate_when_moved_by_a_ten_thousandth():
    for problem in constrained_steps():
        step = solve(problem, "daqp", AS_RECORDED)
        assert step.certificate.holds
        rng = np.random.default_rng(0)
        for _ in range(5):
            offset = rng.normal(size=problem.joint_count)
            offset *= SABOTAGED * np.linalg.norm(step.dtheta) / np.linalg.norm(offset)
            assert not certify(problem, step.dtheta + offset, RANK_TOLERANCE).holds
