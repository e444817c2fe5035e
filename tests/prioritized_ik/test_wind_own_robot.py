"""Winding with any robot: the paper's arm, given as a plain model, winds as it does; others wind by the same controller."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from click.testing import CliRunner, Result
from repository import ROOT

import prioritized_ik as pik
from prioritized_ik.cli import main
from prioritized_ik.winding import chain
from prioritized_ik.winding.loop import Outcome
from prioritized_ik.winding.settings import WindingSettings

SNAKE = ROOT / "examples" / "scenes" / "snake.xml"
HINGES = '<joint axis="0 1 0" range="-60 60"/><joint axis="1 0 0" range="-60 60"/>'
TOUCHED = 4  # the link, from 0, beside whose middle the object stands


def snake(
    wound: str, *, joints: str = HINGES, reverse: bool = False, base: str = "", lengths: Any = None
) -> mujoco.MjModel:
    """A snake of 13 uneven links without names along z, beside an object."""
    each = np.random.default_rng(4).uniform(0.05, 0.075, 13) if lengths is None else lengths
    height = each[:TOUCHED].sum() + 0.5 * each[TOUCHED]
    body = ""
    for number, length in reversed(list(enumerate(each))):
        ends = f"0 0 {length} 0 0 0" if reverse else f"0 0 0 0 0 {length}"
        place = f"0 0 {each[number - 1]}" if number else "0 0 0"
        geoms = f'<geom type="sphere" size="0.005"/><geom type="capsule" size="0.012" fromto="{ends}"/>'
        body = f'<body pos="{place}">{joints if number or not base else base + joints}{geoms}{body}</body>'
    placed = wound.format(height=height)
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="degree" autolimits="true"/><worldbody>{placed}{body}</worldbody></mujoco>'
    )


POLE = '<geom name="pole" type="cylinder" size="0.08 0.6" pos="0.093 0 {height}" euler="90 0 0"/>'
OBJECTS = {
    "cylinder": POLE,
    "tilted": '<geom name="pole" type="capsule" size="0.08 0.6" pos="0.093 0 {height}" axisangle="1 0 0 75"/>',
    "ellipsoid": '<geom name="pole" type="ellipsoid" size="0.08 0.09 0.6" pos="0.093 0 {height}" euler="90 0 0"/>',
}


def wound(model: mujoco.MjModel, **settings: Any) -> pik.WoundRobot:
    return pik.wind_robot(pik.RobotWinding(model=model, q=model.qpos0, wound="pole", **settings))


@pytest.mark.parametrize(("link", "direction", "tilt"), [(13, "back", 0.3), (14, "up", 0.0)])
def test_the_papers_arm_given_as_a_plain_model_winds_as_it_does(link: int, direction: str, tilt: float) -> None:
    settings = WindingSettings(link=link, direction=direction, tilt=tilt)
    episode = pik.wind(settings)
    own = pik.wind_robot(pik.RobotWinding(model=settings.model(), q=settings.initial_posture(), tip="link_17"))
    assert own.outcome is episode.outcome is Outcome.WOUND
    assert own.q == pytest.approx(episode.q, abs=1e-6)
    assert np.array_equal(own.in_contact, episode.in_contact)
    theirs, ours = pik.measure(episode), pik.measure_robot(own)
    assert ours.hinge_excess == pytest.approx(theirs.hinge_excess, abs=1e-6)
    for name in ("turns", "turns_ratio", "penetration", "bend", "drift", "steps", "driven_together", "flips"):
        assert getattr(ours, name) == pytest.approx(getattr(theirs, name), abs=1e-6), name


@pytest.mark.parametrize("shape", OBJECTS)
@pytest.mark.parametrize("reverse", [False, True])
def test_a_snake_of_uneven_links_winds_whichever_way_its_capsules_point(shape: str, reverse: bool) -> None:
    model = snake(OBJECTS[shape], reverse=reverse)
    found = wound(model)
    figures = pik.measure_robot(found)
    assert found.outcome is Outcome.WOUND
    assert found.in_contact[-1, TOUCHED:].all()
    assert figures.turns > 0.7
    assert (
        figures.turns_ratio is None if shape == "ellipsoid" else figures.turns_ratio > 0.9
    )  # uneven links do not all touch in their middles
    assert figures.penetration < 2e-3
    assert figures.hinge_excess <= 1e-9
    assert found.positions[-1, -1] == pytest.approx(_tip(model, found.q[-1]), abs=1e-9)


def _tip(model: mujoco.MjModel, q: np.ndarray) -> np.ndarray:
    """The far end of the last capsule, from its geom alone."""
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    geom = model.ngeom - 1
    ends = [
        data.geom_xpos[geom] + side * model.geom_size[geom, 1] * data.geom_xmat[geom].reshape(3, 3)[:, 2]
        for side in (1, -1)
    ]
    return max(ends, key=lambda end: float(np.linalg.norm(end - data.geom_xpos[geom - 2])))


def test_the_check_of_far_ends_sees_those_that_are_taken_for_near_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    model = snake(POLE)
    right = chain._towards_tip
    monkeypatch.setattr(chain, "_towards_tip", lambda *given: [-side for side in right(*given)])
    found = wound(model, max_steps=1)
    assert np.linalg.norm(found.positions[-1, -1] - _tip(model, found.q[-1])) > 0.04


def test_ball_joints_and_a_base_on_rails_wind_too() -> None:
    model = snake(POLE, joints='<joint type="ball"/>', base='<joint type="slide" axis="0 0 1" range="-0.02 0.02"/>')
    assert model.nq != model.nv
    found = wound(model)
    assert found.outcome is Outcome.WOUND
    quaternions = found.q[:, 1:].reshape(len(found.q), -1, 4)
    assert np.linalg.norm(quaternions, axis=-1) == pytest.approx(1.0)
    assert np.abs(found.q[:, 0]).max() <= 0.02 + 1e-9


def test_an_object_that_a_joint_moves_is_held_out_of_as_well() -> None:
    on_rails = f'<body><joint type="slide" axis="0 1 0" range="-0.1 0.1"/>{POLE}</body>'
    found = wound(snake(on_rails), max_steps=60)
    assert found.distance.min() > 0.0
    assert found.in_contact[-1].sum() > found.in_contact[0].sum()


def test_a_recording_of_it_holds_the_problems_that_were_solved(tmp_path: Path) -> None:
    found = wound(snake(POLE), max_steps=5)
    assert found.outcome is Outcome.OUT_OF_STEPS
    found.recording().save(tmp_path / "snake.npz")
    read = pik.Recording.load(tmp_path / "snake.npz")
    assert (read.steps, read.ending) == (5, "OUT_OF_STEPS")
    assert "contact of link 5 with pole" in read.problem(0).rows.names
    options = found.settings.options
    assert pik.solve(read.problem(4), options=options).dtheta == pytest.approx(read.dtheta[4], abs=1e-9)


def test_a_solver_that_fails_leaves_the_robot_where_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    class Silent(pik.Method):
        name, version = "silent", "0"

        def step(self, *_: Any) -> pik.JointStep:
            return pik.JointStep(None, pik.StepStatus.NOT_FOUND, "no idea")

    model = snake(POLE)
    found = pik.wind_robot(pik.RobotWinding(model=model, q=model.qpos0, wound="pole"), Silent())
    assert found.outcome is Outcome.SOLVER_FAILED
    assert "no idea" in found.message
    assert np.array_equal(found.q[0], found.q[1])
    assert np.isnan(found.dtheta).all()
    assert pik.measure_robot(found).steps == 1


def urdf(folder: Path, link: str) -> Path:
    """The snake as a URDF, its links of one kind of shape; joints that turn about two axes have a link between them."""
    each = np.random.default_rng(4).uniform(0.05, 0.075, 13)
    height = each[:TOUCHED].sum() + 0.5 * each[TOUCHED]
    pole = '<link name="pole"><collision><geometry><cylinder radius="0.08" length="1.2"/></geometry></collision></link>'
    text, before, away = [joint("pole", "base", "fixed", f'xyz="0.093 0 {height}" rpy="{np.pi / 2} 0 0"')], "base", 0.0
    for number, length in enumerate(each):
        shape = f'<origin xyz="0 0 {length / 2}"/><geometry>{link.format(length=length)}</geometry>'
        text.append(f'<link name="half {number}"/><link name="link {number}"><collision>{shape}</collision></link>')
        text.append(joint(f"half {number}", before, "revolute", f'xyz="0 0 {away}"', "0 1 0"))
        text.append(joint(f"link {number}", f"half {number}", "revolute", 'xyz="0 0 0"', "1 0 0"))
        before, away = f"link {number}", length
    file = folder / "snake.urdf"
    file.write_text(f'<robot name="snake"><link name="base"/>{pole}{"".join(text)}</robot>', encoding="utf-8")
    return file


def joint(child: str, parent: str, kind: str, origin: str, axis: str = "0 0 1") -> str:
    turn = f'<axis xyz="{axis}"/><limit lower="{-np.pi / 3}" upper="{np.pi / 3}" effort="1" velocity="1"/>'
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin {origin}/>'
    return f'<joint name="to {child}" type="{kind}">{ends}{turn}</joint>'


def test_a_urdf_winds_as_the_same_robot_in_mjcf_its_cylinders_rounded_off(tmp_path: Path) -> None:
    robot = pik.Robot(urdf(tmp_path, '<cylinder radius="0.012" length="{length}"/>'))
    capsules = int((robot.model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE).sum())
    found = wound(robot.model, max_steps=60)
    assert capsules == int((robot.model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE).sum()) == 0  # ours stays as it is
    assert found.q == pytest.approx(wound(snake(POLE), max_steps=60).q, abs=1e-6)
    assert np.abs(found.q[-1]).max() > 0.1


def test_a_urdf_of_boxes_is_told_what_its_links_need(tmp_path: Path) -> None:
    file = urdf(tmp_path, '<box size="0.02 0.02 {length}"/>')
    result = call("--scene", file, "--object", "pole")
    assert result.exit_code == 2
    assert "0 bodies from the base to 'link 12' have a capsule; expected two links" in result.output
    assert "In a URDF that is a <cylinder>" in result.output


def test_the_command_line_takes_parts_by_number_and_an_object_by_its_body(tmp_path: Path) -> None:
    file = urdf(tmp_path, '<cylinder radius="0.012" length="{length}"/>')
    number = pik.Robot(file).body("link 12")
    by_body, by_number = (call("--scene", file, "--object", which, "--tip", number, "--steps", 5) for which in ("pole", 0))
    assert by_body.output == by_number.output
    assert "steps        5" in by_body.output


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "no such object": ({"wound": "pol"}, "no geom 'pol'; the model has 27 geoms: pole, "),
    "no such tip": ({"tip": "tail"}, "no body 'tail'"),
    "one link": (
        {"tip": 1},
        "1 bodies from the base to 'body 1' have a capsule; expected two links",
    ),
    "bent away": (
        {"q": np.append([-0.9, 0.0], np.zeros(24))},
        "no link touches 'pole' at the start: the nearest, link 1, is",
    ),
    "q too short": ({"q": np.zeros(3)}, "nq = 26 positions and nv = 26"),
    "speed": ({"speed": 0.0}, "speed is 0.0"),
    "weights": ({"weights": "eq25"}, "unknown weights 'eq25'"),
}


@pytest.mark.parametrize(("changes", "message"), BAD.values(), ids=BAD.keys())
def test_bad_input_is_one_clear_message(changes: dict[str, Any], message: str) -> None:
    model = snake(POLE)
    with pytest.raises(pik.InputError, match=message):
        pik.RobotWinding(**{"model": model, "q": model.qpos0, "wound": "pole", **changes})


def call(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["wind", *map(str, arguments)])


def test_the_command_line_winds_the_example_and_saves_it(tmp_path: Path) -> None:
    result = call("--scene", SNAKE, "--object", "pole", "--tip", "tip", "--save", tmp_path / "snake.npz")
    assert result.exit_code == 0, result.output
    assert "equilibrium [1]" in result.output
    assert pik.Recording.load(tmp_path / "snake.npz").ending == "WOUND"
    assert call("--scene", SNAKE, "--object", "pole", "--steps", 3).exit_code == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--scene", SNAKE, "--links", "5"], "--links is of the paper's arm: leave it out with --scene"),
        (["--object", "pole"], "--object is of --scene, which is missing"),
        (["--scene", SNAKE], "there is no geom 'object'"),
        (
            ["--scene", SNAKE, "--object", "pole", "--keyframe", "home"],
            "there is no keyframe 'home'; the model has no keyframe",
        ),
        (["--scene", "none.xml"], "there is no file 'none.xml'"),
    ],
)
def test_bad_usage_is_one_line(arguments: list[object], message: str) -> None:
    result = call(*arguments)
    assert result.exit_code == 2
    assert message in result.output
    assert result.output.count("\n") == 1


def test_it_is_filmed_too(renders: None, tmp_path: Path) -> None:
    from PIL import Image

    result = call("--scene", SNAKE, "--object", "pole", "--steps", "20", "--record", tmp_path / "snake.png")
    assert "recorded" in result.output
    with Image.open(tmp_path / "snake.png") as picture:
        assert len(picture.convert("RGB").getcolors(picture.width * picture.height)) > 50
