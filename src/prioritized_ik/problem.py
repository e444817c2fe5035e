"""The problem of one joint step, free of MuJoCo: levels in strict order, bounds, rows, equalities and a reference.

Lexicographic least squares: level 1 minimises (b - A dθ)ᵀ W (b - A dθ), each further level does so among the optima of
those before it, and an implicit last level minimises ‖dθ - r‖². With one level and nothing binding that is Eqs. 12 and
13 of the paper, and the optimum is unique in any case, because the last level is strictly convex. A level can also be
one of soft inequalities, which counts only what exceeds its target.
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from itertools import compress
from typing import TypeVar

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from prioritized_ik.double_double import DoubleDouble
from prioritized_ik.errors import InputError
from prioritized_ik.tolerances import NOISE, ROUNDING
from prioritized_ik.validation import (
    LARGEST,
    Array,
    distinct,
    finite_array,
    first_repeated,
    fraction,
    length,
    lengths,
    non_negative,
    one_of,
    ones,
    read_only,
    shaped_array,
)

#: `equal` is least squares of A dθ = b; `at_most` of what A dθ <= b leaves violated.
KINDS = ("equal", "at_most")

#: What a damped level leaves to those below: all that does not change what its damped optimum reaches, or nothing.
BELOW = ("free", "hold")

Record = TypeVar("Record")

LEAST_METRIC = 1e-100  # its root divides rows, whose squares must not overflow

NOISIEST = 1e-2  # data with more noise than this decide nothing


@dataclass(frozen=True, init=False, eq=False)
class Level:
    """One priority level: weighted least squares of `matrix @ dtheta` against `target`, or of its excess over `target`.

    Attributes:
        matrix: A, for instance the stacked Jacobian J `(k, m)`.
        target: b, for instance the desired displacement dX_v* `(k,)`.
        weights: diagonal of W `(k,)`; ones unless given. A row of weight zero means nothing.
        name: what messages call it.
        kind: `"equal"`, or `"at_most"` for soft inequalities, whose targets may be infinite.
        damping: δ >= 0: the level minimises its cost + δ ‖dθ‖², in the problem's joint metric.
        below: what a damped level leaves to those below: `"free"`, every motion that does not change what its damped
            optimum reaches; `"hold"`, no motion at all.

    Raises:
        InputError: shapes that do not fit, a weight or damping below zero, an unknown kind or `below`; damping of soft
            inequalities.
    """

    matrix: Array
    target: Array
    weights: Array
    name: str
    kind: str
    damping: float
    below: str

    def __init__(
        self,
        matrix: ArrayLike,
        target: ArrayLike,
        weights: ArrayLike | None = None,
        name: str = "task",
        kind: str = "equal",
        damping: float = 0.0,
        below: str = "free",
    ) -> None:
        one_of(f"kind of level {name!r}", kind, KINDS)
        one_of(f"below of level {name!r}", below, BELOW)
        if non_negative(f"damping of level {name!r}", damping) and kind == "at_most":
            raise InputError(f"damping of level {name!r} is {damping}; expected 0, as soft inequalities have none.")
        checked = finite_array(f"matrix of level {name!r}", matrix, (None, None))
        k = checked.shape[0]
        if weights is None:
            diagonal = ones(k)
        else:
            diagonal = finite_array(f"weights of level {name!r}", weights, (k,))
        if weights is not None and (diagonal < 0.0).any():
            place = int(np.argmin(diagonal))
            raise InputError(f"weights of level {name!r}[{place}] is {diagonal[place]}; expected numbers of at least 0.")
        what = f"target of level {name!r}"
        _set(
            self,
            matrix=checked,
            target=_upper_side(what, target, k) if kind == "at_most" else finite_array(what, target, (k,)),
            weights=diagonal,
            name=name,
            kind=kind,
            damping=float(damping),
            below=below,
        )

    @property
    def hands_down(self) -> bool:
        """Whether its damped optimum is handed down to those below."""
        return self.damping > 0.0 and self.below == "free"

    @property
    def is_soft(self) -> bool:
        """Whether this is a level of soft inequalities."""
        return self.kind == "at_most"

    @property
    def joint_count(self) -> int:
        """Number of joints m."""
        return self.matrix.shape[1]

    def times(self, dtheta: Array) -> Array:
        """Return A dθ `(k,)`."""
        return self.matrix @ dtheta

    def residual(self, dtheta: Array) -> Array:
        """Return A dθ - b `(k,)`; of a soft level only what is above zero."""
        residual = self.times(dtheta) - self.target
        return np.maximum(residual, 0.0) if self.is_soft else residual

    def cost(self, dtheta: Array) -> float:
        """Q = (b - A dθ)ᵀ W (b - A dθ), Eq. (10); of a soft level the same of max(A dθ - b, 0)."""
        residual = self.residual(dtheta)
        return float(residual @ (self.weights * residual))

    @cached_property
    def row_lengths(self) -> Array:
        """Length of each row `(k,)`."""
        return lengths(self.matrix)

    @cached_property
    def strength(self) -> float:
        """What a step of unit length can do to the level at most, ‖W^½ A‖."""
        return math.sqrt(self.weights @ self.row_lengths**2)

    @property
    def demand(self) -> float:
        """Length of what the level asks for, √(bᵀ W b), infinite targets aside."""
        target = np.where(np.isfinite(self.target), self.target, 0.0) if self.is_soft else self.target
        return math.sqrt(self.weights @ (target * target))


@dataclass(frozen=True, init=False, eq=False)
class Bounds:
    """lower <= dθ <= upper, each `(m,)` [rad]; infinities are allowed. `names` name the joints in messages; all differ."""

    lower: Array
    upper: Array
    names: tuple[str, ...]

    def __init__(self, lower: ArrayLike, upper: ArrayLike, names: Sequence[str] = ()) -> None:
        low = shaped_array("lower bounds", lower, (None,))
        high = shaped_array("upper bounds", upper, low.shape)
        joints = _names("bounds", names, "joint", len(low))
        crossed = (low > high) | (low == np.inf) | (high == -np.inf)
        if crossed.any():
            i = int(crossed.argmax())
            raise InputError(
                f"'{joints[i]} lower' is {low[i]}, above '{joints[i]} upper', {high[i]}: no step keeps both; widen one."
            )
        _set(self, lower=low, upper=high, names=joints)

    def intersect(self, other: "Bounds") -> "Bounds":
        """Return the bounds that keep both, with the names of these.

        Raises:
            InputError: other joints, or bounds that no step keeps.
        """
        if self.lower.shape != other.lower.shape:
            raise InputError(f"the other bounds are of {len(other.lower)} joints; expected {len(self.lower)}, as these.")
        lower, upper = np.maximum(self.lower, other.lower), np.minimum(self.upper, other.upper)
        if (lower > upper).any():
            return Bounds(lower, upper, self.names)  # which says whose
        return trusted(Bounds, lower=lower, upper=upper, names=self.names)

    @staticmethod
    @lru_cache(maxsize=16)
    def none(m: int) -> "Bounds":
        """Return bounds on `m` joints that never bind."""
        return Bounds(np.full(m, -np.inf), np.full(m, np.inf))


@dataclass(frozen=True, init=False, eq=False)
class Rows:
    """Inequality rows: matrix `(r, m)` @ dθ <= upper `(r,)`, infinite for none. `names` name the rows; all differ."""

    matrix: Array
    upper: Array
    names: tuple[str, ...]

    def __init__(self, matrix: ArrayLike, upper: ArrayLike, names: Sequence[str] = ()) -> None:
        checked = finite_array("matrix of rows", matrix, (None, None))
        side = _upper_side("upper side of rows", upper, len(checked))
        known = _names("rows", names, "row", len(checked))
        never = side < 0.0  # of most rows none
        if never.any() and (never := ~checked.any(axis=1) & (side < -_rounding_of(side))).any():
            i = int(never.argmax())
            raise InputError(f"{known[i]} is all zero but must not exceed {side[i]}, which no step can keep; leave it out.")
        _set(self, matrix=checked, upper=side, names=known)

    @property
    def joint_count(self) -> int:
        """Number of joints m."""
        return self.matrix.shape[1]

    @staticmethod
    @lru_cache(maxsize=16)
    def none(m: int) -> "Rows":
        """Return no row on `m` joints."""
        return Rows(np.zeros((0, m)), np.zeros(0))

    @staticmethod
    def joined(parts: Sequence["Rows"], m: int) -> "Rows":
        """Return the rows of all `parts` on `m` joints in their order; of two with one name the later is "name (2)"."""
        if not parts:
            return Rows.none(m)
        if len(parts) == 1:
            return parts[0]
        return Rows(
            np.vstack([part.matrix for part in parts]),
            np.concatenate([part.upper for part in parts]),
            distinct([name for part in parts for name in part.names]),
        )


@dataclass(frozen=True, init=False, eq=False)
class Equalities:
    """Hard equality rows: matrix `(e, m)` @ dθ = target `(e,)`. `names` name the rows; all differ."""

    matrix: Array
    target: Array
    names: tuple[str, ...]

    def __init__(self, matrix: ArrayLike, target: ArrayLike, names: Sequence[str] = ()) -> None:
        checked = finite_array("matrix of equalities", matrix, (None, None))
        side = finite_array("target of equalities", target, checked.shape[:1])
        known = _names("equalities", names, "equality", len(checked))
        never = np.flatnonzero(~checked.any(axis=1) & (np.abs(side) > _rounding_of(side)))
        if never.size:
            i = int(never[0])
            raise InputError(f"{known[i]} is all zero but must be {side[i]}, which no step can keep; leave it out.")
        _set(self, matrix=checked, target=side, names=known)

    @staticmethod
    @lru_cache(maxsize=16)
    def none(m: int) -> "Equalities":
        """Return no equality on `m` joints."""
        return Equalities(np.zeros((0, m)), np.zeros(0))

    @staticmethod
    def joined(parts: Sequence["Equalities"], m: int) -> "Equalities":
        """Return the equalities of all `parts` on `m` joints, named as by `Rows.joined`."""
        if not parts:
            return Equalities.none(m)
        if len(parts) == 1:
            return parts[0]
        return Equalities(
            np.vstack([part.matrix for part in parts]),
            np.concatenate([part.target for part in parts]),
            distinct([name for part in parts for name in part.names]),
        )


@dataclass(frozen=True, init=False, eq=False)
class IKProblem:
    """The problem of one joint step dθ `(m,)`.

    Attributes:
        levels: the most important first; there may be none.
        bounds: hard bounds on dθ.
        rows: hard inequality rows.
        reference: r `(m,)` [rad], the last level's target (Eq. 13); zero for the least norm (Eq. 14).
        equalities: hard equality rows.
        metric: M, by which the last level measures, ‖dθ - r‖² = (dθ - r)ᵀ M (dθ - r), and with it every relative
            tolerance: a diagonal `(m,)` or a matrix `(m, m)`; ones unless given, as in the paper. See
            `limits.joint_metric` for joints of several units.
        noise: of the data, as a fraction: what is this little of its surroundings is rounding and counts as zero; about
            1e-6 for data in single precision. The default is that of doubles: 1e-12 for combinations of rows of unit
            length, but 1.4e-14 of the longest for whole rows.

    Raises:
        InputError: widths that differ or are not known, a bound, row or equality with the name of another, a metric that
            is not positive, a noise out of range.
    """

    levels: tuple[Level, ...]
    bounds: Bounds
    rows: Rows
    reference: Array
    equalities: Equalities
    metric: Array
    noise: float

    def __init__(
        self,
        levels: Sequence[Level],
        bounds: Bounds | None = None,
        rows: Rows | None = None,
        reference: ArrayLike | None = None,
        equalities: Equalities | None = None,
        *,
        metric: ArrayLike | None = None,
        noise: float = NOISE,
    ) -> None:
        if not isinstance(levels, list | tuple | Sequence) or not all([isinstance(level, Level) for level in levels]):
            raise InputError(f"levels is {levels!r}; expected a list of Level.")
        parts = (("bounds", bounds, Bounds), ("rows", rows, Rows), ("equalities", equalities, Equalities))
        for name, given, kind in parts:
            if given is not None and not isinstance(given, kind):
                raise InputError(f"{name} is {given!r}; expected {kind.__name__} or None.")
        widths = [level.joint_count for level in levels]
        if bounds is not None:
            widths.append(len(bounds.lower))
        if rows is not None:
            widths.append(rows.joint_count)
        if equalities is not None:
            widths.append(equalities.matrix.shape[1])
        if reference is not None and not widths:
            widths.append(np.size(reference))
        if not widths:
            raise InputError(
                "the problem has neither levels nor bounds, rows, equalities or reference: no number of joints."
            )
        m = widths[0]
        if widths.count(m) != len(widths):
            names = [
                *(f"level {level.name!r}" for level in levels),
                *(name for name, given, _ in parts if given is not None),
            ]
            name, width = next((name, width) for name, width in zip(names, widths, strict=True) if width != m)
            raise InputError(f"{name} has {width} joints; expected {m}, as many as {names[0]}.")
        zeros, units, free, without, no_equality = _nothing(m)
        bounds, rows = bounds or free, rows or without
        equalities = equalities or no_equality
        _check_names(bounds, rows, equalities)
        _set(
            self,
            levels=tuple(levels),
            bounds=bounds,
            rows=rows,
            reference=zeros if reference is None else finite_array("reference", reference, (m,)),
            equalities=equalities,
            metric=units if metric is None else _positive_metric(metric, m),
            noise=fraction("noise", noise, below=NOISIEST),
        )

    @property
    def pattern(self) -> "IKProblem":
        """A problem of the same shape, names, kinds of levels, damping, metric and noise, at hand whatever its numbers."""
        return self

    @property
    def hands_down(self) -> bool:
        """Whether the optimum of a damped level is handed down, see `damping`."""
        return any([level.hands_down for level in self.levels])

    def with_levels(self, levels: Sequence[Level]) -> "IKProblem":
        """Return the problem with other levels; what rows and metric alone decide is not worked out again."""
        other = replaced(self, levels=tuple(levels))
        vars(other).update({name: value for name, value in vars(self).items() if name in _WITHOUT_LEVELS})
        return other

    @cached_property
    def metric_root(self) -> Array:
        """L with LᵀL = M: `(m,)` of a diagonal metric, else upper triangular `(m, m)`."""
        return read_only(np.sqrt(self.metric) if self.metric.ndim == 1 else np.linalg.cholesky(self.metric).T)

    @cached_property
    def in_metric(self) -> "IKProblem":
        """The same problem for u = L dθ, in which the metric is the identity. The problem itself if it has that already.

        A bound on a joint becomes one on the joint's u, or a row if the metric couples joints.
        """
        root = self.metric_root
        if root.ndim == 1 and (root == 1.0).all():
            return self
        m, bounds, rows, equalities = self.joint_count, self.bounds, self.rows, self.equalities
        if root.ndim == 1:
            bounds = trusted(Bounds, lower=bounds.lower * root, upper=bounds.upper * root, names=bounds.names)
        else:
            frozen = bounds.lower == bounds.upper
            names = tuple(f"{name} frozen" for name, keep in zip(bounds.names, frozen, strict=True) if keep)
            equalities = trusted(
                Equalities,
                matrix=np.vstack([np.eye(m)[frozen], equalities.matrix]),
                target=np.append(bounds.lower[frozen], equalities.target),
                names=(*names, *equalities.names),
            )
            bounds, rows = Bounds.none(m), self.inequalities
        stacked = [*(level.matrix for level in self.levels), rows.matrix, equalities.matrix]
        ends = np.cumsum([len(matrix) for matrix in stacked])
        *matrices, of_rows, of_equalities = np.split(self._divided(np.concatenate(stacked)), ends[:-1])
        return trusted(
            IKProblem,
            levels=tuple(replaced(level, matrix=own) for level, own in zip(self.levels, matrices, strict=True)),
            bounds=bounds,
            rows=replaced(rows, matrix=of_rows),
            reference=self.to_metric(self.reference),
            equalities=replaced(equalities, matrix=of_equalities),
            metric=np.ones(m),
            noise=self.noise,
        )

    def to_metric(self, dtheta: Array) -> Array:
        """Return u = L dθ `(m,)`."""
        root = self.metric_root
        return root * dtheta if root.ndim == 1 else root @ dtheta

    def from_metric(self, u: Array) -> Array:
        """Return dθ = L⁻¹ u `(m,)`."""
        root = self.metric_root
        return u / root if root.ndim == 1 else _solved(root, u[:, None], "N")[:, 0]

    def _divided(self, matrix: Array) -> Array:
        """Return `matrix` `(k, m)` L⁻¹, right to the last digit but one."""
        root = self.metric_root
        return matrix / root if root.ndim == 1 else _solved(root, matrix.T, "T").T

    @property
    def joint_count(self) -> int:
        """Number of joints m."""
        return len(self.reference)

    @cached_property
    def inequalities(self) -> "Rows":
        """Every finite bound and row as one set of rows: upper bounds, then lower bounds, then `rows`."""
        bounds, rows = self.bounds, self.rows
        above, below, some = np.isfinite(bounds.upper), np.isfinite(bounds.lower), np.isfinite(rows.upper)
        sides, names = _sides(above.tobytes(), below.tobytes(), bounds.names)
        kept = slice(None) if some.all() else some
        return trusted(
            Rows,
            matrix=np.concatenate([sides, rows.matrix[kept]]),
            upper=np.concatenate([bounds.upper[above], -bounds.lower[below], rows.upper[kept]]),
            names=names + (rows.names if kept is not some else _kept(rows.names, some)),
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
        return replaced(
            self,
            levels=(Level(matrix / sizes[:, None], target / sizes, name="softened rows", kind="at_most"), *self.levels),
            bounds=bounds,
            rows=Rows(self.rows.matrix[~of_rows], self.rows.upper[~of_rows], _kept(self.rows.names, ~of_rows)),
            equalities=Equalities(fixed.matrix[~of_fixed], fixed.target[~of_fixed], _kept(fixed.names, ~of_fixed)),
        )

    def violation(self, dtheta: ArrayLike) -> float:
        """Return the worst violation of any bound, row or equality at `dtheta` `(m,)`, as a joint distance.

        A row's is its distance in the joint metric, (g·dθ - h) / ‖g‖. Zero when all hold. Rows that are rounding, at most
        `noise` of the longest, are kept by every step.
        """
        scaled, u = self.in_metric, self.to_metric(np.asarray(dtheta, dtype=float))
        above = scaled.inequalities.matrix @ u - scaled.inequalities.upper
        off = np.abs(scaled.equalities.matrix @ u - scaled.equalities.target)
        fixed = scaled.equality_lengths > scaled.zero_length
        return max(
            float(np.where(real, distances / np.where(real, sizes, 1.0), 0.0).max(initial=0.0))
            for distances, sizes, real in (
                (above, scaled.row_lengths, scaled.real_rows),
                (off, scaled.equality_lengths, fixed),
            )
        )

    def relative_violation(self, dtheta: ArrayLike) -> float:
        """Return `violation` as a fraction of the step's length; of a step of zero, the distance itself."""
        step = np.asarray(dtheta, dtype=float)
        return self.violation(step) / (length(self.to_metric(step)) or 1.0)

    def tight_rows(self, dtheta: ArrayLike, tolerance: float) -> tuple[str, ...]:
        """Return the names of the bounds and rows within `tolerance` of binding at `dtheta`, a distance in the metric."""
        scaled, u = self.in_metric, self.to_metric(np.asarray(dtheta, dtype=float))
        slack = scaled.inequalities.upper - scaled.inequalities.matrix @ u
        tight = (slack <= tolerance * scaled.row_lengths) & scaled.real_rows
        return _kept(scaled.inequalities.names, tight)

    @cached_property
    def zero_length(self) -> float:
        """Rows of levels, rows and equalities up to this length are rounding: none at all.

        That is the `noise` of the longest if it is stated; else what doubles leave of a zero, and no more: rows may be
        twelve decades apart by their units alone.
        """
        return (self.noise if self.noise != NOISE else ROUNDING) * self.longest_row

    @cached_property
    def longest_row(self) -> float:
        """Length of the longest row in the metric, that of the last level included: one joint's step, of length one."""
        longest = [1.0, *(level.row_lengths.max(initial=0.0) for level in self.in_metric.levels)]
        longest += [self.in_metric.row_lengths.max(initial=0.0), self.in_metric.equality_lengths.max(initial=0.0)]
        return float(max(longest))

    @cached_property
    def real_rows(self) -> NDArray[np.bool_]:
        """Which of the `inequalities` `(r,)` are more than rounding, in a problem in its metric; bounds always are."""
        real = self.row_lengths > self.zero_length
        real[: len(real) - np.count_nonzero(np.isfinite(self.rows.upper))] = True
        return read_only(real)

    @cached_property
    def row_lengths(self) -> Array:
        """Length of each of the `inequalities` `(r,)`."""
        bounded = len(self.inequalities.upper) - np.count_nonzero(np.isfinite(self.rows.upper))
        return read_only(np.concatenate([ones(bounded), lengths(self.inequalities.matrix[bounded:])]))

    @cached_property
    def equality_lengths(self) -> Array:
        """Length of each of the `equalities` `(e,)`."""
        return read_only(lengths(self.equalities.matrix))

    def __str__(self) -> str:
        """Return the problem in a few lines."""
        lines = [f"IKProblem of {self.joint_count} joints, {len(self.levels)} levels"]
        for number, level in enumerate(self.levels, 1):
            damped = f", damping {level.damping:g} ({level.below})" if level.damping else ""
            k = len(level.target)
            lines.append(f"  {number}. {level.name}: {k} rows, {level.kind}, asks for {level.demand:.3g}{damped}")
        bounded = np.count_nonzero(np.isfinite(self.bounds.lower) | np.isfinite(self.bounds.upper))
        frozen = np.count_nonzero(self.bounds.lower == self.bounds.upper)
        lines.append(
            f"  hard: {bounded} joints bounded ({frozen} frozen), {len(self.rows.upper)} rows, "
            f"{len(self.equalities.target)} equalities"
        )
        return "\n".join(lines)


