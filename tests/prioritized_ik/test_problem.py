import dataclasses
from fractions import Fraction

import numpy as np
import pytest

from prioritized_ik.errors import InputError
from prioritized_ik.problem import Bounds, Equalities, IKProblem, Level, Rows, trusted_level, trusted_problem


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


@pytest.mark.parametrize("kind", ["equal", "at_most"])
def test_a_level_without_rows_asks_for_nothing(kind):
    level = Level(np.zeros((0, 3)), [], kind=kind)
    assert (level.cost(np.ones(3)), level.demand) == (0.0, 0.0)
    assert IKProblem([level]).joint_count == 3


def test_a_weight_below_zero_is_named_with_its_place():
    with pytest.raises(InputError, match=r"weights of level 'task'\[1\] is -2\.0; expected numbers of at least 0"):
        Level(np.eye(3), np.zeros(3), [1.0, -2.0, 1.0])


@pytest.mark.parametrize("kind", ["equal", "at_most"])
def test_a_row_of_weight_zero_costs_and_asks_for_nothing(kind):
    level = Level(np.eye(2), [1.0, 5.0], [4.0, 0.0], kind=kind)
    assert level.cost(np.array([3.0, 9.0])) == 16.0
    assert level.demand == 2.0


def test_weights_are_one_unless_given():
    assert np.array_equal(Level(np.eye(3), np.zeros(3)).weights, np.ones(3))


def test_the_cost_of_a_level_is_eq_10():
    level = Level([[1.0, 0.0], [0.0, 2.0]], [3.0, 1.0], [10.0, 0.5])
    assert level.cost(np.array([1.0, 1.0])) == 10.0 * (3.0 - 1.0) ** 2 + 0.5 * (1.0 - 2.0) ** 2


def test_crossing_bounds_name_the_joint_and_both_values():
    said = r"'knee lower' is 0\.2, above 'knee upper', 0\.1: no step keeps both; widen one"
    with pytest.raises(InputError, match=said):
        Bounds([0.0, 0.2], [1.0, 0.1], ["hip", "knee"])


def test_crossing_bounds_without_names_number_the_joint_from_one():
    with pytest.raises(InputError, match=r"'joint 2 lower' is 0\.2, above 'joint 2 upper', 0\.1"):
        Bounds([0.0, 0.2], [1.0, 0.1])


@pytest.mark.parametrize(("lower", "upper"), [(np.inf, np.inf), (-np.inf, -np.inf)])
def test_bounds_at_infinity_that_no_step_keeps_are_refused(lower, upper):
    with pytest.raises(InputError, match=r"'joint 1 lower' .* 'joint 1 upper'.* no step keeps both"):
        Bounds([lower], [upper])


def test_the_intersection_of_bounds_that_exclude_each_other_names_both_limits():
    one, other = Bounds([0.0, 0.0], [1.0, 1.0], ["hip", "knee"]), Bounds([0.0, 2.0], [1.0, 3.0])
    with pytest.raises(InputError, match=r"'knee lower' is 2\.0, above 'knee upper', 1\.0"):
        one.intersect(other)


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


def test_a_row_whose_side_is_infinite_means_nothing():
    rows = Rows([[1.0, 0.0], [0.0, 1.0]], [np.inf, 2.0], ["never", "floor"])
    problem = IKProblem([Level(np.eye(2), np.zeros(2))], rows=rows)
    assert problem.inequalities.names == ("floor",)
    assert problem.inequalities.matrix.tolist() == [[0.0, 1.0]]
    assert problem.violation([1e9, 2.0]) == 0.0
    assert problem.tight_rows([1e9, 2.0], 1e-9) == ("floor",)


def test_a_row_that_must_be_below_minus_infinity_is_refused():
    with pytest.raises(InputError, match=r"upper side of rows\[0\] is -inf, which no step can keep"):
        Rows([[1.0, 0.0]], [-np.inf])
    with pytest.raises(InputError, match=r"target of level 'room'\[1\] is -inf, which no step can keep"):
        Level(np.eye(2), [0.0, -np.inf], name="room", kind="at_most")


