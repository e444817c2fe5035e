"""mink's tasks as levels: each has rows J Δq = -gain e, weighted by cost².

The costs stay weights and are not folded into the rows, as mink's own QP has them: a level's rank is that of J. The
damping of mink's QP, `damping` plus μ = lm_damping ‖cost · gain · e‖² of each task, is `Level.damping`: of one level it
makes mink's objective, term by term. Rows of damping in a level above others would take every joint from those below, so
such a level hands its damped optimum down instead (see `solvers.damping`). The damping that a level counts is its own and
that of all above: a level that strains makes those below careful, never those above. mink's default of 1e-12, which only
makes the answer unique, is left to the last level. Where a task is out of reach and
nearly singular, levels below would swing in the null space that turns with every step; such a level keeps its rows of
damping, unless told otherwise.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mink
import numpy as np
from mink.tasks import BaseTask

from prioritized_ik.errors import InputError
from prioritized_ik.mink.names import task_name
from prioritized_ik.problem import Level, posed_level
from prioritized_ik.solvers.methods import DAMPING
from prioritized_ik.tasks.turns import across
from prioritized_ik.tolerances import ROUNDING
from prioritized_ik.validation import Array

DIRECTIONS = (mink.LookAtTask, mink.AxisAlignTask)

Tasks = Sequence[BaseTask | Sequence[BaseTask]]


@dataclass(frozen=True)
class Objective:
    """One task as (J Δq - b)ᵀ W (J Δq - b) + μ ‖Δq‖².

    Attributes:
        matrix: J `(k, nv)`.
        target: b `(k,)`.
        weights: diagonal of W `(k,)`.
        damping: μ.
    """

    matrix: Array
    target: Array
    weights: Array
    damping: float


def grouped(tasks: Tasks, priority: Mapping[BaseTask, int] | None) -> list[list[BaseTask]]:
    """Return the tasks of each level, the most important first.

    Args:
        tasks: all in one level; or lists of tasks, one a level, where a task by itself is a level too.
        priority: the level of each task, smaller numbers first; only with tasks that are not nested.

    Raises:
        InputError: something that is no task; both ways at once; a task without priority, or a priority without task.
    """
    nested = any(isinstance(entry, list | tuple) for entry in tasks)
    levels = [list(entry) if isinstance(entry, list | tuple) else [entry] for entry in tasks]
    flat = [task for level in levels for task in level]
    for task in flat:
        if not isinstance(task, BaseTask):
            raise InputError(f"tasks holds {task!r}; expected mink's tasks, or lists of them, one a level.")
    if priority is None:
        return levels if nested else [flat] if flat else []
    if nested:
        raise InputError("tasks are nested and have a priority too; expected one of both.")
    if not isinstance(priority, Mapping):
        raise InputError(f"priority is {priority!r}; expected a mapping from task to number: {{task: 1, other: 2}}.")
    for task in flat:
        if task not in priority:
            raise InputError(f"priority has no number for {task_name(task)}; expected one for every task.")
    for task in priority:
        if task not in flat:
            raise InputError(f"priority has a number for {task!r}, which is none of the tasks; leave it out.")
    return [[task for task in flat if priority[task] == number] for number in sorted({priority[task] for task in flat})]


def levels_of(
    configuration: mink.Configuration, groups: Sequence[Sequence[BaseTask]], damping: float, below: str
) -> list[Level]:
    """Return one level a group of tasks, the most important first.

    Args:
        configuration: where the robot is.
        groups: of tasks, see `grouped`.
        damping: of every level.
        below: what a level above others leaves to those below: "free", or "hold" where it strains.
    """
    levels: list[Level] = []
    shared = damping
    for number, tasks in enumerate(groups, 1):
        part = _joined([objective(configuration, task) for task in tasks], configuration.nv)
        shared += part.damping
        last = number == len(groups)  # nobody needs what it leaves: one solve instead of two
        holds = last or (below == "hold" and _strains(part.matrix, part.weights, part.damping))
        levels.append(
            posed_level(
                part.matrix,
                part.target,
                part.weights,
                " + ".join([task_name(task) for task in tasks]) or f"level {number}",
                shared if last or shared > DAMPING else 0.0,
                "hold" if holds else "free",
            )
        )
    return levels


def _joined(parts: Sequence[Objective], nv: int) -> Objective:
    """Return the objective that is the sum of all."""
    if len(parts) == 1:
        return parts[0]
    return Objective(
        np.concatenate([np.zeros((0, nv)), *(part.matrix for part in parts)]),
        np.concatenate([np.zeros(0), *(part.target for part in parts)]),
        np.concatenate([np.zeros(0), *(part.weights for part in parts)]),
        sum([part.damping for part in parts]),
    )


def _strains(matrix: Array, weights: Array, damping: float) -> bool:
    """Whether `damping` takes more than half of a level's weakest direction: the least σ² of W^½ J, rounding aside."""
    if not damping:
        return False
    rows = np.sqrt(weights)[:, None] * matrix
    sizes = np.linalg.svd(rows, compute_uv=False)
    return float(sizes[sizes > ROUNDING * sizes[0]].min(initial=np.inf)) ** 2 < damping


