"""From any answer near the optimum, and most that are not, to the same bits; and no claim where that fails."""

from dataclasses import replace

import numpy as np
import pytest
from hierarchies import EVERYTHING, KnownHierarchy, random_hierarchy, solution_on
from prioritized_ik.solvers.polish import GUESS, Polished, face_solution, polish
from tolerances import ORACLE, ROUNDING
from winding_fixtures import constrained_steps, free_steps

from prioritized_ik.problem import Bounds, Equalities, IKProblem, Level, Rows
from prioritized_ik.solvers import polish as polish_module
from prioritized_ik.solvers.certificate import CERTIFIED, Proof, certify
from prioritized_ik.solvers.hierarchy import HARD, Hierarchy

CUT = 1e-7  # the planted problems' rank tolerance

#: Relative, of planted optima: rounding, times what weights over six decades and nearly dependent rows make of it. The
#: worst of 150 measures 1e-9.
BLURRED = 1e-8

#: Without the features that make a problem so ill-conditioned that rounding itself blurs its optimum.
CALM = EVERYTHING - {"weights", "degenerate"}
SEEDS = range(30)
NEARLY_ALL = 0.9  # of the starts from standing still, which may break rows: an active-set method that starts outside


def hierarchy_of(known: KnownHierarchy) -> Hierarchy:
    return Hierarchy(known.problem, CUT)


def holds(polished: Polished) -> bool:
    """Whether the polish claims the optimum; what it says of its step is that step's own proof."""
    return polished.proof.certificate.holds


def error(found: np.ndarray, truth: np.ndarray) -> float:
    return float(np.linalg.norm(found - truth) / np.linalg.norm(truth))


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


@pytest.mark.parametrize(("start", "repairs"), STARTS.values(), ids=STARTS.keys())
def test_a_start_leads_to_the_optimum_by_one_repair_a_wrong_row(start, repairs):
    hierarchy = Hierarchy(BOXED)
    found = polish(hierarchy, np.array(start))
    assert holds(found)
    assert found.dtheta == pytest.approx(OPTIMUM, abs=ROUNDING)
    assert bits(found.dtheta) == bits(polish(hierarchy, OPTIMUM).dtheta)
    assert repairs is None or found.repairs == repairs


def test_the_polish_leaves_the_callers_answer_alone():
    start = np.array([0.2, 1.0, 0.6])
    polish(Hierarchy(BOXED), start)
    assert start.tolist() == [0.2, 1.0, 0.6]


def test_the_proof_is_that_of_the_polished_step():
    hierarchy = Hierarchy(BOXED)
    for start, _ in STARTS.values():
        found = polish(hierarchy, np.array(start))
        assert found.proof.certificate == Proof(hierarchy, found.dtheta).certificate
        assert found.proof.certificate == certify(BOXED, found.dtheta)


def test_a_row_that_a_lower_level_presses_on_is_found_too():
    levels = [Level([[1.0, 1.0, 0.0]], [1.0]), Level([[1.0, -1.0, 0.0]], [3.0]), Level([[0.0, 0.0, 1.0]], [2.0])]
    hierarchy = Hierarchy(IKProblem(levels, Bounds([-9.0, -0.5, -9.0], [9.0, 9.0, 0.4])))
    for start in ([1.5, -0.5, 0.4], [1.5, -0.5, 0.0], [0.5, 0.5, 0.4], [0.5, 0.5, 0.0], [0.0, 0.0, 0.0], [2.0, -1.0, 2.0]):
        found = polish(hierarchy, np.array(start))
        assert holds(found)
        assert found.dtheta == pytest.approx([1.5, -0.5, 0.4], abs=ROUNDING)