#: What of a problem, worked out when looked at, does not depend on its levels.
_WITHOUT_LEVELS = frozenset({"metric_root", "inequalities", "row_lengths", "equality_lengths"})


def trusted(kind: type[Record], /, **fields: object) -> Record:
    """Return a record of `kind` with fields that need no check: arrays that this package made of checked ones."""
    record = object.__new__(kind)
    for value in fields.values():
        if type(value) is np.ndarray:
            value.setflags(write=False)
    record.__dict__.update(fields)
    return record


def trusted_level(matrix: Array, target: Array, weights: Array, name: str) -> Level:
    """Return an undamped level of kind `"equal"` that needs no check: see `trusted`."""
    return trusted(Level, matrix=matrix, target=target, weights=weights, name=name, kind="equal", damping=0.0, below="free")


def trusted_problem(levels: tuple[Level, ...], bounds: Bounds | None, rows: Rows | None, m: int) -> IKProblem:
    """Return a problem of `m` joints with reference zero and without equalities, that needs no check: see `trusted`."""
    zeros, units, free, without, no_equality = _nothing(m)
    return trusted(
        IKProblem,
        levels=levels,
        bounds=free if bounds is None else bounds,
        rows=without if rows is None else rows,
        reference=zeros,
        equalities=no_equality,
        metric=units,
        noise=NOISE,
    )


