"""The reference solution against answers known by hand, by the closed form and by construction."""

import ast
from collections.abc import Iterator
from pathlib import Path

import cvxpy as cp
import numpy as np
import pytest
from hierarchies import EVERYTHING, random_hierarchy
from oracles import norm_error
from winding_fixtures import QP_ONLY, constrained_steps

from prioritized_ik.errors import InputError, WitnessError
from prioritized_ik.problem import Bounds, Equalities, IKProblem, Level, Rows
from prioritized_ik.solvers import witness
from prioritized_ik.solvers.hierarchy import strict_solution
from prioritized_ik.solvers.solve import solve
from prioritized_ik.solvers.witness import witness_solvers, witness_step

BY_HAND = 1e-6  # interior points leave a tight row without a multiplier by the root of their tolerance, 1e-14
OPTIMUM = 1e-5  # of a step of length one, relative: costs are right to 1e-12, and so steps to 1e-6; levels add up
COST = 1e-7  # of a level's cost, relative to standing still or to the optimum
AGREE = 1e-5  # of two solvers, each right to `OPTIMUM` at worst
RANK = 1e-4  # the library's rank tolerance, to which matrices are cut

WELL_SCALED = EVERYTHING - {"weights", "scales", "degenerate"}  # no spread of six decades, no blurred tight row


def one_level(level: Level, **hard: object) -> np.ndarray:
    return witness_step(IKProblem([level], **hard))


# Without rows: the closed form.


@pytest.mark.parametrize("count", [1, 2, 3, 4])
@pytest.mark.parametrize("seed", range(5))
def test_without_rows_the_witness_is_the_closed_form(count, seed):
    rng = np.random.default_rng([seed, count])
    levels = [Level(rng.normal(size=(4, 20)), rng.normal(size=4), rng.uniform(0.1, 10.0, 4)) for _ in range(count)]
    problem = IKProblem(levels, reference=rng.normal(size=20))
    assert norm_error(witness_step(problem), strict_solution(problem.levels, problem.reference)) <= OPTIMUM


def test_a_level_that_asks_too_much_of_too_few_directions_is_met_in_least_squares():
    rng = np.random.default_rng(3)
    level = Level(rng.normal(size=(9, 3)) @ rng.normal(size=(3, 12)), rng.normal(size=9), rng.uniform(0.1, 10.0, 9))
    root = np.sqrt(level.weights)
    truth = np.linalg.pinv(root[:, None] * level.matrix, rcond=1e-9) @ (root * level.target)
    assert norm_error(one_level(level), truth) <= OPTIMUM


def test_what_no_level_feels_goes_to_the_reference():
    step = one_level(Level([[1.0, 0.0]], [2.0]), reference=[9.0, 7.0])
    assert step == pytest.approx([2.0, 7.0], abs=BY_HAND)


def test_a_level_that_feels_nothing_leaves_all_to_the_others():
    problem = IKProblem([Level([[0.0, 0.0]], [1.0]), Level([[1.0, 1.0]], [2.0])])
    assert witness_step(problem) == pytest.approx([1.0, 1.0], abs=BY_HAND)


def test_the_step_is_zero_if_nothing_asks_for_another():
    assert one_level(Level([[1.0, 2.0]], [0.0])) == pytest.approx([0.0, 0.0], abs=BY_HAND)


def test_one_joint_is_a_problem_too():
    assert one_level(Level([[2.0]], [3.0])) == pytest.approx([1.5], abs=BY_HAND)


# By hand.


def test_a_bound_active_at_the_first_level_leaves_the_second_its_freedom():
    """x = 2 is stopped at x <= 1; x + y = 3 then gives y = 2, and z is left to the reference."""
    levels = [Level([[1.0, 0.0, 0.0]], [2.0]), Level([[1.0, 1.0, 0.0]], [3.0])]
    bounds = Bounds([-1.0, -9.0, -9.0], [1.0, 9.0, 9.0])
    assert witness_step(IKProblem(levels, bounds, reference=[0.0, 0.0, 0.7])) == pytest.approx([1.0, 2.0, 0.7], abs=BY_HAND)


