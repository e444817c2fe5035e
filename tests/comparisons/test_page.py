"""What the page is made of: figures worked out by hand, and text that can never be markup."""

import base64
import io
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import polars
import pytest
from page_fixtures import CASE, COUNT, FAST, MESSAGE, OFF, SLOW, TIMES, WRONG, SmallStore

from comparisons.page import replays as replaying
from comparisons.page import write_page
from comparisons.page.agreement import agreement, digits
from comparisons.page.courses import FAILED, courses
from comparisons.page.failures import failures
from comparisons.page.page import data
from comparisons.page.profile import profiles, stairs_of
from comparisons.page.quantised import LARGEST
from comparisons.page.replays import moved, replays
from comparisons.page.scenes import Drawn
from comparisons.page.series import Answers, answers_of, labels
from comparisons.page.verdicts import finding, verdicts
from comparisons.summary import Row, summarise
from prioritized_ik.errors import EpisodeFileError, InputError
from prioritized_ik.problem import IKProblem, Level
from prioritized_ik.problem_file import load_problem
from prioritized_ik.recording import Recording

OFF_WORDS = "answered, and was wrong by more than the verdict allows"
QUANTISED = 5e-5  # [m] half a step of 16-bit numbers over an arm of 1 m measures 8e-6


def positions_of(motion: dict[str, Any]) -> np.ndarray:
    """The end points (states, links, 3) [m] of what `moved` returned, as the page's script reads them."""
    whole = np.frombuffer(base64.b64decode(motion["positions"]), dtype="<i2").reshape(-1, motion["links"], 3)
    return np.asarray(motion["centre"]) + motion["unit"] * whole


@pytest.fixture
def store(tmp_path: Path) -> SmallStore:
    return SmallStore(tmp_path)


@pytest.fixture
def rows(store: SmallStore) -> list[Row]:
    return summarise(store.steps(), store.episodes())


@pytest.fixture
def answers(store: SmallStore) -> Answers:
    return answers_of(store.steps(), [(solver, "lexicographic") for solver in TIMES])


def number(answers: Answers, solver: str) -> int:
    return [series.solver for series in answers.series].index(solver)


def test_repeats_are_one_answer_and_its_time_the_median(answers: Answers) -> None:
    assert answers.table.height == 3 * COUNT
    for solver, seconds in TIMES.items():
        own = answers.table.filter(series=number(answers, solver))
        assert own["seconds"].to_list() == pytest.approx([seconds] * COUNT)


def test_a_step_that_failed_once_counts_as_failed(store: SmallStore) -> None:
    steps = store.steps().with_columns(
        found=~((polars.col("solver") == FAST) & (polars.col("repeat") == 1) & (polars.col("step") == store.numbers[2]))
        & polars.col("found")
    )
    answers = answers_of(steps, [])
    assert answers.table.filter(~polars.col("found"), series=number(answers, FAST))["step"].to_list() == [store.numbers[2]]


def test_names_are_as_short_as_they_can_be() -> None:
    keys = [
        ("daqp", "lexicographic", 1e-8, "cold"), ("daqp", "lexicographic", 1e-3, "cold"), ("daqp", "damped", None, "cold"),
        ("osqp-warm", "lexicographic", 1e-8, "cold"), ("osqp-warm", "lexicographic", 1e-8, "warm"),
        ("mink (daqp)", "mink", None, "cold"),
    ]  # fmt: skip
    assert labels(keys) == [
        "daqp, 1e-08", "daqp, 1e-03", "daqp, damped", "osqp-warm, cold", "osqp-warm", "mink (daqp)",
    ]  # fmt: skip


def test_cold_starts_stand_aside_where_there_are_warm_ones(store: SmallStore) -> None:
    steps = store.steps()
    warm = steps.filter(solver=FAST).with_columns(start=polars.lit("warm"))
    series = answers_of(polars.concat([steps, warm]), []).series
    assert {one.label: one.aside for one in series} == {FAST: False, f"{FAST}, cold": True, SLOW: False, WRONG: False}


