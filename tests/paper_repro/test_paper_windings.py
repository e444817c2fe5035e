import math
from dataclasses import replace

import numpy as np
import pytest
from winding_fixtures import short_episode

from paper_repro.artefacts import (
    closed_form_episodes,
    closed_form_map,
    closed_form_stability,
    figure_6_windings,
    figure_7_weights,
    figure_penetration,
    leaves_open,
    outcomes,
    sensitivity,
    table_8_windings,
    table_9_ablation,
)
from paper_repro.artefacts.facts import known_facts
from paper_repro.make import drawing3d
from paper_repro.make.artefact import FULL, QUICK, Scale
from paper_repro.make.jobs import Job, Results
from paper_repro.measure.windings import (
    counted,
    is_within_range,
    judged,
    measured,
    measured_job,
    motions,
    settings,
    story,
    wound_to,
)
from prioritized_ik.errors import InputError
from prioritized_ik.models import DIRECTIONS, Arm
from prioritized_ik.solvers.closed_form import minimum_norm_solution, rank_decomposition_svd, weighted_optimum
from prioritized_ik.solvers.hierarchy import strict_solution
from prioritized_ik.solvers.step import StepStatus
from prioritized_ik.winding.cameras import View
from prioritized_ik.winding.episode import wind

SMALL = Scale("full", seeds=3, steps=1, directions=("up", "front"), solvers=None)
GOOD = {
    "outcome": "WOUND",
    "message": "",
    "turns_ratio": 0.98,
    "penetration": 0.5e-3,
    "bend": 1.27,
    "hinge_excess": -0.1,
    "drift": 2e-3,
    "steps": 300,
    "flips": 0,
    "driven_together": 0,
    "contacts_lost": 0,
    "tail_path": 1.5,
    "free_path": 7.0,
    "free_step": 5e-3,
    "turns": 1.2,
    "largest_step": 0.1,
    "reason": None,
    "status": {status.name: 0 for status in StepStatus} | {"SOLVED": 300},
}


class Answers(Results):
    """The same answer to every job, or another to those whose settings contain a text."""

    def __init__(self, others: dict[str, dict] | None = None) -> None:
        super().__init__({})
        self.others = others or {}

    def __getitem__(self, job: Job) -> dict:
        text = job.arguments.get("settings", "")
        return {**GOOD, **next((other for part, other in self.others.items() if part in text), {})}


@pytest.mark.parametrize("weights", ["eq23", "strict"])
def test_windings_by_the_closed_form_take_the_steps_of_eqs_12_and_14(weights):
    """Against the equations one by one; with strict priorities against their nullspace form."""
    episode = wind(settings("closed form", link=14, weights=weights, direction="front"))
    tolerance = episode.settings.options.rank_tolerance
    assert set(episode.status) == {StepStatus.CLOSED_FORM.name}
    for problem, dtheta in zip(episode.problems(), episode.dtheta, strict=True):
        if weights == "strict":
            expected = strict_solution(problem.levels, problem.reference, tolerance)
        else:
            (level,) = problem.levels
            split = rank_decomposition_svd(level.matrix, tolerance)  # Eq. (6)
            dx_b = weighted_optimum(split.j_a, level.weights, level.target)  # Eq. (12)
            expected = minimum_norm_solution(split.j_b, dx_b)  # Eq. (14)
        assert dtheta == pytest.approx(expected, abs=1e-9 * max(1.0, np.abs(expected).max()))


def test_a_good_winding_is_wound_in_every_term():
    assert judged(GOOD) == (True, True, True)
    assert is_within_range(GOOD)


@pytest.mark.parametrize(
    ("flaw", "terms"),
    [
        ({"outcome": "OUT_OF_STEPS"}, (False, False, False)),
        ({"outcome": "LOST"}, (False, False, False)),
        ({"turns_ratio": 0.94}, (True, False, False)),
        ({"penetration": 2.1e-3}, (True, False, False)),
        ({"bend": 1.6}, (True, True, False)),
        ({"bend": 1.6, "turns_ratio": 0.94}, (True, False, False)),
    ],
    ids=str,
)
def test_each_term_of_being_wound_asks_for_more_than_the_one_before(flaw, terms):
    assert judged({**GOOD, **flaw}) == terms
    assert counted([GOOD, {**GOOD, **flaw}]) == tuple(1 + term for term in terms)