@pytest.mark.parametrize("wish", [1e-3, 1.0, 1e3])
def test_bounds_can_hold_a_step_at_zero_whatever_is_asked(wish):
    levels = [Level([[1.0, 0.5], [0.3, 1.0]], [wish, wish]), Level([[1.0, 1.0]], [wish])]
    step = witness_step(IKProblem(levels, Bounds([-1.0, -1.0], [0.0, 0.0])))
    assert step == pytest.approx([0.0, 0.0], abs=BY_HAND * wish)


def test_a_level_that_asks_for_next_to_nothing_measured_by_another_is_still_solved():
    levels = [Level([[1.0, 1.0]], [1e-4]), Level([[1.0, -1.0]], [2e3])]
    bounds = Bounds([-1.0, -1.0], [1e-4, 1.0])
    assert witness_step(IKProblem(levels, bounds)) == pytest.approx([1e-4, 0.0], abs=BY_HAND * 1e-4)


def test_a_row_stops_the_second_level_without_moving_the_first():
    """x = 1 is met; y = 5 is stopped where x + y <= 3."""
    levels = [Level([[1.0, 0.0]], [1.0]), Level([[0.0, 1.0]], [5.0])]
    step = witness_step(IKProblem(levels, rows=Rows([[10.0, 10.0]], [30.0])))
    assert step == pytest.approx([1.0, 2.0], abs=BY_HAND)


def test_rows_of_length_zero_are_kept_by_every_step():
    assert one_level(Level([[1.0]], [2.0]), rows=Rows([[0.0]], [1.0])) == pytest.approx([2.0], abs=BY_HAND)


def test_weights_weigh_the_residuals():
    """x = 0 with weight 1 against x = 1 with weight 3: the minimum of x² + 3 (x - 1)² is at 3/4."""
    assert one_level(Level([[1.0], [1.0]], [0.0, 1.0], [1.0, 3.0])) == pytest.approx([0.75], abs=BY_HAND)


def test_the_order_of_levels_decides_which_is_met():
    levels = [Level([[1.0, 0.0]], [1.0]), Level([[1.0, 0.0]], [-1.0])]
    assert witness_step(IKProblem(levels)) == pytest.approx([1.0, 0.0], abs=BY_HAND)
    assert witness_step(IKProblem(levels[::-1])) == pytest.approx([-1.0, 0.0], abs=BY_HAND)


def test_a_soft_level_that_is_kept_stops_the_level_below_at_its_side():
    levels = [Level([[1.0, 0.0]], [1.0], kind="at_most"), Level(np.eye(2), [3.0, 4.0])]
    assert witness_step(IKProblem(levels)) == pytest.approx([1.0, 4.0], abs=BY_HAND)


def test_a_soft_level_that_is_kept_does_not_pull():
    levels = [Level([[1.0, 0.0]], [1.0], kind="at_most"), Level(np.eye(2), [0.5, 4.0])]
    assert witness_step(IKProblem(levels)) == pytest.approx([0.5, 4.0], abs=BY_HAND)


def test_a_soft_level_in_two_minds_is_violated_by_weight():
    """x <= -1 with weight 3 and x >= 1 with weight 1: the minimum of 3 (x + 1)² + (1 - x)² is at -1/2."""
    levels = [Level([[1.0, 0.0], [-1.0, 0.0]], [-1.0, -1.0], [3.0, 1.0], kind="at_most"), Level(np.eye(2), [5.0, 6.0])]
    assert witness_step(IKProblem(levels)) == pytest.approx([-0.5, 6.0], abs=BY_HAND)


def test_a_soft_row_beyond_a_bound_keeps_its_excess_and_the_others_their_side():
    """x <= -1 is as near as x >= 0 allows, so the level below cannot have x = 5; y <= 2 is kept, so y = 5 stops there."""
    levels = [Level(np.eye(2), [-1.0, 2.0], kind="at_most"), Level(np.eye(2), [5.0, 5.0])]
    assert witness_step(IKProblem(levels, Bounds([0.0, -9.0], [9.0, 9.0]))) == pytest.approx([0.0, 2.0], abs=BY_HAND)


def test_a_soft_level_below_yields_to_the_level_above():
    levels = [Level([[1.0, 1.0]], [4.0]), Level(np.eye(2), [1.0, 1.0], kind="at_most")]
    assert witness_step(IKProblem(levels)) == pytest.approx([2.0, 2.0], abs=BY_HAND)


