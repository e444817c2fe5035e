"""Driven windings as the page replays them: where the arm was and what it touched, in whole numbers."""

import base64
from pathlib import Path
from typing import Any

import numpy as np
import polars

from comparisons.page.series import Key, labels
from prioritized_ik.winding.episode import Episode

LARGEST = 32767  # of the whole numbers that coordinates are stored as: 0.02 mm steps over an arm of 1 m
SHOWN_LENGTH = 2.2  # half length of a cylinder or capsule in a picture, in radii

#: All windings together take this many bytes of a page at most. Beyond, states between are left out, and the page says so.
BUDGET = 4_000_000

FIGURES = ("turns", "turns_ratio", "penetration", "bend", "drift")


def replays(folder: Path, episodes: polars.DataFrame) -> dict[str, Any]:
    """Return `every` (which of the states are kept) and `windings`, one for each saved episode of a winding.

    Args:
        folder: where the episodes' files are.
        episodes: the table of `Source.episodes`.

    Raises:
        EpisodeFileError: a file that the table names is damaged or not there.
    """
    windings_of = episodes.filter(polars.col("file").is_not_null() & polars.col("turns").is_not_null())
    saved = list(windings_of.sort("case", maintain_order=True).iter_rows(named=True))
    states = sum(int(row["steps"]) + 1 for row in saved)
    loaded = ((row, Episode.load(folder / row["file"])) for row in saved)
    names = dict(zip(keys := list(dict.fromkeys(_key(row) for row in saved)), labels(keys), strict=True))
    every = 0
    windings: list[dict[str, Any]] = []
    for row, episode in loaded:
        # All arms are about as long as the first.
        every = every or max(1, -(-states * _bytes_a_state(episode) // BUDGET))
        windings.append(
            {
                "case": row["case"],
                "label": names[_key(row)],
                "formulation": row["formulation"],
                "outcome": row["outcome"] or "",
                "message": row["message"] or "",
                **{name: _number(row.get(name)) for name in FIGURES},
                **moved(episode, every),
            }
        )
    return {"every": max(every, 1), "windings": windings}


def moved(episode: Episode, every: int) -> dict[str, Any]:
    """Return the motion of an episode, each `every`-th state and the last.

    `at`: the numbers of the states; `positions`: base64 of 16-bit numbers (states, links, 3), little-endian, which are
    `centre` + number × `unit` in metres; `contact`: base64 of bits (states, links), each state from a byte of its own.
    """
    last = len(episode.positions) - 1
    chosen = np.unique([*range(0, last, every), last])
    positions = episode.positions[chosen]
    low, high = positions.min(axis=(0, 1)), positions.max(axis=(0, 1))
    centre, unit = 0.5 * (low + high), max(float((high - low).max()), 1e-9) / (2 * LARGEST)
    whole = np.round((positions - centre) / unit).astype("<i2")
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
        "positions": _base64(whole.tobytes()),
        "contact": _base64(np.packbits(episode.in_contact[chosen], axis=1).tobytes()),
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


def _base64(content: bytes) -> str:
    return base64.b64encode(content).decode("ascii")


def _number(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.4g}")
