"""Why a winding is not one by turns and depth: what went wrong first, read off its record."""

from collections.abc import Iterator
from enum import Enum
from typing import Any

import numpy as np

from paper_repro.make.jobs import Job
from paper_repro.measure.windings import DEEPEST, FOLDED, figures_of, is_turned, wound_to
from prioritized_ik.winding.episode import Episode, Outcome, wind
from prioritized_ik.winding.metrics import bends
from prioritized_ik.winding.plan import first_and_last_in_contact
from prioritized_ik.winding.settings import WindingSettings


class Reason(Enum):
    """What went wrong first; the name is its letter in figures."""

    T = "free tail in the object: a link beyond the driven one is deeper than contact"
    P = "pushed in: the driven link or a wound one is deeper than contact"
    F = "folded: a link touches, and stays, bent by more than a right angle against the one before"
    L = "lost: no link is in contact any more"
    N = "no end: no equilibrium within the allowed steps"
    S = "short: turns are missing, and none of the others"


def examined_job(chosen: WindingSettings) -> Job:
    """Return the job of one winding: see `examined`."""
    return Job(examined, {"settings": chosen.to_json()})


def examined(settings: str) -> dict[str, Any]:
    """Return what `measured` returns, the `largest_step` of a joint [rad], and the name of the `reason` if it failed."""
    episode = wind(WindingSettings.from_json(settings))
    reason = reason_of(episode)
    return {
        **figures_of(episode),
        "largest_step": float(np.abs(episode.dtheta).max(initial=0.0)),
        "reason": None if reason is None else reason.name,
    }


def reason_of(episode: Episode) -> Reason | None:
    """Return what went wrong first, None if the arm is wound by turns and depth."""
    if is_turned(figures_of(episode)):
        return None
    return min(_events(episode), key=lambda event: event[0])[1]


def _events(episode: Episode) -> Iterator[tuple[float, Reason]]:
    """Yield what went wrong, and the state at which it did."""
    k = wound_to(episode)
    deep = np.argwhere(episode.distance < -DEEPEST)
    if len(deep):
        state, link = deep[0]
        driven = k[max(state - 1, 0)] + 1  # when the step was posed that led here
        yield float(state), Reason.T if link + 1 > driven else Reason.P
    folded = _folded_since(episode)
    if folded is not None:
        yield float(folded), Reason.F
    if episode.outcome is Outcome.LOST:
        yield float(episode.steps), Reason.L
    if episode.outcome is Outcome.OUT_OF_STEPS:
        yield float(episode.steps), Reason.N
    yield np.inf, Reason.S


def _folded_since(episode: Episode) -> int | None:
    """Return the first of the states, on to the last, at which one link is in contact and folded back on the one before."""
    first = max(first_and_last_in_contact(episode.in_contact[0])[0], 1)
    folded = episode.in_contact[:, 1:] & (bends(episode.directions) > FOLDED)
    since = [
        len(held) - int(np.argmin(held[::-1])) if not held.all() else 0 for held in folded[:, first - 1 :].T if held[-1]
    ]
    return min(since, default=None)
