"""Scenes, recordings and saved problems are compared by the same machinery as windings, and judged as sharply."""

from pathlib import Path
from typing import Any

import numpy as np
import polars
import pytest
from click.testing import CliRunner, Result

import prioritized_ik as pik
from comparisons.cases import cases_of
from comparisons.jobs import drives, replays
from comparisons.run import made_by, run
from comparisons.sample import Reference, chosen, free_steps, sampled
from comparisons.settings import ComparisonSettings
from comparisons.store import Store
from comparisons.summary import Row, summarise
from prioritized_ik.cli import main
from prioritized_ik.problem import Bounds, replaced
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.lexicographic import SolveOptions

TASKS = """
example = "arm"
q = [0.3, 0.5, 0.2, 1.2, 0.1, 0.6, 0.0]
duration = {duration}

[[task]]
kind = "position"
site = "tool"
times = [0.0, 0.2]
targets = [[0.55, 0.2, 0.3], [0.5, 0.1, 0.35]]
gain = 0.5

[[task]]
kind = "posture"
level = 2
gain = 0.1

[[limit]]
kind = "joint-range"

[[limit]]
kind = "velocity"
fastest = 1.0
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    file = tmp_path / "reach.toml"
    file.write_text(TASKS.format(duration=0.6), encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> pik.Recording:
    file = tmp_path_factory.mktemp("scene") / "reach.toml"
    file.write_text(TASKS.format(duration=0.6), encoding="utf-8")
    return pik.load_scene(file).run().recording()


def settings_of(*solvers: str, **given: Any) -> ComparisonSettings:
    small = {"formulations": ("lexicographic",), "steps": 8, "workers": 2, "time_limit": 5.0}
    return ComparisonSettings(solvers=solvers, **{**small, **given})


def compared(place: Path, *solvers: str, **given: Any) -> tuple[dict[str, Row], Store]:
    store = run(settings_of(*solvers, **given), place, lambda *_: None)
    return {row.solver: row for row in summarise(store.steps(), store.episodes())}, store


def call(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def test_every_solver_replays_and_drives_a_scene_and_ends_where_it_was_recorded(scene: Path, tmp_path: Path) -> None:
    rows, store = compared(tmp_path / "out", "active-set", "daqp", "quadprog", scenes=(str(scene),))
    assert set(rows) == {"active-set", "daqp", "quadprog"}
    for row in rows.values():
        assert (row.verdict, row.step_count, row.done, row.episodes) == ("agrees", 8, 1, 1)
        assert row.free_steps > 0
        assert row.constrained_steps > 0
    recorded = store.recorded("reach")
    for file, error in store.episodes().select("file", "error").iter_rows():
        driven = pik.Recording.load(tmp_path / "out" / file)
        assert driven.q == pytest.approx(recorded.q, abs=1e-9)
        assert driven.ending == recorded.ending == pik.load_scene(scene).run().ending.name
        assert error == pytest.approx(next(iter(pik.load_scene(scene).run().errors.values())), abs=1e-9)


@pytest.mark.usefixtures("sabotage")
def test_a_solver_that_is_off_or_gives_no_answer_is_named_on_a_scene_too(scene: Path, tmp_path: Path) -> None:
    rows, store = compared(tmp_path / "out", "daqp", "off", "silent", "nan", "crash", scenes=(str(scene),))
    assert rows["daqp"].verdict == "agrees"
    assert rows["off"].verdict.startswith(("disagrees", "fails"))
    assert rows["silent"].verdict == "fails: 8/8 steps"
    assert rows["nan"].failures == {"nan": 8}
    assert rows["crash"].failures == {"crash": 8}
    outcomes = {row["solver"]: (row["outcome"], row["done"]) for row in store.episodes().iter_rows(named=True)}
    assert outcomes["daqp"] == (store.recorded("reach").ending, True)
    assert outcomes["nan"] == outcomes["crash"] == ("SOLVER_FAILED", False)


def test_compare_takes_scenes_from_the_command_line_and_writes_its_report(scene: Path, tmp_path: Path) -> None:
    few = ["--solvers", "daqp", "--steps", "4", "--formulation", "lexicographic", "--strict"]
    result = call("compare", "--scene", scene, *few, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "task err." in result.output
    assert (tmp_path / "out" / "report.html").exists()
    episodes = polars.read_parquet(tmp_path / "out" / "episodes.parquet")
    assert episodes.select("case", "direction", "turns", "done").rows() == [("reach", None, None, True)]
    scene.write_text(TASKS.format(duration=0.7), encoding="utf-8")
    again = call("compare", "--scene", scene, *few, "--out", tmp_path / "out")
    assert again.exit_code == 2, "results of another task file are not mixed with these"
    assert "results of a run with other settings: scenes of reach.toml was" in again.output


def test_another_model_is_another_scene(tmp_path: Path) -> None:
    model = '<mujoco><worldbody><body><joint/><geom size="0.1"/><site name="tip" pos="{} 0 0"/></body></worldbody></mujoco>'
    file = tmp_path / "one.toml"
    file.write_text('model = "robot.xml"\nduration = 0.1\ntask = [{kind = "position", site = "tip"}]\n')
    made = []
    for length in (1, 1, 2):
        (tmp_path / "robot.xml").write_text(model.format(length))
        made.append(made_by(settings_of("daqp", scenes=(str(file),)))["scenes"])
    assert made[0] == made[1] != made[2]


def test_recordings_and_saved_problems_are_replayed_and_driven_by_nobody(
    recording: pik.Recording, scene: Path, tmp_path: Path
) -> None:
    own = tmp_path / "own"
    own.mkdir()
    assert call("solve", scene, "--save", own / "mine.npz").exit_code == 0
    problem = recording.problem(3)
    pik.save_problem(problem, own / "strict.npz")
    pik.save_problem(replaced(problem, levels=problem.levels[:1]), own / "alone.npz")
    given = {"recorded": str(own), "formulations": ("lexicographic", "damped")}
    store = compared(tmp_path / "out", "daqp", "quadprog", **given)[1]
    assert store.episodes().is_empty()
    counted = store.steps().filter(solver="daqp").group_by("case", "formulation").len().rows()
    assert set(counted) == {
        ("mine", "lexicographic", 8), ("strict", "lexicographic", 1), ("alone", "lexicographic", 1), ("alone", "damped", 1),
    }  # fmt: skip
    assert {row.verdict for row in summarise(store.steps(), store.episodes()) if row.must_agree} == {"agrees"}
    assert call("compare", "--recorded", own, "--solvers", "daqp", "--steps", "2", "--strict").exit_code == 0


def test_scenes_of_several_levels_are_spared_the_damped_formulation_and_mink(scene: Path) -> None:
    settings = settings_of("daqp", scenes=(str(scene),), formulations=("lexicographic", "damped"))
    (case,) = cases_of(settings)
    assert {job.formulation for job in [*replays(settings, [case]), *drives(settings, [case])]} == {"lexicographic"}


def test_the_closed_form_of_damped_levels_is_the_certified_optimum_where_no_row_binds(recording: pik.Recording) -> None:
    options = SolveOptions(rank_tolerance=RANK_TOLERANCE)
    seen = set()
    for number in range(0, recording.steps, 3):
        problem = recording.problem(number)
        reference, step = Reference(problem, RANK_TOLERANCE), pik.solve(problem, options=options)
        off = np.linalg.norm(reference.dtheta - step.dtheta) / np.linalg.norm(step.dtheta)
        seen.add(reference.free)
        assert (off < 1e-8) == reference.free, "where a row binds, no closed form knows it"
    assert seen == {True, False}
    assert any(level.damping for problem in recording.problems() for level in problem.levels)


def test_a_row_that_binds_on_the_way_only_makes_a_step_bound() -> None:
    # Undamped, the level's step keeps the bound; its damped optimum, which is handed down, is smaller in the other joint.
    level = pik.Level([[1.0, 0.0], [0.0, 1e-3]], [0.5, 2e-3], damping=1e-3, name="weak")
    free = pik.IKProblem([level, pik.Level(np.eye(2), [0.4, 0.1])])
    assert Reference(free, 0.0).free
    bound = replaced(free, bounds=Bounds([-0.45, -9.0], [0.45, 9.0]))
    assert not Reference(bound, 0.0).free


def test_the_level_that_is_judged_is_the_first_that_asks_for_something() -> None:
    feet = pik.Level([[1.0, 0.0, 0.0]], [0.0], name="feet")
    hand = pik.Level([[1.0, 1.0, 0.0]], [0.2], [4.0], name="hand")
    assert Reference(pik.IKProblem([feet, hand]), RANK_TOLERANCE).judged == 1
    assert Reference(pik.IKProblem([hand, feet]), RANK_TOLERANCE).judged == 0
    reference = Reference(pik.IKProblem([feet, hand]), RANK_TOLERANCE)
    assert reference.displacement(1) == pytest.approx([0.2])
    assert reference.level(1).matrix == pytest.approx(np.array([[1.0, 1.0, 0.0]]))
    assert Reference(pik.IKProblem([feet]), RANK_TOLERANCE).judged is None


def test_steps_of_a_robot_at_rest_are_not_replayed() -> None:
    moves = pik.IKProblem([pik.Level(np.eye(2), [0.1, 0.0])])
    rests = pik.IKProblem([pik.Level(np.eye(2), [0.0, 0.0])])
    record = pik.Recording.of([moves, rests, moves, rests], np.zeros((4, 2)), np.zeros((4, 2)))
    free = free_steps(record, RANK_TOLERANCE)
    assert free == [True, None, True, None]
    assert chosen(free, 10) == [0, 2]
    with pytest.raises(pik.InputError, match="no level of step 1 asks for anything"):
        sampled(record, 1, RANK_TOLERANCE)


def test_a_level_in_a_metric_is_cut_in_that_metric() -> None:
    # The second direction is felt by a millionth: cut at 1e-4, whatever metres and radians are.
    metric = np.array([[4.0, 1.0], [1.0, 2.0]])
    root = np.linalg.cholesky(metric).T
    strong, weak = np.array([0.6, 0.8]), np.array([-0.8, 0.6])
    matrix = np.array([strong, 1e-6 * weak]) @ root
    for given, rows in ((metric, matrix), (np.array([9.0, 0.25]), np.array([strong, 1e-6 * weak]) * [3.0, 0.5])):
        problem = pik.IKProblem([pik.Level(rows, [0.1, 0.0])], metric=given)
        cut = Reference(problem, RANK_TOLERANCE).level(0).matrix
        assert cut[0] == pytest.approx(rows[0], abs=1e-9)
        assert cut[1] == pytest.approx([0.0, 0.0], abs=1e-9)


BAD = {
    "no such file": (["--scene", "none.toml"], "there is no file 'none.toml'"),
    "two of a name": (["--scene", "a/x.toml", "--scene", "b/x.toml"], "no two are the same"),
    "recorded too": (["--scene", "a/x.toml", "--recorded", "."], "recorded episodes and scenes are both given"),
}


@pytest.mark.parametrize(("arguments", "message"), BAD.values(), ids=BAD.keys())
def test_bad_input_is_one_clear_message(arguments: list[str], message: str) -> None:
    result = call("compare", "--solvers", "daqp", *arguments)
    assert result.exit_code == 2
    assert message in result.output
