"""DAQP's own solver of hierarchies: all levels in one call, each a block of rows that ends at a break point.

From the top level down DAQP makes the rows of a level soft, minimises ½‖x - t‖² + ½‖excess‖² / ρ with the rows so far,
moves the sides of the exceeded rows to where that left them, and makes them hard. An excess counts in rows of unit length,
so the rows of a weighted level must be of one length, or the weights become others. Here they are unit vectors, of

    x_k = N_k (dθ - start)  for `equal` level k, whose cost is ‖x_k - t_k‖² and no more (see `hierarchy.EqualBlock`),
    e_k                     for soft level k, its excesses, which are to be zero; its own rows, less e_k, are hard,
    z = Zᵀ(dθ - start)      along the directions Z that no `equal` level feels, for the reference,

so that each level's least squares is its own, weights and all. t is what all levels would have: where nothing binds it is
the answer. Where rows bind, a level gives way to those below it by a share of ρ: on recorded winding steps dθ is off by
1e-13 in the median and by 1e-6 at most in 99 of 100; in one of 300 DAQP ends on other rows.

Traps of DAQP 0.11: the documented call, without a linear term, returns -8; dependent equality rows are an error; and exit
flag 3 stands for a level that failed, with the answer to those above it, as well as for one that had no freedom left.
"""

import importlib.metadata
from dataclasses import dataclass
from functools import cached_property, partial

import daqp
import numpy as np
from numpy.typing import NDArray

from prioritized_ik.solvers.backends.abilities import abilities_of
from prioritized_ik.solvers.backends.protocol import SolverFailedError, StageResult
from prioritized_ik.solvers.backends.qpsolvers_ import SOLVER_ERRORS
from prioritized_ik.solvers.blocks import HARD, EqualBlock
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.solvers.lexicographic import Clock
from prioritized_ik.solvers.methods import Guessing
from prioritized_ik.validation import Array

SOLVED = (1, 2)  # exit flags: all rows kept; soft rows exceeded

#: What its other exit flags stand for.
FAILURES = {
    3: "a level was lost, as where rows are nearly dependent",
    -1: "infeasible",
    -2: "cycling",
    -3: "unbounded",
    -4: "iteration limit",
    -5: "not convex",
    -6: "dependent equality rows",
}
INFINITY = 1e30

#: Primal tolerance, as a multiple of the accuracy, and ρ of each attempt. Where tight rows are nearly dependent DAQP loses
#: a level: of 148 random hierarchies full of such rows, 70 in one attempt, 35 in two, 23 in three and 3 in four.
ATTEMPTS = ((1e-2, 1e-8), (1.0, 1e-7), (1.0, 1e-6), (10.0, 1e-4))

#: Unit of z, in lengths the step is likely to have. A larger one weighs z less against the levels: with 1, the answers to
#: one or two winding steps in a hundred rest on other rows, with 10 none.
REST_UNIT = 10.0


@dataclass(frozen=True)
class LevelRows:
    """A hierarchy in DAQP's form: lower <= rows x <= upper, hard rows first, then one level up to each break point.

    Attributes:
        rows: `(r, v)`.
        lower: `(r,)`.
        upper: `(r,)`.
        break_points: where the hard rows and each level end.
        target: t `(v,)`.
        basis: `(m, v)`: dθ = start + `basis` @ x.
    """

    rows: Array
    lower: Array
    upper: Array
    break_points: NDArray[np.intc]
    target: Array
    basis: Array

    @staticmethod
    def of(hierarchy: Hierarchy) -> "LevelRows":
        """Return the rows of all levels of a problem."""
        basis, target, ends = _variables(hierarchy)
        matrix, lower, upper = _hard_rows(hierarchy)
        parts = [(matrix @ basis, lower, upper)]
        pooled, slack = hierarchy.rows, hierarchy.rows.slack(hierarchy.start)
        for number, block in enumerate(hierarchy.blocks):
            if block.is_soft:
                own = pooled.level == number
                matrix = pooled.matrix[own] @ basis
                matrix[:, ends[number] : ends[number + 1]] = -np.diag(_unit(hierarchy, number) / pooled.strengths[own])
                parts.append((matrix, np.full(len(matrix), -INFINITY), slack[own]))
        ends = ends + sum(len(part[1]) for part in parts)
        parts.append((np.eye(len(target)), target, target))
        rows, lower, upper = (np.concatenate(column) for column in zip(*parts, strict=True))
        return LevelRows(rows, lower, upper, np.unique(ends).astype(np.intc), target, basis)


