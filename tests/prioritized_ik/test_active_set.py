"""From any answer near the optimum, and most that are not, to the same bits; and no claim where that fails."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from hierarchies import EVERYTHING, KnownHierarchy, random_hierarchy, solution_on
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from oracles import norm_error
from tolerances import ORACLE, ROUNDING
from trees import ball_chain, random_problem
from winding_fixtures import AS_RECORDED, constrained_steps, free_steps

import prioritized_ik as pik
from prioritized_ik.problem import Bounds, Equalities, IKProblem, Level, Rows
from prioritized_ik.solvers import active_set
from prioritized_ik.solvers import stagewise as from_nothing
from prioritized_ik.solvers.active_set import Active, Solution, face_solution, guessed, solve
from prioritized_ik.solvers.blocks import HARD
from prioritized_ik.solvers.certificate import Proof, certify
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.solvers.stagewise import stagewise
from prioritized_ik.tolerances import CERTIFIED, GUESS, LEAST_SETS, ROWS_PER_SET, UNDECIDED
from prioritized_ik.winding.episode import wind
from prioritized_ik.winding.settings import WindingSettings

CUT = 1e-7  # the planted problems' rank tolerance

#: Relative, of planted optima: rounding, times what weights over six decades and nearly dependent rows make of it. The
#: worst of 150 measures 1e-9.
BLURRED = 1e-8

#: Without the features that make a problem so ill-conditioned that rounding itself blurs its optimum.
CALM = EVERYTHING - {"weights", "degenerate"}
SEEDS = range(30)
NEARLY_ALL = (
    0.95  # of the planted optima with every feature, measured 29 of 30: weights over six decades leave some undecided
)
MOST = 0.9  # of the wrong guesses, measured 28 of 30: the others go on from a guess made of nothing


def hierarchy_of(known: KnownHierarchy) -> Hierarchy:
    return Hierarchy(known.problem, CUT)


def from_answer(hierarchy: Hierarchy, answer: np.ndarray) -> Solution:
    """What a solver's answer leads to, from the rows that it seems to rest on."""
    return solve(hierarchy, guessed(hierarchy, answer), answer)


def holds(found: Solution) -> bool:
    """Whether the optimum is claimed; what is said of the step is that step's own proof."""
    return found.proof.certificate.holds


def bits(step: np.ndarray) -> bytes:
    return np.asarray(step, dtype=float).tobytes()


def active_at(hierarchy: Hierarchy, dtheta: np.ndarray) -> np.ndarray:
    return Proof(hierarchy, dtheta).ends_on


# By hand: 1/2 at the first joint's bound, and the second where it wants to be.

LEVEL = Level(np.eye(3), [1.0, 1.0, 0.3], name="reach")
BOXED = IKProblem(
    [LEVEL],
    Bounds([-1.0] * 3, [0.5, 2.0, 0.7], ["x", "y", "z"]),
    Rows([[0.0, 1.0, 1.0]], [1.6], ["idle"]),
)
OPTIMUM = np.array([0.5, 1.0, 0.3])

STARTS = {
    "the optimum": (OPTIMUM, 0),
    "a little off, within what counts as tight": ([0.5 - 1e-7, 1.0 + 1e-5, 0.3], 0),
    "a little over the bound": ([0.5 + 1e-5, 1.0, 0.3], 0),
    "one row too many": ([0.5, 1.0, 0.6], 1),
    "two rows too many": ([0.5, 0.9, 0.7], 2),
    "the wrong row instead": ([0.2, 1.0, 0.6], 2),
    "one row too few": ([0.3, 1.0, 0.3], 1),
    "all rows loose": ([0.1, 0.2, -0.3], 1),
    "standing still": ([0.0, 0.0, 0.0], 1),
    "the closed form, over the bound": ([1.0, 1.0, 0.3], 0),
    "far outside": ([50.0, -80.0, 20.0], None),
}


