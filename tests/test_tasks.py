"""Tasks: every Jacobian against finite differences on every kind of joint, and bad targets."""

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from prioritized_ik import (
    Axis,
    CentreOfMass,
    InputError,
    JointCoupling,
    LookAt,
    Orientation,
    Pose,
    Position,
    Posture,
    Robot,
    Task,
)

#: A free base, and on it a slide, a hinge and a ball joint, each square to none.
XML = """
<mujoco><worldbody><body name="base" pos="0 0 1"><freejoint name="float"/><geom size="0.2" pos="0.05 0 0"/>
<body name="carriage" pos="0.1 0.2 0.1"><joint name="slide" type="slide" axis="1 2 0.5"/><geom size="0.1"/>
<body name="arm" pos="0 0.1 0.3"><joint name="hinge" axis="0.3 1 0.2"/><geom size="0.08" pos="0.1 0 0.1"/>
<body name="hand" pos="0.3 0 0.1"><joint name="ball" type="ball" pos="0 0.02 0"/><geom size="0.05" pos="0 0.1 0.2"/>
<site name="tip" pos="0.1 0.05 0.3" euler="20 30 40"/></body></body></body></body></worldbody></mujoco>
"""
STEP = 1e-6


def _robot() -> Robot:
    model = mujoco.MjModel.from_xml_string(XML)
    robot = Robot(model)
    robot.integrate(np.random.default_rng(5).normal(size=model.nv), 0.5)
    return robot


def _differences(robot: Robot, task: Task) -> np.ndarray:
    """-de/dθ by central differences, one column a degree of freedom."""
    start, columns = robot.q, []
    for direction in np.eye(robot.model.nv):
        ends = []
        for sign in (1.0, -1.0):
            robot.update(start)
            robot.integrate(sign * direction, STEP)
            ends.append(task.rows(robot)[1])
        columns.append((ends[1] - ends[0]) / (2.0 * STEP))
    robot.update(start)
    return np.array(columns).T


def _ahead(robot: Robot, distance: float) -> np.ndarray:
    tip = robot.frame(site="tip")
    return robot.position(tip) + distance * robot.rotation(tip)[:, 2]


#: Errors that turn are differenced at zero, where their rows are exact; the others anywhere.
TASKS: dict[str, Callable[[Robot], Task]] = {
    "position": lambda robot: Position(robot, [0.3, -0.2, 0.9], site="tip"),
    "position of a body": lambda robot: Position(robot, [0.3, -0.2, 0.9], body="hand"),
    "position of an unnamed geom": lambda robot: Position(robot, [0.3, -0.2, 0.9], geom=3),
    "orientation": lambda robot: Orientation(robot, site="tip"),
    "pose": lambda robot: Pose(robot, site="tip"),
    "axis": lambda robot: Axis(robot, _ahead(robot, 1.0) - _ahead(robot, 0.0), site="tip"),
    "look-at": lambda robot: LookAt(robot, _ahead(robot, 0.7), site="tip"),
    "centre of mass": lambda robot: CentreOfMass(robot, [0.1, 0.2, 0.3]),
    "posture": Posture,
    "coupling": lambda robot: JointCoupling(robot, {"slide": 2.0, "hinge": -0.5}, 0.3),
}


@pytest.mark.parametrize("make", TASKS.values(), ids=TASKS.keys())
def test_the_jacobian_is_the_derivative_on_every_kind_of_joint(make):
    robot = _robot()
    task = make(robot)
    jacobian, error = task.rows(robot)
    assert jacobian.shape == (task.size, robot.model.nv)
    assert error.shape == (task.size,)
    assert _differences(robot, task) == pytest.approx(jacobian, abs=1e-8)


def test_the_check_catches_a_row_off_by_a_thousandth():
    robot = _robot()
    task = Position(robot, site="tip")
    jacobian = task.rows(robot)[0].copy()
    jacobian[0, 7] += 1e-3
    assert _differences(robot, task) != pytest.approx(jacobian, abs=1e-8)


@pytest.mark.parametrize("make", TASKS.values(), ids=TASKS.keys())
def test_steps_along_the_rows_meet_the_task_from_afar(make):
    robot = _robot()
    task = make(robot)
    if isinstance(task, Axis | LookAt | Orientation | Pose | Posture):
        robot.integrate(np.random.default_rng(1).normal(size=robot.model.nv), 0.4)
    for _ in range(30):
        jacobian, error = task.rows(robot)
        robot.integrate(np.linalg.pinv(jacobian, rcond=1e-9) @ error, 1.0)
    assert task.rows(robot)[1] == pytest.approx(np.zeros(task.size), abs=1e-8)


