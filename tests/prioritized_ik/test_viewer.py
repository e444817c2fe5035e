"""Pictures, films and the live view: what is drawn and said is where the robot is, and what its step reports."""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import mujoco
import numpy as np
import pytest
from arms import bent_arm
from click.testing import CliRunner
from PIL import Image, ImageSequence
from repository import ROOT

import prioritized_ik as pik
from prioritized_ik.cli import main
from prioritized_ik.errors import InputError
from prioritized_ik.viewer import Camera, Film, View, picture
from prioritized_ik.viewer.marks import FREE, HOLDING, MET, UNMET, marks_of
from prioritized_ik.viewer.panel import lines_of
from prioritized_ik.viewer.window import Window

DT = 0.05  # [s]
SMALL = (160, 120)  # [pixels]


def green(drawn: np.ndarray) -> np.ndarray:
    """Where a picture has the colour of targets that are met."""
    red, green, blue = np.moveaxis(drawn.astype(int), 2, 0)
    return (green > red + 60) & (green > blue + 40)


def test_a_target_is_marked_where_it_is_and_joined_to_the_frame_that_is_not_there() -> None:
    robot = bent_arm()
    here = robot.position(robot.frame(site="tool"))
    task = pik.Position(robot, here, site="tool")
    (ball,) = marks_of(robot, [task])
    assert ball.colour == MET
    np.testing.assert_array_equal(ball.start, here)
    task.target = here + np.array([0.1, 0.0, 0.0])
    ball, line = marks_of(robot, [task])
    assert ball.colour == line.colour == UNMET
    np.testing.assert_array_equal([ball.start, line.start, line.end], [task.target, here, task.target])


def test_every_kind_of_task_with_a_place_in_the_world_is_marked() -> None:
    robot = bent_arm()
    tasks = [
        pik.Position(robot, site="tool"), pik.Pose(robot, site="tool"), pik.Orientation(robot, site="tool"),
        pik.Axis(robot, [0, 0, 1], site="tool"), pik.LookAt(robot, [1, 0, 0], site="tool"), pik.CentreOfMass(robot),
    ]  # fmt: skip
    assert all(marks_of(robot, [task]) for task in tasks)
    assert marks_of(robot, [pik.Posture(robot)]) == []


def test_a_centre_of_mass_that_is_free_to_rise_is_marked_at_its_own_height() -> None:
    robot = bent_arm()
    mass = pik.CentreOfMass(robot, [0.1, 0.2, 9.0], weights=[1, 1, 0])
    ball = marks_of(robot, [mass])[0]
    np.testing.assert_array_equal(ball.start, [0.1, 0.2, robot.data.subtree_com[0, 2]])


def test_geoms_near_each_other_are_joined_in_the_colour_of_what_holds() -> None:
    robot = bent_arm()
    limit = pik.Collision(robot, [("hand", "table")], margin=2.0)
    (line,) = marks_of(robot, [], [limit])
    length = float(np.linalg.norm(line.end - line.start))
    assert length == pytest.approx(limit.distances(robot)[0], abs=1e-6)
    assert line.colour == FREE
    (line,) = marks_of(robot, [], [limit], ["hand near table"])
    assert line.colour == HOLDING


def test_the_panel_says_who_gives_way_and_to_what() -> None:
    robot = bent_arm()
    hand, low = pik.Position(robot, site="tool"), pik.Position(robot, site="tool")
    low.target = hand.target - np.array([0.0, 0.0, 0.02])
    levels, limits = [[hand], [low]], [pik.JointRange(robot)]
    first, second = lines_of(robot, levels, pik.solve_step(robot, [hand, low], limits, DT, damping=0.0))
    assert (first.gives_way, first.error) == (False, "0.0 mm")
    assert (second.gives_way, second.error, second.reason) == (True, "20.0 mm", "the levels above")


def test_the_panel_names_the_limit_that_holds_a_level_back() -> None:
    robot = bent_arm()
    elbow = pik.JointCoupling(robot, {"elbow": 1.0}, target=1.5)
    limits = [pik.Velocity(robot, {"elbow": 1.0})]
    (line,) = lines_of(robot, [[elbow]], pik.solve_step(robot, [elbow], limits, DT, damping=0.0))
    assert (line.gives_way, line.reason, line.holding) == (True, "elbow upper", ("elbow upper",))


