"""What the arm feels: distances, normals, contact with hysteresis."""

import mujoco
import numpy as np
import pytest
from tolerances import DISTANCE, NORMAL, ROUNDING, SABOTAGE

from prioritized_ik.errors import InputError, ModelError
from prioritized_ik.models import DIRECTIONS, Arm, WindingObject, update_kinematics, winding_model
from prioritized_ik.touch import REACH, Touch, TouchSensor, update_contact

OBJECTS = {
    "cylinder": (0.07, 0.5),
    "capsule": (0.07, 0.3),
    "sphere": (0.07,),
    "ellipsoid": (0.07, 0.09, 0.12),
    "box": (0.05, 0.06, 0.3),
}
ARM = Arm(links=6)
MIDDLE = [0.15, 0.0, 0.0]  # of link 3 in the straight pose


def reading(wound: WindingObject, q: np.ndarray | None = None) -> Touch:
    model = winding_model(ARM, wound)
    data = mujoco.MjData(model)
    update_kinematics(model, data, np.zeros(model.nv) if q is None else q)
    return TouchSensor(model, ARM.link_geoms).read(data)


def facing(shape: str, direction: str, gap: float) -> WindingObject:
    """An object before link 3, its surface `gap` from the surface of the link."""
    unplaced = WindingObject(shape, OBJECTS[shape]).touching(MIDDLE, [1.0, 0.0, 0.0], direction)
    outward = np.array(DIRECTIONS[direction])
    return WindingObject(shape, unplaced.size, unplaced.position + (ARM.radius + gap) * outward, unplaced.rotation)


@pytest.mark.parametrize("shape", OBJECTS)
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_the_distance_is_the_gap_for_every_shape_and_direction(shape: str, direction: str) -> None:
    assert reading(facing(shape, direction, 5e-3)).distance[2] == pytest.approx(5e-3, abs=DISTANCE)


@pytest.mark.parametrize("shape", OBJECTS)
@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("gap", [5e-3, 0.0, -4e-3, -0.03])  # the last: the core of the link is inside as well
def test_the_normal_points_from_the_object_into_the_link(shape: str, direction: str, gap: float) -> None:
    normal = reading(facing(shape, direction, gap)).normal[2]
    assert np.linalg.norm(normal) == pytest.approx(1.0, abs=ROUNDING)
    assert -normal @ DIRECTIONS[direction] > 1.0 - NORMAL


@pytest.mark.parametrize("shape", OBJECTS)
def test_the_distance_is_negative_in_penetration(shape: str) -> None:
    assert reading(facing(shape, "up", -4e-3)).distance[2] == pytest.approx(-4e-3, abs=1e-4)


def test_moving_a_link_along_its_normal_takes_it_away_from_the_object() -> None:
    wound = facing("cylinder", "up", 5e-3)
    before = reading(wound)
    further = WindingObject(wound.shape, wound.size, wound.position - 1e-3 * before.normal[2], wound.rotation)
    assert reading(further).distance[2] == pytest.approx(before.distance[2] + 1e-3, abs=DISTANCE)


def test_a_normal_reversed_would_take_the_link_into_the_object() -> None:
    wound = facing("cylinder", "up", 5e-3)
    before = reading(wound)
    nearer = WindingObject(wound.shape, wound.size, wound.position + 1e-3 * before.normal[2], wound.rotation)
    assert reading(nearer).distance[2] < before.distance[2] - 0.9e-3


@pytest.mark.parametrize("shape", OBJECTS)
def test_the_nearest_point_lies_on_the_link_where_the_normal_says(shape: str) -> None:
    wound = facing(shape, "back", 5e-3)
    touch = reading(wound)
    outward = np.array(DIRECTIONS["back"])
    assert touch.point[2] @ outward == pytest.approx(ARM.radius, abs=DISTANCE)
    core = touch.point[2] + ARM.radius * touch.normal[2]
    assert abs(core[1]) < ARM.radius * NORMAL
    assert 0.12 - DISTANCE <= core[0] <= 0.18 + DISTANCE


