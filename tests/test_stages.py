import numpy as np
import pytest
from winding_fixtures import QP_ONLY, constrained_steps, free_steps

from prioritized_ik.errors import InputError
from prioritized_ik.problem import Bounds, IKProblem, Level, Rows
from prioritized_ik.solvers.closed_form import (
    level_decomposition,
    null_space,
    resulting_displacement,
    strict_solution,
    weighted_optimum,
)
from prioritized_ik.solvers.lexicographic import SolveOptions, first_stage
from prioritized_ik.solvers.stages import FAR_SLACK, Room, Stage, damped_stage, reference_stage, task_stage

ROUNDING = 1e-12  # sums of some fifty products of doubles, relative to their size
WEIGHTED = 1e-11  # the same on recorded steps, where weights of 200 and 0.01 meet
SIDE = 1e-9  # points nearer than this to a row are on neither side of it for sure


def random_problem(seed: int) -> IKProblem:
    """Five joints, a level of three rows and rank two, bounds and two rows; dθ = 0 is feasible."""
    rng = np.random.default_rng(seed)
    level = Level(rng.normal(size=(3, 2)) @ rng.normal(size=(2, 5)), rng.normal(size=3), rng.uniform(0.01, 200.0, 3))
    bounds = Bounds(-rng.uniform(0.1, 1.0, 5), np.append(rng.uniform(0.1, 1.0, 4), np.inf))
    return IKProblem((level,), bounds, Rows(rng.normal(size=(2, 5)), rng.uniform(0.0, 0.5, 2)), rng.normal(size=5))


def objective(stage: Stage, x: np.ndarray) -> float:
    return float(0.5 * x @ stage.problem.P @ x + stage.problem.q @ x)


def second_stage_room(problem: IKProblem) -> Room:
    """The room of a level below the first, at the middle between dθ = 0 and a feasible move."""
    stage = first_stage(problem, QP_ONLY)
    x = np.zeros(stage.size)
    x[: stage.costed] = 0.01
    x *= min(1.0, *(stage.problem.h / np.maximum(stage.problem.G @ x, 1e-300)))
    return Room.whole(problem).after(stage.dtheta(x), stage.unfelt)


PROBLEMS = [random_problem(seed) for seed in range(5)]


@pytest.mark.parametrize("problem", PROBLEMS)
def test_the_stages_cost_is_the_levels_cost_in_units_up_to_a_constant(problem):
    level, stage = problem.levels[0], first_stage(problem, QP_ONLY)
    unit = np.linalg.norm(np.sqrt(level.weights) * level.target)
    points = np.random.default_rng(0).normal(size=(20, stage.size))
    gaps = [level.cost(stage.dtheta(x)) / (2.0 * unit**2) - objective(stage, x) for x in points]
    assert np.ptp(gaps) <= ROUNDING * np.abs([objective(stage, x) for x in points]).max()


def test_on_recorded_steps_the_stages_cost_is_that_of_the_decomposed_jacobian():
    for problem in free_steps() + constrained_steps():
        full, stage = problem.levels[0], first_stage(problem, QP_ONLY)
        # J_a J_b, as some of the steps have a small singular value, which the rank tolerance drops.
        factors = level_decomposition(full, np.eye(49), QP_ONLY.rank_tolerance)
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
def test_a_lower_levels_stage_has_its_cost_up_to_scale_and_constant(problem):
    rng = np.random.default_rng(1)
    level = Level(rng.normal(size=(2, 5)), rng.normal(size=2), [3.0, 0.2])
    stage = task_stage(level, second_stage_room(problem), 1e-6)
    costs, values = np.array(
        [(level.cost(stage.dtheta(x)), objective(stage, x)) for x in rng.normal(size=(20, stage.size))]
    ).T
    ratios = np.diff(costs) / np.diff(values)
    assert np.ptp(ratios) <= 1e-9 * ratios.mean()  # differences of costs lose a few digits


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
        assert len(first_stage(problem, QP_ONLY).problem.h) == len(problem.inequalities.upper)


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
def test_the_answer_of_the_level_above_is_feasible_in_the_next_stage(problem):
    room = second_stage_room(problem)
    stage = reference_stage(problem.reference, room)
    assert np.array_equal(stage.dtheta(np.zeros(stage.size)), room.origin)
    assert (stage.problem.h >= 0.0).all()


def test_a_row_broken_by_rounding_above_may_stay_as_it_is():
    room = Room(np.zeros(2), np.eye(2), np.eye(2), np.ones(2)).after(np.array([1.0 + 1e-9, 0.0]), np.eye(2))
    assert room.slack.tolist() == [0.0, 1.0]


def test_rows_that_no_free_direction_moves_are_left_out():
    room = Room(np.zeros(2), np.eye(2), np.eye(2), np.ones(2)).after(np.zeros(2), np.array([[0.0], [1.0]]))
    assert room.rows.tolist() == [[0.0, 1.0]]


