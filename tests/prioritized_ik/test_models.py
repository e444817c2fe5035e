"""The paper's arms and the objects they wind around."""

import mujoco
import numpy as np
import pytest
from arms import Bench
from tolerances import DISTANCE, ROUNDING

from prioritized_ik.errors import InputError, ModelError
from prioritized_ik.models import (
    ARCH,
    DIRECTIONS,
    PLANAR_ARM,
    POSTURES,
    SHAPES,
    Arm,
    WindingObject,
    update_kinematics,
    winding_model,
)
from prioritized_ik.touch import TouchSensor

SIZES = {
    "cylinder": (0.07, 0.5),
    "capsule": (0.07, 0.3),
    "sphere": (0.07,),
    "ellipsoid": (0.07, 0.09, 0.12),
    "box": (0.05, 0.06, 0.3),
}
ALONG_X = [1.0, 0.0, 0.0]


# Arms


def test_fig5_the_arm_has_17_links_49_joints_and_51_rows(paper_arm: Bench) -> None:
    assert paper_arm.arm.joint_count == paper_arm.model.nv == paper_arm.model.nq == 49
    assert paper_arm.jacobian(np.zeros(49)).shape == (51, 49)


def test_fig5_sixteen_links_turn_about_three_axes_and_the_last_about_z(paper_arm: Bench) -> None:
    names = [mujoco.mj_id2name(paper_arm.model, mujoco.mjtObj.mjOBJ_JOINT, i) for i in range(49)]
    assert names == [f"joint_{link}{axis}" for link in range(1, 17) for axis in "zyx"] + ["joint_17z"]
    for i, name in enumerate(names):
        assert paper_arm.model.jnt_axis[i].tolist() == np.eye(3)["xyz".index(name[-1])].tolist()


def test_fig3_the_planar_arm_has_five_joints_about_z() -> None:
    model = PLANAR_ARM.spec().compile()
    assert PLANAR_ARM.joint_count == model.nv == 5
    assert np.array_equal(model.jnt_axis, np.tile([0.0, 0.0, 1.0], (5, 1)))


def test_links_geoms_and_end_sites_are_numbered_from_one(paper_arm: Bench) -> None:
    assert paper_arm.arm.end_sites[0] == "end_1"
    assert paper_arm.arm.link_geoms[-1] == "link_17"
    for link in paper_arm.arm.link_numbers:
        body = paper_arm.model.body(f"link_{link}").id
        assert paper_arm.model.geom(f"link_{link}").bodyid == body
        assert paper_arm.model.site(f"end_{link}").bodyid == body


def test_links_are_capsules_of_the_given_length_and_radius() -> None:
    model = Arm(links=3, link_length=0.1, radius=0.02).spec().compile()
    assert np.allclose(model.geom_size[:, :2], [0.02, 0.05])
    assert np.all(model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE)


def test_every_joint_is_limited_to_plus_and_minus_its_range() -> None:
    model = Arm(links=3, joint_range=0.7).spec().compile()
    assert np.all(model.jnt_limited == 1)
    assert np.allclose(model.jnt_range, [-0.7, 0.7])


def test_the_hinge_order_is_that_of_the_joints() -> None:
    arm = Arm(links=2, hinge_order="xyz")
    assert (arm.hinge_axes(1), arm.hinge_axes(2)) == ("xyz", "z")
    assert np.array_equal(arm.spec().compile().jnt_axis[:3], np.eye(3))


@pytest.mark.parametrize("posture", POSTURES)
@pytest.mark.parametrize("arm", [Arm(), PLANAR_ARM])
def test_postures_lie_within_the_joint_range_of_their_arm(arm: Arm, posture: str) -> None:
    q = arm.posture(posture, seed=3)
    assert q.shape == (arm.joint_count,)
    assert np.all(np.abs(q) <= arm.joint_range)


def test_a_random_posture_lies_within_a_range_narrower_than_its_spread() -> None:
    arm = Arm(joint_range=0.02)
    assert np.all(np.abs(arm.posture("random")) < arm.joint_range)


