"""The ways from a problem to a joint step. Each is a `Method`; `registry` finds them by name, and `solve` is the door.

- `ActiveSet`: the kernel by itself, from the rows of its last step. No QP solver is called.
- `Lexicographic`: a QP solver answers level by level, and the kernel makes its answer the optimum.
- `ClosedForm`: Eqs. 6 and 12 to 14 alone.
- `Damped`, `Slack`: for comparison, the one QP of mink and pink, and the same optimum without squaring J.
"""

import importlib.metadata
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

from prioritized_ik.errors import InputError
from prioritized_ik.problem import IKProblem, Level
from prioritized_ik.solvers.backends.abilities import abilities_of
from prioritized_ik.solvers.backends.protocol import Backend
from prioritized_ik.solvers.compiled.library import library
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.solvers.lexicographic import STANDARD, Clock, RowMemory, SolveOptions, fold, joint_step
from prioritized_ik.solvers.stages import Stage, damped_stage, slack_stage
from prioritized_ik.solvers.step import JointStep, StepStatus
from prioritized_ik.validation import Array

#: Of the methods that are one damped QP: what mink and pink take.
DAMPING = 1e-12


@dataclass(frozen=True)
class Place:
    """Where a problem was posed, for methods that pose the task anew in their own terms.

    Attributes:
        q: joint positions `(nq,)`.
        scene: what posed it there, such as `winding.settings.WindingSettings`.
    """

    q: Array
    scene: object


class Method(ABC):
    """One way from a problem to a joint step. One serves one thread at a time; make one for each.

    A method of your own needs `name`, `version` and `step`; `registry.register` makes it known by its name everywhere. A
    step that it returns without a certificate is given one where it is used, and refused if it breaks a row.

    Attributes:
        name: what the registry calls it.
    """

    name: str

    @property
    def path(self) -> str:
        """What its steps are computed by."""
        return "python"

    @property
    @abstractmethod
    def version(self) -> str:
        """Version of what computes the step."""

    @abstractmethod
    def step(self, problem: IKProblem, options: SolveOptions | None = None, place: Place | None = None) -> JointStep:
        """Return the outcome of one solve as data: a failure is a status, not an exception.

        Args:
            problem: levels and limits.
            options: how to solve.
            place: where the problem was posed, if somebody knows.

        Raises:
            InputError: the method does not know such a problem, or such options.
        """


class _Own(Method):
    """A method of this package alone."""

    @property
    def version(self) -> str:
        """Version of this package."""
        try:
            return importlib.metadata.version("prioritized-ik")
        except importlib.metadata.PackageNotFoundError:  # the sources on the path, not installed
            return "unknown"


def kernel_path() -> str:
    """What the kernel runs on here, where the compiled core does not decline."""
    return "compiled" if library().core is not None else "python"


class ActiveSet(_Own):
    """The kernel by itself: it starts from the rows of its last step, and calls no QP solver."""

    name = "active-set"

    @property
    def path(self) -> str:
        """See `Method.path`."""
        return kernel_path()

    def __init__(self) -> None:
        self._memory = RowMemory()

    def step(self, problem: IKProblem, options: SolveOptions | None = None, place: Place | None = None) -> JointStep:
        """See `Method.step`."""
        return joint_step(problem, self._memory, undamped(self, options), self.name)


class ClosedForm(_Own):
    """Eqs. 6 and 12 to 14, level by level: they know no inequality, and a step that breaks one is refused."""

    name = "closed-form"

    def step(self, problem: IKProblem, options: SolveOptions | None = None, place: Place | None = None) -> JointStep:
        """See `Method.step`."""
        step = joint_step(problem, self._answer, unaided(self, options), self.name)
        return replace(step, status=StepStatus.CLOSED_FORM) if step.status is StepStatus.SOLVED else step

    @staticmethod
    def _answer(problem: IKProblem, hierarchy: Hierarchy, clock: Clock) -> Array | str:
        return hierarchy.closed_form


