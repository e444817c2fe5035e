"""What methods share: from a problem and a start to a certified step, and the fold by which a QP solver makes its guess.

The closed form comes first: if it meets every row it is the optimum of every level (Eqs. 6 and 12 to 14), and no QP is
needed. Otherwise a guess of the rows that the optimum rests on (the rows of the last step, or a QP solver's answer level by
level) goes to the active-set kernel, which makes it the optimum and proves it.
"""

import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import partial
from itertools import compress
from typing import Any, Protocol, TypeVar

import numpy as np

from prioritized_ik.problem import IKProblem, Level
from prioritized_ik.solvers import active_set
from prioritized_ik.solvers.active_set import Active, Solution
from prioritized_ik.solvers.backends.protocol import Backend
from prioritized_ik.solvers.backends.registry import ACCURACY
from prioritized_ik.solvers.blocks import HARD
from prioritized_ik.solvers.certificate import Proof
from prioritized_ik.solvers.compiled import fast
from prioritized_ik.solvers.compiled.library import Question
from prioritized_ik.solvers.conflict import find_conflict
from prioritized_ik.solvers.damping import handed_down
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.solvers.report import DeferredReports
from prioritized_ik.solvers.stages import FoldState, Stage, level_stage, reference_stage
from prioritized_ik.solvers.stagewise import stagewise
from prioritized_ik.solvers.step import JointStep, StepStatus, Timings
from prioritized_ik.solvers.subspaces import directions_left
from prioritized_ik.solvers.tree.step import KINEMATICS, is_worthwhile, tree_step
from prioritized_ik.tolerances import (
    ACCEPTED_VIOLATION,
    FREE,
    LEAST_SETS,
    NARROW,
    ROWS_PER_SET,
    SETTLED_FOR_SOLVERS,
    TIGHT,
    WEAK,
)
from prioritized_ik.validation import Array, fraction, length, non_negative, one_of, tolerance_above_rounding


@dataclass(frozen=True)
class SolveOptions:
    """How to solve.

    Attributes:
        accuracy: asked of the solver, where a method is named and so is made for this solve, see `backends.registry`.
        rank_tolerance: singular values up to this fraction of the largest of a level's matrix count as zero; shared by
            closed form and QP. 0: only what is rounding, see `closed_form.level_decomposition`.
        damping: of the methods `damped` and `slack`, 1e-12 unless given, as in mink and pink; others refuse it.
        closed_form_first: whether a closed-form step that meets every row is the answer.
        polish: whether the solver's answer is made exact; its certificate is computed in any case.
        soften: names of hard bounds and rows that become the most important level instead, one of soft inequalities.
        kinematics: how a problem is solved whose levels and rows are of points on a kinematic tree: `"tree"`, joint by
            joint, in time that grows with the joints; `"dense"`, by its matrices; `"auto"`, by whichever is faster as a
            rule. What the tree's form does not know, or not clearly, goes by matrices; `JointStep.path` says which it was.
    """

    accuracy: float = ACCURACY
    rank_tolerance: float = 0.0
    damping: float | None = None
    closed_form_first: bool = True
    polish: bool = True
    soften: tuple[str, ...] = ()
    kinematics: str = "auto"

    def __post_init__(self) -> None:
        if self.damping is not None:
            non_negative("damping", self.damping)
        if non_negative("rank_tolerance", self.rank_tolerance):
            tolerance_above_rounding("rank_tolerance", self.rank_tolerance)
        fraction("accuracy", self.accuracy)
        one_of("kinematics", self.kinematics, KINEMATICS)
        object.__setattr__(self, "soften", tuple(self.soften))


STANDARD = SolveOptions()


class RowMemory:
    """The rows that the last step rested on, with a multiplier or not: where the kernel starts from by itself.

    Attributes:
        last: the rows, or their names; of the last step that rested on any.
        is_free: whether a step after that was the closed form, so that the next may well be.
    """

    def __init__(self) -> None:
        self.last: Collection[str] | fast.Remembered = ()
        self.is_free = False

    def guess(self, hierarchy: Hierarchy) -> Active:
        """Return the rows `(r,)` that the last step rested on."""
        last = frozenset(self.last.named() if isinstance(self.last, fast.Remembered) else self.last)
        return np.array([name in last for name in hierarchy.rows.names], dtype=bool)

    def remember(self, rows: Collection[str] | fast.Remembered) -> None:
        """Keep the rows that a step rests on, or their names, for the next."""
        self.last, self.is_free = rows, False


