"""Joint steps of robots as people have them: hierarchies of real tasks in metres and radians, from MuJoCo's Jacobians.

A robot's structure is fixed: its levels, limits, rows and equalities. Random are only its configuration, where some joints
stand at a limit or near it, and its targets: what it would see at another configuration, near or out of reach of a step.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import mujoco
import numpy as np

from prioritized_ik.limits import joint_names, joint_range_bounds
from prioritized_ik.models import update_kinematics
from prioritized_ik.problem import Bounds, Equalities, IKProblem, Level, Rows
from prioritized_ik.validation import Array

Vector = tuple[float, float, float]

AT_LIMIT = 0.15  # of a configuration's joints stand at a limit
NEAR_LIMIT = 0.15  # and as many nearer to one than a step is long
REACH = (-1.5, 0.7)  # [decades] how far targets are away, in longest steps
EASE = 0.02  # of the way to the middle of its range is what a posture asks of a joint

AXES = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1", "-y": "0 -1 0", "-z": "0 0 -1"}


@dataclass(frozen=True)
class Joint:
    """A joint and the body that it moves, whose frame is the parent's at zero: `offset` [m] from it, range in rad or m."""

    name: str
    axis: str
    offset: Vector
    range: tuple[float, float]
    kind: str = "hinge"


def chain(joints: Iterable[Joint], inside: str) -> str:
    """Return nested bodies, one a joint, as MJCF; `inside` is what the last one holds."""
    text = inside
    for joint in reversed(list(joints)):
        place, ends = " ".join(map(str, joint.offset)), " ".join(map(str, joint.range))
        text = (
            f'<body name="{joint.name}" pos="{place}">'
            f'<joint name="{joint.name}" type="{joint.kind}" axis="{AXES[joint.axis]}" range="{ends}"/>'
            f'<geom type="sphere" size="0.05"/>{text}</body>'
        )
    return text


def site(name: str, *offset: float) -> str:
    """Return a site at `offset` [m] as MJCF."""
    return f'<site name="{name}" pos="{" ".join(map(str, offset))}"/>'


def mjcf(bodies: str) -> str:
    """Return the MJCF of a model that holds `bodies`."""
    return f'<mujoco><compiler angle="radian" autolimits="true"/><worldbody>{bodies}</worldbody></mujoco>'


# Models: dimensions in the size and ranges of machines that exist.


ARM_7 = mjcf(
    chain(
        [
            Joint("base", "z", (0, 0, 0.333), (-2.9, 2.9)),
            Joint("shoulder", "y", (0, 0, 0), (-1.76, 1.76)),
            Joint("upper arm", "z", (0, 0, 0.316), (-2.9, 2.9)),
            Joint("elbow", "-y", (0.0825, 0, 0), (-3.07, -0.07)),
            Joint("forearm", "z", (-0.0825, 0, 0.384), (-2.9, 2.9)),
            Joint("wrist", "-y", (0, 0, 0), (-0.02, 3.75)),
            Joint("flange", "-z", (0.088, 0, 0), (-2.9, 2.9)),
        ],
        site("tool", 0, 0, -0.21),
    )
)

INDUSTRIAL_6 = mjcf(
    chain(
        [
            Joint("axis 1", "z", (0, 0, 0.495), (-3.14, 3.14)),
            Joint("axis 2", "y", (0.175, 0, 0), (-1.57, 2.61)),
            Joint("axis 3", "y", (0, 0, 1.095), (-3.14, 1.3)),
            Joint("axis 4", "x", (0.3, 0, 0.175), (-6.98, 6.98)),
            Joint("axis 5", "y", (0.97, 0, 0), (-2.18, 2.09)),
            Joint("axis 6", "x", (0.135, 0, 0), (-6.98, 6.98)),
        ],
        site("tool", 0.3, 0, 0.1),
    )
)

