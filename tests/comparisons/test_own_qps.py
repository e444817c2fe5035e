"""Users bring their own episodes and QPs."""

import json
from pathlib import Path

import numpy as np
import polars
import pytest
import qpsolvers
from click.testing import CliRunner

from comparisons.cases import own_files
from comparisons.isolation import Limits, prepare
from comparisons.own_qps import load_qp, measure_qps
from comparisons.results import json_rows
from comparisons.settings import ComparisonSettings
from comparisons.store import Store
from prioritized_ik.cli import main
from prioritized_ik.errors import EpisodeFileError
from prioritized_ik.winding.episode import wind
from prioritized_ik.winding.settings import WindingSettings

LIMITS = Limits(20.0, 2**31)


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """A folder with one feasible QP, one infeasible one and one episode."""
    place = tmp_path / "own"
    place.mkdir()
    one = np.eye(2), np.array([-1.0, -2.0]), np.array([[1.0, 1.0]]), np.array([1.0])
    qpsolvers.Problem(*one, lb=np.zeros(2)).save(str(place / "feasible.npz"))
    qpsolvers.Problem(*one, lb=np.ones(2)).save(str(place / "infeasible.npz"))
    wind(WindingSettings(link=15, tilt=0.2)).save(place / "mine, tilted.npz")
    return place


def test_a_qp_is_judged_by_the_residuals_of_its_problem(own: Path) -> None:
    prepare()
    problems = {name: load_qp(own / f"{name}.npz") for name in ("feasible", "infeasible")}
    for solver in ("quadprog", "clarabel"):
        feasible, infeasible = measure_qps(solver, 1e-8, problems, LIMITS)
        assert feasible["found"]
        assert max(feasible[name] for name in ("primal_residual", "dual_residual", "duality_gap")) <= 1e-6
        assert not infeasible["found"]
        assert infeasible["primal_residual"] is None


def test_own_episodes_and_qps_take_the_place_of_the_windings(own: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = ["compare", "--recorded", str(own), "--solvers", "daqp,quadprog", "--steps", "5", "--no-drive"]
    result = CliRunner().invoke(main, [*arguments, "--repeats", "1", "--out", str(out), "--strict"])
    assert result.exit_code == 0, result.output
    store = Store(out)
    assert set(store.steps()["case"]) == {"mine, tilted"}
    assert store.problem("mine, tilted", 0).joint_count == WindingSettings().arm.joint_count
    assert store.qps().filter("found")["qp"].to_list() == ["feasible", "feasible"]
    assert "QPs" in result.output
    assert polars.read_parquet(out / "qps.parquet").equals(store.qps())


def test_qps_alone_are_in_the_json_and_nothing_that_strict_could_check(own: Path, tmp_path: Path) -> None:
    (own / "mine, tilted.npz").unlink()
    file = tmp_path / "qps.json"
    result = CliRunner().invoke(main, ["compare", "--recorded", str(own), "--solvers", "quadprog", "--json", str(file)])
    assert result.exit_code == 0, result.output
    content = json.loads(file.read_text(encoding="utf-8"))
    assert content["rows"] == []
    assert [(row["qp"], row["found"]) for row in content["qps"]] == [("feasible", True), ("infeasible", False)]
    strict = CliRunner().invoke(main, ["compare", "--recorded", str(own), "--solvers", "quadprog", "--strict"])
    assert strict.exit_code == 2
    assert "nothing was checked" in strict.output


def test_json_has_null_where_a_solver_tells_no_multipliers() -> None:
    table = polars.DataFrame({"qp": ["one", "two"], "dual_residual": [float("inf"), 1e-9], "found": [True, True]})
    assert [row["dual_residual"] for row in json_rows(table)] == [None, 1e-9]
    assert list(json_rows(table)[0]) == table.columns


def test_something_else_among_them_is_refused_by_name(own: Path, tmp_path: Path) -> None:
    np.savez(own / "other.npz", x=np.zeros(3))
    result = CliRunner().invoke(main, ["compare", "--recorded", str(own), "--solvers", "daqp"])
    assert result.exit_code == 2
    assert "other.npz" in result.output
    with pytest.raises(EpisodeFileError, match=r"write it with `Problem\.save`"):
        load_qp(own / "other.npz")


def test_damaged_files_are_refused_by_name(own: Path) -> None:
    whole = (own / "feasible.npz").read_bytes()
    damaged = {"cut short": whole[:-200], "empty": b"", "spoilt": whole[:60] + b"\xff" * 60 + whole[120:]}
    for content in damaged.values():
        (own / "feasible.npz").write_bytes(content)
        with pytest.raises(EpisodeFileError, match=r"feasible\.npz"):
            load_qp(own / "feasible.npz")
    for name in ("cut short", "empty"):
        (own / "feasible.npz").write_bytes(damaged[name])
        with pytest.raises(EpisodeFileError, match=r"feasible\.npz"):
            own_files(str(own))


def test_changed_files_are_other_settings(own: Path, tmp_path: Path) -> None:
    from comparisons.run import made_by

    settings = ComparisonSettings(solvers=("daqp",), recorded=str(own))
    before = made_by(settings)
    assert set(before["recorded"]) == {"feasible.npz", "infeasible.npz", "mine, tilted.npz"}
    qpsolvers.Problem(np.eye(2), np.zeros(2)).save(str(own / "feasible.npz"))
    assert made_by(settings) != before
