"""What the paper's reproduction says of solvers: figures are computed from the problems, and failures are counted."""

import json
import os
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from paper_repro.artefacts import (
    figure_agreement,
    figure_rank_tolerance,
    solvers,
    table_4_backends,
    table_6_weight_ratio,
    table_7_timing,
)
from paper_repro.artefacts.figure_rank_tolerance import TOLERANCES, scaling
from paper_repro.artefacts.table_5_damping import METHODS, NORMAL, ORTHOGONAL, by_qp
from paper_repro.make.artefact import QUICK
from paper_repro.make.jobs import Results
from paper_repro.measure.replays import (
    DAMPED,
    FORMULATIONS,
    LEXICOGRAPHIC,
    MINK,
    Formulation,
    Posed,
    Summary,
    figures_of,
    formulations,
    replayed,
    replayed_job,
    sampled,
    silent,
    steps_of,
    windings,
)
from prioritized_ik.problem import Bounds, IKProblem, Level
from prioritized_ik.solvers.step import JointStep, StepStatus

STEPS = 6
ROUNDING = 1e-9

SCALE = replace(QUICK, directions=("up",), solvers=("daqp", "daqp-warm"))


def posed(*, free: bool) -> Posed:
    (winding,) = windings(SCALE)
    return next(one for one in sampled(winding, STEPS) if one.item.free is free)


def figures_with(solver: str, formulation: Formulation) -> list[dict[str, Any]]:
    return replayed(solver, formulation.name, formulation.damping, formulation.accurate, list(windings(SCALE)), STEPS)


# Figures of a step.


def test_the_recorded_steps_are_free_and_bound_and_the_bound_ones_have_a_certified_truth():
    found = sampled(windings(SCALE)[0], STEPS)
    assert {one.item.free for one in found} == {True, False}
    for one in found:
        assert one.taken is not None
        if one.item.free:
            assert one.true == pytest.approx(one.taken, abs=1e-9 * np.linalg.norm(one.taken))
        else:
            # Eqs. 12-14 break a row there, so that they cannot be the truth.
            assert one.item.problem.relative_violation(one.item.dtheta) > 1e-9
            assert one.item.problem.relative_violation(one.true) <= 1e-9


@pytest.mark.parametrize("free", [True, False])
def test_a_step_that_is_off_by_a_hundred_thousandth_has_that_error(free):
    one = posed(free=free)
    true = one.true
    exact = figures_of(one, JointStep(true, StepStatus.UNCERTIFIED))
    assert exact["dtheta_error"] == exact["dx_error"] == exact["cost_gap"] == 0.0
    off = true + 1e-5 * np.linalg.norm(true) * np.eye(len(true))[0]
    wrong = figures_of(one, JointStep(off, StepStatus.UNCERTIFIED))
    assert wrong["dtheta_error"] == pytest.approx(1e-5, rel=1e-6)
    assert wrong["dx_error"] > 1e-9
    assert wrong["cost_gap"] > 0.0 or not free  # it may leave the rows that hold it back


def test_a_step_that_was_not_found_has_no_figures_and_is_counted():
    one = posed(free=True)
    lost = figures_of(one, JointStep(None, StepStatus.NOT_FOUND))
    assert lost["dtheta_error"] is lost["dx_error"] is lost["cost_gap"] is lost["same_bits"] is None
    found = Summary.of([lost, figures_of(one, JointStep(one.true, StepStatus.UNCERTIFIED))])
    assert (found.steps, found.failed, found.dtheta_max, found.certified) == (2, 1, 0.0, 0.0)
    assert Summary.of([lost]).dtheta_max is None


def test_a_certified_step_counts_as_the_same_bits_only_if_it_is():
    one = posed(free=True)
    same = JointStep(one.taken, StepStatus.SOLVED)
    other = JointStep(np.nextafter(one.taken, np.inf), StepStatus.SOLVED)
    assert [figures_of(one, step)["same_bits"] for step in (same, other)] == [True, False]


# Replays.


def test_the_lexicographic_qp_is_the_closed_form_where_nothing_binds_and_certified_everywhere():
    found = Summary.of(figures_with("daqp", LEXICOGRAPHIC))
    assert found.free_steps > 0
    assert found.dtheta_max <= 1e-9
    assert found.dx_max <= 1e-9
    assert (found.certified, found.same_bits, found.failed) == (1.0, 1.0, 0)


def test_a_strongly_damped_qp_is_not():
    found = Summary.of(figures_with("daqp", Formulation("damped", 1e-2)))
    assert found.dtheta_max > 1e-2
    assert found.certified == 0.0


