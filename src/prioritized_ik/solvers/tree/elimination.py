"""The strict levels of a kinematic tree, solved joint by joint from the tips to the base: the form to read.

Let s be the twist of what a joint carries: ω, and the velocity at the joint's anchor. A joint adds its axis g,

    s = X s_before + g u,

X moving the velocity from the anchor before, and every row on a point is a row on one such s. So dynamic programming runs
from the tips to the base, and by Bellman's principle the motions that are optimal at the levels so far are, given s_before,
the product over joints of what is optimal for each. Per level a joint has rows C s = c, what is left of the rows beyond it:

- the first level at which C g is not zero decides the joint: a reflector turns C s = c into one row ρ u + p·s_before = q,
  which fixes u, and rows without u, which are handed on to the joint before;
- at the levels after that u = (q - p·s_before) / ρ is put in place of u;
- the last level, ‖u - r‖, is a row u = r of each joint and decides whatever is left.

Rows that are held (active inequality rows) are a level above all others that must leave nothing; active bounds fix u. More
than six rows on six numbers are turned into six. The rest is substitution: from tips to base with the right-hand sides,
from base to tips for the joints, and the same with everything transposed for multipliers. Transformations are orthogonal
within a level. All of it takes as long as there are joints and rows. `compiled/tree.hpp` is the form that is fast.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.kinematic_tree import BASE, KinematicTree, Numbers
from prioritized_ik.tolerances import TREE_CLEAR, TREE_ZERO
from prioritized_ik.validation import Array

TWIST = 6
NEAR = 1e-10  # [of its terms] a pivot of the inertia this small may have either sign
HELD = 0  # the level of rows that are held; the problem's are numbered from 1, and the last level comes after them


@dataclass(frozen=True, eq=False)
class TreeRowsOnJoints:
    """All rows of a problem on a tree, in the problem's joint metric, in the order of their joints.

    Attributes:
        tree: of joints in the metric.
        levels: number of the problem's levels.
        joints: the last joint that moves each row's point `(k,)`; none stands still.
        level: of each `(k,)`, `HELD` or from 1 on.
        covectors: each row on its joint's twist, moment about the anchor before force, weighted `(k, 6)`.
        given: the same without weights `(k, 6)`.
    """

    tree: KinematicTree
    levels: int
    joints: Numbers
    level: Numbers
    covectors: Array
    given: Array

    @property
    def last(self) -> int:
        """Number of the last level."""
        return self.levels + 1

    @cached_property
    def axes(self) -> Array:
        """The twist of a unit step of each joint `(m, 6)`, ω before v."""
        return np.concatenate([self.tree.angular, self.tree.linear], axis=1)

    @cached_property
    def arms(self) -> Array:
        """From the anchor of the joint before to each joint's `(m, 3)`, zero for the first ones."""
        parents, anchors = self.tree.parents, self.tree.anchors
        return np.where(parents[:, None] == BASE, 0.0, anchors - anchors[parents])


class Ending(IntEnum):
    """How a factorisation ended."""

    CLEAR = 0
    RANK = 1  # what a level feels of a joint is neither clearly zero nor clearly not


@dataclass
class Step:
    """What was done to one level's rows at one joint.

    Attributes:
        children: number of rows from each joint carried by it, in their order.
        own: numbers of its own rows.
        seen: C g, or the reflector that turned it into one row.
        factor: τ of the reflector, else 0.
        squeezed: reflectors (column by column) that left at most six rows, with τ.
        left: number of rows handed on.
    """

    children: list[tuple[int, int]]
    own: Numbers
    seen: Array
    factor: float = 0.0
    squeezed: list[tuple[Array, float]] = field(default_factory=list)
    left: int = 0


