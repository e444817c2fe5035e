import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from winding_fixtures import recorded, short_episode

from prioritized_ik.models import DIRECTIONS
from prioritized_ik.winding import controller
from prioritized_ik.winding.episode import Episode, Outcome, wind
from prioritized_ik.winding.metrics import bends, drift, ideal_angle, measure, sign_flips, turns_about
from prioritized_ik.winding.settings import CLOSED_FORM, WindingSettings

EXACT = 1e-12  # a few sines and arc tangents
WELL_WOUND = 0.95  # of the ideal: a regular polygon of tangent links less what the first and last leave open
DEEPEST = 1.5e-3  # [m] rows are linear in a step, links are curved paths: a millimetre and a half is lost at most
IN_RANGE = 1e-6  # [rad]


def helix(turns: float, points: int, pitch: float = 0.1) -> np.ndarray:
    angle = 2.0 * math.pi * turns * np.linspace(0.0, 1.0, points)
    return np.column_stack([0.08 * np.cos(angle), 0.08 * np.sin(angle), pitch * angle])


def rotation(seed: int) -> np.ndarray:
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


@pytest.mark.parametrize("turns", [0.1, 0.5, 1.0, 2.75, -1.5])
def test_the_turns_of_a_helix_are_counted_past_one(turns):
    assert turns_about(helix(turns, 40), np.zeros(3), np.eye(3)) == pytest.approx(abs(turns), abs=EXACT)


@pytest.mark.parametrize("seed", range(5))
def test_the_turns_of_a_helix_do_not_depend_on_where_it_stands(seed):
    frame, centre = rotation(seed), np.array([0.3, -0.1, 0.7])
    points = helix(1.3, 20) @ frame.T + centre
    assert turns_about(points, centre, frame) == pytest.approx(1.3, abs=EXACT)


def test_a_path_that_turns_back_gains_nothing():
    there = helix(0.4, 20)
    assert turns_about(np.vstack([there, there[::-1]]), np.zeros(3), np.eye(3)) == pytest.approx(0.0, abs=EXACT)


def test_the_ideal_angle_of_the_papers_link_and_cylinder_is_41_degrees():
    assert math.degrees(ideal_angle(0.06, 0.08)) == pytest.approx(41.1, abs=0.05)


def test_links_that_touch_at_their_middles_turn_by_the_ideal_angle():
    # Two tangent links of 60 mm, their middles 80 mm from the axis, meet in one point.
    half = 0.5 * ideal_angle(0.06, 0.08)
    first_end = np.array([0.08, 0.03])
    second_start = 0.08 * np.array([np.cos(2 * half), np.sin(2 * half)]) - 0.03 * np.array(
        [-np.sin(2 * half), np.cos(2 * half)]
    )
    assert second_start == pytest.approx(first_end, abs=EXACT)


def test_a_tilt_shortens_the_link_by_its_cosine():
    assert ideal_angle(0.06, 0.08, 0.3) == ideal_angle(0.06 * math.cos(0.3), 0.08)


def test_bends_are_the_angles_between_neighbours():
    directions = np.array([[1.0, 0, 0], [1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0], [0, -math.cos(0.2), math.sin(0.2)]])
    assert bends(directions) == pytest.approx([0.0, math.pi / 2, math.pi, 0.2], abs=EXACT)


def test_a_tiny_bend_is_not_lost_to_rounding():
    directions = np.array([[1.0, 0.0, 0.0], [math.cos(1e-9), math.sin(1e-9), 0.0]])
    assert bends(directions) == pytest.approx([1e-9], rel=1e-6)


def test_bends_are_taken_state_by_state():
    assert bends(recorded().directions).shape == (recorded().steps + 1, 16)


def test_sign_flips_count_changes_of_side_and_ignore_zeros():
    signs = np.array([[1, 0, 0], [0, 0, -1], [-1, 0, -1], [-1, 0, 0], [1, 0, -1]], dtype=float)
    assert sign_flips(signs) == 2


def drifting(positions: np.ndarray, in_contact: list[list[bool]]) -> Episode:
    return replace(short_episode(), positions=positions, in_contact=np.array(in_contact))


def test_drift_is_the_way_of_a_link_end_since_its_link_was_wound():
    positions = np.zeros((4, 3, 3))
    positions[1:, 0, 0] = 5.0  # before link 1 is wound: not counted
    positions[2, 1, 1] = 3e-3  # link 2 comes into contact here
    positions[3, 1, 1] = 7e-3
    episode = drifting(positions, [[False] * 3, [True, False, False], [True, True, False], [True, True, False]])
    assert drift(episode) == pytest.approx(4e-3, abs=EXACT)


