"""Steps of whole robots: calm out of reach, out of objects, within ranges, and honest endings."""

import mujoco
import numpy as np
import pytest
from arms import bent_arm

from prioritized_ik import (
    CentreOfMass,
    Collision,
    Ending,
    InputError,
    JointRange,
    Orientation,
    Pose,
    Position,
    Posture,
    Robot,
    Velocity,
    example,
    reach,
    solve_step,
)

DT = 0.01


def test_two_limits_on_one_pair_of_geoms_have_rows_of_their_own():
    robot = bent_arm()
    limits = [Collision(robot, [("hand", "table")], min_distance=least, margin=1.0) for least in (0.02, 0.05)]
    problem = solve_step(robot, [Position(robot, site="tool")], limits, DT).problem
    assert len(set(problem.rows.names)) == len(problem.rows.upper) >= 2
    assert "hand near table" in problem.rows.names
    assert "hand near table (2)" in problem.rows.names


def _run(robot, levels, limits, steps):
    """Velocities `(steps, nv)` of so many steps."""
    velocities = []
    for _ in range(steps):
        motion = solve_step(robot, levels, limits, DT)
        robot.integrate(motion.velocity, DT)
        velocities.append(motion.velocity)
    return np.array(velocities)


def test_an_arm_drawn_out_of_reach_and_back_is_calm_and_returns():
    robot = bent_arm()
    hand = Position(robot, site="tool", gain=0.2)
    start = hand.target
    limits = [JointRange(robot), Velocity(robot, 2.0)]
    levels = [hand, Orientation(robot, site="tool", gain=0.2), Posture(robot, gain=0.1)]
    hand.target = start + np.array([0.8, 0.3, 0.4])
    out = _run(robot, levels, limits, 400)
    assert np.abs(np.diff(out[-50:], axis=0) / DT).max() < 0.1
    assert np.linalg.norm(hand.rows(robot)[1]) > 0.2
    hand.target = start
    back = _run(robot, levels, limits, 400)
    assert np.linalg.norm(hand.rows(robot)[1]) < 1e-3
    assert np.abs(np.diff(back[-50:], axis=0) / DT).max() < 0.1


BALL = """
<mujoco><asset><mesh name="roof" vertex="-.1 -.1 -.1 -.1 .1 -.1 .1 -.1 -.1 .1 .1 -.1 0 -.1 .1 0 .1 .1"/></asset><worldbody>
<geom name="object" {shape} pos="0.5 0 0.4"/>
<body name="a"><joint name="yaw" axis="0 0 1"/><joint name="pitch" axis="0 1 0"/>
<geom type="capsule" size="0.03" fromto="0 0 0 0 0 0.4"/>
<body name="b" pos="0 0 0.4"><joint name="elbow" axis="0 1 0"/><geom type="capsule" size="0.03" fromto="0 0 0 0.2 0 0"/>
<body name="c" pos="0.2 0 0">{joint}<geom name="hand" {hand}/><site name="tip"/></body></body></body></worldbody></mujoco>
"""
LOOSE = '<joint name="wrist" type="ball"/>'
TILTED = 'euler="35 40 10"'
SHAPES = {
    "ball": ('type="sphere" size="0.1"', 'type="sphere" size="0.05"', '<joint name="wrist" axis="0 1 0"/>'),
    "box": ('type="box" size="0.1 0.1 0.1"', 'type="sphere" size="0.05"', '<joint name="wrist" axis="0 1 0"/>'),
    "corner on box": ('type="box" size="0.1 0.1 0.1"', f'type="box" size="0.05 0.05 0.05" {TILTED}', ""),
    "box on box": ('type="box" size="0.1 0.1 0.1"', 'type="box" size="0.05 0.05 0.05"', LOOSE),
    "cap on box": ('type="box" size="0.1 0.1 0.1"', 'type="cylinder" size="0.05 0.05" euler="0 90 0"', LOOSE),
    "capsule along a box": ('type="box" size="0.1 0.1 0.1"', 'type="capsule" size="0.03 0.05"', LOOSE),
    "box on mesh": ('type="mesh" mesh="roof"', 'type="box" size="0.05 0.05 0.05"', LOOSE),
    "ball on mesh": ('type="mesh" mesh="roof"', 'type="sphere" size="0.05"', LOOSE),
    "slide": ('type="sphere" size="0.1"', 'type="sphere" size="0.05"', '<joint name="rail" type="slide" axis="1 0 0"/>'),
}


