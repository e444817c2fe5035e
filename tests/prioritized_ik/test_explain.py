"""Which level gave way, by how much, and to which rows."""

from dataclasses import replace

import numpy as np
import pytest
from hierarchies import random_hierarchy
from tolerances import ROUNDING, SABOTAGE
from winding_fixtures import constrained_steps

from prioritized_ik.errors import InputError
from prioritized_ik.problem import Bounds, Equalities, IKProblem, Level, Rows
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.explain import Concession, explain
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.solvers.solve import solve
from prioritized_ik.solvers.step import JointStep, StepStatus

CUT_AS_RECORDED = SolveOptions(rank_tolerance=RANK_TOLERANCE)
PLANTED = SolveOptions(rank_tolerance=1e-7)  # what the planted problems are to be solved with


def explained(problem: IKProblem, options: SolveOptions | None = None) -> tuple[Concession, ...]:
    return explain(problem, solve(problem, options=options), options)


#: "reach" has x = 1. "posture" wants x = 0 and y = 1/2: it gives way by 1 to "reach", and y stops at 1/5.
CONFLICT = IKProblem(
    [Level([[1.0, 0.0]], [1.0], name="reach"), Level(np.eye(2), [0.0, 0.5], name="posture")],
    Bounds([-9.0, -9.0], [9.0, 0.2], ["hip", "knee"]),
)

#: x may not pass 1/2: "reach" is short by 1/2, of weight 4, and "posture" gains by it.
STOPPED = IKProblem(
    [Level([[1.0, 0.0]], [1.0], [4.0], "reach"), Level(np.eye(2), [0.0, 0.5], name="posture")],
    Bounds([-9.0, -9.0], [0.5, 9.0], ["hip", "knee"]),
)

#: Two levels at odds in x alone, with no rows about.
AT_ODDS = IKProblem([Level([[1.0, 0.0]], [1.0], name="reach"), Level([[3.0, 0.0]], [-6.0], name="other")])


def test_a_level_that_gives_way_to_levels_above_and_to_a_bound():
    reach, posture = explained(CONFLICT)
    assert (reach.level, posture.level) == ("reach", "posture")
    assert not reach.gave_way
    assert (reach.alone, reach.below_others, reach.error) == pytest.approx((0.0, 0.0, 0.0), abs=ROUNDING)
    assert posture.gave_way
    assert posture.alone == pytest.approx(0.0, abs=ROUNDING)
    assert posture.below_others == pytest.approx(1.0, rel=ROUNDING)
    assert posture.error == pytest.approx(np.hypot(1.0, 0.3), rel=ROUNDING)
    assert posture.held_by == ("knee upper",)


def test_a_level_that_gives_way_to_a_bound_only_and_one_below_that_gains_by_it():
    reach, posture = explained(STOPPED)
    assert reach.gave_way
    assert (reach.alone, reach.below_others) == pytest.approx((0.0, 0.0), abs=ROUNDING)
    assert reach.error == pytest.approx(1.0, rel=ROUNDING)  # √4 · 1/2
    assert reach.held_by == ("hip upper",)
    assert posture.gave_way
    assert posture.below_others == pytest.approx(1.0, rel=ROUNDING)
    assert posture.error == pytest.approx(0.5, rel=ROUNDING)


def test_a_level_that_gives_way_to_a_level_above_only():
    reach, other = explained(AT_ODDS)
    assert not reach.gave_way
    assert other.gave_way
    assert other.alone == pytest.approx(0.0, abs=ROUNDING)
    assert other.below_others == pytest.approx(9.0, rel=ROUNDING)
    assert other.error == pytest.approx(9.0, rel=ROUNDING)
    assert other.held_by == ()


def test_levels_that_agree_concede_nothing():
    problem = IKProblem([Level([[1.0, 0.0]], [1.0]), Level(np.eye(2), [1.0, 0.5])], Bounds([-9.0, -9.0], [9.0, 9.0]))
    assert not any(concession.gave_way for concession in explained(problem))


def test_a_target_that_no_step_reaches_is_no_concession():
    # x = 1 and x = -1 at once: an error of √2 whatever the others do.
    (concession,) = explained(IKProblem([Level([[1.0, 0.0], [1.0, 0.0]], [1.0, -1.0])]))
    assert concession.alone == pytest.approx(np.sqrt(2.0), rel=ROUNDING)
    assert concession.error == pytest.approx(concession.alone, rel=ROUNDING)
    assert not concession.gave_way


def test_equalities_are_no_concession_either():
    # They count as given: x = 1 is out of reach for every level alike.
    equalities = Equalities([[1.0, 0.0]], [0.25])
    (concession,) = explained(IKProblem([Level(np.eye(2), [1.0, 1.0])], equalities=equalities))
    assert concession.alone == pytest.approx(0.75, rel=ROUNDING)
    assert not concession.gave_way


