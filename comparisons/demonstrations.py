"""The commands `demo minimum-norm`, `demo weight-ratio` and `demo drop-in`. Heavy imports wait until one runs."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from comparisons.command import FILE_WIDTH
from prioritized_ik.cli import writable_file
from prioritized_ik.extras import require_extra

if TYPE_CHECKING:
    from rich.table import Table

    from comparisons import drop_in, minimum_norm, weight_ratio

SAME = 1e-6  # relative, up to which an answer counts as the exact one

_json_file = click.option("--json", "json_file", type=click.Path(dir_okay=False), help="File for what it shows, as JSON.")

MINIMUM_NORM_LEGEND = (
    "The end of the 17-link arm, arched, is to move by {displacement} mm (position), keeping its orientation (pose). "
    "‖dθ‖: over the least norm of all steps that do it. Off: distance from the step of least norm, relative. Residual: "
    "what is left of the task, relative. mink: mink.solve_ik, default damping 1e-12, each solver's default options; joint "
    "range: its default limit, which binds nowhere. Ours: prioritized_ik.solve, same task, rows and solver, "
    "through the QP (closed_form_first=False). Green: exact to 1e-6."
)
WEIGHT_RATIO_LEGEND = (
    "Two tasks at the ends of one link, which cannot both be done. Ratio: of their weights. Figures: distance from the "
    "strict two-level answer, relative; of the residuals, relative to what the task asks. Orthogonal factors: the closed "
    "form of the library. Damped: JᵀWJ + 1e-12 I. Slack QP: the same optimum without JᵀWJ, the solver's default options. "
    "Strict levels: the two levels by the lexicographic QP, which needs no ratio. Green: within 1e-6."
)
DROP_IN_LEGEND = (
    "solve_ik for each of {count} random configurations a row, tasks of frames alone, damping {damping:g}. Figures: the "
    "largest distance of Δq from the optimum of mink's own QP in sixty digits, relative; mink with each solver's default "
    "options, and how often it failed; ours: prioritized_ik.mink. Nearer: of the calls where an answer of mink's is "
    "further than {same:g} from ours, those where ours is the nearest to the optimum. Certified: our proof holds. Green: "
    "exact to {same:g}."
)

#: The tables of `demo weight-ratio`: a field of its rows, and what it is.
QUANTITIES = {"dtheta": "dθ", "level_1": "the first task's residual", "level_2": "the second task's residual"}


@click.group()
def demo() -> None:
    """Show why a damped solve is not the least norm, and a large weight not a strict priority."""
    require_extra("compare")


@demo.command("minimum-norm")
@_json_file
def minimum_norm_command(json_file: str | None) -> None:
    """Solve one task on a redundant arm with every solver: by mink and by this library."""
    from threadpoolctl import threadpool_limits

    from comparisons.minimum_norm import DISPLACEMENT, POSTURE, measure, shared_solvers

    if json_file is not None:
        writable_file(json_file)
    with threadpool_limits(1):
        rows = measure(shared_solvers())
    case = {"posture": POSTURE, "displacement_m": DISPLACEMENT}
    _write(json_file, case, rows, {row.solver: row.version for row in rows})
    _print(minimum_norm_table(rows))
    click.echo(MINIMUM_NORM_LEGEND.format(displacement=", ".join(f"{1e3 * x:g}" for x in DISPLACEMENT)))
    for row in rows:
        for who, answer in (("mink", row.mink), ("ours", row.ours)):
            if answer.failure:
                kept = "joint range" if row.joint_range else "no joint range"
                click.echo(f"{who}, {row.solver}, {row.task}, {kept}: {answer.failure}")


@demo.command("weight-ratio")
@_json_file
def weight_ratio_command(json_file: str | None) -> None:
    """Solve two conflicting tasks with a growing ratio of weights, by several methods, beside the strict answer."""
    from threadpoolctl import threadpool_limits

    from comparisons.weight_ratio import METHODS, POSTURE, RATIOS, SOLVER, TASKS, closest, measure
    from prioritized_ik.solvers.backends.registry import get_backend

    if json_file is not None:
        writable_file(json_file)
    with threadpool_limits(1):
        rows = measure()
    case = {"posture": POSTURE, "displacements_m": dict(TASKS)}
    _write(json_file, case, rows, {SOLVER: get_backend(SOLVER).version})
    for field, title in QUANTITIES.items():
        _print(weight_ratio_table(rows, field, f"distance of {title}"))
    click.echo(WEIGHT_RATIO_LEGEND)
    for method in METHODS:
        best = closest(rows, method)
        if best is None or best.ratio is None:
            click.echo(f"{method}: no answer at any ratio.")
        else:
            then = "still falling there" if best.ratio == RATIOS[-1] else "rounding takes over beyond"
            click.echo(f"{method}: closest at ratio {best.ratio:.0e}, to {best.dtheta:.0e} in dθ; {then}.")
    for row in rows:
        if row.failure:
            weighed = "strict levels" if row.ratio is None else f"ratio {row.ratio:.0e}"
            click.echo(f"{row.method}, {weighed}: {row.failure}")


@demo.command("drop-in")
@click.option("--count", default=20, show_default=True, type=click.IntRange(min=1), help="Configurations a row.")
@_json_file
def drop_in_command(count: int, json_file: str | None) -> None:
    """Ask mink and its drop-in for the same velocities at mink's default damping, and tell which are right."""
    from threadpoolctl import threadpool_limits

    from comparisons.drop_in import SAME as ALIKE
    from comparisons.drop_in import SOLVERS, measure_all
    from prioritized_ik.solvers.backends.registry import get_backend
    from prioritized_ik.solvers.methods import DAMPING

    if json_file is not None:
        writable_file(json_file)
    with threadpool_limits(1):
        rows = measure_all(count)
    _write(json_file, {"count": count, "damping": DAMPING}, rows, {name: get_backend(name).version for name in SOLVERS})
    _print(drop_in_table(rows))
    click.echo(DROP_IN_LEGEND.format(count=count, damping=DAMPING, same=ALIKE))


