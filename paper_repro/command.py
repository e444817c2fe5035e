"""The command `paper`. Heavy imports wait until it runs."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from prioritized_ik.cli import DISAGREES, made_folder, writable_file
from prioritized_ik.extras import require_extra

if TYPE_CHECKING:
    from paper_repro.make.artefact import Scale
    from paper_repro.make.jobs import Progress


@click.group(invoke_without_command=True)
@click.option("--out", default="results/paper", type=click.Path(file_okay=False), help="Folder for everything.")
@click.option(
    "--only", "names", default="", help="Artefacts, separated by commas, such as table-4,figure-6; all unless given."
)
@click.option("--quick", is_flag=True, help="A reduced run: fewer seeds, directions, steps and solvers.")
@click.option("--workers", type=int, help="Processes.  [default: one a core]")
@click.option(
    "--readme", type=click.Path(exists=True, dir_okay=False), multiple=True, help="Put tables between its markers."
)
@click.pass_context
def paper(context: click.Context, out: str, names: str, quick: bool, workers: int | None, readme: tuple[str, ...]) -> None:
    """Make every table and figure of the paper, and a report of what it says, what we got and what it leaves open.

    What is done is kept: an interrupted run goes on where it was.
    """
    require_extra("report")
    from paper_repro.make.artefact import FULL, QUICK
    from prioritized_ik.validation import at_least

    scale = QUICK if quick else FULL
    processes = at_least("workers", workers if workers is not None else os.cpu_count() or 1, 1)
    context.obj = (scale, Path(out), processes)
    if context.invoked_subcommand is not None:
        return
    from paper_repro.make.build import build
    from paper_repro.make.catalogue import chosen
    from paper_repro.make.readme import fill, marked

    artefacts = chosen(tuple(name.strip() for name in names.split(",") if name.strip()))
    for page in readme:
        marked(Path(writable_file(page)))
    folder = made_folder(Path(out))
    with _bar() as progress:
        files = build(artefacts, folder, scale, processes, progress)
    for path in files:
        click.echo(path)
    for page in readme:
        fill(Path(page), folder, scale)


@paper.command()
@click.pass_obj
def check(given: "tuple[Scale, Path, int]") -> None:
    """Print what the paper states, whether we agree, and our figure.

    Exit code 1 if a figure differs that is not known to.
    """
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from comparisons.command import FILE_WIDTH
    from paper_repro.artefacts import facts
    from paper_repro.make.build import ANSWERS
    from paper_repro.make.jobs import run

    scale, folder, processes = given
    with _bar() as progress:
        results = run(facts.jobs(scale), made_folder(folder) / ANSWERS, processes, progress)
    findings = facts.findings(scale, results)
    made = facts.table(findings)
    drawn = Table(*(column.title for column in made.columns), box=None)
    for row in made.rows:
        drawn.add_row(*(escape(column.text(cell)) for column, cell in zip(made.columns, row, strict=True)))
    Console(width=None if os.isatty(1) else FILE_WIDTH).print(drawn)
    if any(finding.unexpected for finding in findings):
        raise SystemExit(DISAGREES)


@contextmanager
def _bar() -> "Iterator[Progress]":
    """Show a progress bar on a terminal, and yield what moves it."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bars

    console = Console(stderr=True)
    columns = (TextColumn("{task.description:<32}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Bars(*columns, console=console, disable=not console.is_terminal, transient=True) as bars:
        bar = bars.add_task("start")
        yield lambda what, done, total: bars.update(bar, description=what, completed=done, total=total)
