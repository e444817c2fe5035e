"""Rows written where a robot is: the core and Python write the same, and it is what MuJoCo and the tasks say."""

import ctypes

import mujoco
import numpy as np
import pytest

from comparisons.robots import ROBOTS
from prioritized_ik import CentreOfMass, InputError, Orientation, Posing, Position, example
from prioritized_ik.live import LiveProblem
from prioritized_ik.models import update_kinematics
from prioritized_ik.posing import _Asked, _Rows
from prioritized_ik.solvers.compiled.library import library

needs_core = pytest.mark.skipif(library().core is None, reason="there is no compiled core here")
SAME = 1e-14  # [m, rad] of numbers of size one: rounding of a product of three


def _numbers(live: LiveProblem) -> np.ndarray:
    parts = (live.matrix(), live.target(), live.row_matrix, live.row_upper, live.equality_matrix, live.equality_target)
    return np.concatenate([part.ravel() for part in (*parts, live.lower, live.upper)])


@needs_core
@pytest.mark.parametrize("name", ROBOTS)
def test_core_and_python_write_the_same_rows_of_every_robot(name: str) -> None:
    robot = ROBOTS[name]
    for seed in range(5):
        scene = robot.scene(seed)
        problem = robot.problem(scene)  # by Python
        pose = robot.live(scene, problem)
        q = scene.now.qpos.copy()
        mujoco.mj_integratePos(scene.model, q, 0.01 * scene.step, 1.0)
        for place in (q, scene.now.qpos.copy()):  # away and back
            update_kinematics(scene.model, scene.now, place)
            posed, fresh = pose(), robot.problem(scene)
            apart = np.abs(_numbers(LiveProblem(posed)) - _numbers(LiveProblem(fresh)))
            assert apart.max() <= SAME * max(1.0, float(np.abs(_numbers(LiveProblem(fresh))).max()))


@pytest.mark.parametrize("by_python", [True, False])
def test_rows_are_those_of_the_tasks(by_python: bool) -> None:
    robot = example("humanoid")
    posing, nv = Posing(robot.model, robot.data), robot.model.nv
    matrix, target = np.zeros((9, nv)), np.zeros(9)
    frame = robot.frame(site=0)
    there, turn = (
        robot.position(frame) + np.array([0.1, -0.2, 0.05]),
        np.array([0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
    )
    mass = np.array([0.1, 0.2, 0.9])
    posing.position(frame, there, matrix[:3], target[:3], gain=0.5)
    posing.orientation(frame, turn, matrix[3:6], target[3:6])
    posing.centre_of_mass(0, mass, matrix[6:], target[6:])
    (posing.by_python if by_python else posing)()
    tasks = [
        Position(robot, there, site=0, gain=0.5),
        Orientation(robot, turn.reshape(3, 3), site=0),
        CentreOfMass(robot, mass),
    ]
    for i, task in enumerate(tasks):
        jacobian, error = task.rows(robot)
        assert np.abs(matrix[3 * i : 3 * i + 3] - jacobian).max() <= SAME
        assert np.abs(target[3 * i : 3 * i + 3] - task.gain * error).max() <= 10 * SAME


@needs_core
def test_centres_of_mass_of_several_parts_are_told_apart() -> None:
    robot = example("humanoid")
    posing, nv, written = Posing(robot.model, robot.data), robot.model.nv, []
    for body in (0, 2, 2, 0, 5):
        written.append(np.zeros((3, nv)))
        posing.centre_of_mass(body, None, written[-1], np.zeros(3))
    for q in (robot.q, robot.q + 0.1 * (np.arange(robot.model.nq) >= 7)):
        robot.update(q)
        posing()
        by_core = [matrix.copy() for matrix in written]
        posing.by_python()
        assert [matrix.tobytes() for matrix in by_core] == [matrix.tobytes() for matrix in written]


def test_what_is_wanted_is_looked_at_anew() -> None:
    robot = example("arm")
    posing, matrix, target = Posing(robot.model, robot.data), np.zeros((3, 7)), np.zeros(3)
    frame = robot.frame(site="tool")
    wanted = robot.position(frame)
    posing.position(frame, wanted, matrix, target)
    posing()
    assert not target.any()
    wanted[2] += 0.25
    posing()
    assert target == pytest.approx([0.0, 0.0, 0.25])


def test_a_row_that_is_broken_asks_for_no_motion() -> None:
    robot = example("arm")
    posing, matrix, target = Posing(robot.model, robot.data), np.zeros((1, 7)), np.zeros(1)
    frame, down = robot.frame(site="tool"), [[0.0, 0.0, -1.0]]
    posing.position(frame, robot.position(frame) + np.array([0.0, 0.0, 0.1]), matrix, target, across=down, floored=True)
    posing()
    assert target[0] == 0.0
    assert matrix[0] == pytest.approx(-robot.jacobians(frame)[0][2])


def test_rows_that_are_added_later_are_written_too() -> None:
    robot = example("arm")
    posing, lower, upper = Posing(robot.model, robot.data), np.zeros(7), np.zeros(7)
    posing()
    posing.bounds(lower, upper, np.full(7, 0.1))
    robot.update(robot.model.jnt_range[:, 1])
    posing()
    assert upper == pytest.approx(np.zeros(7))
    assert lower == pytest.approx(np.full(7, -0.1))


@needs_core
def test_the_core_measures_the_records_alike() -> None:
    core = library().core
    assert core is not None
    assert core.core_posing_size() == ctypes.sizeof(_Asked)
    assert core.core_posed_rows_size() == ctypes.sizeof(_Rows)


@pytest.mark.parametrize(
    ("wanted", "matrix", "message"),
    [
        (np.zeros(2), np.zeros((3, 7)), "wanted is an array of shape"),
        (np.zeros(3), np.zeros((2, 7)), "matrix is an array of shape"),
        (np.zeros(3), np.zeros((7, 3)).T, "matrix is .*C-contiguous"),
        (np.zeros(3), np.broadcast_to(0.0, (3, 7)), "matrix is .*C-contiguous"),
        (np.zeros(3, dtype=int), np.zeros((3, 7)), "wanted is .* of floats"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(wanted: np.ndarray, matrix: np.ndarray, message: str) -> None:
    robot = example("arm")
    with pytest.raises(InputError, match=message):
        Posing(robot.model, robot.data).position(robot.frame(site="tool"), wanted, matrix, np.zeros(3))


def test_numbers_of_a_frozen_problem_are_not_written() -> None:
    robot, frozen = example("arm"), np.zeros((3, 7))
    frozen.setflags(write=False)
    with pytest.raises(InputError, match="matrix is read-only"):
        Posing(robot.model, robot.data).position(robot.frame(site="tool"), np.zeros(3), frozen, np.zeros(3))


def test_places_beyond_q_are_refused() -> None:
    robot = example("arm")
    with pytest.raises(InputError, match="places are"):
        Posing(robot.model, robot.data).joints([7], np.zeros(1), np.zeros(1))
