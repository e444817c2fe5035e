"""The windings that a comparison runs: the product of what is swept, or the user's own recorded episodes."""

import hashlib
import itertools
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from comparisons.settings import RECORDER, ComparisonSettings
from prioritized_ik.errors import EpisodeFileError, InputError
from prioritized_ik.files import UNREADABLE
from prioritized_ik.models import Arm
from prioritized_ik.winding.episode import Episode
from prioritized_ik.winding.settings import WindingSettings


@dataclass(frozen=True)
class Case:
    """One winding.

    Attributes:
        name: what tells it from the others: the direction and what else is swept: `up link=6 tilt=0.3`.
        winding: how it is recorded.
        file: where it is recorded already; None if the comparison records it.
    """

    name: str
    winding: WindingSettings
    file: Path | None = None

    @property
    def one_level(self) -> bool:
        """Whether its problems have one level, as the damped formulation and mink need."""
        return self.winding.weights != "strict"


def cases_of(settings: ComparisonSettings) -> list[Case]:
    """Return the cases of a comparison.

    Raises:
        InputError: a combination that is no winding.
        EpisodeFileError: the folder of recorded episodes holds a file that is neither an episode nor a QP.
    """
    if settings.recorded:
        return [Case(path.stem, Episode.load(path).settings, path) for path in own_files(settings.recorded)[0]]
    cases = []
    swept: dict[str, tuple[Any, ...]] = {
        "links": settings.links, "link": settings.link, "object": settings.shapes, "diameter": settings.diameter,
        "tilt": settings.tilt, "seed": settings.seeds or (0,),
    }  # fmt: skip
    for direction, *values in itertools.product(settings.directions, *swept.values()):
        links, link, shape, diameter, tilt, seed = values
        named = [f"{name}={value}" for (name, all_), value in zip(swept.items(), values, strict=True) if len(all_) > 1]
        winding = WindingSettings(
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
        cases.append(Case(" ".join([direction, *named]), winding))
    return cases


def own_files(folder: str) -> tuple[list[Path], list[Path]]:
    """Return the episodes and the QPs among the .npz files of a folder.

    Episodes are what `wind --save` writes, QPs what `qpsolvers.Problem.save` does.

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
        raise InputError(f"{folder!r} holds no .npz file; expected episodes of `wind --save`, or QPs of `Problem.save`.")
    return episodes, qps


def file_name(*parts: object) -> str:
    """Return a file name for what `parts` name together: legible, and different for different parts."""
    text = "__".join(re.sub(r"[^A-Za-z0-9.=-]+", "_", str(part)) for part in parts)
    return text if text == "__".join(map(str, parts)) else f"{text[:120]}-{_digest(repr(parts).encode())}"


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:10]
