"""The fold over the levels: each stage moves from the last one's answer, only along what changes nothing above it.

The closed form comes first: if it meets every row it is the optimum of every level, and no QP is needed.
"""

import time
from dataclasses import dataclass, replace

import numpy as np
import scipy.optimize

from prioritized_ik.errors import InputError, StepNotFoundError
from prioritized_ik.problem import STEP_FLOOR, IKProblem, Level
from prioritized_ik.solvers.backends.protocol import Backend, StageResult
from prioritized_ik.solvers.backends.registry import ACCURACY, get_backend
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE, null_space, rank_decomposition_svd, strict_solution
from prioritized_ik.solvers.stages import SETTLED_ROW, Room, Stage, damped_stage, reference_stage, task_stage
from prioritized_ik.solvers.step import JointStep, StepStatus, Timings
from prioritized_ik.validation import Array, fraction, non_negative, one_of

FORMULATIONS = ("lexicographic", "damped")

#: A step may break a row by this fraction of its own size; beyond, it is not accepted.
ACCEPTED_VIOLATION = 1e-6

#: A closed-form step that breaks no row by more than this fraction of itself, its own rounding, breaks none.
FREE = 1e-12

TIGHT = 1e-7  # [rad] a row this close to binding is tight: ten times what a solver at accuracy 1e-8 leaves open
PARALLEL = 1e-5  # tight rows that leave a wedge narrower than this leave no room: solvers fail on narrower ones


@dataclass(frozen=True)
class SolveOptions:
    """How to solve.

    Attributes:
        formulation: `"lexicographic"`, exact; `"damped"`, what mink and pink do, for comparison.
        accuracy: asked of the solver, see `registry.get_backend`.
        rank_tolerance: relative to the largest singular value of J; shared by closed form and QP.
        damping: of the damped formulation; mink's and pink's own default.
        closed_form_first: whether a closed-form step that meets every row is the answer.
    """

    formulation: str = "lexicographic"
    accuracy: float = ACCURACY
    rank_tolerance: float = RANK_TOLERANCE
    damping: float = 1e-12
    closed_form_first: bool = True

    def __post_init__(self) -> None:
        one_of("formulation", self.formulation, FORMULATIONS)
        non_negative("damping", self.damping)
        fraction("rank_tolerance", self.rank_tolerance)
        fraction("accuracy", self.accuracy)


def solve(problem: IKProblem, solver: str = "daqp", options: SolveOptions | None = None) -> JointStep:
    """Return the joint step that is optimal at every level of `problem`.

    Args:
        problem: levels, bounds, rows and reference.
        solver: one of `known_solvers()`.
        options: see `SolveOptions`.

    Raises:
        SolverUnavailableError: unknown solver, or not installed.
        StepNotFoundError: the solver failed or broke a row; the exception keeps the step's figures.
    """
    options = options or SolveOptions()
    step = joint_step(problem, get_backend(solver, options.accuracy), options)
    if not step.found:
        raise StepNotFoundError(f"{solver}: {step.status.value}. {step.message}".rstrip(), step)
    return step


def joint_step(problem: IKProblem, backend: Backend, options: SolveOptions) -> JointStep:
    """Return the outcome of one solve as data: a failure is a status, not an exception. See `solve`."""
    started = time.perf_counter()
    if options.closed_form_first and options.formulation == "lexicographic":
        dtheta = strict_solution(problem.levels, problem.reference, options.rank_tolerance)
        if problem.relative_violation(dtheta) <= FREE:
            step = _accepted(problem, dtheta, StepStatus.CLOSED_FORM)
            return replace(step, timings=Timings(time.perf_counter() - started, 0.0))
    clock = _Clock(backend)
    answer = _fold(problem, clock, options) if options.formulation == "lexicographic" else _damped(problem, clock, options)
    timings = Timings(time.perf_counter() - started - clock.seconds, clock.seconds)
    if isinstance(answer, str):
        return JointStep(None, StepStatus.NOT_FOUND, answer, timings=timings, calls=clock.calls)
    step = _accepted(problem, answer, StepStatus.SOLVED)
    if step.violation > ACCEPTED_VIOLATION:
        step = replace(
            step, dtheta=None, status=StepStatus.VIOLATED, message=f"worst relative violation {step.violation:.1e}"
        )
    return replace(step, timings=timings, calls=clock.calls)