def test_postures_are_straight_arched_without_twist_or_random_by_seed() -> None:
    arm = Arm()
    assert not arm.posture("straight").any()
    assert arm.posture("arched")[:3].tolist() == [ARCH, ARCH, 0.0]
    assert np.array_equal(arm.posture("random", 4), arm.posture("random", 4))
    assert not np.array_equal(arm.posture("random", 4), arm.posture("random", 5))


def test_update_kinematics_brings_positions_and_jacobians_up_to_date() -> None:
    arm = Arm(links=3)
    model = arm.spec().compile()
    fresh, used = mujoco.MjData(model), mujoco.MjData(model)
    q = np.random.default_rng(6).uniform(-0.5, 0.5, arm.joint_count)
    update_kinematics(model, used, -q)
    update_kinematics(model, used, q)
    fresh.qpos[:] = q
    mujoco.mj_forward(model, fresh)
    jacobians = np.empty((2, 3, model.nv))
    for jacobian, data in zip(jacobians, (fresh, used), strict=True):
        mujoco.mj_jacSite(model, data, jacobian, None, 2)
    assert np.array_equal(fresh.site_xpos, used.site_xpos)
    assert np.array_equal(*jacobians)


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"links": 0}, "links is 0"),
        ({"links": 2.5}, r"links is 2\.5"),
        ({"link_length": 0.0}, r"link_length is 0\.0"),
        ({"link_length": np.nan}, "link_length is nan"),
        ({"radius": -0.01}, r"radius is -0\.01"),
        ({"joint_range": np.inf}, "joint_range is inf"),
        ({"joints": "screw"}, "unknown joints 'screw'; choose one of: ball, planar"),
        ({"hinge_order": "zyy"}, "hinge_order is 'zyy'"),
    ],
)
def test_an_arm_of_no_use_is_refused_by_name_and_value(values: dict[str, object], named: str) -> None:
    with pytest.raises(InputError, match=named):
        Arm(**values)


def test_an_unknown_posture_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InputError, match="unknown posture 'coiled'; choose one of: straight, arched, random"):
        Arm().posture("coiled")


# Objects


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("tilt", [0.0, 0.5, -0.5])
def test_an_object_touches_its_link_at_the_gap_from_every_direction(shape: str, direction: str, tilt: float) -> None:
    arm, link, gap = Arm(links=8), 5, 3e-3
    q = arm.posture("random", 7)
    bench = Bench.of(arm)
    bench.jacobian(q)
    body = bench.data.body(f"link_{link}")
    along = body.xmat.reshape(3, 3)[:, 0].copy()
    middle = body.xpos + 0.5 * arm.link_length * along
    placed = WindingObject(shape, SIZES[shape]).touching(middle, along, direction, tilt, arm.radius + gap)
    model = winding_model(arm, placed)
    data = mujoco.MjData(model)
    update_kinematics(model, data, q)
    touch = TouchSensor(model, [f"link_{link}"]).read(data)
    assert touch.distance[0] == pytest.approx(gap, abs=DISTANCE)
    assert -touch.normal[0] @ DIRECTIONS[direction] > 0.9
    assert placed.rotation[:, 0] @ along == pytest.approx(0.0, abs=ROUNDING)


def test_an_object_misplaced_by_a_tenth_of_a_millimetre_would_be_noticed() -> None:
    arm = Arm(links=3)
    placed = WindingObject("sphere", (0.07,)).touching([0.09, 0.0, 0.0], ALONG_X, "up", 0.0, arm.radius + 3.1e-3)
    model = winding_model(arm, placed)
    data = mujoco.MjData(model)
    update_kinematics(model, data, np.zeros(arm.joint_count))
    assert TouchSensor(model, ["link_2"]).read(data).distance[0] != pytest.approx(3e-3, abs=DISTANCE)


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("tilt", [-1.0, -0.3, 0.0, 0.3, 1.0])
def test_tilt_turns_the_axis_about_the_contact_normal_by_its_angle(direction: str, tilt: float) -> None:
    upright = WindingObject().touching([0.0, 0.0, 0.0], ALONG_X, direction)
    tilted = WindingObject().touching([0.0, 0.0, 0.0], ALONG_X, direction, tilt)
    outward = np.array(DIRECTIONS[direction])
    assert abs(upright.axis @ ALONG_X) < ROUNDING
    assert abs(tilted.axis @ outward) < ROUNDING
    angle = np.arctan2(np.cross(upright.axis, tilted.axis) @ outward, upright.axis @ tilted.axis)
    assert angle == pytest.approx(tilt, abs=ROUNDING)
    assert np.array_equal(tilted.position, upright.position)


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_the_object_comes_from_the_named_side(direction: str) -> None:
    placed = WindingObject().touching([0.3, 0.0, 0.0], ALONG_X, direction, gap=0.01)
    assert np.allclose(placed.position, np.array([0.3, 0.0, 0.0]) + 0.08 * np.array(DIRECTIONS[direction]))


