"""mink's limits as bounds and rows, and its constraints as equalities, all of them with names.

A limit's rows G Δq <= h that move one joint alone become bounds on that joint, the tightest of all limits; the others are
rows. Bounds of several limits that leave no room become rows too, named after their limits, so that the conflict is found
and named like any other.
"""

import math
import weakref
from collections.abc import Sequence
from dataclasses import dataclass, field

import mink
import numpy as np
from numpy.typing import NDArray

from prioritized_ik.errors import InputError
from prioritized_ik.limits import joint_names
from prioritized_ik.mink.errors import InfeasibleIkError
from prioritized_ik.mink.levels import met_rows, rows_of
from prioritized_ik.mink.names import numbered, row_name, task_name
from prioritized_ik.problem import Bounds, Equalities, Rows, posed_bounds
from prioritized_ik.solvers.step import JointStep, StepStatus
from prioritized_ik.tolerances import ROUNDING
from prioritized_ik.validation import Array, distinct


@dataclass(frozen=True)
class _Pattern:
    """What the matrix of a limit says, whatever its sides: of most limits it is the same at every step.

    Attributes:
        matrix: G `(r, nv)`.
        singles: numbers of the rows with one entry.
        factors: these entries.
        upper, lower: which of `singles` bound a joint from above, and from below.
        upper_dofs, lower_dofs: the joints.
        others: numbers of the rows with several entries or none.
        repeats: whether a joint has several rows from one side.
    """

    matrix: Array
    singles: NDArray[np.int_]
    factors: Array
    upper: NDArray[np.int_]
    lower: NDArray[np.int_]
    upper_dofs: NDArray[np.int_]
    lower_dofs: NDArray[np.int_]
    others: NDArray[np.int_]
    repeats: bool

    @staticmethod
    def of(matrix: Array) -> "_Pattern":
        """Return the pattern of a finite matrix."""
        single = np.count_nonzero(matrix, axis=1) == 1
        singles, others = np.flatnonzero(single), np.flatnonzero(~single)
        dofs = (matrix[singles] != 0.0).argmax(axis=1)
        factors = matrix[singles, dofs]
        upper, lower = np.flatnonzero(factors > 0.0), np.flatnonzero(factors < 0.0)
        repeats = any(len(np.unique(dofs[side])) < len(side) for side in (upper, lower))
        return _Pattern(np.array(matrix), singles, factors, upper, lower, dofs[upper], dofs[lower], others, repeats)

    def fits(self, matrix: Array) -> bool:
        """Whether this is the pattern of a matrix."""
        return matrix.shape == self.matrix.shape and bool((matrix == self.matrix).all())


#: The last pattern of each limit.
_PATTERNS: weakref.WeakKeyDictionary[mink.Limit, _Pattern] = weakref.WeakKeyDictionary()


def _pattern_of(limit: mink.Limit, name: str, matrix: Array) -> _Pattern:
    try:
        known = _PATTERNS.get(limit)
    except TypeError:  # a limit of the user's own that has no hash
        return _new_pattern(name, matrix)
    if known is None or not known.fits(matrix):
        known = _PATTERNS[limit] = _new_pattern(name, matrix)
    return known


def _new_pattern(name: str, matrix: Array) -> _Pattern:
    if not np.isfinite(matrix).all():
        raise _not_finite(name)
    return _Pattern.of(matrix)