def test_a_profile_counts_right_answers_within_a_multiple_of_the_fastest(answers: Answers) -> None:
    fast, slow, wrong = (stairs_of(answers, 1e-6)[number(answers, solver)] for solver in (FAST, SLOW, WRONG))
    assert (fast[0].tolist(), fast[1].tolist()) == ([1.0], [1.0])
    assert (slow[0].tolist(), slow[1].tolist()) == (pytest.approx([5.0]), [1.0])
    assert len(wrong[0]) == 0
    any_answer = stairs_of(answers, np.inf)[number(answers, WRONG)]
    assert (any_answer[0].tolist(), any_answer[1].tolist()) == (pytest.approx([2.0]), [(COUNT - 1) / COUNT])


def test_the_grid_of_a_profile_keeps_its_ends(answers: Answers) -> None:
    drawn = profiles(answers)
    shares = drawn["kinds"][-1]["shares"]
    assert drawn["ratios"][0] == 1.0
    assert [shares[number(answers, solver)][0] for solver in TIMES] == [1.0, 0.0, 0.0]
    assert [shares[number(answers, solver)][-1] for solver in TIMES] == pytest.approx([1.0, 1.0, (COUNT - 1) / COUNT])


def test_agreement_counts_the_digits_two_solvers_share(answers: Answers) -> None:
    own, certified = agreement(answers)
    fast, slow, wrong = (number(answers, solver) for solver in (FAST, SLOW, WRONG))
    assert own["worst"][fast][slow] == own["median"][slow][fast] == 9.0
    assert own["worst"][fast][wrong] == 3.0
    assert certified["worst"][fast][wrong] == 16.0


def test_digits_tell_the_worst_from_the_median_step_and_nothing_in_common_from_none() -> None:
    relative = np.array([[[1e-2, 1e-4, 1e-6], [np.nan] * 3], [[0.0, 0.0, 3.0], [np.nan, 1e-8, np.nan]]])
    worst, median = digits(relative)
    assert worst[0, 0] == pytest.approx(2.0)
    assert median[0, 0] == pytest.approx(4.0)
    assert np.isnan(worst[0, 1])
    assert np.isnan(median[0, 1])
    assert (worst[1, 0], median[1, 0]) == (0.0, 16.0)
    assert worst[1, 1] == pytest.approx(8.0)