def contacts(*last: int) -> np.ndarray:
    """M of an arm of four links whose first is in contact, up to the link given, state by state."""
    return np.array([[link <= k for link in range(1, 5)] for k in last])


def test_only_ends_of_links_that_are_neither_wound_nor_next_count_as_free():
    positions = np.zeros((3, 4, 3))
    positions[1:, 2, 0] = 0.01  # link 3 moves while link 1 is wound: free, as link 2 is next
    positions[2, 3, 1] = 0.02  # link 4 moves while link 2 is wound: free
    positions[2, 2, 0] = 0.5  # link 3 moves while it is next: not free
    positions[1:, 0, 2] = 0.3  # link 1 is wound
    episode = replace(short_episode(), positions=positions, in_contact=contacts(1, 2, 3))
    assert wound_to(episode).tolist() == [1, 2, 3]
    found = motions(episode)
    assert found["free_path"] == pytest.approx(0.03)
    assert found["free_step"] == pytest.approx(0.03 / 3)  # links 3 and 4, then link 4
    assert found["tail_path"] == pytest.approx(0.02)


def test_an_arm_wound_to_its_end_has_nothing_free():
    episode = replace(short_episode(), positions=np.zeros((2, 4, 3)), in_contact=contacts(4, 4))
    assert motions(episode) == {"tail_path": 0.0, "free_path": 0.0, "free_step": 0.0}


SHORT = settings("qp", link=15, max_steps=45)


def test_statuses_of_a_measured_winding_add_up_to_its_steps():
    found = measured(SHORT.to_json())
    assert sum(found["status"].values()) == found["steps"] > 0


@pytest.mark.parametrize(("stages", "every", "count"), [(4, 0, 4), (6, 20, None)])
def test_a_story_begins_and_ends_with_the_winding_and_agrees_with_its_figures(stages, every, count):
    told, figures = story(SHORT.to_json(), stages, every), measured(SHORT.to_json())
    shown = told["shown"]
    assert shown[0] == 0
    assert shown[-1] == figures["steps"]
    assert len(shown) == (count or math.ceil(figures["steps"] / every) + 1)
    assert every == 0 or all(step % every == 0 for step in shown[:-1])
    assert max(told["penetration_path"]) == figures["penetration"]
    assert max(told["bend_path"]) == figures["bend"]
    assert np.shape(told["q"]) == (len(shown), Arm().joint_count)
    assert len(told["tail"]) == len(told["wound_to"]) == figures["steps"] + 1


def row_of(table, **wanted: object) -> dict[str, object]:
    keys = [column.key for column in table.columns]
    rows = [dict(zip(keys, row, strict=True)) for row in table.rows]
    (found,) = [row for row in rows if wanted.items() <= row.items()]
    return found


def test_table_8_keeps_the_worst_apart_from_the_median_and_counts_it_in_its_direction_only():
    folded = {"turns_ratio": 0.1, "bend": 3.0, "penetration": 60e-3}
    answers = Answers({'"direction": "up", "link": 6, "tilt": 0.0, "gap": 0.001, "posture": "random", "seed": 2': folded})
    table = table_8_windings.build(SMALL, answers)
    case = {"weights": "Eq. 23", "method": "QP"}
    median, worst = (row_of(table, **case, direction="up", statistic=name) for name in ("median", "worst"))
    assert (median["turns_ratio"], median["bend_rad"], median["penetration_mm"]) == pytest.approx((0.98, 1.27, 0.5))
    assert (worst["turns_ratio"], worst["bend_rad"], worst["penetration_mm"]) == pytest.approx((0.1, 3.0, 60.0))
    assert (median["in_contact"], median["turned"], median["within_range"]) == (3, 2, 2)
    assert row_of(table, **case, direction="front", statistic="median")["turned"] == 3
    long, short = (row_of(outcomes.build(SMALL, answers), **case, first_link=link) for link in (6, 12))
    assert [long[f"random_{term}"] for term in ("in_contact", "turned", "within_range")] == [6, 5, 5]
    assert [long["straight_turned"], short["straight_turned"], short["random_turned"]] == [2, 2, 6]
    assert long["penetration_mm_worst"] == pytest.approx(60.0)