def test_a_soft_row_whose_target_is_infinite_costs_and_asks_for_nothing():
    level = Level(np.eye(2), [1.0, np.inf], [4.0, 4.0], kind="at_most")
    assert level.cost(np.array([3.0, 1e300])) == 16.0
    assert level.demand == 2.0


def test_a_row_of_zeros_that_no_step_can_keep_is_refused():
    with pytest.raises(
        InputError, match=r"idle is all zero but must not exceed -0\.5, which no step can keep; leave it out"
    ):
        Rows([[0.0, 0.0]], [-0.5], ["idle"])


def test_names_must_be_as_many_as_rows():
    with pytest.raises(InputError, match="names of rows has 2 entries; expected 1"):
        Rows([[1.0]], [0.0], ["a", "b"])


@pytest.mark.parametrize(
    ("what", "make"),
    [
        ("bounds", lambda names: Bounds([0.0] * 3, [1.0] * 3, names)),
        ("rows", lambda names: Rows(np.eye(3), [1.0] * 3, names)),
        ("equalities", lambda names: Equalities(np.eye(3), [1.0] * 3, names)),
    ],
)
def test_a_repeated_name_is_refused_with_both_places(what, make):
    assert make(["a", "b", "c"]).names == ("a", "b", "c")
    with pytest.raises(InputError, match=rf"names of {what}\[0\] and \[2\] are both 'a'; expected names that differ"):
        make(["a", "b", "a"])


@pytest.mark.parametrize(
    ("bound", "row", "equality", "said"),
    [
        ("a", "a upper", "e", "a bound and a row are both called 'a upper'"),
        ("a", "r", "a lower", "a bound and an equality are both called 'a lower'"),
        ("a", "same", "same", "a row and an equality are both called 'same'"),
    ],
)
def test_a_problem_tells_bounds_rows_and_equalities_apart_by_name(bound, row, equality, said):
    parts = Bounds([0.0], [1.0], [bound]), Rows([[1.0]], [1.0], [row])
    with pytest.raises(InputError, match=said):
        IKProblem([], *parts, equalities=Equalities([[1.0]], [0.5], [equality]))


def test_joined_rows_and_equalities_are_told_apart():
    parts = [
        Rows(np.eye(2), [1.0, 2.0], ["a", "b"]),
        Rows(np.eye(2), [3.0, 4.0], ["a", "a (2)"]),
        Rows([[1, 1]], [5.0], ["a"]),
    ]
    joined = Rows.joined(parts, 2)
    assert joined.names == ("a", "b", "a (3)", "a (2)", "a (4)")
    assert joined.upper.tolist() == [1.0, 2.0, 3.0, 4.0, 5.0]
    equal = [Equalities([[1.0]], [1.0], ["loop"]), Equalities([[2.0]], [2.0], ["loop"])]
    assert Equalities.joined(equal, 1).names == ("loop", "loop (2)")
    assert Equalities.joined([], 4).matrix.shape == (0, 4)


def test_a_problem_of_which_nothing_tells_the_number_of_joints_is_refused():
    with pytest.raises(InputError, match="neither levels nor bounds, rows, equalities or reference: no number of joints"):
        IKProblem([])


PARTS = {
    "bounds": Bounds.none(3),
    "rows": Rows([[1.0, 0.0, 0.0]], [1.0]),
    "equalities": Equalities([[1.0, 0.0, 0.0]], [1.0]),
    "reference": [1.0, 2.0, 3.0],
}


@pytest.mark.parametrize("name", PARTS)
def test_without_levels_the_number_of_joints_is_that_of_any_other_part(name):
    assert IKProblem([], **{name: PARTS[name]}).joint_count == 3


@pytest.mark.parametrize("levels", [None, Level(np.eye(2), np.zeros(2)), [np.eye(2)], "ab"])
def test_levels_that_are_no_list_of_levels_are_refused(levels):
    with pytest.raises(InputError, match="expected a list of Level"):
        IKProblem(levels)


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


