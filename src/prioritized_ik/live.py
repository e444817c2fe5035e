"""A problem that lives: its numbers change from step to step, its shape and names do not.

An `IKProblem` is frozen and checked; a control loop that makes one a step has its names and shapes worked out anew each
time. A `LiveProblem` is made of one problem, keeps what does not change, and lets the rest be written in place:

    live = LiveProblem(problem)
    while True:
        live.matrix("hands")[:] = jacobian
        live.target("hands")[:] = wanted
        live.lower[:], live.upper[:] = bounds
        step = solve(live.frozen(), solver)

A row that is to be left out for a while gets an infinite side.
"""

from typing import Any

import numpy as np

from prioritized_ik.errors import InputError
from prioritized_ik.problem import Bounds, Equalities, IKProblem, Level, Rows, trusted
from prioritized_ik.validation import LARGEST, Array, lengths


class LiveProblem:
    """Arrays to be written in place, and the problem that they stand for.

    Attributes:
        lower, upper: bounds on dθ `(m,)` [rad].
        reference: r `(m,)` [rad].
        row_matrix, row_upper: of the hard inequality rows `(r, m)`, `(r,)`.
        equality_matrix, equality_target: of the hard equalities `(e, m)`, `(e,)`.
    """

    def __init__(self, problem: IKProblem) -> None:
        if not isinstance(problem, IKProblem):
            raise InputError(f"problem is of type {type(problem).__name__}; expected an IKProblem with the shapes to keep.")
        self._first = problem
        self._numbers = {level.name: number for number, level in reversed(list(enumerate(problem.levels)))}
        self._matrices = [level.matrix.copy() for level in problem.levels]
        self._targets = [level.target.copy() for level in problem.levels]
        self._weights = [level.weights.copy() for level in problem.levels]
        self.lower, self.upper = problem.bounds.lower.copy(), problem.bounds.upper.copy()
        self.reference = problem.reference.copy()
        self.row_matrix, self.row_upper = problem.rows.matrix.copy(), problem.rows.upper.copy()
        self.equality_matrix, self.equality_target = problem.equalities.matrix.copy(), problem.equalities.target.copy()
        self._shapes = [array.shape for array in self._arrays()]

    def matrix(self, level: str | int) -> Array:
        """Return A `(k, m)` of a level, by its name or number, to be written in place."""
        return self._matrices[self._number(level)]

    def target(self, level: str | int) -> Array:
        """Return b `(k,)` of a level, by its name or number, to be written in place."""
        return self._targets[self._number(level)]

    def weights(self, level: str | int) -> Array:
        """Return the diagonal of W `(k,)` of a level, by its name or number, to be written in place."""
        return self._weights[self._number(level)]

    def frozen(self) -> IKProblem:
        """Return the problem as it is now; it does not change with the arrays.

        Raises:
            InputError: a number that no problem may hold, as `IKProblem` would say, or an array put in the place of one.
        """
        if not self._is_sound():
            self._complain()
        first = self._first
        levels = tuple(
            trusted(
                Level,
                matrix=self._matrices[number].copy(),
                target=self._targets[number].copy(),
                weights=self._weights[number].copy(),
                name=level.name,
                kind=level.kind,
                damping=level.damping,
                below=level.below,
            )
            for number, level in enumerate(first.levels)
        )
        return trusted(
            IKProblem,
            levels=levels,
            bounds=trusted(Bounds, lower=self.lower.copy(), upper=self.upper.copy(), names=first.bounds.names),
            rows=trusted(Rows, matrix=self.row_matrix.copy(), upper=self.row_upper.copy(), names=first.rows.names),
            reference=self.reference.copy(),
            equalities=trusted(
                Equalities,
                matrix=self.equality_matrix.copy(),
                target=self.equality_target.copy(),
                names=first.equalities.names,
            ),
            metric=first.metric,
            noise=first.noise,
        )

    def _number(self, level: str | int) -> int:
        if isinstance(level, int) and -len(self._matrices) <= level < len(self._matrices):
            return level
        if level not in self._numbers:
            known = ", ".join(repr(level.name) for level in self._first.levels) or "none"
            raise InputError(f"there is no level {level!r}; there are: {known}.")
        return self._numbers[str(level)]

    def _arrays(self) -> list[Array]:
        own = [self.lower, self.upper, self.reference, self.row_matrix, self.row_upper]
        return [*self._matrices, *self._targets, *self._weights, *own, self.equality_matrix, self.equality_target]

    def _is_sound(self) -> bool:
        """Whether all is as the checks of `IKProblem` would have it, seen from a few sums; if in doubt, it is not."""
        arrays: list[Any] = self._arrays()
        if [getattr(array, "shape", None) for array in arrays] != self._shapes:
            return False
        finite = [
            *self._matrices,
            *self._weights,
            self.reference,
            self.row_matrix,
            self.equality_matrix,
            self.equality_target,
        ]
        finite += [b for b, level in zip(self._targets, self._first.levels, strict=True) if not level.is_soft]
        sides = [b for b, level in zip(self._targets, self._first.levels, strict=True) if level.is_soft]
        return (
            all([array.dtype == np.float64 for array in arrays])
            and all([np.vdot(array, array) <= LARGEST**2 for array in finite])  # so is every number; none is NaN
            and all([(weights >= 0.0).all() for weights in self._weights])
            and all([(side >= -LARGEST).all() for side in (*sides, self.row_upper)])
            and bool((self.lower <= self.upper).all())
            and bool((self.lower < np.inf).all() and (self.upper > -np.inf).all())
            and all([lengths(rows).all() for rows in (self.row_matrix, self.equality_matrix) if len(rows)])
        )

    def _complain(self) -> None:
        """Check everything as `IKProblem` does, which says what is wrong; what it accepts is right after all."""
        shapes = [np.shape(array) for array in self._arrays()]
        if shapes != self._shapes:
            place = next(i for i, (have, want) in enumerate(zip(shapes, self._shapes, strict=True)) if have != want)
            raise InputError(
                f"an array of the live problem has shape {shapes[place]}; expected {self._shapes[place]}: write into the "
                "arrays ([:] =), and make a new LiveProblem for a new shape."
            )
        first = self._first
        levels = [
            Level(matrix, target, weights, level.name, level.kind, level.damping, level.below)
            for level, matrix, target, weights in zip(
                first.levels, self._matrices, self._targets, self._weights, strict=True
            )
        ]
        IKProblem(
            levels,
            Bounds(self.lower, self.upper, first.bounds.names),
            Rows(self.row_matrix, self.row_upper, first.rows.names),
            self.reference,
            Equalities(self.equality_matrix, self.equality_target, first.equalities.names),
            metric=first.metric,
            noise=first.noise,
        )