def test_table_8_reports_windings_that_did_not_end_in_contact():
    clean = table_8_windings.build(SMALL, Answers())
    failed = table_8_windings.build(SMALL, Answers({'"weights": "strict"': {"outcome": "SOLVER_FAILED"}}))
    assert "Of 36 windings, 0 did not end" in clean.notes
    assert "Of 36 windings, 12 did not end" in failed.notes
    assert "12 'the solver gave no step" in failed.notes


def test_table_8_is_twenty_seeds_of_every_case_and_no_wider_than_a_page():
    assert len({job.key for job in table_8_windings.jobs(SMALL)}) == 2 * 3 * 2 * 3
    assert FULL.seeds >= 20
    assert set(FULL.directions) == set(DIRECTIONS)
    assert len(table_8_windings.COLUMNS) <= 14


def test_table_9_counts_steps_that_failed_and_never_drops_them():
    status = GOOD["status"] | {"SOLVED": 5, "INFEASIBLE": 1, "UNCERTIFIED": 2, "NOT_FOUND": 1, "VIOLATED": 3}
    table = table_9_ablation.build(SMALL, Answers({'"contacts": false': {"status": status, "outcome": "SOLVER_FAILED"}}))
    row = row_of(table, constraints="limits", direction="up")
    windings = 4  # the straight pose and three random ones
    assert (row["infeasible"], row["uncertified"], row["not_found"]) == (windings, 2 * windings, 4 * windings)
    assert (row["in_contact"], row["turned"], row["within_range"]) == (0, 0, 0)
    assert row_of(table, constraints="both", direction="up")["within_range"] == windings


def test_artefacts_share_the_windings_that_they_have_in_common():
    of_8, of_9, of_sensitivity = (
        {job.key for job in module.jobs(SMALL)} for module in (table_8_windings, table_9_ablation, sensitivity)
    )
    random = measured_job(settings(direction="front", posture="random", seed=0)).key
    assert random in of_8 & of_9 & of_sensitivity
    assert measured_job(settings(direction="front")).key in of_9 & of_sensitivity
    assert {job.key for job in figure_6_windings.jobs(FULL)} == {job.key for job in figure_penetration.jobs(FULL)}


def test_sensitivity_changes_one_choice_at_a_time_from_the_default_of_each_method():
    for choice in sensitivity.CHOICES:
        for method in sensitivity.methods(choice):
            default = [job.key for job in sensitivity.base(SMALL, method)]
            values = [value for name, value in sensitivity.values(SMALL) if name == choice]
            assert sum([job.key for job in sensitivity.windings(SMALL, method, choice, v)] == default for v in values) == 1
    table = sensitivity.build(SMALL, Answers({'"radius": 0.005': {"penetration": 9e-3}}))
    assert row_of(table, choice="link radius [mm]", value="5")["qp_turned"] == 0
    assert row_of(table, choice="link radius [mm]", value="10")["qp_turned"] == 2
    assert row_of(table, choice="joint range [rad]", value="±0.8")["closed_form_turned"] is None


def test_every_choice_that_the_paper_leaves_open_is_tried_or_says_why_not():
    left_open = {fact.id for fact in known_facts() if not fact.is_stated}
    assert left_open == {*leaves_open.TRIED, *leaves_open.ELSEWHERE}
    tried = [choice for choices in leaves_open.TRIED.values() for choice in choices]
    assert sorted(tried) == sorted(sensitivity.CHOICES)
    table = leaves_open.build(SMALL, Answers())
    assert len(table.rows) == len(tried) + len(leaves_open.ELSEWHERE)


def test_a_choice_decides_where_a_value_loses_half_of_the_windings_and_comes_first():
    table = leaves_open.build(SMALL, Answers({'"dead_band": 0.1': {"penetration": 9e-3}}))
    first = dict(zip([column.key for column in table.columns], table.rows[0], strict=True))
    assert first["choice"] == "dead band of Eq. 21 [–]"
    assert first["matters"] == "decides"
    assert {row[3] for row in table.rows[1:]} == {"little", "–"}
    assert leaves_open.matters([leaves_open.Effect(4, 1, "", ""), leaves_open.Effect(4, 0, "", "")]) == "matters"


