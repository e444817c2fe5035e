"""A problem on a kinematic tree in its joint metric, as the rows that an elimination takes."""

from functools import cached_property

import numpy as np

from prioritized_ik.double_double import DoubleDouble
from prioritized_ik.kinematic_tree import BASE, PointRows
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.compiled.library import library
from prioritized_ik.solvers.compiled.tree import CompiledElimination
from prioritized_ik.solvers.tree.elimination import Elimination
from prioritized_ik.solvers.tree.factors import Factors, TreeRowsOnJoints
from prioritized_ik.solvers.tree.fine_rows import FineRows
from prioritized_ik.tolerances import NOISE, ROUNDING, TREE_ZERO
from prioritized_ik.tree_problem import TreeLevel, TreeRows, tree_of
from prioritized_ik.validation import Array, length

POWERS = 30  # of the power method

CLEAR_ROW = 1e-7  # [of the longest row]: lengths are roots of squares, right to half of the digits where they are short


def is_on_tree(problem: IKProblem) -> bool:
    """Whether the elimination takes problems of this kind: rows of points, a diagonal metric, no equality rows."""
    pattern = problem.pattern
    return (
        pattern.noise == NOISE
        and pattern.metric.ndim == 1
        and not len(pattern.equalities.target)
        and bool(pattern.levels)
        and tree_of(pattern) is not None
    )


def _factors(rows: TreeRowsOnJoints) -> Factors:
    return Elimination(rows) if library().core is None else CompiledElimination(rows)


