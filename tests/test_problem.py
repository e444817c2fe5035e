import numpy as np
import pytest

from prioritized_ik.errors import InputError
from prioritized_ik.problem import STEP_FLOOR, Bounds, Equalities, IKProblem, Level, Rows, step_scale


@pytest.fixture
def boxed() -> IKProblem:
    """Two joints: the first bounded on both sides, the second above only, and one row."""
    return IKProblem(
        [Level(np.eye(2), [1.0, 1.0])],
        Bounds([-0.5, -np.inf], [1.0, 2.0], ["hip", "knee"]),
        Rows([[3.0, 4.0]], [5.0], ["contact of link 1"]),
    )


def test_a_nan_in_a_levels_matrix_is_named_with_its_place():
    with pytest.raises(InputError, match=r"matrix of level 'reach'\[0, 1\] is nan"):
        Level([[1.0, np.nan]], [0.0], name="reach")


def test_an_infinity_in_a_levels_target_is_named_with_its_place():
    with pytest.raises(InputError, match=r"target of level 'reach'\[1\] is inf; expected finite"):
        Level(np.eye(2), [0.0, np.inf], name="reach")


def test_a_target_of_another_length_than_the_matrix_is_refused():
    with pytest.raises(InputError, match=r"target of level 'task' has shape \(3,\); expected \(2,\)"):
        Level(np.eye(2), np.zeros(3))


def test_a_matrix_that_is_not_one_is_refused():
    with pytest.raises(InputError, match=r"has shape \(2,\); expected \(any, any\)"):
        Level([1.0, 2.0], [0.0])


def test_values_that_are_no_numbers_are_refused():
    with pytest.raises(InputError, match="is not an array of numbers"):
        Level([["a"]], [0.0])


def test_ragged_rows_are_refused():
    with pytest.raises(InputError, match="is not an array of numbers"):
        Level([[1.0, 2.0], [3.0]], [0.0, 0.0])


@pytest.mark.parametrize("shape", [(0, 3), (2, 0)])
def test_a_level_without_rows_or_joints_is_refused(shape):
    with pytest.raises(InputError, match="expected at least one row"):
        Level(np.zeros(shape), np.zeros(shape[0]))


@pytest.mark.parametrize("weight", [0.0, -2.0])
def test_a_weight_that_is_not_positive_is_named_with_its_place(weight):
    with pytest.raises(InputError, match=rf"weights of level 'task'\[1\] is {weight}"):
        Level(np.eye(3), np.zeros(3), [1.0, weight, 1.0])


def test_weights_are_one_unless_given():
    assert np.array_equal(Level(np.eye(3), np.zeros(3)).weights, np.ones(3))


def test_the_cost_of_a_level_is_eq_10():
    level = Level([[1.0, 0.0], [0.0, 2.0]], [3.0, 1.0], [10.0, 0.5])
    assert level.cost(np.array([1.0, 1.0])) == 10.0 * (3.0 - 1.0) ** 2 + 0.5 * (1.0 - 2.0) ** 2


def test_crossing_bounds_name_the_joint_and_both_values():
    with pytest.raises(InputError, match=r"lower bound 0\.2 of knee is above its upper bound 0\.1"):
        Bounds([0.0, 0.2], [1.0, 0.1], ["hip", "knee"])


def test_crossing_bounds_without_names_number_the_joint_from_one():
    with pytest.raises(InputError, match="of joint 2 is above"):
        Bounds([0.0, 0.2], [1.0, 0.1])


def test_a_nan_bound_is_refused():
    with pytest.raises(InputError, match=r"upper bounds\[1\] is nan"):
        Bounds([0.0, 0.0], [1.0, np.nan])


def test_bounds_of_unequal_lengths_are_refused():
    with pytest.raises(InputError, match=r"upper bounds has shape \(3,\); expected \(2,\)"):
        Bounds(np.zeros(2), np.ones(3))


def test_names_must_be_as_many_as_bounds():
    with pytest.raises(InputError, match="names of bounds has 1 entries; expected 2"):
        Bounds(np.zeros(2), np.ones(2), ["hip"])


def test_the_intersection_of_bounds_keeps_the_tighter_side_and_the_names():
    both = Bounds([-1.0, -3.0], [1.0, 3.0], ["hip", "knee"]).intersect(Bounds([-2.0, -2.0], [0.5, 9.0]))
    assert both.lower.tolist() == [-1.0, -2.0]
    assert both.upper.tolist() == [0.5, 3.0]
    assert both.names == ("hip", "knee")


