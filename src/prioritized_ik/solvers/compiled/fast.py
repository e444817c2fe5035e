"""From a problem to the joint step of the compiled core, or to None where it declines."""

from collections.abc import Iterable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.certificate import Certificate
from prioritized_ik.solvers.compiled.library import Ending, Question, library
from prioritized_ik.solvers.compiled.workspace import FIGURES, Sizes, Workspace, workspace_for
from prioritized_ik.solvers.report import DeferredReports
from prioritized_ik.solvers.step import JointStep, StepStatus
from prioritized_ik.tolerances import NOISE


def answers(problem: IKProblem) -> bool:
    """Whether the core takes problems of this kind, see the table in `compiled/__init__.py`."""
    return (
        library().core is not None
        and problem.noise == NOISE
        and len(problem.reference) > 0
        and all(level.kind == "equal" for level in problem.levels)
    )


def compiled_step(
    problem: IKProblem, rank_tolerance: float, rows: Iterable[str] = (), question: Question = Question.STEP
) -> JointStep | None:
    """Return the certified step of a problem that the core `answers`, None if it declines.

    Args:
        problem: damped levels are taken as their rows.
        rank_tolerance: see `SolveOptions`.
        rows: names of those that the step may rest on, such as the last step's.
        question: the step; only a closed form that breaks no row; or no closed form first.
    """
    flat = problem if problem.metric.ndim == 1 else problem.in_metric
    sizes = Sizes.of(flat)
    workspace = workspace_for(sizes)
    workspace.fill(flat, sizes, rank_tolerance)
    workspace.guess[:] = False
    if rows:
        numbers = _numbers(flat.bounds.names, flat.rows.names)
        for name in rows:
            number = numbers.get(name)
            if number is not None:
                workspace.guess[number] = True
    return _step(problem, flat, sizes, workspace, rank_tolerance, workspace.solve(sizes, question))


def _step(
    problem: IKProblem, flat: IKProblem, sizes: Sizes, workspace: Workspace, rank_tolerance: float, ending: int
) -> JointStep | None:
    if ending >= Ending.BINDING:
        return None
    m, levels = sizes.joints, sizes.levels
    every = 2 * m + sizes.rows
    figures = workspace.figures[: FIGURES * (levels + 1) + 2].tolist()
    dtheta = workspace.dtheta.copy()
    if flat is not problem:
        dtheta = problem.from_metric(dtheta)
    held: tuple[tuple[str, ...], ...] = ((),) * (levels + 1)
    corrections, _, _, multipliers, zeros = workspace.counts.tolist()
    if multipliers:
        by_level = workspace.multipliers[: (levels + 1) * every].reshape(levels + 1, every)
        held = tuple(_names(flat, row > 0.0) for row in by_level)
    end = -2
    certificate = Certificate(
        figures[-2],
        tuple(figures[0:end:FIGURES]),
        tuple(figures[1:end:FIGURES]),
        tuple(figures[2:end:FIGURES]),
        tuple(figures[3:end:FIGURES]),
        held,
    )
    return JointStep(
        dtheta,
        StepStatus.CLOSED_FORM if ending == Ending.CLOSED_FORM else StepStatus.SOLVED,
        costs=tuple(workspace.costs[:levels].tolist()),
        tight_rows=_names(flat, workspace.tight[:every]),
        violation=figures[-2],
        certificate=certificate,
        repairs=corrections,
        levels=DeferredReports(problem, rank_tolerance, dtheta),
        zeros=_zeros(flat, workspace) if zeros else (),
        active_rows=() if ending == Ending.CLOSED_FORM else _names(flat, workspace.active[:every]),
        path="compiled",
    )


def _names(problem: IKProblem, chosen: NDArray[np.bool_]) -> tuple[str, ...]:
    """Return the names of the `chosen` upper bounds, lower bounds and rows, as `IKProblem.inequalities` has them."""
    numbers = chosen.nonzero()[0]
    if not len(numbers):
        return ()
    m, joints, rows = len(problem.reference), problem.bounds.names, problem.rows.names
    return tuple(
        f"{joints[i]} upper" if i < m else f"{joints[i - m]} lower" if i < 2 * m else rows[i - 2 * m]
        for i in numbers.tolist()
    )


def _zeros(problem: IKProblem, workspace: Workspace) -> tuple[str, ...]:
    """Return the names of the levels' rows that are rounding."""
    names: list[str] = []
    end = 0
    for level in problem.levels:
        start, end = end, end + len(level.target)
        names += [f"{level.name} row {i + 1}" for i in workspace.zero[start:end].nonzero()[0].tolist()]
    return tuple(names)


@lru_cache(maxsize=64)
def _numbers(joints: tuple[str, ...], rows: tuple[str, ...]) -> dict[str, int]:
    """Return each upper bound's, lower bound's and row's number by its name."""
    names = (*(f"{name} upper" for name in joints), *(f"{name} lower" for name in joints), *rows)
    return {name: number for number, name in reversed(list(enumerate(names)))}
