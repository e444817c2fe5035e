"""The user's own QPs, saved by `qpsolvers.Problem.save`: every solver on each, judged by the residuals of the problem."""

import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import qpsolvers
import scipy.sparse

from comparisons.isolation import ERROR, MEMORY, NAN, Limits, Tell, isolated_each
from comparisons.tables import QPS, Record
from prioritized_ik.errors import EpisodeFileError
from prioritized_ik.files import UNREADABLE
from prioritized_ik.solvers.backends.abilities import abilities_of
from prioritized_ik.solvers.backends.qpsolvers_ import SOLVER_ERRORS


def load_qp(path: Path) -> qpsolvers.Problem:
    """Return the QP that `qpsolvers.Problem.save` wrote.

    Raises:
        EpisodeFileError: the file is something else, or damaged.
    """
    try:
        with open(path, "rb") as file:
            problem = qpsolvers.Problem.load(file)
        problem.check_constraints()
    except (*UNREADABLE, qpsolvers.exceptions.ProblemError) as error:
        raise EpisodeFileError(f"cannot read a QP from {str(path)!r} ({error}); write it with `Problem.save`.") from error
    return problem


def measure_qps(solver: str, accuracy: float, problems: dict[str, qpsolvers.Problem], limits: Limits) -> list[Record]:
    """Return one record for each of `problems`, by name: what one solver makes of it, in a process of its own."""

    def failed(name: str, failure: str, message: str) -> Record:
        return {**dict.fromkeys(QPS), "qp": name, "found": False, "failure": failure, "message": message}

    def arguments(names: Sequence[str]) -> tuple[Any, ...]:
        return solver, accuracy, {name: problems[name] for name in names}

    return isolated_each(solve_qps, list(problems), arguments, failed, limits)[1]


def solve_qps(tell: Tell, solver: str, accuracy: float, problems: dict[str, qpsolvers.Problem]) -> None:
    """Tell one record for each of `problems`. Work for `isolation.isolated`."""
    abilities = abilities_of(solver)
    for name, problem in problems.items():
        record: Record = {**dict.fromkeys(QPS), "qp": name, "found": False}
        given = _sparse(problem) if abilities.sparse else problem
        started = time.perf_counter()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                solution = qpsolvers.solve_problem(given, solver=solver, **abilities.options(accuracy))
        except SOLVER_ERRORS as error:
            tell({**record, "message": f"{solver} raised {type(error).__name__}: {error}"})
            continue
        except MemoryError:
            tell({**record, "failure": MEMORY, "message": f"{solver} took more memory than it may"})
            continue
        except Exception as error:  # of a library that is on trial
            tell({**record, "failure": ERROR, "message": f"{solver} raised {type(error).__name__}: {error}"})
            continue
        record["solve_s"] = time.perf_counter() - started
        if not solution.found or solution.x is None:
            tell({**record, "message": f"{solver} found no solution"})
        elif not np.isfinite(solution.x).all():
            tell({**record, "failure": NAN, "message": f"{solver} returned values that are not finite"})
        else:
            solution.problem = problem
            residuals = {
                "primal_residual": solution.primal_residual(),
                "dual_residual": solution.dual_residual(),
                "duality_gap": solution.duality_gap(),
            }
            tell({**record, "found": True, **{key: float(value) for key, value in residuals.items()}})


def _sparse(problem: qpsolvers.Problem) -> qpsolvers.Problem:
    def sparse(matrix: Any) -> Any:
        return None if matrix is None else scipy.sparse.csc_matrix(matrix)

    rest = (problem.lb, problem.ub)
    return qpsolvers.Problem(
        sparse(problem.P), problem.q, sparse(problem.G), problem.h, sparse(problem.A), problem.b, *rest
    )
