"""A kinematic tree as one chain of stages, for recursions from its base to its tips and back.

A stage is a few joints in a row that carry nothing of their own between them; the twist at its last joint's anchor stands
for it. Stages follow each other depth first, and at each the state x is its own twist and those of stages that others still
start from: what a chain needs is one twist, and what a tree needs beside it is what is pending. Of a joint's branches the
one that carries most comes last, so that no more is pending than the logarithm of the joints.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.kinematic_tree import BASE, KinematicTree, Numbers
from prioritized_ik.validation import Array

TWIST = 6
MOST = 6  # joints of a stage


@dataclass
class Stage:
    """Some joints, base first.

    Attributes:
        joints: their numbers `(b,)`.
        axes: twist at the last one's anchor of a unit step of each `(b, 6)`, ω before v.
        before: number of the stage that carries it, `BASE` for none.
        arm: from the anchor of that one to this one's `(3,)`.
        state: numbers of the stages whose twists are the state here, its own first.
        kept: where in the state of the stage just before it these stand, its own before it first; -1 for none.
    """

    joints: Numbers
    axes: Array
    before: int
    arm: Array
    state: list[int] = field(default_factory=list)
    kept: list[int] = field(default_factory=list)

    def flow(self, size: int) -> Array:
        """Return F, from the state `(size,)` of the stage just before to this one's, its joints at rest."""
        matrix = np.zeros((TWIST * len(self.state), size))
        for i, place in enumerate(self.kept):
            if place >= 0:
                moved = twist_moved(self.arm) if i == 0 else np.eye(TWIST)
                matrix[TWIST * i : TWIST * (i + 1), TWIST * place : TWIST * (place + 1)] = moved
        return matrix


def stages_of(tree: KinematicTree, carrying: NDArray[np.bool_]) -> list[Stage]:
    """Return the stages of a tree; joints that are `carrying` rows `(m,)` are the last of theirs."""
    parents, m = tree.parents.tolist(), tree.joint_count
    weight = tree.beyond(np.ones((m, 1)))[:, 0]
    carried: list[list[int]] = [[] for _ in range(m + 1)]  # by each joint, `BASE` last
    for j in range(m):
        carried[parents[j]].append(j)
    for some in carried:
        some.sort(key=lambda j: (weight[j], j), reverse=True)
    stages: list[Stage] = []
    waiting = [(j, BASE) for j in carried[BASE]]
    while waiting:
        j, before = waiting.pop()
        joints = [j]
        while len(carried[j]) == 1 and not carrying[j] and len(joints) < MOST:
            (j,) = carried[j]
            joints.append(j)
        stages.append(_stage(tree, joints, before, stages))
        waiting += [(after, len(stages) - 1) for after in carried[j]]
    _add_states(stages)
    return stages


def _stage(tree: KinematicTree, joints: list[int], before: int, stages: list[Stage]) -> Stage:
    anchors = tree.anchors
    at = anchors[joints[-1]]
    axes = np.array([twist_moved(at - anchors[j]) @ np.concatenate([tree.angular[j], tree.linear[j]]) for j in joints])
    arm = np.zeros(3) if before == BASE else at - anchors[stages[before].joints[-1]]
    return Stage(np.array(joints), axes, before, arm)


def _add_states(stages: list[Stage]) -> None:
    last = np.full(len(stages), -1)  # stage that starts from each
    for number, stage in enumerate(stages):
        if stage.before != BASE:
            last[stage.before] = number
    state: list[int] = []
    for number, stage in enumerate(stages):
        pending = [other for other in state if last[other] > number]
        stage.state = [number, *pending]
        stage.kept = [state.index(stage.before) if stage.before != BASE else -1, *map(state.index, pending)]
        state = stage.state


def twist_moved(arm: Array) -> Array:
    """Return X `(6, 6)`: a twist at a point as that at another, an `arm` away."""
    x, y, z = arm
    matrix = np.eye(TWIST)
    matrix[3:, :3] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    return matrix
