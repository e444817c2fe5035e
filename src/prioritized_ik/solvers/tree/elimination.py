"""The strict levels of a kinematic tree, stage by stage from the base to the tips and back: the form to read.

Level by level, the most important first, `frames.part` finds orthonormal coordinates of what the level decides of the
directions that those above leave, and of what it leaves; `triangle.Triangle` has the level's rows in the former. Rows that
are held (active inequality rows) are a level above all others that must leave nothing; active bounds fix joints, which are
then no inputs. The last level, ‖u - r‖, needs no factorisation: its coordinates are orthonormal. All of it takes as long as
there are joints and rows, and every transformation is orthogonal, so that a face is solved to the rounding of its levels,
however long the chain. `compiled/tree.hpp` is the form that is fast.
"""

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.kinematic_tree import BASE
from prioritized_ik.solvers.tree.balance import balance
from prioritized_ik.solvers.tree.damped import Damped
from prioritized_ik.solvers.tree.factors import HELD, Balance, Ending, Factors, TreeRowsOnJoints
from prioritized_ik.solvers.tree.frames import END, Coordinates, FrameStep, Parted, joined, next_frame, part, split
from prioritized_ik.solvers.tree.stages import TWIST, Stage, stages_of, twist_moved
from prioritized_ik.solvers.tree.triangle import Triangle
from prioritized_ik.tolerances import NOISE, ROUNDING
from prioritized_ik.validation import Array, length

NEAR = 1e-10  # [of its terms] a pivot of the inertia this small may have either sign
SHORT = 1e-5  # [of its terms] a length this small, the root of a sum of squares that cancel, is worked out anew