def posed_level(
    matrix: Array, target: Array, weights: Array, name: str, damping: float = 0.0, below: str = "free"
) -> Level:
    """Return a level of kind `"equal"` of arrays that this package made: no copy, and no long look at them.

    Raises:
        InputError: what `Level` does not take.
    """
    shaped = matrix.ndim == 2 and target.shape == weights.shape == matrix.shape[:1]
    sizes = np.vdot(matrix, matrix) + np.vdot(target, target) + np.vdot(weights, weights) if shaped else np.nan
    if not (sizes <= LARGEST and weights.min(initial=0.0) >= 0.0 and math.isfinite(damping)):
        return Level(matrix, target, weights, name, "equal", damping, below)
    return trusted(
        Level, matrix=matrix, target=target, weights=weights, name=name, kind="equal", damping=damping, below=below
    )


def posed_bounds(lower: Array, upper: Array, names: tuple[str, ...]) -> Bounds:
    """Return bounds of arrays that this package made, one a joint of `names`: no copy, and no long look at them.

    Raises:
        InputError: what `Bounds` does not take.
    """
    if not (np.vdot(lower, lower) + np.vdot(upper, upper) <= LARGEST and (lower <= upper).all()):
        return Bounds(lower, upper, names)
    return trusted(Bounds, lower=lower, upper=upper, names=names)