def test_drift_is_the_largest_and_not_the_last():
    positions = np.zeros((3, 3, 3))
    positions[1, 0, 2] = 2e-3
    assert drift(drifting(positions, [[True, False, False]] * 3)) == pytest.approx(2e-3, abs=EXACT)


def test_a_link_beyond_a_gap_does_not_count_as_wound():
    positions = np.zeros((2, 3, 3))
    positions[1, 2, 0] = 1.0
    assert drift(drifting(positions, [[True, False, True]] * 2)) == 0.0


def test_an_arm_that_touched_nothing_has_not_drifted():
    assert drift(drifting(np.zeros((2, 3, 3)), [[False] * 3] * 2)) == 0.0


def test_the_ratio_is_turns_over_the_ideal_of_the_links_beyond_the_first():
    figures = measure(recorded())
    ideal = (17 - 6) * ideal_angle(0.06, 0.08) / (2.0 * math.pi)
    assert figures.turns_ratio == pytest.approx(figures.turns / ideal, rel=EXACT)
    assert figures.steps == recorded().steps


def test_the_penetration_is_the_deepest_ever_and_negative_if_there_was_none():
    assert measure(recorded()).penetration == -recorded().distance.min()
    deep = np.array(recorded().distance)
    deep[100, 7] = -0.005
    assert measure(replace(recorded(), distance=deep)).penetration == 0.005


def test_a_hinge_outside_its_range_shows():
    q = np.array(recorded().q)
    q[50, 3] = -1.25
    assert measure(replace(recorded(), q=q)).hinge_excess == pytest.approx(0.25, abs=EXACT)


def test_steps_that_drive_two_arms_are_counted():
    contact = np.zeros((short_episode().steps + 1, 17), dtype=bool)
    contact[:, 2] = True
    contact[4:7, 5] = True  # a gap behind link 3: arms 4 and 7 are driven
    assert measure(replace(short_episode(), in_contact=contact)).driven_together == 3


def test_an_object_that_is_not_round_has_no_ideal():
    settings = WindingSettings(shape="box", size=(0.07, 0.07, 0.5), max_steps=1)
    assert measure(wind(settings)).turns_ratio is None


WINDINGS = list(itertools.product(DIRECTIONS, (6, 9), (0.0, 0.3)))


@pytest.mark.parametrize("solver", ["daqp", "proxqp"])
@pytest.mark.parametrize(("direction", "link", "tilt"), WINDINGS)
def test_the_arm_winds_well_within_its_joints_and_outside_the_object(solver, direction, link, tilt):
    episode = recorded(direction, solver, link, tilt)
    figures = measure(episode)
    assert episode.outcome is Outcome.WOUND
    assert figures.turns_ratio >= WELL_WOUND
    assert figures.penetration <= DEEPEST
    assert figures.hinge_excess <= IN_RANGE
    # Two hinges at their limits bend a link most: cos of the bend is the product of their cosines.
    assert figures.bend <= math.acos(math.cos(episode.settings.arm.joint_range) ** 2) + IN_RANGE


@pytest.fixture(scope="module")
def closed_form_episode() -> Episode:
    return wind(WindingSettings(solver=CLOSED_FORM, limits=False, contacts=False))


def test_the_closed_form_alone_bends_joints_beyond_their_range(closed_form_episode):
    assert measure(closed_form_episode).hinge_excess > 0.1


def test_the_closed_form_alone_drives_links_into_the_object(closed_form_episode):
    assert measure(closed_form_episode).penetration > 10e-3


@pytest.fixture
def reversed_contact(monkeypatch):
    """Contact vectors that point into the object instead of into the link."""
    right = controller.plan

    def plan(directions, contact_vectors, in_contact, **options):
        return right(directions, -contact_vectors, in_contact, **options)

    monkeypatch.setattr(controller, "plan", plan)
    monkeypatch.setattr(controller, "compiled_look", lambda parts: None)  # which plans by itself


@pytest.mark.usefixtures("reversed_contact")
def test_contact_vectors_of_the_wrong_sign_do_not_wind():
    # Well past the 293 steps that the right sign takes.
    assert measure(wind(WindingSettings(max_steps=400))).turns_ratio < WELL_WOUND


@pytest.mark.usefixtures("reversed_contact")
def test_every_link_in_contact_is_not_a_winding():
    episode = wind(WindingSettings(direction="front", solver=CLOSED_FORM, limits=False, contacts=False))
    assert episode.outcome is Outcome.WOUND
    assert measure(episode).turns_ratio < 0.1
