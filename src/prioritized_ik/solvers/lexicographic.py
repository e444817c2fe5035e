"""One solve, from the problem to a certified step, and the fold over levels by which a QP solver makes its guess.

The closed form comes first: if it meets every row it is the optimum of every level (Eqs. 6 and 12 to 14), and no QP is
needed. Otherwise a guess of the rows that the optimum rests on (the rows of the last step, or a QP solver's answer level by
level) goes to the active-set kernel, which makes it the optimum and proves it.
"""

import importlib.metadata
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import partial
from typing import cast

import numpy as np

from prioritized_ik.errors import InfeasibleError, InputError, SolverUnavailableError, StepNotFoundError
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers import active_set
from prioritized_ik.solvers.active_set import Active, Solution
from prioritized_ik.solvers.backends.abilities import abilities_of
from prioritized_ik.solvers.backends.protocol import AnyBackend, Backend, StageResult, WholeBackend
from prioritized_ik.solvers.backends.registry import ACCURACY, get_backend
from prioritized_ik.solvers.certificate import Proof
from prioritized_ik.solvers.compiled import fast
from prioritized_ik.solvers.compiled.library import Question
from prioritized_ik.solvers.conflict import find_conflict
from prioritized_ik.solvers.damping import handed_down
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.solvers.report import level_reports
from prioritized_ik.solvers.stages import FoldState, Stage, damped_stage, level_stage, reference_stage, slack_stage
from prioritized_ik.solvers.stagewise import stagewise
from prioritized_ik.solvers.step import JointStep, StepStatus, Timings
from prioritized_ik.solvers.subspaces import directions_left
from prioritized_ik.tolerances import ACCEPTED_VIOLATION, FREE, NARROW, SETTLED_FOR_SOLVERS, TIGHT, WEAK
from prioritized_ik.validation import Array, fraction, non_negative, one_of, tolerance_above_rounding

FORMULATIONS = ("lexicographic", "damped", "slack")

#: Those that are one QP, solved as it stands; the other is a fold over stages.
ONE_QP = {"damped": damped_stage, "slack": slack_stage}

#: The damping of mink and pink, of the formulations that are one QP.
DAMPING = 1e-12


@dataclass(frozen=True)
class SolveOptions:
    """How to solve.

    Attributes:
        formulation: `"lexicographic"`, exact; for comparison `"damped"`, what mink and pink do, and `"slack"`, the same
            optimum without squaring J.
        accuracy: asked of the solver, see `registry.get_backend`.
        rank_tolerance: singular values up to this fraction of the largest of a level's matrix count as zero; shared by
            closed form and QP. 0: only what is rounding, see `closed_form.level_decomposition`.
        damping: of the damped and slack formulations, 1e-12 unless given, mink's and pink's own default.
        closed_form_first: whether a closed-form step that meets every row is the answer.
        polish: whether the solver's answer is made exact; its certificate is computed in any case.
        soften: names of hard bounds and rows that become the most important level instead, one of soft inequalities.
    """

    formulation: str = "lexicographic"
    accuracy: float = ACCURACY
    rank_tolerance: float = 0.0
    damping: float | None = None
    closed_form_first: bool = True
    polish: bool = True
    soften: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        one_of("formulation", self.formulation, FORMULATIONS)
        if self.damping is not None:
            non_negative("damping", self.damping)
            if self.formulation not in ONE_QP:
                raise InputError(
                    f"damping is {self.damping!r}, but the {self.formulation} formulation has none; "
                    "damp a level instead: Level(damping=…)."
                )
        if non_negative("rank_tolerance", self.rank_tolerance):
            tolerance_above_rounding("rank_tolerance", self.rank_tolerance)
        fraction("accuracy", self.accuracy)
        object.__setattr__(self, "soften", tuple(self.soften))


class ActiveSet:
    """The kernel by itself: it starts from the rows of its last step, and calls no QP solver.

    Attributes:
        name: "active-set".
        last: the rows that the last step rested on, with a multiplier or not, or their names.
    """

    name = "active-set"

    def __init__(self) -> None:
        self.last: Collection[str] | fast.Remembered = ()

    @property
    def version(self) -> str:
        """Version of this package."""
        return importlib.metadata.version("prioritized-ik")

    def guess(self, hierarchy: Hierarchy) -> Active:
        """Return the rows `(r,)` that the last step rested on."""
        last = frozenset(self.last.named() if isinstance(self.last, fast.Remembered) else self.last)
        return np.array([name in last for name in hierarchy.rows.names], dtype=bool)

    def remember(self, rows: Collection[str] | fast.Remembered) -> None:
        """Keep the rows that a step rests on, or their names, for the next."""
        self.last = rows


Solver = AnyBackend | ActiveSet

#: What steps are found with unless told otherwise.
DEFAULT = ActiveSet.name


