"""The command `bench`. Heavy imports wait until it runs."""

import os
from pathlib import Path

import click

from comparisons.command import FILE_WIDTH
from prioritized_ik.cli import writable_file
from prioritized_ik.extras import require_extra


@click.command()
@click.option("--links", help="Only arms of these numbers of links, such as 8..1000 or 17,100,400.")
@click.option("--quick", is_flag=True, help="Less than a minute, for a look: not for figures to quote.")
@click.option("--json", "json_file", type=click.Path(dir_okay=False), help="File for all figures, as JSON.")
@click.option("--markdown", "markdown_file", type=click.Path(dir_okay=False), help="File for the tables, as Markdown.")
@click.option("--plot", "plot_file", type=click.Path(dir_okay=False), help="File for a plot: .png, .svg or .pdf.")
def bench(links: str | None, quick: bool, json_file: str | None, markdown_file: str | None, plot_file: str | None) -> None:
    """Time a control step beside mink, pink, placo, DAQP and LAPACK: one process, one BLAS thread, ratios first.

    The winding arm and six robots, one to six strict levels, certificate always on; how a step grows with an arm's links;
    sparse solvers beside each other. Takes some minutes; with --links only the last two.
    """
    require_extra("report" if plot_file is not None else "compare")
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
    from threadpoolctl import threadpool_limits

    from comparisons.bench import links_report, report
    from comparisons.bench.run import figures, links_alone, run, run_links
    from comparisons.bench.settings import BenchSettings
    from comparisons.results import write_json
    from prioritized_ik.errors import InputError

    for file in (json_file, markdown_file, plot_file):
        if file is not None:
            writable_file(file)
    if plot_file is not None:
        report.kind_of_plot(plot_file)
    if links is not None and (quick or plot_file is not None):
        raise InputError("--links takes neither --quick nor --plot; leave it out, or them.")
    settings = BenchSettings.quick() if quick else BenchSettings() if links is None else BenchSettings.of_links(links)
    bars = Console(stderr=True)
    columns = (TextColumn("{task.description:<12}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with threadpool_limits(1), Progress(*columns, console=bars, disable=not bars.is_terminal, transient=True) as progress:
        bar = progress.add_task("start")

        def tell(what: str, done: int, total: int) -> None:
            progress.update(bar, description=what, completed=done, total=total)

        grown = None if links is None else run_links(settings, tell)
        measured = run(settings, tell) if links is None else None
    width = None if os.isatty(1) else FILE_WIDTH
    if grown is not None:
        if json_file is not None:
            write_json(Path(json_file), links_alone(grown))
        if markdown_file is not None:
            links_report.write_links_markdown(Path(markdown_file), grown)
        links_report.show_links(grown, Console(width=width))
        return
    assert measured is not None
    if json_file is not None:
        write_json(Path(json_file), figures(measured))
    if markdown_file is not None:
        report.write_markdown(Path(markdown_file), measured)
    if plot_file is not None:
        report.write_plot(Path(plot_file), measured)
    report.show(measured, Console(width=width))
