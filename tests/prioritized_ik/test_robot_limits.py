"""Limits of velocity, acceleration and support: kept on the way, at stops, and by robots that move as a whole."""

import mujoco
import numpy as np
import pytest
from arms import bent_arm
from scipy.optimize import linprog

from prioritized_ik import (
    Acceleration,
    CentreOfMass,
    Collision,
    InfeasibleError,
    InputError,
    JointRange,
    Pose,
    Position,
    Posture,
    Robot,
    SupportPolygon,
    Velocity,
    example,
    solve_step,
)
from prioritized_ik.tasks.turns import turned

DT = 0.01
GREATEST = 4.0  # [rad/s²]


def _run(robot, levels, limits, steps):
    """Velocities `(steps + 1, nv)` from rest on."""
    velocities = [robot.velocity]
    for _ in range(steps):
        robot.integrate(solve_step(robot, levels, limits, DT).velocity, DT)
        velocities.append(robot.velocity)
    return np.array(velocities)


def test_a_joint_that_is_driven_to_its_stop_brakes_in_time_and_ends_on_it():
    robot = bent_arm()
    stop = Posture(robot, [5.0, 5.0, 0.2, -5.0, 0.1, 0.6, 5.0])
    limits = [JointRange(robot), Velocity(robot, 3.0), Acceleration(robot, GREATEST)]
    velocities = _run(robot, [stop], limits, 400)
    assert np.abs(np.diff(velocities, axis=0) / DT).max() < GREATEST * (1.0 + 1e-6)
    assert np.abs(velocities).max() > 2.9
    low, high = robot.model.jnt_range.T
    assert robot.q[[0, 1, 6]] == pytest.approx(high[[0, 1, 6]], abs=1e-4)
    assert robot.q[3] == pytest.approx(low[3], abs=1e-4)


def test_without_the_limit_the_same_joint_stops_at_once():
    robot = bent_arm()
    stop = Posture(robot, [5.0, 5.0, 0.2, -5.0, 0.1, 0.6, 5.0])
    velocities = _run(robot, [stop], [JointRange(robot), Velocity(robot, 3.0)], 400)
    assert np.abs(np.diff(velocities, axis=0) / DT).max() > 100.0


def test_acceleration_by_joint_leaves_the_others_free():
    robot = bent_arm()
    names = robot.names("joint")
    limit = Acceleration(robot, {names[0]: 1.0, names[3]: 2.0})
    velocities = _run(robot, [Posture(robot, robot.q + 0.5)], [limit], 1)
    assert velocities[1, [0, 3]] == pytest.approx([0.01, 0.02])
    assert velocities[1, [1, 2, 4, 5, 6]] == pytest.approx(np.full(5, 50.0))


def test_a_moving_arm_that_meets_an_object_stops_there_whatever_its_acceleration():
    robot = bent_arm()
    table = Collision(robot, [("hand", "table")])
    down = Position(robot, robot.position(robot.frame(site="tool")) - [0.0, 0.0, 0.6], site="tool")
    limits = [table, Velocity(robot, 2.0), Acceleration(robot, 0.5)]
    velocities = _run(robot, [down], limits, 300)
    assert table.distances(robot)[0] > -2e-4
    assert np.abs(np.diff(velocities, axis=0) / DT).max() > 0.5  # the object came first


def test_a_floating_base_keeps_its_speeds_and_accelerations():
    robot = example("humanoid")
    moved = np.eye(4)
    moved[:3, 3] = [2.0, 1.0, 0.5]
    pelvis = Pose(robot, moved, body="pelvis")
    pelvis.target = moved @ np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    limits = [Velocity(robot, 2.0, base=(0.5, 0.8)), Acceleration(robot, 5.0, base=(2.0, 3.0))]
    velocities = _run(robot, [pelvis], limits, 80)
    assert np.abs(velocities[:, :3]).max() == pytest.approx(0.5)
    assert np.abs(velocities[:, 3:6]).max() == pytest.approx(0.8)
    changes = np.abs(np.diff(velocities, axis=0) / DT)
    assert changes[:, :3].max() == pytest.approx(2.0)
    assert changes[:, 3:6].max() == pytest.approx(3.0)


SOLES = ("left foot", "right foot")


def _feet(robot):
    """The box geoms of the feet."""
    boxes = [g for g in range(robot.model.ngeom) if robot.model.geom_bodyid[g] in robot.bodies("* ankle")]
    return [robot.frame(geom=number) for number in boxes]


