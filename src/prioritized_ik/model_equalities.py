"""The model's own equalities: closed loops, welds, coupled joints and tendons."""

import mujoco
import numpy as np

from prioritized_ik.errors import InputError
from prioritized_ik.guard import Guarded, Limit
from prioritized_ik.problem import Equalities
from prioritized_ik.robot import Robot
from prioritized_ik.tolerances import NOISE
from prioritized_ik.validation import Array, gain_of, one_of, positive

_EQUALITY = int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
KINDS = {int(mujoco.mjtEq.mjEQ_CONNECT): "connect", int(mujoco.mjtEq.mjEQ_WELD): "weld"} | {
    int(mujoco.mjtEq.mjEQ_JOINT): "joint",
    int(mujoco.mjtEq.mjEQ_TENDON): "tendon",
}


class ModelEqualities(Limit):
    """The active equalities of the model, `connect`, `weld`, `joint` and `tendon`, as hard rows J dθ = -gain c.

    c is how far an equality is open [m; rad for joints, and times `torquescale` for the rotation of welds]. Rows are of
    first order: what a step opens by its second is looked up at its end and taken off, see `solve_step`, so that no more
    than a tenth of its `accuracy` is left for the next step to take back. Where the rows depend on each other, as
    those of a loop in the plane, only the part of c that some step takes back is asked for; near a singular posture, no
    more of it than joints of `return_speed` can.

    Args:
        robot: whose model has the equalities.
        tolerance: c up to this is drift, which is taken back in any case.
        outside: of equalities further open: `"raise"` an error; `"hold"`, they stay as they are; `"return"`, they close.
        gain: how much of c one step takes back, in (0, 1].
        return_speed: of the joints that do so, at most, in the joint metric [rad/s].

    Raises:
        InputError: a value out of range, or a model without active equalities.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        tolerance: float = 1e-3,
        outside: str = "return",
        gain: float = 1.0,
        return_speed: float = 0.5,
    ) -> None:
        super().__init__(robot)
        self._tolerance, self._gain = positive("tolerance", tolerance), gain_of("gain", gain)
        self._outside = one_of("outside", outside, ("raise", "hold", "return"))
        self._speed = positive("return_speed", return_speed)
        if not (robot.data.eq_active != 0).any():
            raise InputError(f"the model has {robot.model.neq} equalities, none of them active; leave the limit out.")

    def drift(self, robot: Robot) -> dict[str, float]:
        """Return how far each active equality is open, the largest of its rows, by name."""
        _, open_by, which = _rows(robot)
        return {_name(robot, number): float(np.abs(open_by[which == number]).max()) for number in np.unique(which).tolist()}

    def opened(self, robot: Robot) -> Array:
        """Return how far each row is open `(e,)`, see `drift`."""
        return _rows(robot)[1]

    def _at(self, robot: Robot, dt: float) -> Guarded:
        matrix, open_by, which = _rows(robot)
        far = np.isin(which, which[np.abs(open_by) > self._tolerance])
        if self._outside == "raise" and far.any():
            worst = int(np.abs(open_by).argmax())
            raise InputError(
                f"{_name(robot, which[worst])} is open by {abs(open_by[worst]):.6g}, more than tolerance, "
                f"{self._tolerance:.6g}; close it first, or choose outside='return'."
            )
        wanted = np.where(far & (self._outside == "hold"), 0.0, -self._gain * open_by)
        # With rows U S Vᵀ in the joint metric, only U's columns of S above rounding can be asked for.
        u, s, _ = np.linalg.svd(matrix / np.sqrt(robot.metric), full_matrices=False)
        along = np.where(s > NOISE * s.max(initial=0.0), u.T @ wanted, 0.0)
        target = u @ np.clip(along, -s * self._speed * dt, s * self._speed * dt)
        places = [int(np.count_nonzero(which[:i] == number)) + 1 for i, number in enumerate(which.tolist())]
        names = [f"{_name(robot, number)} row {place}" for number, place in zip(which.tolist(), places, strict=True)]
        return Guarded(equalities=Equalities(matrix, target, names))


def _rows(robot: Robot) -> tuple[Array, Array, Array]:
    """Return the Jacobian of all active equalities `(r, nv)`, how far they are open `(r,)`, and which they are `(r,)`."""
    model, data = robot.model, robot.data
    mujoco.mj_makeConstraint(model, data)
    kept = np.flatnonzero(data.efc_type == _EQUALITY)
    if mujoco.mj_isSparse(model):
        matrix = np.zeros((data.nefc, model.nv))
        mujoco.mju_sparse2dense(matrix, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind)
    else:
        matrix = np.reshape(data.efc_J, (data.nefc, model.nv))
    return matrix[kept], data.efc_pos[kept].copy(), data.efc_id[kept].copy()


def _name(robot: Robot, number: int) -> str:
    kind = KINDS.get(int(robot.model.eq_type[number]), "equality")
    given = mujoco.mj_id2name(robot.model, mujoco.mjtObj.mjOBJ_EQUALITY, number)
    return f"{kind} {given or number}"