def drop_in_table(rows: "list[drop_in.Row]") -> "Table":
    """Return the table of `demo drop-in`."""
    solvers = list(rows[0].mink)
    drawn = _table("robot", "limits", right=[*(f"mink, {name}" for name in solvers), "ours", "nearer", "certified"])
    for row in rows:
        theirs = [_distance(row.mink[name]) + (f" ({row.failed[name]})" if row.failed[name] else "") for name in solvers]
        shares = [f"{row.nearer}/{row.apart}", f"{row.certified}/{row.count}"]
        drawn.add_row(row.machine, row.scenario, *theirs, _distance(row.ours), *shares)
    return drawn


def minimum_norm_table(rows: "list[minimum_norm.Row]") -> "Table":
    """Return the table of `demo minimum-norm`."""
    drawn = _table("task", "joint range", "solver", "version", right=[*_columns("mink"), *_columns("ours")])
    for row, following in zip(rows, [*rows[1:], None], strict=True):
        cells = [row.task, "kept" if row.joint_range else "–", row.solver, row.version]
        cells += [*_answer(row.mink), *_answer(row.ours)]
        last = following is None or (following.task, following.joint_range) != (row.task, row.joint_range)
        drawn.add_row(*cells, end_section=last)
    return drawn


def weight_ratio_table(rows: "list[weight_ratio.Row]", field: str, title: str) -> "Table":
    """Return one of the tables of `demo weight-ratio`: a row a ratio, a column a method."""
    methods = list(dict.fromkeys(row.method for row in rows if row.ratio is not None))
    drawn = _table("ratio", right=methods, title=title)
    for ratio in dict.fromkeys(row.ratio for row in rows):
        found = {row.method: row for row in rows if row.ratio == ratio}
        cells = [_distance(getattr(found[method], field)) if method in found else "" for method in methods]
        drawn.add_row("strict levels" if ratio is None else f"{ratio:.0e}", *cells)
    return drawn


def _columns(who: str) -> tuple[str, ...]:
    return f"{who}: ‖dθ‖", "off", "residual"


def _answer(answer: "minimum_norm.Answer") -> list[str]:
    if answer.norm_ratio is None or answer.off is None or answer.residual is None:
        return ["[red]fails[/]", "–", "–"]
    colour = "green" if max(answer.off, answer.residual) <= SAME else "yellow"
    ratio = f"{answer.norm_ratio:.3f}" if answer.norm_ratio < 100.0 else f"{answer.norm_ratio:.0f}"
    return [f"[{colour}]{cell}[/]" for cell in (ratio, f"{answer.off:.0e}", f"{answer.residual:.0e}")]


def _distance(value: float | None) -> str:
    if value is None:
        return "[red]fails[/]"
    return f"[{'green' if value <= SAME else 'yellow'}]{value:.0e}[/]"


def _table(*left: str, right: list[str], title: str | None = None) -> "Table":
    from comparisons.drawn import blank

    return blank((*left, *right), left, title=title, wrap=True)


def _print(table: "Table") -> None:
    from rich.console import Console

    Console(width=None if os.isatty(1) else FILE_WIDTH).print(table)


def _write(json_file: str | None, case: dict[str, Any], rows: list[Any], solver_versions: dict[str, str]) -> None:
    """Write `versions`, `cpu`, `case` and `rows` to `json_file`, if there is one."""
    if json_file is None:
        return
    from dataclasses import asdict

    from comparisons.origin import cpu_model, versions
    from comparisons.results import write_json

    content = {"versions": versions(solver_versions), "cpu": {"model": cpu_model(), "blas_threads": 1}, "case": case}
    write_json(Path(json_file), {**content, "rows": [asdict(row) for row in rows]})