def test_a_soft_level_concedes_its_excess():
    soft = Level([[1.0, 0.0]], [0.2], [4.0], "slow", "at_most")
    slow, reach = explained(
        IKProblem([soft, Level([[1.0, 0.0]], [1.0], name="reach")], rows=Rows([[-1.0, 0.0]], [-0.5], ["far enough"]))
    )
    assert slow.gave_way
    assert (slow.alone, slow.error) == pytest.approx((0.0, 2.0 * 0.3), abs=ROUNDING)
    assert slow.held_by == ("far enough",)
    assert reach.gave_way
    assert (reach.alone, reach.below_others, reach.error) == pytest.approx((0.0, 0.8, 0.5), abs=ROUNDING)


# Text.


def test_the_text_says_to_whom_a_level_gave_way_and_by_how_much():
    reach, posture = explained(CONFLICT)
    assert str(reach) == "reach: error 0, as if it were alone"
    assert str(posture) == (
        "posture: error 1.04 instead of 0; gave way by 1 to the levels above, gave way by 0.044 to knee upper"
    )
    assert str(explained(STOPPED)[0]) == "reach: error 1 instead of 0; gave way by 1 to hip upper"
    assert str(explained(AT_ODDS)[1]) == "other: error 9 instead of 0; gave way by 9 to the levels above"


def concession(**values: object) -> Concession:
    return replace(Concession("reach", 0.1, 0.1, 0.1, (), 1e-8), **values)


def test_the_text_names_every_row_in_order():
    text = str(concession(error=0.6, held_by=("knee upper", "contact of link 3")))
    assert text == "reach: error 0.6 instead of 0.1; gave way by 0.5 to knee upper, contact of link 3"


def test_the_text_names_five_rows_and_counts_the_rest():
    names = tuple(f"row {i}" for i in range(1, 9))
    assert str(concession(error=0.6, held_by=names)).endswith("0.5 to row 1, row 2, row 3, row 4, row 5 and 3 more")
    assert str(concession(error=0.6, held_by=names[:5])).endswith("0.5 to row 1, row 2, row 3, row 4, row 5")


def test_the_text_of_a_level_held_by_no_row_of_its_own_says_so():
    # The rows press on a level above, which leaves this one no room.
    assert str(concession(error=0.6)) == (
        "reach: error 0.6 instead of 0.1; gave way by 0.5 to rows that the levels above rest on"
    )


def test_the_text_of_a_level_that_rows_help_tells_both_sides():
    text = str(explained(STOPPED)[1])
    assert text.startswith("posture: error 0.5 instead of 0; gave way by 1 to the levels above, got back 0.5 through rows")


def test_errors_nearer_to_each_other_than_the_tolerance_are_equal():
    assert not concession(error=0.1 + 0.9e-8).gave_way
    assert concession(error=0.1 + 1.1e-8).gave_way
    assert str(concession(below_others=0.1 + 0.9e-8, error=0.1 + 0.9e-8)) == "reach: error 0.1, as if it were alone"
    text = str(concession(below_others=0.1 + 0.9e-8, error=0.6, held_by=("knee upper",)))
    assert text == "reach: error 0.6 instead of 0.1; gave way by 0.5 to knee upper"


@pytest.mark.parametrize("size", [1e-6, 1e6])
def test_the_tolerance_grows_with_the_target(size):
    level = Level(np.eye(2), [3.0 * size, 4.0 * size], [1.0, 4.0])
    (found,) = explained(IKProblem([level]))
    assert found.tolerance == pytest.approx(1e-8 * size * np.hypot(3.0, 8.0), rel=ROUNDING)


# What was cut.


#: y is asked for by a row of 1e-5 of what the row of x has.
WEAK = IKProblem([Level(np.diag([1.0, 1e-5]), [1.0, 1.0], name="reach")])


def test_what_a_cut_left_undone_is_told_and_by_how_much():
    (found,) = explained(WEAK, CUT_AS_RECORDED)
    assert not found.gave_way  # alone, it is cut too
    assert found.undone == pytest.approx(1.0, rel=ROUNDING)
    assert str(found) == "reach: error 1; 1 of it left undone along directions that were cut"


def test_what_is_not_cut_is_as_if_it_were_alone():
    (found,) = explained(WEAK)
    assert found.undone == 0.0
    assert found.error == pytest.approx(0.0, abs=ROUNDING)
    assert str(found).endswith(", as if it were alone")


@pytest.mark.parametrize("undone", [2e-8, 1e-3, 0.1])
@pytest.mark.parametrize("error", [0.1, 0.6])
def test_nothing_is_as_if_it_were_alone_where_something_was_cut(undone, error):
    text = str(concession(error=error, undone=undone, held_by=("knee upper",)))
    assert "as if it were alone" not in text
    assert f"{undone:.3g} of it left undone along directions that were cut" in text


