"""Which hard rows contradict each other, and by how much: by hand, by scale, and against linear programs of its own."""

from itertools import combinations

import numpy as np
import pytest
import scipy.optimize
from hierarchies import random_hierarchy

from prioritized_ik.errors import PrioritizedIkError
from prioritized_ik.problem import Bounds, Equalities, IKProblem, Level, Rows
from prioritized_ik.solvers import conflict as module
from prioritized_ik.solvers.conflict import Conflict, find_conflict
from prioritized_ik.solvers.witness import witness_step

EXCESS = 1e-6  # relative: HiGHS keeps rows to within 1e-7 of a unit of which the excess is a tenth at least
SEEDS = range(25)


def problem(m: int, bounds: Bounds | None = None, rows: Rows | None = None, equal: Equalities | None = None) -> IKProblem:
    return IKProblem([Level(np.eye(m), np.zeros(m))], bounds, rows, equalities=equal)


def found(given: IKProblem) -> Conflict:
    conflict = find_conflict(given)
    assert conflict is not None
    return conflict


# No conflict.


def test_rows_that_standing_still_keeps_are_in_no_conflict_and_need_no_linear_program(monkeypatch):
    monkeypatch.setattr(module, "_linear_program", None)
    assert find_conflict(problem(2, Bounds([-1.0, -1.0], [0.0, 1.0]), Rows([[1.0, 1.0]], [0.0]))) is None


def test_a_problem_without_hard_rows_has_no_conflict():
    assert find_conflict(problem(3)) is None


def test_rows_that_only_a_step_keeps_are_in_no_conflict():
    assert find_conflict(problem(2, Bounds([0.5, -1.0], [1.0, 1.0]), Rows([[1.0, 1.0]], [-0.4]))) is None


def test_rows_that_leave_one_step_only_are_in_no_conflict():
    rows = Rows([[1.0, 1.0], [-1.0, 0.0], [0.0, -1.0]], [0.3, -0.1, -0.2])
    assert find_conflict(problem(2, rows=rows)) is None


def test_equalities_that_say_the_same_in_other_lengths_are_in_no_conflict():
    equal = Equalities([[1.0, 2.0], [3.0, 6.0], [-0.1, -0.2]], [0.1, 0.3, -0.01])
    assert find_conflict(problem(2, equal=equal)) is None


@pytest.mark.parametrize("seed", range(40))
def test_hierarchies_with_an_optimum_have_no_conflict(seed):
    assert find_conflict(random_hierarchy(seed).problem) is None


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e3])
def test_a_contradiction_below_a_billionth_of_the_sides_is_rounding(scale):
    for excess, contradicts in ((0.9e-9, False), (1.1e-9, True)):
        sides = scale * np.array([0.5, 0.5 + excess])  # half way, each is off by half of it
        conflict = find_conflict(problem(1, equal=Equalities([[1.0], [1.0]], sides)))
        assert (conflict is not None) == contradicts


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e3])
def test_rows_that_say_the_same_to_eight_digits_and_differ_in_their_sides_are_named(scale):
    row, other = [0.1234567, -0.7654321, 0.3], [-0.33558709, 2.08065026, -0.81548454]  # times -2.7182818, rounded
    given = problem(
        3,
        Bounds(np.full(3, -scale), np.full(3, scale)),
        Rows([row], [-0.01 * scale - 3e-8 * scale], ["limit"]),
        Equalities([other], [0.027182818 * scale], ["hold"]),
    )
    conflict = find_conflict(given)
    # Along what the two differ in, bounds of a hundred times the sides leave no way out.
    assert conflict is None or {"limit", "hold"} <= set(conflict.names)


# By hand.


def test_a_row_against_a_bound():
    conflict = found(problem(1, Bounds([-1.0], [0.1]), Rows([[-1.0]], [-0.3], ["get out"])))
    assert conflict.names == ("joint 1 upper", "get out")
    assert conflict.excess == pytest.approx(0.1, rel=EXCESS)


def test_an_equality_against_another():
    conflict = found(problem(2, equal=Equalities([[1.0, 0.0], [1.0, 0.0]], [0.1, 0.2], ["hold", "move"])))
    assert conflict.names == ("hold", "move")
    assert conflict.excess == pytest.approx(0.05, rel=EXCESS)


@pytest.mark.parametrize(("target", "side"), [(0.4, "upper"), (-0.4, "lower")])
def test_an_equality_against_a_bound(target, side):
    given = problem(
        2, Bounds([-0.1, -1.0], [0.1, 1.0], ["hip", "knee"]), equal=Equalities([[1.0, 0.0]], [target], ["hold"])
    )
    conflict = found(given)
    assert conflict.names == (f"hip {side}", "hold")
    assert conflict.excess == pytest.approx(0.15, rel=EXCESS)


TRIANGLE = Rows([[1.0, 0.0], [0.0, 1.0], [-1.0, -1.0]], [0.0, 0.0, -1.0], ["left", "below", "above the diagonal"])


