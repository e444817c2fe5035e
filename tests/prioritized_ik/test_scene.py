"""A task file poses what its classes pose by hand; its run keeps what it says; and what is wrong in it is one message."""

import json
import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from repository import ROOT

import comparisons
import prioritized_ik as pik
from prioritized_ik.cli import main
from prioritized_ik.guard import Limit
from prioritized_ik.problem import IKProblem
from prioritized_ik.scene.entries import LIMITS, TASKS, arguments_of
from prioritized_ik.scene.task_file import KEYS
from prioritized_ik.solvers import registry
from prioritized_ik.solvers.methods import Method
from prioritized_ik.solvers.step import JointStep, StepStatus
from prioritized_ik.tasks.task import Task

START = [0.3, 0.5, 0.2, 1.2, 0.1, 0.6, 0.0]
HAND = {"kind": "position", "site": "tool", "target": [0.55, 0.2, 0.3]}
SCENE = {"example": "arm", "q": START, "duration": 0.5, "task": [HAND]}
EXAMPLES = sorted((ROOT / "examples" / "scenes").glob("*.toml"))


def toml(value: Any) -> str:
    """A value as TOML writes it: what JSON has, but for tables and for numbers that are not finite."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml(item) for item in value) + "]"
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value)


def written(folder: Path, content: dict[str, Any]) -> Path:
    file = folder / "task.toml"
    file.write_text("\n".join(f"{json.dumps(key)} = {toml(value)}" for key, value in content.items()), encoding="utf-8")
    return file


def loaded(folder: Path, **changes: Any) -> pik.Scene:
    content = {key: value for key, value in {**SCENE, **changes}.items() if value is not None}
    return pik.load_scene(written(folder, content))


def solve(*arguments: str | Path) -> Any:
    return CliRunner().invoke(main, ["solve", *map(str, arguments)])


def numbers(problem: IKProblem) -> list[Any]:
    """Everything of a problem that a step depends on."""
    levels = [(level.matrix, level.target, level.weights, level.damping, level.below) for level in problem.levels]
    return [*levels, (problem.bounds.lower, problem.bounds.upper), (problem.rows.matrix, problem.rows.upper)]


def same(one: IKProblem, other: IKProblem) -> bool:
    pairs = zip(numbers(one), numbers(other), strict=True)
    return all(np.array_equal(a, b) for ones, others in pairs for a, b in zip(ones, others, strict=True))


# What a file says of every kind, and the same by hand.
BY_HAND: dict[str, tuple[dict[str, Any], Any]] = {
    "position": ({"site": "tool", "target": [0.5, 0.1, 0.4]}, lambda r: pik.Position(r, [0.5, 0.1, 0.4], site="tool")),
    "orientation": (
        {"body": "wrist", "target": [1.0, 0.0, 0.2, 0.0], "gain": 0.5, "root": {"body": "shoulder"}},
        lambda r: pik.Orientation(r, [1.0, 0.0, 0.2, 0.0], body="wrist", gain=0.5, root=r.frame(body="shoulder")),
    ),
    "pose": (
        {"geom": "hand", "target": np.eye(4).tolist(), "weights": [1, 1, 1, 0.1, 0.1, 0]},
        lambda r: pik.Pose(r, np.eye(4), geom="hand", weights=[1, 1, 1, 0.1, 0.1, 0]),
    ),
    "axis": (
        {"site": "tool", "target": [0, 0, -1], "axis": [1, 0, 0]},
        lambda r: pik.Axis(r, [0, 0, -1], axis=[1, 0, 0], site="tool"),
    ),
    "look-at": ({"site": "tool", "target": [1, 1, 0]}, lambda r: pik.LookAt(r, [1, 1, 0], site="tool")),
    "centre-of-mass": ({"weights": [1, 1, 0]}, lambda r: pik.CentreOfMass(r, weights=[1, 1, 0])),
    "posture": ({"target": [0.0] * 7, "gain": 0.1}, lambda r: pik.Posture(r, np.zeros(7), gain=0.1)),
    "damping": ({"weights": {"elbow": 2.0}}, lambda r: pik.Damping(r, {"elbow": 2.0})),
    "virtual-arms": (
        {"arms": {"points": ["tool"], "axes": "xz"}, "target": [[0.5, 0.4]]},
        lambda r: pik.VirtualArmsTask(r, pik.VirtualArms(r.model, ["tool"], "xz"), [[0.5, 0.4]]),
    ),
    "joint-coupling": (
        {"coefficients": {"elbow": 1.0, "wrist": -2.0}, "target": 0.1},
        lambda r: pik.JointCoupling(r, {"elbow": 1.0, "wrist": -2.0}, 0.1),
    ),
}
#: Frames that make a triangle, seen from above, if no robot would stand on them.
FEET = [{"body": "wrist"}, {"body": "shoulder"}, {"site": "tool"}]
LIMITS_BY_HAND: dict[str, tuple[dict[str, Any], Any]] = {
    "joint-range": ({"margin": 0.05, "outside": "hold"}, lambda r: pik.JointRange(r, margin=0.05, outside="hold")),
    "velocity": ({"fastest": {"elbow": 1.0}}, lambda r: pik.Velocity(r, {"elbow": 1.0})),
    "acceleration": ({"greatest": 30.0}, lambda r: pik.Acceleration(r, 30.0)),
    "support-polygon": (
        {"points": FEET, "outside": "hold"},
        lambda r: pik.SupportPolygon(r, [r.frame(**foot) for foot in FEET], outside="hold"),
    ),
    "collision": (
        {"pairs": [["hand", "post"], ["hand", "table"]], "margin": 1.0},
        lambda r: pik.Collision(r, [("hand", "post"), ("hand", "table")], margin=1.0),
    ),
}


def test_every_task_and_limit_of_the_package_has_a_kind() -> None:
    public = [getattr(pik, name) for name in pik.__all__ if isinstance(getattr(pik, name), type)]
    assert {kind for kind in public if issubclass(kind, Task) and kind is not Task} <= set(TASKS.values())
    assert {kind for kind in public if issubclass(kind, Limit) and kind is not Limit} <= set(LIMITS.values())


def test_a_closed_loop_of_the_model_stays_closed(tmp_path: Path) -> None:
    file = Path(comparisons.__file__).parent / "data" / "robots" / "four_bar.xml"
    robot = pik.Robot(file)
    turned = robot.q + 0.3 * np.eye(robot.model.nq)[0]
    scene = {"example": None, "q": None, "model": str(file), "task": [{"kind": "posture", "target": turned.tolist()}]}
    for limits, closed in (([{"kind": "model-equalities"}], True), ([], False)):
        run = loaded(tmp_path, **scene, limit=limits).run()
        robot.update(run.q[-1])
        assert (max(pik.ModelEqualities(robot).drift(robot).values()) < 1e-6) == closed
        assert abs(run.q[-1, 0] - run.q[0, 0]) > 0.05


def test_every_kind_is_in_the_documentation() -> None:
    page = (ROOT / "docs" / "own-robots.md").read_text(encoding="utf-8")
    assert [kind for kind in (*TASKS, *LIMITS) if f"`{kind}`" not in page] == []


@settings(max_examples=60, derandomize=True, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    kinds=st.lists(st.tuples(st.sampled_from(sorted(BY_HAND)), st.integers(1, 4)), min_size=1, max_size=5),
    limits=st.lists(st.sampled_from(sorted(LIMITS_BY_HAND)), max_size=3, unique=True),
)
def test_a_task_file_poses_the_problem_that_its_classes_pose_by_hand(
    tmp_path: Path, kinds: list[tuple[str, int]], limits: list[str]
) -> None:
    tasks = [{"kind": kind, "level": level, **BY_HAND[kind][0]} for kind, level in kinds]
    scene = loaded(
        tmp_path, task=tasks, limit=[{"kind": kind, **LIMITS_BY_HAND[kind][0]} for kind in limits], duration=0.01
    )
    robot = pik.example("arm", START)
    levels = [[BY_HAND[kind][1](robot) for kind, at in kinds if at == level] for level in (1, 2, 3, 4)]
    by_hand = pik.solve_step(
        robot, [level for level in levels if level], [LIMITS_BY_HAND[kind][1](robot) for kind in limits], dt=0.01
    )
    (step,) = scene.steps()
    assert same(step.problem, by_hand.problem)


@pytest.mark.parametrize("kind", sorted(BY_HAND.keys() - {"damping"}))
def test_the_comparison_with_problems_by_hand_sees_a_gain_that_is_off_by_a_thousandth(tmp_path: Path, kind: str) -> None:
    arguments, made = BY_HAND[kind]
    scene = loaded(tmp_path, task=[{"kind": kind, **arguments, "gain": 0.999 * arguments.get("gain", 1.0)}], duration=0.01)
    robot = pik.example("arm", START)
    robot_at_rest = kind == "centre-of-mass"  # its error is zero, and so is any part of it
    (step,) = scene.steps()
    assert same(step.problem, pik.solve_step(robot, [made(robot)], dt=0.01).problem) == robot_at_rest


def test_a_run_ends_where_forward_kinematics_say_and_keeps_its_limits(tmp_path: Path) -> None:
    limits = [{"kind": "joint-range"}, {"kind": "velocity", "fastest": 2.0}]
    run = loaded(tmp_path, limit=limits).run()
    model = run.scene.model
    data = mujoco.MjData(model)
    data.qpos[:] = run.q[-1]
    mujoco.mj_forward(model, data)
    assert run.ending is pik.Ending.REACHED
    assert data.site("tool").xpos == pytest.approx([0.55, 0.2, 0.3], abs=run.scene.tolerance)
    assert run.errors == {"position of tool": pytest.approx(np.linalg.norm(data.site("tool").xpos - [0.55, 0.2, 0.3]))}
    assert np.abs(np.diff(run.q, axis=0)).max() <= 2.0 * 0.01 * (1.0 + 1e-9)
    assert (run.q >= model.jnt_range[:, 0]).all()
    assert (run.q <= model.jnt_range[:, 1]).all()
    assert sum(run.statuses.values()) == 50 == len(run.steps)


def test_a_scene_runs_to_the_same_bits_each_time_and_when_pickled(tmp_path: Path) -> None:
    way = {"kind": "position", "site": "tool", "times": [0.0, 0.3], "targets": [[0.5, 0.0, 0.4], [0.4, 0.0, 0.5]]}
    scene = loaded(tmp_path, task=[way, {"kind": "posture", "level": 2}])
    once = scene.run().q
    assert np.array_equal(once, scene.run().q)
    assert np.array_equal(once, pickle.loads(pickle.dumps(scene)).run().q)
    assert np.array_equal(scene.q, START)


@pytest.mark.parametrize(
    ("name", "solver"),
    [
        ("humanoid", "daqp"),
        ("humanoid", "quadprog"),
        ("humanoid", "proxqp"),
        ("reach", "clarabel"),  # whose steps end where two bounds and two levels leave almost nothing
        ("reach", "daqp-hierarchy"),
    ],
)
def test_every_solver_moves_the_robot_alike(name: str, solver: str) -> None:
    scene = pik.load_scene(EXAMPLES[0].with_stem(name))
    assert scene.run(solver).q == pytest.approx(scene.run().q, abs=1e-9)


def moving(folder: Path, task: dict[str, Any], times: list[float], targets: list[Any]) -> Any:
    """What a task's target is over time, in milliseconds."""
    scene = loaded(folder, task=[{**task, "times": times, "targets": targets}])
    (aimed,) = scene.staged().aimed

    def at(milliseconds: int) -> Any:
        aimed.aim(1e-3 * milliseconds)
        return aimed.task.target  # type: ignore[attr-defined]

    return at