class _Counts(Protocol):
    """What a backend returns: it says how often the solver was called."""

    @property
    def calls(self) -> int: ...


Called = TypeVar("Called", bound=_Counts)


class Clock:
    """Times one solve, from when this is made, and the backend's part of it."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self.calls = 0
        self._started = time.perf_counter()

    def timed(self, call: Callable[[], Called]) -> Called:
        """Return what a call of the backend returns."""
        started = time.perf_counter()
        result = call()
        self.seconds += time.perf_counter() - started
        self.calls += result.calls
        return result

    def timings(self) -> Timings:
        """Return the times until now: inside the backend, and outside it."""
        return Timings(time.perf_counter() - self._started - self.seconds, self.seconds)


#: Makes an answer to a problem, u `(m,)` in the joint metric, or the reason why there is none.
Answer = Callable[[IKProblem, Hierarchy, Clock], Array | str]

#: What comes first, rows or the closed form, by whether it was the closed form last.
_FROM_MEMORY = {False: Question.STEP, True: Question.CLOSED_FORM_FIRST}

#: Where the kernel starts: rows of the last step, or somebody's answer.
Start = RowMemory | Answer


def joint_step(problem: IKProblem, start: Start, options: SolveOptions, method: str = "") -> JointStep:
    """Return the outcome of one solve as data: a failure is a status, not an exception.

    Args:
        problem: see `solve.solve`.
        start: rows that the kernel starts from, or what makes the answer that is its guess.
        options: without `polish`, the answer is the step, and without `closed_form_first` it is always asked for.
        method: name of who solves.
    """
    if options.soften:
        problem, options = problem.softened(options.soften), replace(options, soften=())
    if problem.hands_down:
        return _damped_step(problem, start, options).made_by(method)
    return _undamped_step(problem, start, options, method).made_by(method)


def _damped_step(problem: IKProblem, start: Start, options: SolveOptions) -> JointStep:
    """Return the outcome of one solve of a problem with damped levels, whose optima are handed down."""
    clock = Clock()
    optima: list[JointStep] = []

    def solve_damped(damped: IKProblem) -> JointStep:
        optima.append(_undamped_step(damped, start, options))
        return optima[-1]

    aimed = handed_down(problem, solve_damped)
    if isinstance(aimed, JointStep):
        return aimed
    timings = clock.timings()
    step = _undamped_step(aimed, start, options)
    if step.dtheta is not None:
        step = replace(step, costs=tuple(level.cost(step.dtheta) for level in problem.levels))
        step = _no_surer_than(optima, step, problem)
    return replace(step, timings=replace(step.timings, build=step.timings.build + timings.build))


def _no_surer_than(optima: Collection[JointStep], step: JointStep, problem: IKProblem) -> JointStep:
    """Return a step that asks for what damped `optima` reach: undecided by as much as they are, and proven if they are.

    What a level's cost changes where the step of `problem` moves by as much is part of its gap.
    """
    if step.certificate is None:
        return step
    found = [one.certificate for one in optima if one.certificate is not None]
    undecided = max([one.variation if one.is_optimal else 1.0 for one in found], default=0.0)
    *others, last = step.certificate.rounding
    certificate = replace(step.certificate, rounding=(*others, max(last, undecided)))
    if undecided and step.dtheta is not None:
        scaled, u = problem.in_metric, problem.to_metric(step.dtheta)
        moved = undecided * length(u)
        last_level = 2.0 * length(u - scaled.reference) * moved + moved**2
        more = [*(_cost_of_moving(level, u, moved) for level in scaled.levels), last_level]
        gaps = tuple(gap + cost for gap, cost in zip(certificate.gaps, more, strict=True))
        certificate = replace(certificate, gaps=gaps)
    return replace(step, certificate=certificate, status=step.status if certificate.holds else StepStatus.UNCERTIFIED)


def _cost_of_moving(level: Level, u: Array, moved: float) -> float:
    """Return how much a level's cost at `u` `(m,)` changes at most where that moves so far."""
    residual = level.residual(u)
    return 2.0 * length((level.weights * residual) @ level.matrix) * moved + (level.strength * moved) ** 2


