"""Every kind of wrong row that a `Posing` could write, in Python or in the core, is noticed beside the tasks' own rows."""

import ctypes
import subprocess
import sys
import types
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from building import build_script

from prioritized_ik import CentreOfMass, JointRange, Orientation, Pose, Position, Posture, Robot, example, posing
from prioritized_ik.limits import limited_scalars
from prioritized_ik.solvers.compiled.library import FOLDER, library
from prioritized_ik.tasks.turns import turned

SAME = 1e-12  # [m, rad] of numbers of about one
NOTICED = 1e-3

ACROSS = np.array([[0.6, 0.0, 0.8], [0.0, -1.0, 0.5]])
FRAMES = ({"site": "left hand"}, {"body": "trunk"}, {"geom": 3})

#: What is wrong: the same in both forms, (posing.py, posing.hpp).
IN_BOTH = {
    "Jacobian of another body": (
        "mujoco.mj_jac(model, data, jacobian, None, self.here, self.body)",
        "mujoco.mj_jac(model, data, jacobian, None, self.here, self.body - 1)",
        "p.jac(p.model, p.data, jacobian, nullptr, rows.here, rows.body)",
        "p.jac(p.model, p.data, jacobian, nullptr, rows.here, rows.body - 1)",
    ),
    "Jacobian at the world's origin": (
        "mujoco.mj_jac(model, data, jacobian, None, self.here, self.body)",
        "mujoco.mj_jac(model, data, jacobian, None, np.zeros(3), self.body)",
        "p.jac(p.model, p.data, jacobian, nullptr, rows.here, rows.body)",
        "p.jac(p.model, p.data, jacobian, nullptr, origin, rows.body)",
    ),
    "Jacobian of places for turns": (
        "mujoco.mj_jac(model, data, None, jacobian, np.zeros(3), self.body)",
        "mujoco.mj_jac(model, data, jacobian, None, np.zeros(3), self.body)",
        "p.jac(p.model, p.data, nullptr, jacobian, origin, rows.body)",
        "p.jac(p.model, p.data, jacobian, nullptr, origin, rows.body)",
    ),
    "mass of the whole model": (
        "mujoco.mj_jacSubtreeCom(model, data, jacobian, self.body)",
        "mujoco.mj_jacSubtreeCom(model, data, jacobian, 0)",
        "mass(rows.body, jacobian)",
        "mass(0, jacobian)",
    ),
    "sign of the way": (
        "is_turn else self.wanted - self.here",
        "is_turn else self.here - self.wanted",
        "error[k] = rows.wanted[k] - rows.here[k];",
        "error[k] = rows.here[k] - rows.wanted[k];",
    ),
    "sign of the turn": (
        "turn_between(self.here.reshape(3, 3), self.wanted.reshape(3, 3))",
        "turn_between(self.wanted.reshape(3, 3), self.here.reshape(3, 3))",
        "*there = rows.wanted + 3 * i, *here = rows.here + 3 * j;",
        "*there = rows.here + 3 * i, *here = rows.wanted + 3 * j;",
    ),
    "turn in the frame's own axes": (
        "turn_between(self.here.reshape(3, 3), self.wanted.reshape(3, 3))",
        "turn_between(self.here.reshape(3, 3).T, self.wanted.reshape(3, 3).T)",
        "there[0] * here[0] + there[1] * here[1] + there[2] * here[2];",
        "rows.wanted[i] * rows.here[j] + rows.wanted[3 + i] * rows.here[3 + j] + rows.wanted[6 + i] * rows.here[6 + j];",
    ),
    "half of the turn": (
        "turn_between(self.here.reshape(3, 3), self.wanted.reshape(3, 3)) if",
        "0.5 * turn_between(self.here.reshape(3, 3), self.wanted.reshape(3, 3)) if",
        "p.to_vector(vector, quaternion, 1.0);",
        "p.to_vector(vector, quaternion, 2.0);",
    ),
    "own axes for the world's, and the reverse": (
        "sides @ self.axes.reshape(3, 3).T",
        "sides @ self.axes.reshape(3, 3)",
        "axis[0] * given[0] + axis[1] * given[1] + axis[2] * given[2]",
        "rows.axes[k] * given[0] + rows.axes[3 + k] * given[1] + rows.axes[6 + k] * given[2]",
    ),
    "world's axes where own ones are asked for": (
        "if self.axes is not None:",
        "if False:",
        "side[k] = axis ? axis",
        "side[k] = false ? axis",
    ),
    "another order of the axes": (
        "sides @ jacobian, self.gain",
        "sides @ jacobian[[0, 2, 1]], self.gain",
        "side[1] * jacobian[m + j] + side[2] * jacobian[2 * m + j]",
        "side[1] * jacobian[2 * m + j] + side[2] * jacobian[m + j]",
    ),
    "combined rows, but not their errors": (
        "self.gain * (sides @ error)",
        "self.gain * error[: len(sides)]",
        "set(rows, i, side[0] * error[0] + side[1] * error[1] + side[2] * error[2]);",
        "set(rows, i, error[i]);",
    ),
    "no gain": (
        "sides @ jacobian, self.gain * (sides @ error)",
        "sides @ jacobian, sides @ error",
        "const double target = rows.gain * error;",
        "const double target = error;",
    ),
    "a side below zero": (
        "np.maximum(self.target, 0.0, out=self.target)",
        "pass",
        "rows.floored && target < 0.0 ? 0.0 : target",
        "target",
    ),
    "sides above zero left out": (
        "np.maximum(self.target, 0.0, out=self.target)",
        "np.minimum(self.target, 0.0, out=self.target)",
        "rows.floored && target < 0.0 ? 0.0 : target",
        "rows.floored && target > 0.0 ? 0.0 : target",
    ),
    "places of other joints": (
        "self.target[:] = self.gain * (self.wanted - self.here[self.places])",
        "self.target[:] = self.gain * (self.wanted - self.here[: len(self.places)])",
        "rows.wanted[k] - rows.here[rows.places[k]]",
        "rows.wanted[k] - rows.here[k]",
    ),
    "sign of the joints' way": (
        "self.target[:] = self.gain * (self.wanted - self.here[self.places])",
        "self.target[:] = self.gain * (self.here[self.places] - self.wanted)",
        "rows.wanted[k] - rows.here[rows.places[k]]",
        "rows.here[rows.places[k]] - rows.wanted[k]",
    ),
    "no gain of joints": (
        "self.target[:] = self.gain * (self.wanted",
        "self.target[:] = (self.wanted",
        "rows.target[k] = rows.gain * (",
        "rows.target[k] = (",
    ),
    "lower bounds of other joints": (
        "self.matrix[self.dofs] = np.maximum",
        "self.matrix[: len(self.dofs)] = np.maximum",
        "rows.matrix[rows.dofs[i]] = ",
        "rows.matrix[i] = ",
    ),
    "upper bounds of other joints": (
        "self.target[self.dofs] = np.minimum",
        "self.target[: len(self.dofs)] = np.minimum",
        "rows.target[rows.dofs[i]] = ",
        "rows.target[i] = ",
    ),
    "ends of ranges, not the ways there": (
        "away = self.wanted - self.here[self.places]",
        "away = self.wanted",
        "const double here = rows.here[rows.places[i]];",
        "const double here = 0.0;",
    ),
    "steps longer than the longest": (
        "np.maximum(np.minimum(away[0], 0.0), self.across[0])",
        "np.minimum(away[0], 0.0)",
        "max(down, rows.across[i])",
        "down",
    ),
    "the wider of range and step above": (
        "np.minimum(np.maximum(away[1], 0.0), self.across[1])",
        "np.maximum(np.maximum(away[1], 0.0), self.across[1])",
        "min(up, rows.across[rows.count + i])",
        "max(up, rows.across[rows.count + i])",
    ),
    "a lower bound that asks for motion": (
        "np.minimum(away[0], 0.0)",
        "away[0]",
        "min(rows.wanted[i] - here, 0.0)",
        "(rows.wanted[i] - here)",
    ),
    "an upper bound that asks for motion": (
        "np.maximum(away[1], 0.0)",
        "away[1]",
        "max(rows.wanted[rows.count + i] - here, 0.0)",
        "(rows.wanted[rows.count + i] - here)",
    ),
}