@pytest.mark.parametrize("size", [1e-12, 1e-9, 1.0, 1e9])
def test_the_violation_of_a_step_of_any_size_counts_against_its_own_length(size):
    problem = IKProblem([Level(np.eye(2), np.zeros(2))], Bounds([-1.0, -1.0], [0.0, np.inf]))
    assert problem.violation([3.0 * size, 4.0 * size]) == pytest.approx(3.0 * size, rel=1e-15)
    assert problem.relative_violation([3.0 * size, 4.0 * size]) == pytest.approx(0.6, rel=1e-15)


def test_the_violation_of_standing_still_is_the_distance_itself():
    problem = IKProblem([Level(np.eye(2), np.zeros(2))], Bounds([1e-7, -1.0], [1.0, 1.0]))
    assert problem.relative_violation([0.0, 0.0]) == problem.violation([0.0, 0.0]) == 1e-7


def test_tight_rows_are_those_within_the_tolerance_as_a_joint_distance(boxed):
    # The row 3 x + 4 y <= 5 is 0.05 from binding, a joint distance of 0.01; "hip upper" is at 1.
    step = [1.0, 0.4875]
    assert boxed.tight_rows(step, 0.011) == ("hip upper", "contact of link 1")
    assert boxed.tight_rows(step, 0.009) == ("hip upper",)


# The joint metric.

DIAGONAL = np.array([4.0, 1.0, 0.25])
FULL = np.array([[4.0, 1.0, 0.0], [1.0, 2.0, -0.5], [0.0, -0.5, 1.0]])
METRICS = {"diagonal": DIAGONAL, "full": FULL, "diagonal as a matrix": np.diag(DIAGONAL)}


def as_matrix(metric: np.ndarray) -> np.ndarray:
    return np.diag(metric) if metric.ndim == 1 else metric


def measured(metric: np.ndarray) -> IKProblem:
    """Three joints with bounds, a row, an equality and two levels."""
    return IKProblem(
        [Level([[1.0, 2.0, 3.0]], [0.5], [2.0]), Level([[0.0, 1.0, -1.0]], [0.1], name="room", kind="at_most")],
        Bounds([-1.0, -np.inf, -3.0], [1.0, 2.0, np.inf], ["hip", "knee", "ankle"]),
        Rows([[3.0, 4.0, 0.0]], [5.0], ["contact"]),
        [0.1, 0.2, 0.3],
        Equalities([[0.0, 1.0, 5.0]], [0.7], ["hold"]),
        metric=metric,
    )


@pytest.fixture(params=METRICS)
def metric(request: pytest.FixtureRequest) -> np.ndarray:
    return METRICS[request.param]


def test_the_metric_is_one_unless_given_and_the_problem_is_in_it():
    problem = IKProblem([Level(np.eye(2), np.zeros(2))])
    assert problem.metric.tolist() == [1.0, 1.0]
    assert problem.in_metric is problem
    step = np.array([1.0, 2.0])
    assert np.array_equal(problem.to_metric(step), step)
    assert np.array_equal(problem.from_metric(step), step)


def test_lengths_in_the_metric_are_those_of_the_coordinates(metric):
    problem = measured(metric)
    for step in np.random.default_rng(0).normal(size=(5, 3)):
        u = problem.to_metric(step)
        assert u @ u == pytest.approx(step @ as_matrix(metric) @ step, rel=1e-14)
        assert problem.from_metric(u) == pytest.approx(step, rel=1e-13)


def test_the_problem_in_its_metric_says_the_same_of_every_step(metric):
    problem = measured(metric)
    scaled = problem.in_metric
    assert scaled.in_metric is scaled
    assert scaled.metric.tolist() == [1.0, 1.0, 1.0]
    assert sorted(scaled.inequalities.names) == sorted(problem.inequalities.names)
    for step in np.random.default_rng(1).normal(scale=3.0, size=(20, 3)):
        u = problem.to_metric(step)
        costs = [(one.cost(step), other.cost(u)) for one, other in zip(problem.levels, scaled.levels, strict=True)]
        for one, other in costs:
            assert other == pytest.approx(one, rel=1e-12, abs=1e-14)
        assert distances(scaled, u) == pytest.approx(distances(problem, step), rel=1e-12, abs=1e-13)
        off = problem.equalities.matrix @ step - problem.equalities.target
        assert scaled.equalities.matrix @ u - scaled.equalities.target == pytest.approx(off, rel=1e-12, abs=1e-13)
        away, there = u - scaled.reference, step - problem.reference
        assert away @ away == pytest.approx(there @ as_matrix(metric) @ there, rel=1e-12)