def _undamped_step(problem: IKProblem, start: Start, options: SolveOptions, method: str = "") -> JointStep:
    """Return the outcome of one solve of a problem whose damping, if any, is rows."""
    if options.polish and is_worthwhile(problem, options.kinematics):
        along_links = _tree_step(problem, start, options, method)
        if along_links is not None:
            return along_links
    compiled = options.polish and fast.answers(problem)
    if compiled and (quick := _compiled_step(problem, start, options, method)) is not None:
        return quick
    clock = Clock()
    hierarchy = Hierarchy(problem, options.rank_tolerance)
    solution: Solution | None = None
    if hierarchy.impossible:
        return JointStep(None, StepStatus.INFEASIBLE, conflict=find_conflict(problem), timings=clock.timings())
    if options.closed_form_first and _meets_every_row(hierarchy):
        u, proof = hierarchy.closed_form, Proof(hierarchy, hierarchy.closed_form)
        if not proof.certificate.holds:  # ill-conditioned: the kernel improves it
            better = active_set.solve(hierarchy, np.zeros(len(hierarchy.rows.upper), dtype=bool), u)
            u, proof = better.u, better.proof
        return _step(problem, hierarchy, u, proof, free=True, timings=clock.timings(), method=method)
    answer: Array | str
    if isinstance(start, RowMemory):
        answer, timings = hierarchy.start, clock.timings()
        solution = _by_active_set(hierarchy, start)
    else:
        answer = start(problem, hierarchy, clock)
        timings = clock.timings()
        if compiled and not isinstance(answer, str) and (exact := _from_answer(hierarchy, answer, problem, options)):
            spent = clock.timings()
            timings = Timings(timings.build, spent.solve, spent.build - timings.build)
            return replace(exact, timings=timings, calls=clock.calls, raw=problem.from_metric(answer))
    return _finished(problem, hierarchy, answer, options, solution, method, clock, timings.build)


def _tree_step(problem: IKProblem, start: Start, options: SolveOptions, method: str) -> JointStep | None:
    """Return the step that the kinematic tree's form finds, or None: from the last rows, or the closed form if it is it."""
    if not isinstance(start, RowMemory):
        if not options.closed_form_first:
            return None
        found = tree_step(problem, options.rank_tolerance, question=Question.CLOSED_FORM_ONLY, method=method)
        return found if found is None else found[0]
    question = Question.STEP if options.closed_form_first else Question.FROM_GUESS_ONLY
    found = tree_step(problem, options.rank_tolerance, start.last, question, method)
    if found is None:
        return None
    step, rows = found
    if step.status is not StepStatus.CLOSED_FORM:
        start.remember(rows)
    return step


def _compiled_step(problem: IKProblem, start: Start, options: SolveOptions, method: str) -> JointStep | None:
    """Return the compiled core's step, or None: from the last rows, or the closed form if it is it."""
    if isinstance(start, RowMemory):
        question = _FROM_MEMORY[start.is_free] if options.closed_form_first else Question.FROM_GUESS_ONLY
        step = fast.compiled_step(problem, options.rank_tolerance, start.last, question, method)
        if step is None:
            return None
        if step.status is StepStatus.CLOSED_FORM:
            start.is_free = True
        else:
            start.remember(step.written.active)
        return step
    if not options.closed_form_first:
        return None
    return fast.compiled_step(problem, options.rank_tolerance, question=Question.CLOSED_FORM_ONLY, method=method)


def _from_answer(hierarchy: Hierarchy, answer: Array, problem: IKProblem, options: SolveOptions) -> JointStep | None:
    """Return the step of the compiled core from a QP solver's answer `(m,)`, in the joint metric, or None."""
    guess = active_set.guessed(hierarchy, answer)
    names = _named(hierarchy, guess)
    return fast.compiled_step(problem, options.rank_tolerance, names, Question.FROM_GUESS_ONLY)


def first_stage(problem: IKProblem, options: SolveOptions | None = None) -> Stage:
    """Return the first stage of `problem` to look at: its `problem` is a plain `qpsolvers.Problem`."""
    state = FoldState.whole(Hierarchy(problem, (options or STANDARD).rank_tolerance))
    return level_stage(state) if problem.levels else reference_stage(state)


def _meets_every_row(hierarchy: Hierarchy) -> bool:
    """Whether the closed form keeps every hard and soft row, and so is the optimum of every level."""
    u = hierarchy.closed_form
    allowed = FREE * hierarchy.scale(u)
    return bool((hierarchy.rows.slack(u) >= -allowed).all()) and hierarchy.problem.violation(u) <= allowed


def _by_active_set(hierarchy: Hierarchy, memory: RowMemory) -> Solution:
    """Return what the kernel makes of the rows of the last step; failing that, of a guess from nothing."""
    guess = memory.guess(hierarchy)
    if guess.any():
        patience = LEAST_SETS + int(np.count_nonzero(guess)) // ROWS_PER_SET
        solution = active_set.solve(hierarchy, guess, hierarchy.start, patience)
        if solution.converged:
            memory.remember(_named(hierarchy, solution.active))
            return solution
    solution = _from_nothing(hierarchy)
    memory.remember(_named(hierarchy, solution.active))
    return solution