def test_placement_gives_a_right_handed_rotation() -> None:
    rng = np.random.default_rng(8)
    for _ in range(20):
        placed = WindingObject().touching(rng.normal(size=3), rng.normal(size=3), "front", rng.uniform(-1.0, 1.0))
        assert np.allclose(placed.rotation @ placed.rotation.T, np.eye(3))
        assert np.linalg.det(placed.rotation) == pytest.approx(1.0)


@pytest.mark.parametrize("shape", SHAPES)
def test_the_model_holds_the_object_at_its_pose(shape: str) -> None:
    placed = WindingObject(shape, SIZES[shape]).touching([0.3, 0.1, 0.2], [1.0, 0.4, 0.2], "down", 0.4)
    model = winding_model(Arm(links=2), placed)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    geom = data.geom("object")
    assert np.allclose(geom.xpos, placed.position)
    assert np.allclose(geom.xmat.reshape(3, 3), placed.rotation)
    assert np.allclose(model.geom("object").size[: len(placed.size)], placed.size)
    assert model.geom("object").type == SHAPES[shape][0]


def test_an_unknown_direction_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InputError, match="unknown direction 'left'; choose one of: up, down, front, back"):
        WindingObject().touching([0.0, 0.0, 0.0], ALONG_X, "left")


def test_a_direction_along_the_link_is_refused() -> None:
    with pytest.raises(ModelError, match=r"direction 'up' points along the link \[0\.0, 0\.0, 1\.0\]"):
        WindingObject().touching([0.0, 0.0, 0.0], [0.0, 0.0, 2.0], "up")


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"shape": "torus"}, "unknown shape 'torus'; choose one of: cylinder, capsule, sphere, ellipsoid, box"),
        ({"size": (0.07,)}, r"size of a cylinder is \(0\.07,\); expected 2 half-sizes"),
        ({"shape": "box", "size": (0.1, 0.1)}, r"size of a box is \(0\.1, 0\.1\); expected 3"),
        ({"size": (0.07, 0.0)}, r"size of the cylinder is 0\.0"),
        ({"size": (np.nan, 0.5)}, "size of the cylinder is nan"),
        ({"position": [0.0, np.nan, 0.0]}, r"position\[1\] is nan"),
        ({"position": [0.0, 0.0]}, r"position has shape \(2,\); expected \(3,\)"),
        ({"rotation": np.eye(2)}, r"rotation has shape \(2, 2\); expected \(3, 3\)"),
        ({"rotation": 2.0 * np.eye(3)}, r"rotation is \[\[2\.0"),
        ({"rotation": -np.eye(3)}, r"rotation is \[\[-1\.0.*expected a rotation matrix"),
    ],
)
def test_an_object_of_no_use_is_refused_by_name_and_value(values: dict[str, object], named: str) -> None:
    with pytest.raises(InputError, match=named):
        WindingObject(**values)


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"point": [0.0, 0.0]}, r"point has shape \(2,\)"),
        ({"point": [0.0, 0.0, np.nan]}, r"point\[2\] is nan"),
        ({"along": [np.inf, 0.0, 0.0]}, r"along\[0\] is inf"),
        ({"gap": -1e-3}, r"gap is -0\.001"),
        ({"gap": np.nan}, "gap is nan"),
    ],
)
def test_a_placement_of_no_use_is_refused_by_name_and_value(values: dict[str, object], named: str) -> None:
    placement = {"point": [0.0, 0.0, 0.0], "along": ALONG_X, "direction": "up"} | values
    with pytest.raises(InputError, match=named):
        WindingObject().touching(**placement)
