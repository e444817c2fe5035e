"""Windings as jobs: every figure of an episode, and its story in a few poses. Shared by the artefacts that need them."""

import math
from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

import numpy as np

from paper_repro.make.jobs import Job
from prioritized_ik.solvers.registry import DEFAULT
from prioritized_ik.solvers.step import StepStatus
from prioritized_ik.winding.episode import Episode, Outcome, wind
from prioritized_ik.winding.metrics import bends, measure
from prioritized_ik.winding.plan import first_and_last_in_contact
from prioritized_ik.winding.settings import WindingSettings

#: Drives the arm, in every method: the fastest. Certified steps do not depend on the solver, and where there are neither
#: limits nor contact rows they are the closed form's, Eqs. (12) to (14) and nothing else.
DRIVER = DEFAULT

METHODS = ("closed form", "qp")
METHOD_NAMES = {"closed form": "closed form", "qp": "QP"}

# When an arm counts as wound: in three terms, each stricter than the one before. The paper speaks of contact alone, which
# an arm folded back on itself reaches too, and one that went through the object.
WELL_WOUND = 0.95  # of the ideal turns: the first and the last link may touch off their middles, and no more is missing
DEEPEST = 2e-3  # [m] the distance at which a link reports contact: what the arm cannot feel cannot be held against it
FOLDED = 0.5 * math.pi  # [rad] a link turned by more points back along the one before; the ideal is 41°

#: First links of the windings that are shown at length. From the first the closed form winds, with a straight arm and an
#: untilted object, from every direction; the second is the default, with more than a turn left to wind.
SHORT, LONG = 12, 6

#: The three terms, and their columns; see `judged`.
TERMS = ("in contact", "turned", "within range")
TERM_TITLES = ("wound: all links in contact", "wound: by turns and depth", "wound: within a joint's range")

CRITERION = (
    "*Wound* in three terms, each with those before it. *All links in contact*: M says so, the paper's own term. *By turns "
    f"and depth*: at least {WELL_WOUND:g} of the ideal turns, and no link ever deeper than {1e3 * DEEPEST:g} mm in the "
    "object. *Within a joint's range*: no link ever bent by more than a right angle against the one before; the paper "
    "states no range"
)


def judged(figures: dict[str, Any]) -> tuple[bool, bool, bool]:
    """Return whether an arm is wound in each of `TERMS`, from the answer of `measured` or `story`."""
    contact = figures["outcome"] == Outcome.WOUND.name
    turned = contact and figures["turns_ratio"] >= WELL_WOUND and figures["penetration"] <= DEEPEST
    return contact, bool(turned), bool(turned and figures["bend"] <= FOLDED)


def counted(windings: Iterable[dict[str, Any]]) -> tuple[int, int, int]:
    """Return how many windings are wound in each of `TERMS`."""
    contact, turned, in_range = np.sum([judged(figures) for figures in windings], axis=0).tolist()
    return contact, turned, in_range


def is_turned(figures: dict[str, Any]) -> bool:
    """Return whether an arm is wound by turns and depth, from the answer of `measured` or `story`."""
    return judged(figures)[1]


def is_within_range(figures: dict[str, Any]) -> bool:
    """Return whether an arm is wound in all of `TERMS`, from the answer of `measured` or `story`."""
    return judged(figures)[2]


def settings(method: str = "qp", **changes: Any) -> WindingSettings:
    """Return the settings of one winding.

    Args:
        method: `qp`, with limits and contact rows, or `closed form`, Eqs. (12) to (14) alone.
        changes: to `WindingSettings`.
    """
    free = {"limits": False, "contacts": False} if method == "closed form" else {}
    return WindingSettings(**{"solver": DRIVER, **free, **changes})


def measured_job(chosen: WindingSettings) -> Job:
    """Return the job of one winding: see `measured`."""
    return Job(measured, {"settings": chosen.to_json()})


def measured(settings: str) -> dict[str, Any]:
    """Return every figure of a winding.

    The fields of `WindingMetrics`, those of `motions`, how often a link lost its contact as `contacts_lost`, the `outcome`,
    its `message`, and how many steps ended how by `status`.
    """
    return figures_of(wind(WindingSettings.from_json(settings)))


def figures_of(episode: Episode) -> dict[str, Any]:
    """Return the answer of `measured` for an episode."""
    statuses = {status.name: int(np.count_nonzero(episode.status == status.name)) for status in StepStatus}
    return {
        **asdict(measure(episode)),
        **motions(episode),
        "contacts_lost": int(np.count_nonzero(episode.in_contact[:-1] & ~episode.in_contact[1:])),
        "outcome": episode.outcome.name,
        "message": episode.message,
        "status": statuses,
    }


def motions(episode: Episode) -> dict[str, float]:
    """Return how much moves that is not wound yet.

    `tail_path`, the length of the path of the arm's end [m]; and of the virtual end points k + 2 … n, for as long as they
    are such, `free_path`, the sum of their paths [m], and `free_step`, how far one of them moves in a step on average [m].
    """
    moved = np.linalg.norm(np.diff(episode.positions, axis=0), axis=2)  # (T, n)
    arms = np.arange(1, moved.shape[1] + 1)
    free = arms > wound_to(episode)[: len(moved), None] + 1
    path = float(moved[free].sum())
    return {
        "tail_path": float(moved[:, -1].sum()),
        "free_path": path,
        "free_step": path / max(int(np.count_nonzero(free)), 1),
    }


def wound_to(episode: Episode) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Return k of Eqs. (23) and (24), the last of the links in successive contact, in each state `(T + 1,)`."""
    return np.array([first_and_last_in_contact(contact)[1] for contact in episode.in_contact])


def story_job(chosen: WindingSettings, stages: int = 6, every: int = 0) -> Job:
    """Return the job of one winding in a few poses: see `story`."""
    return Job(story, {"settings": chosen.to_json(), "stages": stages, "every": every})


def story(settings: str, stages: int, every: int = 0) -> dict[str, Any]:
    """Return a winding as its reader sees it.

    `q` `(stages, m)` [rad], `positions` `(stages, n, 3)` [m] and `in_contact` `(stages, n)` of the states `shown`: evenly
    spaced ones, or every `every` steps if that is not 0, the first and the last included in any case; the path of the
    arm's end `tail` `(T + 1, 3)` [m]; of each state `(T + 1)` the largest `penetration_path` [m] and `bend_path` [rad], and
    `wound_to`, k; `outcome`, and the fields of `WindingMetrics` and of `motions`.
    """
    episode = wind(WindingSettings.from_json(settings))
    last = episode.steps
    steps = np.r_[0:last:every, last] if every else np.unique(np.linspace(0, last, stages).round().astype(int))
    return {
        **asdict(measure(episode)),
        **motions(episode),
        "outcome": episode.outcome.name,
        "shown": steps.tolist(),
        "q": episode.q[steps].tolist(),
        "positions": episode.positions[steps].tolist(),
        "in_contact": episode.in_contact[steps].tolist(),
        "tail": episode.positions[:, -1].tolist(),
        "penetration_path": (-episode.distance.min(axis=1)).tolist(),
        "bend_path": bends(episode.directions).max(axis=1).tolist(),
        "wound_to": wound_to(episode).tolist(),
    }
