"""What a comparison records and drives: the winding of an arm, or the scene of a task file."""

import io
import tempfile
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from comparisons.tables import Record
from prioritized_ik.errors import EpisodeFileError
from prioritized_ik.files import UNREADABLE
from prioritized_ik.problem_file import FORMAT as PROBLEM
from prioritized_ik.problem_file import load_problem
from prioritized_ik.recording import FORMAT as RECORDING
from prioritized_ik.recording import Recording
from prioritized_ik.scene.scene import Scene, SceneRun
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.methods import Method
from prioritized_ik.winding.episode import Episode, Outcome, wind
from prioritized_ik.winding.metrics import measure
from prioritized_ik.winding.settings import CLOSED_FORM, WindingSettings

Posed = WindingSettings | Scene  # what poses problems
Played = Episode | SceneRun  # what comes of it
Recorded = Episode | Recording  # what is kept of it in a file


def driven_by(posed: Posed, method: str, options: SolveOptions) -> Posed:
    """Return what is driven by a method: the same, but for the closed form, which knows no limits."""
    free = method == CLOSED_FORM
    if isinstance(posed, WindingSettings):
        posed = replace(posed, limits=False, contacts=False) if free else posed
        return replace(posed, solver=method, options=options)
    return replace(posed, limits=()) if free else posed


def play(posed: Posed, method: Method | None, options: SolveOptions, on_step: Callable[[int], object]) -> Played:
    """Return what comes of what is posed.

    Args:
        posed: a winding or a scene.
        method: finds the steps; None for the one that a winding names.
        options: of a scene; a winding has its own.
        on_step: called after each step with how many there are.
    """
    if isinstance(posed, WindingSettings):
        return wind(posed, method, on_step=on_step)
    steps = []
    for step in posed.steps(method, options):
        steps.append(step)
        on_step(len(steps))
    return posed.ended(steps)


def figures_of(played: Played) -> Record:
    """Return what `tables.EPISODES` has of it."""
    if isinstance(played, Episode):
        return {**asdict(measure(played)), "outcome": played.outcome.name, "message": played.message}
    required = [name for names in played.levels[: played.scene.required] for name in names]
    return {
        "outcome": played.ending.name,
        "message": played.steps[-1].step.message,
        "steps": len(played.steps),
        "error": max(played.errors[name] for name in required),
    }


def ended_well(outcome: str, record: Recorded) -> bool:
    """Return whether an episode that was driven ended wound, or, of a scene, as it ended when it was recorded."""
    return outcome == (Outcome.WOUND.name if isinstance(record, Episode) else record.ending)


def content_of(played: Played) -> bytes:
    """Return the file of it."""
    file = io.BytesIO()
    (played if isinstance(played, Episode) else played.recording()).write(file)
    return file.getvalue()


def record_of(content: bytes) -> Recorded:
    """Return the record whose file is `content`."""
    with tempfile.NamedTemporaryFile(suffix=".npz") as file:
        file.write(content)
        file.flush()
        return load_record(Path(file.name))


def load_record(path: Path) -> Recorded:
    """Return the record of a file: an episode, a recording, or one saved problem.

    Raises:
        EpisodeFileError: it is none of these, or damaged.
    """
    kind = _format_of(path)
    if kind == PROBLEM:
        problem = load_problem(path)
        return Recording.of([problem], np.zeros((1, 0)), np.full((1, problem.joint_count), np.nan))
    return Recording.load(path) if kind == RECORDING else Episode.load(path)


def has_one_level(record: Recorded) -> bool:
    """Return whether its problems have one level, as the damped formulation needs."""
    if isinstance(record, Episode):
        return record.settings.weights != "strict"
    return all(len(problem.levels) == 1 and not problem.levels[0].is_soft for problem in record.problems())


def _format_of(path: Path) -> str | None:
    """Return what a `.npz` file says that it is; None of one that says nothing, or is none."""
    try:
        with open(path, "rb") as raw, np.load(raw, allow_pickle=False) as content:
            return str(content["format"]) if "format" in content.files else None
    except UNREADABLE as error:
        raise EpisodeFileError(
            f"cannot read {str(path)!r} ({error}); expected a saved episode, recording, problem or QP."
        ) from error