@pytest.mark.parametrize(("start", "iterations"), STARTS.values(), ids=STARTS.keys())
def test_a_start_leads_to_the_optimum_by_one_correction_a_wrong_row(start, iterations):
    hierarchy = Hierarchy(BOXED)
    found = from_answer(hierarchy, np.array(start))
    assert holds(found)
    assert found.u == pytest.approx(OPTIMUM, abs=ROUNDING)
    assert bits(found.u) == bits(from_answer(hierarchy, OPTIMUM).u)
    assert iterations is None or found.iterations == iterations


def test_the_method_leaves_the_callers_answer_alone():
    start = np.array([0.2, 1.0, 0.6])
    from_answer(Hierarchy(BOXED), start)
    assert start.tolist() == [0.2, 1.0, 0.6]


def test_the_proof_is_that_of_the_step_found():
    hierarchy = Hierarchy(BOXED)
    for start, _ in STARTS.values():
        found = from_answer(hierarchy, np.array(start))
        assert found.proof.certificate == Proof(hierarchy, found.u).certificate
        assert found.proof.certificate == certify(BOXED, found.u)


def test_a_row_that_a_lower_level_presses_on_is_found_too():
    levels = [Level([[1.0, 1.0, 0.0]], [1.0]), Level([[1.0, -1.0, 0.0]], [3.0]), Level([[0.0, 0.0, 1.0]], [2.0])]
    hierarchy = Hierarchy(IKProblem(levels, Bounds([-9.0, -0.5, -9.0], [9.0, 9.0, 0.4])))
    for start in ([1.5, -0.5, 0.4], [1.5, -0.5, 0.0], [0.5, 0.5, 0.4], [0.5, 0.5, 0.0], [0.0, 0.0, 0.0], [2.0, -1.0, 2.0]):
        found = from_answer(hierarchy, np.array(start))
        assert holds(found)
        assert found.u == pytest.approx([1.5, -0.5, 0.4], abs=ROUNDING)


def test_soft_rows_that_are_exceeded_are_told_from_those_that_are_kept():
    soft = Level([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], [0.2, 5.0, 9.0], [4.0, 1.0, 1.0], "soft", "at_most")
    problem = IKProblem([soft, Level([[0.0, 1.0]], [1.0])], rows=Rows([[-1.0, 0.0]], [-0.5]))
    for start in ([0.5, 1.0], [0.5, 6.0], [0.2, 5.0], [0.0, 0.0], [3.0, 3.0]):
        found = from_answer(Hierarchy(problem), np.array(start))
        assert holds(found)
        assert found.u == pytest.approx([0.5, 1.0], abs=ROUNDING)


# Planted optima.


def starts(known: KnownHierarchy) -> dict[str, np.ndarray]:
    """Answers with wrong guesses of the rows that the optimum rests on, none of which breaks a row by much."""
    hierarchy, x = hierarchy_of(known), known.dtheta
    rng = np.random.default_rng(known.seed)
    rows, size = hierarchy.rows, np.linalg.norm(x)
    noise = rng.normal(size=len(x)) / np.sqrt(len(x))
    found = {"rounding": x + 1e-12 * size * noise, "noise": x + 1e-8 * size * noise, "much noise": x + 1e-4 * size * noise}
    ends_on = active_at(hierarchy, x)
    slack = rows.slack(x)
    for name, chosen in (("one row too many", ~ends_on & (rows.level == HARD)), ("one row too few", ends_on)):
        numbers = np.flatnonzero(chosen & (rows.reach(np.arange(len(slack)), hierarchy.free) > 0.5))
        if len(numbers):
            i = numbers[np.argmin(np.abs(slack[numbers]))]
            gap = slack[i] if name == "one row too many" else -1e-3 * size
            along = hierarchy.free @ (hierarchy.free.T @ rows.matrix[i])
            found[name] = x + gap * along / (along @ along)
    return found