def _slopes(robot, limit):
    """Derivative of the distance from every edge by every joint `(edges, nv)`."""
    start, ends = robot.q, []
    for sign in (1.0, -1.0):
        changed = []
        for direction in np.eye(robot.model.nv):
            robot.update(start)
            robot.integrate(sign * direction, 1e-6)
            changed.append(limit.at(robot, DT).rows.upper)
        ends.append(np.array(changed).T)
    robot.update(start)
    return (ends[0] - ends[1]) / 2e-6


def test_the_rows_of_the_support_polygon_are_the_gradient_of_the_distance():
    robot = example("humanoid")
    robot.integrate(np.random.default_rng(3).normal(size=robot.model.nv) * 0.1, 1.0)
    limit = SupportPolygon(robot, _feet(robot))
    rows = limit.at(robot, DT).rows
    assert len(rows.names) == 6  # the corners between the feet are inside
    assert -_slopes(robot, limit) == pytest.approx(rows.matrix, abs=1e-7)


#: Feet of every kind, at several heights, on a body that moves freely beside a heavy thing that does not.
FEET = """
<mujoco><compiler angle="radian"/><worldbody><body name="rock" pos="3 0 0"><geom size="0.5"/></body>
<body name="trunk" pos="0 0 0.5"><freejoint/><geom size="0.1"/>
<body pos="0.3 0.2 -0.3" euler="0.1 0.2 0.3"><joint axis="0 1 0"/><geom name="box" type="box" size="0.05 0.04 0.02"/></body>
<body pos="-0.3 0.2 -0.2"><joint axis="1 0 0"/><geom name="ball" size="0.06"/></body>
<body pos="-0.1 -0.3 -0.4" euler="1.2 0.3 0"><joint axis="1 1 0"/><geom name="rod" type="capsule" size="0.03 0.08"/></body>
<body pos="0.2 -0.2 -0.1"><joint type="slide" axis="1 0 1"/><geom size="0.02"/><site name="tip"/></body>
</body></worldbody></mujoco>
"""
ON_FEET = ({"geom": "box"}, {"geom": "ball"}, {"geom": "rod"}, {"site": "tip"})


def _on_feet(**options) -> tuple[Robot, SupportPolygon]:
    robot = Robot(mujoco.MjModel.from_xml_string(FEET))
    robot.integrate(np.random.default_rng(5).normal(size=robot.model.nv) * 0.1, 1.0)
    return robot, SupportPolygon(robot, [robot.frame(**which) for which in ON_FEET], **options)


@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (0.2, -0.3, 0.9), (0.0, 0.0, -1.0)])
@pytest.mark.parametrize("lean", [(0.0, 0.0, 0.0), (0.3, 0.2, 0.0)])
def test_on_uneven_and_tilted_ground_the_rows_are_the_gradient_of_the_distance_too(up, lean):
    robot, limit = _on_feet(up=up, ground=np.add(up, lean))
    rows = limit.at(robot, DT).rows
    assert len(rows.names) >= 4
    assert -_slopes(robot, limit) == pytest.approx(rows.matrix, abs=1e-7)


@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (0.2, -0.3, 0.9), (0.0, 0.0, -1.0)])
def test_a_centre_of_mass_is_inside_where_forces_along_gravity_can_carry_it(up):
    rng, inside = np.random.default_rng(6), 0
    robot = Robot(mujoco.MjModel.from_xml_string(FEET))
    sites = [robot.frame(site="tip"), *(robot.frame(body=number) for number in range(3, 6))]
    for _ in range(40):
        robot.update(robot.model.qpos0)
        robot.integrate(rng.normal(size=robot.model.nv), 1.0)
        points = np.array([robot.position(site) for site in sites]).T
        along = np.array(up) / np.linalg.norm(up)
        across = np.eye(3) - np.outer(along, along)
        centre = robot.data.subtree_com[robot.body("trunk")]
        balance = np.vstack([across @ points, np.ones(4)])  # the forces' torques, and their sum beside the weight
        carried = linprog(np.zeros(4), A_eq=balance, b_eq=[*(across @ centre), 1.0], bounds=(0, None)).status == 0
        inside += carried
        assert (SupportPolygon(robot, sites, up=up).distance(robot) >= 0.0) == carried
    assert 5 < inside < 35


