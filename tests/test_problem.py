import numpy as np
import pytest

from prioritized_ik.errors import InputError
from prioritized_ik.problem import STEP_FLOOR, Bounds, IKProblem, Level, Rows


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