@pytest.mark.parametrize("seed", SEEDS)
def test_a_perturbed_answer_leads_to_the_same_bits_unless_rounding_leaves_the_optimum_undecided(seed):
    known = random_hierarchy(seed)
    hierarchy = hierarchy_of(known)
    wanted = from_answer(hierarchy, known.dtheta)
    assert wanted.iterations == 0
    certificate = wanted.proof.certificate
    assert certificate.is_optimal
    assert holds(wanted) or certificate.variation > UNDECIDED
    assert wanted.converged == holds(wanted)
    assert norm_error(wanted.u, known.dtheta) <= BLURRED
    for name in ("rounding", "noise", "much noise") if holds(wanted) else ():
        found = from_answer(hierarchy, starts(known)[name])
        assert holds(found), name
        assert bits(found.u) == bits(wanted.u), name


def test_rounding_leaves_next_to_no_planted_optimum_undecided():
    solutions = [from_answer(hierarchy_of(known), known.dtheta) for known in map(random_hierarchy, SEEDS)]
    assert sum(map(holds, solutions)) >= NEARLY_ALL * len(SEEDS)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_wrong_guess_leads_to_the_same_bits_or_to_no_claim(seed):
    known = random_hierarchy(seed, CALM, joints=(3, 25), levels=(1, 4))
    hierarchy = hierarchy_of(known)
    wanted = from_answer(hierarchy, known.dtheta).u
    assert norm_error(wanted, known.dtheta) <= ORACLE
    for name, start in starts(known).items():
        found = from_answer(hierarchy, start)
        assert found.converged == holds(found)
        assert bits(found.u) == bits(wanted if holds(found) else start), name


def test_wrong_guesses_take_corrections_and_right_ones_none():
    right, wrong = ("rounding", "noise"), ("one row too many", "one row too few")
    corrections, solved = dict.fromkeys((*right, *wrong), 0), dict.fromkeys((*right, *wrong), 0)
    for seed in SEEDS:
        known = random_hierarchy(seed, CALM, joints=(3, 25), levels=(1, 4))
        for name, start in starts(known).items():
            if name in corrections:
                found = from_answer(hierarchy_of(known), start)
                corrections[name] += found.iterations
                solved[name] += holds(found)
    assert {corrections[name] for name in right} == {0}
    assert {solved[name] for name in right} == {len(SEEDS)}
    assert min(corrections[name] for name in wrong) >= len(SEEDS) // 2
    # Of all there are: not every problem has a row of each kind.
    assert min(solved[name] for name in wrong) >= MOST * len(SEEDS)


def test_from_a_guess_made_of_nothing_every_problem_is_solved():
    unsolved = []
    for seed in SEEDS:
        known = random_hierarchy(seed, CALM, joints=(3, 25), levels=(1, 4))
        hierarchy = hierarchy_of(known)
        u, active = stagewise(hierarchy)
        found = solve(hierarchy, active, u)
        if not holds(found):
            unsolved.append(seed)
            continue
        assert bits(found.u) == bits(from_answer(hierarchy, known.dtheta).u)
    assert unsolved == []


def test_a_guess_from_nothing_ends_soon_where_rounding_makes_blands_rule_cycle(monkeypatch):
    rng = np.random.default_rng(771941)
    problem = random_problem(rng, ball_chain(rng, 12, bend=1e-10, kinks=2), bound=0.03, weights=2.0)
    upper, lower = problem.bounds.upper.copy(), problem.bounds.lower.copy()
    upper[::3], lower[1::3] = 0.0, 0.0
    hierarchy = Hierarchy(IKProblem(problem.levels, Bounds(lower, upper)))
    asked = Mock(wraps=from_nothing._minimum_norm)
    monkeypatch.setattr(from_nothing, "_minimum_norm", asked)
    assert stagewise(hierarchy) is None
    assert asked.call_count < 6 * problem.joint_count  # 72; without a look at where it has been, over 2000


