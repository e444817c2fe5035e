"""Jacobians of many points on bodies at once, from MuJoCo's motion axes."""

from collections.abc import Sequence
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from prioritized_ik.validation import Array

# Rows of cdofᵀ, an angular axis ω over a linear one v, and columns of levers r: three for the products ω_y r_z, ω_z r_x,
# ω_x r_y of v + ω × r, three for those that are taken off, and of the axes three for v.
_AXES = np.array([1, 2, 0, 2, 0, 1, 3, 4, 5])
_LEVERS = np.array([2, 0, 1, 1, 2, 0])


class PointJacobians:
    """Translational Jacobians of points fixed to bodies: what `mujoco.mj_jac` returns point by point.

    A joint moves a point p by v + ω × (p - c), with v and ω MuJoCo's `cdof` about the centre of mass c of the body's tree,
    if it stands between the body and the world.

    Args:
        model: any MuJoCo model.
        bodies: the body that carries each point `(n,)`.

    Attributes:
        roots: the body at the root of each one's tree `(n,)`.
    """

    def __init__(self, model: mujoco.MjModel, bodies: Sequence[int]) -> None:
        self._model, self._bodies = model, tuple(bodies)
        self.roots = model.body_rootid[np.array(bodies, dtype=int)]

    @cached_property
    def moving(self) -> NDArray[np.bool_]:
        """Which degrees of freedom move each body `(n, m)`."""
        moving = [_moving(self._model, body) for body in self._bodies]
        return np.array(moving, dtype=bool).reshape(len(moving), self._model.nv)

    @cached_property
    def _still(self) -> NDArray[np.bool_]:
        return ~self.moving[:, None]

    def moves(self, number: int) -> bool:
        """Return whether a joint moves the body of that number."""
        return bool(_moving(self._model, self._bodies[number]).any())

    def at(self, data: mujoco.MjData, points: Array, chosen: NDArray[np.int_] | slice = slice(None)) -> Array:
        """Return the Jacobians `(k, 3, m)` of `points` `(k, 3)` [m] in the world. Needs `mj_comPos`.

        Args:
            data: the model's state.
            points: in the world, one a body.
            chosen: which of the bodies carry them `(k,)`; all unless given.
        """
        axes = data.cdof.T.take(_AXES, axis=0)
        levers = (points - data.subtree_com[self.roots[chosen]]).take(_LEVERS, axis=1)[:, :, None]
        # Products and sums in the order of `mj_jac`, so that rounding is the same: v + (ω_y r_z - ω_z r_y) and so on.
        jacobians = axes[:3] * levers[:, :3]
        jacobians -= axes[3:6] * levers[:, 3:]
        jacobians += axes[6:]
        np.copyto(jacobians, 0.0, where=self._still[chosen])
        return jacobians


def _moving(model: mujoco.MjModel, body: int) -> NDArray[np.bool_]:
    """Return which degrees of freedom `(m,)` move `body`."""
    moves = np.zeros(model.nv, dtype=bool)
    while body > 0:
        first = model.body_dofadr[body]
        moves[first : first + model.body_dofnum[body]] = True
        body = model.body_parentid[body]
    return moves
