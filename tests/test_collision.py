"""The distance's gradient against differences of the distance itself, for every shape that MuJoCo measures."""

import mujoco
import numpy as np
import pytest

from prioritized_ik import Collision, Robot

SHAPES = {
    "sphere": 'type="sphere" size="0.1"',
    "capsule": 'type="capsule" size="0.05 0.1"',
    "box": 'type="box" size="0.1 0.07 0.05"',
    "ellipsoid": 'type="ellipsoid" size="0.1 0.07 0.05"',
    "cylinder": 'type="cylinder" size="0.05 0.1"',
    "mesh": 'type="mesh" mesh="wedge"',
    "plane": 'type="plane" size="1 1 1"',
}
XML = """
<mujoco><asset><mesh name="wedge" vertex="0 0 0  0.2 0 0  0 0.2 0  0 0 0.2"/></asset><worldbody>
<body pos="0 0 0.3"><joint type="slide" axis="1 0.2 0"/><joint type="ball" pos="0 0 0.1"/>
<geom type="{hand}" size="0.05 0.08 0.06" pos="0 0 -0.05" euler="20 30 40"/></body>
<body pos="0.03 0.02 0"><joint type="{other}" axis="1 0.1 0"/><geom {shape} euler="10 20 5" mass="1"/></body>
</worldbody></mujoco>
"""
STEP = 1e-6


def _differences(robot: Robot, limit: Collision) -> np.ndarray:
    start, changes = robot.q, []
    for direction in np.eye(robot.model.nv):
        ends = []
        for sign in (1.0, -1.0):
            robot.update(start)
            robot.integrate(sign * direction, STEP)
            ends.append(float(limit.distances(robot)[0]))
        changes.append((ends[0] - ends[1]) / (2.0 * STEP))
    robot.update(start)
    return np.array(changes)


@pytest.mark.parametrize("hand", ["capsule", "box"])
@pytest.mark.parametrize("shape", SHAPES)
def test_the_row_is_the_gradient_of_the_distance(shape, hand):
    moving = "hinge"
    text = XML.format(hand=hand, shape=SHAPES[shape], other=moving)
    if shape == "plane":  # only fixed bodies carry planes
        text = text.replace(f'<joint type="{moving}" axis="1 0.1 0"/>', "").replace(' mass="1"', "")
    robot = Robot(mujoco.MjModel.from_xml_string(text))
    limit = Collision(robot, [(0, 1)], margin=1.0)
    rows = limit.at(robot, 0.01).rows
    assert rows is not None
    assert rows.upper == pytest.approx(limit.distances(robot))
    assert -rows.matrix[0] == pytest.approx(_differences(robot, limit), abs=1e-4)
    assert np.abs(rows.matrix).max() > 0.01


def test_the_normal_of_two_boxes_that_touch_is_the_face_s():
    robot = Robot(
        mujoco.MjModel.from_xml_string(
            '<mujoco><worldbody><geom type="box" size="1 1 0.1"/><body pos="0.5 0.2 0.2"><joint type="slide"/>'
            '<geom type="box" size="0.1 0.1 0.1"/></body></worldbody></mujoco>'
        )
    )
    limit = Collision(robot, [(1, 0)])
    assert abs(limit.distances(robot)[0]) < 1e-6
    rows = limit.at(robot, 0.01).rows
    assert rows is not None
    assert rows.matrix == pytest.approx(np.array([[-1.0]]), abs=1e-6)