class DaqpHierarchy(Guessing):
    """DAQP with break points, started cold, makes the kernel's guess.

    Attributes:
        accuracy: asked of the solver, in the levels' scaled variables.
    """

    name = "daqp-hierarchy"

    def __init__(self, accuracy: float) -> None:
        self.accuracy = accuracy

    @cached_property
    def version(self) -> str:
        """Version of the solver's package."""
        return importlib.metadata.version(abilities_of("daqp").package)

    def guess(self, hierarchy: Hierarchy, clock: Clock) -> Array | str:
        """See `Guessing.guess`."""
        result = clock.timed(partial(self.solve_whole, hierarchy))
        return result.message if result.x is None else result.x

    def solve_whole(self, hierarchy: Hierarchy) -> StageResult:
        """Return the joint step `(m,)`, in the joint metric, as x, or a result without x that says what went wrong."""
        if not hierarchy.free.shape[1]:
            return StageResult(hierarchy.start, calls=0)
        levels, message = LevelRows.of(hierarchy), ""
        for calls, (multiple, rho) in enumerate(ATTEMPTS, start=1):
            try:
                x = self._call(levels, min(multiple * self.accuracy, 0.1), rho)
            except SolverFailedError as failure:
                message = message or str(failure)
            else:
                return StageResult(hierarchy.start + levels.basis @ x, calls=calls)
        return StageResult(None, message, len(ATTEMPTS))

    def _call(self, levels: LevelRows, primal_tol: float, rho: float) -> Array:
        """Return the finite x `(v,)` of one attempt."""
        try:
            x, _, flag, _ = daqp.solve(
                np.eye(len(levels.target)),
                -levels.target,
                levels.rows,
                levels.upper,
                levels.lower,
                np.zeros(len(levels.upper), dtype=np.intc),
                levels.break_points,
                primal_tol=primal_tol,
                rho_soft=rho,
            )
        except SOLVER_ERRORS as error:
            raise SolverFailedError(f"{self.name} raised {type(error).__name__}: {error}") from error
        if flag not in SOLVED:
            reason = FAILURES.get(flag, "unknown")
            raise SolverFailedError(f"{self.name} found no solution (exit flag {flag}: {reason})")
        if not np.isfinite(x).all():
            raise SolverFailedError(f"{self.name} returned values that are not finite")
        return x


def _variables(hierarchy: Hierarchy) -> tuple[Array, Array, NDArray[np.int_]]:
    """Return how the step moves with the variables `(m, v)`, their targets `(v,)`, and where each level's begin."""
    start = hierarchy.start
    columns, targets = [], []
    for number, block in enumerate(hierarchy.blocks):
        unit = _unit(hierarchy, number)
        if not isinstance(block, EqualBlock):
            count = int(np.count_nonzero(hierarchy.rows.level == number))
            columns.append(np.zeros((len(start), count)))
            targets.append(np.zeros(count))
        else:
            moves = block.inverse
            for lower in hierarchy.blocks[number + 1 :]:  # which stay where they are
                if isinstance(lower, EqualBlock):
                    moves = moves - lower.inverse @ (lower.matrix @ moves)
            columns.append(unit * moves)
            targets.append(block.missing(start) / unit)
    unit = REST_UNIT * hierarchy.length
    columns.append(unit * hierarchy.rest)
    targets.append(hierarchy.rest.T @ (hierarchy.problem.reference - start) / unit)
    return np.hstack(columns), np.concatenate(targets), np.cumsum([0, *map(len, targets)])


def _unit(hierarchy: Hierarchy, number: int) -> float:
    """Return in what a level's variables are counted: its own size, as in `stages`."""
    block = hierarchy.blocks[number]
    if isinstance(block, EqualBlock):
        sizes = [block.missing(hierarchy.start), block.target]
    else:
        rows = hierarchy.rows
        own, excess = rows.level == number, np.minimum(rows.slack(hierarchy.start), 0.0)
        sizes = [rows.strengths[own] * size[own] for size in (excess, rows.upper)]
    return max(float(np.linalg.norm(size)) for size in sizes) or 1.0


def _hard_rows(hierarchy: Hierarchy) -> tuple[Array, Array, Array]:
    """Return the hard rows that can move `(r, m)` and their sides seen from the start; a joint's two bounds are one row."""
    bounds, rows = hierarchy.problem.bounds, hierarchy.rows
    upper = rows.slack(hierarchy.start)
    lower, kept = np.full(len(upper), -INFINITY), rows.level == HARD
    above, below = np.isfinite(bounds.upper), np.isfinite(bounds.lower)
    both = above & below
    first, second = np.cumsum(above)[both] - 1, np.count_nonzero(above) + np.cumsum(below)[both] - 1
    lower[first], kept[second] = -upper[second], False
    numbers = np.flatnonzero(kept)
    numbers = numbers[rows.reach(numbers, hierarchy.free) > hierarchy.settled]
    return rows.matrix[numbers], lower[numbers], upper[numbers]