def test_a_target_moves_evenly_between_way_points_and_rests_before_and_after(tmp_path: Path) -> None:
    points = [[0.5, 0.0, 0.4], [0.5, 0.2, 0.4], [0.3, 0.2, 0.4]]
    at = moving(tmp_path, {"kind": "position", "site": "tool"}, [0.1, 0.3, 0.4], points)
    assert at(0).tolist() == at(100).tolist() == points[0]
    assert at(200) == pytest.approx([0.5, 0.1, 0.4])
    assert at(250) == pytest.approx([0.5, 0.15, 0.4])
    assert at(300).tolist() == points[1]
    assert at(350) == pytest.approx([0.4, 0.2, 0.4])
    assert at(400).tolist() == at(900).tolist() == points[2]


def test_a_rotation_between_way_points_turns_evenly_about_one_axis(tmp_path: Path) -> None:
    quaternions = [[1.0, 0.0, 0.0, 0.0], [0.5**0.5, 0.0, 0.5**0.5, 0.0]]  # a right angle about y
    at = moving(tmp_path, {"kind": "orientation", "site": "tool"}, [0.0, 0.9], quaternions)
    for degrees in (0, 10, 45, 89, 90):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        assert at(10 * degrees) == pytest.approx(np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]), abs=1e-12)


