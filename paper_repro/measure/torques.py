"""Winding by joint torques in MuJoCo's dynamics: the paper's two approaches to control (Sec. 2, Fig. 2).

The second approach is feedback in the task space: every virtual end point is drawn by a spring and held by a damper,
F_v = K_v (dX_v* - dX_v) - D v, and τ = Jᵀ F_v (Eq. 5). dX_v is counted from where the end point was when the last of
the links in successive contact, k, last changed, and dX_v* is what Eq. 18 asks for, added up since then. The weights of
Eq. 23 become stiffnesses, K_v = κ W: the priorities of the first approach are the stiffnesses of the second.

The first approach is feedback in the joint space: the step dθ* of Eqs. 12 and 14 is added to the desired joint
positions at every control step, and τ = k_p (θ* - θ) - k_d dθ/dt draws the joints there.

Both feel the same contacts, read the same plan and drive the same arm, without gravity. MuJoCo keeps its links out of
the object; neither approach knows joint ranges. Masses, dampings and gains are choices: the paper states none.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from paper_repro.make.jobs import Job
from prioritized_ik.solvers.hierarchy import strict_solution
from prioritized_ik.validation import Array
from prioritized_ik.weights import winding_weights
from prioritized_ik.winding.controller import AXES, Equilibrium, Situation, WindingController
from prioritized_ik.winding.episode import Outcome
from prioritized_ik.winding.metrics import bends, ideal_angle, turns_about
from prioritized_ik.winding.settings import CLOSED_FORM, WindingSettings

TIME_STEP = 2e-3  # [s] of control and dynamics
SPEED = 0.05  # [m/s] η: at 0.2 the recoil of the first approach throws the arm off the object
LONGEST = 60.0  # [s] an arm that does not wind is given up after
DENSITY = 1000.0  # [kg/m³] of the links: 23 g each
ARMATURE = 1e-3  # [kg m²] of a joint's drive
JOINT_DAMPING = 5e-3  # [N m s/rad] of a joint's bearings

STIFFNESS = 1.0  # [N/m] κ, of a weight of one: 200 N/m at wound links, 20 at the driven one, 0.01 at the free ones
RELAXATION = 2.5e-3  # [s] D over K_v
STRETCH = 0.02  # [m] a spring draws no harder than at this length, so that no force builds up on a link held back

JOINT_STIFFNESS = 20.0  # [N m/rad] k_p
DERIVATIVE = 0.1  # [N m s/rad] k_d
LONGEST_STEP = 0.1  # [rad] a joint, of dθ* in one control step

Control = Callable[[Situation, mujoco.MjData], Array]  # what is felt, and the arm's state, to τ `(m,)` [N m]


@dataclass(frozen=True)
class TorqueWinding:
    """How a winding by torques went.

    Attributes:
        equilibrium: which one it ended in, None if time ran out or the arm flew apart.
        seconds: how long it took.
        turns_ratio: turns of the wound links over the ideal.
        penetration: deepest of any link at any time [m].
        bend: largest angle between neighbouring links at any time [rad].
        torque: largest of any joint [N m].
        contact_force: largest normal force of one contact [N].
        work: done by the joints, either way [J].
        q: joint positions at the end `(m,)` [rad].
        in_contact: M at the end `(n,)`.
    """

    equilibrium: Equilibrium | None
    seconds: float
    turns_ratio: float
    penetration: float
    bend: float
    torque: float
    contact_force: float
    work: float
    q: Array
    in_contact: NDArray[np.bool_]


class TaskSpaceControl:
    """The second approach: springs and dampers at the virtual end points."""

    def __init__(self, controller: WindingController) -> None:
        self._controller = controller
        self._target = np.empty(0)
        self._last = -1

    def __call__(self, situation: Situation, data: mujoco.MjData) -> Array:
        """Return τ = Jᵀ F_v `(m,)` [N m]."""
        settings = self._controller.settings
        if situation.last != self._last:
            self._begin(situation)
        self._target = self._target + situation.desired
        stretch = self._target - situation.positions
        length = np.linalg.norm(stretch, axis=1, keepdims=True)
        stretch = stretch * np.minimum(1.0, STRETCH / np.maximum(length, STRETCH))
        stiffness = STIFFNESS * winding_weights(situation.last, len(stretch), settings.weights)[:, None]
        jacobian = self._controller.arms.jacobian(self._controller.data)
        velocity = (jacobian @ data.qvel).reshape(-1, AXES)
        return jacobian.T @ (stiffness * (stretch - RELAXATION * velocity)).ravel()

    def _begin(self, situation: Situation) -> None:
        """Count displacements anew, but for links that were wound before and still are: those are held where they were."""
        held = np.arange(len(situation.positions)) < min(situation.last, self._last)
        kept = self._target if len(self._target) else situation.positions
        self._target = np.where(held[:, None], kept, situation.positions)
        self._last = situation.last


class JointSpaceControl:
    """The first approach: springs and dampers at the joints, drawn to desired positions that dθ* moves."""

    def __init__(self, controller: WindingController) -> None:
        self._controller = controller
        self._desired = controller.settings.initial_posture()

    def __call__(self, situation: Situation, data: mujoco.MjData) -> Array:
        """Return τ = k_p (θ* - θ) - k_d dθ/dt `(m,)` [N m]."""
        q = data.qpos.copy()
        problem = self._controller.problem(q, situation)
        dtheta = strict_solution(problem.levels, problem.reference, self._controller.settings.options.rank_tolerance)
        self._desired = self._desired + np.clip(dtheta, -LONGEST_STEP, LONGEST_STEP)
        return JOINT_STIFFNESS * (self._desired - q) - DERIVATIVE * data.qvel


APPROACHES: dict[str, Callable[[WindingController], Control]] = {
    "joint space (first approach)": JointSpaceControl,
    "task space (second approach)": TaskSpaceControl,
}


def torque_job(approach: str, **changes: Any) -> Job:
    """Return the job of one winding: see `wound`."""
    return Job(wound, {"approach": approach, "changes": changes})


def wound(approach: str, changes: dict[str, Any]) -> dict[str, Any]:
    """Return the figures of `TorqueWinding`, with the name of an `Outcome` for its equilibrium."""
    found = wind_by_torques(approach, **changes)
    outcome = {Equilibrium.WINDING: Outcome.WOUND, Equilibrium.FREE: Outcome.LOST, None: Outcome.OUT_OF_STEPS}
    figures = {**vars(found), "outcome": outcome[found.equilibrium].name}
    return {name: figure for name, figure in figures.items() if name not in ("equilibrium", "q", "in_contact")}


def wind_by_torques(approach: str, **changes: Any) -> TorqueWinding:
    """Return how the arm winds by one of `APPROACHES`.

    Args:
        approach: its name.
        changes: to `WindingSettings`; η and the time step are those of this module.
    """
    settings = torque_settings(**changes)
    controller = WindingController(settings)
    control = APPROACHES[approach](controller)
    model = dynamic_model(settings)
    data = mujoco.MjData(model)
    data.qpos[:] = settings.initial_posture()
    return _run(controller, control, model, data)


def torque_settings(**changes: Any) -> WindingSettings:
    """Return the settings of a winding by torques: those that `wind_by_torques` takes, with η and the time step."""
    given: dict[str, Any] = {"limits": False, "contacts": False, "solver": CLOSED_FORM, "speed": SPEED, "dt": TIME_STEP}
    return WindingSettings(**{**given, **changes})


def dynamic_model(settings: WindingSettings) -> mujoco.MjModel:
    """Return arm and object with masses, damping and contacts between them, but none within the arm."""
    spec = settings.arm.spec()
    settings.wound_object().add_to(spec)
    spec.option.timestep = settings.dt
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.gravity = [0.0, 0.0, 0.0]
    for geom in spec.geoms:
        is_object = geom.name == "object"
        geom.contype, geom.conaffinity, geom.density = int(is_object), int(not is_object), DENSITY
    model = spec.compile()
    model.dof_damping[:], model.dof_armature[:], model.jnt_limited[:] = JOINT_DAMPING, ARMATURE, 0
    return model


def _run(controller: WindingController, control: Control, model: mujoco.MjModel, data: mujoco.MjData) -> TorqueWinding:
    settings = controller.settings
    touching: NDArray[np.bool_] = np.zeros(settings.arm.links, dtype=bool)
    depth, bend, torque, force, work = -np.inf, 0.0, 0.0, 0.0, 0.0
    steps = 0
    while True:
        situation = controller.observe(data.qpos.copy(), touching)
        touching = situation.in_contact
        depth = max(depth, -float(situation.touch.distance.min()))
        bend = max(bend, float(bends(situation.directions).max()))
        if situation.equilibrium is not None or steps * settings.dt >= LONGEST:
            break
        tau = control(situation, data)
        data.qfrc_applied[:] = tau
        mujoco.mj_step(model, data)
        steps += 1
        torque = max(torque, float(np.abs(tau).max()))
        work += float(np.abs(tau * data.qvel).sum()) * settings.dt
        force = max(force, contact_force(model, data))
    wound = settings.wound_object()
    middles = situation.positions - 0.5 * settings.arm.link_length * situation.directions
    angle = ideal_angle(settings.arm.link_length, settings.size[0] + settings.arm.radius, settings.tilt)
    ideal = (settings.arm.links - settings.link) * angle / (2.0 * np.pi)
    turns = turns_about(middles[settings.link - 1 :], wound.position, wound.rotation)
    figures = (steps * settings.dt, turns / ideal, depth, bend, torque, force, work)
    return TorqueWinding(situation.equilibrium, *figures, data.qpos.copy(), touching)


def contact_force(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Return the largest normal force of a contact [N], 0 without any."""
    found = np.zeros(6)
    largest = 0.0
    for contact in range(data.ncon):
        mujoco.mj_contactForce(model, data, contact, found)
        largest = max(largest, float(found[0]))
    return largest