class Guessing(Method):
    """A method that makes a guess of a hierarchy's optimum; the kernel makes it the optimum and proves it."""

    @property
    def path(self) -> str:
        """See `Method.path`; of the kernel."""
        return kernel_path()

    def step(self, problem: IKProblem, options: SolveOptions | None = None, place: Place | None = None) -> JointStep:
        """See `Method.step`."""
        return joint_step(problem, self._answer, undamped(self, options), self.name)

    @abstractmethod
    def guess(self, hierarchy: Hierarchy, clock: Clock) -> Array | str:
        """Return u `(m,)`, in the joint metric, or why there is none; `clock` times the solver."""

    def _answer(self, problem: IKProblem, hierarchy: Hierarchy, clock: Clock) -> Array | str:
        return self.guess(hierarchy, clock)


class Lexicographic(Guessing):
    """A QP solver answers level by level.

    Attributes:
        backend: the solver.
    """

    def __init__(self, backend: Backend) -> None:
        self.backend = backend
        self.name = f"lexicographic:{backend.name}"

    @property
    def version(self) -> str:
        """Version of the solver."""
        return self.backend.version

    def guess(self, hierarchy: Hierarchy, clock: Clock) -> Array | str:
        """See `Guessing.guess`."""
        return fold(self.backend, hierarchy, clock)


class OneQp(Method):
    """A QP solver answers one QP, which is another problem than the strict levels. For comparison.

    Attributes:
        backend: the solver.
        accurate: whether the solver gets the accuracy, the refinement and the second attempt that it gets in the stages of
            `Lexicographic`, in place of one call with its default options.
    """

    family: ClassVar[str]

    @staticmethod
    @abstractmethod
    def _qp(problem: IKProblem, level: Level, damping: float) -> Stage: ...

    def __init__(self, backend: Backend, *, accurate: bool = False) -> None:
        self.backend = backend
        self.accurate = accurate
        self.name = f"{self.family}:{backend.name}"

    @property
    def version(self) -> str:
        """Version of the solver."""
        return self.backend.version

    def stage(self, problem: IKProblem, options: SolveOptions | None = None) -> Stage:
        """Return the QP to look at: `problem` of the stage is a plain `qpsolvers.Problem`.

        Raises:
            InputError: several levels, or a soft one.
        """
        if len(problem.levels) != 1:
            raise InputError(
                f"the {self.family} formulation takes one level, not {len(problem.levels)}; use 'lexicographic'."
            )
        (level,) = problem.levels
        if level.is_soft:
            raise InputError(
                f"the {self.family} formulation takes a level of kind 'equal', not 'at_most'; use 'lexicographic'."
            )
        damping = DAMPING if options is None or options.damping is None else options.damping
        return self._qp(problem.in_metric, problem.in_metric.levels[0], damping)

    def step(self, problem: IKProblem, options: SolveOptions | None = None, place: Place | None = None) -> JointStep:
        """See `Method.step`."""
        options = options or STANDARD
        by_itself = replace(options, polish=False, closed_form_first=False)
        return joint_step(problem, partial(self._answer, options), by_itself, self.name)

    def _answer(self, options: SolveOptions, problem: IKProblem, hierarchy: Hierarchy, clock: Clock) -> Array | str:
        stage = self.stage(problem, options)
        result = clock.timed(partial(self.backend.solve if self.accurate else self.backend.solve_once, stage))
        return result.message if result.x is None else stage.dtheta(result.x)


class Damped(OneQp):
    """The QP of mink and pink, see `stages.damped_stage`."""

    family = "damped"
    _qp = staticmethod(damped_stage)


class Slack(OneQp):
    """The same optimum without squaring J, see `stages.slack_stage`."""

    family = "slack"
    _qp = staticmethod(slack_stage)

    def __init__(self, backend: Backend, *, accurate: bool = False) -> None:
        if abilities_of(backend.name).native:
            raise InputError(
                f"{backend.name} takes no equality rows; the slack formulation needs a solver called through qpsolvers."
            )
        super().__init__(backend, accurate=accurate)


def undamped(method: Method, options: SolveOptions | None) -> SolveOptions:
    """Return the options of a method that has no damping of its own.

    Raises:
        InputError: they ask for it.
    """
    options = options or STANDARD
    if options.damping is not None:
        raise InputError(
            f"damping is {options.damping!r}, but {method.name} has none; damp a level instead: Level(damping=…)."
        )
    return options


def unaided(method: Method, options: SolveOptions | None) -> SolveOptions:
    """Return the options by which the answer of an undamped method is asked for in any case, and is the step."""
    return replace(undamped(method, options), polish=False, closed_form_first=False)