def test_the_robot_follows_a_moving_target_step_by_step(tmp_path: Path) -> None:
    start = pik.example("arm", START)
    here = start.position(start.frame(site="tool"))
    there = here + np.array([0.0, 0.1, 0.0])
    task = {"kind": "position", "site": "tool", "times": [0.0, 0.5], "targets": [here.tolist(), there.tolist()]}
    run = loaded(tmp_path, task=[task]).run()
    assert max(run.largest_errors.values()) < 1e-4  # the curvature of steps of 2 mm
    assert np.diff([step.time for step in run.steps]) == pytest.approx(0.01)


def test_a_scene_without_a_way_to_its_target_says_whether_reach_or_limits_are_short(tmp_path: Path) -> None:
    far = {**HAND, "target": [2.0, 0.0, 0.5]}
    assert loaded(tmp_path, task=[far], duration=10.0).run().ending is pik.Ending.OUT_OF_REACH
    bent = {"kind": "posture", "target": [0.3, 0.5, 0.2, -0.4, 0.1, 0.6, 0.0]}
    run = loaded(tmp_path, task=[bent], limit=[{"kind": "joint-range"}]).run()
    assert (run.ending, run.held_by) == (pik.Ending.STUCK, ("elbow lower",))
    assert "held back by elbow lower" in run.told()
    assert loaded(tmp_path, limit=[{"kind": "velocity", "fastest": 0.1}]).run().ending is pik.Ending.OUT_OF_STEPS


