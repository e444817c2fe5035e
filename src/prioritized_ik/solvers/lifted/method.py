"""Sparse QP solvers level by level in the lifted form, as methods."""

from dataclasses import replace
from functools import partial

from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.backends.sparse import SparseBackend
from prioritized_ik.solvers.compiled.library import Question
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.solvers.lexicographic import Clock, SolveOptions, joint_step
from prioritized_ik.solvers.lifted.fold import lifted_fold
from prioritized_ik.solvers.lifted.stages import LiftedProblem
from prioritized_ik.solvers.methods import Method, Place, kernel_path, undamped
from prioritized_ik.solvers.step import JointStep, Timings
from prioritized_ik.solvers.tree.step import is_worthwhile, tree_step
from prioritized_ik.validation import Array

FAMILY = "lifted"


class Lifted(Method):
    """A sparse QP solver answers level by level, link by link, and the kernel makes its answer the optimum.

    It takes problems all of whose levels and rows are of points on one kinematic tree, see `tree_problem`.

    Attributes:
        backend: the solver.
    """

    def __init__(self, backend: SparseBackend) -> None:
        self.backend = backend
        self.name = f"{FAMILY}:{backend.name}"

    def __repr__(self) -> str:
        """Return what makes it."""
        return f"Lifted({self.backend!r})"

    @property
    def version(self) -> str:
        """Version of the solver."""
        return self.backend.version

    @property
    def path(self) -> str:
        """See `Method.path`; of the kernel. On long trees it is "tree", which the steps say."""
        return kernel_path()

    def guess(self, problem: IKProblem) -> Array | str:
        """Return the solver's own dθ `(m,)`, or why there is none.

        Raises:
            InputError: the problem is not on a kinematic tree; the message says what holds a matrix.
        """
        answer = lifted_fold(self.backend, LiftedProblem(problem))
        return answer if isinstance(answer, str) else problem.from_metric(answer)

    def step(self, problem: IKProblem, options: SolveOptions | None = None, place: Place | None = None) -> JointStep:
        """See `Method.step`.

        Raises:
            InputError: the problem is not on a kinematic tree; the message says what holds a matrix.
        """
        options = undamped(self, options)
        if options.soften:
            problem, options = problem.softened(options.soften), replace(options, soften=())
        lifted, clock = LiftedProblem(problem), Clock()
        if not options.polish or not is_worthwhile(problem, options.kinematics):
            return joint_step(problem, partial(self._answer, lifted, None), options, self.name)
        if options.closed_form_first:
            found = tree_step(problem, options.rank_tolerance, question=Question.CLOSED_FORM_ONLY, method=self.name)
            if found is not None:
                return found[0]
        answer = self._folded(lifted, clock)
        if not isinstance(answer, str):
            built = clock.timings().build
            names = lifted.rests_on(answer)
            found = tree_step(problem, options.rank_tolerance, names, Question.FROM_GUESS_ONLY, self.name)
            if found is not None:
                spent = clock.timings()
                timings = Timings(built, spent.solve, spent.build - built)
                return replace(found[0], raw=problem.from_metric(answer), timings=timings, calls=clock.calls)
        return joint_step(problem, partial(self._answer, lifted, answer), options, self.name)

    def _folded(self, lifted: LiftedProblem, clock: Clock) -> Array | str:
        return lifted_fold(self.backend, lifted, lambda stage: clock.timed(lambda: self.backend.solve(stage)))

    def _answer(
        self, lifted: LiftedProblem, known: Array | str | None, problem: IKProblem, hierarchy: Hierarchy, clock: Clock
    ) -> Array | str:
        """Return the answer that is `known`, or the solver's."""
        return self._folded(lifted, clock) if known is None else known
