"""Errors of this library that are mink's too, so that `except mink.NoSolutionFound` goes on working."""

from prioritized_ik.errors import InfeasibleError, InputError, MissingExtraError, StepNotFoundError

try:
    import mink
except ModuleNotFoundError as error:
    if error.name != "mink":
        raise
    raise MissingExtraError(
        "prioritized_ik.mink needs mink, which is not installed; get the extra by: pip install 'prioritized-ik[mink]'.",
        name="mink",
    ) from error


class NoStepFoundError(StepNotFoundError, mink.NoSolutionFound):  # type: ignore[misc]
    """No step was accepted. `step` holds the status and the figures reached."""

    def __init__(self, message: str, step: object) -> None:
        Exception.__init__(self, message)  # mink's own would take the message for a solver's name
        self.step = step


class InfeasibleIkError(InfeasibleError, mink.NoSolutionFound):  # type: ignore[misc]
    """No step keeps all limits and constraints. The message names those in conflict, and `conflict` holds them."""

    def __init__(self, message: str, step: object) -> None:
        Exception.__init__(self, message)
        self.step = step


class OutsideLimitsError(InputError, mink.NotWithinConfigurationLimits):  # type: ignore[misc]
    """The configuration is outside the joint limits, and `safety_break` asks to stop."""

    def __init__(self, message: str) -> None:
        Exception.__init__(self, message)