def test_soft_rows_that_are_exceeded_are_told_from_those_that_are_kept():
    soft = Level([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], [0.2, 5.0, 9.0], [4.0, 1.0, 1.0], "soft", "at_most")
    problem = IKProblem([soft, Level([[0.0, 1.0]], [1.0])], rows=Rows([[-1.0, 0.0]], [-0.5]))
    for start in ([0.5, 1.0], [0.5, 6.0], [0.2, 5.0], [0.0, 0.0], [3.0, 3.0]):
        found = polish(Hierarchy(problem), np.array(start))
        assert holds(found)
        assert found.dtheta == pytest.approx([0.5, 1.0], abs=ROUNDING)


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
def test_a_perturbed_answer_is_polished_to_the_same_bits(seed):
    known = random_hierarchy(seed)
    hierarchy = hierarchy_of(known)
    wanted = polish(hierarchy, known.dtheta)
    assert holds(wanted)
    assert wanted.repairs == 0
    assert error(wanted.dtheta, known.dtheta) <= BLURRED
    for name in ("rounding", "noise", "much noise"):
        found = polish(hierarchy, starts(known)[name])
        assert holds(found), name
        assert bits(found.dtheta) == bits(wanted.dtheta), name


@pytest.mark.parametrize("seed", SEEDS)
def test_a_wrong_guess_is_repaired_to_the_same_bits(seed):
    known = random_hierarchy(seed, CALM, joints=(3, 25), levels=(1, 4))
    hierarchy = hierarchy_of(known)
    wanted = polish(hierarchy, known.dtheta).dtheta
    assert error(wanted, known.dtheta) <= ORACLE
    for name, start in starts(known).items():
        found = polish(hierarchy, start)
        assert holds(found), name
        assert bits(found.dtheta) == bits(wanted), name


def test_wrong_guesses_take_repairs_and_right_ones_none():
    repairs = {name: 0 for name in ("rounding", "noise", "one row too many", "one row too few")}
    for seed in SEEDS:
        known = random_hierarchy(seed, CALM, joints=(3, 25), levels=(1, 4))
        for name, start in starts(known).items():
            if name in repairs:
                repairs[name] += polish(hierarchy_of(known), start).repairs
    assert repairs["rounding"] == repairs["noise"] == 0
    assert min(repairs["one row too many"], repairs["one row too few"]) >= len(SEEDS) // 2


def test_from_standing_still_nearly_all_problems_are_solved_by_the_polish_alone():
    solved = 0
    for seed in SEEDS:
        known = random_hierarchy(seed, CALM, joints=(3, 25), levels=(1, 4))
        hierarchy = hierarchy_of(known)
        found = polish(hierarchy, np.zeros(len(known.dtheta)))
        if holds(found):
            assert bits(found.dtheta) == bits(polish(hierarchy, known.dtheta).dtheta)
            solved += 1
    assert solved >= NEARLY_ALL * len(SEEDS)


@pytest.mark.parametrize("seed", SEEDS)
def test_whatever_the_start_the_polish_ends_at_the_optimum_or_hands_it_back(seed):
    known = random_hierarchy(seed, joints=(2, 20), levels=(1, 4))
    hierarchy, size = hierarchy_of(known), np.linalg.norm(known.dtheta)
    wanted = polish(hierarchy, known.dtheta).dtheta
    rng = np.random.default_rng(seed)
    for start in (hierarchy.closed_form, known.dtheta + size * rng.normal(size=len(known.dtheta))):
        found = polish(hierarchy, start)
        assert bits(found.dtheta) == bits(wanted if holds(found) else start)


def test_recorded_steps_are_polished_to_the_same_bits_from_answers_off_by_a_millionth():
    for problem in (*free_steps(), *constrained_steps()):
        hierarchy = Hierarchy(problem)
        wanted = polish(hierarchy, hierarchy.closed_form)
        assert holds(wanted)
        noise = np.random.default_rng(0).normal(size=problem.joint_count)
        found = polish(hierarchy, wanted.dtheta + GUESS * np.linalg.norm(wanted.dtheta) * noise / np.linalg.norm(noise))
        assert holds(found)
        assert bits(found.dtheta) == bits(wanted.dtheta)


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
    assert error(found, known.dtheta) <= ORACLE
    assert error(found, solution_on(known.problem, known.presses, known.dtheta)) <= ORACLE


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
    assert error(face_solution(Hierarchy(problem), np.ones(3, dtype=bool)), corner) <= ROUNDING


def test_a_row_that_is_settled_but_for_a_billionth_holds_all_the_same():
    # Level 1 decides x; the row has 1e-9 of y too, which is cut from it and put back in.
    levels = [Level([[1.0, 0.0]], [1.0]), Level([[0.0, 1.0]], [1000.0])]
    hierarchy = Hierarchy(IKProblem(levels, rows=Rows([[1.0, 1e-9]], [0.5])))
    found = face_solution(hierarchy, np.array([True]))
    assert found == pytest.approx([0.5 - 1e-6, 1000.0], abs=ROUNDING)
    assert hierarchy.rows.slack(found) == pytest.approx([0.0], abs=ROUNDING)