def test_an_axis_that_points_the_other_way_turns_round():
    robot = _robot()
    task = Axis(robot, _ahead(robot, 0.0) - _ahead(robot, 1.0), site="tip")
    assert np.linalg.norm(task.rows(robot)[1]) == pytest.approx(np.pi)


def test_a_quaternion_and_its_matrix_ask_for_the_same():
    robot = _robot()
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, [0.5, 0.5, 0.5, 0.5])
    asked = Orientation(robot, [1.0, 1.0, 1.0, 1.0], site="tip").rows(robot)[1]
    assert asked == pytest.approx(Orientation(robot, matrix.reshape(3, 3), site="tip").rows(robot)[1])


BAD: dict[str, tuple[Callable[[Robot], object], str]] = {
    "position in the plane": (lambda robot: Position(robot, [0, 0], site="tip"), r"position of tip has shape \(2,\)"),
    "orientation of three": (lambda robot: Orientation(robot, [0, 0, 0], site="tip"), r"quaternion \(4,\)"),
    "no rotation": (lambda robot: Orientation(robot, 2 * np.eye(3), site="tip"), "expected a rotation matrix"),
    "quaternion of zeros": (lambda robot: Orientation(robot, np.zeros(4), site="tip"), "quaternion of zeros"),
    "pose of three": (lambda robot: Pose(robot, np.eye(3), site="tip"), r"homogeneous matrix \(4, 4\)"),
    "posture of nv": (lambda robot: Posture(robot, np.zeros(robot.model.nv)), r"expected a position \(13,\)"),
    "axis of zeros": (lambda robot: Axis(robot, [0, 0, 0], site="tip"), "is zero"),
    "gain": (lambda robot: Position(robot, site="tip", gain=1.5), "gain of position of tip is 1.5"),
    "weights": (lambda robot: CentreOfMass(robot, weights=[1, 1]), "weights of centre of mass"),
    "negative weight": (lambda robot: CentreOfMass(robot, weights=-1), "at least 0"),
    "ragged pose": (lambda robot: Pose(robot, [[1, 0], [0]], site="tip"), "rows are of different lengths"),
    "ragged weights": (
        lambda robot: CentreOfMass(robot, weights=[[1], [1, 2]]),
        "weights of centre of mass is not an array",
    ),
    "coupling of a number": (lambda robot: JointCoupling(robot, 3), "coefficients is 3; expected joints and numbers"),
    "coupled ball": (lambda robot: JointCoupling(robot, {"ball": 1.0}), "ball or free joint"),
    "coupling of nothing": (lambda robot: JointCoupling(robot, {}), "no joint"),
    "no frame": (lambda robot: Position(robot), "0 frames"),
    "unknown site": (lambda robot: Position(robot, site="tipp"), "there is no site 'tipp'; the model has 1 site: tip"),
    "another model": (lambda robot: Position(_robot(), site="tip").rows(robot), "task of another model"),
    "no robot": (lambda robot: Posture(robot.model), "expected a Robot"),  # type: ignore[arg-type]
    "looking at itself": (lambda robot: LookAt(robot, _ahead(robot, 0.0), site="tip").rows(robot), "origin"),
}


@pytest.mark.parametrize(("ask", "message"), BAD.values(), ids=BAD.keys())
def test_bad_input_is_one_clear_message(ask, message):
    with pytest.raises(InputError, match=message):
        ask(_robot())


@pytest.mark.parametrize("kind", ["position", "orientation", "pose", "axis", "centre of mass", "posture", "coupling"])
def test_half_way_between_two_targets_is_as_far_from_one_as_from_the_other_and_half_of_the_way(kind):
    robot = _robot()
    task = TASKS[kind](robot)
    if kind != "coupling":
        first = (
            type(task)(robot) if kind in ("posture", "centre of mass") else type(task)(robot, task._now(robot), site="tip")
        )
        robot.integrate(np.random.default_rng(2).normal(size=robot.model.nv), 0.3)
        second = (
            type(task)(robot) if kind in ("posture", "centre of mass") else type(task)(robot, task._now(robot), site="tip")
        )
        one, other = first.target, second.target
    else:
        one, other = task.target, float(-task.rows(robot)[1][0] + task.target)
    whole = _distance(task, robot, one)
    task.target = task.between(one, other, 0.5)
    assert whole > 0.05
    assert np.linalg.norm(task.rows(robot)[1]) == pytest.approx(0.5 * whole)
    assert _distance(task, robot, task.between(one, other, 0.0)) == pytest.approx(whole)
    assert _distance(task, robot, task.between(one, other, 1.0)) == pytest.approx(0.0, abs=1e-7)


def _distance(task: Task, robot: Robot, target: object) -> float:
    task.target = target
    return float(np.linalg.norm(task.rows(robot)[1]))