def _beside(name: str) -> Robot:
    shape, hand, joint = SHAPES[name]
    return Robot(mujoco.MjModel.from_xml_string(BALL.format(shape=shape, hand=hand, joint=joint)))


@pytest.mark.parametrize("name", SHAPES)
def test_pressing_for_600_steps_goes_no_deeper_than_a_tenth_of_a_millimetre(name):
    robot = _beside(name)
    apart = Collision(robot, [("hand", "object")])
    task, depths = Position(robot, [0.55, 0.02, 0.4], site="tip", gain=0.1), []
    for _ in range(600):
        robot.integrate(solve_step(robot, [task], [apart, Velocity(robot, 1.0)], DT).velocity, DT)
        depths.append(float(apart.distances(robot)[0]))
    assert min(depths) > -1e-4
    assert abs(depths[-1]) < 1e-4
    assert np.abs(np.diff(depths[-50:])).max() < 1e-6


@pytest.mark.parametrize("name", SHAPES)
def test_a_robot_that_starts_40_mm_deep_comes_out(name):
    robot = _beside(name)
    apart = Collision(robot, [("hand", "object")])
    task = Position(robot, [0.5, 0.0, 0.4], site="tip")
    reach(robot, [task], max_steps=100)
    for further in np.linspace(0.0, 0.1, 21):
        task.target = [0.39 + further, 0.0, 0.4]
        reach(robot, [task], max_steps=100)
        if apart.distances(robot)[0] < -0.039:
            break
    assert apart.distances(robot)[0] < -0.039
    _run(robot, [task], [apart, Velocity(robot, 1.0)], 200)
    assert apart.distances(robot)[0] > -1e-4


def test_min_distance_is_kept_at_rest():
    robot = _beside("ball")
    apart = Collision(robot, [("ha*", 0)], min_distance=0.02)
    _run(robot, [Position(robot, [0.5, 0.0, 0.4], site="tip", gain=0.1)], [apart, Velocity(robot, 1.0)], 300)
    assert apart.distances(robot)[0] == pytest.approx(0.02, abs=1e-4)


def test_without_the_way_back_a_robot_that_starts_deep_stays_deep():
    robot = _beside("ball")
    task = Position(robot, [0.39, 0.0, 0.4], site="tip")
    reach(robot, [task], max_steps=100)
    held = Collision(robot, [("hand", "object")], outside="hold")
    _run(robot, [task], [held], 100)
    assert held.distances(robot)[0] < -0.039
    with pytest.raises(InputError, match=r"hand near object: -0\.039\d* m apart, less than min_distance, 0"):
        solve_step(robot, [task], [Collision(robot, [("hand", "object")], outside="raise")])


RANGES = """
<mujoco><compiler angle="radian"/><worldbody>
<body><joint name="bend" axis="0 1 0" limited="true" range="-1 1"/><geom size="0.1"/>
<body pos="0 0 1"><joint name="ball" type="ball" limited="true" range="0 0.8"/><geom size="0.1"/>
<site name="tip" pos="0 0 1"/></body></body></worldbody></mujoco>
"""


def _outside() -> Robot:
    robot = Robot(mujoco.MjModel.from_xml_string(RANGES))
    robot.integrate([1.1, 0.9, 0.3, 0.0], 1.0)
    return robot


def _ball_angle(robot: Robot) -> float:
    return 2.0 * float(np.arccos(robot.q[1]))


def test_outside_raise_names_the_joint():
    robot = _outside()
    with pytest.raises(InputError, match=r"bend is at 1\.1, outside its range \[-1, 1\]"):
        solve_step(robot, [Posture(robot)], [JointRange(robot, outside="raise")])


def test_outside_hold_goes_no_further():
    robot = _outside()
    angle = _ball_angle(robot)
    away = Posture(robot, [2.0, np.cos(0.6), np.sin(0.6), 0.0, 0.0])
    _run(robot, [away], [JointRange(robot, outside="hold"), Velocity(robot, 1.0)], 60)
    assert robot.q[0] == pytest.approx(1.1, abs=1e-9)
    assert _ball_angle(robot) < angle + 60 * 0.5 * 0.01**2  # turns across the gradient, 0.01 rad a step


def test_outside_return_comes_back_before_any_task_at_a_bounded_speed():
    robot = _outside()
    away = Posture(robot, [2.0, np.cos(0.6), np.sin(0.6), 0.0, 0.0])
    first = _run(robot, [away], [JointRange(robot), Velocity(robot, 1.0)], 1)
    assert first[0, 0] == pytest.approx(-0.5)
    _run(robot, [away], [JointRange(robot)], 100)
    assert robot.q[0] == pytest.approx(1.0, abs=1e-9)
    assert _ball_angle(robot) == pytest.approx(0.8, abs=1e-4)