class Failing(Method):
    """Gives no step from the third on."""

    name, version = "failing", "1"

    def __init__(self, accuracy: float) -> None:
        self._inner, self._calls = pik.get_method("active-set", accuracy), 0

    def step(self, *arguments: Any) -> JointStep:
        self._calls += 1
        if self._calls > 2:
            return JointStep(None, StepStatus.NOT_FOUND, "no more")
        return self._inner.step(*arguments)


@pytest.fixture
def failing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_added", {})
    registry.register("failing", Failing)


@pytest.mark.usefixtures("failing")
def test_a_solver_that_gives_up_ends_the_run_where_it_is(tmp_path: Path) -> None:
    scene = loaded(tmp_path)
    run = scene.run("failing")
    assert run.ending is pik.Ending.SOLVER_FAILED
    assert np.array_equal(run.q[-1], run.q[-2])
    assert np.array_equal(run.q[:3], scene.run().q[:3])
    assert run.statuses["NOT_FOUND"] == 1
    result = solve(tmp_path / "task.toml", "--solver", "failing")
    assert result.exit_code == 1
    assert "SOLVER_FAILED" in result.output
    assert "no more" in result.output


def test_two_tasks_of_one_frame_are_told_apart(tmp_path: Path) -> None:
    tasks = [{"kind": "axis", "site": "tool", "target": [0, 0, -1], "axis": axis} for axis in ([0, 0, 1], [1, 0, 0])]
    assert list(loaded(tmp_path, task=tasks).run().errors) == ["axis of tool", "axis of tool (2)"]


def test_a_keyframe_is_a_start(tmp_path: Path) -> None:
    (tmp_path / "robot.xml").write_text(
        '<mujoco><worldbody><body><joint name="turn"/><geom size="0.1"/><site name="tip" pos="1 0 0"/></body></worldbody>'
        '<keyframe><key name="home" qpos="0.7"/></keyframe></mujoco>'
    )
    task = {"kind": "position", "site": "tip"}
    scene = loaded(tmp_path, example=None, q=None, model="robot.xml", keyframe="home", task=[task])
    assert scene.q.tolist() == [0.7]
    with pytest.raises(pik.InputError, match=r"task\.toml: there is no keyframe 'hom'; the model has 1 keyframe: home"):
        loaded(tmp_path, example=None, q=None, model="robot.xml", keyframe="hom", task=[task])
    with pytest.raises(pik.InputError, match="q and keyframe are both given"):
        loaded(tmp_path, example=None, q=[0.1], model="robot.xml", keyframe="home", task=[task])