#: Wrong where both forms are told what to write: (posing.py).
IN_WHAT_IS_ASKED = {
    "place of another frame": ('"site": "site_xpos"', '"site": "xpos"'),
    "rotation of another frame": ('"site": "site_xmat"', '"site": "xmat"'),
    "a geom's number for its body's": (
        'f"{frame.kind}_bodyid")[frame.number]',
        'f"{frame.kind}_bodyid")[frame.number - 1]',
    ),
    "a frame's number for its body's": ('frame.number if frame.kind == "body" else int(', "frame.number if True else int("),
    "axes of the other kind": ("if own_axes else None", "if not own_axes else None"),
    "gain of frames lost": ("rows.body, rows.gain = self._carrier(frame), gain", "rows.body = self._carrier(frame)"),
    "floor lost": ("rows.floored = floored", "pass"),
    "longest step of other joints": (
        "np.array([-step[dofs], step[dofs]])",
        "np.array([-step[: len(dofs)], step[: len(dofs)]])",
    ),
    "longest step of joints without range lost": ("lower[:], upper[:] = -step, step", "lower[:], upper[:] = -9.0, 9.0"),
}

Parts = list[tuple[np.ndarray, np.ndarray]]
Write = Callable[[Any], None]


def disturbed() -> tuple[Robot, np.random.Generator]:
    """A robot somewhere, some of its joints at or beyond the ends of their ranges."""
    robot, rng = example("humanoid"), np.random.default_rng(11)
    q = np.array(robot.q)
    mujoco.mj_integratePos(robot.model, q, 0.5 * rng.normal(size=robot.model.nv), 1.0)
    joints, _, places = limited_scalars(robot.model)
    low, high = robot.model.jnt_range[joints].T
    q[places] = rng.uniform(low, high)
    q[places[:3]], q[places[3:6]] = low[:3] - 0.02, high[3:6] + 0.02
    q[places[6:9]], q[places[9:12]] = low[6:9] + 0.01, high[9:12] - 0.01
    robot.update(q)
    return robot, rng


