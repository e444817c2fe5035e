"""The model's own equalities: closed loops, welds and couplings stay closed over many steps, and drift is taken back."""

import mujoco
import numpy as np
import pytest

from prioritized_ik import InputError, JointRange, ModelEqualities, Position, Posture, Robot, Velocity, reach, solve_step

DT = 0.01

#: A four-bar linkage in the plane, cut at its last joint: two of the connect's three rows count.
FOUR_BAR = """
<mujoco><compiler angle="radian"/><equality><connect name="pin" body1="rocker" body2="coupler" anchor="0 0 0.3"/></equality>
<default><geom size="0.01" mass="1"/></default>
<worldbody><body name="crank"><joint name="crank" axis="0 1 0"/><geom/>
<body name="coupler" pos="0 0 0.2"><joint name="knee" axis="0 1 0"/><geom/>
<site name="middle" pos="0.2 0 0.05"/></body></body>
<body name="rocker" pos="0.4 0 0"><joint name="rocker" axis="0 1 0"/><geom/></body></worldbody></mujoco>
"""

#: Everything that MuJoCo couples, between joints of every kind.
ALL = """
<mujoco><compiler angle="radian"/><default><geom size="0.05" mass="1"/></default><worldbody>
<body name="base" pos="0 0 1"><freejoint name="float"/><geom/>
<body name="a" pos="0.1 0.2 0"><joint name="slide" type="slide" axis="1 2 0.5"/><geom/>
<body name="b" pos="0 0.1 0.3"><joint name="hinge" axis="0.3 1 0.2"/><geom/></body></body>
<body name="c" pos="0.2 0 0"><joint name="ball" type="ball"/><geom/><site name="s" pos="0 0 0.1"/>
<body name="d" pos="0 0 0.3"><joint name="turn" axis="1 0 0"/><geom/><site name="t" pos="0 0.2 0.1"/></body></body></body>
<body name="e" pos="0.4 0.1 1"><joint name="post" axis="0 1 1"/><geom/></body>
</worldbody>
<tendon><fixed name="cable"><joint joint="slide" coef="0.7"/><joint joint="turn" coef="-0.4"/></fixed>
<spatial name="string"><site site="s"/><site site="t"/></spatial></tendon>
<equality><connect name="pin" body1="b" body2="d" anchor="0.1 0 0.2"/>
<weld name="glue" body1="c" body2="e" torquescale="2"/>
<joint name="gear" joint1="hinge" joint2="turn" polycoef="0.1 0.5 0.3 0 0"/>
<tendon name="rope" tendon1="cable" tendon2="string" polycoef="0 1 0 0 0"/>
<connect name="loose" body1="b" body2="e" anchor="0 0 0" active="false"/></equality></mujoco>
"""


def _robot(text: str, seed: int | None = None) -> Robot:
    robot = Robot(mujoco.MjModel.from_xml_string(text))
    if seed is not None:
        robot.integrate(np.random.default_rng(seed).normal(size=robot.model.nv) * 0.3, 1.0)
    return robot


def _closed() -> tuple[Robot, ModelEqualities]:
    robot = _robot(FOUR_BAR, 1)
    limit = ModelEqualities(robot)
    for _ in range(100):
        robot.integrate(solve_step(robot, [], [limit], DT).velocity, DT)
    assert max(limit.drift(robot).values()) < 1e-9
    return robot, limit


