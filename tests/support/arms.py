"""Arms ready to be posed, and derivatives by differences."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from tolerances import WELL_CONDITIONED

from prioritized_ik.examples import example
from prioritized_ik.models import Arm, update_kinematics
from prioritized_ik.robot import Robot
from prioritized_ik.virtual_arms import VirtualArms


@dataclass
class Bench:
    """An arm with all its virtual end points, ready to be posed."""

    arm: Arm
    model: mujoco.MjModel
    data: mujoco.MjData
    arms: VirtualArms

    @staticmethod
    def of(arm: Arm, axes: str = "xyz", ends: list[str] | None = None) -> "Bench":
        model = arm.spec().compile()
        return Bench(arm, model, mujoco.MjData(model), VirtualArms(model, ends or arm.end_sites, axes))

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        update_kinematics(self.model, self.data, q)
        return self.arms.jacobian(self.data)

    def general_poses(self, count: int, seed: int) -> Iterator[np.ndarray]:
        """Random poses whose 34th singular value is clear of zero."""
        rng = np.random.default_rng(seed)
        while count:
            q = rng.uniform(-0.9, 0.9, self.model.nv)
            s = np.linalg.svd(self.jacobian(q), compute_uv=False)
            if s[33] > WELL_CONDITIONED * s[0]:
                count -= 1
                yield q


def bent_arm() -> Robot:
    """The arm of the examples, clear of its limits and of the table."""
    return example("arm", [0.3, 0.5, 0.2, 1.2, 0.1, 0.6, 0.0])


def central_difference(
    model: mujoco.MjModel, q: np.ndarray, value: Callable[[np.ndarray], np.ndarray], step: float
) -> np.ndarray:
    """Derivative `(k, nv)` of `value(q)` `(k,)` along each degree of freedom, through `mj_integratePos`."""
    columns = []
    for direction in np.eye(model.nv):
        ends = []
        for sign in (1.0, -1.0):
            moved = np.array(q, dtype=float)
            mujoco.mj_integratePos(model, moved, sign * direction, step)
            ends.append(np.ravel(value(moved)))
        columns.append((ends[0] - ends[1]) / (2.0 * step))
    return np.column_stack(columns)


def relative_error(found: np.ndarray, truth: np.ndarray) -> float:
    return float(np.abs(np.asarray(found) - truth).max() / np.abs(truth).max())
