"""The commands `solvers` and `compare`. Heavy imports wait until one runs."""

import os
import tempfile
from pathlib import Path

import click

from prioritized_ik.cli import DISAGREES, writable_file, writable_folder

FILE_WIDTH = 260  # of tables that do not go to a terminal


@click.command()
def solvers() -> None:
    """List the QP solvers: what is installed, its version and abilities, how to install what is missing."""
    from rich.console import Console
    from rich.table import Table

    from prioritized_ik.solvers.backends.abilities import abilities_of
    from prioritized_ik.solvers.backends.registry import get_backend, installed_solvers, known_solvers

    columns = ("native", "semidefinite", "sparse", "warm start", "refinement", "how to get it")
    table = Table("solver", "version", *columns, box=None)
    installed = installed_solvers(on_request=True)
    for name in known_solvers():
        abilities = abilities_of(name)
        able = (abilities.native, abilities.semidefinite, abilities.sparse, abilities.warm_start)
        flags = ["yes" if flag else "–" for flag in able]
        refinement = [] if abilities.semidefinite else ["proximal point"]
        refinement += [f"zoom {' '.join(f'{zoom:g}' for zoom in abilities.zooms)}"] if abilities.zooms else []
        version = get_backend(name).version if name in installed else "–"
        how = f"pip install {abilities.package}" if name not in installed else "installed"
        how += ", runs when named" if abilities.on_request else ""
        table.add_row(name, version, *flags, ", ".join(refinement) or "–", how)
    Console(width=None if os.isatty(1) else FILE_WIDTH).print(table)


@click.command()
@click.option("--solvers", "names", help="Backends, separated by commas; all installed unless given.")
@click.option("--directions", default="up,down,front,back", help="Where the object comes from, separated by commas.")
@click.option("--formulation", default="lexicographic,damped", help="Formulations to replay, separated by commas.")
@click.option("--steps", default=60, help="Recorded steps to replay of each direction.")
@click.option("--link", default=6, help="The link that touches the object first.")
@click.option("--tilt", default=0.0, help="Tilt of the object's axis [rad].")
@click.option("--accuracy", default=1e-8, help="Asked of every solver, in the stages' scaled variables.")
@click.option("--rank-tolerance", default=1e-4, help="Shared by all: singular values below this fraction count as zero.")
@click.option("--damping", default=1e-12, help="Of the damped and slack formulations.")
@click.option("--closed-form-first/--no-closed-form-first", default=False, help="Skip the QP where no row binds.")
@click.option(
    "--witness/--no-witness", default=False, help="Also solve the recorded steps by the problem written in CVXPY."
)
@click.option("--workers", type=int, help="Processes.  [default: one a core]")
@click.option("--out", type=click.Path(file_okay=False), help="Folder for Parquet, Markdown and the recorded episodes.")
@click.option("--json", "json_file", type=click.Path(dir_okay=False), help="File for what the table shows, as JSON.")
@click.option("--readme", type=click.Path(exists=True, dir_okay=False), help="Put the table between this file's markers.")
@click.option("--strict", is_flag=True, help="Exit with 1 if a lexicographic row does not agree.")
def compare(
    names: str | None,
    directions: str,
    formulation: str,
    steps: int,
    link: int,
    tilt: float,
    accuracy: float,
    rank_tolerance: float,
    damping: float,
    closed_form_first: bool,
    witness: bool,
    workers: int | None,
    out: str | None,
    json_file: str | None,
    readme: str | None,
    strict: bool,
) -> None:
    """Run every solver on the same winding episodes and compare it with Eqs. 12-14 and with the others."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    from comparisons.report import LEGEND, show
    from comparisons.results import around_table, facts, replace_table, write_folder, write_json
    from comparisons.run import run
    from comparisons.settings import ComparisonSettings
    from comparisons.summary import summarise

    settings = ComparisonSettings(
        solvers=_split(names or ""),
        directions=_split(directions),
        formulations=_split(formulation),
        steps=steps,
        link=link,
        tilt=tilt,
        accuracy=accuracy,
        rank_tolerance=rank_tolerance,
        damping=damping,
        closed_form_first=closed_form_first,
        witness=witness,
        workers=workers if workers is not None else os.cpu_count() or 1,
    )
    if json_file is not None:
        writable_file(json_file)
    if readme is not None:
        around_table(Path(writable_file(readme)))
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        if out is not None:
            folder = Path(out)
            existing = next(parent for parent in (folder, *folder.absolute().parents) if parent.exists())
            writable_folder(existing)
            folder.mkdir(parents=True, exist_ok=True)
        bars = Console(stderr=True)
        columns = (TextColumn("{task.description:<32}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        with Progress(*columns, console=bars, disable=not bars.is_terminal, transient=True) as progress:
            bar = progress.add_task("start")
            records, episodes = run(
                settings,
                folder,
                lambda what, done, total: progress.update(bar, description=what, completed=done, total=total),
            )
        rows = summarise(records, episodes)
        if out is not None:
            write_folder(folder, settings, rows, records, episodes)
    if json_file is not None:
        write_json(Path(json_file), facts(settings, rows))
    if readme is not None:
        replace_table(Path(readme), settings, rows)
    show(rows, Console(width=None if os.isatty(1) else FILE_WIDTH))
    click.echo(LEGEND)
    if out is not None:
        click.echo(f"Written to {out}.")
    if strict and any(row.must_agree and row.verdict != "agrees" for row in rows):
        raise SystemExit(DISAGREES)


def _split(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",") if part.strip())