def test_two_replays_are_the_same():
    for formulation in (LEXICOGRAPHIC, DAMPED, MINK):
        first, second = (json.dumps(figures_with("daqp", formulation)) for _ in range(2))
        assert first == second


def test_accuracy_is_asked_of_a_damped_qp_only_if_it_is_told_so():
    loose, tight = (Summary.of(figures_with("proxqp", Formulation("damped", 1e-2, flag))) for flag in (False, True))
    assert loose.violation_max > 1e3 * max(tight.violation_max, 1e-12)


def test_native_backends_are_given_their_stages_only_and_the_others_everything():
    assert formulations("daqp-warm") == (LEXICOGRAPHIC,)
    assert formulations("daqp") == FORMULATIONS
    assert len(formulations("highs")) == len(FORMULATIONS) - 1
    assert len({formulation.title for formulation in FORMULATIONS}) == len(FORMULATIONS)
    assert Formulation("damped").title == "raw"
    assert steps_of(QUICK, "scs", MINK) >= 1


def test_what_solvers_print_is_not_shown_and_what_comes_after_is(capfd):
    with silent():
        os.write(2, b"from a C library")
    os.write(2, b"later")
    assert capfd.readouterr() == ("", "later")
    with pytest.raises(ValueError, match="passes"), silent():
        raise ValueError("passes")
    os.write(1, b"still there")
    assert capfd.readouterr().out == "still there"


# Tables.


def answers(failing: str = "") -> Results:
    """Fabricated answers of `SCALE`: errors of 1e-9, but for the backend and formulation that fails."""
    one = {"free": True, "found": True, "status": "SOLVED", "violation": 0.0, "certified": True, "same_bits": True,
           "own_guess": True}  # fmt: skip
    good = {**one, "dtheta_error": 1e-9, "dx_error": 1e-10, "cost_gap": 0.0}
    bad = {**dict.fromkeys(good), "free": True, "found": False, "status": "NOT_FOUND", "certified": False}
    jobs = {(s, f): replayed_job(SCALE, s, f) for s in SCALE.solvers or () for f in formulations(s)}
    return Results({job.key: [bad if f.title == failing else good] * 3 for (_, f), job in jobs.items()})


def test_table_4_has_one_row_a_backend_and_formulation_and_none_is_dropped_for_failing():
    table = table_4_backends.build(SCALE, answers("damped 1e-08"))
    assert len(table.rows) == len(FORMULATIONS) + 1
    by_title = {(row[0], row[1]): row for row in table.rows}
    assert by_title["damped 1e-08", "daqp"][2:] == (*[None] * 8, 0.0, "3/3")
    assert by_title["damped 1e-06", "daqp"][2:6] == (1e-9, 1e-9, 1e-10, 1e-10)
    assert by_title["damped 1e-06", "daqp"][-1] == "0/3"


def test_the_solvers_table_has_one_row_a_backend_and_one_for_mink():
    table = solvers.build(SCALE, answers("lexicographic"))
    assert [row[0] for row in table.rows] == ["daqp", "daqp-warm", "mink (daqp)"]
    assert table.rows[0][2:9] == (None, None, None, 0.0, None, None, "3/3")
    assert table.rows[0][9:] == (1e-9, 1e-9, "0/3")
    assert table.rows[1][9:] == (None, None, None)  # it is not given the damped QP


def test_digits_of_agreement():
    assert [figure_agreement.digits(error) for error in (1e-3, 10.0, 0.0)] == pytest.approx([3.0, 0.0, 16.0])
    lost = Summary.of([{**dict.fromkeys(("dtheta_error", "dx_error", "cost_gap", "violation", "same_bits")), "free": True,
                        "found": False, "certified": False}])  # fmt: skip
    assert figure_agreement.words(lost) == "–\n✕ 100%"


def test_table_6_shows_where_each_method_leaves_the_strict_answer():
    found = Results({table_6_weight_ratio.JOB.key: table_6_weight_ratio.rows_of_methods()})
    table = table_6_weight_ratio.build(SCALE, found)
    assert len(table.rows) == 3 * 13
    steps = np.array([[np.nan if cell is None else cell for cell in row[1:]] for row in table.rows if row[0] == "dθ"])
    ratios, orthogonal, pinv, strict = steps[:, 0], steps[:, 1], steps[:, 2], steps[:, -1]
    assert orthogonal[3:] == pytest.approx(orthogonal[3] * ratios[3] / ratios[3:], rel=0.2)
    assert pinv[-1] > 1e3 * pinv.min()
    assert (strict <= 1e-9).all()


