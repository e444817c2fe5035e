"""The demonstrations show what they claim, and say so when a solver fails."""

import json
from functools import partial
from pathlib import Path
from typing import Any

import mink
import numpy as np
import pytest
from click.testing import CliRunner, Result

from comparisons import minimum_norm, weight_ratio
from comparisons.demonstrations import QUANTITIES
from prioritized_ik.cli import main
from prioritized_ik.errors import StepNotFoundError
from prioritized_ik.validation import Array

SAME = 1e-6  # relative: what a QP solver at accuracy 1e-8 can be held to


def call(*arguments: str) -> Result:
    return CliRunner().invoke(main, ["demo", *arguments])


def shown(folder: Path, command: str) -> tuple[str, dict[str, Any]]:
    file = folder / "rows.json"
    result = call(command, "--json", str(file))
    assert result.exit_code == 0, result.output
    return result.output, json.loads(file.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def norms(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, dict[str, Any]]:
    return shown(tmp_path_factory.mktemp("norm"), "minimum-norm")


@pytest.fixture(scope="module")
def ratios(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, dict[str, Any]]:
    return shown(tmp_path_factory.mktemp("ratio"), "weight-ratio")


def shown_distance(value: float | None) -> str:
    return "fails" if value is None else f"{value:.0e}"


def distances(rows: list[dict[str, Any]], method: str, quantity: str = "dtheta") -> Array:
    """By ratio, from 1 to 1e12."""
    found = [row for row in rows if row["method"] == method and row["ratio"] is not None]
    assert [row["ratio"] for row in found] == [10.0**power for power in range(13)]
    return np.array([row[quantity] for row in found], dtype=float)  # NaN where there is no answer


def test_every_solver_of_ours_returns_the_least_norm(norms: tuple[str, dict[str, Any]]) -> None:
    for row in norms[1]["rows"]:
        assert row["ours"]["norm_ratio"] == pytest.approx(1.0, abs=SAME), row
        assert row["ours"]["off"] <= SAME, row
        assert row["ours"]["residual"] <= SAME, row


def test_some_solver_of_minks_does_the_task_with_a_step_far_too_long(norms: tuple[str, dict[str, Any]]) -> None:
    found = [row["mink"] for row in norms[1]["rows"] if not row["mink"]["failure"]]
    assert any(answer["norm_ratio"] > 1.01 and answer["residual"] <= 1e-5 for answer in found)


def test_the_json_rows_of_minimum_norm_hold_what_its_table_shows(norms: tuple[str, dict[str, Any]]) -> None:
    output, content = norms
    rows = content["rows"]
    assert len(rows) == 4 * len(minimum_norm.shared_solvers())
    lines = [line.split() for line in output.splitlines() if line.strip().startswith(minimum_norm.TASKS)]
    assert len(lines) == len(rows)
    for line, row in zip(lines, rows, strict=True):
        assert line[:4] == [row["task"], "kept" if row["joint_range"] else "–", row["solver"], row["version"]]
        for (ratio, *figures), answer in ((line[4:7], row["mink"]), (line[7:10], row["ours"])):
            if answer["failure"]:
                assert (ratio, *figures) == ("fails", "–", "–")
                assert answer["failure"] in output
            else:
                half_a_digit = 0.5 if answer["norm_ratio"] >= 100 else 5e-4
                assert float(ratio) == pytest.approx(answer["norm_ratio"], abs=1.01 * half_a_digit)
                assert figures == [f"{answer[name]:.0e}" for name in ("off", "residual")]


@pytest.mark.parametrize("command", ["minimum-norm", "weight-ratio"])
def test_the_json_says_of_what_it_is(command: str, request: pytest.FixtureRequest) -> None:
    _, content = request.getfixturevalue("norms" if command == "minimum-norm" else "ratios")
    assert list(content) == ["versions", "cpu", "case", "rows"]
    assert {"mujoco", "mink", "numpy", "daqp"} <= set(content["versions"])
    assert content["case"]["posture"] == "arched"


@pytest.mark.parametrize("task", minimum_norm.TASKS)
def test_nothing_binds_at_the_least_norm_step_and_there_are_many_others(task: str) -> None:
    bench = minimum_norm.Bench(task, joint_range=True)
    assert len(bench.problem.inequalities.upper) == 2 * 49
    assert bench.problem.tight_rows(bench.least, 0.1) == ()
    assert np.linalg.matrix_rank(bench.jacobian) == len(bench.demand)
    assert np.linalg.norm(bench.jacobian @ bench.least - bench.demand) <= 1e-12


@pytest.mark.parametrize("task", minimum_norm.TASKS)
def test_both_sides_solve_the_same_task_but_for_the_damping(task: str) -> None:
    bench = minimum_norm.Bench(task, joint_range=True)
    qp = mink.build_ik(bench._configuration, [bench._task], minimum_norm.DT)  # as solve_ik does
    (level,) = bench.problem.levels
    assert np.allclose(qp.P, level.matrix.T @ level.matrix + 1e-12 * np.eye(49), rtol=0.0, atol=1e-13)
    assert np.allclose(qp.q, -level.matrix.T @ level.target, rtol=0.0, atol=1e-13)
    assert np.array_equal(qp.G, bench.problem.rows.matrix)
    assert np.array_equal(qp.h, bench.problem.rows.upper)


def test_a_failing_solver_is_shown_as_failing_on_either_side(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def no_mink(*_: object, **__: object) -> Array:
        raise mink.NoSolutionFound("daqp")

    def not_us(*_: object, **__: object) -> Array:
        raise StepNotFoundError("daqp: gave in", None)

    monkeypatch.setattr(minimum_norm, "shared_solvers", lambda: ["daqp"])
    monkeypatch.setattr(mink, "solve_ik", no_mink)
    monkeypatch.setattr(minimum_norm, "solve", not_us)
    output, content = shown(tmp_path, "minimum-norm")
    assert output.count("fails") == 2 * 4
    assert "ours, daqp, position, no joint range: daqp: gave in" in output
    for row in content["rows"]:
        assert row["mink"]["norm_ratio"] is None
        assert row["mink"]["failure"].startswith("NoSolutionFound")
        assert row["ours"] == {"norm_ratio": None, "off": None, "residual": None, "failure": "daqp: gave in"}


def test_values_that_are_not_finite_are_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mink, "solve_ik", lambda *_, **__: np.full(49, np.nan))
    answer = minimum_norm.Bench("position", joint_range=False).by_mink("daqp")
    assert answer == minimum_norm.Answer(failure="values that are not finite")


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("method", [weight_ratio.ORTHOGONAL, weight_ratio.QP])
def test_by_orthogonal_factors_weights_come_as_near_to_strict_as_one_over_their_ratio(
    method: str, quantity: str, ratios: tuple[str, dict[str, Any]]
) -> None:
    found = distances(ratios[1]["rows"], method, quantity)[:9]
    assert (np.diff(found) < 0.0).all()
    assert found[-1] < 1e-6
    # From where the heavier task has its way, ten times the ratio is a tenth of the distance.
    assert found[3:] / found[2:-1] == pytest.approx(0.1, rel=0.1)


@pytest.mark.parametrize("method", [weight_ratio.PINV, weight_ratio.DAMPED])
def test_by_normal_equations_they_do_not(method: str, ratios: tuple[str, dict[str, Any]]) -> None:
    found = distances(ratios[1]["rows"], method)
    assert not ((np.diff(found[:9]) < 0.0).all() and found[8] < 1e-6)
    assert found[-1] > 0.1


def test_by_the_slack_qp_residuals_follow_where_the_step_does_not(ratios: tuple[str, dict[str, Any]]) -> None:
    method = weight_ratio.SLACK.format("quadprog")
    first = distances(ratios[1]["rows"], method, "level_1")
    assert first[3:] / first[2:-1] == pytest.approx(0.1, rel=0.1)
    steps = distances(ratios[1]["rows"], method)
    assert steps[3] < 2e-3
    assert steps[6:].max() / steps[6:].min() < 10.0  # no longer better, but, unlike by normal equations, not worse either
    assert 1e-6 < steps[-1] < 1e-2


def test_a_solver_that_is_not_installed_is_a_method_that_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    method = weight_ratio.SLACK.format("none")
    monkeypatch.setattr(weight_ratio, "RATIOS", (1.0,))
    monkeypatch.setitem(weight_ratio.METHODS, method, partial(weight_ratio.by_slack_qp, "none"))
    (row,) = [row for row in weight_ratio.measure() if row.method == method]
    assert row.dtheta is None
    assert row.failure.startswith("unknown solver 'slack:none'")


def test_strict_levels_by_the_qp_need_no_ratio(ratios: tuple[str, dict[str, Any]]) -> None:
    (strict,) = [row for row in ratios[1]["rows"] if row["ratio"] is None]
    assert strict["method"] == weight_ratio.QP
    assert max(strict[quantity] for quantity in QUANTITIES) <= SAME


def test_the_two_tasks_conflict() -> None:
    first, second = weight_ratio.conflicting_levels()
    assert np.linalg.matrix_rank(np.vstack([first.matrix, second.matrix])) == 5
    strict = weight_ratio.by_orthogonal_factors(first, second)
    assert np.linalg.norm(first.matrix @ strict - first.target) <= 1e-12
    assert np.linalg.norm(second.matrix @ strict - second.target) > 5e-3


def test_the_json_rows_of_weight_ratio_hold_what_its_tables_show(ratios: tuple[str, dict[str, Any]]) -> None:
    output, content = ratios
    rows = content["rows"]
    assert len(rows) == 13 * len(weight_ratio.METHODS) + 1
    _, *tables = output.split("distance of ")
    assert len(tables) == len(QUANTITIES)
    for table, quantity in zip(tables, QUANTITIES, strict=True):
        for ratio in weight_ratio.RATIOS:
            (line,) = [line.split() for line in table.splitlines() if line.split()[:1] == [f"{ratio:.0e}"]]
            assert line[1:] == [shown_distance(row[quantity]) for row in rows if row["ratio"] == ratio]
        (line,) = [line.split() for line in table.splitlines() if line.strip().startswith("strict levels")]
        assert line[2:] == [f"{rows[-1][quantity]:.0e}"]


def test_the_output_names_where_each_method_breaks_down(ratios: tuple[str, dict[str, Any]]) -> None:
    output, content = ratios
    for method in weight_ratio.METHODS:
        found = distances(content["rows"], method)
        (line,) = [line for line in output.splitlines() if line.startswith(f"{method}: closest at ratio")]
        assert f"{weight_ratio.RATIOS[int(np.nanargmin(found))]:.0e}, to {np.nanmin(found):.0e}" in line
        assert line.endswith("still falling there." if np.nanargmin(found) == 12 else "rounding takes over beyond.")


def test_a_method_without_an_answer_is_shown_as_failing(monkeypatch: pytest.MonkeyPatch) -> None:
    def singular(_: object) -> Array:
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setitem(weight_ratio.METHODS, weight_ratio.PINV, singular)
    result = call("weight-ratio")
    assert result.exit_code == 0, result.output
    rows = weight_ratio.measure()
    assert result.output.count("fails") == 3 * sum(row.dtheta is None for row in rows) >= 3 * 13
    assert f"{weight_ratio.PINV}: no answer at any ratio." in result.output
    assert f"{weight_ratio.PINV}, ratio 1e+03: Singular matrix" in result.output


@pytest.mark.parametrize("command", ["minimum-norm", "weight-ratio"])
@pytest.mark.parametrize(
    ("file", "message"),
    [
        ("", "cannot write to ''; expected the name of a file"),
        ("/no/such/folder/r.json", "cannot write into '/no/such/folder'; expected a folder that exists and is writable"),
    ],
)
def test_a_place_that_cannot_be_written_is_refused_before_any_solve(
    command: str, file: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (minimum_norm, weight_ratio):
        monkeypatch.setattr(module, "measure", lambda *_: pytest.fail("the file is looked at first"))
    result = call(command, "--json", file)
    assert result.exit_code == 2
    assert message in result.output


@pytest.mark.parametrize("arguments", [["maximum-norm"], ["minimum-norm", "--solver", "daqp"], ["weight-ratio", "1e3"]])
def test_an_unknown_demonstration_or_option_is_bad_usage(arguments: list[str]) -> None:
    result = call(*arguments)
    assert result.exit_code == 2
    assert arguments[-1] in result.output or arguments[-2] in result.output
