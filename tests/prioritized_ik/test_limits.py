"""Joint range, step and contact limits."""

import gc
import weakref

import mujoco
import numpy as np
import pytest
from arms import Bench, central_difference, relative_error
from tolerances import DISTANCE_GRADIENT, DISTANCE_STEP, ROUNDING, SABOTAGE

from prioritized_ik.errors import InputError
from prioritized_ik.limits import OUTSIDE, contact_rows, joint_metric, joint_names, joint_range_bounds, step_bounds
from prioritized_ik.models import Arm, WindingObject, update_kinematics, winding_model
from prioritized_ik.problem import Rows
from prioritized_ik.touch import Touch, TouchSensor

ARM = Arm(links=6)
OBJECTS = {
    "cylinder": (0.07, 0.5),
    "capsule": (0.07, 0.3),
    "sphere": (0.07,),
    "ellipsoid": (0.07, 0.09, 0.12),
    "box": (0.05, 0.06, 0.3),
}
MIXED = """
<mujoco>
  <compiler autolimits="false"/>
  <worldbody>
    <body><freejoint name="root"/><geom size="0.1"/>
      <body><joint name="ball" type="ball" limited="true" range="0 60"/><geom size="0.1"/>
        <body><joint name="slide" type="slide" limited="true" range="-0.2 0.3"/><geom size="0.1"/>
          <body><joint limited="false" range="-10 10"/><geom size="0.1"/>
            <body><joint name="hinge" limited="true" range="-45 90"/><geom size="0.1"/></body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


class Scene:
    """A bent six-link arm beside an object."""

    def __init__(self, shape: str, gap: float, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        self.q = rng.uniform(-0.15, 0.15, ARM.joint_count)
        bench = Bench.of(ARM)
        bench.jacobian(self.q)
        link = bench.data.body("link_4")
        along = link.xmat.reshape(3, 3)[:, 0].copy()
        middle = link.xpos + 0.5 * ARM.link_length * along
        placed = WindingObject(shape, OBJECTS[shape]).touching(middle, along, "up", 0.2)
        outward = placed.rotation[:, 0]
        # A turn that is square to nothing, so that no face or edge lies along a link: there the distance has a kink.
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, np.array([1.0, 0.11, -0.07, 0.05]) / np.linalg.norm([1.0, 0.11, -0.07, 0.05]))
        self.model = winding_model(
            ARM,
            WindingObject(
                shape, placed.size, placed.position + (ARM.radius + gap) * outward, turn.reshape(3, 3) @ placed.rotation
            ),
        )
        self.data = mujoco.MjData(self.model)
        self.sensor = TouchSensor(self.model, ARM.link_geoms)

    def read(self, q: np.ndarray | None = None) -> Touch:
        update_kinematics(self.model, self.data, self.q if q is None else q)
        return self.sensor.read(self.data)

    def rows(self, **options: float) -> Rows:
        touch = self.read()
        return contact_rows(self.sensor, self.data, touch, **options)

    def gradient(self) -> np.ndarray:
        """Derivative of every link's distance by differences of re-read distances."""
        return central_difference(self.model, self.q, lambda q: self.read(q).distance.copy(), DISTANCE_STEP)


# Contact rows


@pytest.mark.parametrize("shape", OBJECTS)
@pytest.mark.parametrize("seed", range(2))
def test_contact_rows_are_minus_the_gradient_of_the_distance(shape: str, seed: int) -> None:
    scene = Scene(shape, gap=0.02, seed=seed)
    rows = scene.rows(margin=1.0)
    assert rows.matrix.shape == (6, ARM.joint_count)
    assert relative_error(-rows.matrix, scene.gradient()) < DISTANCE_GRADIENT


# Not the box: in penetration its distance has a kink wherever another face becomes the nearest way out.
@pytest.mark.parametrize("shape", ["cylinder", "capsule", "sphere", "ellipsoid"])
@pytest.mark.parametrize("gap", [0.0, -3e-3])
def test_contact_rows_are_the_gradient_in_touch_and_shallow_penetration_too(shape: str, gap: float) -> None:
    scene = Scene(shape, gap, seed=1)
    assert scene.read().distance.min() < 1e-6
    assert relative_error(-scene.rows(margin=1.0).matrix, scene.gradient()) < DISTANCE_GRADIENT


def test_contact_rows_wrong_by_a_thousandth_fail_the_finite_difference_check() -> None:
    scene = Scene("cylinder", gap=0.02)
    assert relative_error(-(1.0 + SABOTAGE) * scene.rows(margin=1.0).matrix, scene.gradient()) > DISTANCE_GRADIENT


def test_contact_rows_with_the_normal_reversed_fail_the_finite_difference_check() -> None:
    scene = Scene("cylinder", gap=0.02)
    assert relative_error(scene.rows(margin=1.0).matrix, scene.gradient()) > 1.0


