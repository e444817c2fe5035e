"""Winding by lateral inhibition, in the manner of Hirose and Umetani as Wada and Kuba used it: joints act on touch alone.

What the paper says of it: joints cooperate on the arm's tactile information, by a scheme of lateral inhibition, and
as all joint axes are parallel, the winding stays in a plane. There is no task space and no inverse kinematics. The
scheme itself is written here anew, with these choices:

- *excitation*: a link in contact excites the joint at the end of it, which bends towards the side of the contact at a
  constant rate, until the next link is in contact too;
- *inhibition*: a link that is pressed gives way. Its skin yields up to the contact distance, and pressure is the
  share of that. The joints next to its ends open in proportion, and those at its ends bend as much more: the profile
  (-1, 1, 1, -1), which is how a chain moves one link aside and leaves all but its neighbours, to first order, where
  they are;
- joints that are neither excited nor inhibited hold still, so that the free tail swings with the excited joint.

Contacts have the same thresholds as in winding by virtual arms, and steps are added to the joint positions alike.
"""

import numpy as np

from prioritized_ik.errors import InputError
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.methods import Method, Place
from prioritized_ik.solvers.step import JointStep, StepStatus
from prioritized_ik.validation import Array
from prioritized_ik.winding.controller import Situation, WindingController
from prioritized_ik.winding.settings import WindingSettings

AXIS = "z"  # of the hinges that bend; the object must come along y
RATE = 0.03  # [rad] a step of an excited joint: its link's end moves by less than the contact distance
YIELDING = 0.01  # [rad] a step of a joint beside a link that is pressed by all of its skin
PROFILE = {-1: -1.0, 0: 1.0, 1: 1.0, 2: -1.0}  # of the joints around a pressed link, counted from the one at its base


class LateralInhibition(Method):
    """Joint steps from touch alone, for `winding.episode.wind`."""

    name = "lateral-inhibition"
    version = "1"

    def __init__(self, settings: WindingSettings) -> None:
        arm = settings.arm
        self._controller = WindingController(settings)
        self._in_contact = np.zeros(arm.links, dtype=bool)
        axes = [(link, axis) for link in arm.link_numbers for axis in arm.hinge_axes(link)]
        self._bending = np.array([axes.index((link, AXIS)) for link in arm.link_numbers])
        self._joint_count = len(axes)

    def step(self, problem: IKProblem, options: SolveOptions | None = None, place: Place | None = None) -> JointStep:
        """Return the step where the arm is; the problem, of virtual arms, is not looked at."""
        del problem, options
        if place is None:
            raise InputError(f"{self.name} acts on touch where the arm is, and no place was told; use `wind` for it.")
        situation = self._controller.observe(place.q, self._in_contact)
        self._in_contact = situation.in_contact
        dtheta = np.zeros(self._joint_count)
        skin = self._controller.settings.contact_distance
        dtheta[self._bending] = bending(situation, skin)
        return JointStep(dtheta, StepStatus.CLOSED_FORM)


def bending(situation: Situation, skin: float) -> Array:
    """Return the step of the joint at the base of each link `(n,)` [rad], positive about z.

    Args:
        situation: what the arm feels.
        skin: how far it yields [m].
    """
    touching = situation.in_contact
    side = side_of(situation)
    excited = np.zeros(len(touching))
    excited[1:] = touching[:-1] & ~touching[1:]
    excited *= np.arange(1, len(touching) + 1) == situation.last + 1  # beyond a gap nothing is excited
    pressure = np.clip((skin - situation.touch.distance) / skin, 0.0, None) * touching
    inhibited = np.zeros(len(touching))
    for place, share in PROFILE.items():
        joints = np.arange(len(touching)) + place
        inside = (joints >= 0) & (joints < len(touching))
        np.add.at(inhibited, joints[inside], share * pressure[inside])
    return side * (RATE * excited + YIELDING * inhibited)


def side_of(situation: Situation) -> float:
    """Return the sense about z in which the arm turns towards the object: that of a x (-c) of the first link in contact."""
    if situation.first == 0:
        return 0.0
    link = situation.first - 1
    a, c = situation.directions[link], situation.contact_vectors[link]
    return float(np.sign(a[1] * c[0] - a[0] * c[1]))
