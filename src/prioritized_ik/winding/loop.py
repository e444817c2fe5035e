"""The loop of a winding: look, pose, solve, move, until equilibrium."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

import numpy as np

from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.methods import Method, Place
from prioritized_ik.solvers.solve import step_of
from prioritized_ik.solvers.step import JointStep
from prioritized_ik.validation import Array
from prioritized_ik.winding.controller import ChainController, Equilibrium, Situation


class Outcome(Enum):
    """How an episode ended."""

    WOUND = "equilibrium [1]: every link from k on is in contact"
    LOST = "equilibrium [2]: no link is in contact"
    OUT_OF_STEPS = "no equilibrium within max_steps"
    SOLVER_FAILED = "the solver gave no step, so the arm stopped"


@dataclass(frozen=True)
class Moment:
    """One state of a winding, and the step from it.

    Attributes:
        q: the position `(nq,)`.
        situation: what is seen there.
        problem: of the step; None at the end.
        step: what came of it; None at the end, and without dθ where the solver failed.
    """

    q: Array
    situation: Situation
    problem: IKProblem | None = None
    step: JointStep | None = None

    @property
    def ending(self) -> tuple[Outcome, str]:
        """How a winding ended whose last moment this is, and the solver's own words if it failed."""
        if self.step is not None:
            return Outcome.SOLVER_FAILED, f"{self.step.status.value}. {self.step.message}"
        if self.situation.equilibrium is None:
            return Outcome.OUT_OF_STEPS, ""
        return (Outcome.WOUND if self.situation.equilibrium is Equilibrium.WINDING else Outcome.LOST), ""


def moments(controller: ChainController, method: Method, q: Array) -> Iterator[Moment]:
    """Yield moment after moment of a winding, from the position `q` `(nq,)` to equilibrium, a failed step or the last step.

    Raises:
        InputError: the position is outside the joint ranges.
    """
    settings = controller.settings
    in_contact = np.zeros(controller.chain.count, dtype=bool)
    for number in range(settings.max_steps + 1):
        situation = controller.observe(q, in_contact)
        in_contact = situation.in_contact
        if situation.equilibrium is not None or number == settings.max_steps:
            yield Moment(q, situation)
            return
        problem = controller.problem(q, situation)
        step = step_of(method, problem, settings.options, Place(q, settings))
        yield Moment(q, situation, problem, step)
        if step.dtheta is None:
            return
        q = controller.chain.moved(q, step.dtheta)
