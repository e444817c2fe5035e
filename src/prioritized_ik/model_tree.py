"""The kinematic tree of a MuJoCo model at a state: hinges, slides, balls and free joints, one degree of freedom each."""

from collections.abc import Sequence

import mujoco
import numpy as np

from prioritized_ik.kinematic_tree import BASE, KinematicTree, Numbers
from prioritized_ik.validation import Array

_FREE, _BALL, _SLIDE, _HINGE = (
    int(getattr(mujoco.mjtJoint, f"mjJNT_{name}")) for name in ("FREE", "BALL", "SLIDE", "HINGE")
)


class ModelTree:
    """What of a model's tree does not change with its state.

    Args:
        model: any MuJoCo model.

    Attributes:
        model: see above.
        last_joint: number of the last degree of freedom that moves each body `(nbody,)`, `BASE` for the world's.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        m = model.nv
        kind = model.jnt_type[model.dof_jntid]
        place = np.arange(m) - model.jnt_dofadr[model.dof_jntid]
        self._scalar = (kind == _HINGE) | (kind == _SLIDE)
        self._slides = np.flatnonzero(kind == _SLIDE)
        self._translating = np.flatnonzero((kind == _FREE) & (place < 3))
        self._turning = np.flatnonzero((kind == _BALL) | ((kind == _FREE) & (place >= 3)))
        self._column = place % 3
        self._all_scalar = bool(self._scalar.all())
        self._all_hinges = self._all_scalar and not self._slides.size
        self.last_joint = _last_joints(model)
        zeros = np.zeros((m, 3))
        self._pattern = KinematicTree(np.array(model.dof_parentid, dtype=int), zeros, zeros, zeros)
        self._still = zeros
        self._still.setflags(write=False)

    def at(self, data: mujoco.MjData) -> KinematicTree:
        """Return the tree at the state of `data`. Needs `mj_kinematics`."""
        joints, bodies = self.model.dof_jntid, self.model.dof_bodyid
        anchors, axes = data.xanchor[joints], data.xaxis[joints]
        if self._all_hinges:
            return self._pattern.moved_to(axes, self._still, anchors)
        angular, linear = axes.copy(), np.zeros_like(axes)
        linear[self._slides] = axes[self._slides]
        angular[self._slides] = 0.0
        if not self._all_scalar:
            frames = data.xmat.reshape(-1, 3, 3)
            turning, column = self._turning, self._column
            angular[turning] = frames[bodies[turning], :, column[turning]]
            angular[self._translating] = 0.0
            linear[self._translating] = np.eye(3)[column[self._translating]]
            anchors[self._translating] = data.xpos[bodies[self._translating]]
        return self._pattern.moved_to(angular, linear, anchors)

    def carriers(self, bodies: Sequence[int] | Numbers) -> Numbers:
        """Return the last joint that moves each of `bodies` `(k,)`."""
        return self.last_joint[np.asarray(bodies, dtype=int)]


def _last_joints(model: mujoco.MjModel) -> Numbers:
    last = np.full(model.nbody, BASE)
    for body in range(1, model.nbody):
        count = model.body_dofnum[body]
        last[body] = model.body_dofadr[body] + count - 1 if count else last[model.body_parentid[body]]
    return last


def unit_axes(axes: str) -> Array:
    """Return the world's axes of a task space such as "xyz" or "xy" `(l, 3)`."""
    return np.eye(3)[["xyz".index(axis) for axis in axes]]
