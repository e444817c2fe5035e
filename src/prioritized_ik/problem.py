"""The problem of one joint step, free of MuJoCo: levels in strict order, bounds, rows and a reference.

Lexicographic least squares: level 1 minimises (b - A dθ)ᵀ W (b - A dθ), each further level does so among the optima of
those before it, and an implicit last level minimises ‖dθ - r‖². With one level and nothing binding that is Eqs. 12 and
13 of the paper, and the optimum is unique in any case, because the last level is strictly convex.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from prioritized_ik.errors import InputError
from prioritized_ik.validation import Array, finite_array, read_only, shaped_array

STEP_FLOOR = 1e-4  # [rad] violations are relative to the step, but steps smaller than this count as this


@dataclass(frozen=True, init=False)
class Level:
    """One priority level: weighted least squares of `matrix @ dtheta` against `target`.

    Attributes:
        matrix: A, for instance the stacked Jacobian J `(k, m)`.
        target: b, for instance the desired displacement dX_v* `(k,)`.
        weights: diagonal of W `(k,)`, all positive; ones unless given.
        name: what messages call it.
    """

    matrix: Array
    target: Array
    weights: Array
    name: str

    def __init__(self, matrix: ArrayLike, target: ArrayLike, weights: ArrayLike | None = None, name: str = "task") -> None:
        checked = finite_array(f"matrix of level {name!r}", matrix, (None, None))
        k = checked.shape[0]
        if checked.size == 0:
            raise InputError(f"matrix of level {name!r} has shape {checked.shape}; expected at least one row.")
        diagonal = finite_array(f"weights of level {name!r}", np.ones(k) if weights is None else weights, (k,))
        if (diagonal <= 0.0).any():
            place = int(np.argmin(diagonal))
            raise InputError(
                f"weights of level {name!r}[{place}] is {diagonal[place]}; expected numbers above 0 "
                "(leave a row out instead of giving it no weight)."
            )
        _set(
            self,
            matrix=checked,
            target=finite_array(f"target of level {name!r}", target, (k,)),
            weights=diagonal,
            name=name,
        )

    def cost(self, dtheta: Array) -> float:
        """Q = (b - A dθ)ᵀ W (b - A dθ), Eq. (10)."""
        residual = self.target - self.matrix @ dtheta
        return float(residual @ (self.weights * residual))


@dataclass(frozen=True, init=False)
class Bounds:
    """lower <= dθ <= upper, each `(m,)` [rad]; infinities are allowed. `names` name the joints in messages."""

    lower: Array
    upper: Array
    names: tuple[str, ...]

    def __init__(self, lower: ArrayLike, upper: ArrayLike, names: Sequence[str] = ()) -> None:
        low = shaped_array("lower bounds", lower, (None,))
        high = shaped_array("upper bounds", upper, low.shape)
        joints = _names("bounds", names, "joint", len(low))
        crossed = np.flatnonzero(low > high)
        if crossed.size:
            i = int(crossed[0])
            raise InputError(f"lower bound {low[i]} of {joints[i]} is above its upper bound {high[i]}; swap or widen them.")
        _set(self, lower=low, upper=high, names=joints)

    def intersect(self, other: "Bounds") -> "Bounds":
        """Return the bounds that keep both, with the names of these."""
        return Bounds(np.maximum(self.lower, other.lower), np.minimum(self.upper, other.upper), self.names)

    @staticmethod
    def none(m: int) -> "Bounds":
        """Return bounds on `m` joints that never bind."""
        return Bounds(np.full(m, -np.inf), np.full(m, np.inf))


@dataclass(frozen=True, init=False)
class Rows:
    """Inequality rows: matrix `(r, m)` @ dθ <= upper `(r,)`. `names` name the rows in messages."""

    matrix: Array
    upper: Array
    names: tuple[str, ...]

    def __init__(self, matrix: ArrayLike, upper: ArrayLike, names: Sequence[str] = ()) -> None:
        checked = finite_array("matrix of rows", matrix, (None, None))
        side = finite_array("upper side of rows", upper, checked.shape[:1])
        known = _names("rows", names, "row", len(checked))
        never = np.flatnonzero(~checked.any(axis=1) & (side < 0.0))
        if never.size:
            i = int(never[0])
            raise InputError(f"{known[i]} is all zero but must not exceed {side[i]}, which no step can keep; leave it out.")
        _set(self, matrix=checked, upper=side, names=known)

    @staticmethod
    def none(m: int) -> "Rows":
        """Return no row on `m` joints."""
        return Rows(np.zeros((0, m)), np.zeros(0))


@dataclass(frozen=True, init=False)
class IKProblem:
    """The problem of one joint step dθ `(m,)`.

    Attributes:
        levels: at least one, the most important first.
        bounds: hard bounds on dθ.
        rows: hard inequality rows.
        reference: r `(m,)` [rad], the last level's target (Eq. 13); zero for the least norm (Eq. 14).

    Raises:
        InputError: no level, or widths that differ.
    """

    levels: tuple[Level, ...]
    bounds: Bounds
    rows: Rows
    reference: Array

    def __init__(
        self,
        levels: Sequence[Level],
        bounds: Bounds | None = None,
        rows: Rows | None = None,
        reference: ArrayLike | None = None,
    ) -> None:
        if isinstance(levels, Level) or not levels or not all(isinstance(level, Level) for level in levels):
            raise InputError(f"levels is {levels!r}; expected a list of at least one Level.")
        for name, given, kind in (("bounds", bounds, Bounds), ("rows", rows, Rows)):
            if given is not None and not isinstance(given, kind):
                raise InputError(f"{name} is {given!r}; expected {kind.__name__} or None.")
        m = levels[0].matrix.shape[1]
        _set(
            self,
            levels=tuple(levels),
            bounds=Bounds.none(m) if bounds is None else bounds,
            rows=Rows.none(m) if rows is None else rows,
            reference=finite_array("reference", np.zeros(m) if reference is None else reference, (m,)),
        )
        widths = {f"level {level.name!r}": level.matrix.shape[1] for level in levels}
        widths |= {"bounds": len(self.bounds.lower), "rows": self.rows.matrix.shape[1]}
        for name, width in widths.items():
            if width != m:
                raise InputError(f"{name} has {width} joints; expected {m}, as many as the first level.")

    @property
    def joint_count(self) -> int:
        """Number of joints m."""
        return len(self.reference)

    @cached_property
    def inequalities(self) -> "Rows":
        """Every finite bound and row as one set of rows: upper bounds, then lower bounds, then `rows`."""
        eye = np.eye(self.joint_count)
        above, below = np.isfinite(self.bounds.upper), np.isfinite(self.bounds.lower)
        names = [f"{name} upper" for name, keep in zip(self.bounds.names, above, strict=True) if keep]
        names += [f"{name} lower" for name, keep in zip(self.bounds.names, below, strict=True) if keep]
        return Rows(
            np.vstack([eye[above], -eye[below], self.rows.matrix]),
            np.concatenate([self.bounds.upper[above], -self.bounds.lower[below], self.rows.upper]),
            (*names, *self.rows.names),
        )

    def relative_violation(self, dtheta: ArrayLike) -> float:
        """Return the worst violation of any bound or row at `dtheta` `(m,)`, as a fraction of the step's scale.

        A row's violation is its distance in joint space, (g·dθ - h) / ‖g‖; the step's scale is ‖dθ‖, at least
        `STEP_FLOOR`. Zero when all hold.
        """
        step = np.asarray(dtheta, dtype=float)
        excess = self.inequalities.matrix @ step - self.inequalities.upper
        if not excess.size:
            return 0.0
        distance = excess / np.maximum(self._row_norms, np.finfo(float).tiny)
        return max(0.0, float(distance.max())) / max(float(np.linalg.norm(step)), STEP_FLOOR)

    def tight_rows(self, dtheta: ArrayLike, tolerance: float) -> tuple[str, ...]:
        """Return the names of the bounds and rows within `tolerance` of binding at `dtheta`, as a joint distance [rad]."""
        slack = self.inequalities.upper - self.inequalities.matrix @ np.asarray(dtheta, dtype=float)
        tight = slack <= tolerance * self._row_norms
        return tuple(name for name, is_tight in zip(self.inequalities.names, tight, strict=True) if is_tight)

    @cached_property
    def _row_norms(self) -> Array:
        return read_only(np.linalg.norm(self.inequalities.matrix, axis=1))


def _set(record: object, **values: object) -> None:
    """Fill the fields of a frozen record."""
    for name, value in values.items():
        object.__setattr__(record, name, value)


def _names(what: str, given: Sequence[str], word: str, count: int) -> tuple[str, ...]:
    """Return one name an entry: those given, or `word` and its number from 1."""
    names = tuple(given) or tuple(f"{word} {i + 1}" for i in range(count))
    if len(names) != count:
        raise InputError(f"names of {what} has {len(names)} entries; expected {count}.")
    return names
