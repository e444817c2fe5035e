"""Which methods there are, and how to get one by name.

A method's name is one word, such as `active-set`, or a family and a solver, such as `damped:quadprog`. The bare name of a
QP solver stands for `lexicographic:` and that solver. Packages add families by the entry point `prioritized_ik.methods`,
whose module calls `register_family`.
"""

import difflib
import functools
import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import entry_points

from prioritized_ik.errors import InputError, SolverUnavailableError
from prioritized_ik.solvers.backends.abilities import ABILITIES, SPARSE, abilities_of
from prioritized_ik.solvers.backends.registry import (
    ACCURACY,
    checked_accuracy,
    get_backend,
    installed_solvers,
    installed_sparse,
    known_solvers,
    through_qpsolvers,
)
from prioritized_ik.solvers.methods import ActiveSet, ClosedForm, Damped, Lexicographic, Method, Slack
from prioritized_ik.validation import one_of

#: What steps are found with unless told otherwise.
DEFAULT = ActiveSet.name

#: Families of this package.
LEXICOGRAPHIC, LIFTED, DAMPED, SLACK = "lexicographic", "lifted", Damped.family, Slack.family

#: What the older option `formulation` calls `LEXICOGRAPHIC` beside `LIFTED`.
DENSE = "dense"

DAQP_HIERARCHY = "daqp-hierarchy"


@dataclass(frozen=True)
class Family:
    """Methods that differ in the solver that they call, `family:solver`.

    Attributes:
        make: returns the method of a solver at an accuracy; the last argument says whether the solver is to refine its
            answers, see `backends.registry.get_backend`.
        known: returns the names of the solvers that it knows, installed or not.
        installed: returns the names of those that can run here; with True those too that run only on request.
        about: what the methods are, in a few words.
    """

    make: Callable[[str, float, bool], Method]
    known: Callable[[], list[str]]
    installed: Callable[[bool], list[str]]
    about: str


def _lexicographic(solver: str, accuracy: float, refine: bool) -> Method:
    return Lexicographic(get_backend(solver, accuracy, refine=refine))


def _lifted(solver: str, accuracy: float, refine: bool) -> Method:
    """Return the lifted method of a sparse solver. Its module imports SciPy's sparse matrices, so it waits until now."""
    if solver not in SPARSE:
        raise InputError(f"the lifted form is for sparse QP solvers, not {solver!r}; choose one of: {', '.join(SPARSE)}.")
    if solver not in installed_sparse():
        package = abilities_of(solver).package
        raise SolverUnavailableError(f"solver {solver!r} is not installed; install it with: pip install {package}.")
    from prioritized_ik.solvers.backends.sparse import SparseBackend
    from prioritized_ik.solvers.lifted.method import Lifted

    return Lifted(SparseBackend(solver, checked_accuracy(accuracy, solver), refine=refine))


def _damped(solver: str, accuracy: float, refine: bool) -> Method:
    return Damped(get_backend(solver, accuracy, refine=refine))


def _slack(solver: str, accuracy: float, refine: bool) -> Method:
    return Slack(get_backend(solver, accuracy, refine=refine))


def _installed(on_request: bool) -> list[str]:
    return installed_solvers(on_request=on_request)


def _through_qpsolvers(on_request: bool) -> list[str]:
    return [name for name in _installed(on_request) if name in through_qpsolvers()]


_families = {
    LEXICOGRAPHIC: Family(_lexicographic, known_solvers, _installed, "a QP solver's guess, level by level, made exact"),
    LIFTED: Family(
        _lifted,
        lambda: sorted(SPARSE),
        lambda on_request: installed_sparse(),
        "a sparse QP solver's, link by link on a kinematic tree, made exact",
    ),
    DAMPED: Family(_damped, known_solvers, _installed, "for comparison: the one damped QP of mink and pink"),
    SLACK: Family(_slack, lambda: sorted(ABILITIES), _through_qpsolvers, "for comparison: its optimum without squaring J"),
}

_added: dict[str, Callable[[float], Method]] = {}


def register(name: str, factory: Callable[[float], Method]) -> None:
    """Add a method: `factory(accuracy)` makes one. A name can be registered again, and the last one counts.

    Raises:
        InputError: a method of this package has that name, or it is no word without a colon.
    """
    if not isinstance(name, str) or not name or ":" in name:
        raise InputError(f"the method's name is {name!r}; expected a word without a colon, which stands after a family.")
    if name in _singles():
        raise InputError(f"the method's name is {name!r}, which this package's own has; choose another.")
    _added[name] = factory


def register_family(name: str, family: Family) -> None:
    """Add methods `name:solver`. A name can be registered again, and the last one counts."""
    _families[name] = family


