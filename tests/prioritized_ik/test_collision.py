"""The distance's gradient against differences of the distance itself, for every shape that MuJoCo measures."""

import mujoco
import numpy as np
import pytest

from prioritized_ik import Collision, InputError, Robot, example

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
    assert rows.upper[0] == pytest.approx(limit.distances(robot)[0])
    assert rows.upper.min() == rows.upper[0]  # the other ends of edges are no nearer
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
    assert rows.matrix == pytest.approx(np.full((5, 1), -1.0), abs=1e-6)


def _box_over_floor(tilt: float) -> Robot:
    robot = Robot(
        mujoco.MjModel.from_xml_string(
            '<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1"/><body pos="0 0 0.2"><freejoint/>'
            '<geom name="box" type="box" size="0.1 0.2 0.05"/></body></worldbody></mujoco>'
        )
    )
    robot.integrate([0.0, 0.0, -0.1, tilt, 0.0, 0.0], 1.0)
    return robot


@pytest.mark.parametrize(("tilt", "ends"), [(0.0, 4), (0.01, 4), (0.2, 2)])
def test_a_face_that_meets_another_nearly_flat_has_a_row_at_every_corner(tilt, ends):
    robot = _box_over_floor(tilt)
    limit = Collision(robot, [("box", "floor")], margin=0.1)
    rows = limit.at(robot, 0.01).rows
    corners = np.array([[x, y, -0.05] for x in (-0.1, 0.1) for y in (-0.2, 0.2)])
    geom = robot.frame(geom="box")
    heights = np.sort((corners @ robot.rotation(geom).T + robot.position(geom))[:, 2])
    assert np.unique(rows.upper.round(9)) == pytest.approx(np.unique(heights[:ends].round(9)))
    assert np.linalg.matrix_rank(rows.matrix, tol=1e-9) == min(ends, 3)


def test_the_row_of_an_end_tells_where_the_corner_goes():
    robot = _box_over_floor(0.01)
    limit = Collision(robot, [("box", "floor")], margin=0.1)
    rows = limit.at(robot, 0.01).rows
    turn = np.array([0.0, 0.0, 0.0, 0.001, 0.002, 0.0])
    expected = np.unique((rows.upper - rows.matrix @ turn).round(9))
    robot.integrate(turn, 1.0)
    geom = robot.frame(geom="box")
    corners = np.array([[x, y, -0.05] for x in (-0.1, 0.1) for y in (-0.2, 0.2)])
    heights = (corners @ robot.rotation(geom).T + robot.position(geom))[:, 2]
    assert expected == pytest.approx(np.sort(heights), abs=1e-6)


CHAIN = """
<mujoco><contact><exclude body1="a" body2="d"/></contact><worldbody>
<geom name="floor" type="plane" size="1 1 1" pos="0 0 -.5"/>
<body name="a"><joint/><geom name="a"/><geom name="picture" contype="0" conaffinity="0"/>
<body name="b"><joint/><geom name="b"/><body name="plate"><geom name="plate"/>
<body name="c"><joint/><geom name="c"/><body name="d"><joint/><geom name="d"/></body></body></body></body></body>
</worldbody><default><geom size="0.1"/></default></mujoco>
"""


def test_self_pairs_are_those_that_mujoco_lets_collide():
    robot = Robot(mujoco.MjModel.from_xml_string(CHAIN))
    names = robot.names("geom")
    pairs = {tuple(names[geom] for geom in pair) for pair in Collision(robot, "self").pairs}
    assert pairs == {("a", "c"), ("b", "d"), ("plate", "d")}  # a and d excluded, neighbours left out, "picture" masked
    with_floor = Collision(robot, [("self", "floor"), ("picture", "d")]).pairs
    assert {tuple(names[geom] for geom in pair) for pair in with_floor} == {
        *((name, "floor") for name in ("a", "b", "plate", "c", "d")),
        ("picture", "d"),  # asked for by name
    }


def test_mujoco_itself_finds_contacts_of_no_other_pairs():
    robot = Robot(mujoco.MjModel.from_xml_string(CHAIN))
    mujoco.mj_forward(robot.model, robot.data)  # all links in one place
    found = {tuple(sorted(pair)) for pair in robot.data.contact.geom.tolist()}
    assert found == {tuple(sorted(pair)) for pair in Collision(robot, "self").pairs}


def test_no_pair_within_reach_is_left_out_before_it_is_measured():
    robot = example("humanoid")
    limit = Collision(robot, [("self", "self"), ("self", "floor")], margin=0.1)
    random, near = np.random.default_rng(7), 0
    for _ in range(20):
        robot.update(robot.model.qpos0)
        robot.integrate(random.normal(size=robot.model.nv) * 0.5, 1.0)
        segment = np.zeros(6)
        every = [mujoco.mj_geomDistance(robot.model, robot.data, *pair, 0.1, segment) for pair in limit.pairs]
        assert limit.distances(robot) == pytest.approx(np.array(every), abs=1e-12)
        near += int(np.count_nonzero(np.array(every) < 0.1))
    assert 100 < near < 20 * len(limit.pairs) / 2


def test_pairs_that_are_none_are_refused():
    robot = example("humanoid")
    with pytest.raises(InputError, match="pairs is 'left hand'"):
        Collision(robot, "left hand")
    with pytest.raises(InputError, match="no two geoms that a joint moves"):
        Collision(robot, [("floor", "floor")])
