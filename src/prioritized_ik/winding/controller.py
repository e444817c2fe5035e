"""From the arm's state to the problem of its next step: touch, plan, weights, limits (Sec. 4.2)."""

from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.late import Late
from prioritized_ik.limits import CONTACT_MARGIN, contact_row_name, contact_rows, joint_range_bounds, step_bounds
from prioritized_ik.problem import Bounds, IKProblem, Level, Rows, trusted, trusted_level, trusted_problem
from prioritized_ik.solvers.tree.step import goes_along_links
from prioritized_ik.touch import Touch, update_contact
from prioritized_ik.validation import Array, read_only
from prioritized_ik.weights import diagonal_of_weights, winding_priorities, winding_weights
from prioritized_ik.winding.chain import Chain
from prioritized_ik.winding.compiled import CompiledLook, PackedPose, Parts, compiled_look, parts_of, same_look
from prioritized_ik.winding.on_tree import OnTree, level_on_tree
from prioritized_ik.winding.plan import driven_arms, first_and_last_in_contact, plan
from prioritized_ik.winding.settings import Control, WindingSettings

AXES = 3  # rows of one virtual arm: x, y, z


class Equilibrium(Enum):
    """The two states in which every desired displacement is zero (Sec. 4.2)."""

    WINDING = "state [1]: every link from k on is in contact"
    FREE = "state [2]: no link is in contact"


@dataclass(frozen=True)
class Situation:
    """What the controller knows at one instant.

    Attributes:
        positions: end points `(n, 3)` [m].
        directions: a, unit directions of the links `(n, 3)`.
        touch: distances, normals, nearest points.
        in_contact: M `(n,)`.
        contact_vectors: c `(n, 3)`, zero without contact.
        first, last: the first link in contact, and the last of those in succession with it; 0 if none.
        desired: dX* `(n, 3)` [m].
        signs: s of Eq. (21) `(n,)`.
    """

    positions: Array
    directions: Array
    touch: Touch
    in_contact: NDArray[np.bool_]
    contact_vectors: Array
    first: int
    last: int
    desired: Array
    signs: Array

    @property
    def equilibrium(self) -> Equilibrium | None:
        """Which equilibrium this is, or None while an arm is driven."""
        if driven_arms(self.in_contact).any():
            return None
        return Equilibrium.WINDING if self.in_contact.any() else Equilibrium.FREE


class SeenByCore(Situation):
    """A situation as the compiled core wrote it; its arrays are made when looked at.

    Attributes:
        written: all that the core wrote, the arrays first, see `compiled.parts_of`.
    """

    positions: Any = Late()
    directions: Any = Late()
    touch: Any = Late()
    contact_vectors: Any = Late()
    desired: Any = Late()
    signs: Any = Late()
    written: bytes

    def late_fields(self) -> dict[str, Any]:
        """Return the fields that are made late."""
        parts = parts_of(self.written, len(self.in_contact))
        touch = Touch(parts.pop("distance"), parts.pop("normal"), parts.pop("point"))
        return parts | {"touch": touch}


