"""What is known of a row by comparison with the others of the same problem. Pure, and quick on 100,000 rows."""

from collections import Counter
from collections.abc import Callable

import numpy as np
import polars
from numpy.typing import NDArray

from prioritized_ik.validation import Array, lengths

#: Only steps that keep every row this well can set the best cost: a step that breaks a row by the accepted 1e-6 of its size
#: gains a few 1e-6 of cost by it.
BEST_KEEPS = 1e-8

PROBLEM = ("case", "step")


def compared(steps: polars.DataFrame) -> polars.DataFrame:
    """Return `steps` with the columns `tables.COMPARED`.

    - `cost_gap`: level-1 cost above the best one, over the cost of not moving.
    - `dtheta_spread`: distance of dθ from the median of the lexicographic answers at the finest accuracy, relative. The
      optimum is unique, so that on a step where rows bind the distance is an error of somebody.
    - `certified_spread`: distance of a certified dθ from the one that most lexicographic answers have, relative, and
      `certified_same_bits`, whether it is that to the last bit.
    """
    best = polars.col("cost").filter(polars.col("violation") <= BEST_KEEPS).min().over(PROBLEM)
    steps = steps.with_columns(cost_gap=(polars.col("cost") - best) / polars.col("cost_at_zero"))
    exact = steps["formulation"] == "lexicographic"
    finest = steps.filter(exact)["accuracy"].min()
    at_finest = exact & (steps["accuracy"] == finest).fill_null(value=False) if finest is not None else exact
    groups = _groups(steps)
    spread = _distances(steps["dtheta"], groups, at_finest.to_numpy(), _median)
    certified_spread = _distances(steps["certified_dtheta"], groups, exact.to_numpy(), _most_common)
    return steps.with_columns(
        dtheta_spread=spread, certified_spread=certified_spread, certified_same_bits=certified_spread == 0.0
    )


def _groups(steps: polars.DataFrame) -> list[NDArray[np.int64]]:
    """Return the row numbers of each problem."""
    numbers = steps.with_row_index("row").group_by(PROBLEM, maintain_order=True).agg("row")["row"]
    return [group.to_numpy().astype(np.int64) for group in numbers]


def _distances(
    answers: polars.Series, groups: list[NDArray[np.int64]], exact: NDArray[np.bool_], middle: Callable[[Array], Array]
) -> polars.Series:
    """Return how far each answer is, relative, from the `middle` of the `exact` ones of its group; null without one."""
    sizes = answers.list.len().fill_null(0).to_numpy().astype(np.int64)
    starts = np.cumsum(sizes) - sizes
    values = answers.drop_nulls().explode().to_numpy()
    distances = np.full(len(answers), np.nan)
    for group in groups:
        rows = group[sizes[group] > 0]
        if exact[rows].any():
            found = values[starts[rows][:, None] + np.arange(sizes[rows[0]])]
            centre = middle(found[exact[rows]])
            distances[rows] = lengths(found - centre) / (float(np.linalg.norm(centre)) or 1.0)
    return polars.Series(distances).fill_nan(None)


def _median(found: Array) -> Array:
    return np.median(found, axis=0)


def _most_common(found: Array) -> Array:
    """Return the most frequent row `(m,)`, the first of those equally frequent."""
    ((usual, _),) = Counter(row.tobytes() for row in found).most_common(1)
    return np.frombuffer(usual)
