"""Ranges and null spaces against least squares; room that tight rows leave, by hand and against linear programmes."""

import numpy as np
import pytest
import scipy.optimize
from tolerances import ROUNDING

from prioritized_ik.solvers.subspaces import (
    about_largest,
    are_independent,
    clear_range,
    directions_left,
    divided,
    least_squares,
    nonnegative_least_squares,
    null_space,
    pivoted_qr,
    pseudoinverse,
    range_of,
    singular_values,
)
from prioritized_ik.tolerances import DEPENDENT

NARROW = 1e-9  # far above rounding, far below any wedge of small whole numbers
SETTLED = 1e-9  # what a row may move by and count as settled
STRICT = 1e-6  # of a unit box: rows of small whole numbers that can be left at all can be left by far more


def assert_orthonormal(basis: np.ndarray) -> None:
    assert np.abs(basis.T @ basis - np.eye(basis.shape[1])).max(initial=0.0) <= ROUNDING


def unit(rows: object) -> np.ndarray:
    matrix = np.reshape(np.array(rows, dtype=float), (-1, 3))
    return matrix / np.linalg.norm(matrix, axis=1)[:, None]


def left(rows: object, narrow: float = NARROW) -> np.ndarray:
    """The projector onto what tight `rows`, of any length, leave of three directions."""
    free = directions_left(np.eye(3), unit(rows), narrow, SETTLED)
    assert free.T @ free == pytest.approx(np.eye(free.shape[1]), abs=ROUNDING)
    return free @ free.T


X, Y, Z = np.eye(3)
ALL = np.eye(3)

CONES = {
    "no row": ([], ALL),
    "one row": ([X], ALL),
    "the same row twice": ([X, X], ALL),
    "a corner": ([X, Y, Z], ALL),
    "a wedge": ([X, [-1.0, 0.1, 0.0]], ALL),
    "two antiparallel rows": ([X, -X], np.diag([0.0, 1.0, 1.0])),
    "of unequal lengths": ([1e3 * X, -1e-2 * X], np.diag([0.0, 1.0, 1.0])),
    "one of them twice": ([X, X, -X], np.diag([0.0, 1.0, 1.0])),
    "and one beside them": ([X, -X, Y], np.diag([0.0, 1.0, 1.0])),
    "three rows that cancel": ([X, [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0]], np.diag([0.0, 0.0, 1.0])),
    "two that cancel once two others have": ([X, -X, [0.5, 1.0, 0.0], [0.7, -1.0, 0.0]], np.diag([0.0, 0.0, 1.0])),
    "two pairs": ([X, -X, Z, -Z], np.diag([0.0, 1.0, 0.0])),
    "a pair across the axes": ([[1.0, 1.0, 0.0], [-1.0, -1.0, 0.0]], ALL - np.outer([1, 1, 0], [1, 1, 0]) / 2.0),
    "a corner that is a point": ([X, Y, Z, [-1.0, -1.0, -1.0]], np.zeros((3, 3))),
    "three pairs": ([X, -X, Y, -Y, Z, -Z], np.zeros((3, 3))),
}


@pytest.mark.parametrize(("rows", "projector"), CONES.values(), ids=CONES.keys())
def test_tight_rows_leave_the_directions_of_their_cone(rows, projector):
    assert left(rows) == pytest.approx(projector, abs=ROUNDING)


@pytest.mark.parametrize(("rows", "projector"), CONES.values(), ids=CONES.keys())
def test_the_order_of_rows_does_not_matter(rows, projector):
    for seed in range(5):
        order = np.random.default_rng(seed).permutation(len(rows))
        assert left([rows[i] for i in order]) == pytest.approx(projector, abs=ROUNDING)


def test_the_directions_left_are_orthonormal_and_move_no_cancelling_row():
    rows = unit([[1.0, 2.0, 0.5], [-1.0, -2.0, -0.5]])
    free = directions_left(np.eye(3), rows, NARROW, SETTLED)
    assert free.T @ free == pytest.approx(np.eye(2), abs=1e-15)
    assert np.abs(rows @ free).max() <= 1e-15


def test_where_nothing_cancels_the_free_directions_are_handed_back_as_they_are():
    free = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 2)))[0]
    assert directions_left(free, unit([X, Y]), NARROW, SETTLED) is free
    assert directions_left(free, np.zeros((0, 3)), NARROW, SETTLED) is free
    nothing = np.zeros((3, 0))
    assert directions_left(nothing, unit([X, -X]), NARROW, SETTLED) is nothing


def test_only_what_is_free_counts():
    # Apart in space, opposite within the plane that is left.
    rows = unit([[1.0, 0.0, 3.0], [-1.0, 0.0, 5.0]])
    assert directions_left(np.eye(3), rows, NARROW, SETTLED).shape == (3, 3)
    within = directions_left(np.eye(3)[:, :2], rows, NARROW, SETTLED)
    assert np.abs(within) == pytest.approx(np.array([[0.0], [1.0], [0.0]]), abs=ROUNDING)