class ChainController:
    """Winds by touch alone: it reads the arm's posture and contacts, never the object's size or place.

    Looks and problems come from the compiled core where it can be had, see `compiled.py`.

    Args:
        settings: of the episode.
        chain: what winds.

    Attributes:
        settings: see above.
        chain: see above.
        model, data: of its robot.
        arms: its virtual arms.
        sensor: of touch; it reaches no further than contact rows and contacts need.
    """

    settings: Control

    def __init__(self, settings: Control, chain: Chain) -> None:
        self.settings, self.chain = settings, chain
        self.model, self.data = chain.robot.model, chain.robot.data
        self.arms, self.sensor = chain.arms, chain.sensor
        self._groups: dict[int, tuple[RowGroup, ...]] = {}  # by k
        self._step_bounds = step_bounds(self.model, settings.max_step)
        along_links = not self.sensor.object_moves and goes_along_links(settings.options.kinematics, self.model.nv)
        self._on_tree = OnTree(chain) if along_links else None
        parts = Parts(settings, self.data, self.arms, self.sensor, chain.bodies, CONTACT_MARGIN, not along_links)
        self._compiled = compiled_look(parts) if chain.lies_along_x else None
        self._poses: list[PackedPose] = []  # by k; made before the loop, of which no step is to wait for that
        if self._compiled is not None and not along_links:
            self._poses = [self._pose(self._compiled, k) for k in range(chain.count + 1)]
        self._is_checked = False
        self._seen: SeenByCore | None = None  # what the core saw last

    @property
    def path(self) -> str:
        """Which form looks and poses: "compiled" or "python"."""
        return "python" if self._compiled is None else "compiled"

    def observe(self, q: Array, was_in_contact: NDArray[np.bool_]) -> Situation:
        """Return the situation at joint positions `q` `(m,)` [rad], given which links were in contact `(n,)`."""
        self._seen = None
        if self._compiled is not None and (written := self._compiled.observe(q, was_in_contact)) is not None:
            seen = object.__new__(SeenByCore)
            vars(seen).update(written)
            if self._is_checked or self._is_right(seen, q, was_in_contact):
                self._seen = seen
                return seen
        return self._observed(q, was_in_contact)

    def _is_right(self, seen: Situation, q: Array, was_in_contact: NDArray[np.bool_]) -> bool:
        """Whether the core's first look is the Python form's; if not, the core is not asked again."""
        self._is_checked = True
        if not same_look(seen, self._observed(q, was_in_contact)):
            self._compiled = None
        return self._compiled is not None

    def _observed(self, q: Array, was_in_contact: NDArray[np.bool_]) -> Situation:
        settings = self.settings
        self.chain.robot.update(q)
        touch = self.sensor.read(self.data)
        in_contact = update_contact(was_in_contact, touch.distance, settings.contact_distance, settings.release_distance)
        directions = self.chain.directions()
        contact_vectors = np.where(in_contact[:, None], touch.normal, 0.0)
        first, last = first_and_last_in_contact(in_contact)
        desired, signs = plan(
            directions,
            contact_vectors,
            in_contact,
            speed=settings.speed,
            dt=settings.dt,
            dead_band=settings.dead_band,
        )
        positions = self.arms.positions(self.data)
        for array in (
            touch.distance,
            touch.normal,
            touch.point,
            positions,
            directions,
            in_contact,
            contact_vectors,
            desired,
            signs,
        ):
            array.setflags(write=False)
        return Situation(positions, directions, touch, in_contact, contact_vectors, first, last, desired, signs)

    def problem(self, q: Array, situation: Situation) -> IKProblem:
        """Return the problem of the step from `q`, where `situation` was observed last."""
        if self._on_tree is not None:
            return self._problem_on_tree(self._on_tree, q, situation)
        if situation is self._seen and (problem := self._poses[situation.last].problem(q)) is not None:
            return problem
        return self._assembled(*self._posed(q, situation), situation.last)

    def _pose(self, look: CompiledLook, last: int) -> PackedPose:
        """Return what poses problems where `last` is the last link in contact."""
        n, m, rows = self.arms.count, self.model.nv, [group.rows for group in self._groups_after(last)]
        names = tuple([contact_row_name(link + 1, self.sensor.object_name) for link in range(n)])
        contacts = trusted(Rows, matrix=np.zeros((n, m)), upper=np.zeros(n), names=names)
        pattern = self._assembled(np.zeros((AXES * n, m)), np.zeros(AXES * n), self._step_bounds, contacts, last)
        return PackedPose(look, pattern, rows, n)

    def _assembled(self, jacobian: Array, desired: Array, bounds: Bounds | None, rows: Rows | None, last: int) -> IKProblem:
        """Return the problem of what was posed, where `last` is the last link in contact."""
        levels = tuple(
            [
                trusted_level(jacobian[group.rows], desired[group.rows], group.weights, group.name)
                for group in self._groups_after(last)
            ]
        )
        settings = self.settings
        return trusted_problem(
            levels, bounds if settings.limits else None, rows if settings.contacts else None, self.model.nv
        )

    def _problem_on_tree(self, on_tree: OnTree, q: Array, situation: Situation) -> IKProblem:
        settings, points, desired = self.settings, on_tree.end_points(situation.positions), situation.desired.reshape(-1)
        levels = tuple(
            level_on_tree(points, group.rows, desired, group.weights, group.name)
            for group in self._groups_after(situation.last)
        )
        bounds, rows = None, None
        if settings.limits:
            bounds = joint_range_bounds(self.model, q).intersect(self._step_bounds)
        if settings.contacts:
            rows = on_tree.contact_rows(
                situation.touch, points, CONTACT_MARGIN, settings.min_distance, settings.contact_gain
            )
        return trusted_problem(levels, bounds, rows, self.model.nv)

    def _posed(self, q: Array, situation: Situation) -> tuple[Array, Array, Bounds | None, Rows | None]:
        """Return J `(3 n, m)`, dX_v* `(3 n,)`, and bounds and contact rows where they are kept."""
        settings = self.settings
        bounds, rows = None, None
        if settings.limits:
            bounds = joint_range_bounds(self.model, q).intersect(self._step_bounds)
        if settings.contacts:
            rows = contact_rows(
                self.sensor,
                self.data,
                situation.touch,
                min_distance=settings.min_distance,
                gain=settings.contact_gain,
                margin=CONTACT_MARGIN,
                ahead=0.0,
                push_out=0.0,  # Sec. 4.2 asks for no motion away from the object
            )
        return self.arms.jacobian(self.data), situation.desired.flatten(), bounds, rows

    def _groups_after(self, k: int) -> tuple["RowGroup", ...]:
        """Return each level's rows where k is the last link in contact."""
        if k not in self._groups:
            n, kind = self.chain.count, self.settings.weights
            each, priorities = winding_weights(k, n, kind), winding_priorities(k, n, kind)
            asked = np.count_nonzero(each)  # the first ones
            weights = diagonal_of_weights(each[:asked], AXES)
            self._groups[k] = row_groups(weights, np.repeat(priorities[:asked], AXES))
        return self._groups[k]


