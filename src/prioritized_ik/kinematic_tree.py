"""Which joint moves which point: a tree of joints, and rows of points on it, without any matrix.

A joint with axis ω through an anchor c moves every point p beyond it by v + ω × (p - c): a hinge has v = 0, a slide ω = 0.
What a row of a Jacobian says of m joints is so said by three things: the point, the direction n in which its motion counts,
and the last joint that moves it; products with J and Jᵀ take as long as there are joints and rows, and J itself is made
only when asked for. Everything is in the world's frame, and everything is free of MuJoCo; see `model_tree` for its models.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from prioritized_ik.errors import InputError
from prioritized_ik.validation import Array, finite_array, read_only

BASE = -1  # number of the joint before the first ones, and of the one that moves what stands still

Numbers = NDArray[np.int_]


@dataclass(frozen=True, init=False, eq=False)
class KinematicTree:
    """Joints of one degree of freedom each, ordered so that each comes after the one that carries it.

    A ball joint is three of them on one anchor, a free joint six.

    Attributes:
        parents: number of the joint that carries each one `(m,)`, `BASE` for none.
        angular: ω of each `(m, 3)`, of unit length for hinges, zero for slides.
        linear: v of each at its anchor `(m, 3)`, zero for hinges, of unit length for slides.
        anchors: c of each `(m, 3)` [m].

    Raises:
        InputError: shapes that do not fit, values that are not finite, a parent that does not come before its child.
    """

    parents: Numbers
    angular: Array
    linear: Array
    anchors: Array

    def __init__(self, parents: ArrayLike, angular: ArrayLike, linear: ArrayLike, anchors: ArrayLike) -> None:
        numbers = np.asarray(parents)
        if numbers.ndim != 1 or (numbers.size and numbers.dtype.kind not in "iu"):
            raise InputError(f"parents is of shape {numbers.shape}, {numbers.dtype}; expected whole numbers (m,).")
        m = len(numbers)
        wrong = np.flatnonzero((numbers < BASE) | (numbers >= np.arange(m)))
        if wrong.size:
            j = int(wrong[0])
            raise InputError(f"parents[{j}] is {numbers[j]}; expected {BASE} or a number below {j}: the base first.")
        self._fill(
            read_only(numbers.astype(int)),
            finite_array("angular", angular, (m, 3)),
            finite_array("linear", linear, (m, 3)),
            finite_array("anchors", anchors, (m, 3)),
        )

    def _fill(self, parents: Numbers, angular: Array, linear: Array, anchors: Array) -> None:
        self.__dict__.update(parents=parents, angular=angular, linear=linear, anchors=anchors)

    def moved_to(self, angular: Array, linear: Array, anchors: Array) -> "KinematicTree":
        """Return the same joints elsewhere, unchecked: arrays as in the attributes, kept as they are."""
        tree = object.__new__(KinematicTree)
        tree._fill(self.parents, angular, linear, anchors)
        tree.__dict__["runs"] = self.runs
        return tree

    def scaled(self, factors: Array) -> "KinematicTree":
        """Return the tree of joints whose unit step is `factors` `(m,)` of one here, as in another joint metric."""
        return self.moved_to(self.angular * factors[:, None], self.linear * factors[:, None], self.anchors)

    @property
    def joint_count(self) -> int:
        """Number of joints m."""
        return len(self.parents)

    @cached_property
    def runs(self) -> tuple[tuple[int, int, int], ...]:
        """The first joint, the end, and the joint before, of each unbranched run of joints."""
        starts = np.flatnonzero(self.parents != np.arange(-1, self.joint_count - 1)).tolist()
        if self.joint_count and (not starts or starts[0]):
            starts = [0, *starts]
        return tuple(
            (first, end, int(self.parents[first]))
            for first, end in zip(starts, [*starts[1:], self.joint_count], strict=True)
        )

    @cached_property
    def linear_at_origin(self) -> Array:
        """Velocity of the world's origin, v - ω × c, if each joint carried it `(m, 3)`."""
        return self.linear - crossed(self.angular, self.anchors)

    def twists(self, dtheta: Array) -> tuple[Array, Array]:
        """Return ω `(m, 3)` and the world's origin's velocity `(m, 3)` of what each joint carries, at `dtheta` `(m,)`."""
        motion = np.concatenate([self.angular, self.linear_at_origin], axis=1) * dtheta[:, None]
        for first, end, before in self.runs:
            if before != BASE:
                motion[first] += motion[before]
            np.cumsum(motion[first:end], axis=0, out=motion[first:end])
        return motion[:, :3], motion[:, 3:]

    def torques(self, moments: Array, forces: Array) -> Array:
        """Return joint torques `(m,)` of moments about the world's origin and forces `(m, 3)` on what each carries."""
        carried = self.beyond(np.concatenate([moments, forces], axis=1))
        return np.einsum("ij,ij->i", carried[:, :3], self.angular) + np.einsum(
            "ij,ij->i", carried[:, 3:], self.linear_at_origin
        )

    def beyond(self, values: Array) -> Array:
        """Return the sums `(m, k)` of `values` `(m, k)` over what each joint carries."""
        carried = values.copy()
        for first, end, before in reversed(self.runs):
            carried[first:end] = np.cumsum(carried[first:end][::-1], axis=0)[::-1]
            if before != BASE:
                carried[before] += carried[first]
        return carried

    def moving(self, joints: Numbers) -> NDArray[np.bool_]:
        """Return which joints move what each of `joints` `(k,)` carries, as a mask `(k, m)`."""
        mask = np.zeros((len(joints), self.joint_count), dtype=bool)
        at, rows = np.asarray(joints), np.arange(len(joints))
        while (moves := at != BASE).any():
            rows, at = rows[moves], at[moves]
            mask[rows, at] = True
            at = self.parents[at]
        return mask


