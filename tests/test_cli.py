"""The command line: what it prints, what it refuses, and that it starts without anything heavy."""

import json
import subprocess
import sys
from pathlib import Path

import polars
import pytest
from click.testing import CliRunner, Result

from comparisons.command import compare
from comparisons.settings import ComparisonSettings
from prioritized_ik.cli import main
from prioritized_ik.winding.episode import Episode

ROW = (
    "solver version formulation free_steps free_dtheta_error_max free_dtheta_error_median free_dx_error_max "
    "constrained_steps constrained_violation_max cost_gap_max not_found solve_time_p50_s solve_time_p99_s "
    "turns_ratio_min penetration_max_m bend_max_rad drift_max_m verdict"
).split()


def call(*arguments: str) -> Result:
    return CliRunner().invoke(main, arguments)


def test_help_names_every_command_and_imports_nothing_heavy() -> None:
    code = (
        "import sys; from click.testing import CliRunner; from prioritized_ik.cli import main; "
        "result = CliRunner().invoke(main, ['--help']); print(result.output); "
        "heavy = {'mujoco', 'qpsolvers', 'scipy', 'numpy', 'polars', 'cvxpy'} & set(sys.modules); "
        "assert not heavy, heavy; assert result.exit_code == 0"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert all(command in done.stdout for command in ("compare", "demo", "solvers", "wind"))


def test_solvers_lists_what_is_installed_and_how_to_install_the_rest() -> None:
    result = call("solvers")
    assert result.exit_code == 0
    assert "proxqp" in result.output
    assert "pip install" in result.output


def test_wind_saves_an_episode_that_loads(tmp_path: Path) -> None:
    file = tmp_path / "episode.npz"
    result = call("wind", "--link", "14", "--direction", "back", "--save", str(file))
    assert result.exit_code == 0, result.output
    assert "equilibrium [1]" in result.output
    assert Episode.load(file).settings.direction == "back"


def test_wind_with_strict_weights_winds_and_says_so_in_its_file(tmp_path: Path) -> None:
    file = tmp_path / "episode.npz"
    places = ("--save", str(file), "--record", str(tmp_path / "end.png"))
    result = call("wind", "--link", "14", "--tilt", "0.3", "--weights", "strict", *places)
    assert result.exit_code == 0, result.output
    assert "equilibrium [1]" in result.output
    episode = Episode.load(file)
    assert episode.settings.weights == "strict"
    assert len(episode.problem(0).levels) == 3


@pytest.mark.parametrize("kind", [".png", ".gif"])
def test_wind_records_a_picture_with_the_arm_in_it(tmp_path: Path, kind: str) -> None:
    from PIL import Image

    file = tmp_path / f"picture{kind}"
    result = call("wind", "--link", "16", "--steps", "60", "--record", str(file))
    assert result.exit_code == 0, result.output
    with Image.open(file) as picture:
        assert picture.size == (960, 720)
        colours = picture.convert("RGB").getcolors(960 * 720)
    blue = sum(count for count, (red, green, blue) in colours if blue > red + 40 and blue > green + 20)
    assert blue > 500


def test_wind_ends_with_one_when_the_arm_is_not_wound() -> None:
    result = call("wind", "--steps", "3")
    assert result.exit_code == 1
    assert "no equilibrium" in result.output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["wind", "--solver", "nosuch"], "unknown solver 'nosuch'; choose one of"),
        (["wind", "--direction", "left"], "unknown direction 'left'; choose one of: up, down, front, back"),
        (["wind", "--diameter", "-0.1"], "diameter is -0.1; expected a finite number above 0"),
        (["wind", "--diameter", "nan"], "diameter is nan"),
        (["wind", "--links", "0"], "links is 0; expected a whole number of at least 1"),
        (["wind", "--link", "18"], "link is 18; expected 1 to 16"),
        (["wind", "--weights", "eq25"], "unknown weights 'eq25'; choose one of: eq23, eq24, strict"),
        (["wind", "--weights", "strict", "--formulation", "damped"], "takes one level, not 3; use 'lexicographic'"),
        (["wind", "--shape", "torus"], "unknown shape 'torus'"),
        (["wind", "--formulation", "magic"], "unknown formulation 'magic'"),
        (["wind", "--save", "/no/such/folder/e.npz"], "cannot write into '/no/such/folder'"),
        (["wind", "--record", "arm.bmp"], "unknown kind of picture '.bmp'; choose one of: .png, .gif"),
        (["compare", "--solvers", "daqp,nosuch"], "unknown solver 'nosuch'"),
        (["compare", "--solvers", "daqp,daqp"], "solvers names one twice"),
        (["compare", "--directions", "up,left"], "unknown direction 'left'"),
        (["compare", "--formulation", "magic"], "unknown formulation 'magic'"),
        (["wind", "--link", "17"], "link is 17; expected 1 to 16, so that a link is left to wind"),
        (["wind", "--save", ""], "cannot write to ''; expected the name of a file"),
        (["compare", "--json", ""], "cannot write to ''; expected the name of a file"),
        (["compare", "--directions", ""], "directions is empty; expected at least one"),
        (["compare", "--formulation", "damped,damped"], "formulation names one twice"),
        (["compare", "--steps", "0"], "steps is 0"),
        (["compare", "--workers", "0"], "workers is 0"),
        (["compare", "--accuracy", "2"], "accuracy is 2.0"),
        (["compare", "--damping", "-1"], "damping is -1.0"),
        (["compare", "--out", "/dev/null/results"], "cannot write into"),
        (["compare", "--json", "/no/such/folder/r.json"], "cannot write into '/no/such/folder'"),
    ],
)
def test_bad_input_is_one_message_with_the_value_and_exit_code_two(
    arguments: list[str], message: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    result = call(*arguments)
    assert result.exit_code == 2, result.output
    assert message in result.output
    assert "Traceback" not in result.output
    assert not list(tmp_path.iterdir())


def test_an_unknown_option_is_bad_usage() -> None:
    assert call("compare", "--nosuch").exit_code == 2


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result]:
    folder = tmp_path_factory.mktemp("compare")
    (folder / "page.md").write_text("above\n<!-- table: make readme -->\nold\n<!-- end of table -->\nbelow\n")
    arguments = ["--solvers", "daqp,quadprog", "--directions", "up", "--steps", "10", "--link", "12"]
    places = ["--out", str(folder / "out"), "--json", str(folder / "all.json"), "--readme", str(folder / "page.md")]
    return folder, call("compare", *arguments, *places, "--strict")


