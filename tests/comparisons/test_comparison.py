"""The comparison judges by figures of its own: what disagrees or fails is shown as such, and stops nobody else."""

import importlib
import math
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import polars
import pytest
import saboteurs
from click.testing import CliRunner

from comparisons import worker
from comparisons.cases import Case, cases_of
from comparisons.jobs import COLD, MINK_ROWS, WARM, Job, drives, replays
from comparisons.mink_today import MinkBench
from comparisons.run import RunError, _Run, made_by, run
from comparisons.sample import chosen, free_steps, sampled
from comparisons.settings import ComparisonSettings
from comparisons.store import Store
from comparisons.summary import Row, summarise
from comparisons.tables import COMPARED, EPISODES, JOB, STEPS
from prioritized_ik.cli import main
from prioritized_ik.errors import InputError
from prioritized_ik.solvers import registry
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.methods import Place
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.tolerances import FREE
from prioritized_ik.winding.episode import Episode, wind
from prioritized_ik.winding.settings import WindingSettings

LINK = 13
SMALL = {"directions": ("up",), "link": (LINK,), "repeats": 1, "mink": False, "drive": False, "workers": 2}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("recorded")
    settings = ComparisonSettings(solvers=("daqp",), directions=("up",), link=(LINK,))
    wind(cases_of(settings)[0].winding).save(place / "up.npz")
    return place


def compared(
    place: Path, recorded: Path, *solvers: str, formulation: str = "lexicographic", **settings: Any
) -> polars.DataFrame:
    given = {
        **SMALL,
        "recorded": str(recorded),
        "solvers": solvers,
        "formulations": (formulation,),
        "steps": 12,
        **settings,
    }
    return run(ComparisonSettings(**given), place, lambda *_: None).steps()


def rows_of(steps: polars.DataFrame) -> dict[str, Row]:
    return {row.solver: row for row in summarise(steps, polars.DataFrame(schema={**JOB, **EPISODES}))}


@pytest.mark.usefixtures("sabotage")
def test_a_backend_that_is_off_by_a_hundred_thousandth_disagrees(folder: Path, tmp_path: Path) -> None:
    rows = rows_of(compared(tmp_path, folder, "daqp", "quadprog", "off"))
    assert rows["daqp"].verdict == rows["quadprog"].verdict == "agrees"
    assert rows["off"].verdict.startswith(("disagrees", "fails"))
    assert rows["off"].free_dtheta_error_max > 1e-6
    assert rows["daqp"].constrained_dtheta_spread_max <= 1e-6
    assert rows["off"].constrained_dtheta_spread_max > 1e-6


@pytest.mark.usefixtures("sabotage")
def test_a_last_joint_off_on_one_step_in_a_hundred_is_named_whether_rows_bind_there_or_not(
    folder: Path, tmp_path: Path
) -> None:
    free = free_steps(Episode.load(folder / "up.npz"), RANK_TOLERANCE)
    sample = chosen(free, saboteurs.ONE_IN)
    spoilt = {f"wrong-{kind}": [free[step] for step in sample].index(kind, 10) for kind in (True, False)}
    for name, place in spoilt.items():
        registry.register(name, partial(saboteurs.Wrong, name, place))
    steps = compared(tmp_path, folder, "daqp", *spoilt, steps=saboteurs.ONE_IN)
    rows = rows_of(steps)
    assert rows["daqp"].verdict == "agrees"
    for name, place in spoilt.items():
        assert rows[name].verdict.startswith("disagrees"), name
        honest = rows_of(steps.filter(polars.col("step") != sample[place]))
        assert honest[name].verdict == "agrees", "nothing but that one step gives it away"


@pytest.mark.usefixtures("sabotage")
def test_a_backend_that_crashes_hangs_or_eats_memory_fails_alone(folder: Path, tmp_path: Path) -> None:
    names = ("daqp", "crash", "crash-sometimes", "hang", "eat", "fault", "nan", "silent", "shapeless")
    steps = compared(tmp_path, folder, *names, time_limit=1.5, memory_limit=0.1)
    assert steps.group_by("solver").len()["len"].to_list() == [12] * len(names)
    rows = rows_of(steps)
    assert rows["daqp"].verdict == "agrees"
    expected = {"crash": "crash", "eat": "memory", "fault": "error", "nan": "nan", "shapeless": "error"}
    for name, failure in expected.items():
        assert rows[name].failures == {failure: 12}, name
        assert rows[name].verdict == f"fails: 12/12 steps (12 {failure})"
        assert rows[name].free_dtheta_error_max is None
    assert rows["silent"].verdict == "fails: 12/12 steps"
    assert rows["silent"].failures == {}
    for name, failure in (("crash-sometimes", "crash"), ("hang", "timeout")):
        mine = steps.filter(solver=name)
        lost = mine.filter(failure=failure)
        assert 0 < lost.height < 12
        assert mine.filter("found").height == 12 - lost.height, "what it found before and after counts"
        assert rows[name].failures == {failure: lost.height}
    assert "SIGSEGV" in steps.filter(solver="crash")["message"][0]
    assert "not tried" in steps.filter(solver="crash")["message"][-1]
    assert "KeyError: 'forgotten'" in steps.filter(solver="fault")["message"][0]


