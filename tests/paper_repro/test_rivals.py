"""The methods that the paper names: what each of them knows, and how their windings end."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from paper_repro.artefacts.table_12_rivals import ARMS, METHODS, OBJECTS, BallArm, build, cases, clearance, episode_of, jobs
from paper_repro.make.artefact import FULL, QUICK
from paper_repro.make.jobs import Job, Results
from paper_repro.measure.lateral_inhibition import PROFILE, RATE, YIELDING, LateralInhibition, bending
from paper_repro.measure.windings import figures_of, judged, settings
from prioritized_ik.models import PLANAR_ARM, Arm
from prioritized_ik.solvers.methods import Place
from prioritized_ik.winding.controller import Situation, WindingController
from prioritized_ik.winding.episode import Episode

LONG_ARM, SHORT_ARM = "17 links, 49 joints, longer", "8 links, 24 joints"
SKIN = 2e-3  # [m]


@cache
def wound(wound: str, method: str, arm: str = LONG_ARM) -> Episode:
    return episode_of(arm, wound, method, "front")


def test_the_arm_of_8_links_has_24_joints() -> None:
    assert BallArm(links=8).joint_count == 24
    assert BallArm(links=8).spec().compile().nv == 24


@pytest.mark.parametrize("arm", [LONG_ARM, SHORT_ARM])
def test_lateral_inhibition_winds_within_a_joints_range(arm: str) -> None:
    assert judged(figures_of(wound("cylinder", "lateral inhibition", arm))) == (True, True, True)


def test_lateral_inhibition_is_planar_also_around_a_tilted_object() -> None:
    """The paper's claim: with parallel axes the winding reduces to a planar movement."""
    for shape in ("cylinder", "cylinder, tilted 0.3 rad"):
        assert np.abs(wound(shape, "lateral inhibition").positions[..., 2]).max() < 1e-9
    assert np.abs(wound("cylinder, tilted 0.3 rad", "virtual arms, Eq. 23, QP").positions[..., 2]).max() > 0.1


def test_beyond_a_turn_a_planar_winding_lies_in_itself_and_a_helical_one_beside_itself() -> None:
    tilted = "cylinder, tilted 0.3 rad"
    planar, helical = (wound(tilted, method) for method in ("lateral inhibition", "virtual arms, Eq. 23, QP"))
    assert clearance(planar.settings, planar.q[-1]) < -0.015
    assert clearance(helical.settings, helical.q[-1]) > 0.02


def test_clearance_of_a_straight_arm_is_a_link_less_its_two_ends() -> None:
    arm = Arm()
    assert clearance(settings(), np.zeros(arm.joint_count)) == pytest.approx(arm.link_length - 2.0 * arm.radius)


# The scheme


def situation(*touching: int, distance: float = 1e-3) -> Situation:
    """A straight arm with an object along all of it from the front, of which these links feel a contact."""
    chosen = settings("closed form", direction="front", link=min(touching))
    state = WindingController(chosen)
    seen = state.observe(chosen.initial_posture(), np.zeros(17, dtype=bool))
    felt = np.isin(np.arange(1, 18), touching)
    vectors = np.where(felt[:, None], [0.0, 1.0, 0.0], 0.0)  # into the link: the object is at -y
    touch = replace(seen.touch, distance=np.where(felt, distance, 1.0))
    return replace(seen, touch=touch, in_contact=felt, contact_vectors=vectors, first=min(touching), last=_run(touching))


def _run(touching: tuple[int, ...]) -> int:
    last = min(touching)
    while last + 1 in touching:
        last += 1
    return last


def test_a_link_in_contact_excites_the_next_joint_towards_the_object() -> None:
    step = bending(situation(6, distance=SKIN), SKIN)  # no pressure
    assert np.flatnonzero(step).tolist() == [6]  # joint 7
    assert step[6] == pytest.approx(-RATE)  # about z, towards -y


def test_beyond_a_gap_in_the_contacts_nothing_is_excited() -> None:
    assert np.flatnonzero(bending(situation(6, 7, 9, distance=SKIN), SKIN)).tolist() == [7]


def test_pressure_moves_a_link_aside_and_leaves_the_arm_beyond_where_it_is() -> None:
    arm, link = PLANAR_ARM, 3
    pressed = np.zeros(arm.links)
    for place, share in PROFILE.items():
        pressed[link - 1 + place] = share * 1e-4
    headings = np.cumsum(pressed)
    ends = arm.link_length * np.cumsum(np.sin(headings))
    assert ends[[link - 2, link - 1]] == pytest.approx(-1e-4 * arm.link_length, rel=1e-6)  # both of its ends
    assert np.abs(ends[[0, *range(link, arm.links)]]).max() < 1e-12


def test_a_pressed_link_gives_way_to_the_side_away_from_the_object() -> None:
    step = bending(situation(6, 7, distance=0.0), SKIN) - bending(situation(6, 7, distance=SKIN), SKIN)
    headings = np.cumsum(step)
    ends = np.cumsum(np.sin(headings))
    assert ends[5] > 0.5 * YIELDING * np.cos(0.1)  # end of link 6, towards +y
    assert abs(ends[-1]) < 1e-3 * YIELDING


def test_without_contact_nothing_moves_and_the_problem_of_virtual_arms_is_not_looked_at() -> None:
    chosen = settings("closed form", direction="front", gap=0.05)
    step = LateralInhibition(chosen).step(None, place=Place(chosen.initial_posture(), chosen))  # type: ignore[arg-type]
    assert step.dtheta is not None
    assert not step.dtheta.any()


# The table


class Answers(Results):
    """The same answer to every job."""

    def __init__(self) -> None:
        super().__init__({})

    def __getitem__(self, job: Job) -> dict:
        round_one = job.arguments["wound"] != "ellipsoid"
        good = {"outcome": "WOUND", "turns": 1.2, "penetration": 0.0, "bend": 1.0, "clearance": 0.01, "steps": 300}
        return {**good, "turns_ratio": 0.98 if round_one else None}


def test_every_method_has_a_row_on_every_arm_and_object() -> None:
    table = build(FULL, Answers())
    assert len(table.rows) == len(ARMS) * len(OBJECTS) * len(METHODS)
    assert len({job.key for job in jobs(FULL)}) == 2 * len(cases(FULL))
    assert len(jobs(QUICK)) == len(METHODS)
    keys = [column.key for column in table.columns]
    for row in (dict(zip(keys, cells, strict=True)) for cells in table.rows):
        assert row["in_contact"] == 2
        assert row["turned"] == (None if row["object"] == "ellipsoid" else 2)
