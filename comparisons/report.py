"""The table, for a terminal and as Markdown, from the same rows."""

import io
from collections.abc import Callable
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from comparisons.summary import Row

Cell = Callable[[Row], str]


def _number(name: str, style: str, factor: float = 1.0) -> Cell:
    def cell(row: Row) -> str:
        value = getattr(row, name)
        return "–" if value is None else format(value * factor, style)

    return cell


COLUMNS: dict[str, Cell] = {
    "solver": lambda row: row.solver,
    "version": lambda row: row.version,
    "formulation": lambda row: row.formulation,
    "verdict": lambda row: row.verdict,
    "free: dθ max": _number("free_dtheta_error_max", ".0e"),
    "median": _number("free_dtheta_error_median", ".0e"),
    "dX max": _number("free_dx_error_max", ".0e"),
    "bound: violation": _number("constrained_violation_max", ".0e"),
    "cost gap": _number("cost_gap_max", ".0e"),
    "not found": lambda row: f"{row.not_found}/{row.free_steps + row.constrained_steps}" if row.free_steps else "–",
    "p50 [ms]": _number("solve_time_p50_s", ".2f", 1e3),
    "p99 [ms]": _number("solve_time_p99_s", ".1f", 1e3),
    "wound": lambda row: f"{row.wound}/{row.episodes}" if row.episodes else "–",
    "turns": _number("turns_ratio_min", ".2f"),
    "pen. [mm]": _number("penetration_max_m", ".1f", 1e3),
    "bend [rad]": _number("bend_max_rad", ".2f"),
    "drift [mm]": _number("drift_max_m", ".1f", 1e3),
}

LEGEND = (
    "free: steps on which no row binds, relative error against Eqs. 12-15; bound: the other steps, worst violation of an "
    "accepted step relative to its size, and level-1 cost above the best found relative to the cost of not moving; "
    "p50, p99: build and solve one step; wound, turns (over the ideal), pen., bend, drift: worst of the windings that the "
    "solver drove itself."
)

_STYLES = {"agrees": "green", "reference": "cyan", "disagrees": "yellow", "fails": "red"}


def table(rows: list[Row], *, markdown: bool = False) -> Table:
    """Return the table of `rows`."""
    drawn = Table(box=box.MARKDOWN if markdown else box.SIMPLE_HEAD, show_edge=True)
    for name in COLUMNS:
        left = name in ("solver", "version", "formulation", "verdict")
        drawn.add_column(name, justify="left" if left else "right", no_wrap=True)
    for row in rows:
        colour = "" if markdown else _STYLES[row.verdict.split(":")[0]]
        drawn.add_row(*[cell(row) for cell in COLUMNS.values()], style=colour)
    return drawn


def markdown(rows: list[Row], facts: dict[str, Any]) -> str:
    """Return the table with what it was made by, as Markdown."""
    text = io.StringIO()
    Console(file=text, width=400).print(table(rows, markdown=True))
    lines = [line.strip() for line in text.getvalue().splitlines() if line.strip()]
    stated = ", ".join(f"{name} {value}" for name, value in facts.items())
    return "\n".join([*lines, "", LEGEND, "", stated + "."]) + "\n"
