"""In which directions tight rows leave room: Stiemke's cases by hand, and against linear programmes."""

import numpy as np
import pytest
import scipy.optimize
from tolerances import ROUNDING

from prioritized_ik.solvers import subspaces
from prioritized_ik.solvers.subspaces import directions_left, nonnegative_least_squares, null_space

NARROW = 1e-9  # far above rounding, far below any wedge of small whole numbers
SETTLED = 1e-9  # what a row may move by and count as settled
STRICT = 1e-6  # of a unit box: rows of small whole numbers that can be left at all can be left by far more


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

    monkeypatch.setattr(subspaces.scipy.optimize, "nnls", gives_up)
    x, distance = nonnegative_least_squares(np.ones((3, 2)), np.ones(3))
    assert (x.tolist(), distance) == ([0.0, 0.0], np.inf)
    # So that rows of which it is not known whether they leave room are no equalities.
    assert directions_left(np.eye(3), unit([X, -X]), NARROW, SETTLED).shape == (3, 3)