@pytest.mark.parametrize("seed", SEEDS)
def test_whatever_the_start_the_method_ends_at_the_optimum_or_hands_it_back(seed):
    known = random_hierarchy(seed, joints=(2, 20), levels=(1, 4))
    hierarchy, size = hierarchy_of(known), np.linalg.norm(known.dtheta)
    wanted = from_answer(hierarchy, known.dtheta).u
    rng = np.random.default_rng(seed)
    for start in (hierarchy.closed_form, known.dtheta + size * rng.normal(size=len(known.dtheta))):
        found = from_answer(hierarchy, start)
        assert bits(found.u) == bits(wanted if holds(found) else start)


@pytest.mark.usefixtures("python_path")
def test_recorded_steps_are_found_again_to_the_same_bits_from_answers_off_by_a_millionth():
    for problem in (*free_steps(), *constrained_steps()):
        hierarchy = Hierarchy(problem, RANK_TOLERANCE)
        wanted = hierarchy.problem.to_metric(get_method("active-set").step(problem, AS_RECORDED).dtheta)
        noise = np.random.default_rng(0).normal(size=problem.joint_count)
        found = from_answer(hierarchy, wanted + GUESS * np.linalg.norm(wanted) * noise / np.linalg.norm(noise))
        assert holds(found)
        assert bits(found.u) == bits(wanted)


# What was done.


def sets_of(hierarchy: Hierarchy, guess: Active, found: Solution) -> list[frozenset[str]]:
    """The sets of rows visited, as the trace tells them."""
    names = hierarchy.rows.names
    visited = [frozenset(names[i] for i in np.flatnonzero(guess))]
    for what, changed in found.trace:
        assert changed, "a step that changes nothing"
        assert set(changed) <= set(names)
        if what == "add":
            assert not visited[-1] & set(changed)
            visited.append(visited[-1] | set(changed))
        elif what == "instead":  # of an addition that would have led back
            assert visited.pop() in visited
            visited.append(visited[-1] ^ set(changed))
        else:
            assert what == "drop"
            assert set(changed) <= visited[-1]
            visited.append(visited[-1] - set(changed))
    return visited


@settings(max_examples=50, derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.builds(random_hierarchy, st.integers(0, 2**32 - 1), joints=st.just((2, 20))), st.integers(0, 2**16))
def test_the_trace_names_the_rows_added_and_dropped_and_no_set_is_visited_twice(known, seed):
    hierarchy = hierarchy_of(known)
    rng = np.random.default_rng(seed)
    assert len(set(hierarchy.rows.names)) == len(hierarchy.rows.names)
    for share in (0.0, 0.2, 0.5):
        guess = rng.random(len(hierarchy.rows.upper)) < share
        found = solve(hierarchy, guess, hierarchy.start)
        visited = sets_of(hierarchy, guess, found)
        if not found.converged and len(set(visited)) < len(visited):
            visited.pop()  # it ends because it would return
        assert len(set(visited)) == len(visited)
        assert (
            found.iterations == len(found.trace) - sum(what == "instead" for what, _ in found.trace) or not found.converged
        )


def test_the_trace_tells_a_wrong_row_that_is_dropped_and_the_right_one_that_is_added():
    hierarchy = Hierarchy(BOXED)
    assert from_answer(hierarchy, np.array([0.2, 1.0, 0.6])).trace == (("add", ("x upper",)), ("drop", ("idle",)))
    assert from_answer(hierarchy, OPTIMUM).trace == ()


# Faces.


@pytest.mark.parametrize("seed", SEEDS)
def test_without_rows_a_face_is_everything_and_its_solution_the_closed_form(seed):
    hierarchy = hierarchy_of(random_hierarchy(seed, CALM - {"soft"}, joints=(2, 25)))
    found = face_solution(hierarchy, np.zeros(len(hierarchy.rows.upper), dtype=bool))
    assert bits(found) == bits(hierarchy.closed_form)


