"""The table, for a terminal and as Markdown, from the same rows."""

from collections.abc import Callable
from typing import Any

import polars
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from comparisons.drawn import as_markdown, blank
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
    "accuracy": lambda row: "–" if row.accuracy is None else f"{row.accuracy:.0e}",
    "verdict": lambda row: row.verdict,
    "right": _number("right_fraction", ".1%"),
    "dθ max": _number("free_dtheta_error_max", ".0e"),
    "dθ median": _number("free_dtheta_error_median", ".0e"),
    "dX max": _number("free_dx_error_max", ".0e"),
    "violation": _number("constrained_violation_max", ".0e"),
    "cost gap": _number("cost_gap_max", ".0e"),
    "bound dX": _number("constrained_dx_error_max", ".0e"),
    "bound dθ": _number("constrained_dtheta_spread_median", ".0e"),
    "max": _number("constrained_dtheta_spread_max", ".0e"),
    "certified": _number("certified_fraction", ".1%"),
    "own guess": _number("own_guess_fraction", ".1%"),
    "certified dθ": _number("certified_dtheta_spread_max", ".0e"),
    "same bits": _number("certified_same_bits_fraction", ".1%"),
    "failed": lambda row: f"{row.not_found}/{row.step_count}" if row.step_count else "–",
    "mean [ms]": _number("solve_time_mean_s", ".2f", 1e3),
    "p50 [ms]": _number("solve_time_p50_s", ".2f", 1e3),
    "p99 [ms]": _number("solve_time_p99_s", ".1f", 1e3),
    "cold": _number("cold_time_p50_s", ".2f", 1e3),
    "polish": _number("polish_time_p50_s", ".2f", 1e3),
    "done": lambda row: f"{row.done}/{row.episodes}" if row.episodes else "–",
    "task err.": _number("task_error_max", ".0e"),
    "turns": _number("turns_ratio_min", ".2f"),
    "pen. [mm]": _number("penetration_max_m", ".1f", 1e3),
    "bend [rad]": _number("bend_max_rad", ".2f"),
    "drift [mm]": _number("drift_max_m", ".1f", 1e3),
}

TEXTS = ("solver", "version", "formulation", "verdict")  # columns that hold no figures

LEGEND = (
    "Right: steps found with dθ and dX within 1e-6, dX where rows bind. dθ, dX: relative error against Eqs. 12-15 on the "
    "free steps, on which no row binds. On the other, bound steps: violation, the worst of a row, relative to the step; "
    "cost gap, level-1 cost above the best found, relative to the cost of not moving; bound dX, of dX from that of the "
    "certified step, weighed by W, relative to what is asked; bound dθ, median and max distance from the median answer, "
    "relative. All that is the solver's own answer. Certified: bound steps proven optimal once polished; own guess, how "
    "many of these the solver's answer led to, the others being made by the kernel from nothing; certified dθ, their "
    "largest distance from the answer of most; same bits, how many are equal to that to the last bit. Mean: "
    "shifted geometric mean (shift 1 ms) of building and solving one step, one not found counting as the time limit; "
    "p50, p99: of the same. Of solvers that can start warm these are warm, and cold is their p50 without. Polish: polish "
    "and certificate. Done: episodes that the solver drove itself and that ended as they should, windings wound, scenes "
    "as when recorded; worst of scenes: task err., of a required task at the end [m, rad]; of windings: turns (over the "
    "ideal), penetration (negative: clearance), bend, drift. Agrees: every step found, dθ, dX and cost gap within 1e-6, "
    "bound dX too (or what `abilities.py` states of solvers that stray), 99 % certified and equal within 1e-12, every "
    "episode done."
)

_STYLES = {"agrees": "green", "reference": "cyan", "disagrees": "yellow", "fails": "red"}


_WHO = ("solver", "formulation")
_DRIVEN = ("done", "task err.", "turns", "pen. [mm]", "bend [rad]", "drift [mm]")


def show(rows: list[Row], console: Console) -> None:
    """Print the table of `rows`; where the console is too narrow, as two: replayed steps, then driven windings."""
    whole = table(rows, tuple(COLUMNS))
    unbounded = console.options.update(width=1000)
    if console.measure(whole, options=unbounded).maximum <= console.width:
        console.print(whole)
        return
    console.print(table(rows, tuple(name for name in COLUMNS if name not in (*_DRIVEN, "version"))))
    console.print(table([row for row in rows if row.episodes], (*_WHO, *_DRIVEN)))


def show_qps(measured: polars.DataFrame, console: Console) -> None:
    """Print a table of what the solvers made of the user's own QPs, from `Store.qps`; nothing if there are none."""
    if measured.is_empty():
        return
    figures = {"primal": "primal_residual", "dual": "dual_residual", "gap": "duality_gap"}
    columns = ("solver", "version", "accuracy", "found", *figures, "p50 [ms]")
    drawn = blank(columns, TEXTS, title="QPs")
    for part in measured.partition_by("solver", "accuracy", maintain_order=True):
        solver, version, accuracy = part.select("solver", "version", "accuracy").rows()[0]
        worst: list[Any] = [part[name].max() for name in figures.values()]
        time: Any = part["solve_s"].median()
        cells = [str(solver), str(version), f"{float(accuracy):g}", f"{int(part['found'].sum())}/{part.height}"]
        cells += ["–" if value is None else f"{value:.0e}" for value in worst]
        drawn.add_row(*cells, "–" if time is None else f"{1e3 * time:.2f}")
    console.print(drawn)
    console.print("Worst residuals and gap of the QPs that were found, absolute, computed from the problem.")


def table(rows: list[Row], columns: tuple[str, ...], *, markdown: bool = False) -> Table:
    """Return the table of `rows` with some of the `COLUMNS`."""
    drawn = blank(columns, TEXTS, markdown=markdown)
    for row in rows:
        colour = "" if markdown else _STYLES[row.verdict.split(":")[0]]
        drawn.add_row(*[escape(COLUMNS[name](row)) for name in columns], style=colour)
    return drawn


def markdown(rows: list[Row], facts: dict[str, Any]) -> str:
    """Return the table with what it was made by, as Markdown."""
    lines = as_markdown(table(rows, tuple(COLUMNS), markdown=True))
    stated = ", ".join(f"{name} {value}" for name, value in facts.items())
    return "\n".join([*lines, "", LEGEND, "", stated + "."]) + "\n"