def test_a_row_without_a_finite_side_is_refused():
    with pytest.raises(InputError, match=r"upper side of rows\[0\] is inf"):
        Rows([[1.0, 0.0]], [np.inf])


def test_names_must_be_as_many_as_rows():
    with pytest.raises(InputError, match="names of rows has 2 entries; expected 1"):
        Rows([[1.0]], [0.0], ["a", "b"])


def test_a_problem_without_levels_is_refused():
    with pytest.raises(InputError, match=r"levels is \[\]; expected a list of at least one Level"):
        IKProblem([])


def test_levels_of_unequal_widths_are_refused_by_name():
    with pytest.raises(InputError, match="level 'posture' has 3 joints; expected 2"):
        IKProblem([Level(np.eye(2), np.zeros(2)), Level(np.eye(3), np.zeros(3), name="posture")])


def test_bounds_of_another_width_are_refused():
    with pytest.raises(InputError, match="bounds has 3 joints; expected 2"):
        IKProblem([Level(np.eye(2), np.zeros(2))], Bounds.none(3))


def test_rows_of_another_width_are_refused():
    with pytest.raises(InputError, match="rows has 1 joints; expected 2"):
        IKProblem([Level(np.eye(2), np.zeros(2))], rows=Rows([[1.0]], [0.0]))


def test_a_reference_of_another_length_is_refused():
    with pytest.raises(InputError, match=r"reference has shape \(3,\); expected \(2,\)"):
        IKProblem([Level(np.eye(2), np.zeros(2))], reference=np.zeros(3))


def test_the_reference_is_zero_unless_given():
    assert np.array_equal(IKProblem([Level(np.eye(2), np.zeros(2))]).reference, np.zeros(2))


def test_every_array_is_read_only(boxed):
    level, rows = boxed.levels[0], boxed.inequalities
    arrays = [level.matrix, level.target, level.weights, boxed.bounds.lower, boxed.bounds.upper]
    arrays += [boxed.rows.matrix, boxed.rows.upper, boxed.reference, rows.matrix, rows.upper]
    assert not any(array.flags.writeable for array in arrays)


def test_a_problem_keeps_its_own_copy_of_the_callers_arrays():
    target = np.array([1.0, 1.0])
    level = Level(np.eye(2), target)
    target[0] = 9.0
    assert level.target[0] == 1.0


def test_inequalities_stack_finite_bounds_and_rows_with_names(boxed):
    rows = boxed.inequalities
    assert rows.matrix.tolist() == [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [3.0, 4.0]]
    assert rows.upper.tolist() == [1.0, 2.0, 0.5, 5.0]
    assert rows.names == ("hip upper", "knee upper", "hip lower", "contact of link 1")


def test_inequalities_are_none_where_nothing_binds():
    assert IKProblem([Level(np.eye(2), np.zeros(2))]).inequalities.matrix.shape == (0, 2)


def test_the_violation_is_a_joint_distance_relative_to_the_step(boxed):
    # At (1, 1) the row gives 7 <= 5: a distance of 2 / 5, over a step of length √2.
    assert boxed.relative_violation([1.0, 1.0]) == pytest.approx(0.4 / np.sqrt(2.0), rel=1e-15)


def test_the_violation_is_zero_inside(boxed):
    assert boxed.relative_violation([0.1, 0.1]) == 0.0


def test_the_violation_is_zero_without_rows():
    assert IKProblem([Level(np.eye(2), np.zeros(2))]).relative_violation([9.0, 9.0]) == 0.0


def test_the_violation_of_a_tiny_step_counts_against_the_floor():
    problem = IKProblem([Level(np.eye(2), np.zeros(2))], Bounds([-1.0, -1.0], [0.0, 1.0]))
    assert problem.relative_violation([1e-9, 0.0]) == pytest.approx(1e-9 / STEP_FLOOR, rel=1e-15)


def test_tight_rows_are_those_within_the_tolerance_as_a_joint_distance(boxed):
    # The row 3 x + 4 y <= 5 is 0.05 from binding, a joint distance of 0.01; "hip upper" is at 1.
    step = [1.0, 0.4875]
    assert boxed.tight_rows(step, 0.011) == ("hip upper", "contact of link 1")
    assert boxed.tight_rows(step, 0.009) == ("hip upper",)


# Soft inequalities.


def test_levels_are_equal_unless_said_otherwise():
    assert Level(np.eye(2), np.zeros(2)).kind == "equal"
    assert not Level(np.eye(2), np.zeros(2)).is_soft
    assert Level(np.eye(2), np.zeros(2), kind="at_most").is_soft


