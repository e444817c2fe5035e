"""What every backend offers: the answer to one stage."""

from dataclasses import dataclass
from typing import Protocol

from prioritized_ik.solvers.stages import Stage
from prioritized_ik.validation import Array


@dataclass(frozen=True)
class StageResult:
    """What a backend made of a stage.

    Attributes:
        x: the variables `(v,)`, finite; None if the solver failed.
        message: why it failed; empty otherwise.
        calls: how often the solver was called.
    """

    x: Array | None
    message: str = ""
    calls: int = 1


class Backend(Protocol):
    """A QP solver that can be handed stages."""

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
