"""A robot at a configuration, and what its user may ask of it: levels and limits whose numbers are written in place.

A goal is bound to arrays once, and then writes what it is at the scene's present state as often as that changes: into those
of a new problem, or of one that lives.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from comparisons.robot_models import compiled
from prioritized_ik.limits import in_succession, joint_names, limited_scalars
from prioritized_ik.models import update_kinematics
from prioritized_ik.problem import Bounds, Equalities, Level, Rows
from prioritized_ik.validation import Array

AT_LIMIT = 0.15  # of a configuration's joints stand at a limit
NEAR_LIMIT = 0.15  # and as many nearer to one than a step is long
REACH = (-1.5, 0.7)  # [decades] how far targets are away, in longest steps
EASE = 0.02  # of the way to the middle of its range is what a posture asks of a joint

ACROSS = (slice(1, 3), slice(0, 3, 2), slice(0, 2))  # the other two axes

Write = Callable[[], object]


@dataclass(frozen=True)
class Goal:
    """Rows of a problem.

    Attributes:
        name: what a level is called; rows get it with their number.
        rows: k.
        bind: returns what writes matrix `(k, m)` and target `(k,)` at the scene's present state.
        weights: of a level's rows `(k,)`; ones unless given.
        kind: of a level.
    """

    name: str
    rows: int
    bind: Callable[[Array, Array], Write]
    weights: Array | None = None
    kind: str = "equal"

    def numbers(self, m: int) -> tuple[Array, Array]:
        """Return matrix `(k, m)` and target `(k,)` now."""
        matrix, target = np.zeros((self.rows, m)), np.zeros(self.rows)
        self.bind(matrix, target)()
        return matrix, target

    def level(self, m: int) -> Level:
        """Return them as a level."""
        return Level(*self.numbers(m), self.weights, self.name, self.kind)

    def row(self, m: int) -> Rows:
        """Return them as hard rows."""
        return Rows(*self.numbers(m), [self.name])

    def equality(self, m: int) -> Equalities:
        """Return them as hard equalities."""
        return Equalities(*self.numbers(m), [self.name])


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

    # Levels.

    def position(self, site: str) -> Goal:
        """Return a site's wanted position [m]."""
        return Goal(f"position of {site}", 3, lambda matrix, target: self._moving(site, matrix, target))

    def orientation(self, site: str) -> Goal:
        """Return a site's wanted orientation [rad]."""
        return Goal(f"orientation of {site}", 3, lambda matrix, target: self._turning(site, matrix, target))

    def pointing(self, site: str, axis: int) -> Goal:
        """Return where an axis of a site is to point: two rows, for its turn about itself is free."""
        across = self._axes(site)[0].T[ACROSS[axis]]

        def bind(matrix: Array, target: Array) -> Write:
            rotation, turn = np.zeros((3, self.model.nv)), np.zeros(3)
            turning = self._turning(site, rotation, turn)

            def write() -> None:
                turning()
                np.matmul(across, rotation, matrix)
                np.matmul(across, turn, target)

            return write

        return Goal(f"pointing of {site}", 2, bind)

    def pose(self, site: str, weights: Array) -> Goal:
        """Return a site's wanted position [m] and orientation [rad], in one."""

        def bind(matrix: Array, target: Array) -> Write:
            return both(self._moving(site, matrix[:3], target[:3]), self._turning(site, matrix[3:], target[3:]))

        return Goal(f"pose of {site}", 6, bind, weights)

    def positions(self, sites: Sequence[str], name: str) -> Goal:
        """Return several sites' wanted positions [m]."""
        places = [slice(3 * i, 3 * i + 3) for i in range(len(sites))]

        def bind(matrix: Array, target: Array) -> Write:
            return both(*(self._moving(site, matrix[rows], target[rows]) for site, rows in zip(sites, places, strict=True)))

        return Goal(name, 3 * len(sites), bind)

    def stay(self, sites: Iterable[str], name: str) -> Goal:
        """Return that sites are not to move or turn."""
        numbers = [self.model.site(site).id for site in sites]

        def bind(matrix: Array, target: Array) -> Write:
            target[:] = 0.0
            halves = [
                (number, matrix[6 * i : 6 * i + 3], matrix[6 * i + 3 : 6 * i + 6]) for i, number in enumerate(numbers)
            ]

            def write() -> None:
                for number, position, rotation in halves:
                    mujoco.mj_jacSite(self.model, self.now, position, rotation, number)

            return write

        return Goal(name, 6 * len(numbers), bind)

    def centre_of_mass(self) -> Goal:
        """Return the wanted centre of mass [m]."""
        here, there = self.now.subtree_com[0], self.wanted.subtree_com[0]

        def bind(matrix: Array, target: Array) -> Write:
            def write() -> None:
                mujoco.mj_jacSubtreeCom(self.model, self.now, matrix, 0)
                np.subtract(there, here, target)

            return write

        return Goal("centre of mass", 3, bind)

    def posture(self) -> Goal:
        """Return limited joints drawn to the middle of their ranges, each relative to its range."""
        joints, dofs, places = limited_scalars(self.model)
        low, high = self.model.jnt_range[joints].T
        middle, q, here = 0.5 * (low + high), self.now.qpos, in_succession(places)

        def bind(matrix: Array, target: Array) -> Write:
            matrix[:] = np.eye(self.model.nv)[dofs]

            def write() -> None:
                np.subtract(middle, q[here], target)
                np.multiply(EASE, target, target)

            return write

        return Goal("posture", len(joints), bind, (high - low) ** -2)

    def balance(self, feet: Sequence[str], margin: float) -> Goal:
        """Return the centre of mass kept between feet, and up to a margin [m] beside them: soft rows."""
        numbers = [self.model.site(foot).id for foot in feet]
        places, mass = self.now.site_xpos, self.now.subtree_com[0][:2]

        def bind(matrix: Array, target: Array) -> Write:
            jacobian = np.zeros((3, self.model.nv))

            def write() -> None:
                mujoco.mj_jacSubtreeCom(self.model, self.now, jacobian, 0)
                matrix[:2] = jacobian[:2]
                np.negative(jacobian[:2], matrix[2:])
                standing = places[numbers, :2]
                target[:2] = standing.max(axis=0) + margin - mass
                target[2:] = mass - standing.min(axis=0) + margin

            return write

        return Goal("balance", 4, bind, kind="at_most")

    # Limits.

    def above(self, site: str, height: float) -> Goal:
        """Return the row that keeps a site above a `height` [m], or from sinking where it is below."""
        number, place = self.model.site(site).id, self.now.site_xpos[self.model.site(site).id]

        def bind(matrix: Array, target: Array) -> Write:
            jacobian = np.zeros((3, self.model.nv))

            def write() -> None:
                mujoco.mj_jacSite(self.model, self.now, jacobian, None, number)
                np.negative(jacobian[2], matrix[0])
                target[0] = max(place[2] - height, 0.0)

            return write

        return Goal(f"{site} above the ground", 1, bind)

    def bounds(self) -> Bounds:
        """Return the joints' ranges and longest steps."""
        lower, upper = np.empty(self.model.nv), np.empty(self.model.nv)
        self.bind_bounds(lower, upper)()
        return Bounds(lower, upper, joint_names(self.model))

    def bind_bounds(self, lower: Array, upper: Array) -> Write:
        """Return what writes the bounds `(m,)`, as `limits.joint_range_bounds` within the longest steps."""
        joints, dofs, places = limited_scalars(self.model)
        low, high = self.model.jnt_range[joints].T.copy()
        q, most, least = self.now.qpos, self.step[dofs], -self.step[dofs]
        lower[:], upper[:] = -self.step, self.step
        here, limited = in_succession(places), in_succession(dofs)

        def write() -> None:
            position = q[here]
            lower[limited] = np.maximum(np.minimum(low - position, 0.0), least)
            upper[limited] = np.minimum(np.maximum(high - position, 0.0), most)

        return write

    # Parts of them.

    def _axes(self, site: str) -> tuple[Array, Array]:
        """Return a site's rotation matrices now and wanted, `(3, 3)` each, which follow the states."""
        number = self.model.site(site).id
        return self.now.site_xmat[number].reshape(3, 3), self.wanted.site_xmat[number].reshape(3, 3)

    def _moving(self, site: str, matrix: Array, target: Array) -> Write:
        """Return what writes the Jacobian of a site's position, and the way to where it is wanted."""
        model, now, number = self.model, self.now, self.model.site(site).id
        here, there = now.site_xpos[number], self.wanted.site_xpos[number]

        def write() -> None:
            mujoco.mj_jacSite(model, now, matrix, None, number)
            np.subtract(there, here, target)

        return write

    def _turning(self, site: str, matrix: Array, target: Array) -> Write:
        """Return what writes the Jacobian of a site's orientation, and the turn to the wanted one as a vector."""
        model, now, number = self.model, self.now, self.model.site(site).id
        (here, there), quaternion, turn = self._axes(site), np.empty(4), np.empty((3, 3))
        back, flat = here.T, turn.reshape(-1)

        def write() -> None:
            mujoco.mj_jacSite(model, now, None, matrix, number)
            np.matmul(there, back, turn)
            mujoco.mju_mat2Quat(quaternion, flat)
            mujoco.mju_quat2Vel(target, quaternion, 1.0)

        return write


def both(*writes: Write) -> Write:
    """Return what writes all of them."""

    def write() -> None:
        for each in writes:
            each()

    return write