def get_solver(name: str, accuracy: float = ACCURACY) -> Solver:
    """Return the kernel by itself for "active-set", else the QP solver called `name` that makes its guesses.

    Raises:
        SolverUnavailableError: unknown, or not installed.
    """
    if name == ActiveSet.name:
        return ActiveSet()
    try:
        return get_backend(name, accuracy)
    except SolverUnavailableError as error:
        raise SolverUnavailableError(f"{error} {ActiveSet.name!r} needs no QP solver.") from error


def solve(problem: IKProblem, solver: str | Solver = DEFAULT, options: SolveOptions | None = None) -> JointStep:
    """Return the joint step that is optimal at every level of `problem`.

    Args:
        problem: levels, bounds, rows, equalities and reference.
        solver: "active-set", one of `known_solvers()`, or one from `get_solver`: those that start warm remember their last
            step.
        options: see `SolveOptions`.

    Raises:
        InputError: an argument of another kind.
        SolverUnavailableError: unknown solver, or not installed.
        InfeasibleError: no step keeps all hard rows; it names those in conflict.
        StepNotFoundError: the solver failed or broke a row; the exception keeps the step's figures.
    """
    if not isinstance(problem, IKProblem):
        raise InputError(f"problem is {_kind(problem)}; expected an IKProblem, with its levels and limits.")
    if options is not None and not isinstance(options, SolveOptions):
        raise InputError(f"options is {_kind(options)}; expected SolveOptions.")
    if not isinstance(solver, str) and not (hasattr(solver, "name") and hasattr(solver, "version")):
        raise InputError(
            f"solver is {_kind(solver)}; expected a name such as {DEFAULT!r} or 'daqp', or what get_solver returned "
            "(limits belong into the IKProblem, options into options=)."
        )
    options = options or SolveOptions()
    found = get_solver(solver, options.accuracy) if isinstance(solver, str) else solver
    step = joint_step(problem, found, options)
    if step.conflict is not None:
        raise InfeasibleError(str(step.conflict), step)
    if step.dtheta is None:
        raise StepNotFoundError(f"{found.name}: {step.status.value}. {step.message}".rstrip(), step)
    return step


def joint_step(problem: IKProblem, solver: Solver, options: SolveOptions) -> JointStep:
    """Return the outcome of one solve as data: a failure is a status, not an exception. See `solve`."""
    if options.soften:
        problem, options = problem.softened(options.soften), replace(options, soften=())
    if not any([level.damping and level.below == "free" for level in problem.levels]):
        return _undamped_step(problem, solver, options)
    clock = _Clock()
    aimed = handed_down(problem, lambda damped: _undamped_step(damped, solver, options))
    if isinstance(aimed, JointStep):
        return aimed
    timings = clock.timings()
    step = _undamped_step(aimed, solver, options)
    if step.dtheta is not None:
        step = replace(step, costs=tuple(level.cost(step.dtheta) for level in problem.levels))
    return replace(step, timings=replace(step.timings, build=step.timings.build + timings.build))


def _undamped_step(problem: IKProblem, solver: Solver, options: SolveOptions) -> JointStep:
    """Return the outcome of one solve of a problem whose damping, if any, is rows."""
    clock = _Clock()
    compiled = options.formulation == "lexicographic" and options.polish and fast.answers(problem)
    if compiled and (step := _compiled_step(problem, solver, options)) is not None:
        return step
    hierarchy = Hierarchy(problem, options.rank_tolerance)
    solution: Solution | None = None
    if hierarchy.impossible:
        return JointStep(None, StepStatus.INFEASIBLE, conflict=find_conflict(problem), timings=clock.timings())
    if options.formulation in ONE_QP:
        answer = _as_one_qp(problem, solver, clock, options)
        timings = clock.timings()
        options = replace(options, polish=False)
    else:
        if options.closed_form_first and _meets_every_row(hierarchy):
            u, proof = hierarchy.closed_form, Proof(hierarchy, hierarchy.closed_form)
            if not proof.certificate.holds:  # ill-conditioned: the kernel improves it
                better = active_set.solve(hierarchy, np.zeros(len(hierarchy.rows.upper), dtype=bool), u)
                u, proof = better.u, better.proof
            return replace(_step(problem, hierarchy, u, proof, free=True), timings=clock.timings())
        if isinstance(solver, ActiveSet):
            answer = hierarchy.start
            timings = clock.timings()
            solution = _by_active_set(hierarchy, solver)
        else:
            answer = _fold(hierarchy, solver, clock)
            timings = clock.timings()
            if compiled and not isinstance(answer, str) and (step := _from_answer(hierarchy, answer, problem, options)):
                spent = clock.timings()
                timings = Timings(timings.build, spent.solve, spent.build - timings.build)
                return replace(step, timings=timings, calls=clock.calls, raw=problem.from_metric(answer))
    step = _finished(problem, hierarchy, answer, options, solution)
    spent = clock.timings()
    return replace(
        step,
        timings=Timings(timings.build, spent.solve, spent.build - timings.build),
        calls=clock.calls,
    )