def posed_problem(
    levels: Sequence[Level], bounds: Bounds, rows: Rows, equalities: Equalities, metric: Array | None = None
) -> IKProblem:
    """Return a problem with reference zero of parts that were checked by themselves, and of a metric that needs no check.

    Raises:
        InputError: levels of another width, or names that do not differ, as `IKProblem` says.
    """
    m = len(bounds.lower)
    if not all([level.joint_count == m for level in levels]):
        return IKProblem(levels, bounds, rows, equalities=equalities, metric=metric)  # which says whose
    zeros, units, _, without, no_equality = _nothing(m)
    if rows is not without or equalities is not no_equality:
        _check_names(bounds, rows, equalities)
    return trusted(
        IKProblem,
        levels=tuple(levels),
        bounds=bounds,
        rows=rows,
        reference=zeros,
        equalities=equalities,
        metric=units if metric is None else metric,
        noise=NOISE,
    )


@lru_cache(maxsize=16)
def _nothing(m: int) -> tuple[Array, Array, Bounds, Rows, Equalities]:
    """Return what problems of `m` joints have where nothing else is asked for."""
    return read_only(np.zeros(m)), ones(m), Bounds.none(m), Rows.none(m), Equalities.none(m)


def replaced(record: Record, /, **fields: object) -> Record:
    """Return `record` with some fields changed, unchecked: see `trusted`.

    What holds its matrix in another form, as `tree_problem` does, becomes the plain record of a matrix.
    """
    kept = {field.name: getattr(record, field.name) for field in dataclasses.fields(record)}  # type: ignore[arg-type]
    kind = next(kind for kind in type(record).__mro__ if "__dataclass_fields__" in vars(kind))
    return trusted(kind, **kept | fields)


