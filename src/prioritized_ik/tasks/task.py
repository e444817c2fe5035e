"""What all tasks have in common."""

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from prioritized_ik.errors import InputError
from prioritized_ik.robot import Frame, Robot
from prioritized_ik.validation import Array, finite_array, gain_of, shape_of


class Task(ABC):
    """Rows J dθ = e: the step dθ `(nv,)` that takes the error e `(k,)` to zero, to first order.

    Args:
        robot: whose model the task is for; later calls take any `Robot` of that model.
        size: number of rows k.
        name: what messages call it.
        gain: how much of the error one step is to take away, in (0, 1].
        weights: of the rows in the level's least squares `(k,)`, or one for all.

    Attributes:
        size: number of rows k.
        name: what messages call it.
        gain: how much of the error one step is to take away.
        weights: of the rows `(k,)`.

    Raises:
        InputError: a gain out of range; weights of another shape, or below zero.
    """

    def __init__(self, robot: Robot, size: int, name: str, gain: float = 1.0, weights: ArrayLike = 1.0) -> None:
        if not isinstance(robot, Robot):
            raise InputError(f"robot of {name} is of type {type(robot).__name__}; expected a Robot.")
        self._model = robot.model
        self.size, self.name = size, name
        self.gain = gain_of(f"gain of {name}", gain)
        each = weights if shape_of(f"weights of {name}", weights) else np.full(size, weights)
        self.weights = finite_array(f"weights of {name}", each, (size,))
        if (self.weights < 0.0).any():
            raise InputError(f"weights of {name} are {self.weights.tolist()}; expected numbers of at least 0.")

    def rows(self, robot: Robot) -> tuple[Array, Array]:
        """Return J `(k, nv)` and e `(k,)` at the robot's position.

        Raises:
            InputError: a robot of another model.
        """
        if robot.model is not self._model:
            raise InputError(f"{self.name} is a task of another model; make it from the robot that it is to move.")
        return self._rows(robot)

    def error(self, robot: Robot) -> Array:
        """Return e `(k,)` alone."""
        return self.rows(robot)[1]

    def lever(self, robot: Robot) -> float:
        """Return ℓ [row units / rad]: the rows' second derivatives are about ℓ, and zero where the rows are linear in q.

        `solve_step` damps by it: Gauss-Newton leaves out e times the second derivative.
        """
        return 0.0

    def between(self, one: Any, other: Any, share: float) -> Any:
        """Return the target that is a `share`, from 0 to 1, of the way from one to another, both as `target` has them."""
        return (1.0 - share) * one + share * other

    @abstractmethod
    def _rows(self, robot: Robot) -> tuple[Array, Array]: ...

    def __repr__(self) -> str:
        """Return the kind and name."""
        return f"<{type(self).__name__}: {self.name}>"


class FrameTask(Task):
    """A task of one frame: give one of `body`, `site` and `geom`, by name or number.

    Args:
        robot: see `Task`.
        target: what is wanted of the frame, in the world, or in `root`; where it is now unless given.
        body: the frame, if it is a body's.
        site: the frame, if it is a site's.
        geom: the frame, if it is a geom's.
        root: a frame of the robot (`robot.frame(body="chest")`) that target and rows are in, in place of the world; it may
            move.
        gain: see `Task`.
        weights: see `Task`.

    Raises:
        InputError: see `Task`; a frame that does not exist, a root that is none, or a target of another kind.
    """

    kind: ClassVar[str] = "frame"
    row_count: ClassVar[int] = 3

    def __init__(
        self,
        robot: Robot,
        target: ArrayLike | None = None,
        *,
        body: str | int | None = None,
        site: str | int | None = None,
        geom: str | int | None = None,
        root: Frame | None = None,
        gain: float = 1.0,
        weights: ArrayLike = 1.0,
    ) -> None:
        if not isinstance(robot, Robot):
            raise InputError(f"robot is of type {type(robot).__name__}; expected a Robot.")
        self.frame: Frame = robot.frame(body=body, site=site, geom=geom)
        self.root = _root(root, self.frame)
        within = f" in {root.name}" if root is not None else ""
        super().__init__(robot, self.row_count, f"{self.kind} of {self.frame.name}{within}", gain, weights)
        self.target = self._now(robot) if target is None else target

    @property
    def target(self) -> Array:
        """What is wanted of the frame, see the class."""
        return self._target

    @target.setter
    def target(self, value: ArrayLike) -> None:
        self._target = self._checked(value)

    @abstractmethod
    def _now(self, robot: Robot) -> Array:
        """Return the target that is met where the robot is."""

    @abstractmethod
    def _checked(self, value: ArrayLike) -> Array:
        """Return a target as it is kept."""

    def _position(self, robot: Robot) -> Array:
        """Return the frame's origin `(3,)` [m] in the world or the root."""
        here = robot.position(self.frame)
        if self.root is None:
            return here
        return robot.rotation(self.root).T @ (here - robot.position(self.root))

    def _rotation(self, robot: Robot) -> Array:
        """Return the frame's rotation matrix `(3, 3)` in the world or the root."""
        here = robot.rotation(self.frame)
        return here if self.root is None else robot.rotation(self.root).T @ here

    def _jacobians(self, robot: Robot) -> tuple[Array, Array]:
        """Return the Jacobians `(3, nv)` of `_position` [m] and of the rotation [rad], in the axes of world or root."""
        linear, angular = robot.jacobians(self.frame)
        if self.root is None:
            return linear, angular
        turn, (root_linear, root_angular) = robot.rotation(self.root).T, robot.jacobians(self.root)
        lever = robot.position(self.frame) - robot.position(self.root)
        # d(Rᵀ (p - r)) = Rᵀ (v - v_r - ω_r × (p - r)), with R, r, v_r and ω_r the root's.
        carried = root_linear + np.cross(root_angular, lever, axisa=0, axisc=0)
        return turn @ (linear - carried), turn @ (angular - root_angular)


def _root(root: Frame | None, frame: Frame) -> Frame | None:
    if root is not None and not isinstance(root, Frame):
        raise InputError(f"root is {root!r}; expected a frame such as robot.frame(body='chest').")
    if root == frame:
        raise InputError(f"root is the {frame.kind} {frame.name} itself; expected another frame.")
    return root


def extent_lever(robot: Robot) -> float:
    """Return half the model's extent [m]: about how far a turn of one radian moves the points on it."""
    return 0.5 * float(robot.model.stat.extent)
