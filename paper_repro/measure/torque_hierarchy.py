"""Torque as a hierarchy: limits of contact forces before the hold before the posture, by the kernel of the joint steps.

Unknown are the joints' accelerations d²θ/dt² `(m,)` and the force f `(3,)` of each wound link on the object. The torques
that make them come of the equations of motion, τ = M d²θ/dt² + h + J_cᵀ f, with M and h the arm's own (h: Coriolis forces,
weight and friction) and J_c the Jacobians of the points in contact. In strict order:

1. limits, as hard rows: of contact forces, along the normal at least `LEAST` and at most `MOST`, along the surface no
   more than the friction that is counted on; and of torques. Whatever the forces, some acceleration keeps the torques in
   their limits, as M is regular, so that all rows can always be kept: it is the hold that gives way;
2. the hold: the forces together carry the object's weight, and below that the links' ends stay where they were,
   d²X/dt² = K (X* - X) - D dX/dt;
3. the posture: so do the joints, in what is left, which is how links roll about themselves.

The hierarchy is told the object's mass, and what an accelerometer at its base feels; not where the object is.
"""

from collections import Counter

import mujoco
import numpy as np

from paper_repro.measure.holding import FRICTION, MASS, Scene, Trial
from prioritized_ik.problem import IKProblem, Level, Rows
from prioritized_ik.solvers.registry import DEFAULT, get_method
from prioritized_ik.solvers.solve import solve
from prioritized_ik.solvers.step import StepStatus
from prioritized_ik.validation import Array

PERIOD = 5  # steps of the dynamics a control step, in which the torques stay
LEAST, MOST = 4.0, 15.0  # [N] normal force of a wound link
COUNTED = 0.6  # of the friction coefficient: the rest is for what the plan does not know
PLACE_STIFFNESS, PLACE_DAMPING = 400.0, 40.0  # K [1/s²], D [1/s] of the links' ends: 3 Hz, well damped
POSTURE_STIFFNESS, POSTURE_DAMPING = 100.0, 20.0  # [1/s²], [1/s] of the joints
DAMPING = 1e-4  # [m²] of the ends' level: near straight runs of links the exact accelerations are as long as they like

#: Rows of a wound link's force: along the normal, and along the surface either way in two directions.
WAYS = ("most", "least", *(f"friction {way}" for way in range(1, 5)))


class HierarchyHold:
    """Torques by three strict levels, solved anew every `PERIOD` steps."""

    def __init__(self, scene: Scene, trial: Trial) -> None:
        self._scene, self._trial = scene, trial
        self._method = get_method(DEFAULT)
        self._tau = np.zeros(scene.joints)
        self._step = 0
        self.counts = Counter(uncertified=0, steps=0)

    def __call__(self, grip: float) -> Array:
        """Return the torques `(m,)` [N m]."""
        if self._step % PERIOD == 0:
            dynamics = Dynamics(self._scene)
            problem = dynamics.problem(grip, self._trial.torque_limit, COUNTED * FRICTION)
            self._tau = dynamics.torques(self._solved(problem))
        self._step += 1
        return self._tau

    def _solved(self, problem: IKProblem) -> Array:
        step = solve(problem, self._method)
        self.counts["steps"] += 1
        self.counts["uncertified"] += step.status is StepStatus.UNCERTIFIED
        return np.asarray(step.dtheta)  # `solve` raises where there is none


class Dynamics:
    """The arm's equations of motion and its contacts, as they are now."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        model, data, m = scene.model, scene.data, scene.joints
        mass = np.empty((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        self._touch = scene.touch()
        self._normals = self._touch.normal[scene.wound]
        self._bias = (data.qfrc_bias - data.qfrc_passive)[:m]
        points = self._touch.point[scene.wound]
        contacts = scene.sensor.jacobians.at(data, points, scene.wound)[:, :, :m].reshape(-1, m)
        self._to_torque = np.hstack([mass[:m, :m], contacts.T])

    def torques(self, unknowns: Array) -> Array:
        """Return τ = M d²θ/dt² + h + J_cᵀ f `(m,)` [N m] of accelerations and forces `(m + 3 c,)`."""
        return self._to_torque @ unknowns + self._bias

    def problem(self, grip: float, torque_limit: float, friction: float) -> IKProblem:
        """Return the hierarchy for accelerations of the joints and forces on the object `(m + 3 c,)`.

        Args:
            grip: how far it is closed, from 0 to 1.
            torque_limit: of every joint [N m].
            friction: coefficient that is counted on.
        """
        scene, m = self._scene, self._scene.joints
        data, jacobian = scene.data, scene.jacobian()
        count = 3 * len(scene.wound)
        off = scene.ends - scene.arms.positions(data)
        velocity = data.qvel[:m]
        ends = PLACE_STIFFNESS * off.ravel() - PLACE_DAMPING * (jacobian @ velocity)
        posture = POSTURE_STIFFNESS * (scene.q - data.qpos[:m]) - POSTURE_DAMPING * velocity
        forces = np.tile(np.eye(3), (1, len(scene.wound)))
        levels = (
            Level(np.hstack([np.zeros((3, m)), forces]), -MASS * scene.model.opt.gravity, name="weight of the object"),
            Level(np.hstack([jacobian, np.zeros((len(jacobian), count))]), ends, name="ends of links", damping=DAMPING),
            Level(np.eye(m, m + count), posture, name="posture"),
        )
        return IKProblem(levels, rows=self._rows(grip, torque_limit, friction))

    def _rows(self, grip: float, torque_limit: float, friction: float) -> Rows:
        m, wound = self._scene.joints, self._scene.wound
        limits, sides, names = (
            [self._to_torque, -self._to_torque],
            [torque_limit - self._bias, torque_limit + self._bias],
            [],
        )
        names += [f"torque of joint {joint + 1}, {side}" for side in ("most", "least") for joint in range(m)]
        for place, (link, normal) in enumerate(zip(wound, self._normals, strict=True)):
            across = np.linalg.svd(normal[None])[2][1:]  # two unit vectors along the surface
            pyramid = np.vstack([across, -across]) + friction * normal
            rows = np.zeros((6, m + 3 * len(wound)))
            rows[:, m + 3 * place : m + 3 * place + 3] = np.vstack([-normal, normal, pyramid])
            limits.append(rows)
            sides.append(np.array([MOST, -grip * LEAST, 0.0, 0.0, 0.0, 0.0]))
            names += [f"contact force of link {link + 1}, {way}" for way in WAYS]
        return Rows(np.vstack(limits), np.concatenate(sides), names)
