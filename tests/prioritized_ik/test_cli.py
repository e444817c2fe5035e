"""The command line: what it prints, what it refuses, and that it starts without anything heavy."""

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import polars
import pytest
from click.testing import CliRunner, Result

from comparisons.command import compare
from comparisons.compared import compared as with_comparisons
from comparisons.settings import ComparisonSettings
from comparisons.store import PARTS, TABLES, Store
from prioritized_ik.cli import main
from prioritized_ik.errors import InputError
from prioritized_ik.solvers.compiled.library import library
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
    assert f"The kernel runs {'compiled' if library().core is not None else 'in Python'}" in result.output


def test_wind_saves_an_episode_that_loads(tmp_path: Path) -> None:
    file = tmp_path / "episode.npz"
    result = call("wind", "--link", "14", "--direction", "back", "--save", str(file))
    assert result.exit_code == 0, result.output
    assert "equilibrium [1]" in result.output
    assert Episode.load(file).settings.direction == "back"


def test_wind_with_strict_weights_winds_and_says_so_in_its_file(renders: None, tmp_path: Path) -> None:
    file = tmp_path / "episode.npz"
    places = ("--save", str(file), "--record", str(tmp_path / "end.png"))
    result = call("wind", "--link", "14", "--tilt", "0.3", "--weights", "strict", *places)
    assert result.exit_code == 0, result.output
    assert "equilibrium [1]" in result.output
    episode = Episode.load(file)
    assert episode.settings.weights == "strict"
    assert len(episode.problem(0).levels) == 3


@pytest.mark.parametrize("kind", [".png", ".gif"])
def test_wind_records_a_picture_with_the_arm_in_it(renders: None, tmp_path: Path, kind: str) -> None:
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
        (["wind", "--formulation", "magic"], "unknown formulation 'magic'; choose one of: lexicographic, dense, lifted,"),
        (["wind", "--save", "/no/such/folder/e.npz"], "cannot write into '/no/such/folder'"),
        (["wind", "--record", "arm.bmp"], "unknown kind of picture '.bmp'; choose one of: .png, .gif, .webp, .mp4"),
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
        (["compare", "--accuracy", "1e-6,much"], "accuracy is '1e-6,much'; expected numbers separated by commas"),
        (["compare", "--links", "8,17.5"], "links is '8,17.5'; expected numbers"),
        (["compare", "--links", "8,8"], "links names one twice"),
        (["compare", "--links", "4", "--link", "6"], "link is 6; expected 1 to 3"),
        (["compare", "--diameter", "0.1,-0.2"], "diameter is -0.2"),
        (["compare", "--tilt", "2"], "tilt is 2.0; expected less than 1.2 rad"),
        (["compare", "--object", "torus"], "unknown shape 'torus'"),
        (["compare", "--seeds", "5:5"], "seeds is '5:5', which holds none"),
        (["compare", "--seeds", "a:b"], "seeds is 'a:b'; expected numbers or ranges such as 0:50"),
        (["compare", "--repeats", "0"], "repeats is 0"),
        (["compare", "--time-limit", "0"], "time_limit is 0.0"),
        (["compare", "--plugin", "no.such"], "cannot import plugin 'no.such'"),
        (["compare", "--recorded", "/no/such"], "cannot read '/no/such'; expected a folder"),
        (["compare", "--recorded", "."], "'.' holds no .npz file"),
        (["compare", "--scheduler", "nonsense"], "no Dask scheduler answers at 'nonsense'"),
        (["compare", "--open"], "--open shows the report, which needs a folder"),
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
    arguments = ["--solvers", "daqp,quadprog", "--directions", "up", "--steps", "10", "--link", "12", "--repeats", "2"]
    places = ["--out", str(folder / "out"), "--json", str(folder / "all.json")]
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
    assert found == expected | {("closed-form", "closed form"), ("mink:daqp", "mink"), ("mink:proxqp", "mink")}
    for row in content["rows"]:
        if row["formulation"] == "lexicographic":
            assert row["free_dtheta_error_max"] <= 1e-6
            assert row["constrained_violation_max"] <= 1e-6
            assert row["cost_gap_max"] <= 1e-6
            assert row["free_steps"] + row["constrained_steps"] == 10


def test_compare_writes_parquet_markdown_report_and_episodes(compared: tuple[Path, Result]) -> None:
    folder, result = compared
    out = folder / "out"
    files = {
        "settings.json",
        "steps.parquet",
        "episodes.parquet",
        "success.parquet",
        "rows.parquet",
        "table.md",
        "report.html",
    }
    assert {p.name for p in out.iterdir()} == files | {"parts", "recorded", "driven"}
    assert f"Report: {out / 'report.html'}" in result.output
    steps = polars.read_parquet(out / "steps.parquet")
    assert len(steps) == 2 * 10 * (2 * 2 + 2)
    assert steps["cpu"].null_count() == steps["revision"].null_count() == steps["settings"].null_count() == 0
    episodes = polars.read_parquet(out / "episodes.parquet")
    assert set(episodes["solver"]) == {"daqp", "quadprog", "closed-form", "mink:daqp", "mink:proxqp"}
    for file, steps_there in zip(episodes["file"], episodes["steps"], strict=True):
        assert Episode.load(out / file).steps == steps_there
    assert (out / "table.md").read_text(encoding="utf-8").startswith("| solver")