MOBILE_ARM = mjcf(
    chain(
        [
            Joint("drive x", "x", (0, 0, 0.3), (-20.0, 20.0), "slide"),
            Joint("drive y", "y", (0, 0, 0), (-20.0, 20.0), "slide"),
            Joint("turn", "z", (0, 0, 0), (-30.0, 30.0)),
            Joint("pan", "z", (0.2, 0, 0.4), (-6.28, 6.28)),
            Joint("lift", "y", (0, 0.136, 0), (-6.28, 6.28)),
            Joint("elbow", "y", (0.425, -0.12, 0), (-3.14, 3.14)),
            Joint("wrist 1", "y", (0.392, 0, 0), (-6.28, 6.28)),
            Joint("wrist 2", "-z", (0, 0.093, 0), (-6.28, 6.28)),
            Joint("wrist 3", "y", (0, 0, -0.095), (-6.28, 6.28)),
        ],
        site("tool", 0, 0.18, 0),
    )
)

GANTRY = mjcf(
    chain(
        [
            Joint("bridge", "x", (0, 0, 5.0), (0.0, 15.0), "slide"),
            Joint("trolley", "y", (0, 0, 0), (0.0, 8.0), "slide"),
            Joint("column", "z", (0, 0, 0), (-4.0, 0.0), "slide"),
            Joint("wrist 1", "z", (0, 0, -0.4), (-3.14, 3.14)),
            Joint("wrist 2", "y", (0, 0, 0), (-2.0, 2.0)),
            Joint("wrist 3", "x", (0, 0, -0.3), (-1.5, 1.5)),
        ],
        site("tool", 0, 0, -0.5),
    )
)

SCARA = mjcf(
    chain(
        [
            Joint("shoulder", "z", (0, 0, 0.4), (-2.3, 2.3)),
            Joint("elbow", "z", (0.3, 0, 0), (-2.6, 2.6)),
            Joint("second elbow", "z", (0.25, 0, 0), (-2.6, 2.6)),
            Joint("quill", "z", (0.2, 0, 0), (-0.2, 0.0), "slide"),
            Joint("roll", "z", (0, 0, 0), (-6.28, 6.28)),
        ],
        site("tool", 0.05, 0, -0.1),
    )
)


def _leg(side: str, y: float) -> str:
    joints = [
        Joint(f"{side} hip yaw", "z", (0, y, -0.08), (-0.8, 0.8)),
        Joint(f"{side} hip roll", "x", (0, 0, 0), (-0.6, 0.6)),
        Joint(f"{side} hip pitch", "y", (0, 0, -0.04), (-2.0, 0.7)),
        Joint(f"{side} knee", "y", (0, 0, -0.38), (0.0, 2.4)),
        Joint(f"{side} ankle pitch", "y", (0, 0, -0.38), (-0.9, 0.6)),
        Joint(f"{side} ankle roll", "x", (0, 0, 0), (-0.5, 0.5)),
    ]
    return chain(
        joints, site(f"{side} foot", 0.03, 0, -0.07) + '<geom type="box" size="0.1 0.05 0.02" pos="0.03 0 -0.05"/>'
    )


def _arm(side: str, y: float) -> str:
    joints = [
        Joint(f"{side} shoulder pitch", "y", (0, y, 0.3), (-3.0, 1.0)),
        Joint(f"{side} shoulder roll", "x", (0, 0, 0), (-1.6, 1.6)),
        Joint(f"{side} shoulder yaw", "z", (0, 0, -0.05), (-1.5, 1.5)),
        Joint(f"{side} elbow", "y", (0, 0, -0.24), (-2.4, 0.0)),
        Joint(f"{side} forearm", "z", (0, 0, -0.12), (-1.5, 1.5)),
    ]
    return chain(joints, site(f"{side} hand", 0.02, 0, -0.2))


HUMANOID = mjcf(
    '<body name="pelvis" pos="0 0 0.95"><freejoint name="float"/><geom type="box" size="0.1 0.15 0.08"/>'
    + _leg("left", 0.09)
    + _leg("right", -0.09)
    + chain(
        [Joint("waist yaw", "z", (0, 0, 0.1), (-1.2, 1.2)), Joint("waist pitch", "y", (0, 0, 0.05), (-0.4, 1.0))],
        '<geom type="box" size="0.1 0.15 0.2" pos="0 0 0.2"/>'
        + _arm("left", 0.2)
        + _arm("right", -0.2)
        + chain([Joint("neck", "z", (0, 0, 0.45), (-1.4, 1.4))], site("eyes", 0.08, 0, 0.1)),
    )
    + "</body>"
)

