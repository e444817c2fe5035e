"""From a problem on a kinematic tree to the joint step of the compiled core, or to why it declines."""

import struct
from collections.abc import Collection
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.kinematic_tree import PointRows
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.compiled.fast import STATUS, CompiledStep, Remembered, Written, guessed, step_of
from prioritized_ik.solvers.compiled.library import Ending, Question, library
from prioritized_ik.solvers.compiled.tree import checked, given_back, taken
from prioritized_ik.solvers.compiled.workspace import COUNTS, FIGURES, Answer, recent_names
from prioritized_ik.tree_problem import TreeLevel, TreeRows

PATH = "tree"

_NO_ROWS = (0,) * 6
_REALS, _INTEGERS = np.zeros(0).__array_interface__["typestr"], np.zeros(0, dtype=np.int64).__array_interface__["typestr"]


def compiled_tree_step(
    problem: IKProblem, rank_tolerance: float, rows: Collection[str] | Remembered, question: Question, method: str
) -> CompiledStep | Ending:
    """Return the certified step of a problem that `is_on_tree`, or why the core declines; see `tree.step.tree_step`."""
    started = perf_counter()
    core = library().core
    if core is None:
        return Ending.UNPROVEN
    m, levels, c = len(problem.reference), len(problem.levels), len(problem.rows.upper)
    names, numbers = recent_names(problem.bounds.names, problem.rows.names)
    every, told = 2 * m + c, m + FIGURES * (levels + 1) + 2 + levels
    kept_at = 8 * told
    lists_at = kept_at + (every + 7) // 8 * 8
    room = np.empty(lists_at + 4 * (COUNTS + 2 * (levels + 2) * every), dtype=np.uint8)
    guess = np.frombuffer(guessed(rows, names, numbers), dtype=np.uint8) if rows else None
    places = _Places()
    reals, integers, place = places.of_reals, places.of_integers, places.of
    tree = problem.levels[0].points.tree  # type: ignore[attr-defined]
    given = [
        *(rank_tolerance, m, levels, question),
        *(integers(tree.parents), reals(tree.angular), reals(tree.linear), reals(tree.anchors)),
        *(reals(problem.metric), reals(problem.bounds.lower), reals(problem.bounds.upper), reals(problem.reference)),
        0 if guess is None else place(guess),
        *(start := place(room), start + 8 * m, start + lists_at, start + kept_at),
    ]
    given += (
        places.of_rows(problem.rows.points, problem.rows.upper, None)
        if isinstance(problem.rows, TreeRows) and c
        else _NO_ROWS
    )
    for level in problem.levels:
        assert isinstance(level, TreeLevel)
        given += places.of_rows(level.points, level.target, level.weights)
    address = taken(core)
    try:
        told = checked(core.core_tree_step(address, struct.pack(f"d{len(given) - 1}q", *given)))
    finally:
        given_back(core, address)
    status = STATUS.get(told & 0xFF)
    if status is None:
        return Ending(told & 0xFF)
    answer = Answer(bytearray(room.data[: lists_at + 4 * (told >> 8)]), 8 * m, kept_at, lists_at)
    active, dtheta = Remembered(names, answer.kept_rows(every)), answer.dtheta(m)
    written = Written(problem, rank_tolerance, dtheta, answer, active, perf_counter() - started)
    return step_of(status, PATH, method, written)


class _Places:
    """Addresses of arrays, and of copies of those that the core cannot read as they are, which live as long as this."""

    def __init__(self) -> None:
        self._copies: list[NDArray[Any]] = []

    def of(self, array: NDArray[Any]) -> int:
        """Return the address of an array that is as the core takes it."""
        address: int = array.__array_interface__["data"][0]
        return address

    def of_reals(self, array: NDArray[Any]) -> int:
        """Return where doubles are, one after the other."""
        return self._of_kind(array, _REALS)

    def of_integers(self, array: NDArray[Any]) -> int:
        """Return where whole numbers of eight bytes are, one after the other."""
        return self._of_kind(array, _INTEGERS)

    def of_rows(self, points: PointRows, targets: NDArray[Any], weights: NDArray[Any] | None) -> list[int]:
        """Return the numbers of `TreeRows` in tree_problem.hpp."""
        reals = self.of_reals
        return [
            len(targets),
            self.of_integers(points.joints),
            reals(points.points),
            reals(points.directions),
            reals(targets),
            0 if weights is None else reals(weights),
        ]

    def _of_kind(self, array: NDArray[Any], kind: str) -> int:
        face = array.__array_interface__
        if face["strides"] is not None or face["typestr"] != kind:
            array = np.ascontiguousarray(array, dtype=kind)
            self._copies.append(array)
            face = array.__array_interface__
        address: int = face["data"][0]
        return address
