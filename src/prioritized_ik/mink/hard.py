"""mink's limits as bounds and rows, and its constraints as equalities, all of them with names.

A limit's rows G Δq <= h that move one joint alone become bounds on that joint, the tightest of all limits; the others are
rows. Bounds of several limits that leave no room become rows too, named after their limits, so that the conflict is found
and named like any other.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import mink
import numpy as np

from prioritized_ik.errors import InputError
from prioritized_ik.limits import joint_names
from prioritized_ik.mink.errors import InfeasibleIkError
from prioritized_ik.mink.levels import met_rows, rows_of
from prioritized_ik.mink.names import numbered, row_name, task_name
from prioritized_ik.problem import Bounds, Equalities, Rows
from prioritized_ik.solvers.step import JointStep, StepStatus
from prioritized_ik.tolerances import ROUNDING
from prioritized_ik.validation import Array, distinct


@dataclass
class _Pool:
    """Bounds and rows, as they are collected.

    Attributes:
        lower, upper: the tightest bounds so far `(nv,)`.
        of_lower, of_upper: the limits that they come from, by joint.
        matrix, sides, names: the rows.
    """

    lower: Array
    upper: Array
    of_lower: dict[int, str] = field(default_factory=dict)
    of_upper: dict[int, str] = field(default_factory=dict)
    matrix: list[Array] = field(default_factory=list)
    sides: list[float] = field(default_factory=list)
    names: list[str] = field(default_factory=list)

    def bound(self, rows: Array, sides: Array, limit: str) -> None:
        """Take in rows `(r, nv)` · Δq <= sides `(r,)`, each of one entry."""
        dofs = (rows != 0.0).argmax(axis=1)
        factors = rows[np.arange(len(rows)), dofs]
        above, values = factors > 0.0, sides / factors
        upper, lower = np.full(len(self.upper), np.inf), np.full(len(self.lower), -np.inf)
        np.minimum.at(upper, dofs[above], values[above])
        np.maximum.at(lower, dofs[~above], values[~above])
        for mine, other, of, tighter in (
            (self.upper, upper, self.of_upper, upper < self.upper),
            (self.lower, lower, self.of_lower, lower > self.lower),
        ):
            mine[tighter] = other[tighter]
            of.update(dict.fromkeys(np.flatnonzero(tighter).tolist(), limit))

    def row(self, row: Array, side: float, name: str) -> None:
        """Take in row · Δq <= side."""
        self.matrix.append(row)
        self.sides.append(side)
        self.names.append(name)


def hard_limits(configuration: mink.Configuration, limits: Sequence[mink.Limit] | None, dt: float) -> tuple[Bounds, Rows]:
    """Return the limits at `configuration` as bounds and rows on Δq.

    Args:
        configuration: where the robot is.
        limits: mink's; None for its default, the joint ranges.
        dt: time step [s].

    Raises:
        InputError: something that is no limit, a limit of another model, or sides that are no numbers.
        InfeasibleIkError: a limit that no step keeps, whatever it moves.
    """
    model = configuration.model
    chosen = [mink.ConfigurationLimit(model)] if limits is None else list(limits)
    for limit in chosen:
        if not isinstance(limit, mink.Limit):
            raise InputError(f"limits holds {limit!r}; expected mink's limits.")
    pool = _Pool(np.full(model.nv, -np.inf), np.full(model.nv, np.inf))
    called = numbered([type(limit).__name__ for limit in chosen])
    for limit, name in zip(chosen, called, strict=True):
        _collect(pool, configuration, limit, name, dt)
    joints = joint_names(model)
    _part(pool, joints)
    rows = Rows(np.reshape(pool.matrix, (-1, model.nv)), pool.sides, distinct(pool.names))
    return Bounds(pool.lower, pool.upper, joints), rows


def _collect(pool: _Pool, configuration: mink.Configuration, limit: mink.Limit, name: str, dt: float) -> None:
    """Take in the rows of one limit that can bind."""
    matrix, sides = limit.compute_qp_inequalities(configuration, dt)
    if matrix is None:
        return
    if np.ndim(matrix) != 2 or np.shape(matrix) != (len(sides), configuration.nv):
        raise InputError(
            f"{name} has rows of shape {np.shape(matrix)}; expected ({len(sides)}, {configuration.nv}): is it made for "
            "another model?"
        )
    if np.isnan(sides).any() or not np.isfinite(matrix).all():
        raise InputError(f"{name} has rows that are not finite at this configuration; expected numbers.")
    entries = np.count_nonzero(matrix, axis=1)
    binding, single = sides < np.inf, entries == 1
    pool.bound(matrix[binding & single], sides[binding & single], name)
    for place in np.flatnonzero(binding & ~single):
        row, side = matrix[place], float(sides[place])
        if entries[place] or side < 0.0:
            called = row_name(configuration.model, limit, name, int(place), row)
            if not entries[place]:
                raise _impossible(f"{called} moves with no joint, but must not exceed {side:g}: no step keeps it.")
            pool.row(row, side, called)


def _part(pool: _Pool, joints: Sequence[str]) -> None:
    """Make rows of bounds that leave no room; those that differ by rounding freeze the joint."""
    for dof in map(int, np.flatnonzero(pool.lower > pool.upper)):
        low, high = float(pool.lower[dof]), float(pool.upper[dof])
        if low - high <= ROUNDING * max(abs(low), abs(high)):
            pool.lower[dof] = pool.upper[dof]
            continue
        unit = np.eye(len(joints))[dof]
        pool.row(unit, high, f"{pool.of_upper[dof]}: {joints[dof]} upper")
        pool.row(-unit, -low, f"{pool.of_lower[dof]}: {joints[dof]} lower")
        pool.lower[dof], pool.upper[dof] = -np.inf, np.inf


def hard_tasks(configuration: mink.Configuration, constraints: Sequence[mink.Task] | None) -> Equalities:
    """Return the tasks that are to be met exactly as equalities J Δq = -gain e.

    Raises:
        InputError: something that is no task with a Jacobian, or one of another model.
        InfeasibleIkError: a row that no joint moves and that is not met.
    """
    matrices, sides, names = [np.zeros((0, configuration.nv))], [np.zeros(0)], []
    chosen = list(constraints or ())
    for task in chosen:
        if not isinstance(task, mink.Task):
            raise InputError(f"constraints holds {task!r}; expected mink's tasks with a Jacobian and an error.")
    for task, name in zip(chosen, numbered([task_name(task) for task in chosen]), strict=True):
        matrix, error = met_rows(task, *rows_of(configuration, task))
        matrices.append(matrix)
        sides.append(-task.gain * error)
        names += [f"{name} row {place + 1}" for place in range(len(error))]
    matrix, target = np.vstack(matrices), np.concatenate(sides)
    rounding = ROUNDING * float(np.abs(target).max(initial=0.0))
    for place in np.flatnonzero(~matrix.any(axis=1) & (np.abs(target) > rounding)):
        raise _impossible(f"{names[place]} moves with no joint, but must change by {target[place]:g}: no step keeps it.")
    return Equalities(matrix, target, names)


def _impossible(message: str) -> InfeasibleIkError:
    return InfeasibleIkError(message, JointStep(None, StepStatus.INFEASIBLE, message))