def objective(configuration: mink.Configuration, task: BaseTask) -> Objective:
    """Return what a task asks for at `configuration`; rows without cost are left out.

    Raises:
        InputError: a task of another model, or a quadratic objective of the user's own that has no minimum.
    """
    if not isinstance(task, mink.Task) or _has_own_residual(task):
        return _own_objective(configuration, task)
    matrix, error = rows_of(configuration, task)
    cost = np.asarray(task.cost, dtype=float)  # after the error: it may depend on it
    if cost.shape != error.shape:
        cost = np.broadcast_to(cost, error.shape)
    damping = 0.0
    if task.lm_damping:
        strained = cost * task.gain * error
        damping = task.lm_damping * float(strained @ strained)
    matrix, error = met_rows(task, matrix, error)
    cost = cost[: len(error)]  # one for all of a direction
    counted = cost > 0.0
    if not counted.all():
        matrix, error, cost = matrix[counted], error[counted], cost[counted]
    return Objective(matrix, -task.gain * error, cost * cost, damping)


def met_rows(task: mink.Task, matrix: Array, error: Array) -> tuple[Array, Array]:
    """Return the rows of a task that a step can meet: of J `(k, nv)` and e `(k,)` of a direction the two across it.

    The error a - d of `LookAtTask` and `AxisAlignTask` is that of unit vectors, of which a step moves d across itself
    only: dᵀJ = 0. In doubles that is a row of rounding, which is no direction, and which no step can meet.
    """
    if type(task) not in DIRECTIONS:
        return matrix, error
    sides = across(task.axis - error)
    return sides @ matrix, sides @ error


def rows_of(configuration: mink.Configuration, task: mink.Task) -> tuple[Array, Array]:
    """Return J `(k, nv)` and e `(k,)` of a task; there may be none.

    Raises:
        InputError: a task of another model.
    """
    error = np.asarray(task.compute_error(configuration), dtype=float)
    matrix = np.array(task.compute_jacobian(configuration), dtype=float)  # a copy: it may be the task's own
    _fits(configuration, task, matrix, len(error))
    return matrix, error


def _has_own_residual(task: BaseTask) -> bool:
    """Whether a task has a residual of its own, which need not be what J, e and cost say."""
    return not getattr(type(task).compute_qp_residual, "__module__", "").startswith("mink.")


def _own_objective(configuration: mink.Configuration, task: BaseTask) -> Objective:
    """Return the objective of a task that gives mink the residual W, e, μ or the matrices H, c of its QP itself."""
    residual = task.compute_qp_residual(configuration)
    if residual is not None:
        matrix, target, damping = residual
        _fits(configuration, task, matrix, len(target))
        return Objective(np.array(matrix, dtype=float), np.array(target, dtype=float), np.ones(len(target)), float(damping))
    hessian, linear = task.compute_qp_objective(configuration)
    _fits(configuration, task, hessian, configuration.nv)
    matrix, target = factored(task_name(task), hessian, linear)
    return Objective(matrix, target, np.ones(len(target)), 0.0)


def factored(name: str, hessian: Array, linear: Array) -> tuple[Array, Array]:
    """Return A `(k, m)` and b `(k,)` with ½ xᵀHx + cᵀx = ½ ‖Ax - b‖² + a constant.

    Raises:
        InputError: H is not positive semidefinite, or c is no combination of its columns: the objective has no minimum.
    """
    values, vectors = np.linalg.eigh(0.5 * (hessian + hessian.T))
    rounding = ROUNDING * len(values) * float(np.abs(values).max(initial=0.0))
    if (values < -rounding).any():
        raise InputError(f"H of {name} has the eigenvalue {values[0]:g}; expected a positive semidefinite matrix.")
    felt = values > rounding
    roots = np.sqrt(values[felt])
    left = linear - vectors[:, felt] @ (vectors[:, felt].T @ linear)
    if np.linalg.norm(left) > ROUNDING * len(values) * max(float(np.linalg.norm(linear)), 1.0):
        raise InputError(f"c of {name} is not in the range of its H: the objective has no minimum; add to its H.")
    return roots[:, None] * vectors[:, felt].T, -(vectors[:, felt].T @ linear) / roots


def _fits(configuration: mink.Configuration, task: BaseTask, matrix: Array, rows: int) -> None:
    if np.shape(matrix) != (rows, configuration.nv):
        raise InputError(
            f"the Jacobian of {task_name(task)} is of shape {np.shape(matrix)}; expected ({rows}, {configuration.nv}): "
            "is the task made for another model?"
        )
