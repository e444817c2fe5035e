"""Steps end where their rows say, to a tenth of a millimetre, though rows are of first order."""

import importlib.util
from pathlib import Path

import mujoco
import numpy as np
import pytest
from arms import bent_arm

from prioritized_ik import (
    Collision,
    InputError,
    JointRange,
    Pose,
    Position,
    Posture,
    Robot,
    SupportPolygon,
    Velocity,
    example,
    solve,
    solve_step,
)
from prioritized_ik.curvature import _scaled
from prioritized_ik.motion import build_problem

DT = 0.01
ACCURACY = 1e-4  # [m]

_wheel = importlib.util.find_spec("dm_control")
FOUND = Path(_wheel.submodule_search_locations[0]) if _wheel and _wheel.submodule_search_locations else None


def _crossing() -> tuple[Robot, list, list]:
    """An arm at 2 rad/s with a tool that is to stay where it is while it turns."""
    robot = bent_arm()
    swung = Posture(robot, robot.q + np.array([0.0, 0.0, 1.5, 0.0, 0.0, 0.0, 0.0]), gain=0.2)
    return robot, [Position(robot, site="tool"), swung], [JointRange(robot), Velocity(robot, 6.0)]


def _off(accuracy: float | None) -> float:
    robot, levels, limits = _crossing()
    worst = 0.0
    for _ in range(60):
        robot.integrate(solve_step(robot, levels, limits, DT, accuracy=accuracy).velocity, DT)
        worst = max(worst, float(np.linalg.norm(levels[0].rows(robot)[1])))
    return worst


def test_a_level_that_is_met_is_left_by_no_more_than_asked_on_the_way():
    assert _off(ACCURACY) < ACCURACY
    assert _off(1e-6) < 1e-6


def test_steps_of_first_order_leave_it():
    assert _off(None) > 3 * ACCURACY


def test_the_robot_is_where_it_was_to_the_bit():
    robot, levels, limits = _crossing()
    robot.integrate(np.linspace(0.1, 0.7, 7), DT)
    q, velocity, tool = robot.q, robot.velocity, robot.position(robot.frame(site="tool"))
    solve_step(robot, levels, limits, DT)
    assert (robot.q == q).all()
    assert (robot.velocity == velocity).all()
    assert (robot.position(robot.frame(site="tool")) == tool).all()


@pytest.mark.parametrize("name", ["arm", "humanoid"])
def test_the_curvature_of_a_step_is_within_its_stated_bound(name):
    robot, random = example(name), np.random.default_rng(11)
    metric, largest = np.sqrt(robot.metric), 0.0
    frames = [robot.frame(site=site) for site in range(robot.model.nsite)]
    for _ in range(200):
        robot.update(robot.model.qpos0)
        robot.integrate(random.normal(size=robot.model.nv), 1.0)
        step = 0.02 * random.normal(size=robot.model.nv) * (random.random(robot.model.nv) < 0.3)
        straight = [robot.position(frame) + robot.jacobians(frame)[0] @ step for frame in frames]
        robot.integrate(step, 1.0)
        bent = max(np.linalg.norm(robot.position(frame) - end) for frame, end in zip(frames, straight, strict=True))
        bound = 0.5 * robot.model.stat.extent * np.abs(metric * step).sum() ** 2
        largest = max(largest, bent / bound if bound else 0.0)
    assert 0.1 < largest < 1.0


def test_a_share_of_all_that_is_asked_has_that_share_of_the_step():
    robot, levels, limits = _crossing()
    problem = build_problem(robot, levels, [*limits, Collision(robot, [("hand", "table")], margin=2.0)], DT)
    whole = solve(problem).dtheta
    assert np.linalg.norm(whole) > 0.01
    assert solve(_scaled(problem, 0.25)).dtheta == pytest.approx(0.25 * whole, abs=1e-12)


def _walk(robot: Robot, limit: Collision, base: Pose, fastest: float, steps: int, accuracy: float | None) -> float:
    """The least that is left to any pair on a random walk, the targets of all joints and of the base drawn anew."""
    model, random = robot.model, np.random.default_rng(0)
    limits = [JointRange(robot), Velocity(robot, fastest, base=(1.0, 2.0)), limit]
    posture, home, least = Posture(robot), base.target.copy(), np.inf
    scalar = np.flatnonzero(np.isin(model.jnt_type, (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)))
    for number in range(steps):
        if number % 20 == 0:
            q, moved = robot.q, home.copy()
            q[model.jnt_qposadr[scalar]] = random.uniform(*model.jnt_range[scalar].T)
            moved[:3, 3] += random.uniform(-0.3, 0.3, 3) - [0.0, 0.0, 0.4]
            posture.target, base.target = q, moved
        robot.integrate(solve_step(robot, [[base, posture]], limits, DT, accuracy=accuracy).velocity, DT)
        least = min(least, *limit.room(robot).values(), np.inf)
    return least


@pytest.mark.skipif(FOUND is None, reason="dm_control is not installed")
@pytest.mark.parametrize("fastest", [2.0, 5.0])
def test_a_humanoid_on_a_random_walk_of_2000_steps_keeps_off_itself_and_the_ground(fastest):
    assert FOUND is not None
    robot = Robot(FOUND / "suite" / "humanoid.xml")
    limit = Collision(robot, [("self", "self"), ("self", "floor")])
    assert len(limit.pairs) > 150
    least = _walk(robot, limit, Pose(robot, body="torso"), fastest, 2000, ACCURACY)
    assert -ACCURACY <= least < 0.0


def test_our_own_humanoid_with_boxes_for_feet_does_too():
    robot = example("humanoid")
    limit = Collision(robot, [("self", "self"), ("self", "floor")], min_distance=0.002)
    assert _walk(robot, limit, Pose(robot, body="pelvis"), 3.0, 500, ACCURACY) >= -ACCURACY


def test_steps_of_first_order_do_not_keep_off():
    robot = example("humanoid")
    limit = Collision(robot, [("self", "self"), ("self", "floor")], min_distance=0.002)
    assert _walk(robot, limit, Pose(robot, body="pelvis"), 3.0, 500, None) < -2 * ACCURACY


def test_a_limited_ball_joint_and_a_support_polygon_are_not_left_by_curvature():
    text = (
        '<mujoco><compiler angle="radian"/><worldbody><body><joint name="ball" type="ball" limited="true" range="0 0.8"/>'
        '<geom size="0.1"/></body></worldbody></mujoco>'
    )
    robot = Robot(mujoco.MjModel.from_xml_string(text))
    limits, target = [JointRange(robot), Velocity(robot, 5.0)], Posture(robot)
    for angle in np.linspace(0.0, 6.0, 120):
        target.target = [np.cos(0.6), np.sin(0.6) * np.cos(angle), np.sin(0.6) * np.sin(angle), 0.0]
        robot.integrate(solve_step(robot, [target], limits, DT).velocity, DT)
        assert 2.0 * np.arccos(robot.q[0]) < 0.8 + ACCURACY
    assert 2.0 * np.arccos(robot.q[0]) > 0.79
    human = example("humanoid")
    support = SupportPolygon(
        human, [human.frame(site=s) for s in ("left foot", "right foot")] + [human.frame(body="pelvis")]
    )
    assert set(support.room(human)) == set(support.at(human, DT).rows.names)


def test_an_accuracy_that_is_none_is_refused():
    robot, levels, _ = _crossing()
    with pytest.raises(InputError, match="accuracy is 0"):
        solve_step(robot, levels, accuracy=0)
