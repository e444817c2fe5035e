"""One `IKProblem` as a `.npz` file: plain arrays, nothing in it is executed on reading.

Arrays of the file, for those who read it without this package: `format`; for each level i from 0, the most important,
`level_i_matrix` `(k, m)`, `level_i_target` `(k,)`, `level_i_weights` `(k,)`, `level_i_kind`, `level_i_name`,
`level_i_damping` and `level_i_below`; `lower` and `upper` `(m,)` [rad] with `joint_names`; `rows_matrix` `(r, m)`,
`rows_upper` `(r,)`, `rows_names`; `equalities_matrix`, `equalities_target`, `equalities_names`; `reference` `(m,)` [rad];
`metric` `(m,)` or `(m, m)`; `noise`.

A problem on a kinematic tree has numbers linear in its joints in place of matrices, see `kinematic_tree`: `tree_parents`
`(m,)`, -1 for none, `tree_angular`, `tree_linear` and `tree_anchors` `(m, 3)`; and for each level and the rows `_joints`
`(k,)`, `_points` and `_directions` `(k, 3)`.
"""

import io
from contextlib import nullcontext
from pathlib import Path
from typing import BinaryIO

import numpy as np

from prioritized_ik.errors import InputError
from prioritized_ik.files import UNREADABLE, advising, write_whole
from prioritized_ik.kinematic_tree import KinematicTree, PointRows
from prioritized_ik.problem import Bounds, Equalities, IKProblem, Level, Rows
from prioritized_ik.tree_problem import TreeLevel, TreeRows, tree_of

FORMAT = "prioritized-ik problem 3"


def problem_bytes(problem: IKProblem) -> bytes:
    """Return the content of the `.npz` file of `problem`."""
    arrays = {
        "format": np.array(FORMAT),
        "lower": problem.bounds.lower,
        "upper": problem.bounds.upper,
        "joint_names": np.array(problem.bounds.names, dtype=np.str_),
        "rows_upper": problem.rows.upper,
        "rows_names": np.array(problem.rows.names, dtype=np.str_),
        "equalities_matrix": problem.equalities.matrix,
        "equalities_target": problem.equalities.target,
        "equalities_names": np.array(problem.equalities.names, dtype=np.str_),
        "reference": problem.reference,
        "metric": problem.metric,
        "noise": np.array(problem.noise),
    }
    tree = tree_of(problem)
    if tree is not None:
        arrays |= {f"tree_{part}": getattr(tree, part) for part in _TREE_PARTS}
    arrays |= _motion("rows", problem.rows, tree)
    for number, level in enumerate(problem.levels):
        arrays |= {f"level_{number}_{part}": np.asarray(getattr(level, part)) for part in _LEVEL_PARTS}
        arrays |= _motion(f"level_{number}", level, tree)
    content = io.BytesIO()
    np.savez_compressed(content, allow_pickle=False, **arrays)
    return content.getvalue()


def save_problem(problem: IKProblem, path: str | Path) -> None:
    """Write `problem` to the `.npz` file `path`, whole or not at all.

    Raises:
        InputError: it cannot be written.
    """
    content = problem_bytes(problem)
    with advising("write", path):
        write_whole(path, lambda file: file.write(content))


def load_problem(path: str | Path | BinaryIO) -> IKProblem:
    """Return the problem that `save_problem` wrote, or that was downloaded from a report.

    Args:
        path: of the file, or the file, open.

    Raises:
        InputError: not there, not such a file, or damaged.
    """
    try:
        opened = open(path, "rb") if isinstance(path, str | Path) else nullcontext(path)
        with opened as raw, np.load(raw, allow_pickle=False) as file:
            content = {name: file[name] for name in file.files}
        if str(content["format"]) != FORMAT:
            raise ValueError(f"its format is {str(content['format'])!r}")
        tree = _tree(content)
        levels: list[Level] = []
        while f"level_{len(levels)}_target" in content:
            what = f"level_{len(levels)}"
            target, weights, name, kind, damping, below = (content[f"{what}_{part}"] for part in _LEVEL_PARTS)
            if tree is not None:
                levels.append(TreeLevel(_points(content, what, tree), target, weights, str(name)))
                continue
            matrix = content[f"{what}_matrix"]
            levels.append(Level(matrix, target, weights, str(name), str(kind), float(damping), str(below)))
        sides, names = content["rows_upper"], _names(content["rows_names"])
        rows = _points(content, "rows", tree) if tree is not None and "rows_joints" in content else None
        return IKProblem(
            levels,
            Bounds(content["lower"], content["upper"], _names(content["joint_names"])),
            Rows(content["rows_matrix"], sides, names) if rows is None else TreeRows(rows, sides, names),
            content["reference"],
            Equalities(content["equalities_matrix"], content["equalities_target"], _names(content["equalities_names"])),
            metric=content["metric"],
            noise=float(content["noise"]),
        )
    except (*UNREADABLE, InputError) as error:
        raise InputError(
            f"cannot read a problem from {str(path)!r} ({error}); expected a file of the format {FORMAT!r}, whole."
        ) from error


_LEVEL_PARTS = ("target", "weights", "name", "kind", "damping", "below")
_TREE_PARTS = ("parents", "angular", "linear", "anchors")
_POINT_PARTS = ("joints", "points", "directions")


def _motion(what: str, part: Level | Rows, tree: KinematicTree | None) -> dict[str, np.ndarray]:
    """Return what a level or rows say of joints: motions of points on the tree of all, or a matrix where there is none."""
    if tree is not None and isinstance(part, TreeLevel | TreeRows):
        return {f"{what}_{name}": getattr(part.points, name) for name in _POINT_PARTS}
    return {f"{what}_matrix": part.matrix}


def _tree(content: dict[str, np.ndarray]) -> KinematicTree | None:
    return KinematicTree(*(content[f"tree_{part}"] for part in _TREE_PARTS)) if "tree_parents" in content else None


def _points(content: dict[str, np.ndarray], what: str, tree: KinematicTree) -> PointRows:
    return PointRows(tree, *(content[f"{what}_{part}"] for part in _POINT_PARTS))


def _names(array: np.ndarray) -> tuple[str, ...]:
    return tuple(str(name) for name in array)