@pytest.mark.usefixtures("sabotage")
def test_a_backend_that_crashes_while_it_drives_leaves_no_winding(tmp_path: Path) -> None:
    given = {**SMALL, "solvers": ("crash", "nan", "daqp"), "steps": 2, "drive": True}
    episodes = run(ComparisonSettings(**given), tmp_path, lambda *_: None).episodes().filter(formulation="lexicographic")
    by_solver = {row["solver"]: row for row in episodes.iter_rows(named=True)}
    assert by_solver["crash"]["failure"] == "crash"
    assert by_solver["crash"]["file"] is None
    assert (by_solver["nan"]["outcome"], by_solver["nan"]["failure"]) == ("SOLVER_FAILED", "nan")
    assert by_solver["daqp"]["outcome"] == "WOUND"
    driven = Episode.load(tmp_path / by_solver["daqp"]["file"])
    assert driven.steps == by_solver["daqp"]["steps"]
    assert driven.settings.solver == "daqp"


@pytest.mark.usefixtures("sabotage")
def test_a_process_lost_after_its_last_record_costs_nothing(folder: Path, tmp_path: Path) -> None:
    steps = compared(tmp_path, folder, "daqp", "grave", steps=1, drive=True)
    assert steps.filter(solver="grave")["found"].to_list() == [True]
    more = compared(tmp_path / "more", folder, "daqp", "grave", steps=6)
    # Each destructor falls into the time of the next problem; the last into nobody's.
    assert more.filter(solver="grave")["failure"].to_list() == [None, "crash"] * 3
    episodes = Store(tmp_path).episodes().filter(solver="grave", formulation="lexicographic")
    assert episodes["outcome"].to_list() == ["WOUND"]


@pytest.mark.usefixtures("sabotage")
def test_results_of_a_changed_plugin_are_other_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "brought.py"
    file.write_text("def factory(accuracy): ...\n")
    monkeypatch.syspath_prepend(tmp_path)
    registry.register("brought", partial(importlib.import_module("brought").factory))
    settings = ComparisonSettings(solvers=("daqp", "brought"))
    before = made_by(settings)
    assert set(before["plugins"]) == {"brought"}
    file.write_text("def factory(accuracy): return None\n")
    after = made_by(settings)
    assert {name for name in after if after[name] != before[name]} == {"plugins"}


def test_the_versions_of_solvers_that_are_called_without_being_compared_decide_too() -> None:
    def versions(**given: Any) -> set[str]:
        return set(made_by(ComparisonSettings(solvers=("quadprog",), **given))["version"])

    assert {"quadprog", "daqp"} <= versions(mink=False)
    assert versions() - versions(mink=False) == {"proxqp"}
    assert versions(witness=True) - versions() == {"cvxpy", "clarabel"}


