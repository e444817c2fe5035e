"""Many problems at once, over processes: bit for bit the steps that they have one by one."""

from collections.abc import Iterable
from functools import partial

from prioritized_ik.errors import InputError
from prioritized_ik.problem import IKProblem
from prioritized_ik.processes import over_processes
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.registry import DEFAULT, get_method
from prioritized_ik.solvers.solve import step_of
from prioritized_ik.solvers.step import JointStep


def solve_many(
    problems: Iterable[IKProblem], solver: str = DEFAULT, options: SolveOptions | None = None, workers: int | None = None
) -> list[JointStep]:
    """Return the step of each problem, in order; a failure is a step's status, not an exception.

    Every problem is solved from nothing, so that its step does not depend on its neighbours nor on the number of workers.
    Processes are started anew: a script must have its work under `if __name__ == "__main__":`.

    Args:
        problems: any number.
        solver: see `solve`, by name.
        options: see `SolveOptions`.
        workers: processes; as many as there are processors unless given. 1: none but this one.

    Raises:
        InputError: something that is no IKProblem; no worker.
        SolverUnavailableError: unknown solver, or not installed.
    """
    given, options = list(problems), options or SolveOptions()
    for number, problem in enumerate(given):
        if not isinstance(problem, IKProblem):
            raise InputError(f"problems[{number}] is of type {type(problem).__name__}; expected an IKProblem.")
    get_method(solver, options.accuracy)  # what is not installed is told here
    return over_processes(partial(_solved, solver=solver, options=options), given, workers)


def _solved(problem: IKProblem, solver: str, options: SolveOptions) -> JointStep:
    return step_of(get_method(solver, options.accuracy), problem, options)
