"""Driven episodes as the page replays them: where the arm was and what it touched; of scenes, where each geom was."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import polars

from comparisons.page.quantised import base64_of, quantised
from comparisons.page.scenes import Drawn
from comparisons.page.series import Key, labels
from prioritized_ik.recording import Recording
from prioritized_ik.winding.episode import Episode

SHOWN_LENGTH = 2.2  # half length of a cylinder or capsule in a picture, in radii

#: All episodes together take this many bytes of a page at most. Beyond, states between are left out, and the page says so.
BUDGET = 4_000_000

FIGURES = ("turns", "turns_ratio", "penetration", "bend", "drift", "error")


def replays(folder: Path, episodes: polars.DataFrame, model: Callable[[str], mujoco.MjModel | None]) -> dict[str, Any]:
    """Return `every` (which of the states are kept) and `windings`, one for each saved episode of a winding or a scene.

    Args:
        folder: where the episodes' files are.
        episodes: the table of `Source.episodes`.
        model: see `Source.model`.

    Raises:
        EpisodeFileError: a file that the table names is damaged or not there.
    """
    saved = list(episodes.filter(polars.col("file").is_not_null()).sort("case", maintain_order=True).iter_rows(named=True))
    saved = [row for row in saved if row["turns"] is not None or model(row["case"]) is not None]
    states = sum(int(row["steps"]) + 1 for row in saved)
    names = dict(zip(keys := list(dict.fromkeys(_key(row) for row in saved)), labels(keys), strict=True))
    every = 0
    windings: list[dict[str, Any]] = []
    for row in saved:
        shown = _shown(folder / row["file"], model(row["case"]))
        # All arms are about as long as the first.
        every = every or max(1, -(-states * shown.bytes_a_state // BUDGET))
        windings.append(
            {
                "case": row["case"],
                "label": names[_key(row)],
                "formulation": row["formulation"],
                "outcome": row["outcome"] or "",
                "message": row["message"] or "",
                **{name: _number(row.get(name)) for name in FIGURES},
                **shown.moved(every),
            }
        )
    return {"every": max(every, 1), "windings": windings}


@dataclass(frozen=True)
class _Shown:
    """An episode that can be shown: what one state takes of a page, and its motion, given which states are kept."""

    bytes_a_state: int
    moved: Callable[[int], dict[str, Any]]


def _shown(file: Path, model: mujoco.MjModel | None) -> _Shown:
    if model is None:
        episode = Episode.load(file)
        return _Shown(_bytes_a_state(episode), partial(moved, episode))
    drawn = Drawn.of(model)
    return _Shown(drawn.bytes_a_state, partial(drawn.moved, Recording.load(file)))


def moved(episode: Episode, every: int) -> dict[str, Any]:
    """Return the motion of an episode, each `every`-th state and the last.

    `at`: the numbers of the states; `positions`: base64 of 16-bit numbers (states, links, 3), little-endian, which are
    `centre` + number × `unit` in metres; `contact`: base64 of bits (states, links), each state from a byte of its own.
    """
    last = len(episode.positions) - 1
    chosen = np.unique([*range(0, last, every), last])
    positions = episode.positions[chosen]
    whole, centre, unit = quantised(positions)
    wound = episode.settings.wound_object()
    size = list(wound.size)
    if wound.shape in ("cylinder", "capsule"):
        size[1] = min(size[1], SHOWN_LENGTH * size[0])  # a long object would hide the arm
    return {
        "at": chosen.tolist(),
        "links": positions.shape[1],
        "radius": episode.settings.arm.radius,
        "centre": centre.tolist(),
        "unit": unit,
        "positions": base64_of(whole.tobytes()),
        "contact": base64_of(np.packbits(episode.in_contact[chosen], axis=1).tobytes()),
        "object": {
            "shape": wound.shape,
            "size": size,
            "position": wound.position.tolist(),
            "rotation": wound.rotation.tolist(),
        },
    }


def _key(row: dict[str, Any]) -> Key:
    return row["solver"], row["formulation"], row.get("accuracy"), row.get("start")


def _bytes_a_state(episode: Episode) -> int:
    links = episode.settings.arm.links
    return (6 * links + -(-links // 8)) * 4 // 3


def _number(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.4g}")
