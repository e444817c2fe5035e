"""Where the virtual end points should go, Eqs. (18) to (22), and the two equilibria."""

import dataclasses
import itertools

import numpy as np
import pytest
from tolerances import NORMAL, ROUNDING

from prioritized_ik.models import DIRECTIONS
from prioritized_ik.problem import Bounds, IKProblem, Rows
from prioritized_ik.solvers.compiled.library import Library
from prioritized_ik.touch import Touch
from prioritized_ik.weights import diagonal_of_weights, winding_priorities, winding_weights
from prioritized_ik.winding import compiled
from prioritized_ik.winding.controller import Equilibrium, Situation, WindingController, levels_of
from prioritized_ik.winding.plan import (
    DEAD_BAND,
    desired_displacement,
    driven_arms,
    first_and_last_in_contact,
    into_plane,
    plan,
    plan_arm,
    plane_normal,
    side_sign,
    towards_object,
    winding_direction,
)
from prioritized_ik.winding.settings import WindingSettings

X, Y, Z = np.eye(3)
STEP = {"speed": 2.0, "dt": 2e-3}


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def random_scene(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return unit(rng.normal(size=(n, 3))), unit(rng.normal(size=(n, 3)))


def turned(vector: np.ndarray, axis: np.ndarray, angle: float) -> np.ndarray:
    """Rodrigues' rotation."""
    return vector * np.cos(angle) + np.cross(axis, vector) * np.sin(angle) + axis * (axis @ vector) * (1.0 - np.cos(angle))


# Eq. (18)


@pytest.mark.parametrize(("previous", "current"), list(itertools.product([0, 1], repeat=2)))
def test_eq18_equals_the_printed_product_for_every_contact_of_the_two_links(previous: int, current: int) -> None:
    direction = np.array([0.3, -0.5, 0.7])
    printed = 2.0 * 2e-3 * direction * (1 - current) * (previous - current)
    found = desired_displacement(direction, bool(previous), bool(current), **STEP)
    assert np.abs(found - printed).max() < ROUNDING


@pytest.mark.parametrize(
    ("previous", "current", "driven"), [(False, False, 0), (False, True, 0), (True, False, 1), (True, True, 0)]
)
def test_eq18_drives_only_a_free_link_behind_one_in_contact(previous: bool, current: bool, driven: int) -> None:
    assert np.array_equal(desired_displacement(X, previous, current, **STEP), driven * 4e-3 * X)


def test_eq18_the_first_arm_is_never_driven_for_m0_is_zero() -> None:
    directions, contacts = random_scene(4, seed=1)
    displacements, signs = plan(directions, contacts, np.zeros(4, dtype=bool), **STEP)
    assert not displacements[0].any()
    assert signs[0] == 0.0


def test_eq18_scales_with_speed_and_time_step() -> None:
    slow = desired_displacement(X, True, False, speed=1.0, dt=2e-3)
    assert np.allclose(desired_displacement(X, True, False, speed=3.0, dt=4e-3), 6.0 * slow)


# Eqs. (19) to (22)


def test_eq19_adds_the_two_parts() -> None:
    assert winding_direction(X, Y).tolist() == [1.0, 1.0, 0.0]


def test_eq20_the_plane_part_is_the_signed_normal() -> None:
    assert into_plane(-1.0, Z).tolist() == [0.0, 0.0, -1.0]
    assert not into_plane(0.0, Z).any()


def test_eq20_the_other_part_is_square_to_the_link() -> None:
    for a, e in zip(*random_scene(20, seed=2), strict=True):
        assert abs(towards_object(a, e) @ a) < ROUNDING
        assert np.array_equal(towards_object(a, e), np.cross(a, e))


@pytest.mark.parametrize(("out_of_plane", "sign"), [(0.5, -1.0), (-0.5, 1.0), (0.0, 0.0)])
def test_eq21_is_minus_the_sign_of_the_link_out_of_the_plane(out_of_plane: float, sign: float) -> None:
    assert side_sign(np.array([np.sqrt(1.0 - out_of_plane**2), 0.0, out_of_plane]), Z) == sign


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_eq21_is_zero_up_to_the_dead_band_and_not_beyond_it(side: float) -> None:
    assert side_sign(side * DEAD_BAND * Z, Z) == 0.0
    assert side_sign(side * np.nextafter(DEAD_BAND, 1.0) * Z, Z) == -side
    assert side_sign(side * 1e-9 * Z, Z, dead_band=0.0) == -side
    assert side_sign(side * 0.2 * Z, Z, dead_band=0.3) == 0.0


def test_eq21_moves_the_link_towards_the_plane() -> None:
    normals, links = random_scene(50, seed=3)
    for e, a in zip(normals, links, strict=True):
        moved = unit(a + 0.01 * into_plane(side_sign(a, e, 0.02), e))
        assert abs(moved @ e) <= abs(a @ e)


def test_eq21_with_the_sign_reversed_would_move_the_link_away() -> None:
    a = unit(np.array([1.0, 0.0, 0.3]))
    assert abs(unit(a - 0.01 * into_plane(side_sign(a, Z), Z)) @ Z) > abs(a @ Z)


def test_eq22_the_normal_is_square_to_link_and_contact() -> None:
    for a, c in zip(*random_scene(50, seed=4), strict=True):
        e = plane_normal(a, c)
        assert abs(e @ a) < ROUNDING
        assert abs(e @ c) < ROUNDING
        assert np.array_equal(e, np.cross(a, c))


def test_eq22_is_a_unit_vector_when_the_contact_is_square_to_the_link() -> None:
    assert plane_normal(X, Z).tolist() == [0.0, -1.0, 0.0]


def test_eq22_with_the_next_link_would_leave_nothing_out_of_plane() -> None:
    directions, contacts = random_scene(20, seed=5)
    for a, c in zip(directions, contacts, strict=True):
        assert side_sign(a, plane_normal(a, c), dead_band=1e-12) == 0.0


# Towards the object


@pytest.mark.parametrize("angle", [-0.8, -0.3, 0.0, 0.3, 0.8])
def test_gamma_points_to_the_object_for_the_next_link_bent_in_the_plane(angle: float) -> None:
    # The object lies below, its normal into link i - 1 points up.
    a = turned(X, Y, angle)
    gamma = towards_object(a, plane_normal(X, Z))
    assert gamma @ -Z == pytest.approx(np.cos(angle))


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("tilt", [0.0, 0.4])
@pytest.mark.parametrize("posture", ["straight", "arched"])
def test_gamma_points_to_the_object_from_every_direction(direction: str, tilt: float, posture: str) -> None:
    settings = WindingSettings(direction=direction, tilt=tilt, posture=posture)
    controller = WindingController(settings)
    seen = controller.observe(settings.initial_posture(), np.zeros(17, dtype=bool))
    touching, following = seen.last - 1, seen.last
    assert touching >= settings.link - 1
    assert driven_arms(seen.in_contact)[following]
    # To the axis of the object, not to its centre: a link may touch far from the middle of a tilted cylinder.
    wound = controller.data.geom("object")
    axis = wound.xmat.reshape(3, 3)[:, 2]
    to_object = wound.xpos - seen.touch.point[touching]
    to_object = unit(to_object - axis * (axis @ to_object))
    link, contact = seen.directions[touching], seen.contact_vectors[touching]
    assert towards_object(seen.directions[following], plane_normal(link, contact)) @ to_object > 0.95
    assert seen.desired[following] @ to_object > 0.95 * settings.speed * settings.dt
    # With the sign of c reversed the same check fails.
    assert towards_object(seen.directions[following], plane_normal(link, -contact)) @ to_object < -0.95


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_contact_vectors_are_minus_the_side_that_the_object_is_on(direction: str) -> None:
    settings = WindingSettings(direction=direction)
    seen = WindingController(settings).observe(np.zeros(49), np.zeros(17, dtype=bool))
    assert np.abs(seen.contact_vectors[5] + DIRECTIONS[direction]).max() < NORMAL


# Equilibria


@pytest.mark.parametrize("n", [4, 8])
def test_the_plan_rests_exactly_in_states_1_and_2_of_all_contact_patterns(n: int) -> None:
    directions, contacts = random_scene(n, seed=n)
    for bits in itertools.product([False, True], repeat=n):
        in_contact = np.array(bits)
        displacements, _ = plan(directions, np.where(in_contact[:, None], contacts, 0.0), in_contact, **STEP)
        is_state = list(bits) == sorted(bits)  # 0…01…1, all 0 or all 1
        assert (not displacements.any()) == is_state
        assert (not driven_arms(in_contact).any()) == is_state


@pytest.mark.parametrize("n", [4, 8])
def test_driven_arms_are_those_with_a_desired_displacement(n: int) -> None:
    directions, contacts = random_scene(n, seed=n)
    for bits in itertools.product([False, True], repeat=n):
        in_contact = np.array(bits)
        displacements, _ = plan(directions, contacts, in_contact, **STEP)
        assert np.array_equal(displacements.any(axis=1), driven_arms(in_contact))


@pytest.mark.parametrize("n", [4, 8])
def test_a_situation_knows_its_equilibrium(n: int) -> None:
    nothing = np.zeros((n, 3))
    touch = Touch(np.zeros(n), nothing, nothing)
    for bits in itertools.product([False, True], repeat=n):
        seen = Situation(nothing, nothing, touch, np.array(bits), nothing, 0, 0, nothing, np.zeros(n))
        resting = Equilibrium.WINDING if any(bits) else Equilibrium.FREE
        assert seen.equilibrium is (resting if list(bits) == sorted(bits) else None)


# Locality


@pytest.mark.parametrize("arm", range(1, 8))
def test_an_arm_is_planned_from_its_own_link_and_the_one_before_alone(arm: int) -> None:
    directions, contacts = random_scene(8, seed=6)
    in_contact = np.zeros(8, dtype=bool)
    in_contact[arm - 1] = True
    before, signs = plan(directions, contacts, in_contact, **STEP)
    assert before[arm].any()
    others = [i for i in range(8) if i not in (arm - 1, arm)]
    directions[others], contacts[others] = (x[others] for x in random_scene(8, seed=7))
    in_contact[others] = True
    after, signs_after = plan(directions, contacts, in_contact, **STEP)
    assert np.array_equal(after[arm], before[arm])
    assert signs_after[arm] == signs[arm]


def test_an_arm_does_not_read_its_own_contact_vector() -> None:
    directions, contacts = random_scene(2, seed=8)
    in_contact = np.array([True, False])
    before, _ = plan(directions, contacts, in_contact, **STEP)
    contacts[1] = -contacts[1]
    assert np.array_equal(plan(directions, contacts, in_contact, **STEP)[0], before)


@pytest.mark.parametrize("which", ["direction", "previous direction", "previous contact vector"])
def test_what_an_arm_does_read_changes_its_plan(which: str) -> None:
    directions, contacts = random_scene(2, seed=9)
    in_contact = np.array([True, False])
    before, _ = plan(directions, contacts, in_contact, **STEP)
    changed, place = {
        "direction": (directions, 1),
        "previous direction": (directions, 0),
        "previous contact vector": (contacts, 0),
    }[which]
    changed[place] = turned(changed[place], unit(np.array([1.0, 2.0, 3.0])), 0.1)
    assert not np.array_equal(plan(directions, contacts, in_contact, **STEP)[0], before)


def test_arms_planned_one_by_one_in_any_order_make_the_plan() -> None:
    rng = np.random.default_rng(10)
    directions, contacts = random_scene(17, seed=10)
    for _ in range(20):
        in_contact = rng.random(17) < 0.5
        displacements, signs = plan(directions, contacts, in_contact, **STEP, dead_band=0.1)
        alone, signs_alone = np.zeros((17, 3)), np.zeros(17)
        for i in rng.permutation(np.arange(1, 17)):
            alone[i], signs_alone[i] = plan_arm(
                directions[i - 1],
                contacts[i - 1],
                in_contact[i - 1],
                directions[i],
                in_contact[i],
                **STEP,
                dead_band=0.1,
            )
        assert np.array_equal(alone, displacements)
        assert np.array_equal(signs_alone, signs)


# First and last link in contact


@pytest.mark.parametrize(
    ("pattern", "expected"),
    [
        ("0000", (0, 0)),
        ("1111", (1, 4)),
        ("0111", (2, 4)),
        ("0100", (2, 2)),
        ("0001", (4, 4)),
        ("1000", (1, 1)),
        ("1011", (1, 1)),
        ("0101", (2, 2)),
        ("01101", (2, 3)),
        ("011011", (2, 3)),
    ],
)
def test_first_and_last_in_contact_stop_at_the_first_gap(pattern: str, expected: tuple[int, int]) -> None:
    assert first_and_last_in_contact(np.array([bit == "1" for bit in pattern])) == expected


def test_arms_planned_together_are_planned_alike_to_the_last_bit() -> None:
    rng = np.random.default_rng(11)
    for _ in range(20):
        directions, contacts = (unit(vectors) for vectors in rng.normal(size=(2, 17, 3)))
        touching = rng.random(17) < 0.5
        together = plan(directions, contacts, touching, **STEP)
        for i in range(1, 17):
            alone = plan_arm(directions[i - 1], contacts[i - 1], touching[i - 1], directions[i], touching[i], **STEP)
            assert np.array_equal(together[0][i], alone[0])
            assert together[1][i] == alone[1]


def test_plane_normals_of_many_arms_are_their_cross_products() -> None:
    a, c = random_scene(17, seed=12)
    assert np.abs(plane_normal(a, c) - np.cross(a, c)).max() < ROUNDING


def test_the_controller_poses_the_same_problem_as_checked_constructors_do() -> None:
    for weights in ("eq23", "eq24", "strict"):
        settings = WindingSettings(weights=weights)
        controller = WindingController(settings)
        q = settings.initial_posture()
        situation = controller.observe(q, np.zeros(17, dtype=bool))
        found = controller.problem(q, situation)
        weight = diagonal_of_weights(winding_weights(situation.last, 17, weights), 3)
        number = np.repeat(winding_priorities(situation.last, 17, weights), 3)
        levels = levels_of(controller.arms.jacobian(controller.data), situation.desired.ravel(), weight, number)
        bounds, rows = found.bounds, found.rows
        checked = IKProblem(
            levels, Bounds(bounds.lower, bounds.upper, bounds.names), Rows(rows.matrix, rows.upper, rows.names)
        )
        assert_same(found, checked)


def assert_same(one: object, other: object) -> None:
    """Whether two records hold the same, arrays to the last bit and read-only."""
    if isinstance(one, np.ndarray):
        assert isinstance(other, np.ndarray)
        assert np.array_equal(one, other)
        assert not one.flags.writeable
    elif dataclasses.is_dataclass(one):
        assert isinstance(one, type(other))  # the controller packs its problems
        for item in dataclasses.fields(other):  # type: ignore[arg-type]
            assert_same(getattr(one, item.name), getattr(other, item.name))
    elif isinstance(one, tuple):
        for part, same in zip(one, other, strict=True):  # type: ignore[call-overload]
            assert_same(part, same)
    else:
        assert one == other


@pytest.mark.parametrize("path", ["compiled", "python"])
def test_a_situation_cannot_be_written(path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = WindingSettings()
    if path == "python":
        monkeypatch.setattr(compiled, "library", lambda: Library(None, "switched off"))
    controller = WindingController(settings)
    situation = controller.observe(settings.initial_posture(), np.zeros(17, dtype=bool))
    for array in (situation.desired, situation.in_contact, situation.positions, situation.touch.distance):
        with pytest.raises(ValueError, match="read-only"):
            array[:] = 1.0
