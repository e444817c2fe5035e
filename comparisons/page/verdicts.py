"""The verdict table and the one sentence above it. Pure."""

from typing import Any

from comparisons.report import COLUMNS, LEGEND
from comparisons.summary import Row

TEXT = ("solver", "version", "formulation", "verdict")  # columns that are no figures

TOLD = 4  # disagreeing solvers that the sentence names

#: What people look for comes first, so that a phone shows it.
FIRST, LAST = ("solver", "verdict", "formulation", "accuracy", "p50 [ms]", "p99 [ms]"), ("version",)


def verdicts(rows: list[Row]) -> dict[str, Any]:
    """Return `columns` (`name`, `text`), `rows` (`verdict` in one word, `cells`) and the `legend`.

    There is a column more, `accuracy`, if there are several.
    """
    columns = dict(COLUMNS)
    if len({row.accuracy for row in rows if row.accuracy is not None}) > 1:
        columns["accuracy"] = lambda row: "–" if row.accuracy is None else f"{row.accuracy:.0e}"
    names = [name for name in columns if name not in (*FIRST, *LAST)]
    names = [name for name in (*FIRST, *names, *LAST) if name in columns]
    return {
        "columns": [{"name": name, "text": name in TEXT} for name in names],
        "rows": [{"verdict": row.verdict.split(":")[0], "cells": [columns[name](row) for name in names]} for row in rows],
        "legend": LEGEND,
    }


def finding(rows: list[Row]) -> str:
    """Return what the comparison found, in a sentence or two."""
    claim = [row for row in rows if row.must_agree]
    if not claim:
        return "No solver was asked for exact steps."
    several = len({row.accuracy for row in claim}) > 1

    def who(row: Row) -> str:
        return f"{row.solver} at {row.accuracy:.0e}" if several and row.accuracy is not None else row.solver

    agree = [row for row in claim if row.agrees]
    others = [f"{who(row)} {row.verdict}" for row in claim if not row.agrees]
    noun = "pairs of solver and accuracy" if several else "solvers"
    if not others:
        text = f"All {len(claim)} {noun} agree with the closed form and with each other."
    else:
        text = f"{len(agree)} of {len(claim)} {noun} agree. The others: {', '.join(others[:TOLD])}"
        text += f", and {len(others) - TOLD} more." if len(others) > TOLD else "."
    timed = [(row.solve_time_p50_s, who(row)) for row in agree if row.solve_time_p50_s is not None]
    if timed:
        seconds, name = min(timed)
        text += f" The fastest that agrees is {name}, with a median of {1e3 * seconds:.2f} ms a step."
    return text
