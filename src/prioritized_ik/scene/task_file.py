"""A scene from a task file, in TOML.

    model = "robot.xml"         # MJCF or URDF, from the file's folder; or example = "arm"
    keyframe = "home"           # where the robot starts; or q = [...]; the model's own position unless given
    joints = {elbow = 0.5}      # of it, hinges and slides that start elsewhere [rad, m]
    dt = 0.01                   # [s]
    duration = 2.0              # [s]

    [[task]]
    kind = "position"           # a key of `entries.TASKS`
    level = 1                   # the most important; tasks of one level share it by their weights
    site = "tool"
    times = [0.0, 1.0]          # [s] way points; or one target, which rests; or none: as it is at the start
    targets = [[0.5, 0.1, 0.4], [0.5, -0.1, 0.4]]

    [[limit]]
    kind = "joint-range"        # a key of `entries.LIMITS`

What else a task or a limit takes are the arguments of its class, and what else a file takes those of `Scene`. Nothing in a
file is executed.
"""

import tomllib
from pathlib import Path
from typing import Any

import mujoco

from prioritized_ik.errors import InputError
from prioritized_ik.examples import example
from prioritized_ik.files import advising
from prioritized_ik.robot import Robot
from prioritized_ik.scene.entries import WAY_POINTS, LimitEntry, TaskEntry, check_keys, placed
from prioritized_ik.scene.scene import Scene
from prioritized_ik.validation import Array, finite_array

_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))

PLAIN = ("dt", "duration", "required", "tolerance", "damping", "solver")  # keys that a `Scene` takes as they are
KEYS = ("model", "example", "keyframe", "q", "joints", *PLAIN, "task", "limit")


def load_scene(path: str | Path, model: str | Path | None = None) -> Scene:
    """Return the scene of a task file.

    Args:
        path: the task file, TOML.
        model: an MJCF or URDF file in place of the model that the task file names.

    Raises:
        InputError: no such file, not TOML, an unknown key, one that is missing, or a value that is refused: the message
            says where, what was expected, and which names there are.
        SolverUnavailableError: the method that it names is unknown, or not installed.
    """
    file = Path(path)
    content = _content(file)
    with placed(file.name):
        check_keys(content, KEYS)
        for key in ("duration", "task"):
            if key not in content:
                raise InputError(f"there is no {key}; expected {'[[task]] tables' if key == 'task' else 'seconds'}.")
        robot = _robot(content, file.parent, None if model is None else Path(model))
        tasks = [_task(table, place) for table, place in _tables(content, "task")]
        limits = [_limit(table, place) for table, place in _tables(content, "limit")]
        q = _start(content, robot)
        return Scene(robot.model, q, tasks, limits, **{key: content[key] for key in PLAIN if key in content})


def _content(file: Path) -> dict[str, Any]:
    if not file.is_file():
        raise InputError(f"there is no file {str(file)!r}; expected a task file (.toml).")
    with advising("read", file, advice="choose a file that can be read"):
        raw = file.read_bytes()
    try:
        return tomllib.loads(raw.decode("utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{file.name} is not TOML ({error}); expected a task file.") from error


def _robot(content: dict[str, Any], folder: Path, other: Path | None) -> Robot:
    named = [key for key in ("model", "example") if key in content]
    if other is not None:
        return Robot(other)
    if len(named) != 1:
        raise InputError(
            f"{' and '.join(named) or 'no model'} given; expected either model, a file (.xml, .urdf), or example, a robot "
            "that comes with the package."
        )
    value = content[named[0]]
    if not isinstance(value, str):
        raise InputError(f"{named[0]} is {value!r}; expected a text.")
    return example(value) if named[0] == "example" else Robot(folder / value)


def _start(content: dict[str, Any], robot: Robot) -> Array:
    if "q" in content and "keyframe" in content:
        raise InputError("q and keyframe are both given; expected one of them.")
    robot.update(robot.keyframe(content["keyframe"]) if "keyframe" in content else content.get("q"))
    joints, q = content.get("joints", {}), robot.q
    if not isinstance(joints, dict):
        raise InputError(
            f"joints is {joints!r}; expected a table of joints and where each starts, such as {{elbow = 0.5}}."
        )
    for name, value in joints.items():
        number = robot.joint(name)
        if robot.model.jnt_type[number] not in _SCALAR:
            raise InputError(f"joint {name!r} is a ball or free joint; expected hinges and slides in joints, others in q.")
        q[robot.model.jnt_qposadr[number]] = float(finite_array(f"start of {name}", value, ()))
    return q


def _tables(content: dict[str, Any], key: str) -> list[tuple[dict[str, Any], str]]:
    """Return the tables `[[key]]`, and what messages call each."""
    tables = content.get(key, [])
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise InputError(f"{key} is {tables!r}; expected tables, each led by [[{key}]].")
    return [({**table}, f"{key} {number}") for number, table in enumerate(tables, 1)]


def _task(table: dict[str, Any], place: str) -> TaskEntry:
    with placed(place):
        kind = table.pop("kind", None)
        level, times, targets = (table.pop(key, default) for key, default in (("level", 1), *((k, []) for k in WAY_POINTS)))
        return TaskEntry(kind, level, table, times, targets)


def _limit(table: dict[str, Any], place: str) -> LimitEntry:
    with placed(place):
        return LimitEntry(table.pop("kind", None), table)