def test_a_course_shows_error_time_and_failure_of_every_step(store: SmallStore, answers: Answers) -> None:
    (course,), left_out = courses(answers)
    assert (course["case"], course["steps"], left_out) == (CASE, store.numbers, 0)
    assert course["free"] == [1, 0] * (COUNT // 2)
    assert course["error"][number(answers, SLOW)] == [OFF[SLOW]] * COUNT
    assert course["error"][number(answers, WRONG)] == [OFF[WRONG]] * (COUNT - 1) + [FAILED]
    assert course["time"][number(answers, FAST)] == [2.0] * COUNT


def test_a_motion_is_kept_to_a_fraction_of_a_millimetre(store: SmallStore) -> None:
    motion = moved(store.episode, 1)
    assert np.abs(positions_of(motion) - store.episode.positions).max() < QUANTISED
    bits = np.frombuffer(base64.b64decode(motion["contact"]), dtype=np.uint8).reshape(len(store.episode.positions), -1)
    contact = np.unpackbits(bits, axis=1)[:, : store.episode.settings.arm.links]
    assert (contact == store.episode.in_contact).all()
    assert store.episode.in_contact.any()


def test_windings_beyond_the_budget_keep_every_few_states_and_the_last(
    store: SmallStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = replays(store.folder, store.episodes(), store.model)
    assert whole["every"] == 1
    size = sum(len(winding["positions"]) + len(winding["contact"]) for winding in whole["windings"])
    monkeypatch.setattr(replaying, "BUDGET", size // 4)
    thinned = replays(store.folder, store.episodes(), store.model)
    assert thinned["every"] > 1
    assert sum(len(winding["positions"]) for winding in thinned["windings"]) < size / 3
    assert [winding["at"][-1] for winding in thinned["windings"]] == [winding["at"][-1] for winding in whole["windings"]]


def test_a_winding_without_a_file_is_not_replayed_but_told_among_the_failures(store: SmallStore, answers: Answers) -> None:
    assert [winding["label"] for winding in replays(store.folder, store.episodes(), store.model)["windings"]] == [
        FAST,
        SLOW,
    ]
    groups = failures(answers, store.episodes(), store.problem)["groups"]
    assert [(group["solver"], group["count"], group["message"]) for group in groups if group["windings"]] == [
        (WRONG, 1, MESSAGE)
    ]


def test_failures_name_crashes_and_wrong_answers_and_come_with_problems(
    store: SmallStore, answers: Answers, tmp_path: Path
) -> None:
    found = failures(answers, store.episodes(), store.problem)
    groups = {(group["solver"], group["what"]): group for group in found["groups"] if not group["windings"]}
    assert set(groups) == {(WRONG, "crashed"), (WRONG, OFF_WORDS)}
    crashed = groups[WRONG, "crashed"]
    assert (crashed["count"], crashed["asked"], crashed["message"]) == (1, COUNT, MESSAGE)
    assert crashed["examples"] == [{"case": CASE, "step": store.numbers[-1], "file": True}]
    (tmp_path / "problem.npz").write_bytes(base64.b64decode(found["files"][f"{CASE} {store.numbers[-1]}"]))
    loaded = load_problem(tmp_path / "problem.npz")
    assert (loaded.levels[0].matrix == store.problem(CASE, store.numbers[-1]).levels[0].matrix).all()


def test_a_wrong_answer_is_a_failure_by_what_the_verdict_goes_by_whatever_accuracy_was_asked(store: SmallStore) -> None:
    steps = store.steps().with_columns(accuracy=polars.lit(1e-2))
    found = failures(answers_of(steps, []), store.episodes(), store.problem)["groups"]
    assert [(group["solver"], group["count"]) for group in found if group["what"] == OFF_WORDS] == [(WRONG, COUNT - 1)]
    # cvxopt is known to stray where rows bind by up to 5e-4, and nowhere else.
    strayed = steps.filter(solver=WRONG, found=True).with_columns(
        solver=polars.lit("cvxopt"), dtheta_error=1e-4, dx_error=1e-4, certified_dx_error=1e-4
    )
    (group,) = failures(answers_of(strayed, []), store.episodes().clear(), store.problem)["groups"]
    assert group["count"] == strayed.filter("free", repeat=0).height < strayed.filter(repeat=0).height


def test_the_sentence_above_the_table_names_who_disagrees_and_who_is_fastest(rows: list[Row]) -> None:
    said = finding(rows)
    assert said.startswith("2 of 3 solvers agree.")
    assert f"{WRONG} fails" in said
    assert f"The fastest that agrees is {FAST}, with a median of 2.00 ms" in said


def test_the_verdict_table_has_every_column_once_and_a_phone_sees_the_verdict(rows: list[Row]) -> None:
    from comparisons.report import COLUMNS

    table = verdicts(rows)
    names = [column["name"] for column in table["columns"]]
    assert sorted(names) == sorted(COLUMNS)
    assert names[:2] == ["solver", "verdict"]
    for row, shown in zip(rows, table["rows"], strict=True):
        assert shown["cells"] == [COLUMNS[name](row) for name in names]


def test_a_sweep_of_accuracies_is_told_apart(rows: list[Row]) -> None:
    swept = [*rows, *(replace(row, accuracy=1e-3, verdict="disagrees: dX 1e-04") for row in rows)]
    table = verdicts(swept)
    place = [column["name"] for column in table["columns"]].index("accuracy")
    assert {row["cells"][place] for row in table["rows"]} == {"1e-08", "1e-03"}
    assert finding(swept).startswith("2 of 6 pairs of solver and accuracy agree. The others: scs at 1e-08 fails")


def test_the_page_is_one_file_that_loads_nothing(store: SmallStore, rows: list[Row], tmp_path: Path) -> None:
    path = write_page(tmp_path, store, rows)
    assert path == tmp_path / "report.html"
    page = path.read_text(encoding="utf-8")
    shell = page[: page.index('<script type="application/json"')]
    assert "default-src 'none'" in page.replace("&#x27;", "'")
    assert re.findall(r'(?:src|href)="(?!#)([^"]*)"', shell) == ["data:,"]
    assert set(re.findall(r"https?://[^\s\"'`)]+", page)) == {
        "http://www.w3.org/2000/svg",
        "http://www.w3.org/1999/xhtml",
    }  # names of SVG and of HTML


def test_no_text_of_the_data_can_leave_it(store: SmallStore, rows: list[Row], tmp_path: Path) -> None:
    page = write_page(tmp_path, store, rows).read_text(encoding="utf-8")
    assert len(re.findall(r"</script", page, re.IGNORECASE)) == 2
    assert "<img" not in page
    assert "<!--" not in page
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    assert json.loads(found[1]) == json.loads(json.dumps(data(store, rows)))


def test_a_comparison_without_driven_windings_or_with_one_formulation_has_a_page(store: SmallStore, tmp_path: Path) -> None:
    class Bare(SmallStore):
        def episodes(self) -> polars.DataFrame:
            return super().episodes().clear()

    bare = Bare(tmp_path)
    assert write_page(tmp_path, bare, summarise(bare.steps(), bare.episodes())).stat().st_size > 0


def test_a_page_that_cannot_be_written_or_a_damaged_winding_is_told(
    store: SmallStore, rows: list[Row], tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=r"report\.html"):
        write_page(tmp_path / "missing", store, rows)
    content = io.BytesIO((store.folder / f"{FAST}.npz").read_bytes()).read(1000)
    (store.folder / f"{FAST}.npz").write_bytes(content)
    with pytest.raises(EpisodeFileError, match=FAST):
        write_page(tmp_path, store, rows)


#: A geom of every shape, and one that is not shown, on joints of several kinds.
SHAPES = """
<mujoco><compiler angle="radian"/><asset><mesh name="wedge" vertex="0 0 0  0.2 0 0  0 0.1 0  0 0 0.3"/>
<material name="red" rgba="1 0 0 0.5"/></asset><worldbody><geom type="plane" size="0 0 1"/>
<geom type="box" size="0.1 0.2 0.3" pos="1 0 0.3" euler="0 0 0.5"/>
<body pos="0 0 1"><freejoint/><geom size="0.1" material="red"/><geom type="capsule" size="0.02 0.1" pos="0.1 0 0"/>
<body pos="0.2 0 0"><joint axis="0 1 0"/><geom type="ellipsoid" size="0.1 0.05 0.02" pos="0 0 0.1" euler="0.3 0.2 0.1"/>
<geom type="mesh" mesh="wedge" pos="0 0.1 0"/><geom size="0.01" group="3"/><geom size="0.01" rgba="0 0 0 0"/></body></body>
</worldbody></mujoco>
"""


def test_every_visible_geom_of_a_scene_is_where_mujoco_has_it_at_every_state() -> None:
    model = mujoco.MjModel.from_xml_string(SHAPES)
    rng, data = np.random.default_rng(2), mujoco.MjData(model)
    q = np.tile(model.qpos0, (5, 1))
    for position in q[1:]:
        mujoco.mj_integratePos(model, position, rng.normal(size=model.nv), 1.0)
    dtheta = rng.normal(size=(5, model.nv))
    after = q[-1].copy()
    mujoco.mj_integratePos(model, after, dtheta[-1], 1.0)
    problem = IKProblem([Level(np.eye(model.nv), np.zeros(model.nv))])
    motion = Drawn.of(model).moved(Recording.of([problem] * 5, q, dtheta), 2)
    assert motion["at"] == [0, 2, 4, 5]
    assert [geom["shape"] for geom in motion["geoms"]] == ["box", "box", "sphere", "capsule", "ellipsoid", "box"]
    assert [geom["moves"] for geom in motion["geoms"]] == [False, False, True, True, True, True]
    assert motion["meshes"] == 1
    assert motion["geoms"][2]["colour"] == [1.0, 0.0, 0.0, 0.5]
    whole = np.frombuffer(base64.b64decode(motion["positions"]), "<i2").reshape(4, 4, 3)
    turns = np.frombuffer(base64.b64decode(motion["turns"]), "<i2").reshape(4, 4, 4) / LARGEST
    for state, position in enumerate([q[0], q[2], q[4], after]):
        data.qpos[:] = position
        mujoco.mj_forward(model, data)
        for place, (geom, turn) in enumerate(zip((2, 3, 4, 5), turns[state], strict=True)):
            matrix = np.empty(9)
            mujoco.mju_quat2Mat(matrix, turn / np.linalg.norm(turn))
            assert matrix == pytest.approx(data.geom_xmat[geom], abs=2e-4)
            middle = data.geom_xpos[geom] + matrix.reshape(3, 3) @ (model.geom_aabb[geom, :3] if geom == 5 else np.zeros(3))
            assert np.array(motion["centre"]) + motion["unit"] * whole[state, place] == pytest.approx(middle, abs=2e-4)
