"""A problem that lives: its numbers change from step to step, its shape and names do not.

An `IKProblem` is frozen and checked; a control loop that makes one a step has its names and shapes worked out anew each
time. A `LiveProblem` is made of one problem, keeps what does not change, and lets the rest be written in place:

    live = LiveProblem(problem)
    while True:
        live.matrix("hands")[:] = jacobian
        live.target("hands")[:] = wanted
        live.lower[:], live.upper[:] = bounds
        step = solve(live.frozen(), solver)

Matrices are C-contiguous, so that MuJoCo can write its Jacobians into them. A row that is to be left out for a while gets
an infinite side.
"""

from prioritized_ik.errors import InputError
from prioritized_ik.packed import Layout
from prioritized_ik.problem import Bounds, Equalities, IKProblem, Level, Rows
from prioritized_ik.solvers.compiled import fast
from prioritized_ik.validation import Array


class LiveProblem:
    """Arrays to be written in place, and the problem that they stand for.

    Args:
        problem: with the shapes, names, kinds of levels, damping, metric and noise to keep, and the first numbers.

    Raises:
        InputError: something else.
    """

    def __init__(self, problem: IKProblem) -> None:
        if not isinstance(problem, IKProblem):
            raise InputError(f"problem is of type {type(problem).__name__}; expected an IKProblem with the shapes to keep.")
        self._layout = Layout(problem)
        self._numbers = self._layout.packed()
        self._parts = self._layout.parts(self._numbers)
        self._places = {level.name: number for number, level in reversed(list(enumerate(problem.levels)))}

    @property
    def lower(self) -> Array:
        """Lower bounds on dθ `(m,)` [rad], to be written in place, as all that follows."""
        return self._parts.lower

    @property
    def upper(self) -> Array:
        """Upper bounds on dθ `(m,)` [rad]."""
        return self._parts.upper

    @property
    def reference(self) -> Array:
        """Reference r `(m,)` [rad]."""
        return self._parts.reference

    @property
    def row_matrix(self) -> Array:
        """Matrix of the hard inequality rows `(r, m)`."""
        return self._parts.row_matrix

    @property
    def row_upper(self) -> Array:
        """Sides of the hard inequality rows `(r,)`."""
        return self._parts.row_upper

    @property
    def equality_matrix(self) -> Array:
        """Matrix of the hard equalities `(e, m)`."""
        return self._parts.equality_matrix

    @property
    def equality_target(self) -> Array:
        """Target of the hard equalities `(e,)`."""
        return self._parts.equality_target

    def matrix(self, level: str | int | None = None) -> Array:
        """Return A `(k, m)` of a level, by its name or number; of all levels one after the other if none is given."""
        return self._parts.matrix[self._rows(level)]

    def target(self, level: str | int | None = None) -> Array:
        """Return b `(k,)` of a level, as `matrix`."""
        return self._parts.target[self._rows(level)]

    def weights(self, level: str | int | None = None) -> Array:
        """Return the diagonal of W `(k,)` of a level, as `matrix`."""
        return self._parts.weights[self._rows(level)]

    def frozen(self) -> IKProblem:
        """Return the problem as it is now; it does not change with the arrays.

        Raises:
            InputError: a number that no problem may hold, as `IKProblem` would say.
        """
        frozen = self._layout.problem(self._numbers)
        if not fast.is_sound(frozen):
            _check(frozen)
        return frozen

    def _rows(self, level: str | int | None) -> slice:
        levels = self._layout.levels
        if level is None:
            return slice(None)
        if isinstance(level, int) and -len(levels) <= level < len(levels):
            return levels[level]
        if level not in self._places:
            known = ", ".join(repr(level.name) for level in self._layout.pattern.levels) or "none"
            raise InputError(f"there is no level {level!r}; there are: {known}.")
        return levels[self._places[str(level)]]


def _check(problem: IKProblem) -> None:
    """Check everything as `IKProblem` does, which says what is wrong."""
    bounds, rows, fixed = problem.bounds, problem.rows, problem.equalities
    IKProblem(
        [
            Level(level.matrix, level.target, level.weights, level.name, level.kind, level.damping, level.below)
            for level in problem.levels
        ],
        Bounds(bounds.lower, bounds.upper, bounds.names),
        Rows(rows.matrix, rows.upper, rows.names),
        problem.reference,
        Equalities(fixed.matrix, fixed.target, fixed.names),
        metric=problem.metric,
        noise=problem.noise,
    )
