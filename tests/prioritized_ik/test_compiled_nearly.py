"""Steps that are next to what the compiled core tells apart: it answers them, as the Python form does."""

import campaign
import numpy as np
import paths
import pytest

from comparisons.bench.tracks import problem_of, states_of
from comparisons.robots import ROBOTS
from prioritized_ik.models import update_kinematics
from prioritized_ik.problem import Bounds, IKProblem, Level
from prioritized_ik.solvers.compiled import fast
from prioritized_ik.solvers.compiled.library import library
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.solvers.solve import solve
from prioritized_ik.solvers.step import JointStep, StepStatus

pytestmark = pytest.mark.skipif(not paths.COMPILED, reason=f"no compiled core: {library().note}")


def by_python(problem: IKProblem) -> JointStep:
    with paths.only("python"):
        return solve(problem)


def test_a_closed_form_that_breaks_a_bound_by_rounding_is_answered() -> None:
    problem = IKProblem([Level(np.eye(2), [1.0, 0.5])], Bounds([-2.0, -2.0], [1.0 - 5e-15, 2.0]))
    step = fast.compiled_step(problem, 0.0)
    assert step is not None
    assert step.status is by_python(problem).status is StepStatus.CLOSED_FORM


@pytest.mark.parametrize("from_it", [False, True], ids=["cold", "from that bound"])
@pytest.mark.parametrize("room", [2e-8, 5e-8])
def test_a_bound_that_is_loose_by_little_is_loose(room: float, from_it: bool) -> None:
    problem = IKProblem([Level(np.eye(2), [1.0, 0.5])], Bounds([-2.0, -2.0], [0.8, 0.5 + room], ("one", "other")))
    step = fast.compiled_step(problem, 0.0, ("other upper",) if from_it else ())
    assert step is not None
    assert step.tight_rows == by_python(problem).tight_rows
    assert step.dtheta.tolist() == by_python(problem).dtheta.tolist() == [0.8, 0.5]


@pytest.mark.parametrize("target", [0.5, 2.0], ids=["inactive", "active"])
def test_after_a_closed_form_steps_are_the_same(target: float) -> None:
    limits = Bounds([-1.0, -1.0], [1.0, 1.0])
    bound, free, then = (IKProblem([Level([[1.0, 0.3]], [t])], limits) for t in (2.0, 0.1, target))
    method = get_method("active-set")
    steps = [method.step(problem, SolveOptions()) for problem in (bound, free, then)]
    assert [step.status for step in steps[:2]] == [StepStatus.SOLVED, StepStatus.CLOSED_FORM]
    assert steps[2].dtheta.tobytes() == solve(then).dtheta.tobytes()
    assert steps[2].status is solve(then).status


@pytest.mark.parametrize(
    ("kind", "seed"),
    [("dyadic", 740065), ("frozen_joints", 740089), ("barely_feasible", 740004), ("equalities", 740010)],
)
def test_a_search_through_rows_without_a_step_in_common_comes_to_rest(kind: str, seed: int) -> None:
    assert campaign.judge_compiled(campaign.draw(kind, seed)).word == campaign.RIGHT


@pytest.mark.parametrize(
    ("name", "track", "levels", "moving"),
    [("SCARA", 3, 1, 12), ("industrial arm", 2, 6, 17), ("arm on wheels", 2, 1, 5)],
)
def test_robots_at_rest_beside_their_limits_are_answered(name: str, track: int, levels: int, moving: int) -> None:
    robot, resting = ROBOTS[name], 12
    scene, answered = robot.scene(track), 0
    for q in states_of(robot, scene, moving + resting)[moving:]:
        update_kinematics(scene.model, scene.now, q)
        problem = problem_of(robot, scene, levels)
        step, expected = fast.compiled_step(problem, 0.0), by_python(problem)
        assert expected.dtheta is not None
        assert np.linalg.norm(expected.dtheta) < 1e-5  # [rad]
        answered += step is not None
        assert step is None or step.tight_rows == expected.tight_rows
    assert answered >= resting - 1


@pytest.mark.parametrize("levels", [2, 3, 6])
@pytest.mark.parametrize("track", [1, 2, 3, 5])
def test_the_many_rows_that_hold_a_humanoid_are_guessed_cold_and_warm(track: int, levels: int) -> None:
    robot, method = ROBOTS["humanoid"], get_method("active-set")
    scene = robot.scene(track)
    most = 0
    for q in states_of(robot, scene, 6):
        update_kinematics(scene.model, scene.now, q)
        step = method.step(problem_of(robot, scene, levels))
        assert step.path == "compiled"
        assert step.repairs <= 5  # a search from nothing visits some forty sets
        most = max(most, len(step.active_rows))
    assert levels == 2 or most >= 14