def test_compare_finds_that_exact_backends_agree(compared: tuple[Path, Result]) -> None:
    _, result = compared
    assert result.exit_code == 0, result.output
    assert "agrees" in result.output


def test_compare_writes_the_json_that_it_promises(compared: tuple[Path, Result]) -> None:
    content = json.loads((compared[0] / "all.json").read_text(encoding="utf-8"))
    assert {"versions", "cpu", "settings", "rows"} <= set(content)
    assert all(set(ROW) <= set(row) for row in content["rows"])
    found = {(row["solver"], row["formulation"]) for row in content["rows"]}
    expected = {(solver, kind) for solver in ("daqp", "quadprog") for kind in ("lexicographic", "damped")}
    assert found == expected | {("closed-form", "closed form"), ("mink (daqp)", "mink"), ("mink (proxqp)", "mink")}
    for row in content["rows"]:
        if row["formulation"] == "lexicographic":
            assert row["free_dtheta_error_max"] <= 1e-6
            assert row["constrained_violation_max"] <= 1e-6
            assert row["cost_gap_max"] <= 1e-6
            assert row["free_steps"] + row["constrained_steps"] == 10


def test_compare_writes_parquet_markdown_and_episodes(compared: tuple[Path, Result]) -> None:
    out = compared[0] / "out"
    assert {p.name for p in out.iterdir()} == {"steps.parquet", "episodes.parquet", "rows.parquet", "table.md", "up.npz"}
    steps = polars.read_parquet(out / "steps.parquet")
    assert len(steps) == 10 * (2 * 2 + 2)
    assert set(polars.read_parquet(out / "episodes.parquet")["solver"]) == {
        "daqp", "quadprog", "closed-form", "mink (daqp)", "mink (proxqp)",
    }  # fmt: skip
    assert (out / "table.md").read_text(encoding="utf-8").startswith("| solver")


def test_compare_replaces_the_table_of_a_page_and_nothing_else(compared: tuple[Path, Result]) -> None:
    page = (compared[0] / "page.md").read_text(encoding="utf-8")
    assert page.startswith("above\n<!-- table: make readme -->\n| solver")
    assert page.endswith("<!-- end of table -->\nbelow\n")
    assert "old" not in page


def test_a_page_without_the_markers_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "page.md"
    page.write_text("nothing here\n")
    monkeypatch.setattr("comparisons.run.run", lambda *_: pytest.fail("the page is looked at first"))
    result = call("compare", "--solvers", "daqp", "--readme", str(page))
    assert result.exit_code == 2
    assert "has no place for the table" in result.output
    assert page.read_text() == "nothing here\n"


def test_strict_ends_with_one_when_a_row_disagrees(monkeypatch: pytest.MonkeyPatch) -> None:
    step = {
        "direction": "up", "step": 0, "free": True, "found": True, "violation": 0.0, "cost": 1.0, "cost_at_zero": 2.0,
        "dtheta": [0.0, 1.0],
        "dtheta_error": 1e-3, "dx_error": 1e-9, "solve_s": 1e-3, "polish_s": 1e-3, "status": "SOLVED", "certified": True,
        "certified_dtheta": [0.0, 1.0], "solver": "daqp", "formulation": "lexicographic",
    }  # fmt: skip
    monkeypatch.setattr("comparisons.run.run", lambda *_: ([step], []))
    result = call("compare", "--solvers", "daqp", "--strict")
    assert result.exit_code == 1
    assert "disagrees: dθ 1e-03" in result.output
    assert call("compare", "--solvers", "daqp").exit_code == 0


def test_the_defaults_of_compare_are_those_of_its_settings() -> None:
    # Written twice, since the command line starts without importing where they come from.
    defaults = ComparisonSettings(solvers=("daqp",))
    options = {option.name: option.default for option in compare.params}
    for name in ("steps", "link", "tilt", "accuracy", "rank_tolerance", "damping", "closed_form_first"):
        assert options[name] == getattr(defaults, name), name
    assert tuple(options["directions"].split(",")) == defaults.directions
    assert tuple(options["formulation"].split(",")) == defaults.formulations