# No claim.


def test_rows_without_a_common_point_leave_the_answer_as_it_is():
    problem = IKProblem([Level([[1.0, 0.0]], [5.0])], rows=Rows([[1.0, 0.0], [-1.0, 0.0]], [-1.0, -1.0]))
    for start in ([0.0, 0.0], [-1.0, 0.0], [1.0, 0.0], [7.0, -3.0]):
        found = polish(Hierarchy(problem), np.array(start))
        assert bits(found.dtheta) == bits(start)
        assert not holds(found)
        assert found.proof.certificate == certify(problem, start)
        assert found.proof.certificate.violation > CERTIFIED


def test_equalities_without_a_common_point_leave_the_answer_as_it_is():
    equalities = Equalities([[1.0, 0.0], [2.0, 0.0]], [1.0, 4.0])
    found = polish(Hierarchy(IKProblem([Level(np.eye(2), [1.0, 1.0])], equalities=equalities)), np.ones(2))
    assert bits(found.dtheta) == bits(np.ones(2))
    assert not holds(found)


def test_a_polish_that_runs_out_of_repairs_hands_the_answer_back_with_its_figures(monkeypatch):
    monkeypatch.setattr(polish_module, "REPAIRS", 2)
    start = np.array([0.2, 1.0, 0.6])  # takes two repairs, and so three looks
    found = polish(Hierarchy(BOXED), start)
    assert bits(found.dtheta) == bits(start)
    assert found.proof.certificate == certify(BOXED, start)
    assert not holds(found)
    monkeypatch.setattr(polish_module, "REPAIRS", 3)
    assert holds(polish(Hierarchy(BOXED), start))


def test_an_answer_that_is_the_optimum_is_certified_even_if_the_polish_fails(monkeypatch):
    monkeypatch.setattr(polish_module, "REPAIRS", 0)
    found = polish(Hierarchy(BOXED), OPTIMUM)
    assert holds(found)
    assert bits(found.dtheta) == bits(OPTIMUM)


def test_a_polish_that_gives_up_at_once_has_repaired_nothing():
    problem = IKProblem([Level([[1.0, 0.0]], [5.0])], rows=Rows([[1.0, 0.0], [-1.0, 0.0]], [-1.0, -1.0]))
    assert polish(Hierarchy(problem), np.zeros(2)).repairs == 0


# Sabotage: whatever the polish computes, the certificate has the last word.


@pytest.mark.parametrize("size", [1e-6, 1e-3, 1.0])
def test_a_face_whose_solution_is_off_is_never_handed_out(size, monkeypatch):
    exact = polish_module.face_solution
    monkeypatch.setattr(polish_module, "face_solution", lambda *given: exact(*given) + size * np.array([0.0, 0.6, -0.8]))
    for start in (OPTIMUM, np.array([0.3, 1.0, 0.3]), np.zeros(3)):
        found = polish(Hierarchy(BOXED), start)
        assert bits(found.dtheta) == bits(start)
        assert holds(found) == (start is OPTIMUM)


def test_a_row_that_is_never_dropped_is_never_certified(monkeypatch):
    monkeypatch.setattr(polish_module, "_wrong", lambda proof, active: np.array([], dtype=int))
    found = polish(Hierarchy(BOXED), np.array([0.5, 1.0, 0.6]))
    assert not holds(found)
    assert bits(found.dtheta) == bits([0.5, 1.0, 0.6])


def test_a_certificate_that_holds_for_anything_would_be_noticed(monkeypatch):
    # What the tests above rest on: with a lenient proof the polish stops at the first face, which is wrong.
    class Lenient(Proof):
        @property
        def certificate(self):
            return replace(super().certificate, tolerance=0.9)

    monkeypatch.setattr(polish_module, "Proof", Lenient)
    found = polish(Hierarchy(BOXED), np.array([0.5, 1.0, 0.6]))
    assert error(found.dtheta, OPTIMUM) > 1e-2
    assert not certify(BOXED, found.dtheta).holds