class WindingController(ChainController):
    """That of the paper's arm and object, as `WindingSettings` have them."""

    settings: WindingSettings

    def __init__(self, settings: WindingSettings) -> None:
        super().__init__(settings, settings.chain())


@dataclass(frozen=True)
class RowGroup:
    """The rows of one level among all virtual arms' stacked rows, their weights, and what the level is called."""

    rows: slice
    weights: Array
    name: str


def row_groups(weights: Array, priorities: NDArray[np.int64]) -> tuple[RowGroup, ...]:
    """Return the rows of each level, those of the lowest number first.

    Args:
        weights: diagonal of W `(L,)`.
        priorities: the number of each row's level `(L,)`; levels are whole runs of rows.
    """
    groups = []
    for number in np.unique(priorities):
        rows = np.flatnonzero(priorities == number)
        first, last = rows[0] // AXES + 1, rows[-1] // AXES + 1
        name = f"virtual arm {first}" if first == last else f"virtual arms {first} to {last}"
        run = slice(int(rows[0]), int(rows[-1]) + 1)
        groups.append(RowGroup(run, read_only(weights[run]), name))
    return tuple(groups)


def levels_of(jacobian: Array, desired: Array, weights: Array, priorities: NDArray[np.int64]) -> tuple[Level, ...]:
    """Return the levels of all virtual arms' stacked rows, those of the lowest number first.

    Args:
        jacobian: J `(L, m)`.
        desired: dX_v* `(L,)` [m].
        weights: diagonal of W `(L,)`.
        priorities: the number of each row's level `(L,)`; levels are whole runs of rows.

    Raises:
        InputError: values that are not finite, a weight below zero.
    """
    return tuple(
        Level(jacobian[group.rows], desired[group.rows], group.weights, group.name)
        for group in row_groups(weights, priorities)
    )
