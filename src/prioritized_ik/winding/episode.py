"""One winding episode: the loop, its record, and the record's file.

The arm moves kinematically: each step's dθ is added to the joint positions as it is. The record holds every step's problem
and outcome, so that any solver can be run on the same problems later; a saved episode replays bit for bit.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.errors import EpisodeFileError, InputError
from prioritized_ik.files import UNREADABLE, advising, write_whole
from prioritized_ik.kinematic_tree import KinematicTree, PointRows
from prioritized_ik.limits import contact_row_name
from prioritized_ik.problem import Bounds, IKProblem, Level, Rows
from prioritized_ik.solvers.methods import Method
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.solvers.step import JointStep, StepStatus
from prioritized_ik.tree_problem import TreeLevel, TreeRows, tree_of
from prioritized_ik.validation import Array, read_only
from prioritized_ik.winding.controller import WindingController, levels_of, row_groups
from prioritized_ik.winding.loop import Outcome as Outcome
from prioritized_ik.winding.loop import moments
from prioritized_ik.winding.on_tree import AXES, level_on_tree
from prioritized_ik.winding.settings import WindingSettings

FORMAT = "prioritized-ik episode 5"


@dataclass(frozen=True)
class Episode:
    """The record of T steps of an arm with n links and m joints; L = 3 n. The last state, T, has no step.

    Attributes:
        settings: what decided it.
        outcome: how it ended.
        message: the solver's own words, if it failed.
        q: joint positions `(T + 1, m)` [rad].
        positions: end points `(T + 1, n, 3)` [m].
        directions: unit directions of the links `(T + 1, n, 3)`.
        distance: of each link to the object `(T + 1, n)` [m].
        in_contact: M `(T + 1, n)`.
        contact_vectors: c `(T + 1, n, 3)`.
        signs: s of Eq. (21) `(T + 1, n)`.
        desired: dX_v* `(T, L)` [m].
        jacobian: J `(T, L, m)`; `(0, L, m)` where problems are on the kinematic tree.
        weights: diagonal of W `(T, L)`; zero at the end for arms that nothing is asked of, see `weights.TRAILING`.
        priorities: the number of each row's level `(T, L)`, from 0, the most important; levels are whole runs of rows.
        lower, upper: bounds on dθ `(T, m)` [rad], infinite where there is none.
        row_matrix: contact rows by link `(T, n, m)`; `(0, n, m)` on the tree.
        row_upper: their right sides `(T, n)` [m], infinite where a link has no row.
        axes, anchors: of the joints, unit vectors and `[m]` `(T, m, 3)`, on the tree in place of J; else `(0, m, 3)`.
        row_points, row_directions: of contact rows by link, in place of `row_matrix`, likewise `(T, n, 3)` or `(0, n, 3)`.
        dtheta: the steps `(T, m)` [rad]; NaN where the solver failed.
        status: names of `StepStatus` `(T,)`.
        solve_seconds, build_seconds: see `Timings` `(T,)`.
    """

    settings: WindingSettings
    outcome: Outcome
    message: str
    q: Array
    positions: Array
    directions: Array
    distance: Array
    in_contact: NDArray[np.bool_]
    contact_vectors: Array
    signs: Array
    desired: Array
    jacobian: Array
    weights: Array
    priorities: NDArray[np.int64]
    lower: Array
    upper: Array
    row_matrix: Array
    row_upper: Array
    axes: Array
    anchors: Array
    row_points: Array
    row_directions: Array
    dtheta: Array
    status: NDArray[np.str_]
    solve_seconds: Array
    build_seconds: Array

    @property
    def steps(self) -> int:
        """Number of steps T."""
        return len(self.dtheta)

    def problem(self, step: int) -> IKProblem:
        """Return the problem of `step` (from 0), as it was solved then.

        Raises:
            InputError: there is no such step.
        """
        if not 0 <= step < self.steps:
            raise InputError(f"step is {step}; expected 0 to {self.steps - 1}.")
        links = np.flatnonzero(np.isfinite(self.row_upper[step]))
        sides, names = self.row_upper[step, links], tuple(contact_row_name(int(link) + 1) for link in links)
        bounds = Bounds(self.lower[step], self.upper[step], self._joint_names)
        if not self.is_on_tree:
            asked = self._asked(step)
            jacobian, desired = self.jacobian[step, asked], self.desired[step, asked]
            levels = levels_of(jacobian, desired, self.weights[step, asked], self.priorities[step, asked])
            return IKProblem(levels, bounds, Rows(self.row_matrix[step, links], sides, names))
        points, carriers = self._end_points(step)
        touching = PointRows(points.tree, carriers[links], self.row_points[step, links], self.row_directions[step, links])
        return IKProblem(self._levels_on_tree(step, points), bounds, TreeRows(touching, sides, names))

    @property
    def is_on_tree(self) -> bool:
        """Whether problems are on the kinematic tree: what is recorded of a step is linear in the links then."""
        return self.steps > 0 and not len(self.jacobian)

    def problems(self, steps: Iterator[int] | range | None = None) -> Iterator[IKProblem]:
        """Yield the problems of `steps`, of all unless given."""
        return (self.problem(step) for step in (range(self.steps) if steps is None else steps))

    def save(self, path: str | Path) -> None:
        """Write the episode to one `.npz` file, whole or not at all.

        Raises:
            EpisodeFileError: it cannot be written.
        """
        with advising("write the episode to", path, EpisodeFileError, "choose a folder that exists and is writable"):
            write_whole(path, self.write)

    def write(self, file: BinaryIO) -> None:
        """Write into an open file what `save` writes."""
        arrays: dict[str, Any] = {name: getattr(self, name) for name in _ARRAYS}
        header: dict[str, Any] = {
            "format": np.array(FORMAT),
            "settings": np.array(self.settings.to_json()),
            "outcome": np.array(self.outcome.name),
            "message": np.array(self.message),
        }
        np.savez_compressed(file, **header, **arrays)

    @staticmethod
    def load(path: str | Path) -> "Episode":
        """Return the episode that `save` wrote. Nothing in the file is executed.

        Raises:
            EpisodeFileError: not there, not such a file, or damaged.
        """
        try:
            with open(path, "rb") as raw, np.load(raw, allow_pickle=False) as file:
                content = {name: file[name] for name in file.files}
            if str(content["format"]) != FORMAT:
                raise EpisodeFileError(
                    f"{str(path)!r} has the format {str(content['format'])!r}; expected {FORMAT!r}. Record it anew."
                )
            settings = WindingSettings.from_json(str(content["settings"]))
            arrays = {name: read_only(content[name]) for name in _ARRAYS}
            episode = Episode(settings, Outcome[str(content["outcome"])], str(content["message"]), **arrays)
            episode._check()
        except UNREADABLE as error:
            raise EpisodeFileError(
                f"cannot read an episode from {str(path)!r} ({error}); expected a file that `wind --save` wrote, whole."
            ) from error
        return episode

    def _end_points(self, step: int) -> tuple[PointRows, NDArray[np.int_]]:
        """Return the rows of J of a step, and the last joint that moves each link `(n,)`."""
        arm = self.settings.arm
        carriers = np.cumsum([len(arm.hinge_axes(link)) for link in arm.link_numbers]) - 1
        axes = self.axes[step]
        tree = KinematicTree(np.arange(len(axes)) - 1, axes, np.zeros_like(axes), self.anchors[step])
        return PointRows.along_axes(tree, carriers, self.positions[step], AXES), carriers

    def _levels_on_tree(self, step: int, points: PointRows) -> list[TreeLevel]:
        desired, asked = self.desired[step], self._asked(step)
        return [
            level_on_tree(points, group.rows, desired, group.weights, group.name)
            for group in row_groups(self.weights[step, asked], self.priorities[step, asked])
        ]

    def _asked(self, step: int) -> slice:
        """Return which rows of J the levels of a step have."""
        return slice(0, int(np.count_nonzero(self.weights[step])))

    @property
    def _joint_names(self) -> tuple[str, ...]:
        arm = self.settings.arm
        return tuple(f"joint_{link}{axis}" for link in arm.link_numbers for axis in arm.hinge_axes(link))

    def _check(self) -> None:
        t, n, m = self.steps, self.settings.arm.links, self.settings.arm.joint_count
        dense, on_tree = (0, t) if self.is_on_tree else (t, 0)
        expected = {
            "q": (t + 1, m), "positions": (t + 1, n, 3), "directions": (t + 1, n, 3), "distance": (t + 1, n),
            "in_contact": (t + 1, n), "contact_vectors": (t + 1, n, 3), "signs": (t + 1, n),
            "desired": (t, 3 * n), "jacobian": (dense, 3 * n, m), "weights": (t, 3 * n),
            "priorities": (t, 3 * n), "lower": (t, m), "upper": (t, m), "row_matrix": (dense, n, m), "row_upper": (t, n),
            "axes": (on_tree, m, 3), "anchors": (on_tree, m, 3), "row_points": (on_tree, n, 3),
            "row_directions": (on_tree, n, 3), "dtheta": (t, m), "status": (t,),
            "solve_seconds": (t,), "build_seconds": (t,),
        }  # fmt: skip
        for name, shape in expected.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} has shape {getattr(self, name).shape}, expected {shape}")
        rises = np.diff(self.priorities, axis=1)
        if self.priorities.dtype.kind != "i" or self.priorities[:, 0].any() or not np.isin(rises, (0, 1)).all():
            raise ValueError("priorities are not whole numbers that start at 0 and rise by 1 from level to level")


_ARRAYS = [item.name for item in fields(Episode) if item.name not in ("settings", "outcome", "message")]


def wind(
    settings: WindingSettings, method: Method | None = None, on_step: Callable[[int], object] | None = None
) -> Episode:
    """Return the episode of an arm that winds until equilibrium, a failed step, or `max_steps`.

    Args:
        settings: everything that decides it.
        method: finds the steps, instead of the one that `settings.solver` names.
        on_step: called after each step, with how many there are.

    Raises:
        SolverUnavailableError: the solver is unknown or not installed.
        InputError: the initial posture is outside the joint ranges.
    """
    method = method or get_method(settings.solver, settings.options.accuracy)
    n, m = settings.arm.links, settings.arm.joint_count
    states: list[dict[str, Any]] = []
    steps: list[dict[str, Any]] = []
    for moment in moments(WindingController(settings), method, settings.initial_posture()):
        situation = moment.situation
        states.append(
            {
                "q": moment.q,
                "positions": situation.positions,
                "directions": situation.directions,
                "distance": situation.touch.distance,
                "in_contact": situation.in_contact,
                "contact_vectors": situation.contact_vectors,
                "signs": situation.signs,
            }
        )
        if moment.problem is not None and moment.step is not None:
            steps.append(_record(moment.problem, moment.step, n))
            if on_step is not None:
                on_step(len(steps))
    outcome, message = moment.ending
    if outcome is Outcome.SOLVER_FAILED:
        states.append(states[-1])
    arrays = {name: read_only(np.array([state[name] for state in states])) for name in states[0]}
    # An episode may have no step; the pattern of one gives its empty arrays their shapes.
    pattern = _record(IKProblem([Level(np.zeros((3 * n, m)), np.zeros(3 * n))]), JointStep(None, StepStatus.SOLVED), n)
    pattern |= {"axes": np.zeros((m, 3)), "anchors": np.zeros((m, 3))}
    pattern |= {"row_points": np.zeros((n, 3)), "row_directions": np.zeros((n, 3))}
    for name, value in pattern.items():
        column = [step[name] for step in steps if name in step]
        arrays[name] = read_only(np.array(column) if column else np.array([value])[:0])
    return Episode(settings, outcome, message, **arrays)


def replay(episode: Episode) -> Episode:
    """Return the episode wound anew from the same settings: the same bits, timings aside."""
    return wind(episode.settings)


def _record(problem: IKProblem, step: JointStep, links: int) -> dict[str, Any]:
    levels, m, size = problem.levels, problem.joint_count, 3 * links
    upper = np.full(links, np.inf)
    place = {contact_row_name(link + 1): link for link in range(links)}
    priorities = np.repeat(np.arange(len(levels)), [len(level.target) for level in levels])
    near = [place[name] for name in problem.rows.names]
    upper[near] = problem.rows.upper
    tree = tree_of(problem)
    posed = _matrices(problem, near, links) if tree is None else _on_tree(problem, tree, near, links)
    return posed | {
        "desired": _padded(np.concatenate([level.target for level in levels]), size),
        "weights": _padded(np.concatenate([level.weights for level in levels]), size),
        "priorities": np.pad(priorities, (0, size - len(priorities)), mode="edge"),
        "lower": problem.bounds.lower,
        "upper": problem.bounds.upper,
        "row_upper": upper,
        "dtheta": np.full(m, np.nan) if step.dtheta is None else step.dtheta,
        "status": step.status.name,
        "solve_seconds": step.timings.solve,
        "build_seconds": step.timings.build,
    }


def _matrices(problem: IKProblem, near: list[int], links: int) -> dict[str, Any]:
    """Return J and the contact rows of the links `near`."""
    matrix = np.zeros((links, problem.joint_count))
    matrix[near] = problem.rows.matrix
    jacobian = _padded(np.vstack([level.matrix for level in problem.levels]), 3 * links)
    return {"jacobian": jacobian, "row_matrix": matrix}


def _padded(values: Array, size: int) -> Array:
    """Return `values` with zeros after them, `size` in all."""
    return np.concatenate([values, np.zeros((size - len(values), *values.shape[1:]))])


def _on_tree(problem: IKProblem, tree: KinematicTree, near: list[int], links: int) -> dict[str, Any]:
    """Return what is known in their place on a tree."""
    points, directions = np.zeros((2, links, 3))
    if isinstance(problem.rows, TreeRows):
        points[near], directions[near] = problem.rows.points.points, problem.rows.points.directions
    return {"axes": tree.angular, "anchors": tree.anchors, "row_points": points, "row_directions": directions}