@pytest.mark.parametrize(
    "module",
    [
        table_8_windings,
        table_9_ablation,
        sensitivity,
        leaves_open,
        outcomes,
        closed_form_map,
        closed_form_stability,
        closed_form_episodes,
    ],
)
def test_every_job_of_the_reduced_run_is_there_when_its_table_is_built(module):
    asked = {job.key for job in module.jobs(QUICK)}

    class Known(Answers):
        def __getitem__(self, job: Job) -> dict:
            assert job.key in asked
            return super().__getitem__(job)

    assert module.build(QUICK, Known()).rows


def test_points_are_seen_where_the_view_projects_them():
    view = View(90.0, 0.0, (1.0, 2.0, 3.0), 1.0, 1.0)
    seen = view.project(np.array([[1.1, 5.0, 3.0], [1.0, -4.0, 3.2]]))  # along +y: x to the right, z up, y unseen
    assert seen == pytest.approx(np.array([[0.1, 0.0], [0.0, 0.2]]))


@pytest.mark.parametrize("sight", [(68.0, -22.0), (75.0, -50.0), (107.0, 10.0)])
def test_a_view_of_a_rectangle_shows_that_rectangle(sight):
    rectangle = np.array([0.2, 0.9, -0.3, 0.1])
    view = drawing3d.view_of(rectangle, sight)
    flat = View(*sight, (0.0, 0.0, 0.0), 1.0, 1.0)
    point = np.array([0.3, -0.2, 0.5])
    assert (view.width, view.height) == pytest.approx((0.7, 0.4))
    assert view.project(point) == pytest.approx(flat.project(point) - [0.55, -0.1])


def test_the_rendered_arm_is_where_the_view_projects_it_and_the_rest_is_white(renders):
    chosen = settings("qp")
    q = chosen.arm.posture("arched")[None]
    ends = np.array(story(settings("qp", posture="arched", max_steps=1).to_json(), 2)["positions"][0])
    view, resolution = drawing3d.view_of(np.array([0.0, 1.1, -0.4, 0.4]), (80.0, -20.0)), 400.0
    pictures = drawing3d.rendered(chosen, q, np.zeros((1, 17), dtype=bool), [view], resolution)
    assert pictures is not None
    (picture,) = pictures
    assert picture.shape == (320, 440, 3)
    assert (picture[5, 5] == 255).all()
    right, up = (view.project(0.5 * (ends[-2] + ends[-1])) * resolution).round().astype(int)
    red, _, blue = picture[160 - up, 220 + right].astype(int)
    assert blue > red + 40


def no_renderer(*arguments: object) -> None:
    raise InputError("cannot render here")


@pytest.mark.parametrize("able", [True, False])
def test_figure_6_falls_back_to_lines_where_mujoco_cannot_render(able, monkeypatch, request):
    monkeypatch.setattr(
        figure_6_windings,
        "winding",
        lambda direction, method, link: settings(method, direction=direction, link=14, tilt=0.3),
    )
    if able:
        request.getfixturevalue("renders")
    else:
        monkeypatch.setattr(drawing3d, "poses", no_renderer)
    scale = Scale("quick", 1, 1, ("up",), None)
    results = Results({job.key: job() for job in figure_6_windings.jobs(scale)})
    panels = figure_6_windings.build(scale, results).axes
    assert len(panels) == len(figure_6_windings.SHOWN) * len(figure_6_windings.STAGES)
    assert all(bool(panel.images) is able and bool(panel.lines) is not able for panel in panels)


def test_figures_of_penetration_and_of_weights_show_each_winding(monkeypatch):
    short = settings("qp", link=15, max_steps=40)
    told = story(short.to_json(), 6, figure_6_windings.EVERY)

    class Same(Results):
        def __getitem__(self, job: Job) -> dict:
            return told

    figure = figure_penetration.build(SMALL, Same({}))
    assert [len(panel.lines) for panel in figure.axes] == [4] * 4  # three windings and what counts as wound
    figure = figure_7_weights.build(SMALL, Same({}))
    assert len(figure.axes) == 8
    assert all(f"path {told['tail_path']:.2f} m" in panel.texts[-1].get_text() for panel in figure.axes[:6])