@lru_cache(maxsize=16)  # which joints are bounded seldom changes in a loop
def _sides(above: bytes, below: bytes, joints: tuple[str, ...]) -> tuple[Array, tuple[str, ...]]:
    """Return the matrix and the names of upper, then of lower bounds, given of which joints there are any."""
    has_upper, has_lower = np.frombuffer(above, dtype=bool), np.frombuffer(below, dtype=bool)
    eye = np.eye(len(joints))
    uppers = tuple(f"{name} upper" for name in _kept(joints, has_upper))
    lowers = tuple(f"{name} lower" for name in _kept(joints, has_lower))
    return read_only(np.concatenate([eye[has_upper], -eye[has_lower]])), uppers + lowers


def _positive_metric(metric: ArrayLike, m: int) -> Array:
    """Return the metric `(m,)` or `(m, m)` if it is positive definite."""
    if np.ndim(metric) == 2:
        matrix = finite_array("metric", metric, (m, m))
        skew = float(np.abs(matrix - matrix.T).max(initial=0.0))
        if skew > NOISE * float(np.abs(matrix).max(initial=0.0)):
            raise InputError(f"metric differs from its transpose by {skew:g}; expected a symmetric matrix.")
        _positive_metric(np.diag(matrix), m)
        roots = np.sqrt(np.diag(matrix))
        least = float(np.linalg.eigvalsh(matrix / np.outer(roots, roots))[0]) if m else 1.0  # whatever the joints' units
        if least <= m * NOISE:
            raise InputError(
                f"metric is singular (eigenvalue {least:g} at unit diagonal); expected a positive definite matrix."
            )
        return matrix
    diagonal = finite_array("metric", metric, (m,))
    if (diagonal <= LEAST_METRIC).any():
        place = int(np.argmin(diagonal))
        raise InputError(f"metric[{place}] is {diagonal[place]}; expected numbers above 0, and above {LEAST_METRIC:g}.")
    return diagonal


