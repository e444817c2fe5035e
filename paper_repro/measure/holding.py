"""Hold and lift: the object that the arm is wound around is let go, lifted and shaken, in MuJoCo's dynamics.

The arm winds around the fixed object by the paper's second approach (`torques`), weightless. Then the object is free. The
arm grips for a while, gravity comes on, and the base rises on a carriage and is shaken up and down. What the carriage does
is told as gravity: in its frame, which does not turn, arm and object feel g + d²z/dt², and that is exact.

Held is what the links do not lose: of each wound link the point nearest the object and the object's point there are
marked when it is let go, and the slip is how far they have come apart, whether by sliding or because a link rolls about
itself. Masses, sizes, friction, gains and the grip are choices: the paper holds nothing.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from paper_repro.measure.torques import (
    APPROACHES,
    ARMATURE,
    DENSITY,
    DERIVATIVE,
    JOINT_DAMPING,
    JOINT_STIFFNESS,
    LONGEST_STEP,
    RELAXATION,
    STIFFNESS,
    STRETCH,
    torque_settings,
    wind_by_torques,
)
from prioritized_ik.models import SHAPES
from prioritized_ik.problem import Level
from prioritized_ik.solvers.hierarchy import strict_solution
from prioritized_ik.touch import Touch, TouchSensor
from prioritized_ik.validation import Array
from prioritized_ik.virtual_arms import VirtualArms
from prioritized_ik.weights import diagonal_of_weights, winding_weights
from prioritized_ik.winding.controller import AXES, Equilibrium
from prioritized_ik.winding.settings import WindingSettings

FIRST_LINK = 10  # the last from which the arm, 0.8 of a turn around the cylinder, does not come to lie in itself
OBJECTS: dict[str, tuple[str, tuple[float, ...]]] = {  # shape and half-sizes [m]
    "cylinder": ("cylinder", (0.07, 0.1)),
    "ellipsoid": ("ellipsoid", (0.06, 0.09, 0.1)),
    "box, over its edges": ("box", (0.06, 0.06, 0.1)),
}
MASS = 0.5  # [kg] of the object
GRAVITY = 9.81  # [m/s²]
FRICTION = 0.5  # coefficient between links and object
TORQUE_LIMIT = 10.0  # [N m] of every joint

GRIP, LIFT, SHAKE = 1.0, 1.0, 10.0  # [s] to grip and for gravity to come on; to lift; to shake
HEIGHT = 0.2  # [m] of the lift
FREQUENCY, AMPLITUDE = 2.0, 0.02  # [Hz], [m] of shaking
SWELL = 0.5  # [s] in which shaking comes to its amplitude

PRESS = 8.0  # [N] with which the second approach presses a wound link's end to the object
PRESS_DEPTH = 0.02  # [m] dX* of the first approach into the object
SLIPPED = 0.03  # [m] half a link: an object that slipped further is not held
SAMPLING = 5  # steps between two readings of slip and squeeze


class Control(Protocol):
    """From the scene as it stands to the torques of the arm's joints `(m,)` [N m]."""

    def __call__(self, grip: float) -> Array:
        """Return the torques, with the grip closed to a fraction from 0 to 1."""
        ...


@dataclass(frozen=True)
class Trial:
    """What is to be held, how firmly.

    Attributes:
        wound: name of the object in `OBJECTS`.
        direction: where it came from.
        gravity: [m/s²].
        friction: coefficient between links and object.
        torque_limit: of every joint [N m].
    """

    wound: str
    direction: str
    gravity: float = GRAVITY
    friction: float = FRICTION
    torque_limit: float = TORQUE_LIMIT


@dataclass(frozen=True)
class Hold:
    """How a trial went.

    Attributes:
        held: whether the slip stayed within `SLIPPED` to the end.
        seconds: until the end, or until the object slipped.
        slip: how far marks on links and object have come apart at the end, median of the wound links [m].
        slip_shaken: the part of it since shaking began [m].
        roll: largest turn of a wound link about itself at the end [rad].
        torque: largest of any joint [N m].
        contact_force: largest normal force of one contact [N].
        squeeze: sum of all normal forces, median over time [N].
        work: done by the joints, either way [J].
        course: time [s] and slip [m] in the course of it, `SAMPLING` steps apart.
        uncertified: control steps of a hierarchy that were not proven optimal.
        steps: control steps of a hierarchy.
    """

    held: bool
    seconds: float
    slip: float
    slip_shaken: float
    roll: float
    torque: float
    contact_force: float
    squeeze: float
    work: float
    course: tuple[tuple[float, float], ...]
    uncertified: int = 0
    steps: int = 0


