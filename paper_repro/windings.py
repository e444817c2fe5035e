"""Windings as jobs: every figure of an episode, and its story in a few poses. Shared by the artefacts that need them."""

from dataclasses import asdict
from typing import Any

import numpy as np

from paper_repro.jobs import Job
from prioritized_ik.solvers.step import StepStatus
from prioritized_ik.winding.episode import wind
from prioritized_ik.winding.metrics import bends, measure
from prioritized_ik.winding.settings import CLOSED_FORM, WindingSettings

#: Drives the arm where a QP does. Certified steps do not depend on the solver, so this one may be fast.
DRIVER = "daqp-warm"


def settings(method: str = "qp", **changes: Any) -> WindingSettings:
    """Return the settings of one winding.

    Args:
        method: `qp`, with limits and contact rows, or `closed form`, Eqs. (12) to (14) alone.
        changes: to `WindingSettings`.
    """
    if method == "closed form":
        return WindingSettings(**{"limits": False, "contacts": False, **changes, "solver": CLOSED_FORM})
    return WindingSettings(**{"solver": DRIVER, **changes})


def measured_job(chosen: WindingSettings) -> Job:
    """Return the job of one winding: see `measured`."""
    return Job(measured, {"settings": chosen.to_json()})


def measured(settings: str) -> dict[str, Any]:
    """Return the fields of `WindingMetrics`, the `outcome`, its `message`, and how many steps ended how by `status`."""
    episode = wind(WindingSettings.from_json(settings))
    statuses = {status.name: int(np.count_nonzero(episode.status == status.name)) for status in StepStatus}
    return {**asdict(measure(episode)), "outcome": episode.outcome.name, "message": episode.message, "status": statuses}


def story_job(chosen: WindingSettings, stages: int = 6) -> Job:
    """Return the job of one winding in a few poses: see `story`."""
    return Job(story, {"settings": chosen.to_json(), "stages": stages})


def story(settings: str, stages: int) -> dict[str, Any]:
    """Return a winding as its reader sees it.

    `q` `(stages, m)` [rad], `positions` `(stages, n, 3)` [m] and `in_contact` `(stages, n)` of evenly spaced states
    `shown`, the first and the last included; the path of the arm's end `tail` `(T + 1, 3)` [m]; `penetration_path` [m] and
    `bend_path` [rad], the largest of each state `(T + 1)`; `outcome`, and the fields of `WindingMetrics`.
    """
    episode = wind(WindingSettings.from_json(settings))
    steps = np.unique(np.linspace(0, episode.steps, stages).round().astype(int))
    return {
        **asdict(measure(episode)),
        "outcome": episode.outcome.name,
        "shown": steps.tolist(),
        "q": episode.q[steps].tolist(),
        "positions": episode.positions[steps].tolist(),
        "in_contact": episode.in_contact[steps].tolist(),
        "tail": episode.positions[:, -1].tolist(),
        "penetration_path": (-episode.distance.min(axis=1)).tolist(),
        "bend_path": bends(episode.directions).max(axis=1).tolist(),
    }