@pytest.mark.parametrize("seed", SEEDS)
def test_on_the_rows_that_the_optimum_ends_on_the_solution_is_the_optimum(seed):
    known = random_hierarchy(seed, CALM, joints=(2, 25))
    hierarchy = hierarchy_of(known)
    found = face_solution(hierarchy, active_at(hierarchy, known.dtheta))
    assert norm_error(found, known.dtheta) <= ORACLE
    assert norm_error(found, solution_on(known.problem, known.presses, known.dtheta)) <= ORACLE


@pytest.mark.parametrize("seed", SEEDS)
def test_the_rows_of_a_face_hold_on_it(seed):
    rng = np.random.default_rng(seed)
    level = Level(rng.normal(size=(3, 6)), rng.normal(size=3))
    hierarchy = Hierarchy(IKProblem([level], rows=Rows(rng.normal(size=(4, 6)), rng.normal(size=4))))
    active = np.array([True, False, True, False])
    found = face_solution(hierarchy, active)
    slack = hierarchy.rows.slack(found)
    assert np.abs(slack[active]).max() <= ROUNDING
    assert np.abs(slack[~active]).min() > 1e-3
    # Least squares on it: any step along it costs more.
    along = np.linalg.svd(hierarchy.rows.matrix[active])[2][2:]
    for direction in along:
        for sign in (1e-3, -1e-3):
            assert level.cost(found + sign * direction) >= level.cost(found) - ROUNDING


@pytest.mark.parametrize("far", [1.0, 1e4, 1e8])
def test_the_rows_of_a_face_hold_to_the_roundings_of_the_step_however_far_the_level_wants_to_go(far):
    rng = np.random.default_rng(7)
    corner = rng.normal(size=3)
    matrix = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    problem = IKProblem([Level(np.eye(3), far * np.ones(3))], rows=Rows(matrix, matrix @ corner))
    assert norm_error(face_solution(Hierarchy(problem), np.ones(3, dtype=bool)), corner) <= ROUNDING


ONE_AND_A_LITTLE = IKProblem(
    [Level([[1.0, 0.0]], [1.0]), Level([[0.0, 1.0]], [1000.0])], rows=Rows([[1.0, 5e-10]], [0.5], ["nearly x"])
)


def test_a_row_that_is_settled_but_for_rounding_holds_all_the_same():
    # Level 1 decides x; the row has a little of y too, which is cut from it and put back in.
    hierarchy = Hierarchy(ONE_AND_A_LITTLE, RANK_TOLERANCE)
    found = face_solution(hierarchy, np.array([True]))
    assert found == pytest.approx([0.5 - 5e-7, 1000.0], abs=ROUNDING)
    assert hierarchy.rows.slack(found) == pytest.approx([0.0], abs=ROUNDING)


def test_without_a_rank_tolerance_what_little_a_row_has_of_another_joint_makes_room():
    # x = 1 costs level 1 nothing if y makes up for it, however far; level 2 comes second.
    found = solve(Hierarchy(ONE_AND_A_LITTLE), np.array([True]), np.zeros(2))
    assert holds(found)
    assert found.u == pytest.approx([1.0, -1e9], rel=1e-9)


# No claim.


def test_rows_without_a_common_point_leave_the_answer_as_it_is():
    problem = IKProblem([Level([[1.0, 0.0]], [5.0])], rows=Rows([[1.0, 0.0], [-1.0, 0.0]], [-1.0, -1.0]))
    for start in ([0.0, 0.0], [-1.0, 0.0], [1.0, 0.0], [7.0, -3.0]):
        found = from_answer(Hierarchy(problem), np.array(start))
        assert bits(found.u) == bits(start)
        assert not holds(found)
        assert found.proof.certificate == certify(problem, start)
        assert found.proof.certificate.violation > CERTIFIED


