"""What a factorisation of a face on a kinematic tree is asked for, whoever makes it."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.kinematic_tree import BASE, KinematicTree, Numbers, PointRows, crossed, length_of
from prioritized_ik.tolerances import TREE_ZERO
from prioritized_ik.validation import Array

HELD = 0  # the level of rows that are held; the problem's are numbered from 1, and the last level comes after them


@dataclass(frozen=True, eq=False)
class TreeRowsOnJoints:
    """All rows of a problem on a tree, in the problem's joint metric.

    Attributes:
        points: the rows as motions of points `(k,)`, of a tree in the metric.
        levels: number of the problem's levels.
        level: of each row `(k,)`, `HELD` or from 1 on.
        roots: √w of each `(k,)`, zero of those that count for nothing.
        zero: what a row of unit length moves of what those before it leave, up to this, counts as zero.
    """

    points: PointRows
    levels: int
    level: Numbers
    roots: Array
    zero: float = TREE_ZERO

    @property
    def last(self) -> int:
        """Number of the last level."""
        return self.levels + 1

    @cached_property
    def unit(self) -> float:
        """How far points are from the anchors before them, as a rule [m]: in this unit turns and motions count alike."""
        points = self.points
        moved = points.joints != BASE
        away = length_of((points.points - points.tree.anchors[points.joints])[moved])
        away = away[away > 0.0]
        return float(np.median(away)) if len(away) else 1.0

    @cached_property
    def tree(self) -> KinematicTree:
        """The joints in that unit of length."""
        tree, unit = self.points.tree, self.unit
        return tree.moved_to(tree.angular, tree.linear / unit, tree.anchors / unit)

    @cached_property
    def joints(self) -> Numbers:
        """The last joint that moves each row's point `(k,)`, a number even where none does."""
        return np.maximum(self.points.joints, 0)

    @cached_property
    def given(self) -> Array:
        """Each row on its joint's twist in that unit, moment about its anchor before force, without weights `(k, 6)`."""
        points = self.points
        levers = (points.points - points.tree.anchors[points.joints]) / self.unit
        covectors = np.concatenate([crossed(levers, points.directions), points.directions], axis=1)
        return covectors * np.where(points.joints == BASE, 0.0, self.unit)[:, None]

    @cached_property
    def carrying(self) -> NDArray[np.bool_]:
        """Which joints carry a row `(m,)`."""
        mask = np.zeros(self.tree.joint_count, dtype=bool)
        mask[self.joints] = True
        return mask


class Ending(IntEnum):
    """How a factorisation ended."""

    CLEAR = 0
    RANK = 1  # what a level feels of some direction is neither clearly zero nor clearly not


@dataclass(frozen=True, eq=False)
class Balance:
    """How far rows of the levels above, and what is fixed, balance a level's gradient at a step.

    Attributes:
        rest: what the rows leave of the gradient `(m,)`; along fixed joints, what holds these.
        pulls: multipliers of the rows of the levels above `(k,)`.
        off: how far the step is off what this level and those before it would have `(m,)`, as their gradients show.
        of_bounds: how uncertain the rest is along each joint `(m,)`.
        lower: R⁻ᵀ of the rest, squared: how much lower the level's cost could be.
        moved: length of the step that would lower it.
        astray: length of the rest along what the level does not decide; all of it is rounding, or a multiplier gone wrong.
        noise: how long a gradient rounding can feign.
        feigned: how long a step that can feign.
        of_rows: how uncertain multipliers of held rows are.
    """

    rest: Array
    pulls: Array
    off: Array
    of_bounds: Array
    lower: float
    moved: float
    astray: float
    noise: float
    feigned: float
    of_rows: float


class Factors(ABC):
    """One face's factorisation at a time, and what it solves.

    Coordinates are those of a level's own directions `(p,)`, or of those that all levels leave `(f,)`; both orthonormal.

    Attributes:
        rows: of the problem.
        fixed: which joints are fixed `(m,)`.
        ranks: p of each level, `HELD` first.
        strongest: largest pivot of each of these levels, zero of one without.
        weakest: smallest pivot of each, infinite of one without.
    """

    rows: TreeRowsOnJoints
    fixed: NDArray[np.bool_]
    ranks: list[int]
    strongest: list[float]
    weakest: list[float]

    @abstractmethod
    def factor(self, fixed: NDArray[np.bool_], held: NDArray[np.bool_]) -> Ending:
        """Factor a face; say whether every level's rank is clear.

        Args:
            fixed: which joints are fixed `(m,)`.
            held: which of the rows of level `HELD` are held `(k,)`; of no meaning for the others.
        """

    @abstractmethod
    def solve(self, values: Array, sides: Array, reference: Array) -> Array:
        """Return the strict optimum u `(m,)`; held rows that contradict each other are met in the sense of least squares.

        Args:
            values: of the fixed joints `(m,)`.
            sides: right-hand sides of the rows, weighted `(k,)`.
            reference: r `(m,)`.
        """

    @abstractmethod
    def motions(self, u: Array) -> tuple[Array, Array]:
        """Return how far a step moves each row, and how large the terms are whose sum that is `(k,)`.

        Of the points as they are given, and not of what was factored.
        """

    @abstractmethod
    def damp(self, row_weights: Array, joint_weights: Array) -> None:
        """Factor min ‖w (J u) - b‖² + ‖d u - r‖² of weights w `(k,)` and d `(m,)`, beside the face; see `damped.py`."""

    @abstractmethod
    def damped(self, row_sides: Array, joint_sides: Array) -> Array:
        """Return the optimum u `(m,)` of what was damped last, for the right-hand sides b `(k,)` and r `(m,)`."""

    @abstractmethod
    def parts(self, gradient: Array) -> list[Array]:
        """Return a gradient `(m,)` in the coordinates of each level, `HELD` first, and of what all leave."""

    @abstractmethod
    def whitened(self, level: int, part: Array) -> Array:
        """Return R⁻ᵀ of a level's part of a gradient `(p,)`: its squares are how much lower the level's cost could be."""

    @abstractmethod
    def pulls(self, level: int, whitened: Array) -> Array:
        """Return the values of all rows `(k,)`, zero but for the level's own, whose weighted sum is a `whitened` part."""

    @abstractmethod
    def displacement(self, level: int, whitened: Array) -> Array:
        """Return the move `(m,)` along the level's directions whose R u is `whitened` `(p,)`."""

    @abstractmethod
    def left_by(self, level: int, step: Array) -> Array:
        """Return what of a step `(m,)` is in the directions that levels up to this one leave, without fixed joints."""

    @abstractmethod
    def balance(self, level: int, given: Array, sizes: Array, rounded: float, off: Array, *, is_held: bool) -> Balance:
        """Return how far a level's gradient is balanced, see `balance.balance`."""

    @abstractmethod
    def row_lengths(self) -> Array:
        """Return the length of each row of the matrix, without weights `(k,)`: of all joints that move its point."""

    @abstractmethod
    def count_below(self, level: int, tau: float) -> int | None:
        """Return how many singular values of a level's matrix, without weights, are below `tau`; None if that is not clear.

        In the directions that the levels above leave, zeros included: Sylvester's inertia of AᵀA - τ² 1, by one more
        elimination, against the flow of the level's frame.
        """