@dataclass(frozen=True, init=False, eq=False)
class PointRows:
    """Rows of a Jacobian, each of the motion of a point in a direction: n·(v + ω × p).

    Attributes:
        tree: of the joints that move the points.
        joints: the last joint that moves each row's point `(r,)`, `BASE` for one that stands still.
        points: `(r, 3)` [m].
        directions: n `(r, 3)`.

    Raises:
        InputError: shapes that do not fit, values that are not finite, a joint that the tree does not have.
    """

    tree: KinematicTree
    joints: Numbers
    points: Array
    directions: Array

    def __init__(self, tree: KinematicTree, joints: ArrayLike, points: ArrayLike, directions: ArrayLike) -> None:
        numbers = np.asarray(joints, dtype=int)
        r = len(numbers)
        wrong = np.flatnonzero((numbers < BASE) | (numbers >= tree.joint_count))
        if wrong.size:
            i = int(wrong[0])
            raise InputError(f"joints[{i}] is {numbers[i]}; expected {BASE} to {tree.joint_count - 1}.")
        self._fill(
            tree,
            read_only(numbers.copy()),
            finite_array("points", points, (r, 3)),
            finite_array("directions", directions, (r, 3)),
        )

    def _fill(self, tree: KinematicTree, joints: Numbers, points: Array, directions: Array) -> None:
        self.__dict__.update(tree=tree, joints=joints, points=points, directions=directions)

    @staticmethod
    def trusted(tree: KinematicTree, joints: Numbers, points: Array, directions: Array) -> "PointRows":
        """Return rows of arrays that need no check and are kept as they are."""
        rows = object.__new__(PointRows)
        rows._fill(tree, joints, points, directions)
        return rows

    @staticmethod
    def along_axes(tree: KinematicTree, joints: Numbers, points: Array, axes: Array) -> "PointRows":
        """Return the rows of whole points `(k, 3)`, one for each of the `axes` `(l, 3)`, point by point: k l of them."""
        k, l_ = len(joints), len(axes)
        return PointRows.trusted(tree, np.repeat(joints, l_), np.repeat(points, l_, axis=0), np.tile(axes, (k, 1)))

    def __len__(self) -> int:
        return len(self.joints)

    def __getitem__(self, chosen: slice | NDArray[np.bool_] | Numbers) -> "PointRows":
        """Return some of the rows."""
        return PointRows.trusted(self.tree, self.joints[chosen], self.points[chosen], self.directions[chosen])

    def on(self, tree: KinematicTree) -> "PointRows":
        """Return the same rows on a tree of the same joints, see `KinematicTree.scaled`."""
        return PointRows.trusted(tree, self.joints, self.points, self.directions)

    @cached_property
    def moments(self) -> Array:
        """P × n `(r, 3)`: what the row makes of a turn about the world's origin."""
        return crossed(self.points, self.directions)

    def times(self, dtheta: Array) -> Array:
        """Return J dθ `(r,)`."""
        angular, linear = self.tree.twists(dtheta)
        moved = np.einsum("ij,ij->i", self.directions, linear[self.joints])
        moved += np.einsum("ij,ij->i", self.moments, angular[self.joints])
        moved[self.joints == BASE] = 0.0
        return moved

    def transposed_times(self, values: Array) -> Array:
        """Return Jᵀ y `(m,)`, y `(r,)` being the `values`: joint torques of forces at the points, Eq. (5)."""
        m, moved = self.tree.joint_count, self.joints != BASE
        if not moved.any():
            return np.zeros(m)
        joints = self.joints[moved]
        wrench = np.concatenate([self.moments, self.directions], axis=1)[moved] * values[moved, None]
        sums = np.zeros((m, 6))
        for k in range(6):
            sums[:, k] = np.bincount(joints, wrench[:, k], minlength=m)
        return self.tree.torques(sums[:, :3], sums[:, 3:])

    def sizes_of_terms(self, dtheta: Array) -> Array:
        """Return how large the terms are whose sum `times` is `(r,)`, for their rounding."""
        angular, linear = self.tree.twists(dtheta)
        sizes = np.einsum("ij,ij->i", np.abs(self.directions), np.abs(linear[self.joints]))
        sizes += np.einsum("ij,ij->i", np.abs(self.moments), np.abs(angular[self.joints]))
        sizes[self.joints == BASE] = 0.0
        return sizes

    def sizes_of_torques(self, values: Array) -> Array:
        """Return the root of the sum of squares of the terms that `transposed_times` adds up `(m,)`, about."""
        m, moved = self.tree.joint_count, self.joints != BASE
        joints, sums = self.joints[moved], np.zeros((m, 2))
        for k, part in enumerate((self.moments, self.directions)):
            sums[:, k] = np.bincount(joints, (length_of(part[moved]) * values[moved]) ** 2, minlength=m)
        carried = np.sqrt(self.tree.beyond(sums))
        return carried[:, 0] * length_of(self.tree.angular) + carried[:, 1] * length_of(self.tree.linear_at_origin)

    @cached_property
    def matrix(self) -> Array:
        """J `(r, m)`, made when asked for."""
        tree = self.tree
        joints, where = np.unique(self.joints, return_inverse=True)
        levers = self.points[:, None, :] - tree.anchors[None]
        turned = np.cross(tree.angular[None], levers)
        matrix = np.einsum("rk,rjk->rj", self.directions, turned + tree.linear[None])
        matrix[~tree.moving(joints)[where]] = 0.0
        return read_only(matrix)


def length_of(rows: Array) -> Array:
    """Return the length of each row `(k,)`; `validation.lengths` guards against overflow, which takes longer."""
    return np.sqrt(np.einsum("ij,ij->i", rows, rows))


def crossed(a: Array, b: Array) -> Array:
    """Return a × b, row by row `(k, 3)`; `numpy.cross` takes several times as long."""
    out = np.empty_like(a)
    out[:, 0] = a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1]
    out[:, 1] = a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]
    out[:, 2] = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return out