def test_joints_start_where_they_are_said_to_by_name(tmp_path: Path) -> None:
    changed = loaded(tmp_path, joints={"elbow": 0.8, "base": -0.1}).q
    assert changed.tolist() == [-0.1, 0.5, 0.2, 0.8, 0.1, 0.6, 0.0]
    standing = {"example": "humanoid", "q": None, "task": [{"kind": "posture"}]}
    bent = loaded(tmp_path, **standing, joints={"left knee": 0.8})
    assert bent.q[bent.model.joint("left knee").qposadr[0]] == 0.8
    assert np.count_nonzero(bent.q != bent.model.qpos0) == 1
    with pytest.raises(pik.InputError, match="joint 'float' is a ball or free joint"):
        loaded(tmp_path, **standing, joints={"float": 0.8})


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "unknown key": ({"durations": 1.0}, r"unknown key 'durations'; expected some of: duration, "),
    "unknown kind": ({"task": [{"kind": "positions"}]}, "task 1: unknown kind 'positions'; choose one of: position, "),
    "no kind": ({"task": [{"site": "tool"}]}, "task 1: there is no kind; choose one of"),
    "unknown key of a task": ({"task": [{**HAND, "gains": 1}]}, "task 1: unknown key 'gains'; expected some of: gain, "),
    "the robot is no key": ({"task": [{**HAND, "robot": 1}]}, "task 1: unknown key 'robot'"),
    "unknown limit": ({"limit": [{"kind": "speed"}]}, "limit 1: unknown kind 'speed'"),
    "unknown key of a limit": ({"limit": [{"kind": "velocity", "fast": 1}]}, "limit 1: unknown key 'fast'; .*: fastest, "),
    "a limit's own argument missing": ({"limit": [{"kind": "velocity"}]}, "limit 1: there is no fastest"),
    "a task's own argument missing": ({"task": [{"kind": "axis", "site": "tool"}]}, "task 1: there is no target"),
    "no task": ({"task": []}, "expected at least one"),
    "no tasks at all": ({"task": None}, r"there is no task; expected \[\[task\]\]"),
    "task is no table": ({"task": [3]}, r"task is \[3\]; expected tables"),
    "no duration": ({"duration": None}, "there is no duration"),
    "no frame": ({"task": [{"kind": "position"}]}, "task 1, position: 0 frames were given"),
    "root that is no table": ({"task": [{**HAND, "root": "base"}]}, "root: expected a table with some of: body, site"),
    "root of another key": ({"task": [{**HAND, "root": {"bdy": 1}}]}, "root: unknown key 'bdy'; expected some of: body"),
    "root that does not exist": ({"task": [{**HAND, "root": {"body": "bas"}}]}, "root: there is no body 'bas'"),
    "arms of no point": ({"task": [{"kind": "virtual-arms", "arms": {"points": []}}]}, r"arms: points is \[\]"),
    "arms without points": ({"task": [{"kind": "virtual-arms", "arms": {}}]}, "arms: there is no points"),
    "feet that are no list": ({"limit": [{"kind": "support-polygon", "points": 3}]}, "points: expected a list of tables"),
    "a foot that does not exist": (
        {"limit": [{"kind": "support-polygon", "points": [{"body": "foot"}]}]},
        "limit 1, support-polygon: points: there is no body 'foot'",
    ),
    "frame that does not exist": (
        {"task": [HAND, {**HAND, "site": "tol"}]},
        "task 2, position: there is no site 'tol'; the model has 1 site: tool; 7 joints: .*; 8 bodies: .*; 9 geoms: ",
    ),
    "target in the plane": ({"task": [{**HAND, "target": [0, 0]}]}, r"task 1, position: .* shape \(2,\); expected \(3,\)"),
    "way point in the plane": (
        {"task": [{"kind": "position", "site": "tool", "times": [0, 1], "targets": [[0, 0, 1], [0, 1]]}]},
        r"task 1, position: targets\[1\]: target of position of tool has shape \(2,\)",
    ),
    "times that fall": ({"task": [{"kind": "posture", "times": [1, 0], "targets": [START] * 2}]}, "seconds that rise"),
    "times alone": ({"task": [{"kind": "posture", "times": [1]}]}, "times has 1 and targets 0 entries"),
    "time below zero": ({"task": [{"kind": "posture", "times": [-1], "targets": [START]}]}, r"times\[0\] is -1"),
    "target and targets": ({"task": [{**HAND, "times": [0], "targets": [[0, 0, 1]]}]}, "target and targets are both given"),
    "level zero": ({"task": [{**HAND, "level": 0}]}, "task 1: level is 0"),
    "dt": ({"dt": 0}, "dt is 0; expected a finite number above 0"),
    "duration shorter than a step": ({"duration": 0.001}, "expected at least one step"),
    "start of no joint": ({"joints": {"knee": 1.0}}, "there is no joint 'knee'"),
    "start that is no number": ({"joints": {"elbow": "bent"}}, "start of elbow is not an array of numbers"),
    "starts that are no table": ({"joints": [1.0]}, r"joints is \[1.0\]; expected a table"),
    "q of nv and more": ({"q": [0.0] * 8}, r"q has shape \(8,\); .* nq = 7 positions and nv = 7"),
    "ragged q": ({"q": [[0], [0, 1]]}, "q is not an array"),
    "joint that does not exist": (
        {"limit": [{"kind": "velocity", "fastest": {"knee": 1}}]},
        "limit 1, velocity: there is no joint 'knee'",
    ),
    "unknown solver": ({"solver": "daqq"}, "unknown solver 'daqq'"),
    "unknown example": ({"example": "dog"}, "unknown example 'dog'; choose one of: arm, humanoid"),
    "no model": ({"example": None}, "no model given; expected either model, a file"),
    "model and example": ({"model": "a.xml"}, "model and example given"),
    "model that is not there": ({"example": None, "model": "a.xml"}, r"there is no file '.*a\.xml'"),
    "number as text": ({"tolerance": "small"}, "tolerance is 'small'"),
}  # fmt: skip