class Factors(ABC):
    """One face's factorisation at a time, and what it solves.

    Attributes:
        rows: of the problem.
        fixed: which joints are fixed `(m,)`.
        owner: the level that decides each joint `(m,)`, -1 for fixed ones.
        pivot: ρ `(m,)`.
    """

    rows: TreeRowsOnJoints
    fixed: NDArray[np.bool_]
    owner: NDArray[np.signedinteger]
    pivot: Array

    @abstractmethod
    def factor(self, fixed: NDArray[np.bool_], held: NDArray[np.bool_]) -> Ending:
        """Factor a face; say whether every level's rank is clear.

        Args:
            fixed: which joints are fixed `(m,)`.
            held: which of the rows of level `HELD` are held `(k,)`; of no meaning for the others.
        """

    @abstractmethod
    def solve(self, values: Array, sides: Array, reference: Array) -> tuple[Array, float]:
        """Return the strict optimum u `(m,)`, and what the held rows leave, which must be zero.

        Args:
            values: of the fixed joints `(m,)`.
            sides: right-hand sides of the rows, weighted `(k,)`.
            reference: r `(m,)`.
        """

    @abstractmethod
    def reduced(self, level: int, gradient: Array) -> Array:
        """Return what a gradient `(m,)` at a level leaves by joints, given those that follow it `(m,)`.

        Of a joint that a level above decides, the multiplier of its row ρ u + p·s = q, its sign turned; of one that this
        level decides, R⁻ᵀ of the gradient, whose squares are how much lower the level's cost could be; of others, and of
        fixed ones, the gradient along them.
        """

    @abstractmethod
    def multipliers(self, level: int, reduced: Array) -> Array:
        """Return the multipliers of all rows of the levels above `level` `(k,)`, from its `reduced` gradient `(m,)`.

        With them the gradient is balanced along joints that levels above decide: g + Σ rows of these, weighted, times
        multipliers.
        """

    @abstractmethod
    def row_lengths(self) -> Array:
        """Return the length of each row of the matrix, without weights `(k,)`: of all joints that move its point."""

    @abstractmethod
    def count_below(self, level: int, tau: float) -> int | None:
        """Return how many singular values of a level's matrix, without weights, are below `tau`; None if that is not clear.

        In the directions that the levels above leave, zeros included: Sylvester's inertia of AᵀA - τ² 1, by one more
        elimination. Local pivots cannot see a weak direction that is spread over many joints; this does.
        """

    @abstractmethod
    def displacement(self, level: int, whitened: Array) -> Array:
        """Return the move `(m,)` that has the `whitened` `(m,)` value R u along joints that `level` decides.

        Levels above stay where they are, joints that no level so far decides do not move.
        """


