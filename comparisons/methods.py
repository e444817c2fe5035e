"""Methods to compare with, as families of the registry: mink as it is today, and the problem written out in CVXPY.

Importing this module registers them; the entry point `prioritized_ik.methods` does so for who does not import it. What
they call is imported when one is asked for.
"""

import importlib.util

import qpsolvers

from prioritized_ik.solvers.backends.abilities import ABILITIES
from prioritized_ik.solvers.methods import Method
from prioritized_ik.solvers.registry import Family, register_family

MINK, REFERENCE = "mink", "reference"


def _mink(solver: str, accuracy: float, refine: bool) -> Method:
    from comparisons.mink_today import MinkToday

    del accuracy, refine  # mink leaves them to the solver
    return MinkToday(solver)


def _solvers_of_mink(on_request: bool) -> list[str]:
    found = (name for name in qpsolvers.available_solvers if on_request or name not in _on_request())
    return sorted(found) if importlib.util.find_spec("mink") is not None else []


def _on_request() -> set[str]:
    return {name for name, abilities in ABILITIES.items() if abilities.on_request}


def _reference(solver: str, accuracy: float, refine: bool) -> Method:
    from comparisons.reference import Reference

    del accuracy, refine  # it asks for the finest that the solver reaches
    return Reference(solver)


def _solvers_of_cvxpy() -> list[str]:
    if importlib.util.find_spec("cvxpy") is None:
        return []
    from prioritized_ik.solvers.witness import witness_solvers

    return [name.lower() for name in witness_solvers()]


register_family(MINK, Family(_mink, lambda: sorted(ABILITIES), _solvers_of_mink, "for comparison: `mink.solve_ik` itself"))
register_family(
    REFERENCE,
    Family(
        _reference, _solvers_of_cvxpy, lambda _: _solvers_of_cvxpy(), "for comparison: the problem written out in CVXPY"
    ),
)
