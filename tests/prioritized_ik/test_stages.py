"""Every stage is its level and nothing else: cost, rows and directions, in variables of its own."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hierarchies import random_hierarchy
from winding_fixtures import QP_ONLY, constrained_steps, free_steps

from prioritized_ik.errors import InputError
from prioritized_ik.problem import Bounds, Equalities, IKProblem, Level, Rows
from prioritized_ik.solvers.blocks import HARD
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE, level_decomposition, resulting_displacement, weighted_optimum
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.solvers.lexicographic import SolveOptions, first_stage
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.solvers.stages import FoldState, Stage, damped_stage, level_stage, reference_stage
from prioritized_ik.tolerances import FAR_SLACK

ROUNDING = 1e-12  # sums of some fifty products of doubles, relative to their size
WEIGHTED = 1e-11  # the same on recorded steps, where weights of 200 and 0.01 meet
SIDE = 1e-9  # points nearer than this to a row are on neither side of it for sure

#: Recorded steps are the paper's, and so is the rank to which they are cut.
AS_RECORDED = replace(QP_ONLY, rank_tolerance=RANK_TOLERANCE)


def random_problem(seed: int) -> IKProblem:
    """Five joints, a level of three rows and rank two, bounds and two rows; dθ = 0 is feasible."""
    rng = np.random.default_rng(seed)
    level = Level(rng.normal(size=(3, 2)) @ rng.normal(size=(2, 5)), rng.normal(size=3), rng.uniform(0.01, 200.0, 3))
    bounds = Bounds(-rng.uniform(0.1, 1.0, 5), np.append(rng.uniform(0.1, 1.0, 4), np.inf))
    return IKProblem((level,), bounds, Rows(rng.normal(size=(2, 5)), rng.uniform(0.0, 0.5, 2)), rng.normal(size=5))


def with_second_level(problem: IKProblem, second: Level) -> IKProblem:
    return IKProblem((*problem.levels, second), problem.bounds, problem.rows, problem.reference, problem.equalities)


def some_level(kind: str) -> Level:
    """A level of two rows, which no step of `PROBLEMS` meets for sure."""
    rng = np.random.default_rng(1)
    return Level(rng.normal(size=(2, 5)), rng.normal(size=2) - 0.5, [3.0, 0.2], "second", kind)


def objective(stage: Stage, x: np.ndarray) -> float:
    return float(0.5 * x @ stage.problem.P @ x + stage.problem.q @ x)


def second_state(problem: IKProblem, rank_tolerance: float = QP_ONLY.rank_tolerance) -> FoldState:
    """The state of a level below the first, at the middle between dθ = 0 and a feasible move."""
    state = FoldState.whole(Hierarchy(problem, rank_tolerance))
    stage = level_stage(state)
    x = np.zeros(stage.size)
    x[: stage.costed] = 0.01
    x *= min(1.0, *(stage.problem.h / np.maximum(stage.problem.G @ x, 1e-300)))
    return state.after(stage.dtheta(x), stage.unfelt)


def diagonal_state(levels: list[Level], **parts: object) -> FoldState:
    """The state before the first of some levels."""
    return FoldState.whole(Hierarchy(IKProblem(levels, **parts), 1e-6))


PROBLEMS = [random_problem(seed) for seed in range(5)]


# The first level.


@pytest.mark.parametrize("problem", PROBLEMS)
def test_the_stages_cost_is_the_levels_cost_in_units_up_to_a_constant(problem):
    level, stage = problem.levels[0], first_stage(problem, QP_ONLY)
    unit = np.linalg.norm(np.sqrt(level.weights) * level.target)
    points = np.random.default_rng(0).normal(size=(20, stage.size))
    gaps = [level.cost(stage.dtheta(x)) / (2.0 * unit**2) - objective(stage, x) for x in points]
    assert np.ptp(gaps) <= ROUNDING * np.abs([objective(stage, x) for x in points]).max()


def test_on_recorded_steps_the_stages_cost_is_that_of_the_decomposed_jacobian():
    for problem in free_steps() + constrained_steps():
        full, stage = problem.levels[0], first_stage(problem, AS_RECORDED)
        # J_a J_b, as some of the steps have a small singular value, which the rank tolerance drops.
        factors, _, _ = level_decomposition(full, np.eye(49), RANK_TOLERANCE)
        level = Level(factors.j_a @ factors.j_b, full.target, full.weights)
        unit = np.linalg.norm(np.sqrt(level.weights) * level.target)
        points = np.random.default_rng(0).normal(scale=0.1, size=(5, stage.size))
        gaps = [level.cost(stage.dtheta(x)) / (2.0 * unit**2) - objective(stage, x) for x in points]
        assert np.ptp(gaps) <= WEIGHTED * np.abs([objective(stage, x) for x in points]).max()


@pytest.mark.parametrize("problem", PROBLEMS)
def test_a_cost_of_other_weights_differs_by_more_than_a_constant(problem):
    level, stage = problem.levels[0], first_stage(problem, QP_ONLY)
    other = Level(level.matrix, level.target, level.weights * [1.001, 1.0, 1.0])
    unit = np.linalg.norm(np.sqrt(level.weights) * level.target)
    points = np.random.default_rng(0).normal(size=(20, stage.size))
    gaps = [other.cost(stage.dtheta(x)) / (2.0 * unit**2) - objective(stage, x) for x in points]
    assert np.ptp(gaps) > 1e3 * ROUNDING * np.abs([objective(stage, x) for x in points]).max()


@pytest.mark.parametrize("problem", PROBLEMS)
def test_the_stages_linear_part_is_the_gradient_of_the_residual_objective(problem):
    level, stage = problem.levels[0], first_stage(problem, QP_ONLY)
    unit = np.linalg.norm(np.sqrt(level.weights) * level.target)
    gradient = -stage.basis.T @ level.matrix.T @ (level.weights * level.target) / unit**2
    assert stage.problem.q == pytest.approx(gradient, abs=ROUNDING)


def test_the_first_stages_hessian_is_one_where_costed_and_zero_elsewhere():
    for problem in PROBLEMS:
        stage = first_stage(problem, QP_ONLY)
        assert stage.costed == 2
        assert np.array_equal(stage.problem.P, np.diag([1.0, 1.0, 0.0, 0.0, 0.0]))


def test_the_first_stages_variables_reach_every_joint_step():
    for problem in (*PROBLEMS, *constrained_steps()):
        stage = first_stage(problem, QP_ONLY)
        assert stage.size == problem.joint_count
        assert np.linalg.matrix_rank(stage.basis / np.linalg.norm(stage.basis, axis=0)) == problem.joint_count


def test_every_row_of_the_problem_is_in_the_first_stage():
    for problem in (*PROBLEMS, *constrained_steps()):
        stage = first_stage(problem, QP_ONLY)
        assert len(stage.problem.h) == len(problem.inequalities.upper)
        assert np.array_equal(stage.row_ids, np.arange(len(stage.problem.h)))


@pytest.mark.parametrize("problem", PROBLEMS)
def test_a_point_is_feasible_in_the_stage_exactly_if_its_joint_step_is(problem):
    stage, rows = first_stage(problem, QP_ONLY), problem.inequalities
    rng = np.random.default_rng(2)
    sides = set()
    for _ in range(500):
        step = rng.normal(scale=0.4, size=5)
        x = np.linalg.solve(stage.basis, step)
        in_joints = (rows.matrix @ step - rows.upper).max()
        if abs(in_joints) > SIDE:
            inside = bool((stage.problem.G @ x <= stage.problem.h).all())
            assert inside == (in_joints < 0.0)
            sides.add(inside)
    assert sides == {True, False}


def test_standing_still_is_feasible_in_every_first_stage():
    for problem in (*PROBLEMS, *free_steps(), *constrained_steps()):
        stage = first_stage(problem, QP_ONLY)
        assert np.array_equal(stage.origin, np.zeros(problem.joint_count))
        assert (stage.problem.h >= 0.0).all()


@pytest.mark.parametrize("problem", PROBLEMS)
def test_the_unconstrained_optimum_maps_back_to_the_closed_forms_displacement(problem):
    level, stage = problem.levels[0], first_stage(problem, QP_ONLY)
    factors, _, _ = level_decomposition(level, np.eye(5), 1e-6)
    wanted = resulting_displacement(factors.j_a, level.weights, level.target)
    reached = level.matrix @ stage.dtheta(-stage.problem.q)
    assert reached == pytest.approx(wanted, abs=1e-10 * np.linalg.norm(wanted))  # weights 0.01 and 200: four digits


def test_the_unconstrained_optimum_of_a_recorded_step_is_the_closed_forms_displacement():
    for problem in free_steps():
        level, stage = problem.levels[0], first_stage(problem, AS_RECORDED)
        factors, _, _ = level_decomposition(level, np.eye(49), RANK_TOLERANCE)
        dx_b = weighted_optimum(factors.j_a, level.weights, level.target)
        assert np.linalg.norm(dx_b) > 0.0
        wanted = level.matrix @ factors.j_b.T @ dx_b
        assert level.matrix @ stage.dtheta(-stage.problem.q) == pytest.approx(wanted, abs=WEIGHTED * np.linalg.norm(wanted))


def test_directions_below_the_rank_tolerance_cost_nothing():
    problem = IKProblem([Level(np.diag([1.0, 1e-4]), [1.0, 1.0])])
    assert [first_stage(problem, SolveOptions(rank_tolerance=t)).costed for t in (1e-3, 1e-5)] == [1, 2]


def test_the_directions_left_by_a_stage_are_those_that_its_level_does_not_feel():
    for problem in PROBLEMS:
        stage = first_stage(problem, QP_ONLY)
        factors, _, _ = level_decomposition(problem.levels[0], np.eye(5), 1e-6)
        assert stage.unfelt.T @ stage.unfelt == pytest.approx(np.eye(3), abs=ROUNDING)
        felt = factors.j_b.T @ factors.j_b
        assert stage.unfelt @ stage.unfelt.T == pytest.approx(np.eye(5) - felt, abs=ROUNDING)


# Equalities.


def held_problem(levels: list[Level]) -> IKProblem:
    """Two equalities on five joints and a bound that the shortest step that keeps them exceeds."""
    equalities = Equalities([[1.0, 1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 2.0, 0.0, 1.0]], [2.0, 1.0])
    return IKProblem(levels, Bounds(np.full(5, -np.inf), [0.5, *[np.inf] * 4]), equalities=equalities)


@pytest.mark.parametrize("kind", ["equal", "at_most"])
def test_every_point_of_every_stage_keeps_the_equalities(kind):
    problem = held_problem([some_level("equal"), some_level(kind)])
    state = FoldState.whole(Hierarchy(problem))
    stages = [level_stage(state)]
    state = state.after(stages[0].dtheta(np.ones(stages[0].size)), stages[0].unfelt)
    stages += [level_stage(state), reference_stage(state)]
    for stage in stages:
        for x in np.random.default_rng(4).normal(size=(10, stage.size)):
            off = problem.equalities.matrix @ stage.dtheta(x) - problem.equalities.target
            assert np.abs(off).max() <= ROUNDING * (1.0 + np.linalg.norm(x))


def test_the_first_stage_starts_at_the_shortest_step_that_keeps_the_equalities_whatever_the_rows_say():
    stage = first_stage(held_problem([some_level("equal")]), QP_ONLY)
    assert stage.origin == pytest.approx([1.0, 1.0, 0.4, 0.0, 0.2], abs=ROUNDING)
    assert stage.size == 3
    assert (stage.problem.h < 0.0).all()  # the bound of the first joint: the solver has to find its way back


def test_a_frozen_joint_moves_in_no_stage():
    problem = IKProblem([some_level("equal")], Bounds([-9.0, 0.3, *[-9.0] * 3], [9.0, 0.3, *[9.0] * 3]))
    state = FoldState.whole(Hierarchy(problem))
    stage = level_stage(state)
    last = reference_stage(state.after(stage.dtheta(np.ones(stage.size)), stage.unfelt))
    for one in (stage, last):
        assert np.abs(one.basis[1]).max() <= ROUNDING
        assert one.origin[1] == pytest.approx(0.3, abs=ROUNDING)
    assert stage.size == 4
    assert "joint 2 upper" not in [state.hierarchy.rows.names[i] for i in state.row_ids]


# What means nothing, and metrics.


@pytest.mark.parametrize("kind", ["equal", "at_most"])
def test_the_stage_of_a_level_without_rows_has_no_cost_and_every_direction(kind):
    state = diagonal_state([Level(np.zeros((0, 3)), [], kind=kind)], bounds=Bounds([-1.0] * 3, [1.0] * 3))
    stage = level_stage(state)
    assert (stage.costed, stage.size, stage.unfelt.shape) == (0, 3, (3, 3))
    assert not stage.problem.P.any()
    assert stage.row_ids.tolist() == list(range(6))


def test_without_levels_the_first_stage_to_look_at_is_that_of_the_reference():
    stage = first_stage(IKProblem([], Bounds([-1.0] * 2, [1.0] * 2), reference=[3.0, 4.0]))
    assert stage.costed == stage.size == 2
    assert stage.dtheta(-stage.problem.q) == pytest.approx([3.0, 4.0], rel=1e-15)


def test_infinite_sides_and_rows_of_rounding_are_in_no_stage():
    rows = Rows([[1.0, 0.0], [0.0, 1.0], [0.0, 1e-17]], [np.inf, 2.0, 1.0], ["never", "floor", "rounding"])
    state = diagonal_state([Level(np.eye(2), [1.0, np.inf], name="room", kind="at_most")], rows=rows)
    assert state.hierarchy.rows.names == ("floor", "room row 1")
    assert level_stage(state).row_ids.tolist() == [0, 1]


def test_with_fewer_directions_rows_that_cannot_move_are_gone_and_the_others_keep_their_slack():
    state = diagonal_state([Level([[1.0, 1.0]], [1.0])], rows=Rows(np.eye(2), [3.0, 4.0]))
    fewer = state.without(np.array([[0.0], [1.0]]))
    assert (fewer.row_ids.tolist(), fewer.slack.tolist(), fewer.place) == ([1], [4.0], 0)
    assert np.array_equal(fewer.origin, state.origin)


@pytest.mark.parametrize("metric", [[4.0, 1.0, 0.25], [[4.0, 1.0, 0.0], [1.0, 2.0, -0.5], [0.0, -0.5, 1.0]]])
def test_stages_are_in_the_joint_metric(metric):
    level = Level([[1.0, 2.0, 3.0], [0.5, -1.0, 0.0]], [0.5, 1.0], [2.0, 1.0])
    problem = IKProblem([level], Bounds([-1.0] * 3, [1.0] * 3), reference=[0.1, 0.2, 0.3], metric=metric)
    state = FoldState.whole(Hierarchy(problem))
    stage = level_stage(state)
    points = np.random.default_rng(6).normal(size=(10, 3))
    unit = np.linalg.norm(np.sqrt(level.weights) * level.target)
    steps = [problem.from_metric(stage.dtheta(x)) for x in points]
    gaps = [level.cost(step) / (2.0 * unit**2) - objective(stage, x) for step, x in zip(steps, points, strict=True)]
    assert np.ptp(gaps) <= ROUNDING * np.abs([objective(stage, x) for x in points]).max()
    for step, x in zip(steps, points, strict=True):
        assert (stage.problem.G @ x <= stage.problem.h).all() == (np.abs(step) <= 1.0).all()
    last = reference_stage(state.after(state.origin, np.eye(3)))
    steps = [problem.from_metric(last.dtheta(x)) - problem.reference for x in points]
    full = np.diag(metric) if np.ndim(metric) == 1 else np.array(metric)
    length = np.linalg.norm(last.basis[:, 0])
    gaps = [s @ full @ s / (2.0 * length**2) - objective(last, x) for s, x in zip(steps, points, strict=True)]
    assert np.ptp(gaps) <= ROUNDING * np.abs([objective(last, x) for x in points]).max()


# Lower levels.


@pytest.mark.parametrize("problem", PROBLEMS)
def test_a_lower_levels_stage_has_its_cost_in_units_up_to_a_constant(problem):
    level = some_level("equal")
    stage = level_stage(second_state(with_second_level(problem, level)))
    points = np.random.default_rng(1).normal(size=(20, stage.size))
    costs, values = np.array([(level.cost(stage.dtheta(x)), objective(stage, x)) for x in points]).T
    unit = np.linalg.norm(np.sqrt(level.weights) * level.target)
    ratios = np.diff(costs) / np.diff(values)
    assert np.ptp(ratios) <= 1e-9 * ratios.mean()  # differences of costs lose a few digits
    assert ratios.mean() >= 2.0 * unit**2 * (1.0 - 1e-9)  # one unit of y is the target's length at least


@pytest.mark.parametrize("problem", PROBLEMS)
def test_the_answer_of_the_level_above_is_feasible_in_the_next_stage(problem):
    for second in (some_level("equal"), some_level("at_most")):
        state = second_state(with_second_level(problem, second))
        for stage in (level_stage(state), reference_stage(state)):
            assert np.array_equal(stage.dtheta(np.zeros(stage.size)), state.origin)
            assert (stage.problem.h >= 0.0).all()


def test_a_row_broken_by_rounding_above_may_stay_as_it_is():
    problem = IKProblem([Level([[1.0, 1.0]], [1.0])], rows=Rows(np.eye(2), np.ones(2)))
    state = FoldState.whole(Hierarchy(problem)).after(np.array([1.0 + 1e-9, 0.0]), np.eye(2))
    assert state.slack.tolist() == [0.0, 1.0]


def test_rows_that_no_free_direction_moves_are_left_out():
    problem = IKProblem([Level([[1.0, 1.0]], [1.0])], rows=Rows(np.eye(2), np.ones(2)))
    state = FoldState.whole(Hierarchy(problem)).after(np.zeros(2), np.array([[0.0], [1.0]]))
    assert state.row_ids.tolist() == [1]
    assert state.rows.tolist() == [[0.0, 1.0]]


@pytest.mark.parametrize("problem", PROBLEMS)
def test_no_variable_of_a_lower_stage_changes_the_level_above(problem):
    level = problem.levels[0]
    for second in (some_level("equal"), some_level("at_most")):
        state = second_state(with_second_level(problem, second))
        for stage in (level_stage(state), reference_stage(state)):
            assert np.abs(level.matrix @ stage.basis).max() <= ROUNDING * np.abs(level.matrix).max()


def test_a_lower_levels_rank_counts_against_its_whole_matrix():
    # In the direction that is left the level moves by 1e-9 of what it could: rounding, not a task.
    state = diagonal_state([Level([[1.0, 0.0]], [1.0]), Level([[1.0, 1e-9]], [1.0])])
    state = state.after(state.origin, level_stage(state).unfelt)
    assert level_stage(state).costed == 0


def test_stages_are_numbered_from_the_top():
    state = second_state(with_second_level(PROBLEMS[0], some_level("equal")))
    second = level_stage(state)
    last = reference_stage(state.after(second.dtheta(np.zeros(second.size)), second.unfelt))
    assert [first_stage(PROBLEMS[0]).place, second.place, last.place] == [0, 1, 2]


@pytest.mark.parametrize("seed", range(10))
def test_every_row_of_a_stage_is_the_pooled_row_that_its_id_names(seed):
    problem = random_hierarchy(seed, joints=(3, 12)).problem
    hierarchy = Hierarchy(problem, 1e-7)
    state = FoldState.whole(hierarchy)
    for level in problem.levels:
        stage = level_stage(state)
        dtheta = stage.dtheta(np.zeros(stage.size))
        assert len(stage.row_ids) == (0 if stage.problem.G is None else len(stage.problem.h))
        assert len(set(stage.row_ids)) == len(stage.row_ids)
        for x in np.random.default_rng(seed).normal(size=(3, stage.size)):
            moved = hierarchy.rows.matrix[stage.row_ids] @ (stage.dtheta(x) - dtheta)
            if not level.is_soft and stage.problem.G is not None:
                lengths = np.linalg.norm(hierarchy.rows.matrix[stage.row_ids] @ stage.basis, axis=1)
                assert stage.problem.G @ x * lengths == pytest.approx(moved, abs=1e-9 * np.linalg.norm(stage.basis @ x))
        state = state.after(dtheta, stage.unfelt)
        assert (hierarchy.rows.level[state.row_ids] < state.place).all()


# Soft levels.


@pytest.fixture
def soft_state() -> FoldState:
    """The state of a level of two soft rows on two joints beside a hard one, at dθ = 0: it exceeds the first by 3."""
    level = Level([[3.0, 4.0], [0.0, 2.0]], [-3.0, 5.0], [4.0, 1.0], "soft", "at_most")
    return diagonal_state([level], rows=Rows([[1.0, 0.0]], [2.0]))


def test_a_soft_stages_first_variables_are_the_weighted_excesses_in_units_and_cost_their_square(soft_state):
    stage = level_stage(soft_state)
    assert (stage.costed, stage.size) == (2, 4)
    assert np.array_equal(stage.problem.P, np.diag([1.0, 1.0, 0.0, 0.0]))
    # √w times the excess of dθ = 0 is (2·3, 0), and the unit is the length of √w b = (-6, 5).
    assert stage.problem.q == pytest.approx([6.0 / np.sqrt(61.0), 0.0, 0.0, 0.0], abs=ROUNDING)
    assert np.array_equal(stage.basis[:, :2], np.zeros((2, 2)))


def test_a_soft_stages_best_excesses_cost_what_the_level_does(soft_state):
    (level,) = soft_state.hierarchy.problem.levels
    stage = level_stage(soft_state)
    unit = np.sqrt(61.0)
    constant = level.cost(soft_state.origin) / (2.0 * unit**2)
    for z in np.random.default_rng(5).normal(scale=5.0, size=(20, 2)):
        x = np.append([0.0, 0.0], z)
        dtheta = stage.dtheta(x)
        x[:2] = (np.sqrt(level.weights) * level.residual(dtheta) - [6.0, 0.0]) / unit
        own = stage.problem.G[1:] @ x - stage.problem.h[1:]
        assert own.max() <= ROUNDING * np.abs(stage.problem.h).max()
        assert objective(stage, x) + constant == pytest.approx(level.cost(dtheta) / (2.0 * unit**2), rel=1e-12)
        # Any less of an excess that there is, and its row is broken.
        for i in np.flatnonzero(level.residual(dtheta)):
            less = x - 1e-6 * np.eye(4)[i]
            assert (stage.problem.G[1 + i] @ less - stage.problem.h[1 + i]) > 1e-9


def test_a_soft_stage_holds_its_hard_rows_as_they_are(soft_state):
    stage = level_stage(soft_state)
    assert stage.row_ids.tolist() == [0, 1, 2]
    for z in (1.0, -1.0):
        x = np.array([9.0, 9.0, z, z])
        dtheta = stage.dtheta(x)
        assert (stage.problem.G[0] @ x <= stage.problem.h[0]) == (dtheta[0] <= 2.0)


def test_the_rows_of_a_soft_level_join_those_of_the_levels_below():
    levels = [Level([[3.0, 4.0]], [-5.0], kind="at_most"), Level([[1.0, 0.0]], [1.0])]
    state = diagonal_state(levels, rows=Rows([[0.0, 2.0]], [8.0]))
    # Two of the five that it asks for are met at (-0.24, -0.32): the rest may not grow.
    after = state.after(np.array([-0.24, -0.32]), np.eye(2))
    assert after.hierarchy.rows.level.tolist() == [HARD, 0]
    assert after.row_ids.tolist() == [0, 1]
    assert after.slack == pytest.approx([4.32, 0.0], abs=ROUNDING)
    stage = level_stage(after)
    assert stage.row_ids.tolist() == [0, 1]
    assert (stage.problem.h >= 0.0).all()


# The last level.


@pytest.mark.parametrize("problem", PROBLEMS)
def test_the_last_stages_cost_is_the_distance_to_the_reference(problem):
    stage = reference_stage(second_state(problem))
    unit = np.linalg.norm(stage.basis[:, 0])
    points = np.random.default_rng(3).normal(size=(20, stage.size))
    gaps = [np.sum((stage.dtheta(x) - problem.reference) ** 2) / (2.0 * unit**2) - objective(stage, x) for x in points]
    assert stage.costed == stage.size
    assert np.ptp(gaps) <= ROUNDING * np.abs([objective(stage, x) for x in points]).max()


@pytest.mark.parametrize("problem", PROBLEMS)
def test_far_rows_are_cut_only_beyond_where_the_last_optimum_can_be(problem):
    stage = reference_stage(second_state(problem))
    assert stage.problem.h.max() <= FAR_SLACK
    assert np.linalg.norm(stage.problem.q) <= 1.0 + ROUNDING  # so the optimum is within 2 of x = 0


# Units.


def test_directions_without_cost_are_counted_in_what_a_step_is_likely_to_measure():
    state = diagonal_state([Level([[1.0, 0.0]], [0.3]), Level([[0.0, 1.0]], [9.0], kind="at_most")], reference=[0.0, 0.4])
    stage = level_stage(state)
    assert np.linalg.norm(stage.basis, axis=0) == pytest.approx([0.3, state.hierarchy.length], rel=1e-15)
    soft = level_stage(state.after(state.origin, stage.unfelt))
    assert np.linalg.norm(soft.basis, axis=0) == pytest.approx([0.0, state.hierarchy.length], rel=1e-15)


@pytest.mark.parametrize("scale", [2.0**-10, 2.0**10])
def test_a_step_of_another_size_is_the_same_stage(scale):
    for problem in PROBLEMS:
        level = problem.levels[0]
        bounds = Bounds(scale * problem.bounds.lower, scale * problem.bounds.upper)
        rows = Rows(problem.rows.matrix, scale * problem.rows.upper)
        scaled = IKProblem(
            [Level(level.matrix, scale * level.target, level.weights)], bounds, rows, scale * problem.reference
        )
        one, other = first_stage(problem).problem, first_stage(scaled).problem
        for name in ("P", "q", "G", "h"):
            assert getattr(other, name) == pytest.approx(getattr(one, name), rel=ROUNDING, abs=ROUNDING), name


# The damped QP.


@pytest.mark.parametrize("problem", PROBLEMS)
def test_the_damped_stage_is_the_damped_normal_equations_in_joint_steps(problem):
    level, damping = problem.levels[0], 1e-3
    stage = damped_stage(problem, level, damping)
    w = np.diag(level.weights)
    assert stage.problem.P == pytest.approx(level.matrix.T @ w @ level.matrix + damping * np.eye(5), rel=1e-12)
    assert stage.problem.q == pytest.approx(-level.matrix.T @ w @ level.target - damping * problem.reference, rel=1e-12)
    assert np.array_equal(stage.problem.G, problem.inequalities.matrix)
    assert np.array_equal(stage.problem.h, problem.inequalities.upper)
    assert np.array_equal(stage.dtheta(np.arange(5.0)), np.arange(5.0))


def test_the_damped_stage_holds_an_equality_from_both_sides():
    problem = IKProblem([Level(np.eye(2), [1.0, 1.0])], equalities=Equalities([[1.0, 2.0]], [3.0]))
    qp = damped_stage(problem, problem.levels[0], 1e-3).problem
    assert np.array_equal(qp.G, [[1.0, 2.0], [-1.0, -2.0]])
    assert np.array_equal(qp.h, [3.0, -3.0])


def test_the_damped_stage_of_a_free_problem_has_no_rows_or_bounds():
    problem = IKProblem([Level(np.eye(2), [1.0, 1.0])])
    qp = damped_stage(problem, problem.levels[0], 1e-3).problem
    assert (qp.G, qp.h, qp.lb, qp.ub) == (None, None, None, None)


@pytest.mark.parametrize(
    ("kinds", "said"),
    [(["equal", "equal"], "one level, not 2"), (["at_most"], "a level of kind 'equal', not 'at_most'")],
    ids=["two levels", "a soft one"],
)
def test_the_damped_formulation_takes_one_equal_level_only(kinds: list[str], said: str):
    levels = [Level(np.eye(2), [1.0, 1.0], kind=kind) for kind in kinds]
    with pytest.raises(InputError, match=f"the damped formulation takes {said}; use 'lexicographic'"):
        get_method("damped:daqp").stage(IKProblem(levels))


# Sabotage.

SABOTAGE: dict[str, Callable[[Stage], np.ndarray]] = {
    "a felt direction a thousandth too long": lambda stage: stage.basis * np.append(1.001, np.ones(stage.size - 1)),
    "a felt direction turned by a thousandth": lambda stage: stage.basis + 1e-3 * stage.basis[:, [1, 0, 2, 3, 4]],
    "an unfelt direction that the level feels a little": lambda stage: (
        stage.basis + 1e-3 * np.outer(stage.basis[:, 0], [0.0, 0.0, 1.0, 0.0, 0.0])
    ),
}


@pytest.mark.parametrize("broken", SABOTAGE.values(), ids=SABOTAGE.keys())
def test_a_basis_that_is_wrong_by_a_thousandth_has_another_cost(broken):
    for problem in PROBLEMS:
        level, stage = problem.levels[0], first_stage(problem, QP_ONLY)
        unit = np.linalg.norm(np.sqrt(level.weights) * level.target)
        points = np.random.default_rng(0).normal(size=(20, stage.size))
        basis = broken(stage)
        gaps = [level.cost(basis @ x) / (2.0 * unit**2) - objective(stage, x) for x in points]
        assert np.ptp(gaps) > 1e3 * ROUNDING * np.abs([objective(stage, x) for x in points]).max()
