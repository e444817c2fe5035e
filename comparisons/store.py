"""The results of a comparison, in a folder: one long table of steps, one of driven windings, and their episodes.

    settings.json                   what made it: settings, versions, program
    recorded/<case>.npz             the recorded episode
    recorded/<case>.mjb             of a scene, its model
    driven/<job>.npz                the episode of a driven winding
    parts/recorded/<case>.parquet   which steps of a recorded episode are replayed
    parts/steps/<job>.parquet       one row a replayed problem
    parts/episodes/<job>.parquet    the figures of a driven winding
    parts/qps/<job>.parquet         of the user's own QPs
    report.html, table.md, <table>.parquet      what the command makes of these at its end, see `MADE_OF_IT`

A part is written when its job is done, whole or not at all, so that a run killed at any moment leaves whole parts only, and
the next one does what is missing. Parts of other settings, versions or programs are never mixed: such a folder is refused.
Two runs at a time in one folder are not provided for.
"""

import hashlib
import json
import shutil
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

import mujoco
import polars

from comparisons.cases import Case, file_name
from comparisons.compared import compared
from comparisons.episodes import Recorded, load_record
from comparisons.tables import EPISODES, JOB, ORIGIN, QPS, STEPS, Schema
from prioritized_ik.errors import EpisodeFileError, InputError
from prioritized_ik.files import advising, write_whole
from prioritized_ik.problem import IKProblem
from prioritized_ik.scene.scene import Scene

PARTS: dict[str, Schema] = {
    "steps": {**JOB, **STEPS, **ORIGIN},
    "episodes": {**JOB, **EPISODES, **ORIGIN},
    "qps": {**QPS, **ORIGIN},
    "recorded": {"step": polars.Int64, "free": polars.Boolean},
}
FOLDERS = (*(f"parts/{kind}" for kind in PARTS), "driven", "recorded")  # what is made of others before them
SETTINGS = "settings.json"
TABLES = ("steps", "episodes", "success", "rows", "qps")
MADE_OF_IT = ("report.html", "table.md", *(f"{table}.parquet" for table in TABLES))
EPISODES_AT_HAND = 4


