"""Winding with a chain of links of any robot around a geom of its model."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from prioritized_ik.errors import InputError
from prioritized_ik.problem import IKProblem
from prioritized_ik.recording import Recording
from prioritized_ik.robot import Robot
from prioritized_ik.solvers.methods import Method
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.touch import OBJECT
from prioritized_ik.validation import Array, read_only
from prioritized_ik.winding.chain import Chain, with_capsules
from prioritized_ik.winding.controller import ChainController
from prioritized_ik.winding.loop import Outcome, moments
from prioritized_ik.winding.metrics import ROUND_SHAPES, WindingMetrics, bends, drift, ideal_angle, sign_flips, turns_about
from prioritized_ik.winding.plan import driven_arms, first_and_last_in_contact
from prioritized_ik.winding.settings import Control

_ROUND = tuple(int(getattr(mujoco.mjtGeom, f"mjGEOM_{shape.upper()}")) for shape in ROUND_SHAPES)


@dataclass(frozen=True, eq=False)
class RobotWinding(Control):
    """Settings of a winding with one's own robot: `Control`, and the chain and object themselves.

    The links are those bodies on the way from the base to the tip that have a capsule, of whatever lengths; the object is
    any convex geom. At the start a link touches it. Where the links have cylinders instead, as those of a URDF, they are
    rounded off to capsules in a copy of the model.

    Attributes:
        model: robot and object.
        q: where it starts `(nq,)`.
        tip: the last body of the chain, by name or number; the last of the model unless given.
        wound: the object's geom, by name or number, or the name of a body that has no other.

    Raises:
        InputError: see `Control`; a body or geom that does not exist, a position of another length, or no link touches.
        ModelError: fewer than two links.
    """

    model: mujoco.MjModel = field(kw_only=True)
    q: Array = field(kw_only=True)
    tip: str | int | None = None
    wound: str | int = OBJECT

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "model", with_capsules(self.model, self._tip(Robot(self.model))))
        chain = self.chain()
        object.__setattr__(self, "q", read_only(chain.robot.q))
        distance = chain.sensor.read(chain.robot.data).distance
        nearest = int(distance.argmin())
        if distance[nearest] > self.contact_distance:
            far = f"{distance[nearest]:.4g} m" if distance[nearest] < self.reach else f"more than {self.reach:g} m"
            raise InputError(
                f"no link touches {chain.sensor.object_name!r} at the start: the nearest, link {nearest + 1}, is {far} "
                f"away; expected at most {self.contact_distance:g} m. Start elsewhere, or move the object."
            )

    def chain(self) -> Chain:
        """Return the chain that winds, at the start."""
        robot = Robot(self.model, self.q)
        return Chain.of_robot(robot, self._tip(robot), self.wound, self.reach)

    def _tip(self, robot: Robot) -> int:
        return int(self.model.nbody) - 1 if self.tip is None else robot.body(self.tip)


@dataclass(frozen=True, eq=False)
class WoundRobot:
    """What came of T steps of a chain of n links, L = 3 n; the last state, T, has no step.

    Attributes:
        settings: what decided it.
        outcome: how it ended.
        message: the solver's own words, if it failed.
        q: positions `(T + 1, nq)`.
        positions: far ends of the links `(T + 1, n, 3)` [m].
        directions: of the links `(T + 1, n, 3)`.
        distance: of each link to the object `(T + 1, n)` [m]; no more than `Control.reach`.
        in_contact: M `(T + 1, n)`.
        signs: s of Eq. (21) `(T + 1, n)`.
        problems: of the steps.
        dtheta: the steps `(T, nv)`; NaN where the solver failed.
    """

    settings: RobotWinding
    outcome: Outcome
    message: str
    q: Array
    positions: Array
    directions: Array
    distance: Array
    in_contact: NDArray[np.bool_]
    signs: Array
    problems: tuple[IKProblem, ...]
    dtheta: Array

    @property
    def steps(self) -> int:
        """Number of steps T."""
        return len(self.problems)

    def recording(self) -> Recording:
        """Return its problems and steps, to be saved."""
        return Recording.of(self.problems, self.q[: self.steps], self.dtheta, self.outcome.name)


def wind_robot(
    settings: RobotWinding, method: Method | None = None, on_step: Callable[[int], object] | None = None
) -> WoundRobot:
    """Return what comes of a robot that winds until equilibrium, a failed step, or `max_steps`.

    Args:
        settings: everything that decides it.
        method: finds the steps, instead of the one that `settings.solver` names.
        on_step: called after each step, with how many there are.

    Raises:
        SolverUnavailableError: the solver is unknown or not installed.
        InputError: the robot starts outside its joint ranges.
    """
    method = method or get_method(settings.solver, settings.options.accuracy)
    seen, steps = [], []
    for moment in moments(ChainController(settings, settings.chain()), method, settings.q):
        seen.append(moment)
        if moment.step is not None and moment.problem is not None:
            steps.append((moment.problem, moment.step))
            if on_step is not None:
                on_step(len(steps))
    outcome, message = seen[-1].ending
    if outcome is Outcome.SOLVER_FAILED:
        seen.append(seen[-1])
    missing = np.full(settings.model.nv, np.nan)
    dtheta = [missing if step.dtheta is None else step.dtheta for _, step in steps]
    return WoundRobot(
        settings,
        outcome,
        message,
        np.array([moment.q for moment in seen]),
        np.array([moment.situation.positions for moment in seen]),
        np.array([moment.situation.directions for moment in seen]),
        np.array([moment.situation.touch.distance for moment in seen]),
        np.array([moment.situation.in_contact for moment in seen]),
        np.array([moment.situation.signs for moment in seen]),
        tuple(problem for problem, _ in steps),
        np.reshape(dtheta, (len(steps), settings.model.nv)),
    )


def measure_robot(wound: WoundRobot) -> WindingMetrics:
    """Return the figures of a winding; the ideal: links that touch a round object in their middles, None of another."""
    chain = wound.settings.chain()
    chain.robot.update(wound.q[-1])
    geom, data = chain.sensor.object, chain.robot.data
    first = first_and_last_in_contact(wound.in_contact[0])[0]
    middles = wound.positions[-1] - 0.5 * chain.lengths[:, None] * wound.directions[-1]
    rotation = data.geom_xmat[geom].reshape(3, 3)
    turns = turns_about(middles[first - 1 :], data.geom_xpos[geom], rotation)
    ideal = None
    if chain.robot.model.geom_type[geom] in _ROUND and first < chain.count:
        tilt = math.asin(min(abs(float(wound.directions[0, first - 1] @ rotation[:, 2])), 1.0))
        distance = chain.robot.model.geom_size[geom, 0] + chain.robot.model.geom_size[chain.sensor.links, 0]
        angles = np.array([ideal_angle(*link, tilt) for link in zip(chain.lengths, distance, strict=True)])
        ideal = 0.5 * float((angles[first - 1 : -1] + angles[first:]).sum()) / (2.0 * math.pi)
    return WindingMetrics(
        turns=turns,
        turns_ratio=turns / ideal if ideal else None,
        penetration=-float(wound.distance.min()),
        bend=float(bends(wound.directions).max(initial=0.0)),
        hinge_excess=_excess(chain.robot.model, wound.q),
        drift=drift(wound),
        steps=wound.steps,
        driven_together=int(sum(driven_arms(contact).sum() > 1 for contact in wound.in_contact)),
        flips=sign_flips(wound.signs),
    )


def _excess(model: mujoco.MjModel, q: Array) -> float:
    """Return how far any limited hinge or slide was outside its range [rad, m]; negative inside."""
    scalar = np.isin(model.jnt_type, (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)))
    joints = np.flatnonzero(scalar & (model.jnt_limited != 0))
    here, (low, high) = q[:, model.jnt_qposadr[joints]], model.jnt_range[joints].T
    return float(np.maximum(low - here, here - high).max(initial=-np.inf))
