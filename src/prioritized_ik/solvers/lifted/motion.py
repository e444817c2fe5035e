"""Motions of a tree's links as variables of their own, so that what is said of a point concerns few variables.

To the joint step d `(m,)` come ω and v of every link that something is asked of, and of every link where the ways to
several of these part. A link's motion is that of the link before it and what the joints in between add (lifted form):

    ω_i = ω_h + Σ_j a_j d_j,    v_i = v_h + ω_h × (c_i - c_h) + Σ_j (b_j + a_j × (c_i - c_j)) d_j,

with h the link before, c the point of a link at which v is taken, and a_j, b_j, c_j the axis, the linear motion and the
anchor of joint j. Every joint so stands in six equations, and a row of a point in six variables: no matrix is dense.
The motions are counted in `unit` [m] per radian, so that turns and motions are of one size.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse

from prioritized_ik.kinematic_tree import BASE, KinematicTree, Numbers, PointRows
from prioritized_ik.validation import Array

AXES = 6  # variables of one link: ω, then v
NOWHERE = -1  # place of the link before the first ones, and of one that a joint moves for nothing


@dataclass(frozen=True, eq=False)
class LinkMotions:
    """The links whose motions are variables, and the equations between these.

    Attributes:
        tree: of the joints.
        joints: the last joint before each link `(s,)`, ascending.
        before: place among `joints` of the link before each `(s,)`, `NOWHERE` for none.
        owners: place of the link in whose equations each joint stands `(m,)`, `NOWHERE` for none.
        points: at which v is taken `(s, 3)` [m].
        unit: [m], in which motions of points are counted.
    """

    tree: KinematicTree
    joints: Numbers
    before: Numbers
    owners: Numbers
    points: Array
    unit: float

    @staticmethod
    def of(tree: KinematicTree, rows: PointRows) -> "LinkMotions":
        """Return the links that `rows` concern, and where the ways to them part; v is taken at the first row's point."""
        moved = rows.joints[rows.joints != BASE]
        joints, before, owners = _links(tree, moved)
        points = tree.anchors[joints].copy()
        asked, first = np.unique(rows.joints, return_index=True)
        kept = asked != BASE
        points[np.searchsorted(joints, asked[kept])] = rows.points[first[kept]]
        levers = np.linalg.norm(points - tree.anchors[joints], axis=1)
        levers = levers[levers > 0.0]
        return LinkMotions(tree, joints, before, owners, points, float(np.median(levers)) if len(levers) else 1.0)

    @property
    def joint_count(self) -> int:
        """Number of joints m."""
        return self.tree.joint_count

    @property
    def size(self) -> int:
        """Number of variables: m joints and six a link."""
        return self.joint_count + AXES * len(self.joints)

    @cached_property
    def equations(self) -> scipy.sparse.csc_matrix:
        """E `(6 s, m + 6 s)`: motions and joint steps go together where E (d, ω_1, v_1, ω_2, …) = 0, v in `unit`."""
        entries = [*self._of_joints(), *self._of_links()]
        rows, columns, values = (np.concatenate(parts) for parts in zip(*entries, strict=True))
        matrix = scipy.sparse.coo_matrix((values, (rows, columns)), shape=(AXES * len(self.joints), self.size)).tocsc()
        matrix.eliminate_zeros()
        return matrix

    def rows_of(self, points: PointRows) -> scipy.sparse.csc_matrix:
        """Return C `(r, m + 6 s)` with C (d, ω_1, v_1, …) = J d / `unit`, J the matrix of `points` on links of these."""
        asked = np.flatnonzero(points.joints != BASE)
        links = np.searchsorted(self.joints, points.joints[asked])
        directions = points.directions[asked]
        levers = (points.points[asked] - self.points[links]) / self.unit
        values = np.concatenate([np.cross(levers, directions), directions], axis=1)
        columns = self.joint_count + AXES * links[:, None] + np.arange(AXES)
        rows = np.repeat(asked, AXES)
        shape = (len(points), self.size)
        matrix = scipy.sparse.coo_matrix((values.ravel(), (rows, columns.ravel())), shape=shape).tocsc()
        matrix.eliminate_zeros()
        return matrix

    def variables(self, d: Array) -> Array:
        """Return (d, ω_1, v_1, …) `(m + 6 s,)` of a joint step, by the tree's own twists."""
        angular, at_origin = self.tree.twists(d)
        turned = angular[self.joints]
        linear = at_origin[self.joints] + np.cross(turned, self.points)
        return np.concatenate([d, np.concatenate([turned, linear / self.unit], axis=1).ravel()])

    def _of_joints(self) -> list[tuple[Numbers, Numbers, Array]]:
        """Return rows, columns and values of what each joint adds to its link."""
        joints = np.flatnonzero(self.owners != NOWHERE)
        tree, links = self.tree, self.owners[joints]
        levers = self.points[links] - tree.anchors[joints]
        linear = tree.linear[joints] + np.cross(tree.angular[joints], levers)
        values = -np.concatenate([tree.angular[joints], linear / self.unit], axis=1)
        rows = AXES * links[:, None] + np.arange(AXES)
        return [(rows.ravel(), np.repeat(joints, AXES), values.ravel())]

    def _of_links(self) -> list[tuple[Numbers, Numbers, Array]]:
        """Return rows, columns and values of each link's own motion, and of that of the link before it."""
        m, own = self.joint_count, np.arange(AXES * len(self.joints))
        after = np.flatnonzero(self.before != NOWHERE)
        rows = (AXES * after[:, None] + np.arange(AXES)).ravel()
        columns = (AXES * self.before[after][:, None] + np.arange(AXES)).ravel()
        levers = (self.points[after] - self.points[self.before[after]]) / self.unit
        # - ω × r, row by row: -(ω_y r_z - ω_z r_y), …
        first, second = np.array([1, 2, 0]), np.array([2, 0, 1])
        down = AXES * after[:, None] + 3 + np.arange(3)
        up = m + AXES * self.before[after][:, None]
        return [
            (own, m + own, np.ones(len(own))),
            (rows, m + columns, -np.ones(len(rows))),
            (down.ravel(), (up + first).ravel(), -levers[:, second].ravel()),
            (down.ravel(), (up + second).ravel(), levers[:, first].ravel()),
        ]


def _links(tree: KinematicTree, moved: Numbers) -> tuple[Numbers, Numbers, Numbers]:
    """Return the last joints of the links that `moved` carry or at which ways part, what is before each, and owners."""
    m = tree.joint_count
    chosen = np.zeros(m, dtype=bool)
    chosen[moved] = True
    ways = np.zeros(m, dtype=int)  # how many of a joint's children are on a way to a chosen link
    parents = tree.parents.tolist()
    for j in range(m - 1, -1, -1):
        chosen[j] |= ways[j] > 1
        if (chosen[j] or ways[j]) and parents[j] != BASE:
            ways[parents[j]] += 1
    joints = np.flatnonzero(chosen)
    owners = np.full(m, NOWHERE)
    owners[joints] = np.arange(len(joints))
    above = np.full(m + 1, NOWHERE)  # place of the last link at or before a joint; that of `BASE` comes last
    before = np.full(len(joints), NOWHERE)
    for j in range(m):
        above[j] = above[parents[j]]
        if chosen[j]:
            before[owners[j]], above[j] = above[j], owners[j]
    for j in range(m - 1, -1, -1):
        up = parents[j]
        if owners[j] != NOWHERE and up != BASE and not chosen[up]:
            owners[up] = owners[j]
    return joints, before, owners
