"""Robots at random configurations with mink's own tasks and limits, on which mink and its drop-in are compared.

The robots in `data/robots` and in the package are the project's own, one for each kind of joint and coupling. A seed
decides everything random: where the joints are, what is drawn where, gains and damping.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import mink
import mujoco
import numpy as np
from mink.tasks import BaseTask

from prioritized_ik.examples import example_model
from prioritized_ik.models import Arm
from prioritized_ik.validation import Array

DT = 0.05  # [s]
REACH = (-1.5, 0.0)  # [decades] how far targets are away [rad, m in slides]
SPEED = 1.0  # [rad/s, m/s] that limited scenes allow: 0.05 rad a step, less than most targets ask for
AT_LIMIT = 0.2  # of the joints of a limited scene stand at the end of their range
WANDER = 0.5  # [rad, m] how far joints without range are from where the model has them
ROUND = 0.9  # of its range is how far a ball joint is turned at most

SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))

SCENARIOS = ("free", "limited")


@dataclass(frozen=True)
class Machine:
    """A robot to compare on.

    Attributes:
        name: what tables call it.
        load: makes its model.
        frames: names and types of the frames that tasks draw.
        pairs: groups of geoms that must not collide, each with another; of limited scenes.
    """

    name: str
    load: Callable[[], mujoco.MjModel]
    frames: tuple[tuple[str, str], ...]
    pairs: tuple[tuple[tuple[str, ...], tuple[str, ...]], ...] = ()


def _own(name: str) -> Callable[[], mujoco.MjModel]:
    """Return what loads one of the project's own robots, once."""
    return cache(
        lambda: mujoco.MjModel.from_xml_string((files("comparisons") / f"data/robots/{name}.xml").read_text("utf-8"))
    )


#: The project's own robots, and the paper's arm.
MACHINES = (
    Machine("arm", cache(lambda: example_model("arm")), (("tool", "site"),), ((("hand",), ("post", "table")),)),
    Machine("mobile arm", _own("mobile"), (("tool", "site"),)),
    Machine("gantry", _own("gantry"), (("tool", "site"),)),
    Machine(
        "biped",
        cache(lambda: example_model("humanoid")),
        (("left foot", "site"), ("right foot", "site"), ("left hand", "site"), ("right hand", "site"), ("chest", "site")),
    ),
    Machine("ball joints", _own("ball"), (("tool", "site"), ("back", "body"))),
    Machine("four-bar", _own("four_bar"), (("tool", "site"),)),
    Machine("coupled hand", _own("hand"), (("index", "site"), ("ring", "site"))),
    Machine("winding arm", cache(lambda: Arm().spec().compile()), (("end_8", "site"), ("end_17", "site"))),
)


@dataclass(frozen=True)
class Scene:
    """One call of `solve_ik`, but for solver and damping."""

    configuration: mink.Configuration
    tasks: list[BaseTask]
    limits: list[mink.Limit]


def scene(machine: Machine, scenario: str, seed: int, *, posture: bool = True) -> Scene:
    """Return a random scene.

    Args:
        machine: the robot.
        scenario: "free", without limits, or "limited", with joint ranges, low speeds and collisions.
        seed: of all that is random.
        posture: whether a posture is among the tasks, and a centre of mass if the robot has a free base; frames alone leave
            many directions to the damping.
    """
    model, rng = machine.load(), np.random.default_rng([seed, SCENARIOS.index(scenario)])
    q = configured(model, rng, AT_LIMIT if scenario == "limited" else 0.0)
    other = q.copy()
    away = rng.normal(size=model.nv) * 10.0 ** rng.uniform(*REACH)
    mujoco.mj_integratePos(model, other, away, 1.0)
    there = posed(model, other)
    tasks: list[BaseTask] = []
    for name, kind in machine.frames:
        orientation = float(rng.choice([0.0, 0.3, 1.0]))
        damped = float(rng.choice([0.0, 0.01, 1.0]))
        task = mink.FrameTask(name, kind, 1.0, orientation, gain=float(rng.uniform(0.3, 1.0)), lm_damping=damped)
        task.set_target_from_configuration(there)
        tasks.append(task)
    tasks += [mink.EqualityConstraintTask(model, 10.0)] if model.neq else []
    if posture:
        tasks += list(_whole_body(model, there))
    return Scene(posed(model, q), tasks, _limits(machine, model) if scenario == "limited" else [])


def _whole_body(model: mujoco.MjModel, there: mink.Configuration) -> Iterator[BaseTask]:
    """Yield tasks that concern every joint."""
    task = mink.PostureTask(model, 1e-2)
    task.set_target(there.q)
    yield task
    if (model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).any():
        mass = mink.ComTask(0.5)
        mass.set_target_from_configuration(there)
        yield mass


def _limits(machine: Machine, model: mujoco.MjModel) -> list[mink.Limit]:
    scalar = np.flatnonzero(np.isin(model.jnt_type, SCALAR))
    slow = {model.joint(i).name: SPEED for i in map(int, scalar) if model.joint(i).name}
    limits: list[mink.Limit] = [mink.ConfigurationLimit(model), mink.VelocityLimit(model, slow)]
    if machine.pairs:
        limits.append(mink.CollisionAvoidanceLimit(model, machine.pairs, gain=DT, collision_detection_distance=0.3))
    return limits


def posed(model: mujoco.MjModel, q: Array) -> mink.Configuration:
    """Return mink's configuration at `q` `(nq,)`, its tendons up to date, which mink leaves to the caller."""
    configuration = mink.Configuration(model, q)
    if model.ntendon:
        mujoco.mj_tendon(model, configuration.data)
    if model.neq:
        mujoco.mj_makeConstraint(model, configuration.data)
    return configuration


def configured(model: mujoco.MjModel, rng: np.random.Generator, at_limit: float) -> Array:
    """Return a random configuration `(nq,)` in the joint ranges; a fraction `at_limit` of limited joints at their ends."""
    q, wander = model.qpos0.copy(), WANDER * rng.normal(size=model.nv)
    for joint in np.flatnonzero((model.jnt_type == mujoco.mjtJoint.mjJNT_BALL) & (model.jnt_limited != 0)):
        dofs = slice(model.jnt_dofadr[joint], model.jnt_dofadr[joint] + 3)
        wander[dofs] *= ROUND * rng.random() * model.jnt_range[joint, 1] / np.linalg.norm(wander[dofs])
    mujoco.mj_integratePos(model, q, wander, 1.0)
    joints = np.flatnonzero(np.isin(model.jnt_type, SCALAR) & (model.jnt_limited != 0))
    low, high = model.jnt_range[joints].T
    inside = rng.uniform(low, high)
    ends = np.where(rng.random(len(joints)) < 0.5, low, high)
    q[model.jnt_qposadr[joints]] = np.where(rng.random(len(joints)) < at_limit, ends, inside)
    return q