class Elimination(Factors):
    """See `Factors`, and the module.

    Attributes:
        before: p `(m, 6)`.
    """

    def __init__(self, rows: TreeRowsOnJoints) -> None:
        self.rows, self.axes, self.arms = rows, rows.axes, rows.arms

    def factor(self, fixed: NDArray[np.bool_], held: NDArray[np.bool_]) -> Ending:
        """See `Factors.factor`."""
        rows, tree, m = self.rows, self.rows.tree, self.rows.tree.joint_count
        self.fixed, self.ending = fixed, Ending.CLEAR
        self.owner = np.full(m, -1)
        self.pivot, self.before = np.ones(m), np.zeros((m, TWIST))
        self.steps: list[list[Step]] = [[] for _ in range(m)]
        counts = (rows.level != HELD) | held
        own: list[list[int]] = [[] for _ in range(m)]
        for number in np.flatnonzero(counts).tolist():
            own[rows.joints[number]].append(number)
        left: list[list[tuple[int, list[Array], list[float]]]] = [[] for _ in range(m)]  # from the joints carried by each
        for j in reversed(range(m)):
            handed, sizes = self._joint(j, own[j], left[j])
            left[j] = []
            if tree.parents[j] != BASE:
                left[tree.parents[j]].append((j, [_moved_rows(c, self.arms[j]) for c in handed], sizes))
        return self.ending

    def _joint(
        self, j: int, own: list[int], carried: list[tuple[int, list[Array], list[float]]]
    ) -> tuple[list[Array], list[float]]:
        """Return what joint `j` hands on, by level, and the largest row met so far."""
        rows, axis = self.rows, self.axes[j]
        numbers, handed, sizes = np.array(own, dtype=int), [], []
        for level in range(rows.last + 1):
            mine = numbers[rows.level[numbers] == level]
            c = np.concatenate([*(given[level] for _, given, _ in carried), rows.covectors[mine]])
            size = max([float(np.linalg.norm(c)), *(known[level] for _, _, known in carried)])
            step = Step([(child, len(given[level])) for child, given, _ in carried], mine, c @ axis)
            if level == rows.last and not self.fixed[j]:
                c = self._last(j, step, c)
            elif not self.fixed[j] and self.owner[j] >= 0:
                c = c - np.outer(step.seen / self.pivot[j], self.before[j])
            elif not self.fixed[j] and self._is_felt(step.seen, size * float(np.linalg.norm(axis))):
                c = self._decide(j, level, step, c)
            size = max(size, float(np.linalg.norm(c)))
            c = _squeezed(step, c, TREE_ZERO * size)
            step.left = len(c)
            self.steps[j].append(step)
            handed.append(c)
            sizes.append(size)
        return handed, sizes

    def _is_felt(self, seen: Array, size: float) -> bool:
        felt = float(np.linalg.norm(seen))
        if TREE_ZERO * size < felt <= TREE_CLEAR * size:
            self.ending = Ending.RANK
        return felt > TREE_CLEAR * size

    def _decide(self, j: int, level: int, step: Step, c: Array) -> Array:
        """Let `level` decide joint `j`: ρ u + p·s = q, and rows without u."""
        step.seen, step.factor, self.pivot[j] = reflector(step.seen)
        c = c - np.outer(step.factor * step.seen, step.seen @ c)
        self.owner[j], self.before[j] = level, c[0]
        return c[1:]

    def _last(self, j: int, step: Step, c: Array) -> Array:
        """The last level's row of joint `j`, u = r, comes after those of the joints beyond."""
        if self.owner[j] >= 0:
            c = c - np.outer(step.seen / self.pivot[j], self.before[j])
            return np.concatenate([c, -self.before[j : j + 1] / self.pivot[j]])
        step.seen = np.append(step.seen, 1.0)
        return self._decide(j, self.rows.last, step, np.concatenate([c, np.zeros((1, TWIST))]))

    def solve(self, values: Array, sides: Array, reference: Array) -> tuple[Array, float]:
        """See `Factors.solve`."""
        rows, parents = self.rows, self.rows.tree.parents
        m = len(parents)
        left: list[list[Array]] = [[] for _ in range(m)]
        q, missed = np.zeros(m), 0.0
        for j in reversed(range(m)):
            for level, step in enumerate(self.steps[j]):
                y = np.concatenate([*(left[child][level] for child, _ in step.children), sides[step.own]])
                if self.fixed[j]:
                    y = y - step.seen * values[j]
                elif self.owner[j] == level:
                    if level == rows.last:
                        y = np.append(y, reference[j])
                    y = y - step.factor * step.seen * (step.seen @ y)
                    q[j], y = y[0], y[1:]
                elif 0 <= self.owner[j] < level:
                    y = y - step.seen * (q[j] / self.pivot[j])
                    if level == rows.last:
                        y = np.append(y, reference[j] - q[j] / self.pivot[j])
                for v, factor in step.squeezed:
                    y = y - factor * v * (v @ y)
                left[j].append(y[: step.left])
            if parents[j] == BASE:
                missed = max(missed, float(np.abs(left[j][HELD]).max(initial=0.0)))
        u, s = values.copy(), np.zeros((m, TWIST))
        for j in range(m):
            before = _moved_twist(s[parents[j]], self.arms[j]) if parents[j] != BASE else np.zeros(TWIST)
            if not self.fixed[j]:
                u[j] = (q[j] - self.before[j] @ before) / self.pivot[j]
            s[j] = before + self.axes[j] * u[j]
        return u, missed

    def reduced(self, level: int, gradient: Array) -> Array:
        """See `Factors.reduced`."""
        parents, m = self.rows.tree.parents, len(gradient)
        carried, out = np.zeros((m, TWIST)), np.zeros(m)
        for j in reversed(range(m)):
            out[j] = gradient[j] + carried[j] @ self.axes[j]
            if not self.fixed[j] and self.owner[j] <= level:
                out[j] /= self.pivot[j]
                carried[j] -= out[j] * self.before[j]
            if parents[j] != BASE:
                carried[parents[j]] += _moved_wrench(carried[j], self.arms[j])
        return out

    def multipliers(self, level: int, reduced: Array) -> Array:
        """See `Factors.multipliers`."""
        m, out = len(reduced), np.zeros(len(self.rows.joints))
        pulls = np.where(~self.fixed & (self.owner < level), -reduced, 0.0)
        given: list[list[Array]] = [[np.zeros(step.left) for step in self.steps[j]] for j in range(m)]
        for j in range(m):
            for number in reversed(range(level)):
                step = self.steps[j][number]
                extra = len(step.seen) - (self.owner[j] == number and not self.fixed[j])
                z = np.zeros(max(extra, step.left))
                z[: step.left] = given[j][number]
                for v, factor in reversed(step.squeezed):
                    z = z - factor * v * (v @ z)
                if not self.fixed[j] and self.owner[j] == number:
                    z = np.concatenate([[pulls[j]], z])
                    z = z - step.factor * step.seen * (step.seen @ z)
                elif not self.fixed[j] and 0 <= self.owner[j] < number:
                    pulls[j] -= (step.seen @ z) / self.pivot[j]
                at = 0
                for child, count in step.children:
                    given[child][number] = z[at : at + count]
                    at += count
                out[step.own] = z[at:]
        return out

    def row_lengths(self) -> Array:
        """See `Factors.row_lengths`."""
        parents, m = self.rows.tree.parents, self.rows.tree.joint_count
        grams = np.zeros((m, TWIST, TWIST))  # of what a joint and those before it make of its twist
        for j in range(m):
            if parents[j] != BASE:
                moved = np.array([_moved_twist(column, self.arms[j]) for column in grams[parents[j]].T]).T
                grams[j] = [_moved_twist(row, self.arms[j]) for row in moved]
            grams[j] += np.outer(self.axes[j], self.axes[j])
        given = self.rows.given
        return np.sqrt(np.maximum(np.einsum("ri,rij,rj->r", given, grams[self.rows.joints], given), 0.0))

    def count_below(self, level: int, tau: float) -> int | None:
        """See `Factors.count_below`."""
        parents, m, count = self.rows.tree.parents, len(self.pivot), 0
        inertia = np.zeros((m, TWIST, TWIST))  # s S s is what is least of ‖A u‖² - τ² ‖u‖² over the joints beyond
        for j in reversed(range(m)):
            given, axis, s = self.rows.given[self.steps[j][level].own], self.axes[j], inertia[j]
            s = s + given.T @ given
            along = axis @ s @ axis
            if not self.fixed[j] and self.owner[j] < level:
                before = self.before[j] / self.pivot[j]
                follows = np.eye(TWIST) - np.outer(axis, before)
                s = follows.T @ s @ follows - tau**2 * np.outer(before, before)
            elif not self.fixed[j]:
                pivot = along - tau**2
                if abs(pivot) <= NEAR * (abs(along) + tau**2):
                    return None
                count += pivot < 0.0
                s = s - np.outer(s @ axis, s @ axis) / pivot
            if parents[j] != BASE:
                inertia[parents[j]] += _moved_rows(_moved_rows(s, self.arms[j]).T, self.arms[j])
        return int(count)

    def displacement(self, level: int, whitened: Array) -> Array:
        """See `Factors.displacement`."""
        parents, m = self.rows.tree.parents, len(whitened)
        u, s = np.zeros(m), np.zeros((m, TWIST))
        for j in range(m):
            before = _moved_twist(s[parents[j]], self.arms[j]) if parents[j] != BASE else np.zeros(TWIST)
            if not self.fixed[j] and self.owner[j] <= level:
                wanted = whitened[j] if self.owner[j] == level else 0.0
                u[j] = (wanted - self.before[j] @ before) / self.pivot[j]
            s[j] = before + self.axes[j] * u[j]
        return u


