"""Links that press on an object, start in it or step further than its margin, kept out by `contact_rows`."""

import mujoco
import numpy as np
import pytest

import prioritized_ik as pik

ARM = """<mujoco><compiler angle="radian"/><worldbody>
<geom name="object" type="sphere" size=".15" pos=".45 0 -.05"/>
<body pos="0 0 .25"><joint axis="0 1 0" range="-2.5 2.5"/><geom name="g1" type="capsule" fromto="0 0 0 .3 0 0" size=".02"/>
<body pos=".3 0 0"><joint axis="0 1 0" range="-2.5 2.5"/><geom name="g2" type="capsule" fromto="0 0 0 .3 0 0" size=".02"/>
<body pos=".3 0 0"><joint axis="0 1 0" range="-2.5 2.5"/><geom name="g3" type="capsule" fromto="0 0 0 .15 0 0" size=".02"/>
<site name="hand" pos=".15 0 0"/></body></body></body></worldbody></mujoco>"""
INSIDE = np.array([0.55, -0.05])  # of the object: the hand's target
ABOVE, DEEP, FAR = np.array([-0.4, 0.9, 0.3]), np.array([-0.155, 0.9, 0.3]), np.array([-1.2, 0.2, 0.2])


def clearances(q: np.ndarray, steps: int, longest: float, damping: float = 0.05, **options: float) -> np.ndarray:
    """The least distance before each step `(steps,)` [m], negative in the object, of an arm drawn into it."""
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    sensor, hand = pik.TouchSensor(model, ["g1", "g2", "g3"]), pik.VirtualArms(model, ["hand"], axes="xz")
    method, found = pik.get_method("active-set"), []
    for _ in range(steps):
        pik.update_kinematics(model, data, q)
        touch = sensor.read(data)
        found.append(touch.distance.min())
        error = INSIDE - hand.positions(data)[0]
        error *= min(1.0, (0.01 if longest < 0.1 else 0.2) / np.linalg.norm(error))
        rows = np.vstack([hand.jacobian(data), damping * np.eye(3)])[: 5 if damping else 2]
        level = pik.Level(rows, [*error, 0.0, 0.0, 0.0][: len(rows)])
        bounds = pik.joint_range_bounds(model, q).intersect(pik.step_bounds(model, longest))
        contacts = pik.contact_rows(sensor, data, touch, **options)
        step = pik.solve(pik.IKProblem([level], bounds, contacts), method)
        assert step.certificate.holds
        q = q + step.dtheta
    return np.array(found)


@pytest.mark.parametrize("max_step", [0.05, 0.02, 0.005])
@pytest.mark.parametrize("min_distance", [0.0, 0.01])
def test_pressing_for_600_steps_a_link_comes_to_rest_at_the_surface(max_step, min_distance):
    found = clearances(ABOVE, 600, max_step, min_distance=min_distance)
    assert found[-1] == pytest.approx(min_distance, abs=1e-6)
    assert np.abs(np.diff(found[-50:])).max() < 1e-6


@pytest.mark.parametrize("max_step", [0.05, 0.02, 0.005])
def test_an_undamped_task_that_presses_does_not_sink_in(max_step):
    found = clearances(ABOVE, 600, max_step, damping=0.0)
    assert found.min() > -0.1 * max_step**2 - 1e-6  # the curvature of one step
    assert found[-1] > found[100] - 1e-6


def test_without_push_out_it_stays_as_deep_as_its_curvature_took_it():
    assert clearances(ABOVE, 600, 0.05, push_out=0.0, gain=1.0)[-1] < -5e-4


def test_a_link_40_mm_deep_comes_out_by_no_more_than_is_asked_of_a_step():
    found = clearances(DEEP, 200, 0.02)
    assert found[0] < -0.04
    assert np.diff(found).max() < 6e-3  # the curvature of a step, besides
    assert found[-1] == pytest.approx(0.0, abs=1e-6)


def test_links_that_come_fast_are_stopped_before_the_object_and_only_the_margin_lets_them_jump_into_it():
    assert clearances(FAR, 12, 0.3, damping=0.01).min() > 0.0
    assert clearances(FAR, 12, 0.3, damping=0.01, gain=1.0, ahead=0.0, push_out=0.0).min() < -0.02


def test_a_link_further_than_the_margin_has_a_row_if_a_step_can_bring_it_to_the_object():
    keeps = {"gain": 0.5, "min_distance": 0.01, "push_out": 0.02, "ahead": 0.0}
    assert clearances(FAR, 40, 0.3, damping=0.01, **keeps).min() < -0.01
    assert clearances(FAR, 40, 0.3, damping=0.01, max_step=0.3, **keeps).min() > 0.0


def test_a_sensor_tells_the_fastest_approach_it_has_seen_and_none_at_first():
    model = mujoco.MjModel.from_xml_string(ARM)
    data, sensor, read = mujoco.MjData(model), pik.TouchSensor(model, ["g3"]), []
    for turn in (0.0, 0.1, 0.1, 0.05):
        pik.update_kinematics(model, data, FAR + np.array([turn, 0.0, 0.0]))
        read.append(sensor.read(data))
    came = (read[0].distance - read[1].distance)[0]
    assert came > 0.01
    assert [touch.approach for touch in read] == [None, came, came, came]


def test_a_push_out_that_a_step_cannot_make_is_a_conflict_that_names_the_row():
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    sensor = pik.TouchSensor(model, ["g1", "g2", "g3"])
    pik.update_kinematics(model, data, DEEP)
    rows = pik.contact_rows(sensor, data, sensor.read(data), push_out=0.01)
    with pytest.raises(pik.InfeasibleError, match="contact of link"):
        pik.solve(pik.IKProblem([], pik.step_bounds(model, 1e-3), rows))


@pytest.mark.parametrize(
    ("option", "value"), [("push_out", -1e-3), ("push_out", np.nan), ("ahead", -1.0), ("max_step", 0.0)]
)
def test_values_out_of_range_are_named(option, value):
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    sensor = pik.TouchSensor(model, ["g1"])
    pik.update_kinematics(model, data, ABOVE)
    with pytest.raises(pik.InputError, match=option):
        pik.contact_rows(sensor, data, sensor.read(data), **{option: value})
