"""Levels and rows of an `IKProblem` that know which joint moves which point, and make their matrix only when asked for.

They are levels and rows like any other: every method takes them. A solve that goes along the links (`solvers.tree`) reads
their `points`, and takes as long as there are links; all others look at `matrix`, which is made then.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from prioritized_ik.errors import InputError
from prioritized_ik.kinematic_tree import KinematicTree, PointRows
from prioritized_ik.late import Late
from prioritized_ik.problem import IKProblem, Level, Rows, trusted
from prioritized_ik.validation import Array


class TreeLevel(Level):
    """An undamped level of kind `"equal"` that asks for motions of points: `Level`, but for how its matrix is held.

    Args:
        points: whose motions n·v are the level's rows `(k,)`.
        target, weights, name: see `Level`.

    Raises:
        InputError: see `Level`.

    Attributes:
        points: see above.
    """

    matrix: Any = Late()
    points: PointRows

    def __init__(self, points: PointRows, target: ArrayLike, weights: ArrayLike | None = None, name: str = "task") -> None:
        _require_points(f"points of level {name!r}", points)
        super().__init__(np.zeros((len(points), 0)), target, weights, name)  # which checks all but the matrix
        del self.__dict__["matrix"]
        self.__dict__["points"] = points

    @staticmethod
    def trusted(points: PointRows, target: Array, weights: Array, name: str) -> "TreeLevel":
        """Return a level of arrays that need no check."""
        rest = {"kind": "equal", "damping": 0.0, "below": "free"}
        return trusted(TreeLevel, points=points, target=target, weights=weights, name=name, **rest)

    def late_fields(self) -> dict[str, Any]:
        """Return the fields that are made late."""
        return {"matrix": self.points.matrix}

    @property
    def joint_count(self) -> int:
        """Number of joints m."""
        return self.points.tree.joint_count

    def times(self, dtheta: Array) -> Array:
        """See `Level.times`."""
        return self.points.times(dtheta)


class TreeRows(Rows):
    """Inequality rows on motions of points, such as contact rows: `Rows`, but for how their matrix is held.

    Args:
        points: whose motions n·v are bounded `(r,)`.
        upper, names: see `Rows`.

    Raises:
        InputError: see `Rows`.

    Attributes:
        points: see above.
    """

    matrix: Any = Late()
    points: PointRows

    def __init__(self, points: PointRows, upper: ArrayLike, names: Sequence[str] = ()) -> None:
        _require_points("points of rows", points)
        super().__init__(np.ones((len(points), 1)), upper, names)  # which checks all but the matrix
        del self.__dict__["matrix"]
        self.__dict__["points"] = points

    @staticmethod
    def trusted(points: PointRows, upper: Array, names: tuple[str, ...]) -> "TreeRows":
        """Return rows of arrays that need no check."""
        return trusted(TreeRows, points=points, upper=upper, names=names)

    def late_fields(self) -> dict[str, Any]:
        """Return the fields that are made late."""
        return {"matrix": self.points.matrix}

    @property
    def joint_count(self) -> int:
        """Number of joints m."""
        return self.points.tree.joint_count


def tree_of(problem: IKProblem) -> KinematicTree | None:
    """Return the one tree that all levels and rows of a problem are on; None if there is none, or a matrix among them."""
    tree: KinematicTree | None = None
    parts: list[Level | Rows] = [*problem.levels]
    if len(problem.rows.upper):
        parts.append(problem.rows)
    for part in parts:
        if not isinstance(part, TreeLevel | TreeRows) or (tree is not None and part.points.tree is not tree):
            return None
        tree = part.points.tree
    return tree


def _require_points(what: str, points: object) -> None:
    if not isinstance(points, PointRows):
        raise InputError(f"{what} is of type {type(points).__name__}; expected PointRows, the motions of points.")