def test_table_7_takes_the_median_of_the_repeats_step_by_step():
    scale = replace(SCALE, name="full", steps=5)
    jobs = table_7_timing.timed_jobs(scale)
    assert all(job.alone for job in jobs)
    assert len({job.key for job in jobs}) == len(jobs) == 3
    contenders = table_7_timing.contenders(("daqp", "daqp-warm"))
    found = {}
    for job, slow in zip(jobs, (1.0, 50.0, 1.1), strict=True):
        row = {"build": [1e-3, 1e-3], "solve": [slow * 1e-3, slow * 3e-3], "polish": [0.0, 0.0], "failed": 1}
        found[job.key] = {"cpu": "some CPU", "rows": [row] * len(contenders)}
    table = table_7_timing.build(scale, Results(found))
    rows = {(row[0], row[1], row[2]): row for row in table.rows}
    assert len(rows) == len(table.rows) == len(contenders)
    cold = rows["lexicographic", "daqp-warm", "cold"]
    assert cold[3:6] == pytest.approx((1.0, 0.5 * (1.1 + 3.3), 0.0))
    assert cold[6] == pytest.approx(0.5 * (2.1 + 4.3))  # the slow repeat does not show
    assert cold[9:] == (pytest.approx(4.3), "1/2")
    assert rows["mink", "daqp", None][3] is None
    assert "some CPU" in table.notes


def test_every_contender_is_timed_at_every_step():
    found = table_7_timing.timed(list(windings(SCALE)), 2, ["daqp", "daqp-warm"], 0)
    assert len(found["rows"]) == len(table_7_timing.contenders(("daqp", "daqp-warm")))
    for row in found["rows"]:
        assert len(row["build"]) == len(row["solve"]) == len(row["polish"]) == 2
        assert min(row["solve"]) > 0.0
        assert row["failed"] == 0


# Damping.


def small_problem() -> IKProblem:
    rng = np.random.default_rng(0)
    level = Level(rng.normal(size=(5, 3)) @ rng.normal(size=(3, 6)), rng.normal(size=5), rng.uniform(0.01, 200.0, 5))
    return IKProblem([level], Bounds(np.full(6, -1e3), np.full(6, 1e3)))


def test_all_methods_solve_the_same_damped_problem():
    problem, damping = small_problem(), 1e-2
    (level,) = problem.levels
    answers = {name: method(problem, damping) for name, method in METHODS.items()}
    for name, dtheta in answers.items():
        gradient = level.matrix.T @ (level.weights * (level.matrix @ dtheta - level.target)) + damping * dtheta
        assert np.linalg.norm(gradient) <= ROUNDING * np.linalg.norm(level.weights * level.target), name
        assert np.linalg.norm(gradient + 1e-3 * damping * dtheta) > 10 * np.linalg.norm(gradient), name


def test_a_damping_lost_in_rounding_leaves_the_normal_equations_no_right_digit_and_an_error_that_grows_by_both():
    problem = small_problem()
    (level,) = problem.levels
    root = np.sqrt(level.weights)
    truth = np.linalg.pinv(root[:, None] * level.matrix) @ (root * level.target)
    for damping in (1e-14, 1e-15):
        answer = METHODS[NORMAL](problem, damping)  # whether the factors exist is up to the machine's rounding
        assert answer is None or np.linalg.norm(answer - truth) > 0.1 * np.linalg.norm(truth)
        assert METHODS[ORTHOGONAL](problem, damping) is not None
    for name in (NORMAL, ORTHOGONAL):
        small, large = (np.linalg.norm(METHODS[name](problem, damping) - truth) for damping in (1e-12, 1e-10))
        assert 20.0 < small / large < 500.0  # as one over the damping


def test_a_qp_that_fails_has_no_answer():
    problem = small_problem()
    assert by_qp("damped", problem, 0.0) is None  # quadprog needs a positive definite Hessian


# Rank tolerance.


def test_a_larger_rank_tolerance_never_has_a_larger_rank():
    found = scaling(windings(SCALE)[0], STEPS)
    assert {name: np.shape(values) for name, values in found.items()} == dict.fromkeys(found, (len(TOLERANCES), STEPS))
    ranks = np.array(found["rank"])
    assert (np.diff(ranks, axis=0) <= 0).all()
    assert ranks.max() <= 34
    assert np.max(found["truncation"][0]) == 0.0
    assert np.min(found["truncation"][-1]) > 1e-3


def test_the_solvers_are_compared_at_the_same_tolerance():
    found = figure_rank_tolerance.disagreement(windings(SCALE)[0], STEPS)
    apart = [distance for row in found["apart"] for distance in row if distance is not None]
    assert apart
    assert np.median(apart) <= 1e-6
    assert len(found["certified"]) == len(figure_rank_tolerance.DECADES)
