"""Everything that decides an episode, in one frozen record that travels as JSON."""

import dataclasses
import json
from dataclasses import dataclass, field
from typing import Any

import mujoco

from prioritized_ik.errors import InputError
from prioritized_ik.limits import CONTACT_MARGIN
from prioritized_ik.models import (
    DIRECTIONS,
    POSTURES,
    Arm,
    WindingObject,
    arm_model,
    update_kinematics,
    winding_model,
)
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.methods import ClosedForm
from prioritized_ik.solvers.registry import DEFAULT
from prioritized_ik.validation import Array, at_least, non_negative, one_of, positive
from prioritized_ik.weights import ALL_KINDS
from prioritized_ik.winding.chain import Chain
from prioritized_ik.winding.plan import DEAD_BAND

CLOSED_FORM = ClosedForm.name


def in_proportion(link_length: float) -> dict[str, float]:
    """Return speed, distances of touch and gap for links of another length [m] than the paper's, in proportion."""
    names = ("speed", "contact_distance", "release_distance", "min_distance", "gap")
    return {name: link_length / Arm.link_length * getattr(WindingSettings, name) for name in names}


@dataclass(frozen=True)
class Control:
    """How to wind, whatever winds around whatever. Where the paper states nothing, the default is a choice of this project.

    Attributes:
        weights: `"eq23"`, `"eq24"`, `"strict"`: levels in place of weights, or `"trailing"`: see `weights.TRAILING`.
        speed: η = 2 [m/s].
        dt: time step [s] (not stated).
        dead_band: of Eq. (21), see `plan.DEAD_BAND`.
        contact_distance: a link makes contact at this distance [m] (not stated).
        release_distance: and loses it above this [m] (not stated).
        limits: keep joint ranges and the step limit (QP only).
        contacts: keep links out of the object (QP only).
        max_step: largest step of a joint [rad].
        min_distance: links stop this short of the object [m], inside the contact distance.
        contact_gain: how much of the gap one step may close. At 1 the curvature of large steps lets links break through
            by 10 mm; at 0.5 they stay out.
        max_steps: an episode without equilibrium ends after this many.
        solver: name of the method, see `registry.get_method`.
        options: how to solve; the rank is cut at 1e-4, see `closed_form.RANK_TOLERANCE`.
    """

    weights: str = "eq23"
    speed: float = 2.0
    dt: float = 2e-3
    dead_band: float = DEAD_BAND
    contact_distance: float = 2e-3
    release_distance: float = 4e-3
    limits: bool = True
    contacts: bool = True
    max_step: float = 0.1
    min_distance: float = 1e-3
    contact_gain: float = 0.5
    max_steps: int = 1500
    solver: str = DEFAULT
    options: SolveOptions = field(default_factory=lambda: SolveOptions(rank_tolerance=RANK_TOLERANCE))

    def __post_init__(self) -> None:
        one_of("weights", self.weights, ALL_KINDS)
        for name in ("speed", "dt", "contact_distance", "release_distance", "max_step"):
            positive(name, getattr(self, name))
        for name in ("dead_band", "min_distance"):
            non_negative(name, getattr(self, name))
        if not 0.0 < self.contact_gain <= 1.0:
            raise InputError(f"contact_gain is {self.contact_gain!r}; expected a number above 0 and up to 1.")
        if self.release_distance < self.contact_distance:
            raise InputError(
                f"release_distance {self.release_distance} is below contact_distance {self.contact_distance}; "
                "expected it above."
            )
        if self.contacts and self.min_distance >= self.contact_distance:
            raise InputError(
                f"min_distance {self.min_distance} is not below contact_distance {self.contact_distance}: "
                "no link could ever make contact."
            )
        at_least("max_steps", self.max_steps, 1)
        if not isinstance(self.solver, str):
            raise InputError(f"solver is {self.solver!r}; expected the name of one.")
        if self.solver == CLOSED_FORM and (self.limits or self.contacts):
            raise InputError("the closed form knows no limits or contacts; set both to False, or choose a QP solver.")

    @property
    def reach(self) -> float:
        """How far links need to feel the object, for contact and its rows [m]."""
        return max(CONTACT_MARGIN, 2.0 * self.release_distance)


@dataclass(frozen=True)
class WindingSettings(Control):
    """Settings of one winding episode of the paper's arm: `Control`, and the arm and object themselves.

    Attributes:
        arm: the arm; the paper's.
        shape: the object's shape, a key of `models.SHAPES`; the paper's is a cylinder of 0.14 m diameter.
        size: its half-sizes [m].
        direction: where it comes from (Fig. 6).
        link: k, the link that it touches at first (not stated).
        tilt: turn of its axis about the contact normal [rad] (not stated; 0 winds a ring).
        gap: distance between object and link at the start [m] (not stated).
        posture: initial posture (not stated).
        seed: of a random posture.
    """

    arm: Arm = field(default_factory=Arm)
    shape: str = "cylinder"
    size: tuple[float, ...] = (0.07, 0.5)
    direction: str = "up"
    link: int = 6
    tilt: float = 0.0
    gap: float = 1e-3
    posture: str = "straight"
    seed: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        one_of("direction", self.direction, DIRECTIONS)
        one_of("posture", self.posture, POSTURES)
        if at_least("link", self.link, 1) >= self.arm.links:
            raise InputError(f"link is {self.link}; expected 1 to {self.arm.links - 1}, so that a link is left to wind.")
        non_negative("gap", self.gap)
        if not isinstance(self.tilt, int | float) or not abs(self.tilt) < 1.2:
            raise InputError(f"tilt is {self.tilt!r}; expected less than 1.2 rad to either side.")
        at_least("seed", self.seed, 0)
        self.wound_object()

    def initial_posture(self) -> Array:
        """Return the initial joint positions `(m,)` [rad]."""
        return self.arm.posture(self.posture, self.seed)

    def wound_object(self) -> WindingObject:
        """Return the object at its place, touching the middle of `link` in the initial posture."""
        model = arm_model(dataclasses.replace(self.arm, links=self.link + 1))  # links beyond do not move that one
        data = mujoco.MjData(model)
        update_kinematics(model, data, self.initial_posture()[: model.nq])
        link = data.body(f"link_{self.link}")
        along = link.xmat.reshape(3, 3)[:, 0].copy()
        middle = link.xpos + 0.5 * self.arm.link_length * along
        unplaced = WindingObject(self.shape, self.size)
        return unplaced.touching(middle, along, self.direction, self.tilt, self.arm.radius + self.gap)

    def model(self) -> mujoco.MjModel:
        """Return the model of arm and object."""
        return winding_model(self.arm, self.wound_object())

    def chain(self) -> Chain:
        """Return the arm that winds, beside the object."""
        return Chain.of_arm(self.arm, self.model(), self.reach)

    def to_json(self) -> str:
        """Return the settings as JSON."""
        return json.dumps(dataclasses.asdict(self))

    @staticmethod
    def from_json(text: str) -> "WindingSettings":
        """Return the settings that `to_json` wrote.

        Raises:
            InputError: not such a JSON text, or values out of range.
        """
        try:
            fields: dict[str, Any] = json.loads(text)
            fields["arm"] = Arm(**fields["arm"])
            fields["options"] = SolveOptions(**fields["options"])
            fields["size"] = tuple(fields["size"])
            return WindingSettings(**fields)
        except InputError:
            raise
        except (ValueError, OverflowError, KeyError, TypeError) as error:
            raise InputError(f"these are not settings of an episode ({error}).") from error