def test_a_level_of_an_unknown_kind_is_refused_with_those_there_are():
    with pytest.raises(InputError, match=r"unknown kind of level 'reach' 'at_least'; choose one of: equal, at_most\."):
        Level(np.eye(2), np.zeros(2), name="reach", kind="at_least")


def test_the_residual_of_a_level_is_what_it_is_off_by_on_either_side():
    assert Level(np.eye(2), [1.0, 5.0]).residual(np.array([3.0, 3.0])).tolist() == [2.0, -2.0]


def test_the_residual_of_a_soft_level_is_only_what_exceeds_its_target():
    assert Level(np.eye(2), [1.0, 5.0], kind="at_most").residual(np.array([3.0, 3.0])).tolist() == [2.0, 0.0]


def test_a_soft_level_costs_only_what_exceeds_its_target():
    level = Level([[1.0, 0.0], [0.0, 2.0]], [3.0, 1.0], [10.0, 0.5], kind="at_most")
    assert level.cost(np.array([1.0, 1.0])) == 0.5 * (2.0 - 1.0) ** 2
    assert level.cost(np.array([1.0, 0.0])) == 0.0


# Equalities.


@pytest.fixture
def held() -> IKProblem:
    """Two joints: the first bounded above and below, one row and two equalities."""
    return IKProblem(
        [Level(np.eye(2), [1.0, 1.0])],
        Bounds([-0.5, -np.inf], [1.0, np.inf], ["hip", "knee"]),
        Rows([[3.0, 4.0], [0.0, 2.0]], [5.0, 6.0], ["contact of link 1", "contact of link 2"]),
        [0.1, 0.2],
        Equalities([[0.0, 5.0], [1.0, 1.0]], [10.0, 2.5], ["hold the knee", "balance"]),
    )


def test_equalities_are_numbered_from_one_unless_named():
    assert Equalities(np.eye(2), np.zeros(2)).names == ("equality 1", "equality 2")


def test_names_must_be_as_many_as_equalities():
    with pytest.raises(InputError, match="names of equalities has 1 entries; expected 2"):
        Equalities(np.eye(2), np.zeros(2), ["hold"])


def test_an_equality_of_zeros_that_no_step_can_keep_is_refused():
    with pytest.raises(InputError, match=r"hold is all zero but must be 0\.5, which no step can keep; leave it out"):
        Equalities([[0.0, 0.0]], [0.5], ["hold"])


def test_an_equality_of_zeros_that_every_step_keeps_is_allowed():
    assert Equalities([[0.0, 0.0]], [0.0]).matrix.shape == (1, 2)


def test_equalities_with_a_target_that_is_not_finite_are_refused():
    with pytest.raises(InputError, match=r"target of equalities\[1\] is inf"):
        Equalities(np.eye(2), [0.0, np.inf])


def test_a_problem_has_no_equalities_unless_given():
    assert IKProblem([Level(np.eye(2), np.zeros(2))]).equalities.matrix.shape == (0, 2)


def test_equalities_for_another_number_of_joints_are_refused():
    with pytest.raises(InputError, match="equalities has 3 joints; expected 2"):
        IKProblem([Level(np.eye(2), np.zeros(2))], equalities=Equalities(np.eye(3), np.zeros(3)))


def test_rows_in_the_place_of_equalities_are_refused():
    with pytest.raises(InputError, match="expected Equalities or None"):
        IKProblem([Level(np.eye(2), np.zeros(2))], equalities=Rows.none(2))


@pytest.mark.parametrize("knee", [2.6, 1.4])
def test_the_violation_of_an_equality_counts_on_either_side_as_a_joint_distance(knee):
    # 5 y = 10 is off by 3, a distance of 3 / 5.
    problem = IKProblem([Level(np.eye(2), np.zeros(2))], equalities=Equalities([[0.0, 5.0]], [10.0]))
    assert problem.relative_violation([0.0, knee]) == pytest.approx(0.6 / knee, rel=1e-15)


def test_the_worst_of_rows_and_equalities_is_the_violation(held):
    # "balance" is off by 2.5 - 0, a distance of 2.5 / √2, and "hold the knee" by 2; the rows and bounds are kept.
    assert held.relative_violation([0.0, 0.0]) == pytest.approx(2.0 / STEP_FLOOR, rel=1e-15)


def test_equalities_are_no_inequalities(held):
    assert held.inequalities.names == ("hip upper", "hip lower", "contact of link 1", "contact of link 2")


@pytest.mark.parametrize(("step", "scale"), [([3.0, 4.0], 5.0), ([0.0, 0.0], STEP_FLOOR), ([1e-9, 0.0], STEP_FLOOR)])
def test_the_scale_of_a_step_is_its_length_with_a_floor(step, scale):
    assert step_scale(np.array(step)) == scale


