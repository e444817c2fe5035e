"""How many digits of dθ any two series share, over the steps that both answered. Pure."""

from typing import Any

import numpy as np

from comparisons.page.series import STEP, Answers
from prioritized_ik.validation import Array

ALL_DIGITS = 16.0  # of a double: more cannot be told apart

#: Column of an answer, and what the page calls it.
ANSWERS = {"dtheta": "own answer", "certified_dtheta": "certified step"}


def agreement(answers: Answers) -> list[dict[str, Any]]:
    """Return for each kind of answer the digits on the worst and on the median common step.

    Each entry has `label`, `worst` and `median`: lists of lists (series × series), None where no step is common.
    """
    return [
        {"label": label, "worst": _listed(worst), "median": _listed(median)}
        for column, label in ANSWERS.items()
        for worst, median in [digits(distances(answers, column))]
    ]


def distances(answers: Answers, column: str) -> Array:
    """Return the relative distances `(s, s, steps)` between the answers in `column`, NaN where one is missing.

    Relative to the longer of the two answers; zero between two answers of zero.
    """
    count = len(answers.series)
    parts = [np.zeros((count, count, 0))]
    for (_case,), table in answers.table.group_by(["case"], maintain_order=True):
        given = table.filter(table[column].is_not_null())
        if given.is_empty():
            continue
        steps = given.select(STEP[1]).unique().sort(STEP[1]).to_series().to_list()
        place = {step: number for number, step in enumerate(steps)}
        stacked = np.full((count, len(steps), len(given[column][0])), np.nan)
        stacked[given["series"].to_list(), [place[step] for step in given["step"]]] = np.array(given[column].to_list())
        size = np.linalg.norm(stacked, axis=2)
        apart = np.stack([np.linalg.norm(stacked - one, axis=2) for one in stacked])
        longer = np.maximum(size[:, None], size[None])
        parts.append(np.divide(apart, longer, out=np.where(np.isnan(apart), np.nan, 0.0), where=longer > 0.0))
    return np.concatenate(parts, axis=2)


def digits(relative: Array) -> tuple[Array, Array]:
    """Return the digits on the worst and on the median step `(s, s)` of `relative` distances; NaN without any."""
    with np.errstate(divide="ignore"):
        shared = np.clip(-np.log10(relative), 0.0, ALL_DIGITS)
    known = ~np.isnan(shared)
    some = known.any(axis=2)
    worst = np.where(some, np.where(known, shared, np.inf).min(axis=2, initial=np.inf), np.nan)
    median = np.full(worst.shape, np.nan)
    if some.any():
        median[some] = np.nanmedian(shared[some], axis=1)
    return worst, median


def _listed(matrix: Array) -> list[list[float | None]]:
    return [[None if np.isnan(value) else round(float(value), 1) for value in row] for row in matrix]
