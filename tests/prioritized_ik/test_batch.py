"""Many problems over processes have the steps that they have one by one, to the last bit."""

import campaign
import pytest

from prioritized_ik.errors import InputError, SolverUnavailableError
from prioritized_ik.processes import over_processes
from prioritized_ik.solvers.batch import solve_many
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.solvers.step import StepStatus

KINDS = ("integer", "conflicts", "infeasible", "soft_mix", "equalities")


def problems():
    return [campaign.draw(name, seed).problem for name in KINDS for seed in range(4)]


def test_over_processes_as_one_by_one_to_the_last_bit():
    given = problems()
    alone = [get_method("active-set").step(problem, SolveOptions()) for problem in given]
    for workers in (1, 2):
        steps = solve_many(given, workers=workers)
        assert len(steps) == len(given)
        for step, wanted in zip(steps, alone, strict=True):
            assert (step.status, step.path, step.certificate) == (wanted.status, wanted.path, wanted.certificate)
            assert (step.dtheta is None) == (wanted.dtheta is None)
            if step.dtheta is not None:
                assert step.dtheta.tobytes() == wanted.dtheta.tobytes()
                assert [str(report) for report in step.levels] == [str(report) for report in wanted.levels]


def test_a_conflict_is_a_status_and_stops_no_other():
    steps = solve_many([campaign.draw(name, 0).problem for name in ("infeasible", "integer")], workers=1)
    assert [step.status for step in steps] == [StepStatus.INFEASIBLE, steps[1].status]
    assert steps[1].found


def test_nothing_is_nothing():
    assert solve_many([]) == []


def test_what_is_wrong_is_told_before_any_process_starts():
    with pytest.raises(InputError, match=r"problems\[0\] is of type int; expected an IKProblem"):
        solve_many([3])
    with pytest.raises(InputError, match="workers is 0"):
        solve_many(problems()[:2], workers=0)
    with pytest.raises(SolverUnavailableError):
        solve_many(problems()[:2], "no such solver")


def test_an_error_of_a_worker_is_raised_here():
    with pytest.raises(ZeroDivisionError):
        over_processes(reciprocal, [1, 0, 2], workers=2)


def reciprocal(number: int) -> float:
    return 1 / number
