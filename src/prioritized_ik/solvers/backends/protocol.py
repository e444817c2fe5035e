"""What every backend offers: the answer to one stage."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from prioritized_ik.solvers.stages import Stage
from prioritized_ik.validation import Array


@dataclass(frozen=True)
class StageResult:
    """What a backend made of a stage.

    Attributes:
        x: the variables `(v,)`, finite; None if the solver failed.
        message: why it failed; empty otherwise.
        calls: how often the solver was called.
        multipliers: of the stage's rows G `(r,)`, not negative, as the solver gives them: at x, Px + q + Gᵀ multipliers
            is near zero. None if the solver failed, or gives none.
    """

    x: Array | None
    message: str = ""
    calls: int = 1
    multipliers: Array | None = None


class SolverFailedError(Exception):
    """One call of a solver gave no answer. Backends make a result without x of it."""


@runtime_checkable
class Backend(Protocol):
    """A QP solver that can be handed stages. One backend serves one thread at a time."""

    @property
    def name(self) -> str:
        """What the registry calls it."""
        ...

    @property
    def version(self) -> str:
        """Version of the solver."""
        ...

    def solve(self, stage: Stage) -> StageResult:
        """Return the optimum of `stage`, or a result without x that says what went wrong. Never raises for a failure."""
        ...

    def solve_once(self, stage: Stage) -> StageResult:
        """Return what one call makes of exactly the QP of `stage`, with the solver's default options, from nothing."""
        ...
