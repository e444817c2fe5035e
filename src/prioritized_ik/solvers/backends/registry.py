"""Which backends there are, and how to get one by name."""

from collections.abc import Callable

import qpsolvers

from prioritized_ik.errors import SolverUnavailableError
from prioritized_ik.solvers.backends.abilities import ABILITIES, abilities_of
from prioritized_ik.solvers.backends.protocol import Backend
from prioritized_ik.solvers.backends.qpsolvers_ import QpsolversBackend
from prioritized_ik.validation import fraction

#: Accuracy asked of a solver unless told otherwise, in the stages' scaled variables.
ACCURACY = 1e-8

_factories: dict[str, Callable[[float], Backend]] = {}


def register(name: str, factory: Callable[[float], Backend]) -> None:
    """Add a backend: `factory(accuracy)` makes one. A name can be registered again, and the last one counts."""
    _factories[name] = factory


def known_solvers() -> list[str]:
    """Return the names of every solver this package knows, installed or not."""
    return sorted({*ABILITIES, *qpsolvers.available_solvers, *_factories})


def installed_solvers(*, on_request: bool = False) -> list[str]:
    """Return the names of the solvers that can run here; those that run only on request too if `on_request`."""
    names = sorted({*qpsolvers.available_solvers, *_factories})
    return [name for name in names if on_request or name in _factories or not abilities_of(name).on_request]


def get_backend(name: str, accuracy: float = ACCURACY) -> Backend:
    """Return the backend called `name`.

    Args:
        name: one of `known_solvers()`.
        accuracy: asked of the solver, above 0 and below 1; the table of abilities turns it into its options.

    Raises:
        SolverUnavailableError: unknown, or not installed (with the command that installs it).
        InputError: an accuracy out of range.
    """
    fraction("accuracy", accuracy)
    if name in _factories:
        return _factories[name](accuracy)
    if name in qpsolvers.available_solvers:
        return QpsolversBackend(name, accuracy)
    installed = ", ".join(installed_solvers(on_request=True))
    if name in ABILITIES:
        package = ABILITIES[name].package
        raise SolverUnavailableError(
            f"solver {name!r} is not installed; install it with: pip install {package} (installed: {installed})."
        )
    raise SolverUnavailableError(f"unknown solver {name!r}; choose one of: {installed}.")