# Hard rows made soft.


def test_a_softened_bound_opens_its_side_and_becomes_the_first_level(held):
    soft = held.softened(["hip upper"])
    assert soft.bounds.upper.tolist() == [np.inf, np.inf]
    assert soft.bounds.lower.tolist() == [-0.5, -np.inf]
    assert soft.bounds.names == ("hip", "knee")
    assert (soft.levels[0].name, soft.levels[0].kind) == ("softened rows", "at_most")
    assert soft.levels[0].matrix.tolist() == [[1.0, 0.0]]
    assert soft.levels[0].target.tolist() == [1.0]
    assert soft.levels[1:] == held.levels


def test_a_softened_lower_bound_is_an_upper_one_of_the_opposite(held):
    soft = held.softened(["hip lower"])
    assert soft.bounds.lower.tolist() == [-np.inf, -np.inf]
    assert soft.bounds.upper.tolist() == [1.0, np.inf]
    assert soft.levels[0].matrix.tolist() == [[-1.0, 0.0]]
    assert soft.levels[0].target.tolist() == [0.5]


def test_a_softened_row_is_of_length_one_so_that_it_gives_way_by_a_joint_distance(held):
    soft = held.softened(["contact of link 1"])
    assert soft.rows.names == ("contact of link 2",)
    assert soft.rows.matrix.tolist() == [[0.0, 2.0]]
    assert soft.rows.upper.tolist() == [6.0]
    assert soft.levels[0].matrix[0] == pytest.approx([0.6, 0.8], rel=1e-15)
    assert soft.levels[0].target == pytest.approx([1.0], rel=1e-15)


def test_a_softened_equality_becomes_two_opposite_rows(held):
    soft = held.softened(["hold the knee"])
    assert soft.equalities.names == ("balance",)
    assert soft.equalities.matrix.tolist() == [[1.0, 1.0]]
    assert soft.equalities.target.tolist() == [2.5]
    assert soft.levels[0].matrix.tolist() == [[0.0, 1.0], [0.0, -1.0]]
    assert soft.levels[0].target.tolist() == [2.0, -2.0]


def test_softening_leaves_the_reference_and_the_other_rows_alone(held):
    soft = held.softened(["hip upper"])
    assert soft.reference.tolist() == [0.1, 0.2]
    assert (soft.rows.names, soft.equalities.names) == (held.rows.names, held.equalities.names)


def test_everything_can_be_softened_at_once_and_nothing_hard_is_left(held):
    soft = held.softened([*held.inequalities.names, *held.equalities.names])
    assert soft.inequalities.names == ()
    assert soft.equalities.names == ()
    assert len(soft.levels[0].target) == 4 + 2 * 2
    assert np.linalg.norm(soft.levels[0].matrix, axis=1) == pytest.approx(np.ones(8), rel=1e-15)
    assert soft.relative_violation([9.0, 9.0]) == 0.0


def test_each_name_softens_its_own_row_only(held):
    names = (*held.inequalities.names, *held.equalities.names)
    for name in names:
        soft = held.softened([name])
        left = (*soft.inequalities.names, *soft.equalities.names)
        assert left == tuple(other for other in names if other != name)


def test_the_cost_of_softened_rows_is_the_square_of_what_they_were_broken_by(held):
    soft = held.softened(["hip upper", "contact of link 1"])
    # (2, 1): x <= 1 is broken by 1, and 3 x + 4 y <= 5 by 5, a distance of 1.
    assert soft.levels[0].cost(np.array([2.0, 1.0])) == pytest.approx(2.0, rel=1e-14)


def test_softening_nothing_changes_nothing(held):
    assert held.softened([]) is held


def test_softening_a_row_of_zeros_is_allowed():
    problem = IKProblem([Level(np.eye(2), np.zeros(2))], rows=Rows([[0.0, 0.0]], [7.0], ["idle"]))
    assert problem.softened(["idle"]).levels[0].cost(np.array([9.0, 9.0])) == 0.0


def test_a_name_that_no_hard_row_has_is_refused_with_some_that_there_are(held):
    with pytest.raises(InputError, match=r"no hard row is called 'knee upper'.*'?hip upper"):
        held.softened(["hip lower", "knee upper"])


def test_a_problem_without_hard_rows_has_nothing_to_soften():
    with pytest.raises(InputError, match="no hard row is called 'hip upper'"):
        IKProblem([Level(np.eye(2), np.zeros(2))]).softened(["hip upper"])