# Steps.


@dataclass(frozen=True)
class Scene:
    """A robot at a configuration, and what it is drawn to: itself at another one.

    Attributes:
        model: of the robot.
        now: its state at the configuration, positions and terms for Jacobians up to date.
        wanted: the same at the other one.
        step: longest step of each degree of freedom `(m,)` [rad, m].
    """

    model: mujoco.MjModel
    now: mujoco.MjData
    wanted: mujoco.MjData
    step: Array

    @staticmethod
    def of(text: str, seed: int, slide: float, hinge: float, wandering: float) -> "Scene":
        """Return a random scene of the robot `text`.

        Args:
            text: its MJCF.
            seed: of all that is random.
            slide: longest step of a slide, and of a free joint's position [m].
            hinge: longest step of a hinge, and of a free joint's orientation [rad].
            wandering: how far a free joint is from where the model has it [m, rad].
        """
        model, rng = compiled(text), np.random.default_rng(seed)
        kinds = model.jnt_type[model.dof_jntid]
        step = np.where(kinds == mujoco.mjtJoint.mjJNT_SLIDE, slide, hinge)
        step[: 3 * (kinds[0] == mujoco.mjtJoint.mjJNT_FREE)] = slide
        q = model.qpos0.copy()
        if kinds[0] == mujoco.mjtJoint.mjJNT_FREE:
            mujoco.mj_integratePos(model, q, wandering * rng.normal(size=model.nv), 1.0)
        limited = np.flatnonzero(model.jnt_limited)
        low, high = model.jnt_range[limited].T
        longest = step[model.jnt_dofadr[limited]]
        case, upper = rng.random(limited.size), rng.random(limited.size) < 0.5
        room = np.where(case < AT_LIMIT, 0.0, np.minimum(0.8 * longest, high - low) * rng.random(limited.size))
        at_end = np.where(upper, high - room, low + room)
        q[model.jnt_qposadr[limited]] = np.where(case < AT_LIMIT + NEAR_LIMIT, at_end, rng.uniform(low, high))
        away = step * rng.normal(size=model.nv) * 10.0 ** rng.uniform(*REACH)
        other = q.copy()
        mujoco.mj_integratePos(model, other, away, 1.0)
        now, wanted = mujoco.MjData(model), mujoco.MjData(model)
        update_kinematics(model, now, q)
        update_kinematics(model, wanted, other)
        return Scene(model, now, wanted, step)

    def jacobians(self, site_name: str) -> tuple[Array, Array]:
        """Return the Jacobians of a site's position and orientation, each `(3, m)`."""
        position, rotation = np.empty((3, self.model.nv)), np.empty((3, self.model.nv))
        mujoco.mj_jacSite(self.model, self.now, position, rotation, self.model.site(site_name).id)
        return position, rotation

    def turn(self, site_name: str) -> Array:
        """Return the rotation from where a site is turned to where it is wanted, as a vector `(3,)` [rad]."""
        now, wanted = (data.site(site_name).xmat.reshape(3, 3) for data in (self.now, self.wanted))
        quaternion, vector = np.empty(4), np.empty(3)
        mujoco.mju_mat2Quat(quaternion, (wanted @ now.T).ravel())
        mujoco.mju_quat2Vel(vector, quaternion, 1.0)
        return vector

    def position(self, site_name: str, weights: Array | None = None) -> Level:
        """Return the level of a site's wanted position [m]."""
        target = self.wanted.site(site_name).xpos - self.now.site(site_name).xpos
        return Level(self.jacobians(site_name)[0], target, weights, f"position of {site_name}")

    def orientation(self, site_name: str) -> Level:
        """Return the level of a site's wanted orientation [rad]."""
        return Level(self.jacobians(site_name)[1], self.turn(site_name), name=f"orientation of {site_name}")

    def pointing(self, site_name: str, axis: int) -> Level:
        """Return the level of where an axis of a site is to point: two rows, for its turn about itself is free."""
        across = np.delete(self.now.site(site_name).xmat.reshape(3, 3), axis, axis=1).T
        rotation = self.jacobians(site_name)[1]
        return Level(across @ rotation, across @ self.turn(site_name), name=f"pointing of {site_name}")

    def pose(self, site_name: str, weights: Array) -> Level:
        """Return one level of a site's wanted position [m] and orientation [rad]."""
        way = self.wanted.site(site_name).xpos - self.now.site(site_name).xpos
        target = np.concatenate([way, self.turn(site_name)])
        return Level(np.vstack(self.jacobians(site_name)), target, weights, f"pose of {site_name}")

    def positions(self, sites: Sequence[str], name: str) -> Level:
        """Return one level of several sites' wanted positions [m]."""
        matrix = np.vstack([self.jacobians(site_name)[0] for site_name in sites])
        ways = [self.wanted.site(site_name).xpos - self.now.site(site_name).xpos for site_name in sites]
        return Level(matrix, np.concatenate(ways), name=name)

    def stay(self, sites: Iterable[str], name: str) -> Level:
        """Return the level of sites that are not to move or turn."""
        matrix = np.vstack([jacobian for site_name in sites for jacobian in self.jacobians(site_name)])
        return Level(matrix, np.zeros(len(matrix)), name=name)

    def centre_of_mass(self) -> Level:
        """Return the level of the wanted centre of mass [m]."""
        target = self.wanted.subtree_com[0] - self.now.subtree_com[0]
        return Level(self.jacobian_of_mass(), target, name="centre of mass")

    def jacobian_of_mass(self) -> Array:
        """Return the Jacobian of the centre of mass `(3, m)`."""
        jacobian = np.empty((3, self.model.nv))
        mujoco.mj_jacSubtreeCom(self.model, self.now, jacobian, 0)
        return jacobian

    def posture(self) -> Level:
        """Return the level of limited joints that are drawn to the middle of their ranges, each relative to its range."""
        joints = np.flatnonzero(self.model.jnt_limited)
        low, high = self.model.jnt_range[joints].T
        target = EASE * (0.5 * (low + high) - self.now.qpos[self.model.jnt_qposadr[joints]])
        return Level(np.eye(self.model.nv)[self.model.jnt_dofadr[joints]], target, (high - low) ** -2, "posture")

    def bounds(self) -> Bounds:
        """Return the joints' ranges and longest steps."""
        return joint_range_bounds(self.model, self.now.qpos).intersect(self._longest)

    @cached_property
    def _longest(self) -> Bounds:
        """The longest steps, which the scene's state does not change."""
        return Bounds(-self.step, self.step, joint_names(self.model))

    def above(self, site_name: str, height: float) -> Rows:
        """Return the row that keeps a site above a `height` [m], or from sinking where it is below."""
        room = max(self.now.site(site_name).xpos[2] - height, 0.0)
        return Rows(-self.jacobians(site_name)[0][2:], [room], [f"{site_name} above the ground"])