@dataclass
class _Pool:
    """Bounds and rows, as they are collected.

    Attributes:
        lower, upper: the tightest bounds so far `(nv,)`.
        bounded: the name of each limit that has bounds, with its lower and upper ones.
        matrix, sides, names: the rows.
    """

    lower: Array
    upper: Array
    bounded: list[tuple[str, Array, Array]] = field(default_factory=list)
    matrix: list[Array] = field(default_factory=list)
    sides: list[float] = field(default_factory=list)
    names: list[str] = field(default_factory=list)

    def bound(self, pattern: _Pattern, sides: Array, limit: str) -> None:
        """Take in the rows with one entry, of sides `(r,)` of all rows."""
        values = sides[pattern.singles] / pattern.factors
        upper, lower = np.full(len(self.upper), np.inf), np.full(len(self.lower), -np.inf)
        if pattern.repeats:
            np.minimum.at(upper, pattern.upper_dofs, values[pattern.upper])
            np.maximum.at(lower, pattern.lower_dofs, values[pattern.lower])
        else:
            upper[pattern.upper_dofs], lower[pattern.lower_dofs] = values[pattern.upper], values[pattern.lower]
        self.bounded.append((limit, lower, upper))
        np.minimum(self.upper, upper, out=self.upper)
        np.maximum(self.lower, lower, out=self.lower)

    def row(self, row: Array, side: float, name: str) -> None:
        """Take in row · Δq <= side."""
        self.matrix.append(row)
        self.sides.append(side)
        self.names.append(name)

    def limits_of(self, dof: int) -> tuple[str, str]:
        """Return the limits that a joint's lower and upper bound come from: of equally tight ones the first."""
        _, tightest, _ = max(self.bounded, key=lambda entry: entry[1][dof])
        lower = next(limit for limit, low, _ in self.bounded if low[dof] == tightest[dof])
        _, _, tightest = min(self.bounded, key=lambda entry: entry[2][dof])
        return lower, next(limit for limit, _, high in self.bounded if high[dof] == tightest[dof])


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
    if not (pool.lower <= pool.upper).all():
        _part(pool, joints)
    bounds = posed_bounds(pool.lower, pool.upper, joints)
    if not pool.names:
        return bounds, Rows.none(model.nv)
    return bounds, Rows(np.array(pool.matrix), pool.sides, distinct(pool.names))


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
    if math.isnan(sides.sum()) and np.isnan(sides).any():  # of infinities alone it may be, too
        raise _not_finite(name)
    pattern = _pattern_of(limit, name, matrix)
    if len(pattern.singles):
        pool.bound(pattern, sides, name)
    for place in pattern.others:
        row, side = matrix[place], float(sides[place])
        if side < np.inf and (side < 0.0 or row.any()):
            called = row_name(configuration.model, limit, name, int(place), row)
            if not row.any():
                raise _impossible(f"{called} moves with no joint, but must not exceed {side:g}: no step keeps it.")
            pool.row(row, side, called)


def _not_finite(name: str) -> InputError:
    return InputError(f"{name} has rows that are not finite at this configuration; expected numbers.")


def _part(pool: _Pool, joints: Sequence[str]) -> None:
    """Make rows of bounds that leave no room; those that differ by rounding freeze the joint."""
    for dof in map(int, np.flatnonzero(pool.lower > pool.upper)):
        low, high = float(pool.lower[dof]), float(pool.upper[dof])
        if low - high <= ROUNDING * max(abs(low), abs(high)):
            pool.lower[dof] = pool.upper[dof]
            continue
        unit = np.eye(len(joints))[dof]
        of_lower, of_upper = pool.limits_of(dof)
        pool.row(unit, high, f"{of_upper}: {joints[dof]} upper")
        pool.row(-unit, -low, f"{of_lower}: {joints[dof]} lower")
        pool.lower[dof], pool.upper[dof] = -np.inf, np.inf


def hard_tasks(configuration: mink.Configuration, constraints: Sequence[mink.Task] | None) -> Equalities:
    """Return the tasks that are to be met exactly as equalities J Δq = -gain e.

    Raises:
        InputError: something that is no task with a Jacobian, or one of another model.
        InfeasibleIkError: a row that no joint moves and that is not met.
    """
    if not constraints:
        return Equalities.none(configuration.nv)
    matrices, sides, names = [np.zeros((0, configuration.nv))], [np.zeros(0)], []
    chosen = list(constraints)
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
