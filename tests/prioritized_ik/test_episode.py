import os
from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
from winding_fixtures import AS_RECORDED, By, recorded, short_episode

from prioritized_ik.errors import EpisodeFileError, InputError, SolverUnavailableError
from prioritized_ik.models import Arm
from prioritized_ik.problem_file import problem_bytes
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.solvers.step import JointStep, StepStatus
from prioritized_ik.tree_problem import tree_of
from prioritized_ik.winding.controller import WindingController
from prioritized_ik.winding.episode import FORMAT, Episode, Outcome, replay, wind
from prioritized_ik.winding.loop import moments
from prioritized_ik.winding.settings import CLOSED_FORM, WindingSettings

ARRAYS = [item.name for item in fields(Episode) if item.name not in ("settings", "outcome", "message")]
TIMINGS = ("solve_seconds", "build_seconds")


def differing(a: Episode, b: Episode, names: list[str]) -> list[str]:
    """Names of the arrays whose type, shape or bits differ."""
    pairs = [(name, getattr(a, name), getattr(b, name)) for name in names]
    return [n for n, x, y in pairs if (x.dtype, x.shape, x.tobytes()) != (y.dtype, y.shape, y.tobytes())]


@cache
def on_tree(weights: str = "eq23", links: int = 9) -> Episode:
    options = SolveOptions(kinematics="tree", rank_tolerance=0.0)
    arm = Arm(links=links)
    return wind(WindingSettings(arm=arm, link=4, posture="random", weights=weights, options=options, max_steps=12))


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "episode.npz"
    short_episode().save(path)
    return path


def test_a_saved_episode_loads_bit_for_bit(saved):
    loaded, episode = Episode.load(saved), short_episode()
    assert (loaded.settings, loaded.outcome, loaded.message) == (episode.settings, episode.outcome, episode.message)
    assert differing(loaded, episode, ARRAYS) == []


def test_a_loaded_episode_replays_bit_for_bit(saved):
    loaded = Episode.load(saved)
    assert differing(replay(loaded), loaded, [name for name in ARRAYS if name not in TIMINGS]) == []


def test_a_replay_with_other_settings_differs():
    episode = short_episode()
    other = replace(episode, settings=replace(episode.settings, speed=1.999))
    assert "dtheta" in differing(replay(other), episode, ARRAYS)


def test_every_problem_of_a_loaded_episode_solves_to_the_recorded_bits(saved):
    loaded = Episode.load(saved)
    backend = get_method("daqp")
    for step, problem in enumerate(loaded.problems()):
        assert backend.step(problem, AS_RECORDED).dtheta.tobytes() == loaded.dtheta[step].tobytes()


@pytest.mark.parametrize("weights", ["eq23", "strict", "trailing"])
def test_problems_on_the_tree_are_read_as_they_were_posed_without_any_matrix(weights, tmp_path):
    episode = on_tree(weights)
    episode.save(tmp_path / "episode.npz")
    loaded = Episode.load(tmp_path / "episode.npz")
    assert differing(loaded, episode, ARRAYS) == []
    seen = []
    settings = episode.settings
    for moment in moments(WindingController(settings), get_method("active-set"), settings.initial_posture()):
        seen.append(moment)
    assert len(seen) == loaded.steps + 1
    for posed, read in zip((moment.problem for moment in seen[:-1]), loaded.problems(), strict=True):
        assert tree_of(read) is not None
        assert problem_bytes(read) == problem_bytes(posed)
        assert "matrix" not in vars(read.levels[0])


def test_an_episode_on_the_tree_grows_with_its_links_and_one_of_matrices_with_their_square():
    def numbers(links: int, kinematics: str) -> int:
        options = SolveOptions(kinematics=kinematics)
        episode = wind(WindingSettings(arm=Arm(links=links), link=4, posture="random", options=options, max_steps=1))
        return sum(getattr(episode, name).size for name in ARRAYS)

    assert numbers(16, "tree") < 2.1 * numbers(8, "tree")
    assert numbers(16, "dense") > 3.0 * numbers(8, "dense")


def test_steps_of_arms_that_trail_keep_their_levels_in_a_file_with_matrices_too(tmp_path):
    episode = wind(WindingSettings(weights="trailing", max_steps=5))
    episode.save(tmp_path / "episode.npz")
    problem = Episode.load(tmp_path / "episode.npz").problem(0)
    assert [len(level.target) for level in problem.levels] == [3 * 7]  # arms 1 … 6, and the next


def test_the_steps_add_up_to_the_joint_positions():
    episode = short_episode()
    for step in range(episode.steps):
        assert np.array_equal(episode.q[step + 1], episode.q[step] + episode.dtheta[step])


def test_the_problem_of_a_step_names_joints_and_links():
    rows = recorded().problem(200).inequalities
    assert rows.names[0] == "joint_1z upper"
    assert "joint_17z lower" in rows.names
    assert "contact of link 6" in rows.names