@pytest.mark.parametrize("shape", OBJECTS)
@pytest.mark.parametrize("gap", [0.02, 1e-3, 0.0, -5e-3, -0.02])
def test_without_push_out_no_step_is_always_a_member_even_in_penetration(shape: str, gap: float) -> None:
    for min_distance in (0.0, 1e-3):
        rows = Scene(shape, gap).rows(min_distance=min_distance, gain=0.5, push_out=0.0)
        assert len(rows.upper) > 0
        assert np.all(rows.upper >= 0.0)


def test_a_link_nearer_than_the_least_distance_comes_out_and_without_push_out_may_not_come_nearer_at_all() -> None:
    scene = Scene("cylinder", gap=-5e-3)
    distance = scene.read().distance
    nearest = int(distance.argmin())
    assert scene.rows(margin=1.0, push_out=0.0).upper[nearest] == 0.0
    assert scene.rows(margin=1.0, push_out=2e-3).upper[nearest] == -2e-3
    assert scene.rows(margin=1.0, push_out=1.0).upper[nearest] == distance[nearest]


def test_a_step_along_a_row_closes_at_most_the_gain_of_the_gap() -> None:
    scene = Scene("cylinder", gap=0.01)
    touch = scene.read()
    rows = scene.rows(min_distance=2e-3, gain=0.5, margin=1.0)
    assert np.allclose(rows.upper, 0.5 * np.maximum(touch.distance - 2e-3, 0.0), rtol=ROUNDING)


def test_only_links_within_the_margin_get_a_row_and_its_name() -> None:
    scene = Scene("sphere", gap=0.01)
    near = np.flatnonzero(scene.read().distance < 0.03)
    assert 0 < near.size < 6
    rows = scene.rows(margin=0.03)
    assert rows.names == tuple(f"contact of link {link + 1}" for link in near)
    assert np.array_equal(rows.matrix, scene.rows(margin=1.0).matrix[near])


def test_without_a_link_within_the_margin_there_is_no_row() -> None:
    assert Scene("sphere", gap=0.05).rows(margin=1e-3, ahead=0.0).matrix.shape == (0, ARM.joint_count)


def test_a_link_is_not_held_by_joints_beyond_it() -> None:
    matrix = Scene("cylinder", gap=0.01).rows(margin=1.0).matrix
    for link in range(1, 6):
        assert not matrix[link - 1, 3 * link :].any()


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"gain": 0.0}, r"gain is 0\.0"),
        ({"gain": 1.5}, r"gain is 1\.5"),
        ({"gain": np.nan}, "gain is nan"),
        ({"min_distance": -1e-3}, r"min_distance is -0\.001"),
        ({"min_distance": np.nan}, "min_distance is nan"),
        ({"margin": 0.0}, r"margin is 0\.0"),
        ({"margin": np.inf}, "margin is inf"),
    ],
)
def test_contact_options_of_no_use_are_refused(options: dict[str, float], named: str) -> None:
    with pytest.raises(InputError, match=named):
        Scene("sphere", gap=0.01).rows(**options)


# Joint ranges


def test_every_joint_within_its_range_stays_inside_it_under_the_bounds(paper_arm: Bench) -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        q = rng.uniform(-1.0, 1.0, 49)
        bounds = joint_range_bounds(paper_arm.model, q)
        low, high = paper_arm.model.jnt_range.T
        assert np.all(q + bounds.lower >= low - ROUNDING)
        assert np.all(q + bounds.upper <= high + ROUNDING)
        assert np.all((bounds.lower <= 0.0) & (bounds.upper >= 0.0))


def test_bounds_wider_by_a_thousandth_would_leave_the_range(paper_arm: Bench) -> None:
    q = np.random.default_rng(2).uniform(-1.0, 1.0, 49)
    assert np.all(q + (1.0 + SABOTAGE) * joint_range_bounds(paper_arm.model, q).upper > 1.0 + ROUNDING)


def test_the_bounds_leave_all_of_the_range(paper_arm: Bench) -> None:
    q = np.random.default_rng(2).uniform(-1.0, 1.0, 49)
    bounds = joint_range_bounds(paper_arm.model, q)
    assert np.allclose(q + bounds.lower, -1.0)
    assert np.allclose(q + bounds.upper, 1.0)


def test_a_joint_at_its_limit_may_only_turn_back(paper_arm: Bench) -> None:
    bounds = joint_range_bounds(paper_arm.model, np.full(49, 1.0))
    assert np.all(bounds.upper == 0.0)
    assert np.all(bounds.lower == -2.0)


