"""Performance profiles for the page: who answers how many steps within τ times the fastest, on a common grid of τ. Pure.

The fastest is that of the same formulation: another one is another problem, which can be quicker to solve and still come
within the tolerance of this one's cost.
"""

from typing import Any

import numpy as np
import polars

from comparisons.page.series import STEP, Answers
from comparisons.profiles import performance_profiles
from prioritized_ik.validation import Array

#: What counts as an answer: wrong by this much at most, and what the page calls it.
WITHIN = {1e-9: "right within 1e-9", 1e-6: "right within 1e-6", 1e-3: "right within 1e-3", np.inf: "any accepted answer"}
AT_FIRST = 1e-6  # what the verdicts ask for
POINTS = 160
FURTHEST = 1e3  # τ up to which a profile is drawn at most
ROUNDING = 1e-12  # of a ratio


def profiles(answers: Answers) -> dict[str, Any]:
    """Return `ratios` (τ) and for each entry of `WITHIN` its `label` and `shares`, one list for each series."""
    stairs = [stairs_of(answers, within) for within in WITHIN]
    furthest = max((float(reached[-1]) for kind in stairs for reached, _ in kind if len(reached)), default=1.0)
    ratios = np.geomspace(1.0, max(2.0, min(FURTHEST, furthest)), POINTS)
    return {
        "ratios": [round(float(ratio), 4) for ratio in ratios],
        "first": list(WITHIN).index(AT_FIRST),
        "kinds": [
            {"label": label, "shares": [_on(ratios, *one).round(4).tolist() for one in kind]}
            for label, kind in zip(WITHIN.values(), stairs, strict=True)
        ],
    }


def stairs_of(answers: Answers, within: float) -> list[tuple[Array, Array]]:
    """Return the profile of each series: ratios, ascending, and the share of steps answered within each."""
    stairs: list[tuple[Array, Array]] = [(np.zeros(0), np.zeros(0))] * len(answers.series)
    for formulation in dict.fromkeys(series.formulation for series in answers.series):
        own = [number for number, series in enumerate(answers.series) if series.formulation == formulation]
        names = [str(number) for number in own]
        found = performance_profiles(_times(answers.table.filter(polars.col("series").is_in(own)), own, within), names)
        for number, name in zip(own, names, strict=True):
            one = found.filter(name=name)
            stairs[number] = (one["ratio"].to_numpy(), one["fraction"].to_numpy())
    return stairs


def _on(grid: Array, ratios: Array, shares: Array) -> Array:
    """Return the stairs on a grid of ratios."""
    return np.concatenate([[0.0], shares])[np.searchsorted(ratios, grid * (1.0 + ROUNDING), "right")]


def _times(table: polars.DataFrame, series: list[int], within: float) -> Array:
    """Return the time of each step and series `(p, s)` [s], infinite without an answer that counts."""
    problems = table.select(STEP).unique(maintain_order=True).with_row_index("problem")
    counts = polars.col("found") if np.isinf(within) else polars.col("found") & (polars.col("error") <= within)
    given = table.join(problems, on=list(STEP)).filter(counts & polars.col("seconds").is_not_null())
    times = np.full((len(problems), len(series)), np.inf)
    place = {number: column for column, number in enumerate(series)}
    times[given["problem"].to_numpy(), [place[number] for number in given["series"]]] = given["seconds"].to_numpy()
    return times