def _compiled_step(problem: IKProblem, solver: Solver, options: SolveOptions) -> JointStep | None:
    """Return the compiled core's step, or None: from the last rows, or the closed form where a QP solver is to guess."""
    if isinstance(solver, ActiveSet):
        question = Question.STEP if options.closed_form_first else Question.FROM_GUESS_ONLY
        step = fast.compiled_step(problem, options.rank_tolerance, solver.last, question)
        if step is not None and step.status is not StepStatus.CLOSED_FORM:
            solver.remember(step.written.active())
        return step
    if not options.closed_form_first:
        return None
    return fast.compiled_step(problem, options.rank_tolerance, question=Question.CLOSED_FORM_ONLY)


def _from_answer(hierarchy: Hierarchy, answer: Array, problem: IKProblem, options: SolveOptions) -> JointStep | None:
    """Return the step of the compiled core from a QP solver's answer `(m,)`, in the joint metric, or None."""
    guess = active_set.guessed(hierarchy, answer)
    names = _named(hierarchy, guess)
    return fast.compiled_step(problem, options.rank_tolerance, names, Question.FROM_GUESS_ONLY)


def _kind(value: object) -> str:
    return f"{value!r} ({type(value).__name__})" if len(repr(value)) < 60 else f"of type {type(value).__name__}"


def first_stage(problem: IKProblem, options: SolveOptions | None = None) -> Stage:
    """Return the first stage of `problem` to look at: its `problem` is a plain `qpsolvers.Problem`."""
    options = options or SolveOptions()
    if options.formulation in ONE_QP:
        return _one_qp(problem, options)
    state = FoldState.whole(Hierarchy(problem, options.rank_tolerance))
    return level_stage(state) if problem.levels else reference_stage(state)


class _Clock:
    """Times one solve, from when this is made, and the backend's part of it."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self.calls = 0
        self._started = time.perf_counter()

    def timed(self, call: Callable[[], StageResult]) -> StageResult:
        """Return what a call of the backend returns."""
        started = time.perf_counter()
        result = call()
        self.seconds += time.perf_counter() - started
        self.calls += result.calls
        return result

    def timings(self) -> Timings:
        """Return the times until now: inside the backend, and outside it."""
        return Timings(time.perf_counter() - self._started - self.seconds, self.seconds)


def _takes_all_levels(backend: AnyBackend) -> bool:
    """Whether this is a `WholeBackend`; asking by `isinstance` would take longer than a stage."""
    return hasattr(backend, "solve_whole")


def _meets_every_row(hierarchy: Hierarchy) -> bool:
    """Whether the closed form keeps every hard and soft row, and so is the optimum of every level."""
    u = hierarchy.closed_form
    allowed = FREE * hierarchy.scale(u)
    return bool((hierarchy.rows.slack(u) >= -allowed).all()) and hierarchy.problem.violation(u) <= allowed


def _by_active_set(hierarchy: Hierarchy, solver: ActiveSet) -> Solution:
    """Return what the kernel makes of the rows of the last step; failing that, of a guess from nothing."""
    guess = solver.guess(hierarchy)
    if guess.any():
        solution = active_set.solve(hierarchy, guess, hierarchy.start)
        if solution.converged:
            solver.remember(_named(hierarchy, solution.active))
            return solution
    solution = _from_nothing(hierarchy)
    solver.remember(_named(hierarchy, solution.active))
    return solution


def _named(hierarchy: Hierarchy, active: Active) -> tuple[str, ...]:
    return tuple(hierarchy.rows.names[i] for i in np.flatnonzero(active))


def _from_nothing(hierarchy: Hierarchy) -> Solution:
    """Return what the kernel makes of the levels solved one after the other."""
    first: Solution | None = None
    for weak in WEAK:
        found = stagewise(hierarchy, weak)
        u, active = found or (hierarchy.start, active_set.guessed(hierarchy, hierarchy.start))
        solution = active_set.solve(hierarchy, active, u)
        solution = replace(solution, converged=solution.proof.certificate.holds)
        if solution.converged or found is None:
            return solution
        if first is None or solution.proof.certificate.worst < first.proof.certificate.worst:
            first = solution
    assert first is not None
    return first


def _fold(hierarchy: Hierarchy, backend: AnyBackend, clock: _Clock) -> Array | str:
    """Return the solver's u `(m,)`, in the joint metric, or why there is none."""
    if _takes_all_levels(backend):
        result = clock.timed(partial(cast(WholeBackend, backend).solve_whole, hierarchy))
        return result.message if result.x is None else result.x
    solver = cast(Backend, backend)
    state = FoldState.whole(hierarchy, SETTLED_FOR_SOLVERS)
    for level in hierarchy.problem.levels:
        stage = level_stage(state)
        if not stage.costed and not len(stage.row_ids):
            state = state.after(state.origin, stage.unfelt)
            continue
        result = clock.timed(partial(solver.solve, stage))
        if result.x is None:
            return f"level {level.name!r}: {result.message}"
        u = stage.dtheta(result.x)
        left = state.after(u, stage.unfelt)
        free = directions_left(left.free, left.rows[left.slack <= TIGHT * hierarchy.length], NARROW, state.settled)
        state = left if free is left.free else left.without(free)
        if not free.shape[1]:
            return u
    stage = reference_stage(state)
    result = clock.timed(partial(solver.solve, stage))
    return f"last level: {result.message}" if result.x is None else stage.dtheta(result.x)


