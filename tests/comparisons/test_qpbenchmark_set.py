"""The exported test set: the stages that solvers are given, feasible, and what the real qpbenchmark makes of them."""

import csv
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import polars
import pytest
import qpsolvers
from click.testing import CliRunner
from scipy.optimize import linprog

from comparisons import qpbenchmark_set
from comparisons.export import export_qpbenchmark
from comparisons.qpbenchmark_set import (
    POSITIVE_DEFINITE,
    SEMIDEFINITE,
    NamedStage,
    feasible_stages,
    named_stages,
    write_test_set,
)
from prioritized_ik import solve
from prioritized_ik.errors import InputError
from prioritized_ik.problem import Bounds, IKProblem, Level, Rows
from prioritized_ik.solvers.backends.protocol import StageResult
from prioritized_ik.solvers.stages import Stage
from prioritized_ik.winding.episode import Episode, wind
from prioritized_ik.winding.settings import WindingSettings

STEPS = 4


@pytest.fixture(scope="module")
def episode() -> Episode:
    return wind(WindingSettings(link=13))


@pytest.fixture(scope="module")
def exported(episode: Episode, tmp_path_factory: pytest.TempPathFactory) -> Path:
    recorded, folder = tmp_path_factory.mktemp("recorded"), tmp_path_factory.mktemp("exported")
    episode.save(recorded / "up.npz")
    result = CliRunner().invoke(
        export_qpbenchmark, [str(folder), "--recorded", str(recorded), "--steps", str(STEPS)], catch_exceptions=False
    )
    assert result.exit_code == 0, result.output
    return folder


def problems(folder: Path, module: str) -> dict[str, qpsolvers.Problem]:
    """Read the Parquet file as qpbenchmark does: flat matrices, as many columns as there are variables."""
    found = {}
    for row in polars.read_parquet(folder / f"{module}.parquet").iter_rows(named=True):
        given = {
            key: None if row[key] is None else np.array(row[key]) for key in ("P", "q", "G", "h", "A", "b", "lb", "ub")
        }
        for key in ("P", "G", "A"):
            if given[key] is not None:
                given[key] = given[key].reshape(-1, len(row["q"]))
        found[row["name"]] = qpsolvers.Problem(**given)
    return found


def test_the_subsets_are_what_they_are_called(exported: Path) -> None:
    definite, semidefinite = (problems(exported, subset.module) for subset in (POSITIVE_DEFINITE, SEMIDEFINITE))
    assert len(definite) >= STEPS - 1
    assert len(semidefinite) >= STEPS - 1
    assert all(np.linalg.eigvalsh(qp.P).min() > 0.5 for qp in definite.values())
    assert all(np.linalg.eigvalsh(qp.P).min() == 0.0 for qp in semidefinite.values())
    assert not set(definite) & set(semidefinite)


def test_every_problem_is_feasible_says_another_solver(exported: Path) -> None:
    for subset in (POSITIVE_DEFINITE, SEMIDEFINITE):
        for name, qp in problems(exported, subset.module).items():
            answer = linprog(np.zeros(len(qp.q)), qp.G, qp.h, bounds=(None, None))
            assert answer.status == 0, name


def test_the_last_stage_leads_to_the_step_that_solve_returns(episode: Episode) -> None:
    problem = episode.problem(episode.steps // 2)
    last = feasible_stages(problem)[-1]
    x = qpsolvers.solve_problem(last.problem, "quadprog").x
    expected = solve(problem, options=episode.settings.options).dtheta
    # Where rows bind, solvers agree in cost, and in dθ only as far as the table's `bound dθ` shows.
    assert np.linalg.norm(last.dtheta(x) - expected) <= 1e-6 * np.linalg.norm(expected)


def test_an_infeasible_problem_is_left_out() -> None:
    task = Level(np.eye(2), [0.1, 0.1])
    apart = IKProblem([task], Bounds([-1.0, -1.0], [1.0, 1.0]), Rows([[1.0, 0.0], [-1.0, 0.0]], [-0.1, -0.1]))
    assert feasible_stages(apart) == []
    assert feasible_stages(IKProblem([task], Bounds([-1.0, -1.0], [1.0, 1.0]))) != []


def test_a_stage_whose_answer_breaks_rows_is_left_out_too(monkeypatch: pytest.MonkeyPatch, episode: Episode) -> None:
    def careless(self: object, stage: Stage) -> StageResult:
        return StageResult(np.full(stage.size, 1e3))

    monkeypatch.setattr(qpbenchmark_set.QpsolversBackend, "solve", careless)
    assert feasible_stages(episode.problem(episode.steps // 2)) == []


def test_without_problems_nothing_is_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no problem"):
        write_test_set(tmp_path, [])
    assert list(tmp_path.iterdir()) == []


def test_names_tell_episode_step_and_stage(episode: Episode) -> None:
    named: list[NamedStage] = list(named_stages({"up": episode}, 2))
    assert {item.name.rsplit("_", 1)[0] for item in named} == {"up_0000", f"up_{episode.steps - 1:04d}"}
    assert len({item.name for item in named}) == len(named)


@pytest.mark.parametrize(
    ("module", "solvers"),
    [(SEMIDEFINITE.module, ("daqp", "proxqp", "clarabel")), (POSITIVE_DEFINITE.module, ("quadprog",))],
)
def test_the_real_qpbenchmark_runs_it_and_every_solver_succeeds(
    exported: Path, tmp_path: Path, module: str, solvers: tuple[str, ...]
) -> None:
    results = tmp_path / "results.csv"
    command = Path(sys.executable).with_name("qpbenchmark")
    for solver in solvers:
        subprocess.run(
            [
                command,
                exported / f"{module}.py",
                "--results-path",
                results,
                "run",
                "--solver",
                solver,
                "--author",
                "nobody",
            ],
            check=True,
            capture_output=True,
            timeout=300,
        )
    with results.open(newline="") as file:
        rows = list(csv.DictReader(file))
    asked = {(row["problem"], row["solver"], row["settings"]) for row in rows}
    assert {row["solver"] for row in rows} == set(solvers)
    assert len(asked) == len(problems(exported, module)) * len(solvers) * len({row["settings"] for row in rows})
    report = (tmp_path / f"{module}.md").read_text(encoding="utf-8")
    # The first table of the report's section on success: per cent of the problems, a column for each settings.
    section = report[report.index("### Success rate") :]
    shares = {solver: re.search(rf"^\| {solver} +\|(.*)\|$", section, re.MULTILINE) for solver in solvers}
    for solver, found in shares.items():
        assert found is not None, solver
        assert [float(cell) for cell in found[1].split("|")] == [100.0] * 4, solver
