"""The bench asks every program the same question, proves every step that it times, and says what it left out.

No time is asserted here.
"""

import importlib.util
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mink
import mujoco
import numpy as np
import pytest
from click.testing import CliRunner, Result
from repository import ROOT
from winding_fixtures import recorded

from comparisons import goals
from comparisons.bench import command, neighbours, report, winding
from comparisons.bench.clock import Times, quantile, ratio, rotated, timed
from comparisons.bench.growth import WARM_TREE
from comparisons.bench.rivals import Dgelsy, Mink, MinkOnRobot, in_one_level
from comparisons.bench.run import Bench, figures, run
from comparisons.bench.settings import ROBOT_LEVELS, BenchSettings
from comparisons.bench.tracks import label, problem_of
from comparisons.bench.urdf import urdf
from comparisons.bench.winding import CHANGED, OURS, PARTS, DifferentProblemError, stretches_of
from comparisons.robots import ROBOTS
from prioritized_ik.cli import CommandGroup
from prioritized_ik.errors import ModelError
from prioritized_ik.models import Arm
from prioritized_ik.problem import IKProblem, Level, replaced
from prioritized_ik.validation import Array
from prioritized_ik.winding.episode import Episode, wind
from prioritized_ik.winding.settings import WindingSettings

TINY = BenchSettings(
    directions=("up",),
    weights=("eq23", "strict"),
    stretches=1,
    stretch=2,
    changes=1,
    repeats=2,
    tracks=1,
    track=2,
    links=(3, 4),
    lifted=(4,),
    lifted_steps=1,
    largest_rival=3,
    starts=1,
    profiled=3,
)
KEYS = (
    "winding_step_over_mink_p50",
    "winding_step_p99_over_mink_p50",
    "robots_1_level_over_mink_p50",
    "robots_3_levels_active_over_mink_p50",
    "solve_over_gelsy_p50",
    "first_solve_s",
    "cpu",
    "versions",
)
#: Robots that mink asks for a turn, whose error it measures in the tangent at the target: ours to first order.
TURNING = ("arm on wheels",)
SHORT = 1e-3  # of the largest entry, where the way to the target is 1e-4 of the longest step

SAME = 1e-9  # of the largest entry: the same matrix, made by two programs
ITERATED = 5e-6  # [m] MuJoCo's iterative collision stops at 1e-6 m, and normals follow
DAMPED = 1e-3  # of the cost of not moving: what damping of 1e-12 leaves a QP solver


@pytest.fixture(scope="module")
def bench() -> Bench:
    return run(TINY, lambda *_: None)


@pytest.fixture(scope="module")
def told(bench: Bench) -> dict[str, Any]:
    return json.loads(json.dumps(figures(bench), allow_nan=False))


def call(*arguments: str) -> Result:
    group = CommandGroup(commands={"bench": command.bench})
    return CliRunner().invoke(group, ["bench", "--quick", *arguments])