def test_a_joint_beyond_its_range_by_rounding_leaves_no_step_a_member(paper_arm: Bench) -> None:
    q = np.zeros(49)
    q[7] = 1.0 + 0.5 * OUTSIDE
    bounds = joint_range_bounds(paper_arm.model, q)
    assert bounds.upper[7] == 0.0
    assert q[7] + bounds.lower[7] == pytest.approx(-1.0)


@pytest.mark.parametrize("value", [1.25, -1.25])
def test_a_joint_outside_its_range_is_refused_by_name_and_value(paper_arm: Bench, value: float) -> None:
    q = np.zeros(49)
    q[4] = value
    with pytest.raises(InputError, match=rf"joint_2y is at {value}, outside its range \[-1, 1\]"):
        joint_range_bounds(paper_arm.model, q)


def test_the_joint_furthest_outside_is_the_one_named(paper_arm: Bench) -> None:
    q = np.zeros(49)
    q[[3, 48]] = 1.25, -1.5
    with pytest.raises(InputError, match=r"joint_17z is at -1\.5"):
        joint_range_bounds(paper_arm.model, q)


def test_only_limited_hinges_and_slides_are_bounded_and_at_their_own_places() -> None:
    model = mujoco.MjModel.from_xml_string(MIXED)
    q = np.array(model.qpos0)
    q[model.jnt_qposadr[2]] = 0.1
    q[model.jnt_qposadr[4]] = 0.5
    bounds = joint_range_bounds(model, q)
    free = [*range(9), 10]
    assert np.all(np.isinf(bounds.lower[free]))
    assert np.all(np.isinf(bounds.upper[free]))
    assert (bounds.lower[9], bounds.upper[9]) == pytest.approx((-0.3, 0.2))
    assert (bounds.lower[11], bounds.upper[11]) == pytest.approx((-np.pi / 4 - 0.5, np.pi / 2 - 0.5))


def test_a_joint_outside_its_range_is_named_in_a_model_with_a_free_joint() -> None:
    model = mujoco.MjModel.from_xml_string(MIXED)
    q = np.array(model.qpos0)
    q[model.jnt_qposadr[4]] = 2.0
    with pytest.raises(InputError, match=r"hinge is at 2, outside its range \[-0\.785398, 1\.5708\]"):
        joint_range_bounds(model, q)


def test_joints_without_a_name_get_their_number() -> None:
    names = joint_names(mujoco.MjModel.from_xml_string(MIXED))
    root, ball = [f"root[{i}]" for i in range(1, 7)], [f"ball[{i}]" for i in range(1, 4)]
    assert names == (*root, *ball, "slide", "joint 4", "hinge")


def test_joint_positions_of_no_use_are_refused(paper_arm: Bench) -> None:
    with pytest.raises(InputError, match=r"q has shape \(3,\); expected \(49,\)"):
        joint_range_bounds(paper_arm.model, np.zeros(3))
    q = np.zeros(49)
    q[5] = np.nan
    with pytest.raises(InputError, match=r"q\[5\] is nan"):
        joint_range_bounds(paper_arm.model, q)


# Steps


def test_step_bounds_are_the_same_to_both_sides_for_every_joint(paper_arm: Bench) -> None:
    bounds = step_bounds(paper_arm.model, 0.1)
    assert np.array_equal(bounds.upper, np.full(49, 0.1))
    assert np.array_equal(bounds.lower, -bounds.upper)
    assert bounds.names == joint_names(paper_arm.model)


def test_range_and_step_bounds_together_keep_both(paper_arm: Bench) -> None:
    q = np.full(49, 0.95)
    bounds = joint_range_bounds(paper_arm.model, q).intersect(step_bounds(paper_arm.model, 0.1))
    assert np.allclose(bounds.upper, 0.05)
    assert np.allclose(bounds.lower, -0.1)


@pytest.mark.parametrize("bad", [0.0, -0.1, np.nan, np.inf])
def test_a_step_limit_that_is_not_positive_is_refused(paper_arm: Bench, bad: float) -> None:
    with pytest.raises(InputError, match=f"max_step is {bad}"):
        step_bounds(paper_arm.model, bad)


def test_contact_rows_against_an_object_that_moves_are_the_gradient_too() -> None:
    spec = Arm(links=3).spec()
    carriage = spec.worldbody.add_body(name="carriage", pos=[0.09, 0.01, 0.1])
    carriage.add_joint(name="slide", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0.0, 0.3, 1.0])
    square = [np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0]
    carriage.add_geom(name="object", type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[0.05, 0.2, 0.0], quat=square)
    model = spec.compile()
    data, sensor = mujoco.MjData(model), TouchSensor(model, ["link_1", "link_2", "link_3"])
    q = np.array([0.1, -0.2, 0.1, 0.2, 0.1, -0.1, 0.3, 0.01])

    def distance(position: np.ndarray) -> np.ndarray:
        update_kinematics(model, data, position)
        return sensor.read(data).distance

    step = 1e-6
    slopes = [(distance(q + step * e) - distance(q - step * e)) / (2 * step) for e in np.eye(model.nv)]
    update_kinematics(model, data, q)
    rows = contact_rows(sensor, data, sensor.read(data), margin=1.0)
    assert np.abs(np.transpose(slopes) + rows.matrix).max() < 1e-5
    assert np.abs(rows.matrix[:, -1]).min() > 0.1