class Store:
    """Reads and writes the results in `folder`, which `create` made.

    Attributes:
        folder: where they are; `file` of an episode starts from it.
        recorded: returns the record of a case, by name.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._steps: polars.DataFrame | None = None
        self.recorded = lru_cache(EPISODES_AT_HAND)(self._recorded)

    @staticmethod
    def create(folder: Path, made_by: dict[str, Any], facts: dict[str, Any]) -> "Store":
        """Return the store in `folder`, empty or with what a run with the same settings left there.

        Args:
            folder: made if it does not exist.
            made_by: what decides the figures, as JSON; a folder in which some of it differs is refused.
            facts: whatever else is to be known.

        Raises:
            InputError: the folder was made by something else, named; or cannot be written.
        """
        store = Store(folder)
        made_by = json.loads(json.dumps(made_by))
        if (folder / SETTINGS).exists():
            found = store._settings()["made_by"]
            differences = list(_differences(found, made_by))
            if differences:
                raise InputError(
                    f"{str(folder)!r} holds results of a run with other settings: {'; '.join(differences)}. "
                    "Choose another folder, or start over with --fresh."
                )
        with advising("write into", folder):
            for name in FOLDERS:
                (folder / name).mkdir(parents=True, exist_ok=True)
                for left in (folder / name).glob(".*.part"):  # by a run that was killed
                    left.unlink()
        text = json.dumps({"made_by": made_by, "facts": facts}, indent=1, ensure_ascii=False, default=str)
        store.write_file(SETTINGS, lambda file: file.write(text.encode()))
        return store

    @staticmethod
    def clear(folder: Path) -> None:
        """Delete the results in `folder`, if it is one of a store, and nothing else.

        What is made of others goes before them, so that one killed at any moment leaves a store that lacks something.

        Raises:
            InputError: its `settings.json` is not one of a store, or something cannot be deleted.
        """
        if not (folder / SETTINGS).exists():
            return
        Store(folder)._settings()
        with advising("delete the results in", folder, advice="choose another folder"):
            for name in MADE_OF_IT:
                (folder / name).unlink(missing_ok=True)
            for name in FOLDERS:
                if (folder / name).exists():
                    shutil.rmtree(folder / name)
            (folder / SETTINGS).unlink()

    def facts(self) -> dict[str, Any]:
        """Return versions, processor, settings, git revision: what was known when it was made."""
        facts: dict[str, Any] = self._settings()["facts"]
        return facts

    def steps(self) -> polars.DataFrame:
        """Return the long table: one row for each case, step, solver, formulation, accuracy, start and repeat.

        Its columns are those of `tables`: `JOB`, `STEPS`, `ORIGIN` and `COMPARED`.
        """
        if self._steps is None:
            order = ["case", "solver", "formulation", "accuracy", "start", "repeat", "step"]
            self._steps = compared(self._table("steps").sort(order))
        return self._steps

    def episodes(self) -> polars.DataFrame:
        """Return one row for each driven winding: columns `JOB`, `EPISODES` and `ORIGIN` of `tables`."""
        return self._table("episodes").sort("case", "solver", "formulation", "accuracy")

    def qps(self) -> polars.DataFrame:
        """Return one row for each of the user's own QPs, solver, accuracy and repeat: columns `QPS` and `ORIGIN`."""
        return self._table("qps").sort("qp", "solver", "accuracy", "repeat")

    def problem(self, case: str, step: int) -> IKProblem:
        """Return a recorded problem.

        Raises:
            EpisodeFileError: there is no such case.
            InputError: there is no such step.
        """
        return self.recorded(case).problem(step)

    def model(self, case: str) -> mujoco.MjModel | None:
        """Return the model of a case that is a scene.

        Raises:
            EpisodeFileError: its file cannot be read.
        """
        file = self._model_file(case)
        if not file.exists():
            return None
        try:
            return mujoco.MjModel.from_binary_path(str(file))
        except ValueError as error:
            raise EpisodeFileError(f"cannot read {str(file)!r} ({error}); start over with --fresh.") from error

    def _model_file(self, case: str) -> Path:
        return self.folder / f"recorded/{file_name(case)}.mjb"

    def _recorded(self, case: str) -> Recorded:
        """Return the recorded episode of a case."""
        return load_record(self.folder / f"recorded/{file_name(case)}.npz")

    def replayed(self, case: str) -> list[int]:
        """Return which steps of the recorded episode are replayed."""
        numbers: list[int] = polars.read_parquet(self.folder / f"parts/recorded/{file_name(case)}.parquet")[
            "step"
        ].to_list()
        return numbers

    def parts(self, kind: str) -> set[str]:
        """Return the names of the parts of one of `PARTS` that are there."""
        return {path.stem for path in (self.folder / "parts" / kind).glob("*.parquet")}

    def add(self, kind: str, name: str, rows: list[dict[str, Any]]) -> None:
        """Write one part.

        Raises:
            InputError: it cannot be written.
        """
        self._steps = None
        frame = polars.DataFrame(rows, schema=PARTS[kind], orient="row")
        self.write_file(f"parts/{kind}/{name}.parquet", frame.write_parquet)

    def add_case(self, case: Case, episode: bytes, free: Sequence[bool | None], replayed: list[int]) -> None:
        """Write the recorded episode of a case, of a scene its model, and which of its steps are replayed."""
        if isinstance(case.posed, Scene):
            with advising("write", self._model_file(case.name)):
                mujoco.mj_saveModel(case.posed.model, str(self._model_file(case.name)), None)
        self.write_file(f"recorded/{file_name(case.name)}.npz", lambda file: file.write(episode))
        self.add("recorded", file_name(case.name), [{"step": step, "free": free[step]} for step in replayed])

    def write_file(self, name: str, write: Callable[[BinaryIO], object]) -> None:
        """Write a file into the folder, whole or not at all.

        Raises:
            InputError: it cannot be written.
        """
        with advising("write", self.folder / name):
            write_whole(self.folder / name, write)

    def digest(self) -> str:
        """Return the beginning of the SHA-256 of what made the folder."""
        return hashlib.sha256(json.dumps(self._settings()["made_by"], sort_keys=True).encode()).hexdigest()[:12]

    def _settings(self) -> dict[str, Any]:
        try:
            content: dict[str, Any] = json.loads((self.folder / SETTINGS).read_text(encoding="utf-8"))
            content["made_by"], content["facts"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(
                f"cannot read {str(self.folder / SETTINGS)!r} ({error}); expected the folder of a comparison."
            ) from error
        return content

    def _table(self, kind: str) -> polars.DataFrame:
        schema = PARTS[kind]
        files = sorted((self.folder / "parts" / kind).glob("*.parquet"))
        if not files:
            return polars.DataFrame(schema=schema)
        return polars.read_parquet(files, schema=schema)


def _differences(found: dict[str, Any], wanted: dict[str, Any], name: str = "") -> "list[str]":
    """Return what differs between two JSON objects, by name, with both values."""
    told = []
    for key in {**found, **wanted}:
        one, other = found.get(key), wanted.get(key)
        if isinstance(one, dict) and isinstance(other, dict):
            told += _differences(one, other, f"{key} of " if not name else name)
        elif one != other:
            told.append(f"{name}{key} was {_told(one)} there and is {_told(other)} now")
    return told


def _told(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "nothing"
    return "nothing" if value is None else str(value)