def test_equalities_without_a_common_point_leave_the_answer_as_it_is():
    equalities = Equalities([[1.0, 0.0], [2.0, 0.0]], [1.0, 4.0])
    found = from_answer(Hierarchy(IKProblem([Level(np.eye(2), [1.0, 1.0])], equalities=equalities)), np.ones(2))
    assert bits(found.u) == bits(np.ones(2))
    assert not holds(found)


def test_a_search_that_runs_out_of_iterations_hands_the_start_back_with_its_figures(monkeypatch):
    monkeypatch.setattr(active_set, "ITERATIONS", 2)
    start = np.array([0.2, 1.0, 0.6])  # takes two corrections, and so three looks
    found = from_answer(Hierarchy(BOXED), start)
    assert bits(found.u) == bits(start)
    assert found.proof.certificate == certify(BOXED, start)
    assert not found.converged
    assert not holds(found)
    monkeypatch.setattr(active_set, "ITERATIONS", 3)
    assert holds(from_answer(Hierarchy(BOXED), start))


def test_a_start_that_is_the_optimum_is_proven_even_if_the_search_fails_but_is_not_its_own(monkeypatch):
    monkeypatch.setattr(active_set, "ITERATIONS", 0)
    found = from_answer(Hierarchy(BOXED), OPTIMUM)
    assert holds(found)
    assert not found.converged
    assert bits(found.u) == bits(OPTIMUM)
    assert found.iterations == 0


# Sabotage: whatever is computed, the certificate has the last word.


@pytest.mark.parametrize("size", [1e-6, 1e-3, 1.0])
def test_a_face_whose_solution_is_off_is_put_right_or_never_handed_out(size, monkeypatch):
    exact = active_set.face_solution
    monkeypatch.setattr(active_set, "face_solution", lambda *given: exact(*given) + size * np.array([0.0, 0.6, -0.8]))
    for start in (OPTIMUM, np.array([0.3, 1.0, 0.3]), np.zeros(3)):
        found = from_answer(Hierarchy(BOXED), start)
        if found.converged:
            assert found.u == pytest.approx(OPTIMUM, abs=ROUNDING)
        else:
            assert bits(found.u) == bits(start)
            assert holds(found) == (start is OPTIMUM)


@pytest.mark.parametrize("size", [1e-6, 1e-3, 1.0])
def test_a_face_whose_solution_is_off_is_not_handed_out_by_luck(size, monkeypatch):
    exact = active_set.face_solution
    monkeypatch.setattr(active_set, "face_solution", lambda *given: exact(*given) + size * np.array([0.0, 0.6, -0.8]))
    monkeypatch.setattr(active_set, "REFINEMENTS", 0)
    assert not any(from_answer(Hierarchy(BOXED), start).converged for start in (OPTIMUM, np.zeros(3)))


def test_a_row_that_is_never_dropped_is_never_certified(monkeypatch):
    monkeypatch.setattr(active_set, "_corrected", lambda proof, active: iter(()))
    found = from_answer(Hierarchy(BOXED), np.array([0.5, 1.0, 0.6]))
    assert not holds(found)
    assert bits(found.u) == bits([0.5, 1.0, 0.6])


def test_a_certificate_that_holds_for_anything_would_be_noticed(monkeypatch):
    # What the tests above rest on: with a lenient proof the search stops at the first face, which is wrong.
    class Lenient(Proof):
        @property
        def certificate(self):
            figures = super().certificate
            zeros = (0.0,) * len(figures.relative_gaps)
            return replace(figures, tolerance=0.9, relative_gaps=zeros, rounding=zeros, stationarity=zeros)

    monkeypatch.setattr(active_set, "Proof", Lenient)
    found = from_answer(Hierarchy(BOXED), np.array([0.5, 1.0, 0.6]))
    assert norm_error(found.u, OPTIMUM) > 1e-2
    assert not certify(BOXED, found.u).holds