def test_contact_rows_of_several_objects_join_without_clashing_names() -> None:
    spec = Arm(links=3).spec()
    for name, height in (("pole", 0.1), ("ball", -0.1)):
        spec.worldbody.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.05] * 3, pos=[0.09, 0.0, height])
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.05] * 3, pos=[0.2, 0.0, 0.1])
    model = spec.compile()
    data, links = mujoco.MjData(model), ["link_1", "link_2", "link_3"]
    sensors = [TouchSensor(model, links, wound) for wound in ("pole", "ball", 2)]
    update_kinematics(model, data, np.full(model.nv, 0.1))
    parts = [contact_rows(sensor, data, sensor.read(data), margin=1.0) for sensor in sensors]
    rows = Rows.joined(parts, model.nv)
    assert len(set(rows.names)) == len(rows.upper) == 9
    assert rows.names[::4] == (
        "contact of link 1 with pole",
        "contact of link 2 with ball",
        "contact of link 3 with geom 2",
    )
    for place, part in enumerate(parts):
        assert np.array_equal(rows.matrix[3 * place : 3 * place + 3], part.matrix)
        assert np.array_equal(rows.upper[3 * place : 3 * place + 3], part.upper)
    assert Rows.joined([], model.nv).matrix.shape == (0, model.nv)


def test_contact_rows_of_two_chains_on_one_object_join_without_clashing_names() -> None:
    scene = Scene("sphere", 0.01)
    rows = scene.rows(margin=1.0)
    joined = Rows.joined([rows, rows], scene.model.nv)
    assert len(set(joined.names)) == len(joined.upper) == 2 * len(rows.upper)
    assert joined.names[len(rows.upper) :] == tuple(f"{name} (2)" for name in rows.names)


def test_a_joint_without_a_name_is_told_from_one_that_has_its_name() -> None:
    joints = '<joint axis="1 0 0"/><joint name="joint 1" axis="0 1 0"/>'
    text = f'<mujoco><worldbody><body>{joints}<geom size="1"/></body></worldbody></mujoco>'
    model = mujoco.MjModel.from_xml_string(text)
    assert joint_names(model) == ("joint 1", "joint 1 (2)")


def test_joints_of_several_degrees_of_freedom_are_numbered() -> None:
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="base")
    body.add_joint(name="root", type=mujoco.mjtJoint.mjJNT_FREE)
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.1, 0.0, 0.0])
    assert joint_names(spec.compile()) == tuple(f"root[{i}]" for i in range(1, 7))


def test_in_the_metric_of_a_model_only_what_translates_counts_in_its_length() -> None:
    model = mujoco.MjModel.from_xml_string(MIXED)
    # A free base, a ball, a slide and two hinges.
    assert joint_metric(model, 0.5).tolist() == [4.0] * 3 + [1.0] * 3 + [1.0] * 3 + [4.0] + [1.0] * 2
    assert joint_metric(model)[9] == pytest.approx(4.0 / model.stat.extent**2, rel=1e-15)


@pytest.mark.parametrize("length", [0.0, -1.0, np.nan, np.inf])
def test_the_length_of_a_metric_must_be_positive(length: float) -> None:
    with pytest.raises(InputError, match=r"length is .*; expected a finite number above 0"):
        joint_metric(mujoco.MjModel.from_xml_string(MIXED), length)


def test_the_names_of_a_models_joints_are_its_own_and_die_with_it() -> None:
    texts = [
        f'<mujoco><worldbody><body><joint name="{name}"/><geom size="1"/></body></worldbody></mujoco>' for name in "ab"
    ]
    one, other = (mujoco.MjModel.from_xml_string(text) for text in texts)
    assert joint_names(one) == joint_names(one) == ("a",)
    assert joint_names(other) == ("b",)
    watched = weakref.ref(one)
    del one
    gc.collect()
    assert watched() is None


def test_a_joint_range_that_is_changed_counts_at_once() -> None:
    model = Arm(links=2).spec().compile()
    before = joint_range_bounds(model, np.zeros(model.nq))
    model.jnt_range[:] *= 0.5
    assert np.array_equal(joint_range_bounds(model, np.zeros(model.nq)).upper, 0.5 * before.upper)