def test_the_panel_skips_the_recovery_of_limits() -> None:
    robot = bent_arm()
    robot.data.joint("elbow").qpos = -0.1  # below its range
    robot.update()
    levels, limits = [pik.Posture(robot, bent_arm().q)], [pik.JointRange(robot)]
    motion = pik.solve_step(robot, levels, limits, DT)
    assert len(motion.problem.levels) == 2
    (line,) = lines_of(robot, [levels], motion)
    assert line.name == "posture"


def test_two_tasks_of_a_kind_share_a_name_and_more_are_counted() -> None:
    robot = pik.example("humanoid")
    hands = [pik.Position(robot, site=f"{side} hand") for side in ("left", "right")]
    feet = [pik.Pose(robot, site=f"{side} foot") for side in ("left", "right")]
    names = [line.name for line in lines_of(robot, [hands, [*feet, *hands], []], None)]
    assert names == ["position of left hand, right hand", "pose of left foot and 3 more"]


def test_a_picture_shows_the_target_where_the_camera_sees_it(renders: None) -> None:
    robot = pik.Robot(bent_arm().model)
    camera = Camera(azimuth=90, elevation=0, distance=2.0, lookat=(0.0, 0.0, 0.5))
    sides = []
    for x in (-0.5, 0.5):
        mark = pik.Position(robot, [x, -0.5, 0.5], site="tool")
        met = pik.Position(robot, site="tool")
        drawn = picture(robot, [mark], camera=camera, size=SMALL, panel=False).astype(int)
        without = picture(robot, [met], camera=camera, size=SMALL, panel=False).astype(int)
        orange = (drawn[..., 0] > drawn[..., 2] + 60) & (np.abs(drawn - without).sum(2) > 30)
        sides.append(np.argwhere(orange)[:, 1].mean())
    assert sides[0] < SMALL[0] / 2 < sides[1]


def test_a_picture_of_a_model_without_light_or_sky_is_not_dark_and_its_model_is_not_changed(renders: None) -> None:
    import mujoco

    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint/><geom size='0.1'/></body></worldbody></mujoco>"
    )
    before = (model.vis.global_.offwidth, model.vis.headlight.ambient.copy())
    drawn = picture(pik.Robot(model), size=(800, 600))  # larger than the model's own buffer
    assert drawn.shape == (600, 800, 3)
    assert drawn[0, 0].min() > 200
    assert model.vis.global_.offwidth == before[0]
    np.testing.assert_array_equal(model.vis.headlight.ambient, before[1])


