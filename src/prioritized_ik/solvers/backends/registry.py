"""Which QP solvers there are, and how to get one by name. How a step is made of one, `solvers.registry` tells."""

import difflib
import importlib.util
from numbers import Real

from prioritized_ik.errors import InputError, SolverUnavailableError
from prioritized_ik.solvers.backends.abilities import ABILITIES, NATIVE, SPARSE, abilities_of
from prioritized_ik.solvers.backends.protocol import Backend
from prioritized_ik.validation import fraction

#: Accuracy asked of a solver unless told otherwise, in the stages' scaled variables.
ACCURACY = 1e-8


def through_qpsolvers() -> list[str]:
    """Return the names of the solvers that qpsolvers finds here. It imports all of them, so it waits until asked."""
    import qpsolvers

    return list(qpsolvers.available_solvers)


def known_solvers() -> list[str]:
    """Return the names of every QP solver this package knows, installed or not."""
    return sorted({*ABILITIES, *NATIVE, *through_qpsolvers()})


def installed_solvers(*, on_request: bool = False) -> list[str]:
    """Return the names of the QP solvers that can run here; those that run only on request too if `on_request`."""
    native = (name for name in NATIVE if _is_installed(name))
    names = sorted({*through_qpsolvers(), *native})
    return [name for name in names if on_request or not abilities_of(name).on_request]


def installed_sparse() -> list[str]:
    """Return the names of the solvers of sparse QPs that can run here, see `sparse`."""
    return sorted(name for name, module in SPARSE.items() if importlib.util.find_spec(module) is not None)


def get_backend(name: str, accuracy: float = ACCURACY, *, refine: bool = True) -> Backend:
    """Return the backend called `name`.

    A backend is for one thread; make one for each. It can be copied and pickled, also once used, and a copy starts from
    nothing: what a solver remembers from the step before stays with the original.

    Args:
        name: one of `known_solvers()`.
        accuracy: asked of the solver, below 1 and at least what it reaches; the table of abilities makes its options of it.
        refine: zoom in on each answer of a solver that needs it to be exact by itself; needless if the step is polished.

    Raises:
        SolverUnavailableError: unknown, or not installed (with the command that installs it).
        InputError: a name that is no text; an accuracy that is no number, out of range, or finer than the solver reaches.
    """
    if not isinstance(name, str):
        raise InputError(f"solver is {name!r}; expected a name, one of: {_installed()}.")
    if name not in known_solvers():
        raise SolverUnavailableError(f"unknown solver {name!r}; {_guess(name)}choose one of: {_installed()}.")
    accuracy = checked_accuracy(accuracy, name)
    if name in through_qpsolvers():
        from prioritized_ik.solvers.backends.qpsolvers_ import QpsolversBackend

        return QpsolversBackend(name, accuracy, refine=refine)
    if name in NATIVE and _is_installed(name):
        return _native(name, accuracy, refine=refine)
    package = abilities_of(name).package
    raise SolverUnavailableError(
        f"solver {name!r} is not installed; install it with: pip install {package} (installed: {_installed()})."
    )


def checked_accuracy(accuracy: float, name: str | None = None) -> float:
    """Return an accuracy, that of solver `name` if given.

    Raises:
        InputError: it is no number, out of range, or finer than the solver reaches.
    """
    if not isinstance(accuracy, Real) or isinstance(accuracy, int):  # a text, or whole and maybe too large for a float
        raise InputError(f"accuracy is {accuracy!r}; expected a number above 0 and below 1.")
    accuracy = fraction("accuracy", accuracy)
    finest = 0.0 if name is None else abilities_of(name).finest
    if accuracy < finest:
        raise InputError(f"accuracy is {accuracy:g}, finer than {name} reaches; expected at least {finest:g}.")
    return accuracy


def _installed() -> str:
    """Return the names that `get_backend` takes, as text."""
    return ", ".join(installed_solvers(on_request=True))


def _guess(name: str) -> str:
    """Return which known solvers an unknown `name` is a slip of the pen for, the nearest first, as part of a message."""
    near = [repr(known) for known in difflib.get_close_matches(name.lower(), known_solvers())]
    return f"did you mean {' or '.join(near)}? " if near else ""


def _is_installed(name: str) -> bool:
    """Whether what native solver `name` imports is there."""
    return importlib.util.find_spec(NATIVE[name].module) is not None


def _native(name: str, accuracy: float, *, refine: bool) -> Backend:
    """Return native backend `name`. Its module imports its solver, so it waits until now."""
    from prioritized_ik.solvers.backends.native import NativeBackend, Workspace

    workspace: type[Workspace]
    match name:
        case "daqp-warm":
            from prioritized_ik.solvers.backends.daqp_ import DaqpWorkspace as workspace
        case "osqp-warm":
            from prioritized_ik.solvers.backends.osqp_ import OsqpWorkspace as workspace
        case "piqp-warm":
            from prioritized_ik.solvers.backends.piqp_ import PiqpWorkspace as workspace
        case "proxqp-sparse-warm":
            from prioritized_ik.solvers.backends.proxqp_ import SparseProxqpWorkspace as workspace
        case "proxqp-warm":
            from prioritized_ik.solvers.backends.proxqp_ import ProxqpWorkspace as workspace
    return NativeBackend(name, accuracy, workspace, refine=refine)
