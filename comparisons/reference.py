"""The problem written out in CVXPY, as a method: it shares no code with what finds a step."""

from dataclasses import replace
from functools import partial
from importlib.metadata import version

from prioritized_ik.errors import WitnessError
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.backends.protocol import StageResult
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.solvers.lexicographic import Clock, SolveOptions, joint_step
from prioritized_ik.solvers.methods import Method, Place, unaided
from prioritized_ik.solvers.step import JointStep
from prioritized_ik.solvers.witness import witness_step
from prioritized_ik.validation import Array


class Reference(Method):
    """`witness.witness_step` with one of CVXPY's solvers."""

    def __init__(self, solver: str) -> None:
        self.name = f"reference:{solver}"
        self._solver = solver.upper()

    @property
    def version(self) -> str:
        """Version of CVXPY."""
        return version("cvxpy")

    def step(self, problem: IKProblem, options: SolveOptions | None = None, place: Place | None = None) -> JointStep:
        """See `Method.step`."""
        step = joint_step(problem, self._answer, unaided(self, options), self.name)
        return replace(step, timings=replace(step.timings, build=0.0))  # which is not CVXPY's

    def _answer(self, problem: IKProblem, hierarchy: Hierarchy, clock: Clock) -> Array | str:
        result = clock.timed(partial(self._solved, hierarchy))
        return result.message if result.x is None else result.x

    def _solved(self, hierarchy: Hierarchy) -> StageResult:
        try:
            return StageResult(witness_step(hierarchy.cut_problem, self._solver))
        except WitnessError as error:
            return StageResult(None, str(error))
