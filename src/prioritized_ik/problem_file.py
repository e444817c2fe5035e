"""One `IKProblem` as a `.npz` file: plain arrays, nothing in it is executed on reading.

Arrays of the file, for those who read it without this package: `format`; for each level i from 0, the most important,
`level_i_matrix` `(k, m)`, `level_i_target` `(k,)`, `level_i_weights` `(k,)`, `level_i_kind`, `level_i_name`,
`level_i_damping` and `level_i_below`; `lower` and `upper` `(m,)` [rad] with `joint_names`; `rows_matrix` `(r, m)`,
`rows_upper` `(r,)`, `rows_names`; `equalities_matrix`, `equalities_target`, `equalities_names`; `reference` `(m,)` [rad];
`metric` `(m,)` or `(m, m)`; `noise`.
"""

import io
from contextlib import nullcontext
from pathlib import Path
from typing import BinaryIO

import numpy as np

from prioritized_ik.errors import InputError
from prioritized_ik.files import UNREADABLE, advising, write_whole
from prioritized_ik.problem import Bounds, Equalities, IKProblem, Level, Rows

FORMAT = "prioritized-ik problem 2"


def problem_bytes(problem: IKProblem) -> bytes:
    """Return the content of the `.npz` file of `problem`."""
    arrays = {
        "format": np.array(FORMAT),
        "lower": problem.bounds.lower,
        "upper": problem.bounds.upper,
        "joint_names": np.array(problem.bounds.names, dtype=np.str_),
        "rows_matrix": problem.rows.matrix,
        "rows_upper": problem.rows.upper,
        "rows_names": np.array(problem.rows.names, dtype=np.str_),
        "equalities_matrix": problem.equalities.matrix,
        "equalities_target": problem.equalities.target,
        "equalities_names": np.array(problem.equalities.names, dtype=np.str_),
        "reference": problem.reference,
        "metric": problem.metric,
        "noise": np.array(problem.noise),
    }
    for number, level in enumerate(problem.levels):
        arrays |= {f"level_{number}_{part}": np.asarray(getattr(level, part)) for part in _LEVEL_PARTS}
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
        levels: list[Level] = []
        while f"level_{len(levels)}_matrix" in content:
            parts = (content[f"level_{len(levels)}_{part}"] for part in _LEVEL_PARTS)
            matrix, target, weights, name, kind, damping, below = parts
            levels.append(Level(matrix, target, weights, str(name), str(kind), float(damping), str(below)))
        return IKProblem(
            levels,
            Bounds(content["lower"], content["upper"], _names(content["joint_names"])),
            Rows(content["rows_matrix"], content["rows_upper"], _names(content["rows_names"])),
            content["reference"],
            Equalities(content["equalities_matrix"], content["equalities_target"], _names(content["equalities_names"])),
            metric=content["metric"],
            noise=float(content["noise"]),
        )
    except (*UNREADABLE, InputError) as error:
        raise InputError(
            f"cannot read a problem from {str(path)!r} ({error}); expected a file of the format {FORMAT!r}, whole."
        ) from error


_LEVEL_PARTS = ("matrix", "target", "weights", "name", "kind", "damping", "below")


def _names(array: np.ndarray) -> tuple[str, ...]:
    return tuple(str(name) for name in array)