def test_problems_of_chosen_steps_are_those():
    episode = short_episode()
    chosen = [problem.levels[0].target.tobytes() for problem in episode.problems(range(3, 6))]
    assert chosen == [episode.desired[step].tobytes() for step in (3, 4, 5)]


@pytest.mark.parametrize("step", [-1, 25])
def test_a_step_that_is_not_there_is_refused(step):
    with pytest.raises(InputError, match=f"step is {step}; expected 0 to 24"):
        short_episode().problem(step)


def test_every_array_of_an_episode_is_read_only(saved):
    for episode in (short_episode(), Episode.load(saved)):
        assert not any(getattr(episode, name).flags.writeable for name in ARRAYS)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(EpisodeFileError, match=r"cannot read an episode from .*nowhere\.npz"):
        Episode.load(tmp_path / "nowhere.npz")


def test_a_folder_is_refused_as_a_file(tmp_path):
    with pytest.raises(EpisodeFileError):
        Episode.load(tmp_path)


@pytest.mark.parametrize("content", [b"", b"no zip at all", b"PK\x03\x04", b"\x93NUMPY"])
def test_a_file_that_is_no_archive_is_refused(content, tmp_path):
    path = tmp_path / "episode.npz"
    path.write_bytes(content)
    with pytest.raises(EpisodeFileError):
        Episode.load(path)


def test_a_single_array_is_refused(tmp_path):
    path = tmp_path / "array.npy"
    np.save(path, np.zeros(3))
    with pytest.raises(EpisodeFileError):
        Episode.load(path)


@pytest.mark.parametrize("part", [0.1, 0.5, 0.9, 0.999])
def test_a_truncated_file_is_refused(part, saved):
    content = saved.read_bytes()
    saved.write_bytes(content[: int(part * len(content))])
    with pytest.raises(EpisodeFileError):
        Episode.load(saved)


def test_a_file_with_a_damaged_array_is_refused(saved):
    content = bytearray(saved.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 64] = bytes(64)
    saved.write_bytes(content)
    with pytest.raises(EpisodeFileError):
        Episode.load(saved)


def test_an_archive_packed_in_a_way_that_cannot_be_unpacked_is_refused(saved):
    content = bytearray(saved.read_bytes())
    directory = content.index(b"PK\x01\x02")
    content[directory + 10] = 99  # the first entry's compression method
    saved.write_bytes(content)
    with pytest.raises(EpisodeFileError):
        Episode.load(saved)


def rewritten(path, **changes):
    """Write the archive at `path` anew with changed or, where the value is None, missing entries."""
    with np.load(path) as file:
        content = {name: file[name] for name in file.files} | changes
    np.savez(path, **{name: value for name, value in content.items() if value is not None}, allow_pickle=True)


def test_a_rewritten_file_without_changes_still_loads(saved):
    rewritten(saved)
    assert differing(Episode.load(saved), short_episode(), ARRAYS) == []


class Trap:
    """An object whose unpickling would leave a trace."""

    sprung = False

    def __reduce__(self):
        return (_spring, ())


def _spring():
    Trap.sprung = True


def test_a_pickled_object_is_refused_and_not_run(saved):
    rewritten(saved, q=np.array([Trap()], dtype=object))
    with pytest.raises(EpisodeFileError, match="allow_pickle"):
        Episode.load(saved)
    assert not Trap.sprung


@pytest.mark.parametrize("name", ["format", "settings", "outcome", "q", "row_upper"])
def test_a_missing_entry_is_refused(name, saved):
    rewritten(saved, **{name: None})
    with pytest.raises(EpisodeFileError, match=name):
        Episode.load(saved)


@pytest.mark.parametrize("name", ARRAYS)
def test_an_array_of_another_shape_is_refused_by_name(name, saved):
    value = getattr(short_episode(), name)
    rewritten(saved, **{name: value[1:] if len(value) else np.zeros((1, *value.shape[1:]))})
    # A shorter dθ changes T itself, so that every other array has the wrong length.
    with pytest.raises(EpisodeFileError, match="has shape" if name == "dtheta" else f"{name} has shape"):
        Episode.load(saved)


def test_a_file_of_another_format_is_refused_with_both_names(saved):
    rewritten(saved, format=np.array("prioritized-ik episode 0"))
    with pytest.raises(EpisodeFileError, match=f"has the format 'prioritized-ik episode 0'; expected '{FORMAT}'"):
        Episode.load(saved)


def test_an_outcome_that_there_is_not_is_refused(saved):
    rewritten(saved, outcome=np.array("TRIUMPH"))
    with pytest.raises(EpisodeFileError, match="TRIUMPH"):
        Episode.load(saved)


@pytest.mark.parametrize("text", ["{", "{}", '{"link": 3}'])
def test_settings_that_are_none_are_refused(text, saved):
    rewritten(saved, settings=np.array(text))
    with pytest.raises(EpisodeFileError, match="not settings"):
        Episode.load(saved)


