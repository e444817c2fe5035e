"""A robot at a configuration, and what its user may ask of it: levels and limits whose numbers are written in place.

A goal is bound to arrays once, and a `Posing` then writes what it is at the scene's present state as often as that changes:
into those of a new problem, or of one that lives.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial, reduce

import mujoco
import numpy as np

from comparisons.robot_models import compiled
from prioritized_ik.limits import joint_names, limited_scalars
from prioritized_ik.models import update_kinematics
from prioritized_ik.posing import Posing
from prioritized_ik.problem import Bounds, Equalities, Level, Rows
from prioritized_ik.robot import Frame
from prioritized_ik.validation import Array

AT_LIMIT = 0.15  # of a configuration's joints stand at a limit
NEAR_LIMIT = 0.15  # and as many nearer to one than a step is long
REACH = (-1.5, 0.7)  # [decades] how far targets are away, in longest steps
EASE = 0.02  # of the way to the middle of its range is what a posture asks of a joint


@dataclass(frozen=True)
class Goal:
    """Rows of a problem.

    Attributes:
        name: what a level is called; rows get it with their number.
        rows: k.
        bind: tells a `Posing` what to write to matrix `(k, m)` and target `(k,)`.
        weights: of a level's rows `(k,)`; ones unless given.
        kind: of a level.
    """

    name: str
    rows: int
    bind: Callable[[Posing, Array, Array], object]
    weights: Array | None = None
    kind: str = "equal"

    def numbers(self, scene: "Scene") -> tuple[Array, Array]:
        """Return matrix `(k, m)` and target `(k,)` now."""
        matrix, target = np.zeros((self.rows, scene.model.nv)), np.zeros(self.rows)
        posing = scene.posing()
        self.bind(posing, matrix, target)
        posing.by_python()
        return matrix, target

    def level(self, scene: "Scene") -> Level:
        """Return them as a level."""
        return Level(*self.numbers(scene), self.weights, self.name, self.kind)

    def row(self, scene: "Scene") -> Rows:
        """Return them as hard rows."""
        return Rows(*self.numbers(scene), [self.name])

    def equality(self, scene: "Scene") -> Equalities:
        """Return them as hard equalities."""
        return Equalities(*self.numbers(scene), [self.name])


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

    def posing(self) -> Posing:
        """Return what writes goals at the present state; nothing yet."""
        return Posing(self.model, self.now)

    def site(self, name: str) -> Frame:
        """Return the frame of a site."""
        return Frame("site", self.model.site(name).id, name)

    # Levels.

    def position(self, site: str) -> Goal:
        """Return a site's wanted position [m]."""
        return Goal(f"position of {site}", 3, partial(self._moving, site))

    def orientation(self, site: str) -> Goal:
        """Return a site's wanted orientation [rad]."""
        return Goal(f"orientation of {site}", 3, partial(self._turning, site))

    def pointing(self, site: str, axis: int) -> Goal:
        """Return where an axis of a site is to point: two rows, for its turn about itself is free."""
        across = np.delete(np.eye(3), axis, axis=0)
        return Goal(f"pointing of {site}", 2, partial(self._turning, site, across=across))

    def pose(self, site: str, weights: Array) -> Goal:
        """Return a site's wanted position [m] and orientation [rad], in one."""

        def bind(posing: Posing, matrix: Array, target: Array) -> None:
            self._moving(site, posing, matrix[:3], target[:3])
            self._turning(site, posing, matrix[3:], target[3:])

        return Goal(f"pose of {site}", 6, bind, weights)

    def positions(self, sites: Sequence[str], name: str) -> Goal:
        """Return several sites' wanted positions [m]."""

        def bind(posing: Posing, matrix: Array, target: Array) -> None:
            for i, site in enumerate(sites):
                self._moving(site, posing, matrix[3 * i : 3 * i + 3], target[3 * i : 3 * i + 3])

        return Goal(name, 3 * len(sites), bind)

    def stay(self, sites: Iterable[str], name: str) -> Goal:
        """Return that sites are not to move or turn."""
        frames = [self.site(site) for site in sites]

        def bind(posing: Posing, matrix: Array, target: Array) -> None:
            for i, frame in enumerate(frames):
                half, last = slice(6 * i, 6 * i + 3), slice(6 * i + 3, 6 * i + 6)
                posing.position(frame, None, matrix[half], target[half])
                posing.orientation(frame, None, matrix[last], target[last])

        return Goal(name, 6 * len(frames), bind)

    def centre_of_mass(self) -> Goal:
        """Return the wanted centre of mass [m]."""
        there = self.wanted.subtree_com[0]
        return Goal("centre of mass", 3, lambda posing, matrix, target: posing.centre_of_mass(0, there, matrix, target))

    def posture(self) -> Goal:
        """Return limited joints drawn to the middle of their ranges, each relative to its range."""
        joints, dofs, places = limited_scalars(self.model)
        low, high = self.model.jnt_range[joints].T
        middle = 0.5 * (low + high)

        def bind(posing: Posing, matrix: Array, target: Array) -> None:
            matrix[:] = np.eye(self.model.nv)[dofs]
            posing.joints(places, middle, target, EASE)

        return Goal("posture", len(joints), bind, (high - low) ** -2)

    def balance(self, feet: Sequence[str], margin: float) -> Goal:
        """Return the centre of mass kept between feet, and up to a margin [m] beside them: soft rows."""
        standing = [self.now.site_xpos[self.model.site(foot).id, :2] for foot in feet]
        mass, both = self.now.subtree_com[0][:2], np.vstack([np.eye(2, 3), -np.eye(2, 3)])

        def bind(posing: Posing, matrix: Array, target: Array) -> None:
            above, below = target[:2], target[2:]
            posing.centre_of_mass(0, None, matrix, target, across=both)

            def write() -> None:
                np.subtract(reduce(np.maximum, standing), mass, out=above)
                np.subtract(mass, reduce(np.minimum, standing), out=below)
                np.add(target, margin, out=target)

            posing.also(write)

        return Goal("balance", 4, bind, kind="at_most")

    # Limits.

    def above(self, site: str, height: float) -> Goal:
        """Return the row that keeps a site above a `height` [m], or from sinking where it is below."""
        frame, ground, down = self.site(site), np.array([0.0, 0.0, height]), [[0.0, 0.0, -1.0]]

        def bind(posing: Posing, matrix: Array, target: Array) -> None:
            posing.position(frame, ground, matrix, target, across=down, floored=True)

        return Goal(f"{site} above the ground", 1, bind)

    def bounds(self) -> Bounds:
        """Return the joints' ranges and longest steps."""
        lower, upper = np.empty(self.model.nv), np.empty(self.model.nv)
        posing = self.posing()
        posing.bounds(lower, upper, self.step)
        posing.by_python()
        return Bounds(lower, upper, joint_names(self.model))

    # Parts of them.

    def _moving(self, site: str, posing: Posing, matrix: Array, target: Array) -> None:
        """Have the Jacobian of a site's position written, and the way to where it is wanted."""
        frame = self.site(site)
        posing.position(frame, self.wanted.site_xpos[frame.number], matrix, target)

    def _turning(self, site: str, posing: Posing, matrix: Array, target: Array, across: Array | None = None) -> None:
        """Have the Jacobian of a site's orientation written, and the turn to the wanted one as a vector.

        `across`: of it only what is about these of the site's own axes `(k, 3)`.
        """
        frame = self.site(site)
        posing.orientation(frame, self.wanted.site_xmat[frame.number], matrix, target, across=across, own_axes=True)