@pytest.fixture
def measured(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> Bench:
    """What the command is handed in place of a run of its own."""
    monkeypatch.setattr("comparisons.bench.run.run", lambda *_: bench)
    return bench


# What it tells.


def test_the_json_holds_the_figures_to_watch(told: dict[str, Any]) -> None:
    assert set(KEYS) <= told.keys()
    for key in KEYS[:6]:
        assert told[key] is None or 0.0 < told[key] < math.inf, key
    assert {"mink", "mujoco", "numpy", "daqp"} <= told["versions"].keys()


def test_every_program_part_and_robot_is_told_of(told: dict[str, Any]) -> None:
    assert {OURS, "mink (daqp)", "mink (proxqp)", "dgelsy", "DAQP", "DAQP's hierarchy"} <= told["winding"][
        "programs"
    ].keys()
    assert told["winding"]["parts"].keys() == set(PARTS)
    assert told["robots"].keys() == ROBOTS.keys()
    assert len(ROBOTS) >= 5
    for robot in told["robots"].values():
        assert robot["levels"].keys() == {label(count) for count in ROBOT_LEVELS}
    assert told["growth"]["seconds"][WARM_TREE].keys() == {"3", "4"}
    assert all(call["peak"] is None or call["peak"] > 10.0 for call in told["first_calls"].values())
    assert told["profile"]["functions"]
    assert all(seconds > 0.0 for seconds in told["profile"]["floor"].values())


def test_the_tables_show_every_program_and_every_robot(bench: Bench) -> None:
    text = report.markdown(bench)
    for name in (*bench.windings.times.seconds, *ROBOTS):
        assert f"| {name} " in text, name


def test_the_path_by_which_steps_were_made_is_told(bench: Bench) -> None:
    assert sum(bench.windings.paths.values()) == bench.windings.steps
    assert all(path in " ".join(report.notes(bench)) for path in bench.windings.paths)


# That every step was proven.


def test_every_timed_step_came_with_a_certificate(told: dict[str, Any]) -> None:
    steps = len(TINY.weights) * (TINY.stretches * TINY.stretch + TINY.changes) * TINY.repeats
    assert told["winding"]["steps"] == told["winding"]["certificates"] == steps
    for robot in told["robots"].values():
        assert robot["certificates"] == robot["steps"] == TINY.repeats * TINY.tracks * TINY.track * len(ROBOT_LEVELS)


def test_a_step_without_certificate_would_be_counted_as_such() -> None:
    measured = winding.WindingTimes()
    step = winding.Loop(recorded("up").settings)(recorded("up").q[0], np.zeros(17, dtype=bool)).step
    winding._count(replace(step, certificate=None), measured)
    winding._count(step, measured)
    assert (measured.steps, measured.certificates) == (2, 1)


# That all were asked the same.


def test_rivals_that_answer_the_same_question_reach_the_same_cost(told: dict[str, Any]) -> None:
    for name in ("mink (daqp)", "mink (proxqp)", "DAQP", "DAQP's hierarchy"):
        assert abs(told["winding"]["gaps"][name]["max"]) <= DAMPED, name
    assert abs(told["winding"]["gaps"]["dgelsy"]["max"]) <= SAME
    for name, robot in told["robots"].items():
        gap = robot["gaps"]["mink (daqp)"]  # proxqp's default accuracy leaves it up to a tenth off on the same QPs
        assert gap["answered"] == gap["steps"]
        assert name in TURNING or abs(gap["max"]) <= DAMPED, name


def test_neighbours_that_are_installed_answer_the_same_question_without_contacts(told: dict[str, Any]) -> None:
    for name in neighbours.PACKAGES:
        found = [gap for program, gap in told["winding"]["gaps"].items() if program.startswith(name)]
        assert bool(found) is (importlib.util.find_spec(name) is not None), name
        assert all(gap["answered"] == gap["steps"] and abs(gap["max"]) <= DAMPED for gap in found), name


def box_and_rows(matrix: Array, upper: Array) -> tuple[Array, Array, list[Array]]:
    """Lower and upper bounds, and the rows of several joints with their sides behind them."""
    m = matrix.shape[1]
    low, high, rows = np.full(m, -np.inf), np.full(m, np.inf), []
    for row, side in zip(matrix, upper, strict=True):
        (joints,) = np.nonzero(row)
        if len(joints) == 1:
            joint = joints[0]
            end = side / row[joint]
            low[joint], high[joint] = (
                (low[joint], min(high[joint], end)) if row[joint] > 0 else (max(low[joint], end), high[joint])
            )
        elif len(joints) and np.isfinite(side):
            rows.append(np.append(row, side))
    return low, high, rows


def assert_the_same_question(ours: IKProblem, theirs: Any, same: float = SAME, contacts: float = SAME) -> None:
    (level,) = ours.levels
    hessian = level.matrix.T @ (level.weights[:, None] * level.matrix)
    assert theirs.P == pytest.approx(hessian, abs=same * np.abs(hessian).max())
    linear = -level.matrix.T @ (level.weights * level.target)
    assert theirs.q == pytest.approx(linear, abs=same * np.abs(hessian).max())
    fixed = ours.equalities
    hard = ours.inequalities
    given = np.vstack([hard.matrix, fixed.matrix, -fixed.matrix])
    low, high, rows = box_and_rows(given, np.concatenate([hard.upper, fixed.target, -fixed.target]))
    their_low, their_high, their_rows = box_and_rows(theirs.G, theirs.h)
    assert their_low == pytest.approx(low, abs=SAME)
    assert their_high == pytest.approx(high, abs=SAME)
    assert len(their_rows) == len(rows)
    for row in rows:
        assert min(np.abs(other - row).max() for other in their_rows) <= contacts


@pytest.mark.parametrize("step", [0, 60, 150, 250])
@pytest.mark.parametrize("wound", ["cylinder", "capsule"])
def test_mink_poses_the_same_qp_on_the_winding(wound: str, step: int, monkeypatch: pytest.MonkeyPatch) -> None:
    # To a capsule both take the distances of MuJoCo; to a cylinder mink does, and they are iterated.
    if wound == "capsule":
        episode, same = wind(WindingSettings(shape=wound, size=(0.07, 1.0))), SAME
    else:
        episode, same = recorded("up"), ITERATED
    problem, q = episode.problem(step), episode.q[step]
    posed = []

    def build(*given: Any, limits: Any) -> Array:
        configuration, tasks, dt, _ = given
        posed.append(mink.build_ik(configuration, tasks, dt, limits=limits))
        return np.zeros(len(q))

    monkeypatch.setattr(mink, "solve_ik", build)
    rival = Mink(episode.settings, "daqp")
    asked = rival.asked(problem, q)
    rival.ask(asked, q)()
    assert_the_same_question(asked, posed[0], contacts=same)
    with pytest.raises(AssertionError):
        assert_the_same_question(episode.problem(step + 1), posed[0], contacts=same)


@pytest.mark.parametrize("name", ROBOTS)
def test_mink_poses_the_same_qp_on_a_robot(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if name in TURNING:
        monkeypatch.setattr(goals, "REACH", (-4.0, -4.0))
    for seed in range(4):
        scene = ROBOTS[name].scene(seed)
        one = problem_of(ROBOTS[name], scene, 1)
        theirs = MinkOnRobot(name, scene, "daqp").qp(one, scene.now.qpos.copy())
        assert_the_same_question(one, theirs, same=SHORT if name in TURNING else SAME)


def test_a_rival_asked_another_problem_than_ours_is_found_out() -> None:
    problem = recorded("up").problem(60)
    winding._same(problem, problem)
    (level,) = problem.levels
    with pytest.raises(DifferentProblemError):
        winding._same(problem, problem.with_levels([replaced(level, weights=1.001 * level.weights)]))


def test_six_levels_are_the_rows_of_three() -> None:
    robot = ROBOTS["arm of 7 joints"]
    scene = robot.scene(0)
    three, six = problem_of(robot, scene, 3), problem_of(robot, scene, 6)
    assert len(six.levels) == 6
    one, other = (np.vstack([level.matrix for level in problem.levels]) for problem in (six, three))
    assert np.array_equal(one, other)
    assert len(problem_of(ROBOTS["humanoid"], ROBOTS["humanoid"].scene(0), 6).levels) == 6


def test_levels_in_one_keep_rows_targets_and_weights() -> None:
    levels = [Level([[1.0, 2.0]], [3.0], [4.0]), Level([[5.0, 6.0]], [7.0], [8.0])]
    (one,) = in_one_level(IKProblem(levels)).levels
    assert (one.matrix.tolist(), one.target.tolist(), one.weights.tolist()) == ([[1, 2], [5, 6]], [3, 7], [4, 8])


def test_dgelsy_answers_eqs_12_and_14() -> None:
    problem = IKProblem([Level([[1.0, 1.0, 0.0]], [2.0], [3.0])])
    assert Dgelsy(1e-4).ask(problem, np.zeros(3))() == pytest.approx([1.0, 1.0, 0.0])


def test_timed_stretches_lie_within_the_episode_and_some_follow_a_contact_change() -> None:
    episode = recorded("up")
    stretches = stretches_of(episode, TINY)
    assert all(0 < stretch.start and stretch.stop <= episode.steps for stretch in stretches)
    (after,) = (stretch.start for stretch in stretches if len(stretch) == 1)
    assert (episode.in_contact[after] != episode.in_contact[after - 1]).any()


def test_steps_after_a_contact_change_are_told_apart(told: dict[str, Any]) -> None:
    assert told["winding"]["kinds"][CHANGED]["steps"] >= len(TINY.weights) * TINY.changes


# The clock.


def test_programs_take_turns_at_being_the_first() -> None:
    assert ["".join(rotated("abc", turn)) for turn in range(4)] == ["abc", "bca", "cab", "abc"]


def test_what_is_timed_is_called_once_and_answers() -> None:
    calls: list[int] = []
    seconds, answer = timed(lambda: calls.append(1) or "answer")
    assert (len(calls), answer) == (1, "answer")
    assert seconds >= 0.0


def test_a_piece_of_work_counts_once_by_the_median_of_its_repeats() -> None:
    times = Times()
    for seconds in (1.0, 9.0, 2.0):
        times.add("ours", "first", seconds)
    times.add("ours", "second", 4.0)
    assert sorted(times.of("ours")) == [2.0, 4.0]
    assert times.of("ours", {"second"}).tolist() == [4.0]
    assert not len(times.of("theirs"))


def test_where_there_is_nothing_to_compare_there_is_no_ratio() -> None:
    assert quantile(np.array([]), 0.5) is None
    assert ratio(1.0, None) is ratio(None, 1.0) is None
    assert ratio(1.0, 4.0) == 0.25


# What was not there.


def test_a_neighbour_that_is_not_installed_is_named_and_how_to_get_it(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(neighbours, "PACKAGES", {"no_such_module": "no-such-package"})
    absent = neighbours.missing()
    assert absent == {"no_such_module": "pip install no-such-package"}
    without = replace(bench, missing=bench.missing | absent)
    for text in (report.markdown(without), json.dumps(absent)):
        assert "no_such_module" in text
        assert "pip install no-such-package" in text


def test_neighbours_that_are_not_installed_are_not_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    assert neighbours.missing().keys() == {"pink", "placo"}
    assert neighbours.neighbours(recorded("up").settings) == {}


def test_a_program_that_is_not_asked_for_longer_arms_is_named(bench: Bench) -> None:
    assert "mink (daqp) not asked beyond 3 links" in " ".join(report.notes(bench))


# The arm as URDF.


def place_by_urdf(text: str, q: dict[str, float], link: str) -> Array:
    """Where a link's origin is, from the URDF's own words alone."""
    joints = {joint.find("child").get("link"): joint for joint in ElementTree.fromstring(text).iter("joint")}
    point = np.zeros(3)
    while link in joints:
        joint = joints[link]
        origin, axis = joint.find("origin"), joint.find("axis")
        if axis is not None:
            point = rotation(numbers(axis.get("xyz")), q[joint.get("name")]) @ point
        roll, pitch, yaw = numbers(origin.get("rpy"))
        turned = rotation([0, 0, 1], yaw) @ rotation([0, 1, 0], pitch) @ rotation([1, 0, 0], roll)
        point = numbers(origin.get("xyz")) + turned @ point
        link = joint.find("parent").get("link")
    return point


def numbers(text: str) -> Array:
    return np.array([float(number) for number in text.split()])


def rotation(axis: Any, angle: float) -> Array:
    x, y, z = axis
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * skew + (1.0 - np.cos(angle)) * skew @ skew


TURNED = """<mujoco><compiler angle="radian"/><worldbody><body name="a" pos="0.1 0.2 0.3" euler="0.3 -0.5 0.7">
<joint name="turn" axis="0 0.6 0.8" limited="true" range="-1 1"/><geom size="0.1"/>
<body name="b" pos="0 0.4 0" euler="-0.2 0.1 0.9"><geom size="0.1"/>
<site name="end" pos="0.1 0 0.2"/></body></body></worldbody></mujoco>"""


@pytest.mark.parametrize("model", [Arm(links=4).spec().compile(), mujoco.MjModel.from_xml_string(TURNED)])
def test_the_urdf_says_where_the_sites_are(model: mujoco.MjModel) -> None:
    data = mujoco.MjData(model)
    data.qpos[:] = np.random.default_rng(0).uniform(-1.0, 1.0, model.nq)
    mujoco.mj_kinematics(model, data)
    q = {model.joint(j).name: float(data.qpos[j]) for j in range(model.njnt)}
    for site in range(model.nsite):
        assert place_by_urdf(urdf(model, 1.0), q, model.site(site).name) == pytest.approx(data.site_xpos[site], abs=1e-14)


def test_a_model_with_a_ball_joint_has_no_urdf() -> None:
    text = (
        '<mujoco><worldbody><body name="a"><joint name="ball" type="ball"/><geom size="0.1"/></body></worldbody></mujoco>'
    )
    with pytest.raises(ModelError, match="ball"):
        urdf(mujoco.MjModel.from_xml_string(text), 1.0)


# The command.


def test_the_command_writes_whole_files_and_prints_the_ratios_first(measured: Bench, tmp_path: Path) -> None:
    files = {name: tmp_path / name for name in ("bench.json", "bench.md", "bench.png")}
    arguments = zip(("--json", "--markdown", "--plot"), map(str, files.values()), strict=True)
    result = call(*(word for pair in arguments for word in pair))
    assert result.exit_code == 0, result.output
    assert result.output.startswith("Ratios to watch")
    assert json.loads(files["bench.json"].read_text(encoding="utf-8"))["cpu"]
    assert files["bench.md"].read_text(encoding="utf-8") == report.markdown(measured)
    assert files["bench.png"].read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(files)


def test_a_write_that_fails_leaves_the_old_file(measured: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "bench.md"
    file.write_text("old", encoding="utf-8")

    def full(self: Path, other: Path) -> None:
        raise OSError("no space left")

    monkeypatch.setattr(Path, "replace", full)
    result = call("--markdown", str(file))
    assert (result.exit_code, result.output.count("\n")) == (2, 1)
    assert "no space left" in result.output
    assert [path.read_text(encoding="utf-8") for path in tmp_path.iterdir()] == ["old"]


@pytest.mark.parametrize("option", ["--json", "--markdown", "--plot"])
def test_a_place_that_cannot_be_written_is_refused_before_anything_is_measured(
    option: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("comparisons.bench.run.run", lambda *_: pytest.fail("measured"))
    result = call(option, str(tmp_path / "nowhere" / "bench.png"))
    assert (result.exit_code, result.output.count("\n")) == (2, 1)
    assert "nowhere" in result.output


def test_a_plot_of_an_unknown_kind_is_refused_with_the_kinds_there_are(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("comparisons.bench.run.run", lambda *_: pytest.fail("measured"))
    result = call("--plot", "bench.xyz")
    assert (result.exit_code, result.output.count("\n")) == (2, 1)
    assert "png, svg, pdf" in result.output


def test_the_quick_bench_is_a_part_of_the_whole_one() -> None:
    quick, whole = BenchSettings.quick(), BenchSettings()
    assert set(quick.directions) <= set(whole.directions)
    assert set(quick.links) <= set(whole.links)
    for name in ("stretches", "stretch", "changes", "repeats", "tracks", "track", "starts", "profiled"):
        assert getattr(quick, name) <= getattr(whole, name)


def test_the_command_is_registered() -> None:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert '\nbench = "comparisons.bench.command:bench"\n' in text


def test_the_recorded_episode_is_what_rivals_are_asked_of() -> None:
    episode: Episode = recorded("up")
    ours = winding.Loop(episode.settings)(episode.q[60], episode.in_contact[59])
    theirs = episode.problem(60)
    for level, same in zip(ours.posed.levels, theirs.levels, strict=True):
        assert level.matrix.tobytes() == same.matrix.tobytes()
        assert level.target.tobytes() == same.target.tobytes()
    winding._same(ours.posed, theirs)
    with pytest.raises(winding.DifferentProblemError, match="another problem"):
        winding._same(ours.posed, episode.problem(61))
