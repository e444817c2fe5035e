"""Robots as people have them: bases that drive, models without names, several in one process, tasks of nothing."""

import mujoco
import numpy as np
import pytest

from prioritized_ik import (
    CentreOfMass,
    Collision,
    JointRange,
    Orientation,
    Position,
    Posture,
    Robot,
    Task,
    Velocity,
    example,
    solve_step,
)

DT = 0.01

#: A base that drives and turns, and an arm of three hinges and a telescope on it, in metres times `unit`.
MOBILE = """
<mujoco><compiler angle="radian"/><worldbody><body name="base" pos="0 0 {u02}">
<joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/><joint name="yaw" axis="0 0 1"/>
<geom type="box" size="{u03} {u02} {u01}" mass="20"/>
<body pos="0 0 {u02}"><joint name="pitch" axis="0 1 0"/>
<geom type="capsule" size="{u003}" fromto="0 0 0 0 0 {u04}" mass="2"/>
<body pos="0 0 {u04}"><joint name="elbow" axis="0 1 0"/>
<geom type="capsule" size="{u003}" fromto="0 0 0 {u03} 0 0" mass="2"/>
<body pos="{u03} 0 0"><joint name="telescope" type="slide" axis="1 0 0"/>
<geom type="capsule" size="{u003}" fromto="0 0 0 {u02} 0 0" mass="1"/>
<body pos="{u02} 0 0"><joint name="wrist" axis="0 1 0"/><geom size="{u003}" mass="1"/><site name="hand" pos="{u01} 0 0"/>
</body></body></body></body></body></worldbody></mujoco>
"""
SLIDES = [0, 1, 5]


def _mobile(unit: float) -> Robot:
    lengths = {f"u{digits}": unit * float(f"{digits[0]}.{digits[1:]}") for digits in ("02", "03", "01", "04", "003")}
    robot = Robot(mujoco.MjModel.from_xml_string(MOBILE.format(**lengths)))
    q = np.array([0.3, -0.2, 0.5, 0.2, 0.4, 0.05, -0.3])
    q[SLIDES] *= unit
    robot.update(q)
    return robot


def _drawn(robot: Robot, unit: float) -> Position:
    hand = Position(robot, site="hand")
    hand.target = hand.target + unit * np.array([0.02, 0.01, -0.01])
    return hand


def test_the_metric_shares_a_motion_between_driving_and_turning_as_it_says():
    robot = _mobile(1.0)
    half = 0.5 * robot.model.stat.extent
    assert robot.metric == pytest.approx([1 / half**2, 1 / half**2, 1, 1, 1, 1 / half**2, 1])
    hand = _drawn(robot, 1.0)
    jacobian, error = hand.rows(robot)
    moved = solve_step(robot, [hand], damping=0.0, accuracy=None).velocity * DT
    # The least (dθᵀ M dθ) of all that reach, by the normal equations.
    inverse = np.diag(1.0 / robot.metric)
    assert moved == pytest.approx(inverse @ jacobian.T @ np.linalg.solve(jacobian @ inverse @ jacobian.T, error))
    assert np.abs(moved - np.linalg.pinv(jacobian) @ error).max() > 1e-3  # which the plain norm would share otherwise


def test_a_robot_modelled_in_millimetres_makes_the_same_steps():
    velocities = []
    for unit in (1.0, 1000.0):
        robot = _mobile(unit)
        slow = {"x": unit * 0.5, "y": unit * 0.5, "telescope": unit * 0.1, "yaw": 0.3, "pitch": 0.3, "elbow": 0.3}
        levels = [_drawn(robot, unit), Orientation(robot, np.eye(3), site="hand"), Posture(robot)]
        each = [solve_step(robot, levels, [Velocity(robot, slow)], damping=0.0, accuracy=None).velocity]
        robot.integrate(each[0], DT)
        each.append(solve_step(robot, levels[:1], [], damping=0.0, accuracy=None).velocity)
        for velocity in each:
            velocity[SLIDES] /= unit
        velocities.append(np.array(each))
    assert np.abs(velocities[0]).max() > 0.1
    assert velocities[1] == pytest.approx(velocities[0], rel=1e-6, abs=1e-9)


class _Nothing(Task):
    """A task of no rows."""

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot, 0, "nothing")

    def _rows(self, robot: Robot) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros((0, robot.model.nv)), np.zeros(0)


@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_task_without_rows_changes_nothing_wherever_it_stands(place):
    robot = _mobile(1.0)
    levels = [_drawn(robot, 1.0), Posture(robot, robot.q + 0.1)]
    expected = solve_step(robot, levels, [JointRange(robot)]).velocity
    with_nothing = [*levels[:place], _Nothing(robot), *levels[place:]]
    assert solve_step(robot, with_nothing, [JointRange(robot)]).velocity == pytest.approx(expected, abs=1e-9)
    beside = [[level, _Nothing(robot)] for level in levels]
    assert solve_step(robot, beside, [JointRange(robot)]).velocity == pytest.approx(expected, abs=1e-9)


def test_the_posture_of_a_body_that_only_floats_has_no_row_and_asks_for_nothing():
    robot = Robot(
        mujoco.MjModel.from_xml_string("<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>")
    )
    assert Posture(robot).size == 0
    assert not solve_step(robot, [Posture(robot)]).velocity.any()
    moved = solve_step(robot, [Posture(robot), CentreOfMass(robot, [0.01, 0.0, 0.0])], damping=0.0).velocity * DT
    assert moved[:3] == pytest.approx([0.01, 0.0, 0.0])


def test_several_models_in_one_process_do_not_meet():
    def make(name: str) -> tuple[Robot, list[Task], list]:
        robot = _mobile(1.0) if name == "mobile" else example(name)
        task = CentreOfMass(robot)
        task.target = task.target + 0.02
        return robot, [task, Posture(robot)], [JointRange(robot), Velocity(robot, 2.0)]

    names, alone = ("arm", "humanoid", "mobile", "arm"), []
    for name in names:
        robot, levels, limits = make(name)
        for _ in range(5):
            robot.integrate(solve_step(robot, levels, limits, DT).velocity, DT)
        alone.append(robot.q)
    together = [make(name) for name in names]
    for _ in range(5):
        for robot, levels, limits in together:
            robot.integrate(solve_step(robot, levels, limits, DT).velocity, DT)
    assert all((robot.q == q).all() for (robot, _, _), q in zip(together, alone, strict=True))


def test_geoms_without_names_are_kept_apart_and_told_apart_by_number():
    robot = _mobile(1.0)
    limit = Collision(robot, "self", margin=1.0)
    assert not any(robot.model.geom(geom).name for geom in range(robot.model.ngeom))
    names = limit.at(robot, DT).rows.names
    assert {name.partition(", ")[0] for name in names} == {f"geom {one} near geom {other}" for one, other in limit.pairs}
    assert len(set(names)) == len(names)
    assert limit.at(robot, DT).rows.upper.shape == (len(names),)