def _named(hierarchy: Hierarchy, active: Active) -> tuple[str, ...]:
    return tuple(compress(hierarchy.rows.names, active.tolist()))


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


def fold(backend: Backend, hierarchy: Hierarchy, clock: Clock) -> Array | str:
    """Return a QP solver's u `(m,)`, in the joint metric, level by level, or why there is none."""
    state = FoldState.whole(hierarchy, SETTLED_FOR_SOLVERS)
    for level in hierarchy.problem.levels:
        stage = level_stage(state)
        if not stage.costed and not len(stage.row_ids):
            state = state.after(state.origin, stage.unfelt)
            continue
        result = clock.timed(partial(backend.solve, stage))
        if result.x is None:
            return f"level {level.name!r}: {result.message}"
        u = stage.dtheta(result.x)
        left = state.after(u, stage.unfelt)
        free = directions_left(left.free, left.rows[left.slack <= TIGHT * hierarchy.length], NARROW, state.settled)
        state = left if free is left.free else left.without(free)
        if not free.shape[1]:
            return u
    stage = reference_stage(state)
    result = clock.timed(partial(backend.solve, stage))
    return f"last level: {result.message}" if result.x is None else stage.dtheta(result.x)


def _finished(
    problem: IKProblem,
    hierarchy: Hierarchy,
    answer: Array | str,
    options: SolveOptions,
    solution: Solution | None,
    method: str,
    clock: Clock,
    built: float,
) -> JointStep:
    """Return the step that a solver's answer leads to: made exact, certified, and refused if it breaks a row.

    Of a solver that gave up, `answer` says why; the rows may be in conflict. `solution` is there if no solver was called.
    Decompositions and stages had taken `built` seconds before it was asked for.
    """

    def timings() -> Timings:
        spent = clock.timings()
        return Timings(built, spent.solve, spent.build - built)

    if isinstance(answer, str):
        conflict = find_conflict(problem)
        status = StepStatus.NOT_FOUND if conflict is None else StepStatus.INFEASIBLE
        return JointStep(None, status, answer, timings=timings(), calls=clock.calls, conflict=conflict)
    raw = None if solution is not None else problem.from_metric(answer)
    from_nothing = False
    if solution is None and options.polish:
        solution = active_set.solve(hierarchy, active_set.guessed(hierarchy, answer), answer)
        if not solution.converged:
            solution, from_nothing = _from_nothing(hierarchy), True  # the same for every solver
    if solution is None:
        solution = Solution(answer, Proof(hierarchy, answer), active_set.guessed(hierarchy, answer), 0, converged=True)
    step = _step(
        problem,
        hierarchy,
        solution.u,
        solution.proof,
        converged=solution.converged,
        timings=timings(),
        method=method,
        calls=clock.calls,
        raw=raw,
        repairs=solution.iterations,
        from_nothing=from_nothing,
    )
    if step.violation <= ACCEPTED_VIOLATION:
        return step
    conflict = find_conflict(problem)
    status = StepStatus.VIOLATED if conflict is None else StepStatus.INFEASIBLE
    message = f"worst relative violation {step.violation:.1e}"
    return replace(step, dtheta=None, status=status, message=message, conflict=conflict, timings=timings())


def _step(
    problem: IKProblem,
    hierarchy: Hierarchy,
    u: Array,
    proof: Proof,
    *,
    converged: bool = True,
    free: bool = False,
    **others: Any,
) -> JointStep:
    """Return a proven step, with `others` of its fields."""
    certificate, dtheta = proof.certificate, problem.from_metric(u)
    is_tight = (proof.slack <= ACCEPTED_VIOLATION * proof.scale) & (hierarchy.rows.level == HARD)
    status = StepStatus.CLOSED_FORM if free else StepStatus.SOLVED
    return JointStep(
        dtheta,
        status if converged and certificate.holds else StepStatus.UNCERTIFIED,
        costs=tuple(level.cost(dtheta) for level in problem.levels),
        tight_rows=_named(hierarchy, is_tight),
        violation=certificate.violation,
        certificate=certificate,
        levels=DeferredReports(problem, hierarchy.rank_tolerance, dtheta),
        zeros=hierarchy.zeros,
        active_rows=() if free else _named(hierarchy, proof.ends_on),
        **others,
    )
