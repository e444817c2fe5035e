"""From a problem to the joint step of the compiled core, or to None where it declines."""

from collections.abc import Collection
from time import perf_counter

from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.certificate import Certificate
from prioritized_ik.solvers.compiled.library import Ending, Question, library
from prioritized_ik.solvers.compiled.workspace import COUNTS, FIGURES, Sizes, Workspace, workspace_for
from prioritized_ik.solvers.report import DeferredReports
from prioritized_ik.solvers.step import JointStep, StepStatus, Timings
from prioritized_ik.tolerances import CERTIFIED, NOISE

FEW = 64  # counts and lists of most steps, read at once

_STATUS: dict[int, StepStatus] = {Ending.CLOSED_FORM: StepStatus.CLOSED_FORM, Ending.SOLVED: StepStatus.SOLVED}


def answers(problem: IKProblem) -> bool:
    """Whether the core takes problems of this kind, see the table in `compiled/__init__.py`."""
    if library().core is None or problem.noise != NOISE or not len(problem.reference):
        return False
    return all([level.kind == "equal" for level in problem.levels])


def compiled_step(
    problem: IKProblem, rank_tolerance: float, rows: Collection[str] = (), question: Question = Question.STEP
) -> JointStep | None:
    """Return the certified step of a problem that the core `answers`, None if it declines.

    Args:
        problem: damped levels are taken as their rows.
        rank_tolerance: see `SolveOptions`.
        rows: names of those that the step may rest on, such as the last step's.
        question: the step; only a closed form that breaks no row; or no closed form first.
    """
    started = perf_counter()
    flat = problem if problem.metric.ndim == 1 else problem.in_metric
    sizes = Sizes.of(flat)
    workspace = workspace_for(sizes)
    workspace.fill(flat, sizes, rank_tolerance)
    workspace.name(flat)
    workspace.guess[:] = False
    for name in rows:
        number = workspace.numbers.get(name)
        if number is not None:
            workspace.guess[number] = True
    ending = workspace.solve(sizes, question)
    return _step(problem, flat, workspace, rank_tolerance, ending, started) if ending in _STATUS else None


def _step(
    problem: IKProblem, flat: IKProblem, workspace: Workspace, rank_tolerance: float, ending: int, started: float
) -> JointStep:
    levels = len(problem.levels)
    end = FIGURES * (levels + 1)
    figures: list[float] = workspace.figures[: end + 2 + levels].tolist()
    dtheta = workspace.dtheta.copy()
    if flat is not problem:
        dtheta = problem.from_metric(dtheta)
    lists: list[int] = workspace.lists[:FEW].tolist()
    corrections, _, _, active, tight, zero, holding = lists[:COUNTS]
    active += COUNTS
    tight += active
    zero += tight
    last = zero + 2 * holding
    if last > FEW:
        lists = workspace.lists[:last].tolist()
    names = workspace.names
    held: list[tuple[str, ...]] = [()] * (levels + 1)
    for place in range(zero, last, 2):
        held[lists[place]] += (names[lists[place + 1]],)
    violation = figures[end]
    certificate = object.__new__(Certificate)
    certificate.__dict__.update(
        violation=violation,
        gaps=tuple(figures[0:end:FIGURES]),
        relative_gaps=tuple(figures[1:end:FIGURES]),
        stationarity=tuple(figures[2:end:FIGURES]),
        rounding=tuple(figures[3:end:FIGURES]),
        held_by=tuple(held),
        tolerance=CERTIFIED,
    )
    return JointStep(
        dtheta,
        _STATUS[ending],
        "",
        tuple(figures[end + 2 :]),
        tuple([names[i] for i in lists[active:tight]]),
        violation,
        Timings(perf_counter() - started, 0.0),
        certificate=certificate,
        repairs=corrections,
        levels=DeferredReports(problem, rank_tolerance, dtheta),
        zeros=_row_names(flat, lists[tight:zero]) if zero > tight else (),
        active_rows=tuple([names[i] for i in lists[COUNTS:active]]),
        path="compiled",
    )


def _row_names(problem: IKProblem, numbers: list[int]) -> tuple[str, ...]:
    """Return the names of rows by `numbers`, counted through all levels and then through the hard rows."""
    names: list[str] = []
    before, rest = 0, iter(numbers)
    number = next(rest, None)
    for level in problem.levels:
        end = before + len(level.target)
        while number is not None and number < end:
            names.append(f"{level.name} row {number - before + 1}")
            number = next(rest, None)
        before = end
    while number is not None:
        names.append(problem.rows.names[number - before])
        number = next(rest, None)
    return tuple(names)
