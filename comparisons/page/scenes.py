"""Driven scenes as the page replays them: every visible geom of the robot and around it, at every state."""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from comparisons.page.quantised import LARGEST, base64_of, quantised
from prioritized_ik.recording import Recording
from prioritized_ik.validation import Array

HIDDEN = 3  # groups of geoms from this one on are not shown by MuJoCo's viewers either
FLAT = 1e-3  # half the thickness that a plane is drawn with [m]
_PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)
_SHAPES = {
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{shape.upper()}")): shape
    for shape in ("sphere", "capsule", "ellipsoid", "cylinder", "box")
}


@dataclass(frozen=True)
class Drawn:
    """What is drawn of a model.

    Attributes:
        model: the model.
        geoms: numbers of the geoms that are visible.
        moves: which of them a joint moves.
    """

    model: mujoco.MjModel
    geoms: NDArray[np.int_]
    moves: NDArray[np.bool_]

    @staticmethod
    def of(model: mujoco.MjModel) -> "Drawn":
        """Return what is drawn of a model."""
        seen = (model.geom_group < HIDDEN) & (_colours(model)[:, 3] > 0.0)
        geoms = np.flatnonzero(seen)
        return Drawn(model, geoms, model.body_weldid[model.geom_bodyid[geoms]] != 0)

    @property
    def bytes_a_state(self) -> int:
        """How much of a page one state takes: seven numbers of 16 bits a geom, as base64."""
        return 7 * 2 * int(self.moves.sum()) * 4 // 3

    def moved(self, recording: Recording, every: int) -> dict[str, Any]:
        """Return the motion of a recording, each `every`-th state and the last.

        `at`: the numbers of the states; `geoms`: `shape`, `size`, `colour`, `moves`, how far they `reach` from their middle
        [m], and `position` and `turn`, a quaternion, at the start; `positions`: base64 of 16-bit numbers (states, moving
        geoms, 3), little-endian, which are `centre` + number × `unit` in metres; `turns`: the same of (states, moving
        geoms, 4), quaternions times the largest number.
        """
        q = self._states(recording)
        chosen = np.unique([*range(0, len(q) - 1, every), len(q) - 1])
        places, turns = self._poses(q[chosen])
        whole, centre, unit = quantised(places[:, self.moves])
        sides = np.round(turns[:, self.moves] * LARGEST).astype("<i2")
        return {
            "at": chosen.tolist(),
            "geoms": [
                self._geom(geom, bool(moves), places[0, number], turns[0, number])
                for number, (geom, moves) in enumerate(zip(self.geoms.tolist(), self.moves, strict=True))
            ],
            "meshes": int(np.isin(self.model.geom_type[self.geoms], (*_SHAPES, _PLANE), invert=True).sum()),
            "centre": centre.tolist(),
            "unit": unit,
            "positions": base64_of(whole.tobytes()),
            "turns": base64_of(sides.tobytes()),
        }

    def _states(self, recording: Recording) -> Array:
        """Return the positions of all states, the one after the last step too `(T + 1, nq)`."""
        last = recording.q[-1].copy()
        if np.isfinite(recording.dtheta[-1]).all():
            mujoco.mj_integratePos(self.model, last, recording.dtheta[-1], 1.0)
        return np.vstack([recording.q, last])

    def _poses(self, q: Array) -> tuple[Array, Array]:
        """Return where the geoms' middles are `(states, geoms, 3)` [m], and how they are turned `(states, geoms, 4)`."""
        data = mujoco.MjData(self.model)
        places, turns = np.empty((len(q), len(self.geoms), 3)), np.empty((len(q), len(self.geoms), 4))
        for state, position in enumerate(q):
            data.qpos[:] = position
            mujoco.mj_kinematics(self.model, data)
            for number, geom in enumerate(self.geoms.tolist()):
                mujoco.mju_mat2Quat(turns[state, number], data.geom_xmat[geom])
                off = self._shape(geom)[2]
                places[state, number] = data.geom_xpos[geom] + data.geom_xmat[geom].reshape(3, 3) @ off
        return places, turns

    def _shape(self, geom: int) -> tuple[str, Array, Array]:
        """Return what a geom is drawn as, its half-sizes, and where its middle is in its frame; of meshes their box."""
        kind, size = int(self.model.geom_type[geom]), np.array(self.model.geom_size[geom])
        if kind in _SHAPES:
            return _SHAPES[kind], size, np.zeros(3)
        if kind == _PLANE:
            wide = float(self.model.stat.extent)
            sides = [min(side, wide) if side > 0.0 else wide for side in size[:2]]
            return "box", np.array([*sides, FLAT]), np.array([0.0, 0.0, -FLAT])
        box = self.model.geom_aabb[geom]
        return "box", np.array(box[3:]), np.array(box[:3])

    def _geom(self, geom: int, moves: bool, place: Array, turn: Array) -> dict[str, Any]:
        shape, size, _ = self._shape(geom)
        plane = int(self.model.geom_type[geom]) == _PLANE
        return {
            "shape": shape,
            "size": size.tolist(),
            "colour": _colours(self.model)[geom].tolist(),
            "moves": moves,
            "reach": 0.0 if plane else float(self.model.geom_rbound[geom]),
            "position": place.tolist(),
            "turn": turn.tolist(),
        }


def _colours(model: mujoco.MjModel) -> Array:
    """Return the colour of every geom: red, green, blue, opacity `(n, 4)`."""
    colours = np.array(model.geom_rgba, dtype=float)
    made_of = model.geom_matid >= 0
    colours[made_of] = model.mat_rgba[model.geom_matid[made_of]]
    return colours
