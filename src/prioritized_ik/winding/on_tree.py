"""The problem of a winding controller on the kinematic tree: that of `controller.py`, in numbers linear in the links."""

import numpy as np

from prioritized_ik.kinematic_tree import PointRows
from prioritized_ik.limits import contact_row_name, contact_sides
from prioritized_ik.model_tree import ModelTree, unit_axes
from prioritized_ik.touch import Touch
from prioritized_ik.tree_problem import TreeLevel, TreeRows
from prioritized_ik.validation import Array
from prioritized_ik.winding.chain import Chain

AXES = unit_axes("xyz")


class OnTree:
    """Which joints move the links and end points of a chain beside an object that stands still.

    Args:
        chain: what winds.
    """

    def __init__(self, chain: Chain) -> None:
        self._data, self._sensor = chain.robot.data, chain.sensor
        self._tree = ModelTree(chain.robot.model)
        self._ends = self._tree.carriers(chain.arms.bodies)
        self._links = self._tree.carriers(chain.sensor.bodies)

    def end_points(self, positions: Array) -> PointRows:
        """Return the rows of J `(3 n,)` where the arm is, its end points being at `positions` `(n, 3)` [m]."""
        return PointRows.along_axes(self._tree.at(self._data), self._ends, positions, AXES)

    def contact_rows(self, touch: Touch, points: PointRows, margin: float, min_distance: float, gain: float) -> TreeRows:
        """Return what `limits.contact_rows` does, on the tree of `points`."""
        near = np.flatnonzero(touch.distance < margin)
        rows = PointRows.trusted(points.tree, self._links[near], touch.point[near], -touch.normal[near])
        upper = contact_sides(touch.distance[near], min_distance, gain)
        wound = self._sensor.object_name
        return TreeRows.trusted(rows, upper, tuple(contact_row_name(link + 1, wound) for link in near.tolist()))


def level_on_tree(points: PointRows, rows: slice, desired: Array, weights: Array, name: str) -> TreeLevel:
    """Return the level of some `rows` of all end points' `(3 n,)`."""
    return TreeLevel.trusted(points[rows], desired[rows], weights, name)