def test_equalities_hold_whatever_the_levels_ask():
    """x + y = 1 is hard; x - y = 3 can be met with it, x = 9 cannot any more."""
    levels = [Level([[1.0, -1.0]], [3.0]), Level([[1.0, 0.0]], [9.0])]
    step = witness_step(IKProblem(levels, equalities=Equalities([[1.0, 1.0]], [1.0])))
    assert step == pytest.approx([2.0, -1.0], abs=BY_HAND)


def test_equalities_that_say_the_same_twice_are_one():
    equalities = Equalities([[1.0, 1.0], [-5.0, -5.0]], [1.0, -5.0])
    assert one_level(Level([[1.0, -1.0]], [3.0]), equalities=equalities) == pytest.approx([2.0, -1.0], abs=BY_HAND)


def test_a_joint_whose_bounds_are_one_stays_there():
    bounds = Bounds([0.25, -9.0], [0.25, 9.0])
    assert one_level(Level([[1.0, 1.0]], [2.0]), bounds=bounds) == pytest.approx([0.25, 1.75], abs=BY_HAND)


# By construction.


@pytest.mark.parametrize("seed", range(20))
def test_the_witness_finds_an_optimum_that_was_chosen_first(seed):
    known = random_hierarchy(seed, WELL_SCALED, joints=(2, 60), levels=(1, 6))
    step = witness_step(known.problem)
    assert norm_error(step, known.dtheta) <= OPTIMUM
    assert known.problem.relative_violation(step) <= OPTIMUM
    for level in known.problem.levels:
        least = level.cost(known.dtheta)
        assert abs(level.cost(step) - least) <= COST * max(least, level.cost(np.zeros_like(step)))


@pytest.mark.parametrize("scale", [1e-4, 1e3])
def test_steps_of_a_tenth_of_a_milliradian_are_as_accurate_as_those_of_a_thousand_radians(scale):
    known = random_hierarchy(5, WELL_SCALED)
    problem = known.problem
    scaled = IKProblem(
        [Level(one.matrix, scale * one.target, one.weights, one.name, one.kind) for one in problem.levels],
        Bounds(scale * problem.bounds.lower, scale * problem.bounds.upper),
        Rows(problem.rows.matrix, scale * problem.rows.upper),
        scale * problem.reference,
        Equalities(problem.equalities.matrix, scale * problem.equalities.target),
    )
    assert norm_error(witness_step(scaled), scale * known.dtheta) <= OPTIMUM


def cut(level: Level) -> Level:
    """`level` with its matrix cut to the rank that counts."""
    u, s, vt = np.linalg.svd(level.matrix, full_matrices=False)
    kept = s > RANK * s[0]
    return Level((u[:, kept] * s[kept]) @ vt[kept], level.target, level.weights)


def test_the_library_and_the_witness_agree_on_constrained_winding_steps():
    for problem in constrained_steps():
        (level,) = levels = [cut(problem.levels[0])]
        same = IKProblem(levels, problem.bounds, problem.rows, problem.reference)
        step, reference = solve(same, "daqp", QP_ONLY).dtheta, witness_step(same)
        assert abs(level.cost(step) - level.cost(reference)) <= COST * level.cost(np.zeros_like(step))
        assert norm_error(step, reference) <= AGREE


# Solvers.