@pytest.mark.parametrize("cost", [1e-2, 1e-3, 1e-4, 1e-5, 1e-6])
def test_a_weak_posture_among_the_rows_of_a_task_is_followed_or_said_to_be_cut(cost):
    rng = np.random.default_rng(0)
    matrix, wanted, posture = rng.normal(size=(3, 7)), np.array([0.02, -0.01, 0.03]), rng.normal(size=7) * 0.1
    problem = IKProblem([Level(np.vstack([matrix, cost * np.eye(7)]), np.concatenate([wanted, cost * posture]))])
    for options in (SolveOptions(), CUT_AS_RECORDED):
        step = solve(problem, options=options)
        missing = np.linalg.norm(np.linalg.svd(matrix)[2][3:] @ (step.dtheta - posture))
        text = str(explain(problem, step, options)[0])
        assert (missing <= 1e-6) == ("were cut" not in text)


# Rows that were softened.


def test_softened_rows_concede_first():
    problem = IKProblem(
        [Level([[1.0, 0.0]], [1.0], name="reach")],
        Bounds([-9.0, -9.0], [0.5, 9.0], ["hip", "knee"]),
        Rows([[-2.0, 0.0]], [-1.4], ["far enough"]),
    )
    options = SolveOptions(soften=("hip upper",))
    softened, reach = explained(problem, options)
    assert softened.level == "softened rows"
    # x >= 0.7 breaks x <= 1/2 by a fifth, and "reach" is held there by the row that was softened.
    assert (softened.alone, softened.error) == pytest.approx((0.0, 0.2), abs=ROUNDING)
    assert softened.held_by == ("far enough",)
    assert reach.error == pytest.approx(0.3, rel=ROUNDING)
    assert explain(problem, solve(problem, options=options), options) == (softened, reach)


# Planted problems.


@pytest.mark.parametrize("seed", range(20))
def test_errors_are_those_of_smaller_problems(seed):
    known = random_hierarchy(seed, joints=(2, 20), levels=(1, 4))
    problem = known.problem
    step = get_method("daqp").step(problem, PLANTED)
    found = explain(problem, step, PLANTED)
    assert [one.level for one in found] == [level.name for level in problem.levels]
    assert [one.error for one in found] == pytest.approx([np.sqrt(cost) for cost in step.costs], rel=ROUNDING)
    for i, one in enumerate(found):
        tolerance = one.tolerance + ROUNDING * one.error
        assert one.alone <= one.below_others + tolerance  # fewer levels above, more room
        assert one.held_by == step.certificate.held_by[i]
        if i == 0:
            assert one.below_others == pytest.approx(one.alone, abs=tolerance)
            assert one.error >= one.alone - tolerance
        assert str(one).startswith(f"{problem.levels[i].name}: error ")
        assert ("gave way by" in str(one)) == one.gave_way


def test_a_winding_step_gives_way_to_named_bounds_and_contacts():
    gave_way = 0
    for problem in constrained_steps():
        (found,) = explained(problem, CUT_AS_RECORDED)
        names = problem.inequalities.names
        assert set(found.held_by) <= set(names)
        assert found.held_by or found.error <= found.tolerance  # rows that bind can leave all that a level asks for
        gave_way += found.gave_way
    assert gave_way >= 4  # in others the rows cost less than can be told


# Sabotage.


def test_an_error_that_is_off_by_a_thousandth_is_another_story():
    step = solve(CONFLICT)
    off = replace(step, dtheta=step.dtheta + SABOTAGE * np.array([1.0, 0.0]))
    reach, _ = explain(CONFLICT, off)
    assert reach.error == pytest.approx(SABOTAGE, rel=1e-9)
    assert reach.gave_way


def test_the_order_of_levels_tells_who_gives_way():
    problem = IKProblem(CONFLICT.levels[::-1], CONFLICT.bounds)
    posture, reach = explained(problem)
    assert posture.error == pytest.approx(0.3, rel=ROUNDING)
    assert reach.error == pytest.approx(1.0, rel=ROUNDING)
    assert reach.held_by == ()


# Errors.


@pytest.mark.parametrize("status", [StepStatus.NOT_FOUND, StepStatus.VIOLATED, StepStatus.INFEASIBLE])
def test_a_step_that_was_not_found_is_not_explained(status):
    with pytest.raises(InputError, match=f"the step is {status.name}; expected one that was found and has a certificate"):
        explain(CONFLICT, JointStep(None, status))


def test_a_step_without_a_certificate_is_not_explained():
    step = replace(solve(CONFLICT), certificate=None)
    with pytest.raises(InputError, match="the step is SOLVED; expected one that was found and has a certificate"):
        explain(CONFLICT, step)


def test_a_level_that_asks_for_what_is_there_does_not_give_way_to_rounding():
    rng = np.random.default_rng(3)
    for _ in range(30):
        still = Level(rng.normal(size=(3, 6)), np.zeros(3), name="still")
        moved = Level(rng.normal(size=(2, 6)), rng.normal(size=2), name="moved")
        problem = IKProblem([still, moved])
        assert not explain(problem, solve(problem))[0].gave_way