def test_the_panel_is_drawn_over_the_picture(renders: None) -> None:
    robot = bent_arm()
    bare, told = (picture(robot, [pik.Posture(robot)], panel=panel, size=SMALL) for panel in (False, True))
    different = np.abs(bare.astype(int) - told).sum(2) > 0
    assert different[: SMALL[1] // 3].any()
    assert not different[SMALL[1] // 2 :].any()


@pytest.mark.parametrize("kind", [".gif", ".webp", ".png", ".mp4"])
def test_a_film_has_a_frame_a_step_and_a_picture_the_last(renders: None, tmp_path: Path, kind: str) -> None:
    robot = bent_arm()
    file = tmp_path / f"film{kind}"
    with Film(file, robot, size=SMALL, rate=10.0) as film:
        for turn in (0.0, 0.5, 1.0):
            robot.update([turn, *robot.q[1:]])
            film.add()
    if kind == ".mp4":
        assert imageio_ffmpeg.count_frames_and_secs(file) == (3, pytest.approx(0.3, abs=0.05))
        command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(file)]
        told = subprocess.run(command, capture_output=True, text=True, check=False).stderr
        assert "h264" in told
        assert "160x120" in told
        return
    with Image.open(file) as shown:
        assert (shown.size, getattr(shown, "n_frames", 1)) == (SMALL, 1 if kind == ".png" else 3)
        shown.seek(shown.n_frames - 1 if kind != ".png" else 0)
        last = np.asarray(shown.convert("RGB"), dtype=int)
    assert np.abs(last - picture(robot, size=SMALL)).mean() < 4.0


def test_a_film_that_fails_or_has_no_frame_leaves_no_file(renders: None, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="site 'nothing'"), Film(tmp_path / "a.gif", bent_arm(), size=SMALL) as film:
        film.add(pik.Position(bent_arm(), site="nothing"))
    with pytest.raises(InputError, match="has no frame; expected add"), Film(tmp_path / "b.gif", bent_arm(), size=SMALL):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_film_of_another_kind_is_refused_before_anything_moves() -> None:
    with pytest.raises(InputError, match=r"unknown kind of picture '.avi'; choose one of: .png, .gif"):
        Film("reach.avi", bent_arm())


def test_the_page_answers_on_this_machine_alone_and_is_shown_what_the_panel_says() -> None:
    robot = bent_arm()
    task = pik.Position(robot, [0.5, 0.2, 0.3], site="tool")
    with View(robot, [task], [pik.JointRange(robot)], place="page", port=0) as view:
        assert view.address.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(view.address) as answer:
            assert answer.status == 200
        for _ in range(3):
            motion = pik.solve_step(robot, [task], dt=DT)
            robot.integrate(motion.velocity, DT)
            view.show(motion)
        assert view.is_open
    assert not view.is_open


def test_without_a_display_a_window_is_refused_in_one_line_and_the_page_is_taken() -> None:
    code = """
import json, prioritized_ik as pik
from prioritized_ik.viewer import View
robot = pik.example("arm")
try:
    View(robot, place="window")
except pik.InputError as error:
    refused = str(error)
with View(robot, port=0) as view:
    print(json.dumps([refused, view.address]))
"""
    environment = {key: value for key, value in os.environ.items() if key not in ("DISPLAY", "WAYLAND_DISPLAY")}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    refused, address = json.loads(next(line for line in done.stdout.splitlines() if line.startswith("[")))
    assert refused == "no window opens here; expected a display, or place='page'."
    assert address.startswith("http://127.0.0.1:")


REACH = ROOT / "examples" / "scenes" / "reach.toml"


def test_a_scene_is_recorded_as_fast_as_it_moves_and_told_as_without(renders: None, tmp_path: Path) -> None:
    plain = CliRunner().invoke(main, ["solve", str(REACH)])
    filmed = CliRunner().invoke(main, ["solve", str(REACH), "--record", str(tmp_path / "reach.gif")])
    assert filmed.exit_code == plain.exit_code == 0, filmed.output
    assert filmed.stdout == plain.stdout
    with Image.open(tmp_path / "reach.gif") as film:
        shown = [frame.info["duration"] for frame in ImageSequence.Iterator(film)]
    assert sum(shown) == 61 * 50  # [ms] 3 s, 20 frames a second, and the start; frames that are alike are one


@pytest.mark.parametrize(
    ("arguments", "result"),
    [(["solve", str(REACH)], "ended    REACHED"), (["wind", "--link", "14", "--tilt", "0.3"], "outcome      equilibrium")],
    ids=["solve", "wind"],
)
def test_what_is_viewed_says_where_it_is_seen_and_stays_until_it_is_interrupted(arguments: list[str], result: str) -> None:
    command = [sys.executable, "-u", "-c", "from prioritized_ik.cli import main; main()", *arguments, "--view"]
    environment = {key: value for key, value in os.environ.items() if key not in ("DISPLAY", "WAYLAND_DISPLAY")}
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        said = ""
        for line in running.stderr:
            said += line
            if "stays until" in line:
                break
        address = re.search(r"^seen at (http://127.0.0.1:\d+)$", said, re.MULTILINE)[1]
        with urllib.request.urlopen(address) as answer:
            assert answer.status == 200
        running.send_signal(signal.SIGINT)
        told, _ = running.communicate()
    assert running.returncode == 0
    assert told.startswith(result)


class Handle:
    """What `mujoco.viewer.launch_passive` returns, as far as a window uses it."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, **options: bool) -> None:
        self.user_scn = mujoco.MjvScene(model, 100)
        self.texts: tuple[Any, ...] = ()
        self.synced = 0

    def lock(self) -> Any:
        return contextlib.nullcontext()

    def set_texts(self, texts: tuple[Any, ...]) -> None:
        self.texts = texts

    def sync(self) -> None:
        self.synced += 1


def test_a_window_shows_marks_and_the_panel_in_letters_that_its_fonts_have(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mujoco.viewer.launch_passive", Handle)
    robot = bent_arm()
    tool = pik.Position(robot, [0.55, 0.2, 0.3], site="tool")
    levels = [tool, pik.Axis(robot, [0.0, 0.0, -1.0], site="tool")]
    levels[1].name = "axis – of Ω"
    window = Window(robot)
    window.show(robot, marks_of(robot, levels), lines_of(robot, [[task] for task in levels], None))
    handle = window._handle
    assert handle.synced == 1
    assert handle.user_scn.ngeom >= 2
    names, errors = handle.texts[2:]
    assert names == "1 position of tool\n2 axis - of ?"
    assert errors.splitlines()[1].endswith(" deg")
    assert (names + errors).isascii()