def test_turned_with_its_gravity_the_world_is_the_same():
    robot, limit = _on_feet()
    distance, rows = limit.distance(robot), limit.at(robot, DT).rows
    turn = turned(np.eye(3), np.array([0.5, -0.4, 1.1]))
    model = mujoco.MjModel.from_xml_string(FEET)
    model.opt.gravity[:] = turn @ model.opt.gravity
    q, quaternion = robot.q, np.empty(4)
    mujoco.mju_mat2Quat(quaternion, turn.ravel())
    q[:3] = turn @ q[:3]
    mujoco.mju_mulQuat(q[3:7], quaternion, robot.q[3:7])
    there = Robot(model, q)
    tilted = SupportPolygon(there, [there.frame(**which) for which in ON_FEET])
    turned_rows = tilted.at(there, DT).rows
    assert tilted.distance(there) == pytest.approx(distance, abs=1e-12)
    order = [turned_rows.names.index(name) for name in rows.names]
    assert turned_rows.matrix[order, 3:] == pytest.approx(rows.matrix[:, 3:], abs=1e-12)
    assert turned_rows.matrix[order, :3] @ turn == pytest.approx(rows.matrix[:, :3], abs=1e-12)
    level = SupportPolygon(there, [there.frame(**which) for which in ON_FEET], up=[0, 0, 1])
    assert abs(level.distance(there) - distance) > 1e-2


def test_a_ball_on_a_slope_stands_below_its_centre_along_the_slopes_normal():
    text = '<mujoco><worldbody><body><freejoint/>{}<geom pos="0 0 1" size="0.1"/></body></worldbody></mujoco>'
    balls = [f'<geom name="{x} {y}" size="0.2" pos="{x} {y} {-0.5 * x}"/>' for x, y in ((-1, -1), (-1, 1), (1, -1), (1, 1))]
    robot = Robot(mujoco.MjModel.from_xml_string(text.format("".join(balls))))
    frames = [robot.frame(geom=number) for number in range(4)]
    level, slope = SupportPolygon(robot, frames), SupportPolygon(robot, frames, ground=[0.5, 0, 1])  # it falls along x
    centre = robot.data.subtree_com[1, 0]
    shift = 0.2 * 0.5 / np.sqrt(1.25)  # of the points, downhill's opposite
    assert level.distance(robot) == pytest.approx(1.0 - abs(centre))
    assert slope.room(robot)["support edge 1 -1 – 1 1"] == pytest.approx(1.0 - shift - centre)
    assert slope.room(robot)["support edge -1 1 – -1 -1"] == pytest.approx(1.0 + shift + centre)


@pytest.mark.parametrize("hard", [True, False])
def test_the_centre_of_mass_stays_above_the_feet_however_far_the_hands_are_drawn(hard):
    robot = example("humanoid")
    limit = SupportPolygon(robot, _feet(robot), margin=0.01, hard=hard)
    feet = [Pose(robot, site=name) for name in SOLES]
    hands = [Position(robot, site=f"{side} hand", gain=0.1) for side in ("left", "right")]
    for hand in hands:
        hand.target = hand.target + np.array([0.8, 0.0, 0.0])
    nearest = []
    for _ in range(200):
        robot.integrate(solve_step(robot, [feet, hands], [limit, JointRange(robot), Velocity(robot, 2.0)], DT).velocity, DT)
        nearest.append(limit.distance(robot))
    assert min(nearest) > 0.01 - 1e-4
    assert nearest[-1] == pytest.approx(0.01, abs=1e-4)


def test_a_soft_polygon_that_cannot_be_kept_does_not_slow_the_robot():
    robot = example("humanoid")
    soft = SupportPolygon(robot, _feet(robot), margin=0.3, hard=False)  # more than there is
    ahead = CentreOfMass(robot)
    ahead.target = ahead.target + np.array([0.05, 0.0, 0.0])
    limits = [soft, Velocity(robot, 2.0, base=(1.0, 1.0))]
    curved, straight = (solve_step(robot, [ahead], limits, DT, accuracy=accuracy).velocity for accuracy in (1e-4, None))
    assert np.linalg.norm(straight) > 0.1
    assert curved == pytest.approx(straight, abs=0.1)


def test_without_the_limit_it_leaves_them():
    robot = example("humanoid")
    limit = SupportPolygon(robot, _feet(robot))
    feet = [Pose(robot, site=name) for name in SOLES]
    hands = [Position(robot, site=f"{side} hand", gain=0.1) for side in ("left", "right")]
    for hand in hands:
        hand.target = hand.target + np.array([0.8, 0.0, 0.0])
    _run(robot, [feet, hands], [JointRange(robot), Velocity(robot, 2.0)], 200)
    assert limit.distance(robot) < -0.01


def _leaning() -> tuple[Robot, SupportPolygon]:
    robot = example("humanoid")
    ahead = CentreOfMass(robot)
    ahead.target = ahead.target + np.array([0.12, 0.0, 0.0])
    feet = [Pose(robot, site=name) for name in SOLES]
    _run(robot, [feet, ahead], [JointRange(robot), Velocity(robot, 2.0)], 100)
    return robot, SupportPolygon(robot, _feet(robot))


