"""How well an episode wound. Pure functions of its record.

"Every link from k on reports contact" is not success: an arm folded back on itself reaches it too, even with the sign of
the contact vectors reversed. What counts is how far the wound links went round the object, and at what price.
"""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.validation import Array
from prioritized_ik.winding.episode import Episode
from prioritized_ik.winding.plan import driven_arms, first_and_last_in_contact

ROUND_SHAPES = ("cylinder", "capsule", "sphere")  # those whose ideal winding is a regular polygon's


@dataclass(frozen=True)
class WindingMetrics:
    """Figures of one episode.

    Attributes:
        turns: turns of the wound links about the object's axis.
        turns_ratio: over the geometric ideal; None for an object that is not round.
        penetration: deepest of any link at any time [m]; negative: the least clearance.
        bend: largest angle between neighbouring links at any time [rad].
        hinge_excess: how far any hinge was outside its range [rad]; negative inside.
        drift: largest motion of a link end after its link had been wound [m].
        steps: number of steps.
        driven_together: steps in which more than one arm was driven.
        flips: sign changes of β (Eq. 21).
    """

    turns: float
    turns_ratio: float | None
    penetration: float
    bend: float
    hinge_excess: float
    drift: float
    steps: int
    driven_together: int
    flips: int


def measure(episode: Episode) -> WindingMetrics:
    """Return the figures of `episode`."""
    settings = episode.settings
    first = first_and_last_in_contact(episode.in_contact[0])[0] or settings.link
    wound = settings.wound_object()
    middles = episode.positions[-1] - 0.5 * settings.arm.link_length * episode.directions[-1]
    turns = turns_about(middles[first - 1 :], wound.position, wound.rotation)
    ideal = None
    if settings.shape in ROUND_SHAPES:
        angle = ideal_angle(settings.arm.link_length, settings.size[0] + settings.arm.radius, settings.tilt)
        ideal = (settings.arm.links - first) * angle / (2.0 * math.pi)
    return WindingMetrics(
        turns=turns,
        turns_ratio=turns / ideal if ideal else None,
        penetration=-float(episode.distance.min()),
        bend=float(bends(episode.directions).max(initial=0.0)),
        hinge_excess=float(np.abs(episode.q).max()) - settings.arm.joint_range,
        drift=drift(episode),
        steps=episode.steps,
        driven_together=int(sum(driven_arms(contact).sum() > 1 for contact in episode.in_contact)),
        flips=sign_flips(episode.signs),
    )


def turns_about(points: Array, centre: Array, rotation: Array) -> float:
    """Return how many turns `points` `(k, 3)` make about the third axis of `rotation` `(3, 3)` through `centre`."""
    local = (points - centre) @ rotation
    azimuth = np.unwrap(np.arctan2(local[:, 1], local[:, 0]))
    return abs(float(azimuth[-1] - azimuth[0])) / (2.0 * math.pi)


def ideal_angle(link_length: float, distance: float, tilt: float = 0.0) -> float:
    """Return the angle [rad] that one tangent link turns about an axis at `distance` from its middle [m].

    2 atan((ℓ/2) / (R + r)), with ℓ cos φ for ℓ when the winding is a helix of tilt φ.
    """
    return 2.0 * math.atan(0.5 * link_length * math.cos(tilt) / distance)


def bends(directions: Array) -> Array:
    """Return the angles [rad] between neighbouring links `(..., n - 1)` from their unit directions `(..., n, 3)`."""
    a, b = directions[..., :-1, :], directions[..., 1:, :]
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.einsum("...i,...i->...", a, b))


class Wound(Protocol):
    """What `drift` looks at: an `Episode`, or what came of another robot."""

    @property
    def positions(self) -> Array:
        """Ends of the links `(T + 1, n, 3)` [m]."""

    @property
    def in_contact(self) -> NDArray[np.bool_]:
        """M `(T + 1, n)`."""


def drift(episode: Wound) -> float:
    """Return the largest motion [m] of a link's end after its link first belonged to the wound ones."""
    worst = 0.0
    wound_at: dict[int, Array] = {}
    for positions, contact in zip(episode.positions, episode.in_contact, strict=True):
        first, last = first_and_last_in_contact(contact)
        for link in range(max(first - 1, 0), last):
            wound_at.setdefault(link, positions[link])
        for link, place in wound_at.items():
            worst = max(worst, float(np.linalg.norm(positions[link] - place)))
    return worst


def sign_flips(signs: Array) -> int:
    """Return how often an arm's s changed from one side to the other over an episode `(T, n)`, zeros between ignored."""
    flips = 0
    for history in signs.T:
        sides = history[history != 0.0]
        flips += int(np.count_nonzero(sides[1:] != sides[:-1]))
    return flips
