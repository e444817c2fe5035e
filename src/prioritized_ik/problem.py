"""The problem of one joint step, free of MuJoCo: levels in strict order, bounds, rows, equalities and a reference.

Lexicographic least squares: level 1 minimises (b - A dθ)ᵀ W (b - A dθ), each further level does so among the optima of
those before it, and an implicit last level minimises ‖dθ - r‖². With one level and nothing binding that is Eqs. 12 and
13 of the paper, and the optimum is unique in any case, because the last level is strictly convex. A level can also be
one of soft inequalities, which counts only what exceeds its target.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from prioritized_ik.errors import InputError
from prioritized_ik.validation import Array, finite_array, length, lengths, one_of, read_only, shaped_array

#: `equal` is least squares of A dθ = b; `at_most` of what A dθ <= b leaves violated.
KINDS = ("equal", "at_most")

STEP_FLOOR = 1e-4  # [rad] violations are relative to the step, but steps smaller than this count as this


@dataclass(frozen=True, init=False, eq=False)
class Level:
    """One priority level: weighted least squares of `matrix @ dtheta` against `target`, or of its excess over `target`.

    Attributes:
        matrix: A, for instance the stacked Jacobian J `(k, m)`.
        target: b, for instance the desired displacement dX_v* `(k,)`.
        weights: diagonal of W `(k,)`, all positive; ones unless given.
        name: what messages call it.
        kind: `"equal"`, or `"at_most"` for soft inequalities.

    Raises:
        InputError: no row, shapes that do not fit, a weight that is not positive, an unknown kind.
    """

    matrix: Array
    target: Array
    weights: Array
    name: str
    kind: str

    def __init__(
        self,
        matrix: ArrayLike,
        target: ArrayLike,
        weights: ArrayLike | None = None,
        name: str = "task",
        kind: str = "equal",
    ) -> None:
        one_of(f"kind of level {name!r}", kind, KINDS)
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
            kind=kind,
        )

    @property
    def is_soft(self) -> bool:
        """Whether this is a level of soft inequalities."""
        return self.kind == "at_most"

    def residual(self, dtheta: Array) -> Array:
        """Return A dθ - b `(k,)`; of a soft level only what is above zero."""
        residual = self.matrix @ dtheta - self.target
        return np.maximum(residual, 0.0) if self.is_soft else residual

    def cost(self, dtheta: Array) -> float:
        """Q = (b - A dθ)ᵀ W (b - A dθ), Eq. (10); of a soft level the same of max(A dθ - b, 0)."""
        residual = self.residual(dtheta)
        return float(residual @ (self.weights * residual))


@dataclass(frozen=True, init=False, eq=False)
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


@dataclass(frozen=True, init=False, eq=False)
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


@dataclass(frozen=True, init=False, eq=False)
class Equalities:
    """Hard equality rows: matrix `(e, m)` @ dθ = target `(e,)`. `names` name the rows in messages."""

    matrix: Array
    target: Array
    names: tuple[str, ...]

    def __init__(self, matrix: ArrayLike, target: ArrayLike, names: Sequence[str] = ()) -> None:
        checked = finite_array("matrix of equalities", matrix, (None, None))
        side = finite_array("target of equalities", target, checked.shape[:1])
        known = _names("equalities", names, "equality", len(checked))
        never = np.flatnonzero(~checked.any(axis=1) & (side != 0.0))
        if never.size:
            i = int(never[0])
            raise InputError(f"{known[i]} is all zero but must be {side[i]}, which no step can keep; leave it out.")
        _set(self, matrix=checked, target=side, names=known)

    @staticmethod
    def none(m: int) -> "Equalities":
        """Return no equality on `m` joints."""
        return Equalities(np.zeros((0, m)), np.zeros(0))


@dataclass(frozen=True, init=False, eq=False)
class IKProblem:
    """The problem of one joint step dθ `(m,)`.

    Attributes:
        levels: at least one, the most important first.
        bounds: hard bounds on dθ.
        rows: hard inequality rows.
        reference: r `(m,)` [rad], the last level's target (Eq. 13); zero for the least norm (Eq. 14).
        equalities: hard equality rows.

    Raises:
        InputError: no level, or widths that differ.
    """

    levels: tuple[Level, ...]
    bounds: Bounds
    rows: Rows
    reference: Array
    equalities: Equalities

    def __init__(
        self,
        levels: Sequence[Level],
        bounds: Bounds | None = None,
        rows: Rows | None = None,
        reference: ArrayLike | None = None,
        equalities: Equalities | None = None,
    ) -> None:
        if isinstance(levels, Level) or not levels or not all(isinstance(level, Level) for level in levels):
            raise InputError(f"levels is {levels!r}; expected a list of at least one Level.")
        parts = (("bounds", bounds, Bounds), ("rows", rows, Rows), ("equalities", equalities, Equalities))
        for name, given, kind in parts:
            if given is not None and not isinstance(given, kind):
                raise InputError(f"{name} is {given!r}; expected {kind.__name__} or None.")
        m = levels[0].matrix.shape[1]
        _set(
            self,
            levels=tuple(levels),
            bounds=Bounds.none(m) if bounds is None else bounds,
            rows=Rows.none(m) if rows is None else rows,
            reference=finite_array("reference", np.zeros(m) if reference is None else reference, (m,)),
            equalities=Equalities.none(m) if equalities is None else equalities,
        )
        widths = {f"level {level.name!r}": level.matrix.shape[1] for level in levels}
        widths |= {"bounds": len(self.bounds.lower), "rows": self.rows.matrix.shape[1]}
        widths |= {"equalities": self.equalities.matrix.shape[1]}
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

    def softened(self, names: Sequence[str]) -> "IKProblem":
        """Return the problem with some hard rows as its most important level, one of soft inequalities.

        The level is called "softened rows". Its rows are of unit length, so that what it gives way by is a distance in
        joint space [rad]; an equality becomes two of them.

        Args:
            names: of bounds ("joint 1 upper"), rows and equalities.

        Raises:
            InputError: there is no such name.
        """
        hard, fixed = self.inequalities, self.equalities
        known = (*hard.names, *fixed.names)
        for name in names:
            if name not in known:
                shown = ", ".join(known[:8]) + (", …" if len(known) > 8 else "")
                raise InputError(f"no hard row is called {name!r}; there are: {shown or 'none'}.")
        if not names:
            return self
        soft, of_rows, of_fixed = (np.isin(list(group), names) for group in (hard.names, self.rows.names, fixed.names))
        matrix = np.vstack([hard.matrix[soft], fixed.matrix[of_fixed], -fixed.matrix[of_fixed]])
        target = np.concatenate([hard.upper[soft], fixed.target[of_fixed], -fixed.target[of_fixed]])
        sizes = lengths(matrix)
        sizes[sizes == 0.0] = 1.0  # a row of zeros, which every step keeps
        joints = self.bounds.names
        bounds = Bounds(
            np.where(np.isin([f"{joint} lower" for joint in joints], names), -np.inf, self.bounds.lower),
            np.where(np.isin([f"{joint} upper" for joint in joints], names), np.inf, self.bounds.upper),
            joints,
        )
        return IKProblem(
            (Level(matrix / sizes[:, None], target / sizes, name="softened rows", kind="at_most"), *self.levels),
            bounds,
            Rows(self.rows.matrix[~of_rows], self.rows.upper[~of_rows], _kept(self.rows.names, ~of_rows)),
            self.reference,
            Equalities(fixed.matrix[~of_fixed], fixed.target[~of_fixed], _kept(fixed.names, ~of_fixed)),
        )

    def relative_violation(self, dtheta: ArrayLike) -> float:
        """Return the worst violation of any bound, row or equality at `dtheta` `(m,)`, as a fraction of the step's scale.

        A row's violation is its distance in joint space, (g·dθ - h) / ‖g‖; the step's scale is ‖dθ‖, at least
        `STEP_FLOOR`. Zero when all hold.
        """
        step = np.asarray(dtheta, dtype=float)
        above = self.inequalities.matrix @ step - self.inequalities.upper
        off = np.abs(self.equalities.matrix @ step - self.equalities.target)
        tiny = np.finfo(float).tiny
        distances = (above / np.maximum(self._row_norms, tiny), off / np.maximum(self._equality_norms, tiny))
        return max(0.0, *(float(distance.max(initial=0.0)) for distance in distances)) / step_scale(step)

    def tight_rows(self, dtheta: ArrayLike, tolerance: float) -> tuple[str, ...]:
        """Return the names of the bounds and rows within `tolerance` of binding at `dtheta`, as a joint distance [rad]."""
        slack = self.inequalities.upper - self.inequalities.matrix @ np.asarray(dtheta, dtype=float)
        tight = slack <= tolerance * self._row_norms
        return tuple(name for name, is_tight in zip(self.inequalities.names, tight, strict=True) if is_tight)

    @cached_property
    def _row_norms(self) -> Array:
        return read_only(lengths(self.inequalities.matrix))

    @cached_property
    def _equality_norms(self) -> Array:
        return read_only(lengths(self.equalities.matrix))


def step_scale(dtheta: Array) -> float:
    """Return what relative figures of a step count against: ‖dθ‖ [rad], at least `STEP_FLOOR`."""
    return max(length(dtheta), STEP_FLOOR)


def _kept(names: tuple[str, ...], kept: NDArray[np.bool_]) -> tuple[str, ...]:
    return tuple(name for name, keep in zip(names, kept, strict=True) if keep)


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
