"""An arm in a pose: what checks, tables and drawings read from the model."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from prioritized_ik.models import Arm, update_kinematics
from prioritized_ik.validation import Array
from prioritized_ik.virtual_arms import EndPoint, VirtualArms

#: The arm of Fig. 1, and the ends of its virtual arms: at a joint, on a link, at a joint.
VIRTUAL_ARMS_OF = Arm(links=4, joints="planar")
VIRTUAL_ENDS: tuple[EndPoint | str, ...] = ("end_1", EndPoint("geom", "link_3"), "end_3")

GENERAL = 0.9  # [rad] joints of a general pose are drawn from plus and minus this, within the default joint range


@dataclass(frozen=True)
class PosedArm:
    """A serial arm and its virtual end points, brought to a pose.

    Attributes:
        model: the compiled arm.
        data: its state.
        arms: the virtual arms.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    arms: VirtualArms

    @staticmethod
    def of(
        arm: Arm,
        q: ArrayLike,
        points: list[EndPoint | str] | None = None,
        axes: str = "xyz",
        spec: mujoco.MjSpec | None = None,
    ) -> "PosedArm":
        """Return `arm` at joint positions `q` `(m,)` [rad].

        Args:
            arm: the arm.
            q: joint positions.
            points: virtual end points; the link ends unless given.
            axes: of the task space.
            spec: the arm's specification where it was changed.
        """
        model = (spec or arm.spec()).compile()
        data = mujoco.MjData(model)
        update_kinematics(model, data, q)
        return PosedArm(model, data, VirtualArms(model, points or list(arm.end_sites), axes))

    def moved_to(self, q: ArrayLike) -> "PosedArm":
        """Return the same arm at other joint positions; this one moves too."""
        update_kinematics(self.model, self.data, q)
        return self

    @property
    def q(self) -> Array:
        """Joint positions `(m,)` [rad]."""
        return self.data.qpos.copy()

    @property
    def positions(self) -> Array:
        """End points `(n, l)` [m]."""
        return self.arms.positions(self.data)

    @property
    def jacobian(self) -> Array:
        """Stacked Jacobian J `(L, m)`."""
        return self.arms.jacobian(self.data)

    @property
    def directions(self) -> Array:
        """Unit directions of the links `(links, 3)`."""
        return self.data.xmat[1:].reshape(-1, 3, 3)[:, :, 0].copy()

    @property
    def bases(self) -> Array:
        """Where each link begins, which is where its joints are `(links, 3)` [m]."""
        return self.data.xpos[1:].copy()

    @property
    def joint_anchors(self) -> Array:
        """A point on each joint's axis `(m, 3)` [m]."""
        return self.data.xanchor.copy()

    @property
    def joint_axes(self) -> Array:
        """Unit vectors along the joint axes, in the world `(m, 3)`."""
        return self.data.xaxis.copy()


def general_pose(arm: Arm, seed: int) -> Array:
    """Return joint positions `(m,)` [rad] drawn evenly from plus and minus `GENERAL`."""
    return np.random.default_rng(seed).uniform(-GENERAL, GENERAL, arm.joint_count)


def relative_error(found: ArrayLike, truth: ArrayLike) -> float:
    """Return ‖found - truth‖ / ‖truth‖, the relative error."""
    return float(np.linalg.norm(np.asarray(found) - truth) / np.linalg.norm(truth))