def rows_of(posing_class: Any, robot: Robot, rng: np.random.Generator, write: Write) -> tuple[Parts, Parts]:
    """Everything that a `Posing` writes, as a task or limit says it and as it was written: matrix and target of each."""
    model, nv = robot.model, robot.model.nv
    posed, told, found = posing_class(model, robot.data), [], []

    def room(rows: int) -> tuple[np.ndarray, np.ndarray]:
        found.append((np.zeros((rows, nv)), np.zeros(rows)))
        return found[-1]

    for which in FRAMES:
        frame = robot.frame(**which)
        place = robot.position(frame) + rng.normal(size=3)
        turn = turned(robot.rotation(frame), np.array([0.7, -1.1, 0.4])).ravel()
        axes = robot.rotation(frame)
        (moves, way), (turns, angle) = (
            Position(robot, place, **which).rows(robot),
            Orientation(robot, turn.reshape(3, 3), **which).rows(robot),
        )
        whole = Pose(robot, **which).rows(robot)[0]
        assert np.abs(whole[:3] - moves).max() <= SAME
        posed.position(frame, place, *room(3), gain=0.5)
        posed.orientation(frame, turn, *room(3), gain=0.25)
        told += [(moves, 0.5 * way), (turns, 0.25 * angle)]
        for own, sides in ((False, ACROSS), (True, ACROSS @ axes.T)):
            posed.position(frame, place, *room(2), across=ACROSS, own_axes=own, gain=0.5)
            posed.orientation(frame, turn, *room(2), across=ACROSS, own_axes=own)
            told += [(sides @ moves, 0.5 * sides @ way), (sides @ turns, sides @ angle)]
        posed.position(frame, place, *room(3), floored=True)
        posed.position(frame, None, *room(3))
        posed.orientation(frame, None, *room(3))
        told += [(moves, np.maximum(way, 0.0)), (moves, np.zeros(3)), (turns, np.zeros(3))]
    for body in (0, robot.body("trunk"), robot.body("left upper arm")):
        mass = robot.data.subtree_com[body] + rng.normal(size=3)
        posed.centre_of_mass(body, mass, *room(3), gain=0.5)
        jacobian, error = CentreOfMass(robot, mass, body=body).rows(robot)
        told.append((jacobian, 0.5 * error))
        posed.centre_of_mass(body, mass, *room(2), across=ACROSS)
        told.append((ACROSS @ jacobian, ACROSS @ error))

    _, dofs, places = limited_scalars(model)
    dofs, places = dofs[::-2].copy(), places[::-2].copy()
    wanted = rng.normal(size=len(places))
    q = np.array(robot.q)
    q[places] = wanted
    matrix, error = Posture(robot, q).rows(robot)
    target = np.zeros(len(places))
    posed.joints(places, wanted, target, gain=0.5)
    found.append((np.zeros(0), target))
    told.append((np.zeros(0), 0.5 * (matrix.T @ error)[dofs]))

    step = rng.uniform(0.02, 0.3, nv)
    lower, upper = np.full(nv, np.nan), np.full(nv, np.nan)
    posed.bounds(lower, upper, step)
    found.append((lower, upper))
    ranges = JointRange(robot, outside="hold").at(robot, 0.1).bounds
    assert ranges is not None
    told.append((np.maximum(ranges.lower, -step), np.minimum(ranges.upper, step)))
    write(posed)
    return told, found