def test_a_worker_that_runs_another_program_is_refused_by_its_host(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("comparisons.run._here", lambda: {"code": "other", "host": "elsewhere"})
    with pytest.raises(RunError, match=r"worker on 'elsewhere' runs another program \(other, here"):
        compared(tmp_path, folder, "daqp", steps=1)
    monkeypatch.undo()
    run_ = _Run(ComparisonSettings(solvers=("daqp",), recorded=str(folder)), tmp_path / "rows", keep_driven=False)
    with pytest.raises(RunError, match="elsewhere"):
        run_._add_rows("steps", "up", {}, ({"code": "other", "host": "elsewhere"}, []))


def test_our_own_work_on_an_episode_is_not_on_a_solvers_time(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    episode = Episode.load(folder / "up.npz")
    told: list[tuple[Any, bool]] = []

    def tell(thing: Any, *, ours: bool = False) -> None:
        told.append((thing, ours))

    def on_our_time(work: Callable[..., Any]) -> Callable[..., Any]:
        def checked(*arguments: Any) -> Any:
            assert told.pop() == (None, True), work
            return work(*arguments)

        return checked

    worker.record(tell, ComparisonSettings(solvers=("daqp",)), episode.settings, (folder / "up.npz").read_bytes())
    assert told[:-1] == [(None, True)] * episode.steps
    for name in ("figures_of", "content_of", "judge"):
        monkeypatch.setattr(worker, name, on_our_time(getattr(worker, name)))
    settings = ComparisonSettings(solvers=("daqp",), drive=True)
    (job,) = (job for job in drives(settings, cases_of(settings)[:1]) if job.solver == "daqp")
    winding = replace(episode.settings, max_steps=3)
    worker.drive(tell, settings, job, winding, {})
    replayed = Job("replay", job.case, "daqp", "lexicographic", 1e-8)
    worker.replay(tell, settings, replayed, winding, [sampled(episode, 0, RANK_TOLERANCE)], {})


def test_a_backend_that_cannot_be_sent_to_another_process_is_refused(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(registry, "_added", {})
    registry.register("local", lambda accuracy: saboteurs.made(saboteurs.Saboteur, "nan", accuracy))
    with pytest.raises(InputError, match="method 'local' cannot be sent to a process of its own"):
        compared(tmp_path, folder, "local")


def test_a_plugin_brings_backends_of_ones_own_and_strict_names_the_one_that_fails(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(registry, "_added", {})
    monkeypatch.delitem(sys.modules, "saboteur_plugin", raising=False)
    arguments = ["compare", "--plugin", "saboteur_plugin", "--solvers", "daqp,nan", "--recorded", str(folder)]
    few = ["--steps", "3", "--repeats", "1", "--no-drive", "--no-mink", "--formulation", "lexicographic"]
    result = CliRunner().invoke(main, [*arguments, *few, "--strict"])
    assert result.exit_code == 1, result.output
    assert "nan 0 (lexicographic, accuracy 1e-08): fails: 3/3 steps (3 nan)" in result.output
    assert "daqp 0" not in result.output


def test_the_damped_formulation_is_another_problem(folder: Path, tmp_path: Path) -> None:
    assert rows_of(compared(tmp_path, folder, "quadprog", formulation="damped"))["quadprog"].verdict != "agrees"


def test_the_sample_holds_free_and_constrained_steps_of_the_whole_episode(folder: Path) -> None:
    episode = Episode.load(folder / "up.npz")
    free = free_steps(episode, RANK_TOLERANCE)
    numbers = chosen(free, 12)
    assert numbers == sorted(set(numbers))
    assert len(numbers) == 12
    assert {free[number] for number in numbers} == {True, False}
    for number in numbers:
        item = sampled(episode, number, RANK_TOLERANCE)
        assert item.free is free[number]
        assert item.free == (item.problem.relative_violation(item.dtheta) <= FREE)
        assert (item.before is None) == (number == 0)


def test_every_solver_replays_and_drives_and_so_does_mink() -> None:
    settings = ComparisonSettings(solvers=("daqp", "scs", "daqp-warm"), directions=("up", "back"), repeats=2)
    cases = cases_of(settings)
    todo = {(job.case, job.solver, job.formulation, job.start, job.repeat) for job in replays(settings, cases)}
    assert len(todo) == len(replays(settings, cases)) == 2 * 2 * (2 * 2 + 2 + 2)
    assert ("up", "daqp-warm", "lexicographic", WARM, 1) in todo
    assert ("up", "daqp-warm", "lexicographic", COLD, 1) in todo
    assert {("up", name, "mink", COLD, 0) for name in MINK_ROWS} <= todo
    driven = {(job.case, job.solver) for job in drives(settings, cases)}
    assert len(driven) == len(drives(settings, cases)) == 2 * (3 + 1 + 2)
    assert ("up", "closed-form") in driven


def test_repeats_are_interleaved_and_files_tell_all_jobs_apart() -> None:
    settings = ComparisonSettings(solvers=("daqp", "scs"), accuracy=(1e-6, 1e-8), repeats=3)
    todo = replays(settings, cases_of(settings))
    assert [job.repeat for job in todo] == sorted(job.repeat for job in todo)
    assert len({job.file for job in todo}) == len(todo)
    assert all(set(job.file) <= set("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_=.-") for job in todo)


def test_cases_are_the_product_of_what_is_swept_and_named_by_it() -> None:
    swept = {"links": (8, 17), "link": (5,), "tilt": (0.0, 0.3), "seeds": (0, 1, 2), "shapes": ("cylinder", "sphere")}
    cases = cases_of(ComparisonSettings(solvers=("daqp",), directions=("up", "back"), **swept))
    assert len(cases) == len({case.name for case in cases}) == 2 * 2 * 2 * 3 * 2
    case = next(case for case in cases if case.name == "back links=8 object=sphere tilt=0.3 seed=2")
    assert (case.winding.arm.links, case.winding.shape, case.winding.tilt, case.winding.seed) == (8, "sphere", 0.3, 2)
    assert case.winding.posture == "random"
    assert cases_of(ComparisonSettings(solvers=("daqp",), directions=("up",)))[0].name == "up"


def test_an_accuracy_out_of_a_solvers_reach_is_left_out_and_said() -> None:
    settings = ComparisonSettings(solvers=("daqp", "highs"), accuracy=(1e-6, 1e-9))
    assert settings.accuracies_of("highs") == (1e-6,)
    assert settings.left_out() == {"highs": [1e-9]}
    with pytest.raises(InputError, match="finer than highs reaches"):
        ComparisonSettings(solvers=("highs",), accuracy=(1e-9,))


def test_problems_of_several_levels_are_spared_the_damped_formulation_and_mink() -> None:
    settings = ComparisonSettings(solvers=("daqp",))
    strict = Case("strict", replace(cases_of(settings)[0].winding, weights="strict"), one_level=False)
    assert {job.formulation for job in replays(settings, [strict]) + drives(settings, [strict])} == {"lexicographic"}


def test_mink_is_given_the_same_problem() -> None:
    # Far from singular and with nothing binding, mink's damping does no harm: both take the same step.
    settings = WindingSettings(posture="random", seed=3, max_steps=1, weights="eq24", speed=0.02)
    episode = wind(settings)
    step = get_method("mink:quadprog").step(episode.problem(0), place=Place(episode.q[0], settings))
    dx = episode.jacobian[0] @ step.dtheta
    assert np.linalg.norm(dx - episode.jacobian[0] @ episode.dtheta[0]) <= 1e-6 * np.linalg.norm(dx)


def test_minks_limits_bind_where_ours_do(folder: Path) -> None:
    episode = Episode.load(folder / "up.npz")
    bench = MinkBench(episode.settings)
    for number in range(0, episode.steps, 10):
        problem = episode.problem(number)
        bench.solve(problem, episode.q[number], "daqp")
        ours = {tuple(np.round(row, 9)): side for row, side in zip(problem.rows.matrix, problem.rows.upper, strict=True)}
        g, h = bench.limits[2].compute_qp_inequalities(bench.configuration, episode.settings.dt)
        theirs = {tuple(np.round(row, 9)): side for row, side in zip(g, h, strict=True) if math.isfinite(side)}
        assert len(theirs) == len(ours)
        for mine, other in zip(sorted(ours.items()), sorted(theirs.items()), strict=True):
            assert np.allclose(mine[0], other[0], atol=1e-4)
            assert mine[1] == pytest.approx(other[1], abs=1e-9)


def test_a_step_that_was_not_found_takes_no_part_in_the_times_of_those_that_were() -> None:
    step = {"case": "up", "solver": "daqp", "version": "1", "formulation": "lexicographic", "accuracy": 1e-8,
            "start": "cold", "repeat": 0, "free": False, "status": "SOLVED"}  # fmt: skip
    found = {"step": 0, "found": True, "build_s": 1.0, "solve_s": 2.0, "polish_s": 4.0}
    lost = [{"step": number, "found": False, "build_s": seconds} for number, seconds in ((1, None), (2, None), (3, 9.0))]
    steps = polars.DataFrame([{**step, **figures} for figures in (found, *lost)], schema={**JOB, **STEPS, **COMPARED})
    row = rows_of(steps)["daqp"]
    assert (row.constrained_time_p50_s, row.build_time_p50_s, row.polish_time_p50_s) == (7.0, 1.0, 4.0)


def test_no_replayed_step_is_no_agreement() -> None:
    episode = {"case": "up", "direction": "up", "solver": "daqp", "version": "1", "formulation": "lexicographic",
               "outcome": "WOUND", "penetration": 0.0, "bend": 0.0, "drift": 0.0}  # fmt: skip
    steps = polars.DataFrame(schema={**JOB, **STEPS, **COMPARED})
    (row,) = summarise(steps, polars.DataFrame([episode], schema={**JOB, **EPISODES}))
    assert row.verdict == "fails: no steps"
    assert row.turns_ratio_min is None