@pytest.mark.parametrize("rest", [0.1 * SETTLED, 10.0 * SETTLED])
def test_a_row_that_hardly_moves_along_what_is_free_is_no_row(rest):
    # Two rows that the directions above have settled; what is left of them is opposite.
    rows = unit([[1.0, rest, 0.0], [1.0, -rest, 0.0]])
    found = directions_left(np.eye(3)[:, 1:], rows, NARROW, SETTLED)
    assert found.shape[1] == (2 if rest < SETTLED else 1)


@pytest.mark.parametrize("angle", [1e-3, 1e-6])
def test_a_wedge_leaves_room_exactly_if_it_is_wider_than_what_counts_as_narrow(angle):
    rows = [X, [-np.cos(angle), np.sin(angle), 0.0]]
    assert np.trace(left(rows, 0.1 * angle)) == pytest.approx(3.0)
    # Both rows are held then: what is left moves neither.
    assert left(rows, 10.0 * angle) == pytest.approx(np.diag([0.0, 1.0, 1.0]), abs=10.0 * angle)


def stay_tight(rows: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Which of the `rows` no step along `free` that exceeds none of them can leave, by one linear programme a row."""
    inner = rows @ free
    kept = []
    for row in inner:
        found = scipy.optimize.linprog(row, inner, np.zeros(len(inner)), bounds=(-1.0, 1.0), method="highs")
        assert found.status == 0
        kept.append(found.fun > -STRICT)
    return np.array(kept, dtype=bool)


def random_cone(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows with entries of -1, 0 and 1 before their lengths are made one, and free directions."""
    rng = np.random.default_rng(seed)
    m, t = int(rng.integers(2, 7)), int(rng.integers(1, 10))
    rows = rng.integers(-1, 2, size=(t, m)).astype(float)
    if seed % 3 == 0 and t > 1:  # a positive combination that vanishes
        rows[-1] = -rng.integers(1, 4, size=t - 1) @ rows[:-1]
    rows = rows[rows.any(axis=1)]
    free = np.linalg.qr(rng.normal(size=(m, int(rng.integers(1, m + 1)))))[0] if seed % 2 else np.eye(m)
    return rows / np.linalg.norm(rows, axis=1)[:, None], free


@pytest.mark.parametrize("seed", range(60))
def test_the_directions_left_are_those_that_move_no_row_which_must_stay_tight(seed):
    rows, free = random_cone(seed)
    found = directions_left(free, rows, NARROW, SETTLED)
    held = rows[stay_tight(rows, free)] @ free
    _, s, vt = np.linalg.svd(held, full_matrices=True)
    wanted = free @ vt[np.count_nonzero(s > STRICT) :].T
    assert found @ found.T == pytest.approx(wanted @ wanted.T, abs=ROUNDING)


def test_of_the_random_cones_some_hold_no_row_some_a_few_and_some_all():
    counts = set()
    for seed in range(60):
        held = stay_tight(*random_cone(seed))
        counts.add("all" if held.all() else "a few" if held.any() else "none")
    assert counts == {"all", "a few", "none"}


def test_rows_that_vanish_in_a_combination_with_one_negative_factor_leave_every_direction():
    # Sabotage of the oracle's own claim: x + y, -x, and y with -(x + y) - (-x) + y = 0 need not stay tight.
    rows = unit([[1.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    assert not stay_tight(rows, np.eye(3)).any()
    assert directions_left(np.eye(3), rows, NARROW, SETTLED).shape == (3, 3)
    assert stay_tight(unit([X, -X, Y]), np.eye(3)).tolist() == [True, True, False]


# Descents.


@pytest.mark.parametrize("seed", range(10))
def test_the_nearest_non_negative_combination_meets_its_conditions(seed):
    rng = np.random.default_rng(seed)
    matrix, target = rng.normal(size=(6, 4)), rng.normal(size=6)
    x, distance = nonnegative_least_squares(matrix, target)
    slope = matrix.T @ (matrix @ x - target)
    assert x.min() >= 0.0
    assert slope.min() >= -ROUNDING
    assert np.abs(slope[x > 0.0]).max(initial=0.0) <= ROUNDING
    assert distance == pytest.approx(np.linalg.norm(matrix @ x - target), rel=ROUNDING)


def test_a_combination_that_is_not_found_is_none_at_all_and_infinitely_far(monkeypatch):
    def gives_up(matrix, target):
        raise RuntimeError("Maximum number of iterations reached.")

    monkeypatch.setattr("scipy.optimize.nnls", gives_up)
    x, distance = nonnegative_least_squares(np.ones((3, 2)), np.ones(3))
    assert (x.tolist(), distance) == ([0.0, 0.0], np.inf)
    # So that rows of which it is not known whether they leave room are no equalities.
    assert directions_left(np.eye(3), unit([X, -X]), NARROW, SETTLED).shape == (3, 3)


def with_singular_values(values: list[float], shape: tuple[int, int], seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    left, right = (np.linalg.qr(rng.normal(size=(n, n)))[0] for n in shape)
    return left[:, : len(values)] * values @ right[:, : len(values)].T


SHAPES = [(3, 7), (7, 3), (5, 5)]


@pytest.mark.parametrize("shape", SHAPES)
def test_a_range_is_clear_where_a_pivoted_qr_leaves_zeros_and_all_else_is_far_from_the_cut(shape):
    for values in ([2.0, 1.0, 1e-2], [1.0, 0.1]):
        rows = with_singular_values(values, shape)
        basis, p, weakest = clear_range(rows, 1e-4)
        assert p == len(values)
        assert_orthonormal(basis)
        assert np.abs(rows @ basis[:, p:]).max(initial=0.0) <= ROUNDING
        assert np.linalg.svd(rows @ basis[:, :p])[1][p - 1] == pytest.approx(values[-1], rel=ROUNDING)
        assert 0.3 * values[-1] <= weakest <= 1.1 * values[-1]
    for values in ([1.0, 1e-5], [1.0, 1e-4], [1.0, 1e-13]):
        assert clear_range(with_singular_values(values, shape), 1e-4) is None
    basis, p, weakest = clear_range(np.zeros(shape), 1e-4)
    assert (p, weakest) == (0, np.inf)
    assert_orthonormal(basis)


@pytest.mark.parametrize("shape", SHAPES)
def test_the_largest_singular_value_is_estimated_to_a_few_hundredths_whatever_its_size(shape):
    for seed in range(20):
        for size in (1e-90, 1.0, 1e90):
            matrix = size * np.random.default_rng(seed).normal(size=shape)
            largest = np.linalg.svd(matrix)[1][0]
            assert 0.9 * largest <= about_largest(matrix) <= largest * (1.0 + ROUNDING)
    assert about_largest(np.zeros(shape)) == 1.0


def test_rows_are_independent_where_every_combination_is_clearly_longer_than_the_least():
    assert are_independent(np.zeros((0, 4)), 1e-9)
    assert are_independent(with_singular_values([1.0, 1e-3], (2, 4)), 1e-4)
    assert not are_independent(with_singular_values([1.0, 1e-3], (2, 4)), 1e-3)
    assert not are_independent(with_singular_values([1.0, 1e-3], (3, 4)), 1e-9)
    assert not are_independent(with_singular_values([1.0, 1.0], (3, 2)), 1e-9)
    assert not are_independent(np.zeros((1, 4)), 1e-9)


@pytest.mark.parametrize("shape", SHAPES)
def test_least_squares_are_unique_or_none_and_of_some_columns_as_near(shape):
    k, rng = min(shape), np.random.default_rng(0)
    target = rng.normal(size=shape[0])
    for values in (np.geomspace(1.0, 1e-3, k), np.geomspace(1.0, 1e-3, k - 1)):
        columns = with_singular_values(list(values), shape)
        nearest = np.linalg.lstsq(columns, target)[0]
        unique, some = least_squares(columns, target), least_squares(columns, target, some=True)
        if len(values) == shape[1]:
            assert unique == pytest.approx(nearest, rel=1e-11)
        else:
            assert unique is None
        assert np.count_nonzero(some) == len(values)
        assert columns @ some == pytest.approx(columns @ nearest, abs=1e-11)


@pytest.mark.parametrize("shape", [*SHAPES, (0, 4), (4, 0)])
def test_a_pseudoinverse_and_singular_values_are_those_of_numpy(shape):
    for values in ([1.0, 1e-2, 1e-4], [1.0, 1e-2], [1.0, 1e-13]):
        rows = with_singular_values(values[: min(shape)], shape)
        expected = np.linalg.pinv(rows, rcond=DEPENDENT)
        assert pseudoinverse(rows) == pytest.approx(expected, rel=1e-9, abs=1e-9)
        for full in (False, True) if rows.size else ():
            u, s, vt = singular_values(rows, full=full)
            assert s == pytest.approx(np.linalg.svd(rows)[1], abs=ROUNDING)
            assert (u[:, : len(s)] * s) @ vt[: len(s)] == pytest.approx(rows, abs=ROUNDING)
            assert u.shape[1] == (shape[0] if full else len(s))


# Coordinates within some directions.


def weighted_change(directions: np.ndarray, root: np.ndarray, dtheta: np.ndarray) -> np.ndarray:
    return root @ (directions.T @ dtheta)


@pytest.mark.parametrize("seed", range(10))
def test_in_whitened_coordinates_least_squares_is_a_distance(seed):
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(7, 4))
    directions[:, 3] = directions[:, 0] + 0.5 * directions[:, 1]  # one that is no news
    directions /= np.linalg.norm(directions, axis=0)
    root, free = np.triu(rng.normal(size=(4, 4))) + 3.0 * np.eye(4), np.linalg.qr(rng.normal(size=(7, 5)))[0]
    found = range_of(directions, root, free)
    assert found.felt.shape == (7, 3)
    assert_orthonormal(found.q)
    assert_orthonormal(found.unfelt)
    assert np.abs(directions.T @ found.unfelt).max() <= ROUNDING
    for basis in (found.felt, found.unfelt):  # of what is free
        assert np.linalg.norm(basis - free @ (free.T @ basis)) <= ROUNDING * np.linalg.norm(basis)
    # What the rows see of y is q y: so ½‖root directionsᵀ felt y - e‖² is ½‖y - qᵀe‖² and a constant.
    assert weighted_change(directions, root, found.felt) == pytest.approx(found.q, abs=ROUNDING)
    lacking = rng.normal(size=4)
    best = np.linalg.lstsq(weighted_change(directions, root, found.felt), lacking, rcond=None)[0]
    assert found.project(lacking) == pytest.approx(best, abs=ROUNDING)


def test_rows_that_feel_nothing_of_what_is_free_have_no_coordinates():
    free = np.eye(3)[:, 1:]
    for directions in (np.zeros((3, 0)), np.eye(3)[:, :1]):
        found = range_of(directions, np.eye(directions.shape[1]), free)
        assert found.felt.shape == (3, 0)
        assert found.unfelt @ found.unfelt.T == pytest.approx(free @ free.T, abs=ROUNDING)
        assert found.project(np.ones(directions.shape[1])).shape == (0,)
    nothing = range_of(np.eye(3), np.eye(3), np.zeros((3, 0)))
    assert (nothing.felt.shape, nothing.unfelt.shape) == ((3, 0), (3, 0))


def test_directions_that_differ_by_less_than_the_angle_given_count_as_one():
    for angle, rank in ((10.0 * DEPENDENT, 2), (0.1 * DEPENDENT, 1)):
        directions = np.array([[1.0, 1.0], [0.0, angle]])
        assert range_of(directions, np.eye(2), np.eye(2)).felt.shape[1] == rank
        assert range_of(directions, np.eye(2), np.eye(2), dependent=1e-6).felt.shape[1] == 1


@pytest.mark.parametrize("seed", range(10))
def test_the_null_space_of_rows_within_some_directions_is_all_that_they_do_not_feel(seed):
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(4, 2)) @ rng.normal(size=(2, 7))
    free = np.linalg.qr(rng.normal(size=(7, 5)))[0]
    found = null_space(rows / np.linalg.norm(rows, axis=1)[:, None], free)
    assert found.shape == (7, 3)
    assert_orthonormal(found)
    assert np.abs(rows @ found).max() <= ROUNDING * np.abs(rows).max()
    assert free @ (free.T @ found) == pytest.approx(found, abs=ROUNDING)


def test_without_rows_or_directions_the_null_space_is_all_that_is_free():
    free, nothing = np.eye(3)[:, 1:], np.zeros((3, 0))
    assert null_space(np.zeros((0, 3)), free) is free
    assert null_space(np.eye(3), nothing) is nothing


def test_rows_that_feel_less_than_what_counts_do_not_shrink_the_null_space():
    for part, left in ((0.1 * DEPENDENT, 2), (10.0 * DEPENDENT, 1)):
        assert null_space(np.array([[1.0, part, 0.0]]), np.eye(3)[:, 1:]).shape[1] == left


def test_columns_divided_by_a_triangle_are_those_times_its_inverse():
    rng = np.random.default_rng(0)
    columns, triangle = rng.normal(size=(5, 3)), np.triu(rng.normal(size=(3, 3))) + 3.0 * np.eye(3)
    assert divided(columns, triangle) == pytest.approx(columns @ np.linalg.inv(triangle), abs=ROUNDING)
    assert divided(np.zeros((5, 0)), np.zeros((0, 0))).shape == (5, 0)


@pytest.mark.parametrize("shape", [(5, 3), (3, 3), (4, 1), (4, 0), (0, 0)])
def test_a_pivoted_qr_gives_the_matrix_with_its_columns_in_order(shape):
    matrix = np.random.default_rng(1).normal(size=shape)
    q, r, order = pivoted_qr(matrix)
    assert q.shape == shape
    assert_orthonormal(q)
    assert np.array_equal(r, np.triu(r))
    assert sorted(order) == list(range(shape[1]))
    assert q @ r == pytest.approx(matrix[:, order], abs=ROUNDING)
    assert (np.diff(np.abs(np.diag(r))) <= ROUNDING).all()