class PosedOnTree:
    """A problem that `is_on_tree`, in its joint metric: u = √M dθ.

    Its rows are those of motions of points, the inequality rows first, then level by level; `k` counts all of them, `c` the
    inequality rows.

    Attributes:
        problem: as it was given.
        zero: see `TreeRowsOnJoints`.
        tree: of joints in the metric.
        lower, upper, reference: in the metric `(m,)`.
        rows: all rows' motions `(k,)`.
        level: of each row `(k,)`, 0 for inequality rows.
        targets: right-hand sides `(k,)`.
        parts: places of each level's rows, those of the inequality rows first.
    """

    def __init__(self, problem: IKProblem, zero: float = TREE_ZERO) -> None:
        self.zero = zero
        self._moved_by: Array | None = None
        self._motions = self._terms = np.zeros(0)
        self._finely_moved: tuple[Array | None, DoubleDouble] = None, DoubleDouble.of(np.zeros(0))
        tree = tree_of(problem)
        assert tree is not None
        root = problem.metric_root
        plain = bool((root == 1.0).all())
        self.problem, self.tree = problem, tree if plain else tree.scaled(1.0 / root)
        bounds = problem.bounds
        self.lower, self.upper = (bounds.lower, bounds.upper) if plain else (bounds.lower * root, bounds.upper * root)
        self.reference = problem.reference if plain else problem.reference * root
        levels = [level for level in problem.levels if isinstance(level, TreeLevel)]
        contacts = [problem.rows.points] if isinstance(problem.rows, TreeRows) else []
        parts = [*contacts, *(level.points for level in levels)]
        self.rows = PointRows.trusted(
            self.tree,
            np.concatenate([part.joints for part in parts]),
            np.concatenate([part.points for part in parts]),
            np.concatenate([part.directions for part in parts]),
        )
        counts = [len(problem.rows.upper), *(len(level.target) for level in levels)]
        self.level = np.repeat(np.arange(len(counts)), counts)
        self.targets = np.concatenate([problem.rows.upper, *(level.target for level in levels)])
        self._weights = np.concatenate([np.ones(counts[0]), *(level.weights for level in levels)])
        self.parts = [slice(end - count, end) for end, count in zip(np.cumsum(counts), counts, strict=True)]

    @cached_property
    def factors(self) -> Factors:
        """What factors faces: the compiled core, where there is one."""
        return _factors(self.on_joints)

    @cached_property
    def factors_alike(self) -> Factors:
        """The same of rows of unit length; rows that say nothing weigh nothing."""
        real = (self.roots > 0.0) & (self.lengths > ROUNDING * self.lengths.max(initial=0.0))
        roots = np.where(real, 1.0 / np.where(real, self.lengths, 1.0), 0.0)
        return _factors(TreeRowsOnJoints(self.rows, len(self.parts) - 1, self.level, roots, self.zero))

    @cached_property
    def lengths(self) -> Array:
        """Length of each row of the matrix `(k,)`."""
        return self.factors.row_lengths()

    @cached_property
    def roots(self) -> Array:
        """√w of each row `(k,)`, one for inequality rows; zero for those that count for nothing."""
        return np.where(self.rows.joints == BASE, 0.0, np.sqrt(self._weights))

    @cached_property
    def on_joints(self) -> TreeRowsOnJoints:
        """The rows for the elimination."""
        return TreeRowsOnJoints(self.rows, len(self.parts) - 1, self.level, self.roots, self.zero)

    @cached_property
    def sides(self) -> Array:
        """Right-hand sides, weighted `(k,)`; of inequality rows that are none, zero."""
        return np.where(np.isfinite(self.targets), self.targets, 0.0) * self.roots

    def motions(self, u: Array) -> Array:
        """Return how far `u` `(m,)`, which does not change, moves each row `(k,)`; that of the last one is kept."""
        self._move(u)
        return self._motions

    def sizes_of_terms(self, u: Array) -> Array:
        """Return how large the terms are whose sum `motions` is `(k,)`, for their rounding."""
        self._move(u)
        return self._terms

    def _move(self, u: Array) -> None:
        if u is not self._moved_by:
            self._moved_by, (self._motions, self._terms) = u, self.factors.motions(u)

    def slack(self, u: Array) -> Array:
        """Return how far `u` `(m,)` is from each inequality row `(c,)`, as a distance."""
        part = self.parts[0]
        if part.stop == part.start:
            return np.zeros(0)
        return (self.targets[part] - self.motions(u)[part]) / self.lengths[part]

    @property
    def has_clear_rows(self) -> bool:
        """Whether no inequality row is so short beside the others that it may be rounding."""
        lengths = self.lengths[self.parts[0]]
        return bool(lengths.min(initial=np.inf) > CLEAR_ROW * self.lengths.max(initial=0.0))

    def missing(self, u: Array) -> Array:
        """Return what each row lacks at `u`, weighted `(k,)`."""
        return self.sides - self.roots * self.motions(u)

    def fine_gradient(self, number: int, u: Array, pulls: Array) -> Array:
        """Return the gradient of a level's cost, or of the last level's, and what `pulls` `(k,)` of rows add to it, `(m,)`.

        At `u` `(m,)`, worked out with twice the digits of doubles and rounded.
        """
        values = DoubleDouble.of(pulls).times(self.roots)
        if number == len(self.parts):
            own = DoubleDouble.of(u) - DoubleDouble.of(self.reference)
            return (own + self.fine_rows.transposed_times(values)).rounded
        own_rows = self.level == number
        if self._finely_moved[0] is not u:
            self._finely_moved = u, self.fine_rows.times(u)
        missing = DoubleDouble.of(np.where(own_rows, self.targets, 0.0)) - self._finely_moved[1].where(own_rows)
        weights = np.where(self.roots > 0.0, self._weights, 0.0)
        return self.fine_rows.transposed_times(values - missing.times(weights)).rounded

    @cached_property
    def fine_rows(self) -> FineRows:
        """All rows' motions, with twice the digits."""
        return FineRows(self.rows)

    def demand(self, number: int) -> float:
        """Return the length of what a level asks for; levels are numbered from 1."""
        return length(self.sides[self.parts[number]])

    def norm_of_matrix(self, number: int) -> float:
        """Return the largest singular value of a level's matrix, without weights, from below, by the power method."""
        rows = self.rows[self.parts[number]]
        u, largest = rows.transposed_times(self.lengths[self.parts[number]]), 0.0
        for _ in range(POWERS):
            size = length(u)
            if size == 0.0:
                return 0.0
            moved = rows.times(u / size)
            largest = length(moved)
            u = rows.transposed_times(moved)
        return largest

    def strength(self, number: int) -> float:
        """Return ‖W^½ A‖ of a level."""
        part = self.parts[number]
        return length(self.roots[part] * self.lengths[part])