def test_a_folder_that_is_not_there_is_refused_and_not_made(tmp_path):
    with pytest.raises(EpisodeFileError, match="choose a folder that exists and is writable"):
        short_episode().save(tmp_path / "missing" / "episode.npz")
    assert list(tmp_path.iterdir()) == []


def test_a_file_in_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "file").write_text("kept")
    with pytest.raises(EpisodeFileError):
        short_episode().save(tmp_path / "file" / "episode.npz")
    assert (tmp_path / "file").read_text() == "kept"


def test_a_folder_in_place_of_the_file_is_refused_and_nothing_is_left_behind(tmp_path):
    (tmp_path / "episode.npz").mkdir()
    with pytest.raises(EpisodeFileError):
        short_episode().save(tmp_path / "episode.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["episode.npz"]


def test_a_full_disk_keeps_the_old_file_and_leaves_nothing_behind(saved, monkeypatch):
    before = saved.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(EpisodeFileError, match="No space left"):
        recorded().save(saved)
    assert saved.read_bytes() == before
    assert [path.name for path in saved.parent.iterdir()] == [saved.name]


def test_saving_twice_replaces_the_file(saved):
    recorded().save(saved)
    assert Episode.load(saved).steps == recorded().steps
    assert [path.name for path in saved.parent.iterdir()] == [saved.name]


def test_an_arm_in_contact_from_k_on_has_wound():
    episode = recorded()
    assert episode.outcome is Outcome.WOUND
    assert episode.in_contact[-1, 5:].all()
    assert not episode.in_contact[:-1, 5:].all(axis=1).any()


def test_an_episode_without_equilibrium_ends_out_of_steps():
    episode = short_episode()
    assert episode.outcome is Outcome.OUT_OF_STEPS
    assert (episode.steps, len(episode.q)) == (25, 26)


def test_a_short_episode_is_the_beginning_of_the_long_one():
    for name in ("q", "dtheta", "jacobian"):
        short = getattr(short_episode(), name)
        assert np.array_equal(short, getattr(recorded(), name)[: len(short)])


def fails_at(step: int):
    """A solve that finds five steps and then none."""
    backend, posed = get_method("daqp"), []

    def solve(problem, q):
        posed.append(q)
        if len(posed) > step:
            return JointStep(None, StepStatus.NOT_FOUND, "gave in")
        return backend.step(problem, AS_RECORDED)

    return By(solve)


def test_a_failed_solve_stops_the_arm_where_it_is():
    episode = wind(WindingSettings(), fails_at(5))
    assert episode.outcome is Outcome.SOLVER_FAILED
    assert (episode.steps, len(episode.q)) == (6, 7)
    assert np.array_equal(episode.q[6], episode.q[5])


def test_a_failed_solve_is_recorded_without_a_step():
    episode = wind(WindingSettings(), fails_at(5))
    assert np.isnan(episode.dtheta[5]).all()
    assert np.isfinite(episode.dtheta[:5]).all()
    assert episode.status.tolist() == ["SOLVED"] * 5 + ["NOT_FOUND"]


def test_a_failed_solve_keeps_the_solvers_words(tmp_path):
    episode = wind(WindingSettings(), fails_at(0))
    episode.save(tmp_path / "failed.npz")
    assert Episode.load(tmp_path / "failed.npz").message == f"{StepStatus.NOT_FOUND.value}. gave in"


def test_the_solve_is_told_where_the_arm_is():
    seen = []
    backend = get_method("daqp")

    def solve(problem, q):
        seen.append(q.tobytes())
        return backend.step(problem, AS_RECORDED)

    episode = wind(WindingSettings(max_steps=4), By(solve))
    assert seen == [q.tobytes() for q in episode.q[:-1]]


def test_an_arm_that_touches_nothing_is_lost_at_once(tmp_path):
    episode = wind(WindingSettings(gap=3e-3, contact_distance=2e-3))
    assert (episode.outcome, episode.steps, len(episode.q)) == (Outcome.LOST, 0, 1)
    assert episode.jacobian.shape == (0, 51, 49)


def test_an_episode_without_steps_survives_its_file(tmp_path):
    episode = wind(WindingSettings(gap=3e-3, contact_distance=2e-3))
    episode.save(tmp_path / "lost.npz")
    assert differing(Episode.load(tmp_path / "lost.npz"), episode, ARRAYS) == []


def test_an_episode_of_an_unknown_solver_does_not_start():
    with pytest.raises(SolverUnavailableError):
        wind(WindingSettings(solver="sorcery"))


def test_the_closed_form_winds_without_rows_or_bounds():
    episode = wind(WindingSettings(solver=CLOSED_FORM, limits=False, contacts=False, max_steps=3))
    assert set(episode.status) == {"CLOSED_FORM"}
    assert not np.isfinite(episode.upper).any()
    assert not np.isfinite(episode.row_upper).any()
