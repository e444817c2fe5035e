"""What can go wrong, as exceptions. Each message gives the value, what was expected and what to do.

All of them pickle and copy with what they hold, so that pools of processes hand them back.
"""

import copyreg
from typing import Any


class PrioritizedIkError(Exception):
    """Base of every error that this package raises on purpose."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to make this error again: from its message, then its attributes, never through its `__init__`."""
        return copyreg.__newobj__, (type(self), *self.args), vars(self)  # type: ignore[attr-defined]


class InputError(PrioritizedIkError, ValueError):
    """A value from the caller is of no use: wrong shape, not finite, out of range, unknown name."""


class ModelError(InputError):
    """The MuJoCo model lacks something that was asked for, or holds it in an unusable form."""


class MissingExtraError(PrioritizedIkError):
    """A command needs packages of an optional extra that is not installed."""


class SolverUnavailableError(PrioritizedIkError):
    """A QP solver is unknown, or known but not installed."""


class StepNotFoundError(PrioritizedIkError):
    """No joint step was accepted. `step` holds the status and the figures reached."""

    def __init__(self, message: str, step: object) -> None:
        super().__init__(message)
        self.step = step


class InfeasibleError(StepNotFoundError):
    """No step keeps all hard rows. The message names the rows in conflict, and `conflict` holds them."""

    @property
    def conflict(self) -> object:
        """The rows, and by how much they contradict each other."""
        return getattr(self.step, "conflict", None)


class EpisodeFileError(PrioritizedIkError):
    """A saved episode cannot be read or written."""


class WitnessError(PrioritizedIkError):
    """The reference solution could not be computed; the message names the stage and what the solver said."""
