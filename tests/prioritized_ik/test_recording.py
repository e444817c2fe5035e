"""A recording survives its file to the last bit, and a file that is none is refused."""

from pathlib import Path

import numpy as np
import pytest

import prioritized_ik as pik
from prioritized_ik.errors import EpisodeFileError
from prioritized_ik.problem_file import problem_bytes

SCENE = pik.Scene(
    pik.example("arm").model,
    np.array([0.3, 0.5, 0.2, 1.2, 0.1, 0.6, 0.0]),
    [pik.TaskEntry("position", 1, {"site": "tool", "target": [0.5, 0.2, 0.3]}), pik.TaskEntry("posture", 2)],
    [pik.LimitEntry("collision", {"pairs": [["hand", "post"]], "margin": 0.1})],
    duration=0.2,
)


@pytest.fixture(scope="module")
def run() -> pik.SceneRun:
    return SCENE.run()


def test_a_recording_is_read_as_it_was_written_to_the_last_bit(run: pik.SceneRun, tmp_path: Path) -> None:
    run.recording().save(tmp_path / "run.npz")
    read = pik.Recording.load(tmp_path / "run.npz")
    assert read.steps == 20
    assert read.ending == run.ending.name
    assert np.array_equal(read.q, run.q[:-1])
    for number, (problem, one) in enumerate(zip(read.problems(), run.steps, strict=True)):
        assert problem_bytes(problem) == problem_bytes(one.problem)
        assert np.array_equal(read.dtheta[number], one.step.dtheta)


def test_its_problems_solved_again_give_the_steps_that_were_taken(run: pik.SceneRun) -> None:
    recording = run.recording()
    for number in (0, 7, 19):
        assert pik.solve(recording.problem(number), "quadprog").dtheta == pytest.approx(recording.dtheta[number], abs=1e-9)
    with pytest.raises(pik.InputError, match="step is 20; expected 0 to 19"):
        recording.problem(20)


@pytest.mark.parametrize("damage", ["cut", "another", "text", "missing", "short", "spoilt"])
def test_another_file_is_refused_by_name(run: pik.SceneRun, tmp_path: Path, damage: str) -> None:
    path = tmp_path / "run.npz"
    run.recording().save(path)
    with np.load(path) as file:
        arrays = dict(file)
    if damage == "cut":
        path.write_bytes(path.read_bytes()[:-300])
    elif damage == "another":
        pik.save_problem(run.steps[0].problem, path)
    elif damage == "text":
        path.write_text("no archive")
    elif damage == "missing":
        path.unlink()
    elif damage == "short":
        np.savez(path, **{**arrays, "q": arrays["q"][1:]})
    elif damage == "spoilt":
        content = arrays["content"].copy()
        content[len(content) // 2 : len(content) // 2 + 400] = 0
        np.savez(path, **{**arrays, "content": content})
    with pytest.raises(EpisodeFileError, match=r"run\.npz"):
        pik.Recording.load(path)