class Scene:
    """The arm wound around an object that is free to move.

    Attributes:
        settings: of the winding.
        model, data: of arm and object; the arm's m joints come first.
        arms: its virtual arms.
        sensor: what it feels of the object.
        joints: m.
        q: joint positions when the object was let go `(m,)` [rad].
        ends: positions of the links' ends then `(n, 3)` [m].
        wound: the links in contact then, from 0.
    """

    def __init__(self, trial: Trial) -> None:
        self.settings, self.q, self.wound = wound_arm(trial.wound, trial.direction)
        self.model = free_model(self.settings, trial.friction)
        self.data = mujoco.MjData(self.model)
        self.joints = len(self.q)
        self.data.qpos[: self.joints] = self.q
        mujoco.mj_forward(self.model, self.data)
        self.arms = VirtualArms(self.model, self.settings.arm.end_sites)
        self.sensor = TouchSensor(self.model, self.settings.arm.link_geoms)
        self.ends = self.arms.positions(self.data)
        self._links = np.array(self.sensor.bodies)[self.wound]
        self._before = self.data.xmat[self._links].reshape(-1, 3, 3).copy()
        marks = self.sensor.read(self.data).point[self.wound]
        self._marks = [self._in_frame(body, mark) for body, mark in zip(self._links, marks, strict=True)]
        self._opposite = [self._in_frame(self.sensor.object_body, mark) for mark in marks]

    def touch(self) -> Touch:
        """Return what the arm feels now."""
        return self.sensor.read(self.data)

    def jacobian(self) -> Array:
        """Return J of the virtual end points `(3 n, m)`."""
        return self.arms.jacobian(self.data)[:, : self.joints]

    def slip(self) -> float:
        """Return how far marks on links and object have come apart, median of the wound links [m]."""
        thing = self.sensor.object_body
        apart = [
            np.linalg.norm(self._in_world(body, mark) - self._in_world(thing, other))
            for body, mark, other in zip(self._links, self._marks, self._opposite, strict=True)
        ]
        return float(np.median(apart))

    def roll(self) -> float:
        """Return the largest turn of a wound link about itself since the object was let go [rad]."""
        turns = np.swapaxes(self._before, 1, 2) @ self.data.xmat[self._links].reshape(-1, 3, 3)
        about = np.arctan2(turns[:, 2, 1] - turns[:, 1, 2], turns[:, 1, 1] + turns[:, 2, 2])
        return float(np.abs(about).max())

    def squeeze(self) -> tuple[float, float]:
        """Return the largest normal force of a contact, and the sum of all [N]."""
        force, forces = np.zeros(6), [0.0]
        for contact in range(self.data.ncon):
            mujoco.mj_contactForce(self.model, self.data, contact, force)
            forces.append(float(force[0]))
        return max(forces), sum(forces)

    def _in_frame(self, body: int, point: Array) -> Array:
        return (point - self.data.xpos[body]) @ self.data.xmat[body].reshape(3, 3)

    def _in_world(self, body: int, point: Array) -> Array:
        return self.data.xpos[body] + self.data.xmat[body].reshape(3, 3) @ point


class JointSpaceHold:
    """The first approach: joints are drawn to where dθ* of Eqs. 12 and 14 takes them, with dX* into the object."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        arm, touch = scene.settings.arm, scene.touch()
        desired = np.zeros((arm.links, AXES))
        desired[scene.wound] = -PRESS_DEPTH * touch.normal[scene.wound]
        weights = diagonal_of_weights(winding_weights(arm.links, arm.links), AXES)
        level = Level(scene.jacobian(), desired.ravel(), weights)
        dtheta = strict_solution([level], np.zeros(scene.joints), scene.settings.options.rank_tolerance)
        self._pressing = np.clip(dtheta, -LONGEST_STEP, LONGEST_STEP)

    def __call__(self, grip: float) -> Array:
        """Return τ = k_p (θ* - θ) - k_d dθ/dt `(m,)` [N m]."""
        data, m = self._scene.data, self._scene.joints
        desired = self._scene.q + grip * self._pressing
        return JOINT_STIFFNESS * (desired - data.qpos[:m]) - DERIVATIVE * data.qvel[:m]


class TaskSpaceHold:
    """The second approach: every end is held by its spring and damper where it was, and presses the object."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        links = scene.settings.arm.links
        self._stiffness = STIFFNESS * winding_weights(links, links)[:, None]

    def __call__(self, grip: float) -> Array:
        """Return τ = Jᵀ F_v `(m,)` [N m]."""
        scene = self._scene
        stretch = scene.ends - scene.arms.positions(scene.data)
        length = np.linalg.norm(stretch, axis=1, keepdims=True)
        stretch = stretch * np.minimum(1.0, STRETCH / np.maximum(length, STRETCH))
        jacobian = scene.jacobian()
        velocity = (jacobian @ scene.data.qvel[: scene.joints]).reshape(-1, AXES)
        forces = self._stiffness * (stretch - RELAXATION * velocity)
        forces[scene.wound] -= grip * PRESS * scene.touch().normal[scene.wound]
        return jacobian.T @ forces.ravel()