@pytest.mark.parametrize("problem", PROBLEMS)
def test_no_variable_of_a_lower_stage_changes_the_level_above(problem):
    level = problem.levels[0]
    stage = reference_stage(problem.reference, second_stage_room(problem))
    assert np.abs(level.matrix @ stage.basis).max() <= ROUNDING * np.abs(level.matrix).max()


@pytest.mark.parametrize("problem", PROBLEMS)
def test_the_last_stages_cost_is_the_distance_to_the_reference(problem):
    stage = reference_stage(problem.reference, second_stage_room(problem))
    unit = np.linalg.norm(stage.basis[:, 0])
    points = np.random.default_rng(3).normal(size=(20, stage.size))
    gaps = [np.sum((stage.dtheta(x) - problem.reference) ** 2) / (2.0 * unit**2) - objective(stage, x) for x in points]
    assert stage.costed == stage.size
    assert np.ptp(gaps) <= ROUNDING * np.abs([objective(stage, x) for x in points]).max()


@pytest.mark.parametrize("problem", PROBLEMS)
def test_far_rows_are_cut_only_beyond_where_the_last_optimum_can_be(problem):
    stage = reference_stage(problem.reference, second_stage_room(problem))
    assert stage.problem.h.max() <= FAR_SLACK
    assert np.linalg.norm(stage.problem.q) <= 1.0 + ROUNDING  # so the optimum is within 2 of x = 0


@pytest.mark.parametrize("problem", PROBLEMS)
def test_the_unconstrained_optimum_maps_back_to_the_closed_forms_displacement(problem):
    level, stage = problem.levels[0], first_stage(problem, QP_ONLY)
    factors = level_decomposition(level, np.eye(5), 1e-6)
    wanted = resulting_displacement(factors.j_a, level.weights, level.target)
    reached = level.matrix @ stage.dtheta(-stage.problem.q)
    assert reached == pytest.approx(wanted, abs=1e-10 * np.linalg.norm(wanted))  # weights 0.01 and 200: four digits


def test_the_unconstrained_optimum_of_a_recorded_step_is_the_closed_forms_displacement():
    for problem in free_steps():
        level, stage = problem.levels[0], first_stage(problem, QP_ONLY)
        dx_b = weighted_optimum(
            level_decomposition(level, np.eye(49), QP_ONLY.rank_tolerance).j_a, level.weights, level.target
        )
        assert np.linalg.norm(dx_b) > 0.0
        wanted = level.matrix @ strict_solution(problem.levels, problem.reference)
        assert level.matrix @ stage.dtheta(-stage.problem.q) == pytest.approx(wanted, abs=WEIGHTED * np.linalg.norm(wanted))


def test_directions_below_the_rank_tolerance_cost_nothing():
    level = Level(np.diag([1.0, 1e-4]), [1.0, 1.0])
    room = Room(np.zeros(2), np.eye(2), np.zeros((0, 2)), np.zeros(0))
    assert [task_stage(level, room, tolerance).costed for tolerance in (1e-3, 1e-5)] == [1, 2]


def test_a_lower_levels_rank_counts_against_its_whole_matrix():
    # In the direction that is left the level moves by 1e-9 of what it could: rounding, not a task.
    level = Level([[1.0, 1e-9]], [1.0])
    room = Room(np.zeros(2), np.array([[0.0], [1.0]]), np.zeros((0, 2)), np.zeros(0))
    assert task_stage(level, room, 1e-6).costed == 0


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
    assert stage.as_it_stands


def test_the_damped_stage_of_a_free_problem_has_no_rows_or_bounds():
    problem = IKProblem([Level(np.eye(2), [1.0, 1.0])])
    qp = damped_stage(problem, problem.levels[0], 1e-3).problem
    assert (qp.G, qp.h, qp.lb, qp.ub) == (None, None, None, None)


def test_the_first_stage_to_look_at_is_that_of_the_formulation():
    problem = PROBLEMS[0]
    assert first_stage(problem, SolveOptions(formulation="damped")).as_it_stands
    assert not first_stage(problem, SolveOptions()).as_it_stands


def test_the_damped_formulation_takes_one_level_only():
    levels = [Level(np.eye(2), [1.0, 1.0])] * 2
    with pytest.raises(InputError, match="takes one level, not 2"):
        first_stage(IKProblem(levels), SolveOptions(formulation="damped"))


def test_the_null_space_left_by_a_stage_is_what_its_level_does_not_feel():
    for problem in PROBLEMS:
        stage = first_stage(problem, QP_ONLY)
        factors = level_decomposition(problem.levels[0], np.eye(5), 1e-6)
        assert stage.unfelt.T @ stage.unfelt == pytest.approx(np.eye(3), abs=ROUNDING)
        assert stage.unfelt == pytest.approx(null_space(factors.j_b), abs=ROUNDING)