def test_three_rows_of_which_any_two_can_be_kept():
    """x <= 0, y <= 0 and x + y >= 1: at x = y = t the first two are broken by t, the third by (1 - 2 t) / √2."""
    conflict = found(problem(2, rows=TRIANGLE))
    assert conflict.names == TRIANGLE.names
    assert conflict.excess == pytest.approx(1.0 / (2.0 + np.sqrt(2.0)), rel=EXCESS)
    for pair in combinations(range(3), 2):
        assert find_conflict(problem(2, rows=Rows(TRIANGLE.matrix[[*pair]], TRIANGLE.upper[[*pair]]))) is None


def test_equalities_of_which_any_two_can_be_kept():
    conflict = found(problem(2, equal=Equalities(TRIANGLE.matrix, TRIANGLE.upper, TRIANGLE.names)))
    assert conflict.names == TRIANGLE.names
    assert conflict.excess == pytest.approx(1.0 / (2.0 + np.sqrt(2.0)), rel=EXCESS)


def test_innocent_rows_are_not_named():
    rng = np.random.default_rng(7)
    matrix = np.vstack([rng.normal(size=(20, 2)), TRIANGLE.matrix, rng.normal(size=(20, 2))])
    upper = np.concatenate([rng.uniform(3.0, 9.0, 20), TRIANGLE.upper, rng.uniform(3.0, 9.0, 20)])
    conflict = found(problem(2, Bounds([-9.0, -9.0], [9.0, 9.0]), Rows(matrix, upper), Equalities([[1.0, -1.0]], [0.0])))
    assert conflict.names == ("row 21", "row 22", "row 23")


def test_a_copy_of_a_row_in_conflict_is_not_named_beside_it():
    rows = Rows([[1.0], [2.0], [-1.0]], [0.1, 0.2, -0.3])
    conflict = found(problem(1, rows=rows))
    assert len(conflict.names) == 2
    assert "row 3" in conflict.names


def test_of_two_conflicts_the_worse_is_named():
    rows = Rows([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]], [0.0, -0.1, 0.0, -0.7])
    conflict = found(problem(2, rows=rows))
    assert conflict.names == ("row 3", "row 4")
    assert conflict.excess == pytest.approx(0.35, rel=EXCESS)


def test_the_excess_is_a_joint_distance_whatever_the_length_of_the_rows():
    lengths = np.array([1e-3, 1.0, 1e4])
    rows = Rows(lengths[:, None] * TRIANGLE.matrix, lengths * TRIANGLE.upper, TRIANGLE.names)
    conflict = found(problem(2, rows=rows))
    assert conflict.names == TRIANGLE.names
    assert conflict.excess == pytest.approx(1.0 / (2.0 + np.sqrt(2.0)), rel=EXCESS)


def test_a_row_of_zeros_is_in_no_conflict():
    conflict = found(problem(1, rows=Rows([[0.0], [1.0], [-1.0]], [0.0, 0.0, -1.0])))
    assert conflict.names == ("row 2", "row 3")


# Scales.


@pytest.mark.parametrize("scale", [1e-6, 1e-4, 1e3])
def test_tiny_and_huge_steps_conflict_alike(scale):
    conflict = found(problem(2, rows=Rows(TRIANGLE.matrix, scale * TRIANGLE.upper, TRIANGLE.names)))
    assert conflict.names == TRIANGLE.names
    assert conflict.excess == pytest.approx(scale / (2.0 + np.sqrt(2.0)), rel=EXCESS)


