from dataclasses import asdict
from functools import cache

import numpy as np
import pytest

from paper_repro.artefacts import table_10_failures
from paper_repro.make.artefact import FULL, QUICK
from paper_repro.make.jobs import Job, Results
from paper_repro.measure import disturbed
from paper_repro.measure.disturbed import FAULTS, DeadSensor, wind_with
from paper_repro.measure.singularities import (
    DISTANCES,
    KINDS,
    TOLERANCES,
    approach,
    plain_solve,
    row_norms,
)
from paper_repro.measure.windings import figures_of, is_turned, measured, settings
from prioritized_ik.winding import episode
from prioritized_ik.winding.controller import WindingController
from prioritized_ik.winding.episode import Episode, wind
from prioritized_ik.winding.metrics import measure
from prioritized_ik.winding.plan import driven_arms

LONG_ENOUGH = 140  # steps until several links are wound
SINGULAR = [kind for kind in KINDS if kind != "inner ball"]


def test_a_controller_without_a_fault_winds_as_ever(monkeypatch):
    monkeypatch.setitem(FAULTS, "none", WindingController)
    chosen = settings(link=14, max_steps=30)
    assert wind_with("none", chosen).q.tobytes() == wind(chosen).q.tobytes()


def test_a_fault_is_gone_after_its_winding():
    wind_with("reversed contact", settings(link=14, max_steps=2))
    assert episode.WindingController is WindingController


def test_with_c_reversed_an_arm_says_wound_that_is_folded_and_not_wound():
    chosen = settings("closed form", direction="front")
    figures = figures_of(wind_with("reversed contact", chosen))
    assert figures["outcome"] == "WOUND"
    assert figures["turns_ratio"] < 0.05
    assert figures["bend"] > 3.0
    assert not is_turned(figures)


@cache
def wound_by(fault: str, **changes: object) -> Episode:
    return wind_with(fault, settings(**{"max_steps": LONG_ENOUGH, **changes}))


def test_a_dead_sensor_leaves_a_gap_in_m_that_drives_several_arms():
    found = wound_by("dead sensor", max_steps=240)
    gap = DeadSensor.LINK - 1
    assert not found.in_contact[:, gap].any()
    assert not found.contact_vectors[:, gap].any()
    assert (found.distance[:, gap] <= 2e-3).any()  # it does touch
    assert measure(found).driven_together > 0


def test_the_plan_follows_what_is_felt_and_not_what_touches():
    found = wound_by("dead sensor", max_steps=240)
    for step in range(0, found.steps, 20):
        wanted = found.desired[step].reshape(-1, 3).any(axis=1)
        assert np.array_equal(wanted, driven_arms(found.in_contact[step]))


def test_loose_contacts_come_and_go_alike_in_every_run():
    first = wound_by("loose contacts")
    second = wind_with("loose contacts", first.settings)
    assert first.in_contact.tobytes() == second.in_contact.tobytes()
    assert figures_of(first)["contacts_lost"] > 5


def test_hysteresis_keeps_contacts_that_noise_takes_away():
    with_hysteresis, without = (
        figures_of(wound_by("noisy distance", release_distance=release))["contacts_lost"] for release in (4e-3, 2e-3)
    )
    assert without > 10
    assert with_hysteresis <= 2


@pytest.mark.parametrize("kind", SINGULAR)
def test_a_request_near_a_singular_pose_costs_ten_times_as_much_ten_times_as_near(kind):
    norms = np.array(approach(kind)["norms"])[:, 0]
    assert norms[1:] / norms[:-1] == pytest.approx(10.0, rel=0.15)
    assert norms[-1] > 10.0


@pytest.mark.parametrize("kind", SINGULAR)
def test_truncation_leaves_out_what_is_below_the_tolerance_and_nothing_else(kind):
    found = approach(kind)
    for share, norms in zip(found["share"], found["norms"], strict=True):
        for tolerance, norm in zip(TOLERANCES[1:], norms[1:], strict=True):
            assert norm == pytest.approx(norms[0] if share > tolerance else 0.0, abs=1e-12)


def test_gimbal_lock_of_an_inner_ball_costs_nothing():
    found = approach("inner ball")
    assert found["rank"] == 34
    assert len(DISTANCES) == len(found["norms"])
    assert np.ptp(found["norms"]) < 1e-3


def test_a_plain_solve_of_eq_17_returns_rounding_without_an_error():
    found = plain_solve()
    # How long it is, is rounding too, and depends on the processor.
    assert min(found["plain"]) > 10.0 * max(found["ours"])
    assert max(found["plain"]) > 100.0 * max(found["ours"])
    assert found["same_cost"]


def test_daqp_by_itself_loses_the_weights_that_the_backend_keeps():
    found = row_norms("eq23")
    assert found["raw"] > 0.1
    assert found["normalised"] < 1e-6
    assert found["cost"] > 100.0
    assert found["adapter"] < 1e-9


def test_daqp_by_itself_misses_strict_levels_too():
    found = row_norms("strict")
    assert found["raw"] > 0.1
    assert found["adapter"] < 1e-9


class Answers(Results):
    """Real answers of the solves, one short winding for all windings but faulty ones."""

    def __init__(self, faulty: dict[str, object]) -> None:
        super().__init__({})
        self.winding = measured(settings(link=15, max_steps=40).to_json())
        self.faulty = faulty

    def __getitem__(self, job: Job) -> dict:
        if "settings" not in job.arguments:
            return job()
        return self.winding | (self.faulty if "fault" in job.arguments else {})


@pytest.fixture(scope="module")
def gallery() -> list[tuple[str, ...]]:
    table = table_10_failures.build(QUICK, Answers({"outcome": "SOLVER_FAILED", "contacts_lost": 77}))
    return [tuple(map(str, row)) for row in table.rows]


def test_every_failure_asked_for_is_in_the_gallery(gallery):
    named = {row[0] for row in gallery}
    assert named >= {
        "near a singular pose",
        "wrong sign of c",
        "no hysteresis",
        "no dead band",
        "η·dt too large",
        "M with gaps",
        "collinear tip",
        "row-normalised hierarchy",
    }
    assert all(all(cell for cell in row) for row in gallery)


def test_a_winding_that_a_solver_stopped_is_reported_as_such(gallery):
    (row,) = [row for row in gallery if row[0] == "wrong sign of c"]
    assert "1 stopped by a step that failed" in row[2]
    assert "stopped" not in row[3]


def test_contacts_lost_stand_in_the_row_of_hysteresis(gallery):
    noisy = [row for row in gallery if row[0] == "no hysteresis"][1]
    assert "up to 77 contacts lost" in noisy[2]


def test_the_full_gallery_winds_from_two_sides_with_every_fault():
    arguments = [job.arguments for job in table_10_failures.jobs(FULL) if "fault" in job.arguments]
    for fault in FAULTS:
        directions = {
            text
            for one in arguments
            for text in ("up", "front")
            if f'"{text}"' in one["settings"] and one["fault"] == fault
        }
        assert directions == {"up", "front"}


def test_faults_are_told_apart_by_their_record():
    chosen = settings(link=14, max_steps=25)
    records = {name: asdict(measure(wind_with(name, chosen))) for name in ("reversed contact", "dead sensor")}
    assert records["reversed contact"] != records["dead sensor"]
    assert set(disturbed.FAULTS) >= set(records)
