"""A guess of the active bounds and rows, by an interior-point method: as good with hundreds of them as with two.

An active set that starts from nothing is corrected a few rows at a time. Mehrotra's predictor and corrector go through the
inside instead: some twenty steps, whatever the number of rows, each one least-squares problem along the links
(`damped.py`). Levels are weighed against each other there, each much less than the one above, and the joints' reference
least of all, which is near enough to tell which rows hold the optimum: of those that do, the slack goes to zero from step
to step while the multiplier stays, and of the others the multiplier (Tapia's indicator). The kernel starts from there, and
its certificate judges, as always.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.solvers.tree.certificate import ActiveSet
from prioritized_ik.solvers.tree.posed import PosedOnTree
from prioritized_ik.validation import Array

LEAST = 1e-9  # [of rows of unit strength] that of the joints' reference
FIXED = 1e8  # [of the same] that of a frozen joint
STEPS = 40
ENOUGH = 1e-19  # [of the mean product of slack and multiplier at the start] where the levels' rows have been told apart
FALLS, LATE = 0.9, 1e-8  # [of the one before, and at the start] what that product is at most after a step, from when on
INSIDE = 0.995  # [of the way to the first row] how far a step goes
START = 1e-3  # [of the room of a row, as a rule] the least that any has at the start
FIRST = 0.1  # [of the gradient] multipliers at the start


@dataclass(frozen=True, eq=False)
class _Direction:
    u: Array  # (m,)
    slack: Array  # (n,)
    multipliers: Array  # (n,)


class _Interior:
    """A point inside n bounds and rows of a problem, C u + s = d, and its steps.

    The bounds from above come first, those from below next, inequality rows of unit length last.
    """

    def __init__(self, posed: PosedOnTree, less: float) -> None:
        self._posed, self._factors = posed, posed.factors
        self.frozen = posed.lower == posed.upper
        self.up = np.flatnonzero(np.isfinite(posed.upper) & ~self.frozen)
        self.down = np.flatnonzero(np.isfinite(posed.lower) & ~self.frozen)
        sides = posed.targets[posed.parts[0]]
        self.rows = np.flatnonzero(np.isfinite(sides) & (posed.lengths[posed.parts[0]] > 0.0))
        self._lengths = posed.lengths[self.rows]
        self.sides = np.concatenate(
            [posed.upper[self.up], -posed.lower[self.down], posed.targets[self.rows] / self._lengths]
        )
        self._weights = np.zeros(len(posed.level))
        for number, part in enumerate(posed.parts[1:]):
            strength = posed.strength(number + 1)
            self._weights[part] = less**number * posed.roots[part] / (strength or 1.0)
        self.u = np.where(self.frozen, posed.lower, 0.0)
        self._look()
        room = np.median(np.abs(self.sides)) if len(self.sides) else 0.0
        self.slack = np.maximum(self.sides - self.felt, START * float(room) or 1.0)
        steepest = np.abs(self._torques(self._lacking)).max(initial=0.0)
        self.multipliers = np.full(len(self.sides), FIRST * float(steepest) or 1.0)

    def _torques(self, values: Array) -> Array:
        return self._posed.rows.transposed_times(self._weights * values)

    def _look(self) -> None:
        """Note how far the point moves rows, C u, and what levels lack there, weighted."""
        posed = self._posed
        motions = posed.motions(self.u)
        self.felt = self._at(self.u, motions)
        self._lacking = self._weights * (np.where(self._weights > 0.0, posed.targets, 0.0) - motions)

    def _at(self, u: Array, motions: Array) -> Array:
        return np.concatenate([u[self.up], -u[self.down], motions[self.rows] / self._lengths])

    @property
    def product(self) -> float:
        """Mean product of slack and multiplier."""
        return float(self.slack @ self.multipliers) / max(1, len(self.slack))

    def factor(self) -> None:
        """Factor the least squares of steps from here: bounds and rows weigh as multipliers by slack."""
        ratios, count = self.multipliers / self.slack, len(self.up)
        joints = np.full(len(self.u), LEAST**2)
        joints[self.up] += ratios[:count]
        joints[self.down] += ratios[count : count + len(self.down)]
        joints[self.frozen] = FIXED**2
        self._joint_weights = np.sqrt(joints)
        self._row_weights = self._weights.copy()
        self._row_weights[self.rows] = np.sqrt(ratios[count + len(self.down) :]) / self._lengths
        self._factors.damp(self._row_weights, self._joint_weights)

    def direction(self, products: Array) -> _Direction:
        """Return the step after which products of slack and multiplier are less by `products` `(n,)`."""
        beyond = self.felt + self.slack - self.sides
        pulls = self.multipliers + (self.multipliers * beyond - products) / self.slack
        count, more = len(self.up), len(self.up) + len(self.down)
        joints = LEAST**2 * (self._posed.reference - self.u)
        joints[self.up] -= pulls[:count]
        joints[self.down] += pulls[count:more]
        joints[self.frozen] = 0.0
        sides = self._lacking.copy()
        sides[self.rows] = -pulls[more:] / (self._row_weights[self.rows] * self._lengths)
        u = self._factors.damped(sides, joints / self._joint_weights)
        slack = -beyond - self._at(u, self._factors.motions(u)[0])
        return _Direction(u, slack, (-products - self.multipliers * slack) / self.slack)

    def go(self, direction: _Direction, primal: float, dual: float) -> NDArray[np.bool_]:
        """Go so far along it; return of which rows the slack shrinks more than the multiplier `(n,)`."""
        slack, multipliers = self.slack, self.multipliers
        self.u = self.u + primal * direction.u
        self.slack = slack + primal * direction.slack
        self.multipliers = multipliers + dual * direction.multipliers
        self._look()
        return np.asarray(self.slack * multipliers < self.multipliers * slack)


@dataclass(frozen=True, eq=False)
class Inside:
    """A guess.

    Attributes:
        u: `(m,)`, within all bounds, and at those that it may rest on.
        active: which bounds and rows it may rest on.
    """

    u: Array
    active: ActiveSet


def guessed(posed: PosedOnTree, less: float) -> Inside | None:
    """Return where the optimum is, about; None if numbers run out.

    Args:
        posed: the problem.
        less: weight of a level's rows of unit strength, relative to those of the level above.
    """
    point = _Interior(posed, less)
    tight, start = np.zeros(len(point.sides), dtype=bool), point.product
    product = start
    with np.errstate(all="ignore"):
        for _ in range(STEPS):
            point.factor()
            both = point.slack * point.multipliers
            first = point.direction(both)
            primal, dual = _reach(point.slack, first.slack), _reach(point.multipliers, first.multipliers)
            after = (point.slack + primal * first.slack) @ (point.multipliers + dual * first.multipliers) / len(both)
            aim = float(after / product) ** 3 * product
            way = point.direction(both + first.slack * first.multipliers - aim)
            primal, dual = _reach(point.slack, way.slack), _reach(point.multipliers, way.multipliers)
            if not np.isfinite(way.u).all():
                return None
            before, told = product, point.go(way, min(1.0, INSIDE * primal), min(1.0, INSIDE * dual))
            product = point.product
            if FALLS * before <= product < LATE * start:  # rounding has the better of it
                break
            tight = told
            if product <= ENOUGH * start:
                break
    active = _active(point, posed, tight)
    u = np.where(active.side > 0, posed.upper, np.where(active.side < 0, posed.lower, point.u))
    return Inside(np.clip(u, posed.lower, posed.upper), active)


def _reach(values: Array, change: Array) -> float:
    """Return how far values may go, one at most, until the first of them is zero."""
    falls = change < 0.0
    return min(1.0, float((values[falls] / -change[falls]).min(initial=np.inf)))


def _active(point: _Interior, posed: PosedOnTree, tight: NDArray[np.bool_]) -> ActiveSet:
    count, more = len(point.up), len(point.up) + len(point.down)
    side = np.where(point.frozen, 1, 0).astype(np.int8)
    side[point.up[tight[:count]]] = 1
    side[point.down[tight[count:more]]] = -1
    held = np.zeros(len(posed.problem.rows.upper), dtype=bool)
    held[point.rows[tight[more:]]] = True
    return ActiveSet(side, held)