def test_a_centre_of_mass_outside_comes_back_at_a_bounded_speed():
    robot, limit = _leaning()
    outside = limit.distance(robot)
    assert outside < -0.01
    feet = [Pose(robot, site=name) for name in SOLES]
    _run(robot, [feet, Posture(robot)], [limit], 1)
    assert limit.distance(robot) == pytest.approx(outside + 0.5 * DT, abs=2e-4)
    _run(robot, [feet, Posture(robot)], [limit], 30)
    assert limit.distance(robot) > -1e-4


def test_outside_raise_tells_by_how_much():
    robot, limit = _leaning()
    with pytest.raises(
        InputError, match=rf"the centre of mass is {limit.distance(robot):.6g} m inside the support polygon"
    ):
        solve_step(robot, [Posture(robot)], [SupportPolygon(robot, _feet(robot), outside="raise")])


RAIL = """
<mujoco><compiler angle="radian"/><worldbody><geom name="wall" type="box" size="0.1 1 1" pos="1 0 0"/>
<body name="cart"><joint name="rail" type="slide" axis="1 0 0" limited="true" range="-1 {high}"/>
<geom name="bumper" size="0.1"/></body></worldbody></mujoco>
"""


def _on_rail(high: float, place: float) -> Robot:
    return Robot(mujoco.MjModel.from_xml_string(RAIL.format(high=high)), [place])


def test_a_way_back_that_is_required_is_hard_and_bounded():
    robot = _on_rail(0.5, 0.6)
    rows = JointRange(robot, outside="require", return_speed=0.3)
    assert rows.at(robot, DT).bounds.upper == pytest.approx([-0.003])
    assert not rows.at(robot, DT).recovery
    away = Posture(robot, [2.0])
    _run(robot, [away], [rows], 60)
    assert robot.q == pytest.approx([0.5])


def test_required_ways_back_that_exclude_each_other_are_named_and_soft_ones_compromise():
    robot = _on_rail(2.0, 0.85)  # 5 cm deep in the wall, and beyond a range that ends on its other side
    robot.model.jnt_range[0] = [0.9, 2.0]
    hard = [Collision(robot, [("bumper", "wall")], outside="require"), JointRange(robot, outside="require")]
    with pytest.raises(InfeasibleError, match=r"rail.*bumper near wall|bumper near wall.*rail"):
        solve_step(robot, [Posture(robot)], hard)
    soft = [Collision(robot, [("bumper", "wall")]), JointRange(robot)]
    assert np.abs(solve_step(robot, [Posture(robot)], soft).velocity).max() < 1e-6


def _standing(robot, **options):
    return SupportPolygon(robot, [robot.frame(body=number) for number in (1, 4, 6)], **options)


def _without_gravity():
    robot = bent_arm()
    robot.model.opt.gravity[:] = 0.0
    return robot


BAD = {
    "acceleration": (lambda robot: Acceleration(robot, -1.0), "greatest is -1.0"),
    "acceleration of a joint": (lambda robot: Acceleration(robot, {"elbow": 0.0}), "greatest of elbow is 0.0"),
    "unknown joint": (lambda robot: Acceleration(robot, {"knee*": 1.0}), r"there is no joint 'knee\*'"),
    "too many speeds": (lambda robot: Velocity(robot, {"elbow": [1.0, 2.0]}), r"elbow has shape \(2,\); expected \(1,\)"),
    "base": (lambda robot: Velocity(robot, 1.0, base=3.0), r"base of fastest has shape \(\); expected \(2,\)"),
    "points": (lambda robot: SupportPolygon(robot, ["tool"]), r"points is \['tool'\]; expected frames such as"),
    "two points": (lambda robot: SupportPolygon(robot, [robot.frame(site="tool"), robot.frame(body=1)]), "three that are"),
    "mesh": (
        lambda robot: SupportPolygon(robot, [robot.frame(geom="post")]),
        "no box, sphere or capsule; .* sites, which mark",
    ),
    "no up": (lambda robot: _standing(robot, up=[0, 0, 0]), "up is zero"),
    "ground overhead": (lambda robot: _standing(robot, ground=[0, 1, -1]), "does not face up"),
    "no gravity": (lambda robot: _standing(_without_gravity()), "the model has no gravity; give up, "),
    "two trees": (
        lambda robot: SupportPolygon(robot, [robot.frame(body=number) for number in (0, 1, 3)]),
        "points are on the trees of world, base; expected one, or body=",
    ),
}


@pytest.mark.parametrize(("ask", "message"), BAD.values(), ids=BAD.keys())
def test_bad_input_is_one_clear_message(ask, message):
    with pytest.raises(InputError, match=message):
        ask(bent_arm())