def hold(trial: Trial, scene: Scene, control: Control) -> Hold:
    """Return how a control holds: let go, grip, lift, shake."""
    model, data, m = scene.model, scene.data, scene.joints
    dt = scene.settings.dt
    times: list[float] = []
    slips: list[float] = []
    squeezes: list[float] = []
    torque, force, work = 0.0, 0.0, 0.0
    for step in range(round((GRIP + LIFT + SHAKE) / dt)):
        seconds = step * dt
        model.opt.gravity[2] = -trial.gravity * _risen((seconds - 0.5 * GRIP) / (0.5 * GRIP)) - acceleration(seconds)
        tau = np.clip(control(_risen(seconds / (0.5 * GRIP))), -trial.torque_limit, trial.torque_limit)
        data.qfrc_applied[:m] = tau
        mujoco.mj_step(model, data)
        torque = max(torque, float(np.abs(tau).max()))
        work += float(np.abs(tau * data.qvel[:m]).sum()) * dt
        if step % SAMPLING == 0:
            largest, together = scene.squeeze()
            force = max(force, largest)
            squeezes.append(together)
            slips.append(scene.slip())
            times.append(seconds)
            if not slips[-1] <= 2.0 * SLIPPED:
                break
    shaken = [slip for slip, time in zip(slips, times, strict=True) if time >= GRIP + LIFT]
    return Hold(
        held=max(slips) <= SLIPPED,
        seconds=seconds + dt,
        slip=slips[-1],
        slip_shaken=shaken[-1] - shaken[0] if shaken else 0.0,
        roll=scene.roll(),
        torque=torque,
        contact_force=force,
        squeeze=float(np.median(squeezes)),
        work=work,
        course=tuple(zip(times, slips, strict=True)),
        **getattr(control, "counts", {}),
    )


def acceleration(seconds: float) -> float:
    """Return d²z/dt² of the carriage [m/s²]: a smooth lift by `HEIGHT`, then shaking that swells to its amplitude."""
    time = seconds - GRIP
    if time < 0.0:
        return 0.0
    if time < LIFT:
        s = time / LIFT
        return HEIGHT * (60.0 * s - 180.0 * s**2 + 120.0 * s**3) / LIFT**2  # of minimum jerk
    time -= LIFT
    pulse = 2.0 * math.pi * FREQUENCY
    return -AMPLITUDE * pulse**2 * math.sin(pulse * time) * _risen(time / SWELL)


def _risen(fraction: float) -> float:
    return min(1.0, max(0.0, fraction))


@cache
def wound_arm(wound: str, direction: str) -> tuple[WindingSettings, Array, NDArray[np.intp]]:
    """Return settings, joint positions `(m,)` [rad] and links in contact (from 0) of the arm wound by the second approach.

    Raises:
        ValueError: it does not wind.
    """
    found = wind_by_torques(TASK_SPACE, **_changes(wound, direction))
    if found.equilibrium is not Equilibrium.WINDING:
        raise ValueError(f"the arm does not wind around the {wound} from {direction}: {found.equilibrium}.")
    return wound_settings(wound, direction), found.q, np.flatnonzero(found.in_contact)


def wound_settings(wound: str, direction: str) -> WindingSettings:
    """Return the settings of the winding around an object of `OBJECTS`."""
    return torque_settings(**_changes(wound, direction))


def _changes(wound: str, direction: str) -> dict[str, Any]:
    shape, size = OBJECTS[wound]
    return {"shape": shape, "size": size, "direction": direction, "link": FIRST_LINK}


def free_model(settings: WindingSettings, friction: float) -> mujoco.MjModel:
    """Return arm and object, both with masses, the object free, with contacts between them, but none within the arm."""
    spec, wound = settings.arm.spec(), settings.wound_object()
    geom_type, count = SHAPES[wound.shape]
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, wound.rotation.ravel())
    body = spec.worldbody.add_body(name="object", pos=wound.position, quat=quaternion)
    body.add_freejoint()
    body.add_geom(name="object", type=geom_type, size=[*wound.size, *[0.0] * (3 - count)], mass=MASS)
    spec.option.timestep = settings.dt
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10.0  # friction as hard as the contact is: at 1 held objects creep
    for geom in spec.geoms:
        is_object = geom.name == "object"
        geom.contype, geom.conaffinity = int(is_object), int(not is_object)
        geom.friction[0] = friction
        if not is_object:
            geom.density = DENSITY
    model = spec.compile()
    joints = settings.arm.joint_count
    model.dof_damping[:joints], model.dof_armature[:joints], model.jnt_limited[:] = JOINT_DAMPING, ARMATURE, 0
    return model


JOINT_SPACE, TASK_SPACE = APPROACHES

#: Controls that hold, by name.
HOLDS: dict[str, Callable[[Scene], Control]] = {JOINT_SPACE: JointSpaceHold, TASK_SPACE: TaskSpaceHold}
