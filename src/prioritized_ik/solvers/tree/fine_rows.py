"""Products with J and Jᵀ of points on a tree, with twice the digits of doubles, for gradients that nearly cancel."""

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.double_double import DoubleDouble
from prioritized_ik.kinematic_tree import BASE, PointRows
from prioritized_ik.validation import Array


class FineRows:
    """Rows of points, as they are given, whose products are right to about 1e-30 of their terms.

    Args:
        rows: of motions of points `(k,)`.
    """

    def __init__(self, rows: PointRows) -> None:
        tree = rows.tree
        self._tree, self._joints = tree, rows.joints
        moving = (rows.joints != BASE)[:, None]
        of_origin = DoubleDouble.of(tree.linear) - _crossed(tree.angular, tree.anchors)
        self._axes = _beside(DoubleDouble.of(tree.angular), of_origin)  # (m, 6)
        covectors = _beside(_crossed(rows.points, rows.directions), DoubleDouble.of(rows.directions))
        self._covectors = covectors.where(moving)  # (k, 6)

    def times(self, u: Array) -> DoubleDouble:
        """Return J u `(k,)` of a step `(m,)`."""
        twists = self._axes.times(u[:, None])
        for first, end, before in self._tree.runs:
            if before != BASE:
                _put(twists, slice(first, first + 1), twists[first : first + 1] + twists[before : before + 1])
            _put(twists, slice(first, end), _running_sum(twists[first:end]))
        return _dots(self._covectors, twists[self._joints])

    def transposed_times(self, values: DoubleDouble) -> DoubleDouble:
        """Return Jᵀ y `(m,)` of the `values` y `(k,)`."""
        wrenches = _product(self._covectors, values[:, None])
        carried = DoubleDouble.of(np.zeros((self._tree.joint_count, 6)))
        waiting = np.flatnonzero(self._joints != BASE)
        while len(waiting):  # one row a joint at a time
            joints, some = np.unique(self._joints[waiting], return_index=True)
            _put(carried, joints, carried[joints] + wrenches[waiting[some]])
            waiting = np.delete(waiting, some)
        for first, end, before in reversed(self._tree.runs):
            _put(carried, slice(first, end), _running_sum(carried[first:end][::-1])[::-1])
            if before != BASE:
                _put(carried, slice(before, before + 1), carried[before : before + 1] + carried[first : first + 1])
        return _dots(self._axes, carried)


def _put(numbers: DoubleDouble, where: slice | NDArray[np.intp], others: DoubleDouble) -> None:
    numbers.high[where], numbers.low[where] = others.high, others.low


def _beside(left: DoubleDouble, right: DoubleDouble) -> DoubleDouble:
    return DoubleDouble(np.hstack([left.high, right.high]), np.hstack([left.low, right.low]))


def _crossed(a: Array, b: Array) -> DoubleDouble:
    one, other = (
        DoubleDouble.of(a[:, [1, 2, 0]]).times(b[:, [2, 0, 1]]),
        DoubleDouble.of(a[:, [2, 0, 1]]).times(b[:, [1, 2, 0]]),
    )
    return one - other


def _product(a: DoubleDouble, b: DoubleDouble) -> DoubleDouble:
    """Return the product element by element."""
    return a.times(b.high) + DoubleDouble.of(a.high * b.low)


def _dots(a: DoubleDouble, b: DoubleDouble) -> DoubleDouble:
    """Return the dot products of rows `(n,)` of two `(n, 6)`."""
    products = _product(a, b)
    total = products[:, 0]
    for i in range(1, products.high.shape[1]):
        total = total + products[:, i]
    return total


def _running_sum(rows: DoubleDouble) -> DoubleDouble:
    """Return the sums of the rows up to each, twice as many at a time."""
    reach = 1
    while reach < len(rows.high):
        more = rows[reach:] + rows[:-reach]
        rows = DoubleDouble(np.concatenate([rows.high[:reach], more.high]), np.concatenate([rows.low[:reach], more.low]))
        reach *= 2
    return rows
