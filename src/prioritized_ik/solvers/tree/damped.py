"""Least squares of rows and joints together on a tree: min ‖w (J u) - b‖² + ‖d u - r‖², by one sweep to the base and back.

From the tips to the base, reflectors turn a stage's rows, those that stages beyond it hand on and its joints' own into
R u + S t = q, t being the twist before it, and rows on t alone, six at most, which are handed on. As all joints have
weights, R is regular, and there is no rank to be found.
`compiled/tree_damped.hpp` is the form that is fast.
"""

from dataclasses import dataclass

import numpy as np

from prioritized_ik.kinematic_tree import BASE, Numbers
from prioritized_ik.solvers.tree.stages import TWIST, Stage, twist_moved
from prioritized_ik.validation import Array


@dataclass
class _Step:
    turn: Array  # Q, of the rows handed on to it, its own and those of its joints
    root: Array  # R
    behind: Array  # S
    handed: int


class Damped:
    """Such a problem, factored.

    Args:
        stages: of the tree.
        stage_of_rows: number of each row's stage `(k,)`.
        rows: on twists, weighted `(k, 6)`.
        joint_weights: d `(m,)`.
    """

    def __init__(self, stages: list[Stage], stage_of_rows: Numbers, rows: Array, joint_weights: Array) -> None:
        self._stages = stages
        self._own = [np.flatnonzero(stage_of_rows == number) for number in range(len(stages))]
        self._carried: list[list[int]] = [[] for _ in stages]
        for number, stage in enumerate(stages):
            if stage.before != BASE:
                self._carried[stage.before].append(number)
        self._steps: dict[int, _Step] = {}
        handed: list[Array] = [np.zeros((0, TWIST))] * len(stages)
        for number, stage in reversed(list(enumerate(stages))):
            met = np.vstack([*(handed[other] for other in self._carried[number]), rows[self._own[number]]])
            count, moved = len(stage.joints), twist_moved(stage.arm)
            joints = np.hstack([np.diag(joint_weights[stage.joints]), np.zeros((count, TWIST))])
            whole = np.vstack([np.hstack([met @ stage.axes.T, met @ moved]), joints])
            turn, upper = np.linalg.qr(whole, mode="complete")
            handed[number] = upper[count : count + TWIST, count:] if stage.before != BASE else np.zeros((0, TWIST))
            self._steps[number] = _Step(turn, upper[:count, :count], upper[:count, count:], len(handed[number]))

    def solve(self, row_sides: Array, joint_sides: Array) -> Array:
        """Return u `(m,)` for the right-hand sides b `(k,)` and r `(m,)`."""
        stages, values = self._stages, [np.zeros(0)] * len(self._stages)
        whitened = values.copy()
        for number, stage in reversed(list(enumerate(stages))):
            step = self._steps[number]
            met = [*(values[other] for other in self._carried[number]), row_sides[self._own[number]]]
            y, count = step.turn.T @ np.concatenate([*met, joint_sides[stage.joints]]), len(stage.joints)
            whitened[number], values[number] = y[:count], y[count : count + step.handed]
        u, twists = np.zeros(len(joint_sides)), np.zeros((len(stages), TWIST))
        for number, stage in enumerate(stages):
            step = self._steps[number]
            before = np.zeros(TWIST) if stage.before == BASE else twists[stage.before]
            u[stage.joints] = np.linalg.solve(step.root, whitened[number] - step.behind @ before)
            twists[number] = twist_moved(stage.arm) @ before + stage.axes.T @ u[stage.joints]
        return u