def reflector(x: Array) -> tuple[Array, float, float]:
    """Return v, τ and β with (I - τ v vᵀ) x = β e₁."""
    beta = -float(np.copysign(np.linalg.norm(x), x[0]))
    v = x / (x[0] - beta)
    v[0] = 1.0
    return v, float((beta - x[0]) / beta), beta


def _squeezed(step: Step, c: Array, zero: float) -> Array:
    """Return at most six rows that say what `c` says; those up to `zero` in length say nothing."""
    if len(c) <= TWIST:
        return c
    columns, done = list(range(TWIST)), 0
    while columns and done < len(c):
        sizes = np.linalg.norm(c[done:, columns], axis=0)
        best = int(sizes.argmax())
        if sizes[best] <= zero:
            break
        column = columns.pop(best)
        v = np.zeros(len(c))
        v[done:], factor, _ = reflector(c[done:, column])
        c = c - np.outer(factor * v, v @ c)
        c[done + 1 :, column] = 0.0
        step.squeezed.append((v, factor))
        done += 1
    return c[:done]


def _moved_rows(rows: Array, arm: Array) -> Array:
    """Return rows on a joint's twist as rows on that of the joint before, whose anchor is an `arm` back."""
    moved = rows.copy()
    moved[:, :3] += np.cross(arm, rows[:, 3:])
    return moved


def _moved_wrench(wrench: Array, arm: Array) -> Array:
    return _moved_rows(wrench[None], arm)[0]


def _moved_twist(twist: Array, arm: Array) -> Array:
    """Return a joint's twist at an anchor an `arm` away."""
    moved = twist.copy()
    moved[3:] += np.cross(twist[:3], arm)
    return moved