def test_a_bent_arm_is_read_as_the_distance_of_two_capsules() -> None:
    # A capsule is so long here that only its core line counts, and distances of lines have a formula.
    rng = np.random.default_rng(1)
    wound = WindingObject("capsule", (0.03, 1.0), np.array([0.1, 0.1, 0.05]))
    q = rng.uniform(-0.5, 0.5, ARM.joint_count)
    model = winding_model(ARM, wound)
    data = mujoco.MjData(model)
    update_kinematics(model, data, q)
    touch = TouchSensor(model, ARM.link_geoms).read(data)
    along = np.linspace(0.0, ARM.link_length, 20001)
    for i, name in enumerate(ARM.link_geoms):
        body = data.body(name)
        core = body.xpos + along[:, None] * body.xmat.reshape(3, 3)[:, 0]
        radial = np.linalg.norm(core[:, :2] - wound.position[:2], axis=1).min()
        assert touch.distance[i] == pytest.approx(radial - 0.03 - ARM.radius, abs=DISTANCE)


def test_links_beyond_reach_count_as_far_away_without_a_normal() -> None:
    touch = reading(WindingObject(position=np.array([0.0, 0.0, 2.0 * REACH])))
    assert np.all(touch.distance == REACH)
    assert not touch.normal.any()


def test_spheres_serve_as_links() -> None:
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(pos=[0.0, 0.0, 0.3])
    body.add_geom(name="ball", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.05, 0.0, 0.0])
    WindingObject("sphere", (0.1,)).add_to(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    touch = TouchSensor(model, ["ball"]).read(data)
    assert touch.distance[0] == pytest.approx(0.15, abs=DISTANCE)
    assert np.abs(touch.normal[0] - [0.0, 0.0, 1.0]).max() < NORMAL
    assert np.abs(touch.point[0] - [0.0, 0.0, 0.25]).max() < DISTANCE


# Beside a cylinder: closed form, held to a convex minimum along the link's core, and elsewhere to MuJoCo


CYLINDER = (0.07, 0.2)


def scattered_links(seed: int, *, shape: str = "capsule", count: int = 60) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Links at random places around a tilted cylinder: beside it, at its edges, inside, along it and across it."""
    rng = np.random.default_rng(seed)
    spec = mujoco.MjSpec()
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    place = rng.uniform(-0.3, 0.3, 3)
    wound = WindingObject("cylinder", CYLINDER, place, turn)
    wound.add_to(spec)
    for number in range(count):
        around, gap, height = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(-0.06, 0.1), rng.uniform(-1.3, 1.3)
        across = np.array([np.cos(around), np.sin(around), 0.0])
        centre = place + turn @ (across * (CYLINDER[0] + gap) + [0.0, 0.0, height * CYLINDER[1]])
        along = [rng.normal(size=3), [0.0, 0.0, 1.0] + 10.0 ** rng.uniform(-9, -1) * rng.normal(size=3)][number % 2]
        body = spec.worldbody.add_body(name=f"body_{number}", pos=centre)
        kind = mujoco.mjtGeom.mjGEOM_CAPSULE if shape == "capsule" else mujoco.mjtGeom.mjGEOM_SPHERE
        quat = np.zeros(4)
        mujoco.mju_quatZ2Vec(quat, turn @ (along / np.linalg.norm(along)))
        body.add_geom(name=f"link_{number}", type=kind, size=[0.01, 0.03, 0.0], quat=quat)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return model, data


def off_cylinder(model: mujoco.MjModel, data: mujoco.MjData, points: np.ndarray) -> np.ndarray:
    """Distances of points `(..., 3)` from the solid cylinder."""
    turn = data.geom("object").xmat.reshape(3, 3)
    own = (points - data.geom("object").xpos) @ turn
    beside = np.maximum(np.hypot(own[..., 0], own[..., 1]) - CYLINDER[0], 0.0)
    return np.hypot(beside, np.maximum(np.abs(own[..., 2]) - CYLINDER[1], 0.0))


@pytest.mark.parametrize("shape", ["capsule", "sphere"])
@pytest.mark.parametrize("seed", range(4))
def test_links_around_a_cylinder_are_as_far_as_their_cores(seed: int, shape: str) -> None:
    model, data = scattered_links(seed, shape=shape)
    sensor = TouchSensor(model, [f"link_{i}" for i in range(60)])
    touch = sensor.read(data)
    known = sensor._beside_cylinder(
        data, data.geom_xpos[sensor.links], data.geom_xmat[sensor.links].reshape(-1, 3, 3)[:, :, 2]
    )[2]
    assert 15 <= known.sum() <= 50
    for i, geom in enumerate(sensor.links):
        centre, axis = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)[:, 2]
        low, high = -sensor.half_lengths[i], sensor.half_lengths[i]
        for _ in range(100):  # a convex function, by thirds
            third = (high - low) / 3.0
            one, other = off_cylinder(model, data, centre + np.outer([low + third, high - third], axis))
            low, high = (low, high - third) if one <= other else (low + third, high)
        apart = off_cylinder(model, data, centre + low * axis)
        if known[i]:
            assert apart > 0.0
            assert touch.distance[i] == pytest.approx(apart - 0.01, abs=ROUNDING)
            assert np.linalg.norm(touch.normal[i]) == pytest.approx(1.0, abs=ROUNDING)
            # from the nearest point on the link, along the normal, it is as far to the surface as the distance says
            assert off_cylinder(model, data, touch.point[i] + 0.01 * touch.normal[i]) == pytest.approx(apart, abs=ROUNDING)
            nearer = off_cylinder(model, data, touch.point[i] + (0.01 - apart / 2.0) * touch.normal[i])
            assert nearer == pytest.approx(apart / 2.0, abs=ROUNDING)
        elif apart > 0.01:
            assert touch.distance[i] == pytest.approx(apart - 0.01, abs=DISTANCE)
        else:
            assert touch.distance[i] < 10.0 * DISTANCE


def test_a_distance_to_a_cylinder_that_ends_before_the_link_is_not_that_of_lines() -> None:
    model, data = scattered_links(7)
    sensor = TouchSensor(model, [f"link_{i}" for i in range(60)])
    right = sensor.read(data).distance
    sensor.cylinder = (CYLINDER[0], 10.0)  # sabotage: it does not end
    assert (sensor.read(data).distance < right - SABOTAGE).any()


# Contact with hysteresis


@pytest.mark.parametrize(
    ("was", "distance", "now"),
    [
        (False, 1.9e-3, True),
        (False, 2.0e-3, True),
        (False, 2.1e-3, False),
        (False, 3.9e-3, False),
        (True, 2.1e-3, True),
        (True, 4.0e-3, True),
        (True, 4.1e-3, False),
        (True, -1e-3, True),
        (False, -1e-3, True),
    ],
)
def test_contact_is_made_at_one_distance_and_lost_above_another(was: bool, distance: float, now: bool) -> None:
    assert update_contact(np.array([was]), np.array([distance]), 2e-3, 4e-3).tolist() == [now]


def test_between_the_two_distances_contact_stays_as_it_was() -> None:
    distance = np.full(50, 3e-3)
    was = np.random.default_rng(2).random(50) < 0.5
    assert np.array_equal(update_contact(was, distance, 2e-3, 4e-3), was)


def test_with_one_distance_there_is_no_hysteresis() -> None:
    was, distance = np.array([True, False]), np.array([3e-3, 3e-3])
    assert update_contact(was, distance, 2e-3, 2e-3).tolist() == [False, False]


def test_a_release_distance_below_the_contact_distance_is_refused() -> None:
    with pytest.raises(InputError, match=r"release_distance 0\.001 is below contact_distance 0\.002"):
        update_contact(np.array([False]), np.array([0.0]), 2e-3, 1e-3)


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
def test_contact_distances_that_are_not_positive_are_refused(bad: float) -> None:
    with pytest.raises(InputError, match=f"contact_distance is {bad}"):
        update_contact(np.array([False]), np.array([0.0]), bad, 4e-3)
    with pytest.raises(InputError, match=f"release_distance is {bad}"):
        update_contact(np.array([False]), np.array([0.0]), 2e-3, bad)


# Bad input


def test_a_model_without_the_object_is_refused_with_the_geoms_there_are() -> None:
    with pytest.raises(ModelError, match="no geom called 'object'; its geoms: link_1, link_2"):
        TouchSensor(ARM.spec().compile(), ARM.link_geoms)


def test_another_name_of_the_object_is_looked_up() -> None:
    spec = ARM.spec()
    WindingObject().add_to(spec, "pole")
    assert TouchSensor(spec.compile(), ARM.link_geoms, "pole").bodies == [1, 2, 3, 4, 5, 6]


def test_an_unknown_link_geom_is_refused() -> None:
    with pytest.raises(ModelError, match=r"no geom called 'link_7'; its geoms: .*object"):
        TouchSensor(winding_model(ARM, WindingObject()), ["link_7"])


def test_a_link_that_is_neither_capsule_nor_sphere_is_refused() -> None:
    model = winding_model(ARM, WindingObject("box", (0.1, 0.1, 0.1)))
    with pytest.raises(ModelError, match="link geom 'object' is a mjGEOM_BOX; expected a capsule or a sphere"):
        TouchSensor(model, ["object"], "link_1")
