"""What became of each level's rank: nothing that was asked for is dropped in silence."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import overload

import numpy as np

from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.blocks import EqualBlock
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.tolerances import ROUNDING
from prioritized_ik.validation import Array


@dataclass(frozen=True)
class LevelReport:
    """How a level's matrix was cut to its rank in the directions that the levels above leave.

    Attributes:
        level: its name.
        rank: how many directions it decides.
        smallest_kept: smallest singular value that counts, relative to `relative_to`; None if none does.
        largest_cut: largest one taken for zero; None if none was.
        relative_to: what a singular value of 1 is.
        undone: √ of the part of its cost along what was cut, in the level's units: what was left undone by the cut alone.
    """

    level: str
    rank: int
    smallest_kept: float | None
    largest_cut: float | None
    relative_to: str
    undone: float

    def __str__(self) -> str:
        """Return one line for people."""
        if self.largest_cut is None or not self.undone:
            return f"{self.level}: rank {self.rank}"
        return (
            f"{self.level}: rank {self.rank}; directions up to {self.largest_cut:.0e} of {self.relative_to} were cut, "
            f"which left {self.undone:.3g} undone"
        )


def level_reports(hierarchy: Hierarchy, u: Array) -> tuple[LevelReport, ...]:
    """Return the report of every `equal` level at the step `u` `(m,)`, the most important first."""
    return tuple(
        _report(level.name, block, np.sqrt(level.weights), level.residual(u))
        for level, block in zip(hierarchy.problem.levels, hierarchy.blocks, strict=True)
        if isinstance(block, EqualBlock)
    )


class DeferredReports(Sequence[LevelReport]):
    """The reports of a problem's levels at a step, worked out when first looked at."""

    def __init__(self, problem: IKProblem, rank_tolerance: float, dtheta: Array) -> None:
        self._problem, self._rank_tolerance, self._dtheta = problem, rank_tolerance, dtheta

    @cached_property
    def _reports(self) -> tuple[LevelReport, ...]:
        return level_reports(Hierarchy(self._problem, self._rank_tolerance), self._problem.to_metric(self._dtheta))

    @overload
    def __getitem__(self, place: int) -> LevelReport: ...
    @overload
    def __getitem__(self, place: slice) -> Sequence[LevelReport]: ...
    def __getitem__(self, place: int | slice) -> LevelReport | Sequence[LevelReport]:
        return self._reports[place]

    def __len__(self) -> int:
        return len(self._reports)

    def __eq__(self, other: object) -> bool:
        return self._reports == tuple(other) if isinstance(other, Sequence) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._reports)

    def __repr__(self) -> str:
        return repr(self._reports)


def _report(name: str, block: EqualBlock, roots: Array, residual: Array) -> LevelReport:
    kept, cut = block.spectrum.kept, block.spectrum.cut
    undone = 0.0
    real = cut > ROUNDING  # what is zero serves nothing: the level cannot do it, or levels above have decided it
    if real.any():
        # Of the residual, what the cut directions would serve and the kept ones cannot.
        served = block.spectrum.cut_rows[real] * roots
        sizes = np.linalg.norm(served, axis=1)
        undone = float(np.linalg.norm((served / np.where(sizes > 0.0, sizes, 1.0)[:, None]) @ (roots * residual)))
    return LevelReport(
        name,
        len(kept),
        float(kept[-1]) if len(kept) else None,
        float(cut[0]) if len(cut) else None,
        block.spectrum.relative_to,
        undone,
    )