@cache
def compiled(text: str) -> mujoco.MjModel:
    """Return the model of an MJCF text."""
    return mujoco.MjModel.from_xml_string(text)


# Hierarchies.


@dataclass(frozen=True)
class Robot:
    """A robot and what its user asks of it.

    Attributes:
        text: its MJCF.
        levels: what makes each level of a scene, the most important first.
        slide: longest step of a slide, and of a free joint's position [m].
        hinge: longest step of a hinge, and of a free joint's orientation [rad].
        wandering: how far a free joint is from where the model has it [m, rad].
        rows: what makes its hard rows, if it has any.
        equalities: what makes its hard equalities, if it has any.
    """

    text: str
    levels: tuple[Callable[[Scene], Level], ...]
    slide: float = 0.05
    hinge: float = 0.1
    wandering: float = 0.0
    rows: Callable[[Scene], Rows] | None = None
    equalities: Callable[[Scene], Equalities] | None = None

    def scene(self, seed: int) -> Scene:
        """Return the random scene of `seed`."""
        return Scene.of(self.text, seed, self.slide, self.hinge, self.wandering)

    def problem(self, scene: Scene, levels: int | None = None) -> IKProblem:
        """Return the problem of a scene's next step, with the first `levels` only if given."""
        return IKProblem(
            [level(scene) for level in self.levels[:levels]],
            scene.bounds(),
            None if self.rows is None else self.rows(scene),
            equalities=None if self.equalities is None else self.equalities(scene),
        )