@pytest.mark.parametrize(("changes", "message"), BAD.values(), ids=BAD.keys())
def test_bad_input_is_one_clear_message_that_names_the_file(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises((pik.InputError, pik.SolverUnavailableError), match=message) as caught:
        loaded(tmp_path, **changes)
    assert str(caught.value).startswith("task.toml: ")
    assert "\n" not in str(caught.value)


def test_a_file_that_is_no_task_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(pik.InputError, match="there is no file"):
        pik.load_scene(tmp_path / "none.toml")
    (tmp_path / "text.toml").write_text("no = = toml")
    with pytest.raises(pik.InputError, match=r"text\.toml is not TOML"):
        pik.load_scene(tmp_path / "text.toml")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(pik.InputError, match=r"bytes\.toml is not TOML"):
        pik.load_scene(tmp_path / "bytes.toml")


def test_a_urdf_of_package_paths_is_refused_in_a_task_file_too(tmp_path: Path) -> None:
    (tmp_path / "robot.urdf").write_text(
        '<robot name="r"><link name="a"><visual><mesh filename="package://a"/></visual></link></robot>'
    )
    with pytest.raises(pik.InputError, match="package:// paths"):
        loaded(tmp_path, example=None, model="robot.urdf")


#: Whatever TOML can hold.
ANYTHING = st.recursive(
    st.booleans()
    | st.integers()
    | st.floats()
    | st.text(st.characters(codec="ascii", exclude_categories=("C",)), max_size=5)
    | st.sampled_from([0, 1, 0.5, [0, 0, 1], START, [[0, 0, 1]] * 2, "tool", {"elbow": 1.0}, [["hand", "post"]], 10**400]),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from("ab"), inner, max_size=2),
    max_leaves=6,
)


def places() -> Iterator[tuple[str, str]]:
    for table, kinds in (("task", TASKS), ("limit", LIMITS)):
        for kind, made in kinds.items():
            keys = ["kind", *arguments_of(made), *(["level", "times", "targets"] if table == "task" else [])]
            yield from ((f"{table} {kind}", key) for key in keys)
    yield from (("", key) for key in KEYS)


@settings(max_examples=400, derandomize=True, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.sampled_from(list(places())), value=ANYTHING)
def test_whatever_stands_at_a_key_the_file_loads_or_is_one_message(
    tmp_path: Path, place: tuple[str, str], value: Any
) -> None:
    where, key = place
    table, _, kind = where.partition(" ")
    known = {
        **{name: entry[0] for name, entry in BY_HAND.items()},
        **{name: entry[0] for name, entry in LIMITS_BY_HAND.items()},
    }
    changes = {table: [{"kind": kind, **known.get(kind, {}), key: value}]} if table else {key: value}
    scene, message = None, ""
    try:
        scene = loaded(tmp_path, **changes)
    except (pik.InputError, pik.SolverUnavailableError) as error:
        message = str(error)
    assert message.strip() if scene is None else scene.q.shape == (scene.model.nq,)