def _rows(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """The rows, and c as MuJoCo has it."""
    matrix = ModelEqualities(robot).at(robot, DT).equalities.matrix
    return matrix, robot.data.efc_pos[robot.data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY].copy()


@pytest.mark.parametrize("jacobian", ["dense", "sparse"])
def test_the_rows_are_the_derivative_of_what_is_open_on_every_kind_of_joint(jacobian):
    robot = _robot(ALL.replace("<mujoco>", f'<mujoco><option jacobian="{jacobian}"/>'), 4)
    matrix, _ = _rows(robot)
    start, columns = robot.q, []
    for direction in np.eye(robot.model.nv):
        ends = []
        for sign in (1.0, -1.0):
            robot.update(start)
            robot.integrate(sign * direction, 1e-6)
            ends.append(_rows(robot)[1])
        columns.append((ends[0] - ends[1]) / 2e-6)
    assert len(matrix) == 3 + 6 + 1 + 1  # the inactive one is left out
    assert np.array(columns).T == pytest.approx(matrix, abs=1e-7)


def test_every_kind_is_named_and_closes_from_afar():
    robot = _robot(ALL, 4)
    limit = ModelEqualities(robot)
    assert set(limit.drift(robot)) == {"connect pin", "weld glue", "joint gear", "tendon rope"}
    assert max(limit.drift(robot).values()) > 0.1
    for _ in range(400):
        robot.integrate(solve_step(robot, [], [limit], DT).velocity, DT)
    assert max(limit.drift(robot).values()) < 1e-9


def _round_and_round(accuracy: float | None, speed: float) -> float:
    """The most that a four-bar linkage is open while its crank turns three times."""
    robot, limit = _closed()
    crank, worst, turned = Posture(robot, weights={"crank": 1.0}), 0.0, robot.q[0]
    while robot.q[0] - turned < 19.0:
        crank.target = robot.q + np.array([speed * DT, 0.0, 0.0])
        robot.integrate(solve_step(robot, [crank], [limit], DT, accuracy=accuracy).velocity, DT)
        worst = max(worst, *limit.drift(robot).values())
    return worst


@pytest.mark.parametrize("accuracy", [1e-4, 1e-6])
def test_a_loop_that_is_turned_round_and_round_opens_by_no_more_than_a_tenth_of_the_accuracy(accuracy):
    assert _round_and_round(accuracy, 5.0) <= 0.1 * accuracy


def test_steps_of_first_order_open_it_by_the_square_of_their_length():
    slow, fast = _round_and_round(None, 2.5), _round_and_round(None, 5.0)
    assert 4e-4 < fast < 6e-4  # [m]
    assert fast / slow == pytest.approx(4.0, rel=0.05)


def test_everything_that_is_coupled_stays_so_while_a_robot_wanders():
    robot = _robot(ALL, 4)
    limit, rng, posture = ModelEqualities(robot), np.random.default_rng(0), Posture(robot)
    for _ in range(400):
        robot.integrate(solve_step(robot, [], [limit], DT).velocity, DT)
    limits, worst = [limit, Velocity(robot, 5.0, base=(5.0, 5.0))], 0.0
    for number in range(90):
        if number % 30 == 0:
            velocity = 5.0 * rng.normal(size=robot.model.nv)
        target = robot.q
        mujoco.mj_integratePos(robot.model, target, velocity, DT)
        posture.target = target
        robot.integrate(solve_step(robot, [posture], limits, DT).velocity, DT)
        assert np.linalg.norm(robot.velocity) > 0.5
        worst = max(worst, *limit.drift(robot).values())
    assert worst <= 1e-5


def test_a_linkage_that_is_driven_against_its_dead_point_stays_closed():
    robot, limit = _closed()
    rocker, worst, start = Posture(robot, weights={"rocker": 1.0}), 0.0, robot.q[2]
    for _ in range(100):
        rocker.target = robot.q + np.array([0.0, 0.0, 0.02])
        robot.integrate(solve_step(robot, [rocker], [limit, Velocity(robot, 20.0)], DT).velocity, DT)
        worst = max(worst, *limit.drift(robot).values())
    assert 0.5 < robot.q[2] - start < 0.7
    assert worst <= 1e-4


def test_without_the_limit_the_loop_opens():
    robot, limit = _closed()
    crank = Posture(robot, robot.q + np.array([0.5, 0.0, 0.0]), weights={"crank": 1.0})
    reach(robot, [crank], dt=DT)
    assert max(limit.drift(robot).values()) > 0.05


def test_a_loop_driven_against_a_stop_stays_closed_and_says_who_holds_it():
    robot, limit = _closed()
    here = robot.q[2]
    robot.model.jnt_limited[2], robot.model.jnt_range[2] = 1, [here - 0.2, here + 0.2]
    middle = Position(robot, site="middle", gain=0.2)
    middle.target = middle.target + np.array([0.4, 0.0, 0.0])
    end = reach(robot, [middle], [limit, JointRange(robot), Velocity(robot, 2.0)])
    assert "rocker upper" in end.held_by, str(end)
    assert max(limit.drift(robot).values()) < 1e-7


def test_an_open_loop_closes_at_a_bounded_speed_stays_as_it_is_or_is_an_error():
    robot = _robot(FOUR_BAR, 1)
    step = solve_step(robot, [], [ModelEqualities(robot, return_speed=0.1)], DT).velocity
    assert 0.05 < np.linalg.norm(step) < 0.1 * np.sqrt(2.0) + 1e-9  # a speed for each of two directions
    assert np.abs(solve_step(robot, [], [ModelEqualities(robot, outside="hold")], DT).velocity).max() < 1e-12
    with pytest.raises(InputError, match=r"connect pin is open by 0\.\d+, more than tolerance, 0\.001; close it first"):
        solve_step(robot, [], [ModelEqualities(robot, outside="raise")], DT)


def test_drift_within_the_tolerance_is_no_error_and_taken_back_in_one_step():
    robot, _ = _closed()
    robot.integrate([1e-4, 0.0, 0.0], 1.0)
    limit = ModelEqualities(robot, outside="raise")
    assert 1e-5 < limit.drift(robot)["connect pin"] < 1e-3
    robot.integrate(solve_step(robot, [], [limit], DT).velocity, DT)
    assert limit.drift(robot)["connect pin"] < 1e-8


def test_a_model_without_equalities_is_refused():
    robot = _robot('<mujoco><worldbody><body><joint/><geom size="1"/></body></worldbody></mujoco>')
    with pytest.raises(InputError, match="the model has 0 equalities, none of them active"):
        ModelEqualities(robot)
