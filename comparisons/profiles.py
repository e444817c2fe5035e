"""Summaries of times and successes over many problems. Pure.

The shifted geometric mean and the performance profile are those that benchmarks of solvers use: D. E. Dolan and J. J. Moré,
"Benchmarking optimization software with performance profiles", Math. Program. 91 (2002), and H. D. Mittelmann's pages.
"""

from collections.abc import Sequence

import numpy as np
import polars
from numpy.typing import ArrayLike

from prioritized_ik.errors import InputError
from prioritized_ik.validation import Array

SHIFT = 1e-3  # [s] of the shifted geometric mean: a tenth of the time of a slow step, so that the quickest do not decide

#: Success is counted up to each of these relative errors.
TOLERANCES = tuple(10.0**power for power in range(-12, -1))

WHO = ("solver", "formulation", "accuracy")
PROBLEM = ("case", "step")


def shifted_geometric_mean(times: ArrayLike, shift: float = SHIFT) -> float:
    """Return exp(mean(log(t + s))) - s of `times` `(n,)` [s] with the shift s [s]; NaN of none."""
    values = np.asarray(times, dtype=float)
    return float(np.exp(np.log(values + shift).mean()) - shift) if values.size else float("nan")


def performance_profiles(times: ArrayLike, names: Sequence[str]) -> polars.DataFrame:
    """Return the performance profiles ρ_s(τ) of solvers, Eq. (2.1) of Dolan and Moré.

    Args:
        times: of each problem and solver `(p, s)`; infinite where the solver failed.
        names: of the solvers `(s,)`.

    Returns:
        `name`, `ratio` τ and `fraction` ρ: a step each time a solver has one problem more within τ times the best time. A
        problem that no solver solves counts against all.

    Raises:
        InputError: shapes that do not fit, or times that are not positive.
    """
    table = np.asarray(times, dtype=float)
    if table.ndim != 2 or table.shape[1] != len(names):
        raise InputError(f"times has shape {table.shape}; expected (problems, {len(names)}), a column for each name.")
    if not (table > 0.0).all():
        raise InputError("times holds values that are not above 0; expected seconds, infinite where a solver failed.")
    best = table.min(axis=1, keepdims=True, initial=np.inf)
    solved = np.isfinite(best[:, 0])
    ratios = np.sort(table[solved] / best[solved], axis=0)
    rows: list[tuple[str, float, float]] = []
    for name, column in zip(names, ratios.T, strict=True):
        reached = column[np.isfinite(column)]
        taus, counts = np.unique(reached, return_counts=True)
        rows += [(name, tau, count / len(table)) for tau, count in zip(taus, np.cumsum(counts), strict=True)]
    return polars.DataFrame(
        rows, schema={"name": polars.String, "ratio": polars.Float64, "fraction": polars.Float64}, orient="row"
    )


def success(steps: polars.DataFrame, tolerances: Sequence[float] = TOLERANCES) -> polars.DataFrame:
    """Return for each solver, formulation and accuracy the `fraction` of steps right within each relative `tolerance`."""
    right = [(polars.col("found") & (error() <= tolerance)).fill_null(value=False).mean() for tolerance in tolerances]
    named = [fraction.alias(str(number)) for number, fraction in enumerate(right)]
    wide = steps.group_by(*WHO, maintain_order=True).agg(named)
    long = wide.unpivot(index=list(WHO), variable_name="number", value_name="fraction")
    known = polars.Series(tolerances, dtype=polars.Float64)
    return long.select(*WHO, known.gather(long["number"].cast(polars.Int64)).alias("tolerance"), "fraction")


def error() -> polars.Expr:
    """Return the relative error of a step: of dX and dθ where no row binds, elsewhere of dX.

    Where rows bind, dX is measured against the certified step; without one the error is unknown, and null. There dθ can
    rest on directions that cost next to nothing, and tells of the problem rather than of the solver.
    """
    free = polars.max_horizontal("dtheta_error", "dx_error")
    return polars.when("free").then(free).otherwise("certified_dx_error")


def per_problem(steps: polars.DataFrame) -> Array:
    """Return the time of building and solving each problem `(p,)` [s], median over repeats."""
    medians = steps.group_by(*PROBLEM).agg((polars.col("build_s") + polars.col("solve_s")).median().alias("time"))
    return medians["time"].drop_nulls().to_numpy()