def distances(problem: IKProblem, step: np.ndarray) -> dict[str, float]:
    """How far a step is from each hard row, by name: (h - g·dθ) / √(gᵀM⁻¹g)."""
    rows, inverse = problem.inequalities, np.linalg.inv(as_matrix(problem.metric))
    sides = zip(rows.names, rows.matrix, rows.upper, strict=True)
    return {name: float((h - g @ step) / np.sqrt(g @ inverse @ g)) for name, g, h in sides}


def test_the_violation_is_the_distance_in_the_metric_to_what_keeps_the_row(metric):
    # The nearest point of g·dθ <= h in the metric M is (g·dθ - h) / √(gᵀM⁻¹g) away.
    problem = measured(metric)
    inverse = np.linalg.inv(as_matrix(metric))
    hard, fixed = problem.inequalities, problem.equalities
    for step in np.random.default_rng(2).normal(scale=3.0, size=(20, 3)):
        broken = [max(g @ step - h, 0.0) / np.sqrt(g @ inverse @ g) for g, h in zip(hard.matrix, hard.upper, strict=True)]
        broken += [abs(g @ step - h) / np.sqrt(g @ inverse @ g) for g, h in zip(fixed.matrix, fixed.target, strict=True)]
        assert problem.violation(step) == pytest.approx(max(broken), rel=1e-12)
        length = np.sqrt(step @ as_matrix(metric) @ step)
        assert problem.relative_violation(step) == pytest.approx(max(broken) / length, rel=1e-12)


def test_tight_rows_are_within_a_distance_in_the_metric():
    problem = IKProblem([], Bounds([-np.inf], [1.0], ["slide"]), metric=[100.0])  # 0.01 of the joint's unit measures 0.1
    assert problem.tight_rows([0.99], 0.11) == ("slide upper",)
    assert problem.tight_rows([0.99], 0.09) == ()


def test_a_metric_that_is_a_diagonal_matrix_is_that_diagonal():
    one, other = measured(DIAGONAL), measured(np.diag(DIAGONAL))
    step = np.array([0.3, -0.2, 0.5])
    assert other.to_metric(step) == pytest.approx(one.to_metric(step), rel=1e-15)
    assert other.violation(step) == pytest.approx(one.violation(step), rel=1e-14)