def first_stage(problem: IKProblem, options: SolveOptions | None = None) -> Stage:
    """Return the first stage of `problem` to look at: its `problem` is a plain `qpsolvers.Problem`."""
    options = options or SolveOptions()
    if options.formulation == "damped":
        return damped_stage(problem, _only_level(problem), options.damping)
    return task_stage(problem.levels[0], Room.whole(problem), options.rank_tolerance)


class _Clock:
    """A backend that is timed."""

    def __init__(self, backend: Backend) -> None:
        self._backend = backend
        self.seconds = 0.0
        self.calls = 0

    def solve(self, stage: Stage) -> StageResult:
        started = time.perf_counter()
        result = self._backend.solve(stage)
        self.seconds += time.perf_counter() - started
        self.calls += result.calls
        return result


def _fold(problem: IKProblem, backend: _Clock, options: SolveOptions) -> Array | str:
    """Return dθ `(m,)`, or why there is none."""
    room = Room.whole(problem)
    for level in problem.levels:
        stage = task_stage(level, room, options.rank_tolerance)
        result = backend.solve(stage)
        if result.x is None:
            return f"level {level.name!r}: {result.message}"
        dtheta = stage.dtheta(result.x)
        room = room.after(dtheta, _directions_left(room.after(dtheta, stage.unfelt)))
        if not room.free.shape[1]:
            return dtheta
    stage = reference_stage(problem.reference, room)
    result = backend.solve(stage)
    return f"last level: {result.message}" if result.x is None else stage.dtheta(result.x)


def _directions_left(room: Room) -> Array:
    """Return the directions `(m, f)` among the free ones of `room` in which no tight row is bound to stay tight.

    Tight rows B can leave a level's optima no room on either side: where a positive combination λᵀB vanishes, the rows
    in it are zero throughout {w: B w <= 0} (Stiemke). For all levels below they are equalities, and handing them on as
    inequalities would leave a feasible set without interior, on which most solvers fail. This is a matter of geometry,
    so it does not depend on the size of multipliers.
    """
    lengths = np.linalg.norm(room.rows, axis=1)
    tight = room.rows[room.slack <= TIGHT * lengths]
    free = room.free
    while len(tight) and free.shape[1]:
        cone = tight @ free
        norms = np.linalg.norm(cone, axis=1)
        moving = norms > SETTLED_ROW * np.linalg.norm(tight, axis=1)
        if not moving.any():
            return free
        cone = cone[moving] / norms[moving, None]
        # The shortest convex combination of the rows: if it is not zero, it points to where all of them are strict.
        convex = np.vstack([cone.T, np.ones(len(cone))])
        combination, distance = scipy.optimize.nnls(convex, np.eye(len(convex))[-1])
        if distance > PARALLEL:
            return free
        free = free @ null_space(rank_decomposition_svd(cone[combination > PARALLEL], PARALLEL).j_b)
    return free


def _damped(problem: IKProblem, backend: _Clock, options: SolveOptions) -> Array | str:
    """Return dθ `(m,)` of the damped QP, or why there is none."""
    stage = damped_stage(problem, _only_level(problem), options.damping)
    result = backend.solve(stage)
    return result.message if result.x is None else stage.dtheta(result.x)


def _only_level(problem: IKProblem) -> Level:
    if len(problem.levels) != 1:
        raise InputError(f"the damped formulation takes one level, not {len(problem.levels)}; use 'lexicographic'.")
    return problem.levels[0]


def _accepted(problem: IKProblem, dtheta: Array, status: StepStatus) -> JointStep:
    scale = max(float(np.linalg.norm(dtheta)), STEP_FLOOR)
    return JointStep(
        dtheta,
        status,
        costs=tuple(level.cost(dtheta) for level in problem.levels),
        tight_rows=problem.tight_rows(dtheta, ACCEPTED_VIOLATION * scale),
        violation=problem.relative_violation(dtheta),
    )
