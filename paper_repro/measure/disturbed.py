"""Controllers with a fault put into them, and windings driven by one: what the library has no switch for.

A fault is made where the arm feels: the controller plans with what it is told, the record holds what it was told, and the
arm and the object are what they are.
"""

from dataclasses import replace
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.touch import update_contact
from prioritized_ik.validation import Array
from prioritized_ik.winding import episode
from prioritized_ik.winding.controller import Situation, WindingController
from prioritized_ik.winding.episode import Episode, wind
from prioritized_ik.winding.plan import first_and_last_in_contact, plan
from prioritized_ik.winding.settings import WindingSettings


class ReversedContact(WindingController):
    """Contact vectors that point from the link into the object: the other reading of the paper's text."""

    def observe(self, q: Array, was_in_contact: NDArray[np.bool_]) -> Situation:
        """See `WindingController.observe`."""
        situation = super().observe(q, was_in_contact)
        return _planned(self.settings, replace(situation, contact_vectors=-situation.contact_vectors))


class DeadSensor(WindingController):
    """Link 9 never feels anything: a gap in M as soon as link 10 touches."""

    LINK = 9

    def observe(self, q: Array, was_in_contact: NDArray[np.bool_]) -> Situation:
        """See `WindingController.observe`."""
        situation = super().observe(q, was_in_contact)
        return _felt(self.settings, situation, np.arange(1, len(was_in_contact) + 1) != self.LINK)


class LooseContacts(WindingController):
    """Every link loses its contact for a step now and then, drawn by lot with a fixed seed: gaps that come and go."""

    LOST = 0.05  # of a link's readings

    def __init__(self, settings: WindingSettings) -> None:
        super().__init__(settings)
        self._lot = np.random.default_rng(settings.seed)

    def observe(self, q: Array, was_in_contact: NDArray[np.bool_]) -> Situation:
        """See `WindingController.observe`."""
        situation = super().observe(q, was_in_contact)
        return _felt(self.settings, situation, self._lot.random(len(was_in_contact)) >= self.LOST)


class NoisyDistance(WindingController):
    """Distances with normal noise, so that contacts near the threshold come and go. Contact rows see the true ones."""

    DEVIATION = 0.5e-3  # [m]

    def __init__(self, settings: WindingSettings) -> None:
        super().__init__(settings)
        self._lot = np.random.default_rng(settings.seed)

    def observe(self, q: Array, was_in_contact: NDArray[np.bool_]) -> Situation:
        """See `WindingController.observe`."""
        situation = super().observe(q, was_in_contact)
        noisy = situation.touch.distance + self._lot.normal(scale=self.DEVIATION, size=len(was_in_contact))
        contact = update_contact(was_in_contact, noisy, self.settings.contact_distance, self.settings.release_distance)
        vectors = np.where(contact[:, None], situation.touch.normal, 0.0)
        felt = replace(situation, in_contact=contact, contact_vectors=vectors)
        return _felt(self.settings, felt, np.ones(len(contact), dtype=bool))


FAULTS: dict[str, type[WindingController]] = {
    "reversed contact": ReversedContact,
    "dead sensor": DeadSensor,
    "loose contacts": LooseContacts,
    "noisy distance": NoisyDistance,
}


def wind_with(fault: str, settings: WindingSettings) -> Episode:
    """Return the episode of an arm whose controller has one of `FAULTS`."""
    # The library has no use for a choice of controllers, so `wind` has no parameter for one.
    with patch.object(episode, "WindingController", FAULTS[fault]):
        return wind(settings)


def _felt(settings: WindingSettings, situation: Situation, works: NDArray[np.bool_]) -> Situation:
    """Return the situation with the contacts only of links whose sensor works `(n,)`."""
    contact = situation.in_contact & works
    first, last = first_and_last_in_contact(contact)
    vectors = np.where(contact[:, None], situation.contact_vectors, 0.0)
    return _planned(settings, replace(situation, in_contact=contact, contact_vectors=vectors, first=first, last=last))


def _planned(settings: WindingSettings, situation: Situation) -> Situation:
    """Return the situation with the plan that follows from what is felt now."""
    desired, signs = plan(
        situation.directions,
        situation.contact_vectors,
        situation.in_contact,
        speed=settings.speed,
        dt=settings.dt,
        dead_band=settings.dead_band,
    )
    return replace(situation, desired=desired, signs=signs)