def test_a_robot_pressed_against_a_wall_keeps_its_step_certified_once_it_rests():
    """Where the step is a billionth of what the levels ask for, rounding of what they ask for breaks no row."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        matrix, towards = rng.normal(size=(2, 3)), rng.normal(size=3)
        level = pik.Level(np.vstack([matrix, 0.05 * np.eye(3)]), [*(0.01 * matrix @ towards), 0.0, 0.0, 0.0])
        pressed = level.matrix.T @ level.target
        for side in (0.0, -1e-16, 1e-13, -1e-12):
            wall = pik.Rows([pressed, rng.normal(size=3)], [side, 0.02])
            step = pik.solve(pik.IKProblem([level], pik.Bounds([-0.02] * 3, [0.02] * 3), wall))
            assert step.certificate.holds, side
            assert pressed @ step.dtheta <= side + 1e-16


def far_off(seed: int) -> tuple[IKProblem, Active]:
    """A problem of many rows, and a guess that has little to do with it."""
    rng = np.random.default_rng(seed)
    m, r = 30, 150
    rows = Rows(rng.normal(size=(r, m)), 0.3 * np.abs(rng.normal(size=r)))
    levels = [Level(rng.normal(size=(6, m)), 5.0 * rng.normal(size=6)), Level(np.eye(m), 3.0 * rng.normal(size=m))]
    guess = np.zeros(r, dtype=bool)
    guess[rng.choice(r, m // 2, replace=False)] = True
    return IKProblem(levels, rows=rows), guess


@pytest.mark.parametrize("seed", range(4))
def test_a_guess_that_is_far_off_leads_to_the_optimum_of_many_rows_too(seed: int) -> None:
    problem, guess = far_off(seed)
    hierarchy = Hierarchy(problem)
    solution = active_set.solve(hierarchy, guess, hierarchy.start)
    assert solution.converged
    assert solution.iterations > active_set.ITERATIONS  # as many as for few rows would not do


@pytest.mark.usefixtures("python_path")
@pytest.mark.parametrize("seed", range(4))
def test_rows_of_the_last_step_that_lead_far_are_given_up_for_a_search_from_nothing(seed: int, monkeypatch) -> None:
    problem, guess = far_off(seed)
    own, faces = get_method("active-set"), Mock(side_effect=face_solution)
    own._memory.remember([problem.rows.names[i] for i in np.flatnonzero(guess)])
    monkeypatch.setattr(active_set, "face_solution", faces)
    fresh = get_method("active-set").step(problem)
    from_nothing_alone = faces.call_count
    step = own.step(problem)
    assert faces.call_count - 2 * from_nothing_alone == LEAST_SETS + np.count_nonzero(guess) // ROWS_PER_SET
    assert bits(step.dtheta) == bits(fresh.dtheta)
    assert step.certificate == fresh.certificate


@pytest.mark.parametrize(("weights", "first"), [("eq23", 70), ("eq24", 372)])
def test_from_odd_rows_no_other_step_is_certified_where_a_row_hardly_moves_what_is_left(weights, first):
    """A row that moves 1e-9 of itself in what a level leaves holds the level only until another row is in the way."""
    rng, seen = np.random.default_rng(first), 0
    problems = list(wind(WindingSettings(direction="up", weights=weights)).problems())
    for problem in problems[first : first + 10]:
        hierarchy = Hierarchy(problem, RANK_TOLERANCE)
        step = get_method("active-set").step(problem, SolveOptions(rank_tolerance=RANK_TOLERANCE))
        right = np.isin(hierarchy.rows.names, step.active_rows)
        for wrong in (0.01, 0.02, 0.05):
            found = active_set.solve(hierarchy, right ^ (rng.random(len(right)) < wrong), hierarchy.start)
            if found.converged:
                seen += 1
                allowed = 1e-7 + found.proof.certificate.variation + step.certificate.variation
                assert np.linalg.norm(found.u - step.dtheta) <= allowed * np.linalg.norm(step.dtheta)
    assert seen > 10