def test_gain_and_margin_slow_the_way_to_the_end_of_the_range():
    robot = Robot(mujoco.MjModel.from_xml_string(RANGES))
    push = Posture(robot, [2.0, 1.0, 0.0, 0.0, 0.0])
    _run(robot, [push], [JointRange(robot, gain=0.5, margin=0.1)], 1)
    assert robot.q[0] == pytest.approx(0.45)
    _run(robot, [push], [JointRange(robot, gain=0.5, margin=0.1)], 60)
    assert robot.q[0] == pytest.approx(0.9)


def test_reach_ends_reached():
    robot = bent_arm()
    hand = Position(robot, robot.position(robot.frame(site="tool")) + 0.05, site="tool")
    end = reach(robot, [hand, Posture(robot)], [JointRange(robot), Velocity(robot, 2.0)])
    assert end.ending is Ending.REACHED
    assert end.errors["position of tool"] < 1e-4
    assert not end.held_by


def test_reach_ends_out_of_reach_at_the_nearest_point():
    robot = bent_arm()
    model = robot.model
    hand = Position(robot, [0.0, 1.0, 2.0], site="tool")
    end = reach(robot, [hand], dt=0.05)
    shoulder = np.array([0.0, 0.0, 0.3])
    length = 0.2 + 0.15 + 0.2 + 0.15 + 0.08 + 0.12
    assert model.nv == 7
    assert end.ending is Ending.OUT_OF_REACH, str(end)
    assert end.nearest == pytest.approx(np.linalg.norm(hand.target - shoulder) - length, abs=1e-4)


def test_reach_ends_stuck_and_names_what_holds_it():
    robot = _beside("ball")
    end = reach(
        robot, [Position(robot, [0.5, 0.0, 0.4], site="tip", gain=0.2)], [Collision(robot, [("hand", "object")])], dt=0.05
    )
    assert end.ending is Ending.STUCK, str(end)
    assert end.held_by == ("hand near object",)


def test_reach_ends_out_of_steps():
    robot = bent_arm()
    end = reach(robot, [Position(robot, [0.4, 0.1, 0.5], site="tool")], [Velocity(robot, 0.1)], max_steps=3)
    assert (end.ending, end.steps) == (Ending.OUT_OF_STEPS, 3)


CROUCH = {"hip pitch": -0.5, "knee": 1.0, "ankle pitch": -0.5, "elbow": -0.8}


def _crouch(robot):
    q = robot.q
    for joint, angle in CROUCH.items():
        for side in ("left", "right"):
            q[robot.model.jnt_qposadr[robot.joint(f"{side} {joint}")]] = angle
    robot.update(q)


@pytest.mark.parametrize("further", [0.05, 0.8])
@pytest.mark.parametrize("crouched", [False, True], ids=["straight", "crouched"])
def test_a_humanoid_keeps_feet_and_balance_strictly_and_comes_to_rest(crouched, further):
    robot = example("humanoid")
    if crouched:
        _crouch(robot)
    feet = [Pose(robot, site=f"{side} foot") for side in ("left", "right")]
    balance = CentreOfMass(robot, gain=0.2)
    hands = [Position(robot, site=f"{side} hand", gain=0.2) for side in ("left", "right")]
    for hand in hands:
        hand.target = hand.target + np.array([further, 0.0, 0.0])
    levels = [feet, balance, hands, Posture(robot, gain=0.1)]
    velocities, off = [], []
    for _ in range(300):
        velocities.append(_run(robot, levels, [JointRange(robot), Velocity(robot, 2.0)], 1)[0])
        off.append(max(np.abs(task.rows(robot)[1]).max() for task in [*feet, balance]))
    assert max(off) < 1e-4  # on the way, too
    assert off[-1] < 1e-8
    assert np.abs(np.diff(velocities[-50:], axis=0) / DT).max() < 1.0
    if crouched and further == 0.05:
        assert max(np.linalg.norm(hand.rows(robot)[1]) for hand in hands) < 1e-6