def _solved(root: Array, right: Array, trans: str) -> Array:
    """Return x `(m, k)` with L x = `right` `(m, k)`, or Lᵀ x if `trans` is "T", refined with twice the digits of doubles.

    Rows that doubles alone divide are off by as much more as L is ill-conditioned, which a certificate could not know.
    """
    solve = partial(scipy.linalg.solve_triangular, root, trans=trans)
    exact, wanted = DoubleDouble.of(root if trans == "N" else root.T), DoubleDouble.of(right)
    found: Array = solve(right)
    return found + solve((wanted - exact @ DoubleDouble.of(found)).rounded) if right.size else found


def _rounding_of(sides: Array) -> float:
    """Return what of sides `(n,)` is rounding beside the largest of them."""
    finite = np.abs(sides[np.isfinite(sides)])
    return NOISE * float(finite.max(initial=0.0))


def _upper_side(what: str, upper: ArrayLike, count: int) -> Array:
    """Return upper sides `(count,)`, which may be infinite: then there is none."""
    side = shaped_array(what, upper, (count,))
    never = side == -np.inf
    if never.any():
        raise InputError(f"{what}[{int(never.argmax())}] is -inf, which no step can keep; expected numbers or inf.")
    return side


def _kept(names: tuple[str, ...], kept: NDArray[np.bool_]) -> tuple[str, ...]:
    return tuple(compress(names, kept.tolist()))


