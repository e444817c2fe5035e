"""Tasks: every Jacobian against finite differences on every kind of joint, and bad targets."""

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from prioritized_ik import (
    Axis,
    CentreOfMass,
    Damping,
    EndPoint,
    InputError,
    JointCoupling,
    LookAt,
    Orientation,
    Pose,
    Position,
    Posture,
    Robot,
    Task,
    VirtualArms,
    VirtualArmsTask,
    solve_step,
)
from prioritized_ik.robot import Frame

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


def _carriage(robot: Robot) -> Frame:
    return robot.frame(body="carriage")


def _in_carriage(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """A point ahead of the tip, and the direction there, in the carriage."""
    turn = robot.rotation(_carriage(robot)).T
    place = robot.position(_carriage(robot))
    return turn @ (_ahead(robot, 0.7) - place), turn @ (_ahead(robot, 1.0) - _ahead(robot, 0.0))


def _arms(robot: Robot) -> VirtualArms:
    return VirtualArms(robot.model, ["tip", EndPoint("body", "arm", (0.1, 0.2, 0.0))], axes="xz")


#: Errors that turn are differenced at zero, where their rows are exact; the others anywhere.
TASKS: dict[str, Callable[[Robot], Task]] = {
    "position": lambda robot: Position(robot, [0.3, -0.2, 0.9], site="tip"),
    "position of a body": lambda robot: Position(robot, [0.3, -0.2, 0.9], body="hand"),
    "position of an unnamed geom": lambda robot: Position(robot, [0.3, -0.2, 0.9], geom=3),
    "orientation": lambda robot: Orientation(robot, site="tip"),
    "pose": lambda robot: Pose(robot, site="tip"),
    "axis": lambda robot: Axis(robot, _ahead(robot, 1.0) - _ahead(robot, 0.0), site="tip"),
    "look-at": lambda robot: LookAt(robot, _ahead(robot, 0.7), site="tip"),
    "position in a frame that moves": lambda robot: Position(robot, [0.2, -0.1, 0.5], site="tip", root=_carriage(robot)),
    "orientation in a frame that moves": lambda robot: Orientation(robot, site="tip", root=_carriage(robot)),
    "pose in a frame that moves": lambda robot: Pose(robot, site="tip", root=_carriage(robot)),
    "axis in a frame that moves": lambda robot: Axis(robot, _in_carriage(robot)[1], site="tip", root=_carriage(robot)),
    "look-at in a frame that moves": lambda robot: LookAt(robot, _in_carriage(robot)[0], site="tip", root=_carriage(robot)),
    "virtual arms": lambda robot: VirtualArmsTask(robot, _arms(robot), [[0.3, 0.2], [0.1, 0.4]]),
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
    "root": (lambda robot: Pose(robot, site="tip", root="arm"), "root is 'arm'; expected a frame such as"),  # type: ignore[arg-type]
    "its own root": (lambda robot: Pose(robot, site="tip", root=robot.frame(site="tip")), "root is the site tip itself"),
    "damped joint": (lambda robot: Damping(robot, {"hnge": 1.0}), "no joint 'hnge'; the model has 4 joints: hinge"),
    "damping of a joint": (lambda robot: Damping(robot, {"ball": [1, 2]}), r"of ball has shape \(2,\); expected \(3,\)"),
    "negative damping": (lambda robot: Damping(robot, {"ball": -1}), "weights of damping are .*; expected numbers of at"),
    "no arms": (lambda robot: VirtualArmsTask(robot, ["tip"]), "arms is of type list"),  # type: ignore[arg-type]
    "arms of another model": (lambda robot: VirtualArmsTask(robot, _arms(_robot())), "virtual arms of another model"),
    "target of arms": (lambda robot: VirtualArmsTask(robot, _arms(robot), [0, 0]), r"expected \(2, 2\)"),
    "weights of arms": (lambda robot: VirtualArmsTask(robot, _arms(robot), weights=[1, 2, 3]), "weights of virtual arms"),
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


@pytest.mark.parametrize("kind", [Position, Orientation, Pose])
def test_a_task_in_a_frame_that_moves_follows_it(kind):
    robot = _robot()
    task = kind(robot, site="tip", root=_carriage(robot))
    assert task.name.endswith(" of tip in carriage")
    robot.integrate([1.0, -0.5, 0.3, 0.2, 0.4, -0.3, 0.7, 0.0, 0.0, 0.0, 0.0], 1.0)  # the base and the slide alone
    assert task.rows(robot)[1] == pytest.approx(np.zeros(task.size), abs=1e-12)


def test_damping_keeps_at_rest_what_the_levels_above_leave_open():
    robot = _robot()
    hand = Position(robot, _ahead(robot, 0.01), site="tip")
    held = solve_step(robot, [hand, Damping(robot, {"float": 1.0, "slide": 1.0})], damping=0.0).velocity
    free = solve_step(robot, [hand, Damping(robot, {"hinge": 1.0, "ball": [1.0, 1.0, 1.0]})], damping=0.0).velocity
    assert np.abs(held[:7]).max() < 1e-9
    assert np.abs(free[7:]).max() < 1e-9
    assert np.abs(free[:7]).max() > 0.1


def test_a_posture_may_weigh_some_joints_only():
    robot = _robot()
    there = robot.q
    robot.integrate(np.r_[np.zeros(6), 0.1, 0.2, 0.0, 0.0, 0.0], 1.0)
    step = solve_step(robot, [Posture(robot, there, weights={"s*": 1.0})]).velocity * 0.01
    assert step == pytest.approx(np.r_[np.zeros(6), -0.1, np.zeros(4)])


def test_virtual_arms_are_weighted_arm_by_arm():
    robot = _robot()
    arms = _arms(robot)
    each = VirtualArmsTask(robot, arms, weights=[2.0, 3.0])
    assert each.weights.tolist() == [2.0, 2.0, 3.0, 3.0]
    assert VirtualArmsTask(robot, arms, weights=[[2, 2], [3, 3]]).weights.tolist() == each.weights.tolist()
    each.target = arms.positions(robot.data) + 0.01
    robot.integrate(solve_step(robot, [each]).velocity, 0.01)
    assert np.abs(each.rows(robot)[1]).max() < 1e-3