class Elimination(Factors):
    """See `Factors`, and the module."""

    def __init__(self, rows: TreeRowsOnJoints) -> None:
        self.rows = rows
        self._stages = stages_of(rows.tree, rows.carrying)
        of_joints = {int(stage.joints[-1]): number for number, stage in enumerate(self._stages)}
        self._stage_of_rows = np.array([of_joints[int(j)] for j in rows.joints], dtype=int)
        self._spread, terms, self._lengths = self._measured()
        safe = np.where(self._lengths > 0.0, self._lengths, 1.0)
        self._unit = rows.given / safe[:, None]
        self._zeros = np.maximum(rows.zero, ROUNDING * terms / safe)
        self._real = (self._lengths > ROUNDING * self._lengths.max(initial=0.0)) & (rows.roots > 0.0)

    def factor(self, fixed: NDArray[np.bool_], held: NDArray[np.bool_]) -> Ending:
        """See `Factors.factor`."""
        self.fixed, rows = fixed, self.rows
        self._inputs = [stage.joints[~fixed[stage.joints]] for stage in self._stages] + [np.zeros(0, dtype=int)]
        self._frames: list[list[FrameStep]] = []
        self._turns: list[list[Parted]] = []
        self._parted: list[list[Parted]] = []
        self._triangles: list[Triangle | None] = []
        frame, outwards = self._first_frame(), True
        counts = self._real & ((rows.level != HELD) | held)
        for level in range(rows.levels + 1):
            numbers: dict[int, list[int]] = {}
            for row in np.flatnonzero(counts & (rows.level == level)).tolist():
                numbers.setdefault(int(self._stage_of_rows[row]), []).append(row)
            if not numbers:  # the next one has the same frame
                self._turns.append([])
                self._parted.append([])
                self._triangles.append(None)
                self._frames.append(frame)
                continue
            turn: list[Parted] = []
            if not outwards:
                turn = part(frame, {}, {})
                frame = next_frame(frame, turn)
            self._turns.append(turn)
            self._frames.append(frame)
            steps = part(
                frame,
                {stage: self._unit[some] for stage, some in numbers.items()},
                {stage: self._zeros[some] for stage, some in numbers.items()},
            )
            weighted = {stage: rows.given[some] * rows.roots[some, None] for stage, some in numbers.items()}
            self._parted.append(steps)
            self._triangles.append(Triangle(frame, steps, weighted, numbers))
            frame, outwards = next_frame(frame, steps), False
        self.ranks = [sum(step.decided for step in steps) for steps in self._parted]
        self.strongest = [triangle.strongest if triangle else 0.0 for triangle in self._triangles]
        self.weakest = [triangle.weakest if triangle else np.inf for triangle in self._triangles]
        clear = all(some.weakest > NOISE * some.strongest for some in self._triangles if some and some.strongest)
        return Ending.CLEAR if clear else Ending.RANK

    def solve(self, values: Array, sides: Array, reference: Array) -> Array:
        """See `Factors.solve`."""
        rows, u = self.rows, np.where(self.fixed, values, 0.0)
        for level, triangle in enumerate(self._triangles):
            if triangle is None:
                continue
            missing = sides - rows.roots * rows.points.times(u)
            u = u + self._joined(level, triangle.solve(triangle.from_sides(missing)))
        return u + self._joined(rows.levels, None, self._split(np.where(self.fixed, 0.0, reference - u))[1])

    def motions(self, u: Array) -> tuple[Array, Array]:
        """See `Factors.motions`."""
        return self.rows.points.times(u), self.rows.points.sizes_of_terms(u)

    def damp(self, row_weights: Array, joint_weights: Array) -> None:
        """See `Factors.damp`."""
        rows = self.rows.given * row_weights[:, None]
        self._damped = Damped(self._stages, self._stage_of_rows, rows, joint_weights)

    def damped(self, row_sides: Array, joint_sides: Array) -> Array:
        """See `Factors.damped`."""
        return self._damped.solve(row_sides, joint_sides)

    def parts(self, gradient: Array) -> list[Array]:
        """See `Factors.parts`."""
        decided, rest = self._split(gradient)
        return [_whole(some) for some in (*decided, rest)]

    def whitened(self, level: int, part: Array) -> Array:
        """See `Factors.whitened`."""
        triangle = self._triangles[level]
        return part if triangle is None else _whole(triangle.whitened(self._by_step(level, part)))

    def pulls(self, level: int, whitened: Array) -> Array:
        """See `Factors.pulls`."""
        out = np.zeros(len(self.rows.level))
        if (triangle := self._triangles[level]) is not None:
            triangle.pulls(self._by_step(level, whitened), out)
        return out

    def displacement(self, level: int, whitened: Array) -> Array:
        """See `Factors.displacement`."""
        triangle = self._triangles[level]
        if triangle is None:
            return np.zeros(len(self.fixed))
        return self._joined(level, triangle.solve(self._by_step(level, whitened)))

    def left_by(self, level: int, step: Array) -> Array:
        """See `Factors.left_by`."""
        left = [step[numbers] for numbers in self._inputs]
        for turn, steps in zip(self._turns[: level + 1], self._parted[: level + 1], strict=True):
            for parted in (turn, steps):
                if parted:
                    _, left = split(parted, left)
        return self._joined(level, None, left)

    def balance(self, level: int, given: Array, sizes: Array, rounded: float, off: Array, *, is_held: bool) -> Balance:
        """See `balance.balance`."""
        return balance(self, self.sizes_of_torques, level, given, sizes, rounded, off, is_held=is_held)

    def sizes_of_torques(self, values: Array) -> Array:
        """Return the sum of the sizes of all terms of the torques of rows, weighted, times `values` `(m,)`."""
        sizes, out = np.zeros((len(self._stages), TWIST)), np.zeros(len(self.fixed))
        np.add.at(sizes, self._stage_of_rows, np.abs((values * self.rows.roots)[:, None] * self.rows.given))
        for number, stage in reversed(list(enumerate(self._stages))):
            out[stage.joints] = np.abs(stage.axes) @ sizes[number]
            if stage.before != BASE:
                sizes[stage.before] += np.abs(twist_moved(stage.arm).T) @ sizes[number]
        return out

    def row_lengths(self) -> Array:
        """See `Factors.row_lengths`."""
        return self._lengths

    def count_below(self, level: int, tau: float) -> int | None:
        """See `Factors.count_below`."""
        frame, rows, count = self._frames[level], self.rows, 0
        s = np.zeros((0, 0))  # x S x is what is least of ‖A u‖² - τ² ‖u‖² over the steps yet to come
        for step in reversed(frame):
            own = rows.given[(rows.level == level) & self._real & (self._stage_of_rows == step.stage)] @ step.twist
            s = s + own.T @ own
            both = np.hstack([step.inputs, step.flow])
            s, i = both.T @ s @ both, step.inputs.shape[1]
            s[:i, :i] -= tau**2 * np.eye(i)
            for k in range(i):
                pivot = s[k, k]
                if abs(pivot) <= NEAR * (abs(pivot + tau**2) + tau**2):
                    return None
                count += pivot < 0.0
                s = s - np.outer(s[k], s[k]) / pivot
            s = s[i:, i:]
        return int(count)

    def _by_step(self, level: int, whole: Array) -> Coordinates:
        return np.split(whole, np.cumsum([step.decided for step in self._parted[level]])[:-1])

    def _split(self, gradient: Array) -> tuple[list[Coordinates], Coordinates]:
        """Return a gradient's coordinates at each level, step by step, and those of what all leave."""
        left, decided = [gradient[numbers] for numbers in self._inputs], list[Coordinates]()
        for turn, steps in zip(self._turns, self._parted, strict=True):
            own: Coordinates = []
            if turn:
                _, left = split(turn, left)
            if steps:
                own, left = split(steps, left)
            decided.append(own)
        return decided, left

    def _joined(self, level: int, decided: Coordinates | None, left: Coordinates | None = None) -> Array:
        """Return the step `(m,)` of a level's coordinates, and of those of what it leaves; zero unless given."""
        inputs = left
        for number in range(level, -1, -1):
            if self._parted[number]:
                inputs = joined(self._parted[number], decided if number == level else None, inputs)
            if self._turns[number]:
                inputs = joined(self._turns[number], None, inputs)
        assert inputs is not None
        u = np.zeros(len(self.fixed))
        for numbers, made in zip(self._inputs, inputs, strict=True):
            u[numbers] = made
        return u

    def _first_frame(self) -> list[FrameStep]:
        frame, size = [], 0
        for number, stage in enumerate(self._stages):
            free, state = ~self.fixed[stage.joints], TWIST * len(stage.state)
            inputs = np.zeros((state, int(np.count_nonzero(free))))
            inputs[:TWIST] = stage.axes[free].T
            spread = self._spread[stage.state].ravel()
            frame.append(FrameStep(number, stage.flow(size), inputs, np.eye(TWIST, state), spread))
            size = state
        frame.append(FrameStep(END, np.zeros((0, size)), np.zeros((0, 0)), np.zeros((TWIST, 0)), np.zeros(0)))
        return frame

    def _measured(self) -> tuple[Array, Array, Array]:
        """Return how much stages' twists move `(stages, 6)`, and sizes of rows' terms and of rows `(k,)`."""
        grams: list[Array] = []
        for stage in self._stages:
            moved = twist_moved(stage.arm)
            before = np.zeros((TWIST, TWIST)) if stage.before == BASE else moved @ grams[stage.before] @ moved.T
            grams.append(before + stage.axes.T @ stage.axes)
        spread = np.sqrt(np.maximum([np.diag(gram) for gram in grams], 0.0))
        given, at = self.rows.given, self._stage_of_rows
        terms = np.einsum("ki,ki->k", np.abs(given), spread[at])
        squares = np.einsum("ki,kij,kj->k", given, np.array(grams)[at], given)
        sizes = np.sqrt(np.maximum(squares, 0.0))
        for row in np.flatnonzero(sizes < SHORT * terms):
            sizes[row] = _length_anew(self._stages, int(at[row]), given[row])
        return spread, terms, sizes


def _whole(coordinates: Coordinates) -> Array:
    return np.concatenate([np.zeros(0), *coordinates])


def _length_anew(stages: list[Stage], number: int, row: Array) -> float:
    squares = 0.0
    while True:
        stage = stages[number]
        squares += length(stage.axes @ row) ** 2
        if stage.before == BASE:
            return float(np.sqrt(squares))
        row, number = twist_moved(stage.arm).T @ row, stage.before