def test_compare_goes_on_where_it_was_and_refuses_results_of_other_settings(compared: tuple[Path, Result]) -> None:
    out = compared[0] / "out"
    part = sorted((out / "parts/steps").iterdir())[0]
    others = {path: path.stat().st_mtime_ns for path in (out / "parts").rglob("*.parquet") if path != part}
    part.unlink()
    arguments = [
        "compare",
        "--solvers",
        "daqp,quadprog",
        "--directions",
        "up",
        "--link",
        "12",
        "--repeats",
        "2",
        "--out",
        str(out),
    ]
    assert call(*arguments, "--steps", "10").exit_code == 0
    assert part.exists()
    assert {path: path.stat().st_mtime_ns for path in others} == others
    refused = call(*arguments, "--steps", "11", "--accuracy", "1e-6")
    assert refused.exit_code == 2
    assert "steps was 10 there and is 11 now; accuracy was 1e-08 there and is 1e-06 now" in refused.output
    assert "--fresh" in refused.output


def test_fresh_deletes_results_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "recorded").mkdir()
    (tmp_path / "recorded" / "mine.npz").write_text("not a result")
    Store.clear(tmp_path)
    assert (tmp_path / "recorded" / "mine.npz").exists()
    (tmp_path / "settings.json").write_text('{"something": "else"}')
    with pytest.raises(InputError, match="expected the folder of a comparison"):
        Store.clear(tmp_path)
    assert (tmp_path / "recorded" / "mine.npz").exists()
    (tmp_path / "settings.json").unlink()
    Store.create(tmp_path, {}, {})
    (tmp_path / "notes.txt").write_text("mine")
    for name in ("report.html", "table.md", *(f"{name}.parquet" for name in TABLES)):
        (tmp_path / name).write_text("of the old run")
    Store.clear(tmp_path)
    assert [path.name for path in tmp_path.iterdir() if path.is_file()] == ["notes.txt"]
    assert not (tmp_path / "parts" / "steps").exists()


def test_fresh_that_is_killed_leaves_a_store_that_lacks_something(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Store.create(tmp_path, {}, {})
    (tmp_path / "report.html").touch()
    (tmp_path / "recorded" / "up.npz").touch()

    def killed(path: Path) -> None:
        if path.name == "recorded" and path.parent == tmp_path:
            raise KeyboardInterrupt
        path.rmdir()

    monkeypatch.setattr("shutil.rmtree", killed)
    with pytest.raises(KeyboardInterrupt):
        Store.clear(tmp_path)
    assert not list((tmp_path / "parts").iterdir()), "no part rests on a recorded episode that is gone"
    assert not (tmp_path / "report.html").exists()
    assert (tmp_path / "settings.json").exists(), "so that it can be cleared again"


def test_own_episodes_in_the_folder_that_is_written_are_refused(tmp_path: Path) -> None:
    (tmp_path / "recorded").mkdir()
    result = call("compare", "--recorded", str(tmp_path / "recorded"), "--out", str(tmp_path), "--fresh")
    assert result.exit_code == 2
    assert "which is written" in result.output
    assert (tmp_path / "recorded").exists()


def test_strict_ends_with_one_and_names_who_disagrees(monkeypatch: pytest.MonkeyPatch) -> None:
    step = {
        "case": "up", "direction": "up", "step": 0, "free": True, "found": True, "violation": 0.0, "cost": 1.0,
        "cost_at_zero": 2.0, "dtheta": [0.0, 1.0], "dtheta_error": 1e-3, "dx_error": 1e-9, "build_s": 1e-3,
        "solve_s": 1e-3, "polish_s": 1e-3, "status": "SOLVED", "certified": True, "certified_dtheta": [0.0, 1.0],
        "solver": "daqp", "version": "9.9", "formulation": "lexicographic", "accuracy": 1e-8, "start": "cold", "repeat": 0,
    }  # fmt: skip
    other = {**step, "solver": "quadprog", "dtheta_error": 1e-9}
    store = SimpleNamespace(
        steps=lambda: with_comparisons(polars.DataFrame([step, other], schema=PARTS["steps"])),
        episodes=lambda: polars.DataFrame(schema=PARTS["episodes"]),
        qps=lambda: polars.DataFrame(schema=PARTS["qps"]),
    )
    monkeypatch.setattr("comparisons.run.run", lambda *_, **__: store)
    result = call("compare", "--solvers", "daqp", "--strict")
    assert result.exit_code == 1
    assert "daqp 9.9 (lexicographic, accuracy 1e-08): disagrees: dθ 1e-03" in result.output
    assert "quadprog 9.9 (lexicographic" not in result.output
    assert call("compare", "--solvers", "daqp").exit_code == 0


def test_the_defaults_of_compare_are_those_of_its_settings() -> None:
    # Written twice, since the command line starts without importing where they come from.
    defaults = ComparisonSettings(solvers=("daqp",))
    options = {option.name: option.default for option in compare.params}
    for name in ("steps", "rank_tolerance", "damping", "closed_form_first", "repeats", "drive", "mink", "witness",
                 "time_limit", "memory_limit", "recorded", "scheduler"):  # fmt: skip
        assert options[name] == getattr(defaults, name), name
    for name in ("links", "link", "shapes", "diameter", "tilt", "accuracy", "directions"):
        assert options[name] == ",".join(map(str, getattr(defaults, name))), name
    assert tuple(options["formulation"].split(",")) == defaults.formulations
    assert options["seeds"] == ""
    assert defaults.seeds == ()
