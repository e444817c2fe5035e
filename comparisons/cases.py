"""What a comparison runs: windings, the product of what is swept; scenes; or what the user recorded."""

import hashlib
import itertools
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from comparisons.episodes import Posed, has_one_level, load_record
from comparisons.settings import RECORDER, ComparisonSettings
from prioritized_ik.errors import EpisodeFileError, InputError
from prioritized_ik.files import UNREADABLE
from prioritized_ik.models import Arm
from prioritized_ik.scene.task_file import load_scene
from prioritized_ik.winding.episode import Episode
from prioritized_ik.winding.settings import WindingSettings


@dataclass(frozen=True)
class Case:
    """One episode: a winding, a scene, or problems that were recorded.

    Attributes:
        name: what tells it from the others: of a winding, the direction and what else is swept: `up link=6 tilt=0.3`.
        posed: what poses its problems; None where nobody knows, so that nobody drives it.
        file: where it is recorded already; None if the comparison records it.
        one_level: whether its problems have one level, as the damped formulation and mink need.
    """

    name: str
    posed: Posed | None
    file: Path | None = None
    one_level: bool = True

    @property
    def winding(self) -> WindingSettings | None:
        """How it is wound, if it is a winding."""
        return self.posed if isinstance(self.posed, WindingSettings) else None


def cases_of(settings: ComparisonSettings) -> list[Case]:
    """Return the cases of a comparison.

    Raises:
        InputError: a combination that is no winding.
        EpisodeFileError: the folder of recorded episodes holds a file that is neither an episode nor a QP.
    """
    if settings.recorded:
        return [_recorded(path) for path in own_files(settings.recorded)[0]]
    if settings.scenes:
        return [_scene(Path(file)) for file in settings.scenes]
    return [Case(name, winding) for name, winding in windings_of(settings).items()]


def windings_of(settings: ComparisonSettings) -> dict[str, WindingSettings]:
    """Return the windings that are the product of what is swept, by name.

    Raises:
        InputError: a combination that is no winding.
    """
    windings = {}
    swept: dict[str, tuple[Any, ...]] = {
        "links": settings.links, "link": settings.link, "object": settings.shapes, "diameter": settings.diameter,
        "tilt": settings.tilt, "seed": settings.seeds or (0,),
    }  # fmt: skip
    for direction, *values in itertools.product(settings.directions, *swept.values()):
        links, link, shape, diameter, tilt, seed = values
        named = [f"{name}={value}" for (name, all_), value in zip(swept.items(), values, strict=True) if len(all_) > 1]
        windings[" ".join([direction, *named])] = WindingSettings(
            arm=Arm(links=links),
            shape=shape,
            size=(diameter / 2.0,) if shape == "sphere" else (diameter / 2.0, 0.5),
            direction=direction,
            link=link,
            tilt=tilt,
            posture="random" if settings.seeds else "straight",
            seed=seed,
            solver=RECORDER,
            options=settings.options(),
        )
    return windings


def _recorded(path: Path) -> Case:
    record = load_record(path)
    return Case(path.stem, record.settings if isinstance(record, Episode) else None, path, has_one_level(record))


def _scene(path: Path) -> Case:
    scene = load_scene(path)
    return Case(path.stem, scene, one_level=len({task.level for task in scene.tasks}) == 1)


def own_files(folder: str) -> tuple[list[Path], list[Path]]:
    """Return the records and the QPs among the .npz files of a folder.

    Records are what `wind --save`, `solve --save` and `save_problem` write, QPs what `qpsolvers.Problem.save` does.

    Raises:
        InputError: there is neither.
        EpisodeFileError: one is something else, or damaged.
    """
    import numpy as np

    episodes, qps = [], []
    for path in sorted(Path(folder).glob("*.npz")):
        try:
            with open(path, "rb") as raw, np.load(raw, allow_pickle=False) as content:
                names = set(content.files)
        except UNREADABLE as error:
            raise EpisodeFileError(f"cannot read {str(path)!r} ({error}); expected a saved episode or QP.") from error
        if {"P", "q"} <= names:
            qps.append(path)
        else:
            episodes.append(path)
    if not episodes and not qps:
        raise InputError(
            f"{folder!r} holds no .npz file; expected episodes of `wind --save` or `solve --save`, problems of "
            "`save_problem`, or QPs of `Problem.save`."
        )
    return episodes, qps


def file_name(*parts: object) -> str:
    """Return a file name for what `parts` name together: legible, and different for different parts."""
    text = "__".join(re.sub(r"[^A-Za-z0-9.=-]+", "_", str(part)) for part in parts)
    return text if text == "__".join(map(str, parts)) else f"{text[:120]}-{_digest(repr(parts).encode())}"


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:10]
