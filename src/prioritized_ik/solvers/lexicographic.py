"""The fold over the levels: each stage moves from the last one's answer, only along what changes nothing above it.

The closed form comes first: if it meets every row it is the optimum of every level, and no QP is needed. The polish comes
last: it makes the answer exact, and the certificate proves it.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import cast

from prioritized_ik.errors import InfeasibleError, InputError, StepNotFoundError
from prioritized_ik.problem import IKProblem, step_scale
from prioritized_ik.solvers.backends.abilities import abilities_of
from prioritized_ik.solvers.backends.protocol import AnyBackend, Backend, StageResult, WholeBackend
from prioritized_ik.solvers.backends.registry import ACCURACY, get_backend
from prioritized_ik.solvers.certificate import Proof
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.cones import directions_left
from prioritized_ik.solvers.conflict import find_conflict
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.solvers.polish import Polished, polish
from prioritized_ik.solvers.stages import Room, Stage, damped_stage, level_stage, reference_stage, slack_stage
from prioritized_ik.solvers.step import JointStep, StepStatus, Timings
from prioritized_ik.validation import Array, fraction, non_negative, one_of

FORMULATIONS = ("lexicographic", "damped", "slack")

#: Those that are one QP, solved as it stands; the other is a fold over stages.
ONE_QP = {"damped": damped_stage, "slack": slack_stage}

#: A step may break a row by this fraction of its own size; beyond, it is not accepted.
ACCEPTED_VIOLATION = 1e-6

#: A closed-form step that breaks no row by more than this fraction of itself, its own rounding, breaks none.
FREE = 1e-12

TIGHT = 1e-7  # [rad] a row this close to binding is tight: ten times what a solver at accuracy 1e-8 leaves open
NARROW = 1e-5  # tight rows that leave a wedge narrower than this leave no room: solvers fail on narrower ones


@dataclass(frozen=True)
class SolveOptions:
    """How to solve.

    Attributes:
        formulation: `"lexicographic"`, exact; for comparison `"damped"`, what mink and pink do, and `"slack"`, the same
            optimum without squaring J.
        accuracy: asked of the solver, see `registry.get_backend`.
        rank_tolerance: relative to the largest singular value of J; shared by closed form and QP.
        damping: of the damped and slack formulations; mink's and pink's own default.
        closed_form_first: whether a closed-form step that meets every row is the answer.
        polish: whether the solver's answer is made exact; its certificate is computed in any case.
        soften: names of hard bounds and rows that become the most important level instead, one of soft inequalities.
    """

    formulation: str = "lexicographic"
    accuracy: float = ACCURACY
    rank_tolerance: float = RANK_TOLERANCE
    damping: float = 1e-12
    closed_form_first: bool = True
    polish: bool = True
    soften: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        one_of("formulation", self.formulation, FORMULATIONS)
        non_negative("damping", self.damping)
        fraction("rank_tolerance", self.rank_tolerance)
        fraction("accuracy", self.accuracy)
        object.__setattr__(self, "soften", tuple(self.soften))


def solve(problem: IKProblem, solver: str | AnyBackend = "daqp", options: SolveOptions | None = None) -> JointStep:
    """Return the joint step that is optimal at every level of `problem`.

    Args:
        problem: levels, bounds, rows, equalities and reference.
        solver: one of `known_solvers()`, or a backend from `get_backend`: those that start warm remember their last step.
        options: see `SolveOptions`.

    Raises:
        SolverUnavailableError: unknown solver, or not installed.
        InfeasibleError: no step keeps all hard rows; it names those in conflict.
        StepNotFoundError: the solver failed or broke a row; the exception keeps the step's figures.
    """
    options = options or SolveOptions()
    backend = get_backend(solver, options.accuracy) if isinstance(solver, str) else solver
    step = joint_step(problem, backend, options)
    if step.conflict is not None:
        raise InfeasibleError(str(step.conflict), step)
    if not step.found:
        raise StepNotFoundError(f"{backend.name}: {step.status.value}. {step.message}".rstrip(), step)
    return step


def joint_step(problem: IKProblem, backend: AnyBackend, options: SolveOptions) -> JointStep:
    """Return the outcome of one solve as data: a failure is a status, not an exception. See `solve`."""
    clock = _Clock()
    if options.soften:
        problem = problem.softened(options.soften)
    if options.formulation in ONE_QP:
        answer = _as_one_qp(problem, backend, clock, options)
        timings = clock.timings()
        hierarchy = Hierarchy(problem, options.rank_tolerance)
        options = replace(options, polish=False)
    else:
        hierarchy = Hierarchy(problem, options.rank_tolerance)
        if options.closed_form_first and _meets_every_row(hierarchy):
            step = _step(hierarchy, hierarchy.closed_form, StepStatus.CLOSED_FORM)
            return replace(step, timings=clock.timings())
        answer = _fold(hierarchy, backend, clock, exact=False)
        timings = clock.timings()
    step = _finished(hierarchy, answer, options)
    wanting = step.status in (StepStatus.UNCERTIFIED, StepStatus.NOT_FOUND, StepStatus.VIOLATED)
    if wanting and options.polish and not _takes_all_levels(backend):
        # An error of an upper level can have sent those below astray: once more, with every level made exact in turn.
        again = _finished(hierarchy, _fold(hierarchy, backend, clock, exact=True), options)
        step = again if again.found else step
    spent = clock.timings()
    return replace(
        step,
        timings=Timings(timings.build, spent.solve, spent.build - timings.build),
        calls=clock.calls,
    )


def first_stage(problem: IKProblem, options: SolveOptions | None = None) -> Stage:
    """Return the first stage of `problem` to look at: its `problem` is a plain `qpsolvers.Problem`."""
    options = options or SolveOptions()
    if options.formulation in ONE_QP:
        return _one_qp(problem, options)
    return level_stage(Room.whole(Hierarchy(problem, options.rank_tolerance)))


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
    dtheta = hierarchy.closed_form
    allowed = FREE * step_scale(dtheta)
    return bool((hierarchy.rows.slack(dtheta) >= -allowed).all()) and hierarchy.problem.relative_violation(dtheta) <= FREE


def _fold(hierarchy: Hierarchy, backend: AnyBackend, clock: _Clock, *, exact: bool) -> Array | str:
    """Return the solver's dθ `(m,)`, each level's answer polished if `exact`, or why there is none."""
    if _takes_all_levels(backend):
        result = clock.timed(partial(cast(WholeBackend, backend).solve_whole, hierarchy))
        return result.message if result.x is None else result.x
    solver = cast(Backend, backend)
    room = Room.whole(hierarchy)
    for level in hierarchy.problem.levels:
        stage = level_stage(room)
        result = clock.timed(partial(solver.solve, stage))
        if result.x is None:
            return f"level {level.name!r}: {result.message}"
        dtheta = stage.dtheta(result.x)
        if exact:
            so_far = _exact_so_far(hierarchy, room.place, dtheta)
            dtheta, free = so_far.dtheta, so_far.proof.free
        else:
            left = room.after(dtheta, stage.unfelt)
            free = directions_left(left.free, left.rows[left.slack <= TIGHT], NARROW)
        room = room.after(dtheta, free) if exact or free is not left.free else left
        if not free.shape[1]:
            return dtheta
    stage = reference_stage(room)
    result = clock.timed(partial(solver.solve, stage))
    return f"last level: {result.message}" if result.x is None else stage.dtheta(result.x)


def _as_one_qp(problem: IKProblem, backend: AnyBackend, clock: _Clock, options: SolveOptions) -> Array | str:
    """Return dθ `(m,)` of the one QP of a formulation that is one, or why there is none."""
    formulation = options.formulation
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


def _exact_so_far(hierarchy: Hierarchy, place: int, dtheta: Array) -> Polished:
    """Return the optimum of the levels up to `place` that is nearest to `dtheta`, an answer to them."""
    problem = hierarchy.problem
    so_far = IKProblem(problem.levels[: place + 1], problem.bounds, problem.rows, dtheta, problem.equalities)
    return polish(Hierarchy(so_far, hierarchy.rank_tolerance), dtheta)


def _finished(hierarchy: Hierarchy, answer: Array | str, options: SolveOptions) -> JointStep:
    """Return the step that a solver's answer leads to: polished, certified, and refused if it breaks a row.

    Of a solver that gave up, `answer` says why; the rows may be in conflict.
    """
    if isinstance(answer, str):
        conflict = find_conflict(hierarchy.problem)
        status = StepStatus.NOT_FOUND if conflict is None else StepStatus.INFEASIBLE
        return JointStep(None, status, answer, conflict=conflict)
    polished = polish(hierarchy, answer) if options.polish else Polished(answer, Proof(hierarchy, answer), 0, ended=True)
    certified = polished.ended and polished.proof.certificate.holds
    status = StepStatus.SOLVED if certified else StepStatus.UNCERTIFIED
    step = replace(_step(hierarchy, polished.dtheta, status, polished.proof), raw=answer, repairs=polished.repairs)
    if step.violation <= ACCEPTED_VIOLATION:
        return step
    conflict = find_conflict(hierarchy.problem)
    status = StepStatus.VIOLATED if conflict is None else StepStatus.INFEASIBLE
    message = f"worst relative violation {step.violation:.1e}"
    return replace(step, dtheta=None, status=status, message=message, conflict=conflict)


def _step(hierarchy: Hierarchy, dtheta: Array, status: StepStatus, proof: Proof | None = None) -> JointStep:
    problem = hierarchy.problem
    certificate = (proof or Proof(hierarchy, dtheta)).certificate
    return JointStep(
        dtheta,
        status,
        costs=tuple(level.cost(dtheta) for level in problem.levels),
        tight_rows=problem.tight_rows(dtheta, ACCEPTED_VIOLATION * step_scale(dtheta)),
        violation=certificate.violation,
        certificate=certificate,
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
    return ONE_QP[formulation](problem, level, options.damping)