def base_at_rest(scene: Scene) -> Level:
    """Return the level of a base of two slides and a hinge that is not to move."""
    return Level(np.eye(scene.model.nv)[:3], np.zeros(3), [1.0, 1.0, 0.25], "base at rest")


def no_slip(scene: Scene) -> Equalities:
    """Return the equality of wheels that do not slip sideways."""
    heading = scene.now.qpos[2]
    sideways = np.zeros((1, scene.model.nv))
    sideways[0, :2] = -np.sin(heading), np.cos(heading)
    return Equalities(sideways, [0.0], ["no slip"])


def balance(scene: Scene) -> Level:
    """Return the soft level that keeps the centre of mass between the feet."""
    feet = np.array([scene.now.site(f"{side} foot").xpos[:2] for side in ("left", "right")])
    jacobian, mass = scene.jacobian_of_mass()[:2], scene.now.subtree_com[0][:2]
    room = np.concatenate([feet.max(axis=0) + 0.05 - mass, mass - feet.min(axis=0) + 0.05])
    return Level(np.vstack([jacobian, -jacobian]), room, name="balance", kind="at_most")


ROBOTS: dict[str, Robot] = {
    # A redundant arm on a table.
    "arm of 7 joints": Robot(
        ARM_7,
        (lambda scene: scene.position("tool"), lambda scene: scene.orientation("tool"), Scene.posture),
        rows=lambda scene: scene.above("tool", 0.05),
    ),
    # A large arm with a tool that is round.
    "industrial arm": Robot(
        INDUSTRIAL_6,
        (lambda scene: scene.position("tool"), lambda scene: scene.pointing("tool", axis=0), Scene.posture),
        hinge=0.05,
        rows=lambda scene: scene.above("tool", 0.3),
    ),
    # An arm on wheels, which do not slip sideways; 10 mm count as 0.1 rad.
    "arm on wheels": Robot(
        MOBILE_ARM,
        (lambda scene: scene.pose("tool", np.repeat([100.0, 1.0], 3)), base_at_rest, Scene.posture),
        rows=lambda scene: scene.above("tool", 0.1),
        equalities=no_slip,
    ),
    # A crane of 15 m with a wrist.
    "gantry": Robot(
        GANTRY,
        (lambda scene: scene.position("tool"), lambda scene: scene.pointing("tool", axis=2), Scene.posture),
        slide=0.5,
        rows=lambda scene: scene.above("tool", 0.2),
    ),
    # An arm that turns about one axis only, so that its orientation has rank 1.
    "SCARA": Robot(
        SCARA,
        (lambda scene: scene.position("tool"), lambda scene: scene.orientation("tool"), Scene.posture),
        slide=0.02,
        rows=lambda scene: scene.above("tool", 0.15),
    ),
    "humanoid": Robot(
        HUMANOID,
        (
            lambda scene: scene.stay(["left foot", "right foot"], "feet"),
            balance,
            Scene.centre_of_mass,
            lambda scene: scene.positions(["left hand", "right hand"], "hands"),
            lambda scene: scene.pointing("eyes", axis=0),
            Scene.posture,
        ),
        wandering=0.1,
    ),
}


def robot_steps(name: str, seed: int) -> IKProblem:
    """Return a random step of the robot `name`, a key of `ROBOTS`."""
    robot = ROBOTS[name]
    return robot.problem(robot.scene(seed))