def test_a_urdf_reaches_with_a_tool_that_is_fixed_to_its_last_link(tmp_path: Path) -> None:
    def link(name: str) -> str:
        inertial = '<mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/>'
        shape = '<collision><geometry><cylinder radius="0.02" length="0.3"/></geometry></collision>'
        return f'<link name="{name}"><inertial>{inertial}</inertial>{shape}</link>'

    def joint(kind: str, parent: str, child: str) -> str:
        limit = '<limit lower="-2" upper="2" effort="1" velocity="1"/>' if kind == "revolute" else ""
        return (
            f'<joint name="{parent} to {child}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="0.3 0 0"/><axis xyz="0 1 0"/>{limit}</joint>'
        )

    chain = ["base", "upper", "lower", "hand", "tool"]
    kinds = ["revolute", "revolute", "revolute", "fixed"]
    joints = "".join(joint(kind, one, other) for kind, one, other in zip(kinds, chain, chain[1:], strict=False))
    (tmp_path / "robot.urdf").write_text(f'<robot name="r">{"".join(map(link, chain))}{joints}</robot>')
    task = {"kind": "position", "body": "tool", "target": [0.9, 0.0, -0.5]}
    scene = loaded(
        tmp_path,
        example=None,
        q=None,
        model="robot.urdf",
        joints={"base to upper": 0.3, "upper to lower": 0.3},
        duration=1.0,
        task=[task],
        limit=[{"kind": "joint-range"}],
    )
    run = scene.run()
    assert run.ending is pik.Ending.REACHED
    data = mujoco.MjData(scene.model)
    data.qpos[:] = run.q[-1]
    mujoco.mj_forward(scene.model, data)
    hand = data.body("hand")
    assert hand.xpos + hand.xmat.reshape(3, 3)[:, 0] * 0.3 == pytest.approx(task["target"], abs=1e-4)


@pytest.mark.parametrize("file", EXAMPLES, ids=lambda file: file.stem)
def test_the_example_scenes_run_and_end_as_their_first_line_says(file: Path) -> None:
    result = solve(file)
    assert result.exit_code == 0, result.output
    assert "REACHED" in result.output
    assert set(pik.load_scene(file).run().statuses) <= {"CLOSED_FORM", "SOLVED"}, "every step is proven"


def test_solve_writes_what_it_shows_and_ends_with_one_where_the_tasks_are_not_met(tmp_path: Path) -> None:
    file = written(tmp_path, {**SCENE, "task": [HAND, {**HAND, "level": 2, "target": [0.5, 0.0, 0.4]}]})
    result = solve(file, "--json", tmp_path / "out.json", "--solver", "daqp")
    assert result.exit_code == 0, result.output
    assert "gave way by" in result.output
    content = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))
    run = pik.load_scene(file).run("daqp")
    assert content == json.loads(json.dumps(run.to_json()))
    assert content["gave_way"][0]["level"] == "position of tool (2)"
    assert np.array_equal(content["positions"], run.q)
    written(tmp_path, {**SCENE, "task": [{**HAND, "target": [2.0, 0.0, 0.5]}]})
    assert solve(file).exit_code == 1


def test_solve_takes_another_model_and_says_in_one_line_what_is_wrong(tmp_path: Path) -> None:
    (tmp_path / "other.xml").write_text(
        '<mujoco><worldbody><body><joint/><geom size="0.1"/><site name="tool" pos="1 0 0"/></body></worldbody></mujoco>'
    )
    file = written(tmp_path, {"example": "arm", "duration": 0.1, "task": [{"kind": "position", "site": "tool"}]})
    assert solve(file, "--scene", tmp_path / "other.xml").exit_code == 0
    assert len(pik.load_scene(file, tmp_path / "other.xml").q) == 1
    result = solve(file, "--scene", tmp_path / "none.xml")
    assert result.exit_code == 2
    assert result.output.count("\n") == 1
    assert solve(tmp_path / "none.toml").exit_code == 2
    assert solve(file, "--json", "").exit_code == 2