def _as_one_qp(problem: IKProblem, backend: Solver, clock: _Clock, options: SolveOptions) -> Array | str:
    """Return u `(m,)`, in the joint metric, of the one QP of a formulation that is one, or why there is none."""
    formulation = options.formulation
    if isinstance(backend, ActiveSet):
        raise InputError(f"{backend.name} solves whole hierarchies; the {formulation} formulation needs a QP solver.")
    if _takes_all_levels(backend):
        raise InputError(
            f"{backend.name} solves whole hierarchies; the {formulation} formulation needs a solver of single QPs."
        )
    if formulation == "slack" and abilities_of(backend.name).native:
        raise InputError(
            f"{backend.name} takes no equality rows; the slack formulation needs a solver called through qpsolvers."
        )
    stage = _one_qp(problem, options)
    result = clock.timed(partial(cast(Backend, backend).solve, stage))
    return result.message if result.x is None else stage.dtheta(result.x)


def _finished(
    problem: IKProblem, hierarchy: Hierarchy, answer: Array | str, options: SolveOptions, solution: Solution | None
) -> JointStep:
    """Return the step that a solver's answer leads to: made exact, certified, and refused if it breaks a row.

    Of a solver that gave up, `answer` says why; the rows may be in conflict. `solution` is there if no solver was called.
    """
    if isinstance(answer, str):
        conflict = find_conflict(problem)
        status = StepStatus.NOT_FOUND if conflict is None else StepStatus.INFEASIBLE
        return JointStep(None, status, answer, conflict=conflict)
    raw = None if solution is not None else problem.from_metric(answer)
    from_nothing = False
    if solution is None and options.polish:
        solution = active_set.solve(hierarchy, active_set.guessed(hierarchy, answer), answer)
        if not solution.converged:
            solution, from_nothing = _from_nothing(hierarchy), True  # the same for every solver
    if solution is None:
        solution = Solution(answer, Proof(hierarchy, answer), active_set.guessed(hierarchy, answer), 0, converged=True)
    step = _step(problem, hierarchy, solution.u, solution.proof, converged=solution.converged)
    step = replace(step, raw=raw, repairs=solution.iterations, from_nothing=from_nothing)
    if step.violation <= ACCEPTED_VIOLATION:
        return step
    conflict = find_conflict(problem)
    status = StepStatus.VIOLATED if conflict is None else StepStatus.INFEASIBLE
    message = f"worst relative violation {step.violation:.1e}"
    return replace(step, dtheta=None, status=status, message=message, conflict=conflict)


def _step(
    problem: IKProblem, hierarchy: Hierarchy, u: Array, proof: Proof, *, converged: bool = True, free: bool = False
) -> JointStep:
    certificate, dtheta = proof.certificate, problem.from_metric(u)
    status = StepStatus.CLOSED_FORM if free else StepStatus.SOLVED
    return JointStep(
        dtheta,
        status if converged and certificate.holds else StepStatus.UNCERTIFIED,
        costs=tuple(level.cost(dtheta) for level in problem.levels),
        tight_rows=problem.tight_rows(dtheta, ACCEPTED_VIOLATION * proof.scale),
        violation=certificate.violation,
        certificate=certificate,
        levels=level_reports(hierarchy, u),
        zeros=hierarchy.zeros,
        active_rows=() if free else _named(hierarchy, proof.ends_on),
    )


def _one_qp(problem: IKProblem, options: SolveOptions) -> Stage:
    formulation = options.formulation
    if len(problem.levels) != 1:
        raise InputError(f"the {formulation} formulation takes one level, not {len(problem.levels)}; use 'lexicographic'.")
    (level,) = problem.levels
    if level.is_soft:
        raise InputError(
            f"the {formulation} formulation takes a level of kind 'equal', not 'at_most'; use 'lexicographic'."
        )
    damping = DAMPING if options.damping is None else options.damping
    return ONE_QP[formulation](problem.in_metric, problem.in_metric.levels[0], damping)