def small_problems() -> Iterator[IKProblem]:
    """Six joints, an equal, a soft and another equal level, bounds and rows, some of which bind."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        levels = [
            Level(rng.normal(size=(2, 6)), rng.normal(size=2)),
            Level(rng.normal(size=(2, 6)), rng.normal(size=2) - 1.0, kind="at_most"),
            Level(rng.normal(size=(2, 6)), rng.normal(size=2), [1.0, 5.0]),
        ]
        bounds = Bounds(-rng.uniform(0.1, 0.6, 6), rng.uniform(0.1, 0.6, 6))
        yield IKProblem(levels, bounds, Rows(rng.normal(size=(3, 6)), rng.uniform(0.05, 0.5, 3)), rng.normal(size=6))


def test_the_solvers_that_come_with_cvxpy_are_there():
    assert {"CLARABEL", "OSQP", "SCS"} <= set(witness_solvers())


@pytest.mark.parametrize("solver", sorted(set(witness_solvers()) - {"CLARABEL"}))
def test_solvers_of_other_methods_agree(solver):
    for problem in small_problems():
        assert norm_error(witness_step(problem, solver), witness_step(problem)) <= AGREE


def test_the_small_problems_bind():
    assert all(problem.tight_rows(witness_step(problem), BY_HAND) for problem in small_problems())


def test_an_unknown_solver_is_refused_with_those_there_are():
    with pytest.raises(InputError, match=r"unknown witness solver 'clarabell'; choose one of: CLARABEL"):
        witness_step(IKProblem([Level([[1.0]], [1.0])]), "clarabell")


# Compiled once.


@pytest.fixture
def compilations(monkeypatch) -> list[object]:
    """What CVXPY compiles from here on; nothing is compiled yet."""
    seen: list[object] = []
    construct = cp.Problem._construct_chain

    def count(self, *args, **kwargs):
        seen.append(self)
        return construct(self, *args, **kwargs)

    monkeypatch.setattr(cp.Problem, "_construct_chain", count)
    witness._compiled.cache_clear()
    return seen


def free_problem(seed: int, rows: int = 3) -> IKProblem:
    """Two levels of three rows and some hard rows, none of which binds."""
    rng = np.random.default_rng(seed)
    levels = [Level(rng.normal(size=(3, 8)), rng.normal(size=3)) for _ in range(2)]
    return IKProblem(levels, rows=Rows(rng.normal(size=(rows, 8)), np.full(rows, 1e3)))


def test_problems_of_one_shape_are_compiled_once(compilations):
    first = witness_step(free_problem(1))
    assert len(compilations) == 3  # two levels and the reference
    second = witness_step(free_problem(2))
    assert len(compilations) == 3
    assert norm_error(second, strict_solution(free_problem(2).levels, np.zeros(8))) <= OPTIMUM
    assert norm_error(first, strict_solution(free_problem(1).levels, np.zeros(8))) <= OPTIMUM


def test_a_problem_of_another_shape_is_compiled_anew(compilations):
    witness_step(free_problem(1))
    witness_step(free_problem(1, rows=4))
    assert len(compilations) == 6


def test_a_step_does_not_depend_on_what_was_solved_before():
    alone = witness_step(free_problem(1))
    witness_step(free_problem(2))
    assert np.array_equal(witness_step(free_problem(1)), alone)


# Failures.


def test_equalities_that_contradict_each_other_are_said_to():
    with pytest.raises(WitnessError, match="the hard equalities contradict each other"):
        one_level(Level([[1.0]], [0.0]), equalities=Equalities([[1.0], [1.0]], [0.1, 0.2]))


def test_rows_that_contradict_each_other_end_in_an_error_that_names_solver_level_and_status():
    with pytest.raises(WitnessError, match=r"CLARABEL on level 'reach': infeasible; expected optimal\. Look for rows"):
        one_level(Level([[1.0]], [0.0], name="reach"), rows=Rows([[1.0], [-1.0]], [-1.0, -1.0]))


def test_a_solver_that_gives_up_ends_in_an_error(monkeypatch):
    monkeypatch.setattr(witness._Stage, "_ask", lambda self, solver, tolerance: "user_limit")
    with pytest.raises(WitnessError, match="'task': user_limit; expected optimal"):
        one_level(Level([[1.0]], [1.0]))


def test_an_answer_that_is_not_finite_ends_in_an_error(monkeypatch):
    def nonsense(self, solver, tolerance):
        self.x.save_value(np.full(self.x.shape, np.nan))
        return cp.OPTIMAL

    monkeypatch.setattr(witness._Stage, "_ask", nonsense)
    with pytest.raises(WitnessError, match="an answer that is not finite"):
        one_level(Level([[1.0]], [1.0]))


# Independence.


def test_the_witness_shares_no_code_with_the_solvers():
    tree = ast.parse(Path(witness.__file__).read_text(encoding="utf-8"))
    imported = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    imported |= {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    own = {name for name in imported if name.startswith("prioritized_ik")}
    assert own == {"prioritized_ik.errors", "prioritized_ik.problem", "prioritized_ik.validation"}