def test_at_rest_with_targets_along_straight_arms_and_out_of_reach_every_step_is_proven():
    robot = example("humanoid")
    hands = [Position(robot, site=f"{side} hand") for side in ("left", "right")]
    for hand in hands:
        hand.target = hand.target + np.array([0.0, 0.0, -0.8])
    levels = [[Pose(robot, site=f"{side} foot") for side in ("left", "right")], CentreOfMass(robot, gain=0.2), hands]
    for _ in range(40):
        step = solve_step(robot, [*levels, Posture(robot, gain=0.1)], [JointRange(robot), Velocity(robot, 3.0)], DT).step
        assert step.certificate.holds, step.certificate
        assert np.abs(step.dtheta).max() < 1e-8  # all that is asked for is out of reach
        robot.integrate(step.dtheta / DT, DT)


@pytest.mark.parametrize("drawn", [(0.8, 0.0, 0.0), (0.5, 0.5, -0.3), (0.0, 0.0, 0.8)], ids=str)
def test_undamped_and_drawn_out_of_reach_every_step_of_a_crouched_humanoid_is_proven(drawn):
    robot = example("humanoid")
    _crouch(robot)
    feet = [Pose(robot, site=f"{side} foot") for side in ("left", "right")]
    hands = [Position(robot, site=f"{side} hand", gain=0.2) for side in ("left", "right")]
    for hand in hands:
        hand.target = hand.target + np.array(drawn)
    levels, stopped = [feet, CentreOfMass(robot, gain=0.2), hands, Posture(robot, gain=0.1)], 0
    for _ in range(40):
        motion = solve_step(robot, levels, [JointRange(robot), Velocity(robot, 2.0)], 0.05, damping=0.0)
        assert motion.step.certificate.holds, motion.step.certificate
        stopped += len(motion.step.active_rows)
        robot.integrate(motion.velocity, 0.05)
    assert stopped > 40


def test_reach_says_which_joint_is_at_its_stop():
    robot = bent_arm()
    turned = Posture(robot, [0.3, 0.5, 0.2, -0.4, 0.1, 0.6, 0.0], gain=0.5)
    end = reach(robot, [turned], [JointRange(robot)])
    assert end.ending is Ending.STUCK, str(end)
    assert end.held_by == ("elbow lower",)
    assert end.nearest == pytest.approx(0.4, abs=1e-6)


BAD = {
    "dt": (lambda robot: solve_step(robot, [Posture(robot)], dt=0.0), "dt is 0.0"),
    "no task": (lambda robot: solve_step(robot, [3]), "levels hold 3"),
    "no list of limits": (
        lambda robot: solve_step(robot, [Posture(robot)], JointRange(robot)),
        "expected a list of limits",
    ),
    "no limit": (lambda robot: solve_step(robot, [Posture(robot)], [3]), "limits hold 3"),
    "unknown joint": (lambda robot: Velocity(robot, {"knee": 1.0}), "there is no joint 'knee'"),
    "speed": (lambda robot: Velocity(robot, -1.0), "fastest is -1.0"),
    "unknown geom": (lambda robot: Collision(robot, [("hat", "table")]), "there is no geom 'hat'.*: hand"),
    "same body": (lambda robot: Collision(robot, [("table", "post")]), "no two geoms that a joint moves"),
    "margin": (lambda robot: JointRange(robot, margin=3.0), "more than half the range"),
    "outside": (lambda robot: JointRange(robot, outside="ignore"), "unknown outside 'ignore'"),
    "another model": (lambda robot: solve_step(robot, [Posture(robot)], [JointRange(_outside())]), "another model"),
    "example": (lambda robot: example("dog"), "unknown example 'dog'"),
}


@pytest.mark.parametrize(("ask", "message"), BAD.values(), ids=BAD.keys())
def test_bad_input_is_one_clear_message(ask, message):
    with pytest.raises(InputError, match=message):
        ask(bent_arm())


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("weights", np.array([1.0, -1.0, 1.0]), r"weights of level 'position of tool'\[1\] is -1.0"),
        ("gain", np.nan, "target of level 'position of tool'.* is nan"),
    ],
)
def test_what_a_task_was_given_after_it_was_made_is_checked_too(field, value, message):
    robot = bent_arm()
    task = Position(robot, robot.q[:3], site="tool")
    setattr(task, field, value)
    with pytest.raises(InputError, match=message):
        solve_step(robot, [task], [JointRange(robot)], DT)


def test_jacobians_of_a_users_task_stay_theirs():
    robot = bent_arm()

    class Kept(Position):
        def _rows(self, robot):
            self.rows_given = super()._rows(robot)
            return self.rows_given

    task = Kept(robot, site="tool")
    solve_step(robot, [task], [], DT)
    task.rows_given[0][:] = 0.0
