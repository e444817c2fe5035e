"""The outcome of one solve: a joint step and what is known of it."""

from dataclasses import dataclass
from enum import Enum

from prioritized_ik.validation import Array


class StepStatus(Enum):
    """How a joint step came about; the text says what to do."""

    CLOSED_FORM = "no row binds: the step is the closed form, Eqs. (12) and (13); no QP was needed"
    SOLVED = "the solver solved every stage and its step keeps every bound and row"
    VIOLATED = "the solver's step breaks a bound or row: tighten the accuracy or choose another solver"
    NOT_FOUND = "the solver gave no answer to a stage: choose another solver, or look at the rows for a conflict"


@dataclass(frozen=True)
class Timings:
    """Where the time of one solve went [s]."""

    build: float  # decompositions, changes of variables, stages
    solve: float  # inside the backend, refinement included


@dataclass(frozen=True)
class JointStep:
    """One solve's outcome.

    Attributes:
        dtheta: dθ `(m,)` [rad]; None unless the step was accepted, so that a failure cannot pass for an answer.
        status: how it came about.
        message: the solver's own words about a failure.
        costs: each level's cost (Eq. 10), the most important first.
        tight_rows: names of the bounds and rows that the step ends on.
        violation: worst violation of a bound or row, relative to the step.
        timings: where the time went.
        calls: how often the solver was called.
    """

    dtheta: Array | None
    status: StepStatus
    message: str = ""
    costs: tuple[float, ...] = ()
    tight_rows: tuple[str, ...] = ()
    violation: float = 0.0
    timings: Timings = Timings(0.0, 0.0)
    calls: int = 0

    @property
    def found(self) -> bool:
        """Whether there is a step to take."""
        return self.dtheta is not None