def _set(record: object, **values: object) -> None:
    """Fill the fields of a frozen record."""
    record.__dict__.update(values)


def _names(what: str, given: Sequence[str], word: str, count: int) -> tuple[str, ...]:
    """Return one name an entry: those given, or `word` and its number from 1."""
    names = tuple(given) or tuple(f"{word} {i + 1}" for i in range(count))
    if len(names) != count:
        raise InputError(f"names of {what} has {len(names)} entries; expected {count}.")
    if (repeated := first_repeated(names)) is not None:
        first, second = [place for place, name in enumerate(names) if name == repeated][:2]
        raise InputError(
            f"names of {what}[{first}] and [{second}] are both {repeated!r}; expected names that differ: "
            "rows are told apart, and remembered from step to step, by them."
        )
    return names


@lru_cache(maxsize=64)
def _sides_of(joints: tuple[str, ...]) -> frozenset[str]:
    """Return what the bounds on joints are called, upper and lower ones."""
    return frozenset(f"{joint} {side}" for joint in joints for side in ("upper", "lower"))


def _check_names(bounds: Bounds, rows: Rows, equalities: Equalities) -> None:
    """Raise if a bound, row or equality has the name of another."""
    sides, hard = _sides_of(bounds.names), set(rows.names)
    groups = (("a bound", sides, "a row", hard), ("a bound", sides, "an equality", equalities.names))
    for one, names, other, others in (*groups, ("a row", hard, "an equality", equalities.names)):
        if not names.isdisjoint(others):
            raise InputError(f"{one} and {other} are both called {min(names & {*others})!r}; expected names that differ.")