@pytest.mark.parametrize(
    ("metric", "said"),
    [
        ([1.0, 1.0], r"metric has shape \(2,\); expected \(3,\)"),
        (np.eye(2), r"metric has shape \(2, 2\); expected \(3, 3\)"),
        ([1.0, 0.0, 1.0], r"metric\[1\] is 0\.0; expected numbers above 0"),
        ([1.0, 1.0, -2.0], r"metric\[2\] is -2\.0; expected numbers above 0"),
        ([1.0, np.nan, 1.0], r"metric\[1\] is nan"),
        ([1.0, np.inf, 1.0], r"metric\[1\] is inf; expected finite"),
        (np.diag([1.0, 1.0, np.inf]), r"metric\[2, 2\] is inf; expected finite"),
        ([[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], r"metric differs from its transpose by 0\.5; .* symmetric"),
        (np.diag([1.0, 1.0, -1.0]), "metric\\[2\\] is -1.0; expected numbers above 0"),
        (np.ones((3, 3)), "metric is singular .*; expected a positive definite matrix"),
        ("ones", "metric is not an array of numbers"),
    ],
)
def test_a_metric_that_is_none_is_refused_with_what_is_wrong(metric, said):
    with pytest.raises(InputError, match=said):
        IKProblem([Level(np.eye(3), np.zeros(3))], metric=metric)


def test_a_metric_symmetric_to_rounding_is_accepted():
    metric = FULL.copy()
    metric[0, 1] *= 1.0 + 1e-15
    assert measured(metric).violation([0.0, 0.0, 0.0]) == pytest.approx(
        measured(FULL).violation([0.0, 0.0, 0.0]), rel=1e-12
    )


def test_other_levels_keep_the_metric_and_the_noise(metric):
    problem = IKProblem(measured(metric).levels, metric=metric, noise=1e-6)
    for other in (problem.with_levels(problem.levels[:1]), problem.in_metric):
        assert other.noise == 1e-6
    assert problem.with_levels(problem.levels[:1]).metric is problem.metric
    softened = IKProblem([], Bounds([0.0] * 3, [1.0] * 3), metric=metric, noise=1e-6).softened(["joint 1 upper"])
    assert (softened.noise, softened.metric.tolist()) == (1e-6, np.asarray(metric).tolist())


# Noise.


@pytest.mark.parametrize("noise", [0.0, -1e-9, 0.01, 1.0, np.nan, np.inf, "small", None])
def test_a_noise_out_of_range_is_refused(noise):
    with pytest.raises(InputError, match=r"noise is .*; expected a number above 0 and below 0\.01"):
        IKProblem([Level(np.eye(2), np.zeros(2))], noise=noise)


ROUNDED_TO = 64 * 2.0**-52  # sixty products of two doubles


def test_unless_stated_rows_are_rounding_where_doubles_leave_no_more_of_a_zero():
    problem = IKProblem([Level([[100.0, 0.0]], [1.0])], rows=Rows([[0.0, 1.0]], [1.0]))
    assert problem.zero_length == pytest.approx(100.0 * ROUNDED_TO, rel=1e-15)


@pytest.mark.parametrize("noise", [1e-15, 1e-11, 1e-6, 9e-3])
def test_rows_up_to_the_noise_of_the_longest_are_rounding(noise):
    problem = IKProblem([Level([[100.0, 0.0]], [1.0])], rows=Rows([[0.0, 1.0]], [1.0]), noise=noise)
    assert problem.zero_length == pytest.approx(100.0 * noise, rel=1e-15)


def test_a_joints_own_step_counts_among_the_rows_so_that_tiny_levels_alone_are_rounding():
    assert IKProblem([Level([[1e-20, 0.0]], [1.0])]).zero_length == ROUNDED_TO


def test_rows_that_are_rounding_are_kept_by_every_step_and_never_tight():
    rows = Rows([[1e-17, 0.0], [0.0, 1.0]], [-1.0, 1.0], ["rounding", "floor"])
    problem = IKProblem([], rows=rows, equalities=Equalities([[0.0, 1e-17]], [1.0]))
    assert problem.violation([0.0, 0.0]) == 0.0
    assert problem.tight_rows([0.0, 1.0], 1e-9) == ("floor",)
    assert problem.violation([0.0, 3.0]) == 2.0


# In words.


def test_a_problem_says_what_it_is_in_a_few_lines():
    problem = IKProblem(
        [Level(np.eye(2), [3.0, 4.0], name="reach"), Level(np.eye(2), [0.0, 0.0], name="posture", damping=1e-3)],
        Bounds([0.0, -1.0], [0.0, np.inf]),
        Rows([[1.0, 0.0]], [1.0]),
    )
    assert str(problem).splitlines() == [
        "IKProblem of 2 joints, 2 levels",
        "  1. reach: 2 rows, equal, asks for 5",
        "  2. posture: 2 rows, equal, asks for 0, damping 0.001 (free)",
        "  hard: 2 joints bounded (1 frozen), 1 rows, 0 equalities",
    ]


# Damping.


@pytest.mark.parametrize("bad", [-1.0, np.nan, np.inf, "much"])
def test_a_damping_that_is_no_number_of_at_least_zero_is_refused(bad):
    with pytest.raises(InputError, match=r"damping of level 'reach' is .*; expected a finite number of at least 0"):
        Level(np.eye(2), np.zeros(2), name="reach", damping=bad)


def test_damping_of_soft_inequalities_is_refused():
    with pytest.raises(InputError, match=r"damping of level 'room' is 0\.1; expected 0, as soft inequalities have none"):
        Level(np.eye(2), np.zeros(2), name="room", kind="at_most", damping=0.1)


def test_what_a_damped_level_leaves_below_is_one_of_two_words():
    with pytest.raises(InputError, match=r"unknown below of level 'reach' 'some'; choose one of: free, hold\."):
        Level(np.eye(2), np.zeros(2), name="reach", damping=0.1, below="some")


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
    assert held.violation([0.0, 0.0]) == pytest.approx(2.0, rel=1e-15)


def test_equalities_are_no_inequalities(held):
    assert held.inequalities.names == ("hip upper", "hip lower", "contact of link 1", "contact of link 2")


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


def test_bounds_of_other_joints_do_not_intersect() -> None:
    with pytest.raises(InputError, match="of 3 joints; expected 2"):
        Bounds([-1, -1], [1, 1]).intersect(Bounds.none(3))


def test_bounds_that_cross_where_they_intersect_are_refused_by_name() -> None:
    with pytest.raises(InputError, match=r"'b lower' is 2\.0, above 'b upper', 1\.0"):
        Bounds([-1, -1], [1, 1], ["a", "b"]).intersect(Bounds([-1, 2], [1, 3]))


def test_an_unchecked_problem_is_the_one_that_checks_would_make() -> None:
    level = Level([[1.0, 2.0]], [3.0], [4.0], "hand")
    bounds, rows = Bounds([-1, -np.inf], [1, 2]), Rows([[1, 1], [2, 0]], [1, np.inf])
    for given in ((bounds, rows), (None, None)):
        checked = IKProblem([level], *given)
        unchecked = trusted_problem((trusted_level(level.matrix, level.target, level.weights, "hand"),), *given, 2)
        for one, other in ((checked, unchecked), (checked.levels[0], unchecked.levels[0])):
            for item in dataclasses.fields(one):
                same, as_same = getattr(one, item.name), getattr(other, item.name)
                if isinstance(same, np.ndarray):
                    assert np.array_equal(same, as_same)
                    assert not as_same.flags.writeable
                elif item.name in ("kind", "below", "name", "damping", "noise"):
                    assert same == as_same
        assert np.array_equal(checked.inequalities.matrix, unchecked.inequalities.matrix)
        assert checked.inequalities.names == unchecked.inequalities.names


def test_bounds_of_other_joints_or_sides_have_other_inequalities() -> None:
    for lower, upper, names, rows in (
        ([-1, -np.inf], [np.inf, 2], ("a", "b"), ("b upper", "a lower")),
        ([-1, -1], [np.inf, 2], ("a", "b"), ("b upper", "a lower", "b lower")),
        ([-1, -1], [np.inf, 2], ("c", "d"), ("d upper", "c lower", "d lower")),
    ):
        found = IKProblem([], Bounds(lower, upper, names)).inequalities
        assert found.names == rows
        for name, row in zip(found.names, found.matrix, strict=True):
            joint, side = name.split()
            assert np.array_equal(row, (1.0 if side == "upper" else -1.0) * np.eye(2)[names.index(joint)])


def test_rows_are_divided_by_the_root_of_an_ill_conditioned_metric_to_the_last_digit():
    rng = np.random.default_rng(0)
    for size in (1e-3, 1e-5):
        skewed = np.triu(rng.normal(size=(5, 5)))
        skewed[np.diag_indices(5)] = np.geomspace(1.0, size, 5)
        metric = skewed.T @ skewed + 1e-3 * size * np.eye(5)
        problem = IKProblem([Level(rng.normal(size=(3, 5)), np.zeros(3))], metric=metric)
        root = [[Fraction(value) for value in row] for row in problem.metric_root.tolist()]
        for row, divided in zip(problem.levels[0].matrix, problem.in_metric.levels[0].matrix, strict=True):
            exact: list[Fraction] = []
            for j in range(5):
                before = sum((exact[i] * root[i][j] for i in range(j)), Fraction(0))
                exact.append((Fraction(float(row[j])) - before) / root[j][j])
            assert divided == pytest.approx([float(value) for value in exact], rel=4e-16)
