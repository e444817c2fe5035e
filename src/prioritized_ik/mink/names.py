"""What messages call mink's tasks, limits and rows: its classes, and the model's own names."""

from collections.abc import Sequence

import mink
import mujoco
import numpy as np
from mink.tasks import BaseTask

from prioritized_ik.validation import Array


def task_name(task: BaseTask) -> str:
    """Return a task's class and, where it has one, its frame: "FrameTask hand"."""
    frame = getattr(task, "frame_name", None)
    return type(task).__name__ if frame is None else f"{type(task).__name__} {frame}"


def numbered(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names, those that stand there several times with numbers from 1."""
    given = list(names)
    return tuple(
        name if given.count(name) == 1 else f"{name} {given[: place + 1].count(name)}" for place, name in enumerate(given)
    )


def row_name(model: mujoco.MjModel, limit: mink.Limit, name: str, place: int, row: Array) -> str:
    """Return what a row `(nv,)` of a limit is called: by its geoms, by the one joint it moves, or by its number from 1."""
    pairs = getattr(limit, "geom_id_pairs", ())
    if place < len(pairs):
        one, other = (model.geom(int(geom)).name or f"geom {geom}" for geom in pairs[place])
        return f"{name}: {one} – {other}"
    joints = np.unique(model.dof_jntid[np.flatnonzero(row)])
    if len(joints) == 1:
        return f"{name}: {model.joint(int(joints[0])).name or f'joint {joints[0] + 1}'}"
    return f"{name} row {place + 1}"