@pytest.mark.parametrize("excess", [1e-3, 1e-5, 1e-7, 1e-8])
def test_a_small_contradiction_between_large_sides_is_found_among_far_rows(excess):
    """HiGHS alone keeps rows to within 1e-7 only."""
    rows = Rows([[1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [0.0, 1.0, 1.0]], [1.0, -1.0 - 2.0 * np.sqrt(2.0) * excess, 500.0])
    conflict = found(problem(3, Bounds(-np.full(3, 1e3), np.full(3, 1e3)), rows))
    assert conflict.names == ("row 1", "row 2")
    assert conflict.excess == pytest.approx(excess, rel=1e-5)  # sides of 1 hold 1e-16, eight digits below 1e-8


# Against linear programs of the test's own.


def elastic(given: IKProblem, names: tuple[str, ...]) -> float:
    """The least violation of the named rows, each of unit length, in units of the largest side."""
    rows, equal = given.inequalities, given.equalities
    chosen = [(rows.matrix[i], rows.upper[i]) for i, name in enumerate(rows.names) if name in names]
    for i, name in enumerate(equal.names):
        if name in names:
            chosen += [(equal.matrix[i], equal.target[i]), (-equal.matrix[i], -equal.target[i])]
    matrix = np.array([row / np.linalg.norm(row) for row, _ in chosen])
    sides = np.array([side / np.linalg.norm(row) for row, side in chosen])
    largest = np.abs(sides).max()
    result = scipy.optimize.linprog(
        np.append(np.zeros(given.joint_count), 1.0),
        np.hstack([matrix, -np.ones((len(matrix), 1))]),
        sides / largest,
        bounds=[(None, None)] * given.joint_count + [(0.0, None)],
        method="highs-ipm",
    )
    assert result.status == 0
    return float(largest * result.x[-1])


def planted(seed: int) -> tuple[IKProblem, float]:
    """Rows g_i with Σ λ_i g_i = 0 and sides that a step z breaks all by one amount, among rows that z keeps."""
    rng = np.random.default_rng(seed)
    m, scale = int(rng.integers(2, 50)), 10.0 ** rng.integers(-4, 4)
    z = scale * rng.normal(size=m)
    count = int(rng.integers(1, min(m, 7) + 1))
    core = rng.normal(size=(count, m))
    core = np.vstack([core, -rng.uniform(0.2, 1.0, count) @ core])
    core /= np.linalg.norm(core, axis=1)[:, None]
    excess = scale * 10.0 ** rng.uniform(-3.0, 0.0)
    lengths, equal = 10.0 ** rng.uniform(-2.0, 2.0, len(core)), rng.random(len(core)) < 0.3
    others = rng.normal(size=(int(rng.integers(0, 40)), m))
    matrix = np.vstack([others, (lengths[:, None] * core)[~equal]])
    upper = np.append(others @ z + scale * rng.uniform(0.0, 1.0, len(others)), (lengths * (core @ z - excess))[~equal])
    order = rng.permutation(len(matrix))
    given = problem(
        m,
        Bounds(z - 3.0 * scale, z + 3.0 * scale),
        Rows(matrix[order], upper[order]) if len(matrix) else None,
        Equalities((lengths[:, None] * core)[equal], (lengths * (core @ z - excess))[equal]) if equal.any() else None,
    )
    return given, excess


@pytest.mark.parametrize("seed", SEEDS)
def test_a_conflict_that_was_planted_is_found_and_cannot_be_made_smaller(seed):
    given, excess = planted(seed)
    conflict = found(given)
    assert conflict.excess >= excess * (1.0 - EXCESS)
    assert elastic(given, conflict.names) == pytest.approx(conflict.excess, rel=1e-4)  # one program alone is that exact
    for name in conflict.names:
        rest = tuple(other for other in conflict.names if other != name)
        assert elastic(given, rest) <= 1e-3 * conflict.excess


@pytest.mark.parametrize("seed", SEEDS)
def test_softening_what_is_in_conflict_until_nothing_is_leaves_a_problem_with_a_step(seed):
    given, _ = planted(seed)
    names: list[str] = []
    while (conflict := find_conflict(given.softened(names))) is not None:
        assert not set(conflict.names) & set(names)
        names += conflict.names
    softened = given.softened(names)
    assert softened.relative_violation(witness_step(softened)) <= 1e-6  # what the library accepts of a step


def test_many_random_rows_conflict_irreducibly():
    rng = np.random.default_rng(1)
    given = problem(10, rows=Rows(rng.normal(size=(60, 10)), rng.normal(size=60) - 1.0))
    conflict = found(given)
    assert 2 <= len(conflict.names) <= 11  # at most one more than joints (Helly)
    assert all(elastic(given, tuple(set(conflict.names) - {name})) <= 1e-9 for name in conflict.names)


# Words and failures.


def test_the_text_names_the_rows_the_amount_and_what_to_do():
    conflict = Conflict(("joint 1 upper", "get out"), 0.0512345)
    assert str(conflict) == conflict.text
    assert "'joint 1 upper', 'get out'" in conflict.text
    assert "0.0512 rad" in conflict.text
    assert "problem.softened(['joint 1 upper', 'get out'])" in conflict.text


def test_what_the_text_advises_resolves_the_conflict():
    given = problem(2, rows=TRIANGLE)
    assert find_conflict(given.softened(found(given).names)) is None


def test_a_multiplier_too_small_to_tell_does_not_hide_the_conflict(monkeypatch):
    """Then all rows are suspects, and what is left of them need not be the worst conflict; its excess is its own."""
    monkeypatch.setattr(module, "PUSHING", 2.0)
    rows = Rows([[1.0, 0.0], [-1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, -1.0]], [0.0, -0.7, 5.0, 0.0, -0.1])
    conflict = found(problem(2, rows=rows))
    assert conflict.names == ("row 4", "row 5")
    assert conflict.excess == pytest.approx(0.05, rel=EXCESS)


def test_a_linear_program_that_highs_does_not_solve_is_an_error(monkeypatch):
    def fails(*args, **kwargs):
        return scipy.optimize.OptimizeResult(status=4, message="numerical difficulties")

    monkeypatch.setattr("scipy.optimize.linprog", fails)
    with pytest.raises(PrioritizedIkError, match="contradict each other: numerical difficulties"):
        find_conflict(problem(2, rows=TRIANGLE))
