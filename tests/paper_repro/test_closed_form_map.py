"""Where the closed form winds: the map's cases, the reasons of its failures, and the claims made from it."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from paper_repro.artefacts import closed_form_map, closed_form_stability, figure_closed_form_map
from paper_repro.artefacts.closed_form_map import Case, cases, winding
from paper_repro.make.artefact import FULL, QUICK
from paper_repro.make.jobs import Job, Results
from paper_repro.measure.failing import Reason, examined, reason_of
from paper_repro.measure.windings import SHORT, judged, settings
from prioritized_ik.models import DIRECTIONS
from prioritized_ik.winding.episode import Episode, Outcome, wind

SIDES = tuple(DIRECTIONS)


@cache
def straight(link: int, weights: str = "eq23", direction: str = "up") -> Episode:
    return wind(settings("closed form", link=link, weights=weights, direction=direction))


def test_the_map_is_at_least_8_first_links_2_weights_4_directions_2_tilts_and_5_poses():
    every = cases(FULL)
    assert len(set(every)) == len(every) >= 640
    for field, least in (("link", 8), ("weights", 2), ("direction", 4), ("tilt", 2), ("pose", 5)):
        assert len({getattr(case, field) for case in every}) >= least
    assert len(cases(QUICK)) <= 4


@pytest.mark.parametrize("direction", SIDES)
def test_the_closed_form_winds_a_straight_arm_from_every_direction(direction: str) -> None:
    """What the paper claims of Eqs. 12 to 14 with the weights of Eq. 23."""
    found = examined(straight(SHORT, direction=direction).settings.to_json())
    assert judged(found)[1]
    assert found["turns_ratio"] > 0.97
    assert found["penetration"] < 1.5e-3
    assert found["reason"] is None


def test_with_eq_24_it_winds_one_link_further_than_with_eq_23() -> None:
    assert reason_of(straight(10, "eq24")) is None
    assert reason_of(straight(10, "eq23")) is Reason.F


def test_with_more_than_a_turn_left_the_free_tail_is_in_the_object() -> None:
    assert reason_of(straight(6)) is Reason.T


def in_state(episode: Episode, change: Callable[[np.ndarray], None], name: str) -> Episode:
    """The record with one array changed."""
    changed = getattr(episode, name).copy()
    change(changed)
    return replace(episode, **{name: changed})


DEEP = -3e-3  # [m]


@pytest.mark.parametrize(("link", "reason"), [(12, Reason.P), (13, Reason.P), (14, Reason.T), (17, Reason.T)])
def test_a_deep_link_is_of_the_tail_if_it_comes_after_the_driven_one(link: int, reason: Reason) -> None:
    """At first link 12 is wound and 13 is driven."""

    def sink(distance: np.ndarray) -> None:
        distance[3, link - 1] = DEEP

    assert reason_of(in_state(straight(SHORT), sink, "distance")) is reason


def test_what_goes_wrong_first_is_the_reason() -> None:
    def sink(distance: np.ndarray) -> None:
        distance[5, 16], distance[4, 12] = DEEP, DEEP

    assert reason_of(in_state(straight(SHORT), sink, "distance")) is Reason.P


@pytest.mark.parametrize(("outcome", "reason"), [(Outcome.LOST, Reason.L), (Outcome.OUT_OF_STEPS, Reason.N)])
def test_an_arm_that_is_not_deep_or_folded_has_lost_the_object_or_never_ends(outcome: Outcome, reason: Reason) -> None:
    assert reason_of(replace(straight(SHORT), outcome=outcome)) is reason


def test_a_link_that_ends_folded_and_in_contact_is_folded_and_one_that_unfolds_is_not() -> None:
    def fold(directions: np.ndarray) -> None:
        directions[-3:, 16] = -directions[-3:, 15]

    lost = replace(straight(SHORT), outcome=Outcome.OUT_OF_STEPS)
    assert reason_of(in_state(lost, fold, "directions")) is Reason.F

    def fold_and_unfold(directions: np.ndarray) -> None:
        directions[-3:-1, 16] = -directions[-3:-1, 15]

    assert reason_of(in_state(lost, fold_and_unfold, "directions")) is Reason.N


def test_turns_that_are_missing_for_no_other_reason_are_short() -> None:
    def apart(distance: np.ndarray) -> None:
        del distance

    episode = in_state(straight(15), apart, "distance")
    moved = replace(episode, positions=np.repeat(episode.positions[:1], len(episode.positions), axis=0))
    assert reason_of(replace(moved, directions=np.repeat(episode.directions[:1], len(moved.q), axis=0))) is Reason.S


GOOD = {"outcome": "WOUND", "turns_ratio": 0.98, "penetration": 0.0, "bend": 1.0, "largest_step": 0.1, "reason": None}
BAD = {**GOOD, "turns_ratio": 0.4, "reason": "F"}


class Answers(Results):
    """A good winding to every job but those from first link 6."""

    def __init__(self) -> None:
        super().__init__({})

    def __getitem__(self, job: Job) -> dict:
        return BAD if '"link": 6,' in job.arguments["settings"] else GOOD


def test_the_map_counts_by_first_link_and_names_the_reasons() -> None:
    table = closed_form_map.build(FULL, Answers())
    keys = [column.key for column in table.columns]
    for row in (dict(zip(keys, cells, strict=True)) for cells in table.rows):
        count = row["windings_a_first_link"]
        assert count == (12 if row["pose"] == "random" else 4)
        assert (row["first_link_6"], row["first_link_12"]) == (0, count)
        assert (row["in_contact"], row["turned"]) == (9 * count, 8 * count)
        assert row["reasons"] == f"F {count}"
    assert len(table.rows) == 2 * 2 * 2 * 3


def test_the_figure_of_the_map_has_a_cell_a_winding_and_a_letter_a_failure() -> None:
    figure = figure_closed_form_map.build(FULL, Answers())
    assert sum(len(panel.patches) for panel in figure.axes) == len(cases(FULL))
    letters = [text.get_text() for panel in figure.axes for text in panel.texts]
    assert letters.count("F") == len(cases(FULL)) / 9


def test_stability_changes_one_choice_at_a_time() -> None:
    changes = closed_form_stability.CHANGES
    assert not next(iter(changes.values()))
    assert {name for change in changes.values() for name in change} >= {"dt", "contact_distance", "options"}
    default = closed_form_stability.group(FULL, "none", "eq23", 12)
    assert len({job.key for job in default}) == 4


def test_a_case_says_what_its_winding_is() -> None:
    chosen = winding(Case(1e-3, "eq24", 0.3, "random 2", "back", 9))
    assert (chosen.options.rank_tolerance, chosen.weights, chosen.tilt, chosen.posture, chosen.seed) == (
        1e-3,
        "eq24",
        0.3,
        "random",
        2,
    )
    assert (chosen.direction, chosen.link, chosen.limits, chosen.contacts) == ("back", 9, False, False)
