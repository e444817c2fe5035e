"""The controller's look and its problem in the compiled core, beside the form to read."""

import ctypes
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from building import build_script, replace_in_sources

from prioritized_ik.errors import InputError
from prioritized_ik.models import DIRECTIONS, Arm
from prioritized_ik.packed import PackedProblem
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.compiled.library import FOLDER, Library, library
from prioritized_ik.touch import TouchSensor
from prioritized_ik.winding import compiled
from prioritized_ik.winding.compiled import Scene, mujoco_functions
from prioritized_ik.winding.controller import Situation, WindingController
from prioritized_ik.winding.episode import wind
from prioritized_ik.winding.settings import WindingSettings

needs_core = pytest.mark.skipif(library().core is None, reason="the core is not compiled")

SHORT = Arm(links=6)

AGREES = 1e-12  # [m], and of Jacobians: sums of a few products of numbers up to one


@contextmanager
def only_python(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let controllers that are made have no compiled look."""
    with monkeypatch.context() as patch:
        patch.setattr(compiled, "library", lambda: Library(None, "switched off"))
        yield


def arrays(seen: Situation, problem: IKProblem) -> dict[str, np.ndarray]:
    """Everything that a controller tells, by name."""
    found = {
        f"seen {name}": getattr(seen, name) for name in ("positions", "directions", "contact_vectors", "desired", "signs")
    }
    found |= {f"touch {name}": getattr(seen.touch, name) for name in ("distance", "normal", "point")}
    found |= {"lower": problem.bounds.lower, "upper": problem.bounds.upper}
    found |= {"rows": problem.rows.matrix, "sides": problem.rows.upper}
    for level in problem.levels:
        found |= {f"{level.name} {name}": getattr(level, name) for name in ("matrix", "target", "weights")}
    return found


@needs_core
@pytest.mark.parametrize("weights", ["eq23", "strict"])
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_along_a_winding_the_two_forms_see_and_pose_the_same(
    direction: str, weights: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = WindingSettings(direction=direction, weights=weights, tilt=0.1, posture="arched")
    episode = wind(settings)
    fast = WindingController(settings)
    with only_python(monkeypatch):
        slow = WindingController(settings)
    assert (fast.path, slow.path) == ("compiled", "python")
    for number in range(1, episode.steps, 7):
        given = episode.q[number], episode.in_contact[number - 1]
        seen, reference = fast.observe(*given), slow.observe(*given)
        assert fast.path == "compiled"
        assert (seen.in_contact == reference.in_contact).all()
        assert (seen.first, seen.last, seen.equilibrium) == (reference.first, reference.last, reference.equilibrium)
        posed, wanted = fast.problem(given[0], seen), slow.problem(given[0], reference)
        assert (posed.bounds.names, posed.rows.names) == (wanted.bounds.names, wanted.rows.names)
        assert [level.name for level in posed.levels] == [level.name for level in wanted.levels]
        ours, theirs = arrays(seen, posed), arrays(reference, wanted)
        assert ours.keys() == theirs.keys()
        for name, array in ours.items():
            assert array.shape == theirs[name].shape, name
            assert np.abs(array - theirs[name]).max(initial=0.0) <= AGREES, name


@needs_core
def test_no_step_waits_for_a_kind_of_problem_that_it_is_the_first_to_have(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = WindingSettings(tilt=0.1, posture="arched", weights="strict")
    episode, controller = wind(settings), WindingController(settings)
    monkeypatch.delattr(compiled, "Layout")
    kinds = set()
    for number in range(1, episode.steps):
        seen = controller.observe(episode.q[number], episode.in_contact[number - 1])
        problem = controller.problem(episode.q[number], seen)
        assert isinstance(problem, PackedProblem)
        kinds.add(problem.layout)
    assert len(kinds) > SHORT.links


@needs_core
def test_what_was_seen_does_not_change_with_the_next_look_and_cannot_be_written() -> None:
    settings = WindingSettings(arm=SHORT, link=3)
    controller, nothing = WindingController(settings), np.zeros(SHORT.links, dtype=bool)
    q = settings.initial_posture()
    controller.observe(q, nothing)  # the first look is taken both ways
    seen = controller.observe(q, nothing)
    problem = controller.problem(q, seen)
    before = {name: array.copy() for name, array in arrays(seen, problem).items()}
    later = controller.observe(q + 0.01, nothing)
    controller.problem(q + 0.01, later)
    assert (later.positions != seen.positions).any()
    for name, array in arrays(seen, problem).items():
        assert np.array_equal(array, before[name]), name
        assert not array.flags.writeable, name


@needs_core
def test_a_situation_that_was_changed_poses_what_it_says() -> None:
    settings = WindingSettings(arm=SHORT, link=3)
    controller, nothing = WindingController(settings), np.zeros(SHORT.links, dtype=bool)
    q = settings.initial_posture()
    controller.observe(q, nothing)
    seen = controller.observe(q, nothing)
    wanted = np.full((SHORT.links, 3), 1e-3)
    changed = controller.problem(q, replace(seen, desired=wanted))
    assert np.array_equal(np.concatenate([level.target for level in changed.levels]), wanted.ravel())
    kept = controller.problem(q, seen)
    assert np.array_equal(kept.rows.matrix.shape, changed.rows.matrix.shape)
    assert np.abs(kept.rows.matrix - changed.rows.matrix).max() <= AGREES


@pytest.mark.parametrize("path", ["compiled", "python"])
def test_positions_that_make_no_sense_are_refused_alike(path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    settings, nothing = WindingSettings(arm=SHORT, link=3), np.zeros(SHORT.links, dtype=bool)
    q = settings.initial_posture()
    if path == "compiled":
        controller = WindingController(settings)
        controller.observe(q, nothing)
    else:
        with only_python(monkeypatch):
            controller = WindingController(settings)
    bad = q.copy()
    bad[2] = np.nan
    with pytest.raises(InputError, match=r"q\[2\] is nan"):
        controller.observe(bad, nothing)
    with pytest.raises(InputError, match=r"q has shape \(3,\)"):
        controller.observe(q[:3], nothing)
    outside = q.copy()
    outside[1] = 9.0
    with pytest.raises(InputError, match="outside its range"):
        controller.problem(outside, controller.observe(outside, nothing))


def test_the_fields_are_those_of_the_core() -> None:
    text = (FOLDER / "winding.hpp").read_text(encoding="utf-8")
    block = re.search(r"struct Scene \{(.*?)\n\};", text, re.DOTALL)
    assert block is not None
    body = re.sub(r"//.*", "", block[1])
    body = re.sub(r"\(\*(\w+)\)\([^)]*\)", r"\1", body)  # pointers to functions
    named = [re.findall(r"(\w+)\s*$", part)[0] for line in body.split(";") if line.strip() for part in line.split(",")]
    assert named == [name for name, _ in Scene._fields_]


@needs_core
def test_the_core_measures_the_record_alike() -> None:
    core = library().core
    assert core is not None
    assert core.core_scene_size() == ctypes.sizeof(Scene)


def test_without_mujocos_library_the_python_form_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "mujoco_functions", lambda: None)
    assert WindingController(WindingSettings(arm=SHORT, link=3)).path == "python"


def test_mujocos_functions_are_found_where_it_is_installed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    found = mujoco_functions()
    assert found is not None
    assert all(found.values())
    monkeypatch.setattr(compiled.mujoco, "__file__", str(tmp_path / "__init__.py"))
    assert mujoco_functions.__wrapped__() is None


def test_a_sensor_feels_no_further_than_it_reaches() -> None:
    controller = WindingController(WindingSettings(arm=Arm(links=17), link=6))
    controller.observe(controller.settings.initial_posture(), np.zeros(17, dtype=bool))
    near, far = controller.sensor, TouchSensor(controller.model, controller.settings.arm.link_geoms)
    one, other = near.read(controller.data), far.read(controller.data)
    felt = other.distance < near.reach
    assert felt.any()
    assert not felt.all()
    assert np.array_equal(one.distance[felt], other.distance[felt])
    assert (one.distance[~felt] == near.reach).all()
    assert not one.normal[~felt].any()


@needs_core
@pytest.mark.skipif(build_script().compiler() is None, reason="no C++ compiler")
def test_a_core_that_sees_something_else_is_not_asked_again_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    right = "along += (point[k] - centre[k]) * axis[k];"
    made = replace_in_sources(tmp_path, {right: right.replace("-", "+")})
    settings = WindingSettings(link=6)
    given = settings.initial_posture(), np.zeros(17, dtype=bool)
    honest = WindingController(settings).observe(*given)
    monkeypatch.setattr(compiled, "library", lambda: made)
    controller = WindingController(settings)
    with pytest.warns(RuntimeWarning, match="off the Python form's, which is used"):
        seen = controller.observe(*given)
    assert controller.path == "python"
    assert np.abs(seen.touch.normal - honest.touch.normal).max() <= AGREES