def registered() -> dict[str, Callable[[float], Method]]:
    """Return the factories of the methods that were added, by name."""
    return dict(_added)


def families() -> dict[str, Family]:
    """Return the families by name, those of other packages too."""
    _load_other_packages()
    return dict(_families)


def known_methods() -> list[str]:
    """Return the names of every method this package knows, installed or not."""
    return [*_alone(), *(f"{name}:{solver}" for name, family in families().items() for solver in family.known())]


def installed_methods(*, on_request: bool = False) -> list[str]:
    """Return the names of the methods that can run here; those that run only on request too if `on_request`."""
    several = families().items()
    alone = [name for name in _alone() if name != DAQP_HIERARCHY or (on_request and _has_daqp())]
    return [*alone, *(f"{name}:{solver}" for name, family in several for solver in family.installed(on_request))]


def get_method(name: str, accuracy: float = ACCURACY, *, refine: bool = True) -> Method:
    """Return the method called `name`.

    A method is for one thread; make one for each. It can be copied and pickled, also once used; what a QP solver remembers
    from the step before stays with the original.

    Args:
        name: one of `known_methods()`, or the bare name of a QP solver for `lexicographic:` and that solver.
        accuracy: asked of the solver, if there is one, see `backends.registry.get_backend`.
        refine: whether the solver zooms in on its answers to be exact by itself; needless if they are polished.

    Raises:
        SolverUnavailableError: unknown, or not installed (with the command that installs it).
        InputError: a name that is no text, or an accuracy that is none or out of reach.
    """
    if not isinstance(name, str):
        raise InputError(f"solver is {name!r}; expected a name, one of: {_choices()}.")
    if name in _added:
        return _made(name, _added[name](checked_accuracy(accuracy)))
    if name in _singles():
        return _singles()[name](checked_accuracy(accuracy))
    family, solver = parts_of(name)
    several = _families if family in _families else families()
    if family in several and (solver in several[family].known() or solver in known_solvers()):
        return several[family].make(solver, accuracy, refine)
    raise SolverUnavailableError(f"unknown solver {name!r}; {_nearest(name)}choose one of: {_choices()}.")


def parts_of(name: str) -> tuple[str, str]:
    """Return family and solver of a method's name; no family if it has none."""
    family, colon, solver = name.rpartition(":")
    return (LEXICOGRAPHIC, name) if not colon and name not in _added and name in known_solvers() else (family, solver)


def old_name(solver: str, formulation: str) -> str:
    """Return the method that `solver` and a `formulation`, its family, named when they were two options.

    Raises:
        InputError: no such formulation.
    """
    one_of("formulation", formulation, (LEXICOGRAPHIC, DENSE, LIFTED, DAMPED, SLACK))
    return solver if formulation in (LEXICOGRAPHIC, DENSE) else f"{formulation}:{solver}"


def _singles() -> dict[str, Callable[[float], Method]]:
    """Return the makers of this package's methods that are no family's."""
    return {
        ActiveSet.name: lambda accuracy: ActiveSet(),
        ClosedForm.name: lambda accuracy: ClosedForm(),
        DAQP_HIERARCHY: _daqp_hierarchy,
    }


def _alone() -> list[str]:
    return [*_singles(), *sorted(_added)]


def _has_daqp() -> bool:
    return importlib.util.find_spec("daqp") is not None


def _daqp_hierarchy(accuracy: float) -> Method:
    if not _has_daqp():
        raise SolverUnavailableError(f"solver {DAQP_HIERARCHY!r} is not installed; install it with: pip install daqp.")
    from prioritized_ik.solvers.daqp_hierarchy import DaqpHierarchy

    return DaqpHierarchy(checked_accuracy(accuracy, "daqp"))


def _made(name: str, method: object) -> Method:
    if not isinstance(method, Method):
        raise InputError(f"what was registered as {name!r} made a {type(method).__name__}; expected a Method.")
    method.name = name  # as its steps are to say
    return method


@functools.cache
def _load_other_packages() -> None:
    """Import the modules that add families."""
    for entry in entry_points(group="prioritized_ik.methods"):
        entry.load()


def _choices() -> str:
    """Return the names that `get_method` takes, as text."""
    words = ", ".join(name for name in _alone() if name != DAQP_HIERARCHY or _has_daqp())
    return f"{words}; or {', '.join(_families)}, a colon and a solver; or one of: {', '.join(_installed(True))}"


def _nearest(name: str) -> str:
    """Return which known methods an unknown `name` is a slip of the pen for, the nearest first, as part of a message."""
    near = difflib.get_close_matches(name.lower(), [*known_methods(), *known_solvers()])
    return f"did you mean {' or '.join(map(repr, near))}? " if near else ""