def apart(told: Parts, found: Parts) -> float:
    """How far what was written is from what tasks and limits say, at most."""
    pairs = [pair for both in zip(told, found, strict=True) for pair in zip(*both, strict=True)]
    return max(float(np.abs(one - other).max(initial=0.0)) for one, other in pairs)


def deviation(posing_class: Any, write: Write) -> float:
    robot, rng = disturbed()
    return apart(*rows_of(posing_class, robot, rng, write))


@cache
def changed(right: str, wrong: str) -> Any:
    """`Posing` of a module in which some text is replaced."""
    path = Path(posing.__file__)
    text = path.read_text(encoding="utf-8")
    assert right in text, right
    module = types.ModuleType("prioritized_ik.posing_changed")
    module.__dict__["__file__"] = str(path)
    sys.modules[module.__name__] = module  # where dataclasses look for it
    try:
        exec(compile(text.replace(right, wrong), str(path), "exec"), module.__dict__)
    finally:
        del sys.modules[module.__name__]
    return module.Posing


def by_python(posed: Any) -> None:
    posed.by_python()


def by_core(posed: Any) -> None:
    posed()


@pytest.fixture(scope="module")
def wrong_cores(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """One library with the honest function and every wrong one, each compiled from the changed source."""
    script, folder = build_script(), tmp_path_factory.mktemp("posing")
    source = (FOLDER / "posing.hpp").read_text(encoding="utf-8")
    body = source[source.index("namespace prioritized_ik {") :]
    texts = [f'#include "{FOLDER / "dense.hpp"}"', "#include <cstdint>"]
    for number, (right, wrong) in enumerate([("", ""), *((case[2], case[3]) for case in IN_BOTH.values())]):
        assert right in body, right
        own = (body.replace(right, wrong) if right else body).replace(
            "namespace prioritized_ik {", f"namespace wrong_{number} {{ using namespace prioritized_ik;"
        )
        texts.append(own)
        texts.append(
            f'extern "C" __attribute__((visibility("default"))) void pose_{number}(const wrong_{number}::Posing* p) '
            f"{{ wrong_{number}::Poser(*p).write(); }}"
        )
    path, made = folder / "wrong.cpp", folder / "wrong.so"
    path.write_text("\n".join(texts), encoding="utf-8")
    flags = [flag if flag != "-O3" else "-O1" for flag in script.FLAGS]
    subprocess.run([*script.compiler(), *flags, str(path), "-o", str(made)], check=True, capture_output=True)
    core = ctypes.CDLL(str(made))
    for number in range(len(IN_BOTH) + 1):
        function = getattr(core, f"pose_{number}")
        function.argtypes, function.restype = [ctypes.c_void_p], None
    return core


def by_another(core: ctypes.CDLL, number: int) -> Write:
    """What writes by one of the wrong functions; 0 is the honest one."""

    def write(posed: Any) -> None:
        _, at, memory = posed._compiled
        posed.__dict__["_compiled"] = getattr(core, f"pose_{number}"), at, memory
        posed()

    return write


@pytest.mark.parametrize("write", [by_python, by_core])
def test_rows_are_those_of_tasks_and_limits(write: Write) -> None:
    assert deviation(posing.Posing, write) <= SAME


@pytest.mark.parametrize("name", IN_BOTH)
def test_what_is_wrong_in_the_python_form_is_noticed(name: str) -> None:
    right, wrong, *_ = IN_BOTH[name]
    assert deviation(changed(right, wrong), by_python) >= NOTICED


@pytest.mark.skipif(library().core is None, reason="there is no compiled core here")
@pytest.mark.skipif(build_script().compiler() is None, reason="no C++ compiler")
class TestTheCore:
    def test_its_honest_function_is_right(self, wrong_cores: ctypes.CDLL) -> None:
        assert deviation(posing.Posing, by_another(wrong_cores, 0)) <= SAME

    @pytest.mark.parametrize("name", IN_BOTH)
    def test_what_is_wrong_is_noticed(self, name: str, wrong_cores: ctypes.CDLL) -> None:
        number = 1 + list(IN_BOTH).index(name)
        assert deviation(posing.Posing, by_another(wrong_cores, number)) >= NOTICED


@pytest.mark.parametrize("write", [by_python, by_core])
@pytest.mark.parametrize("name", IN_WHAT_IS_ASKED)
def test_what_is_wrong_in_what_is_asked_is_noticed(name: str, write: Write) -> None:
    assert deviation(changed(*IN_WHAT_IS_ASKED[name]), write) >= NOTICED
