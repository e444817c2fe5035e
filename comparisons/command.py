"""The commands `solvers` and `compare`. Heavy imports wait until one runs."""

import os
import tempfile
import webbrowser
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import click

from prioritized_ik.cli import DISAGREES, made_folder, writable_file
from prioritized_ik.extras import require_extra

if TYPE_CHECKING:
    from rich.table import Table

Number = TypeVar("Number", int, float)

FILE_WIDTH = 310  # of tables that do not go to a terminal


@click.command()
def solvers() -> None:
    """List the methods and the QP solvers: version, what is installed, abilities, how to install what is missing."""
    from rich.console import Console

    import comparisons.methods  # noqa: F401  its families are listed too
    from prioritized_ik.solvers.compiled.library import library

    console = Console(width=None if os.isatty(1) else FILE_WIDTH)
    console.print(_table_of_methods())
    core = library()
    console.print(f"\nThe kernel runs {'compiled' if core.core is not None else 'in Python'}: {core.note}", highlight=False)
    console.print("\nSOLVER by itself is lexicographic:SOLVER. The QP solvers:\n", highlight=False)
    console.print(_table_of_solvers())


def _table_of_methods() -> "Table":
    from rich.table import Table

    from prioritized_ik.solvers.registry import DEFAULT, families, get_method, installed_methods, known_methods

    table = Table("method", "version", "path", "available", "what it is", box=None)
    installed = installed_methods(on_request=True)
    for name in (name for name in known_methods() if ":" not in name):
        if name not in installed:
            table.add_row(name, "–", "–", "pip install daqp", "")
            continue
        method = get_method(name)
        first_line = (type(method).__doc__ or "").partition("\n")[0]
        table.add_row(name, method.version, method.path, "yes, the default" if name == DEFAULT else "yes", first_line)
    for name, family in families().items():
        able, known = family.installed(True), family.known()
        paths = sorted({get_method(f"{name}:{solver}").path for solver in able})
        available = f"{len(able)} of {len({*able, *known})} solvers"
        table.add_row(f"{name}:SOLVER", "the solver's", ", ".join(paths) or "–", available, family.about)
    return table


def _table_of_solvers() -> "Table":
    from rich.table import Table

    from prioritized_ik.solvers.backends.abilities import abilities_of
    from prioritized_ik.solvers.backends.registry import get_backend, installed_solvers, known_solvers
    from prioritized_ik.solvers.registry import families

    columns = ("native", "semidefinite", "sparse", "warm start", "refinement", "how to get it", "methods")
    table = Table("solver", "version", *columns, box=None)
    installed = installed_solvers(on_request=True)
    takes = {family: found.installed(True) for family, found in families().items()}
    for name in known_solvers():
        abilities = abilities_of(name)
        able = (abilities.native, abilities.semidefinite, abilities.sparse, abilities.warm_start)
        flags = ["yes" if flag else "–" for flag in able]
        refinement = [] if abilities.semidefinite else ["proximal point"]
        refinement += [f"zoom {' '.join(f'{zoom:g}' for zoom in abilities.zooms)}"] if abilities.zooms else []
        version = get_backend(name).version if name in installed else "–"
        how = f"pip install {abilities.package}" if name not in installed else "installed"
        how += ", runs when named" if abilities.on_request else ""
        methods = " ".join(family for family, able_here in takes.items() if name in able_here)
        table.add_row(name, version, *flags, ", ".join(refinement) or "–", how, methods or "–")
    return table


@click.command()
@click.option(
    "--solvers", "names", help="Methods or QP solvers, separated by commas; active-set and all QP solvers unless given."
)
@click.option("--directions", default="up,down,front,back", help="Where the object comes from, separated by commas.")
@click.option(
    "--formulation",
    default="lexicographic,damped",
    help="Formulations that a QP solver is replayed in, separated by commas.",
)
@click.option("--steps", default=60, help="Recorded steps to replay of each winding.")
@click.option("--links", default="17", help="Number of links; several, separated by commas, are swept, as in what follows.")
@click.option("--link", default="6", help="The link that touches the object first.")
@click.option("--object", "shapes", default="cylinder", help="cylinder, capsule or sphere.")
@click.option("--diameter", default="0.14", help="Diameter of the object [m].")
@click.option("--tilt", default="0.0", help="Tilt of the object's axis [rad].")
@click.option("--seeds", default="", help="Seeds of random initial postures, 1,2 or 0:50; straight unless given.")
@click.option("--accuracy", default="1e-08", help="Asked of every solver, in the stages' scaled variables.")
@click.option("--scene", "scenes", multiple=True, help="Task file to run instead of windings; can be repeated.")
@click.option("--recorded", default="", help="Folder of your own episodes and problems (.npz), instead; see docs.")
@click.option("--rank-tolerance", default=1e-4, help="Shared by all: singular values below this fraction count as zero.")
@click.option("--damping", default=1e-12, help="Of the damped and slack formulations.")
@click.option("--closed-form-first/--no-closed-form-first", default=False, help="Skip the QP where no row binds.")
@click.option("--repeats", default=1, help="Solve each problem so often; times are medians.")
@click.option("--drive/--no-drive", default=True, help="Let every solver wind the arm itself as well.")
@click.option("--mink/--no-mink", default=True, help="Compare with mink.solve_ik.")
@click.option(
    "--witness/--no-witness", default=False, help="Also solve the recorded steps by the problem written in CVXPY."
)
@click.option("--plugin", multiple=True, help="Module that registers methods of your own; can be repeated.")
@click.option("--time-limit", default=10.0, help="Of one problem [s].")
@click.option("--memory-limit", default=2.0, help="Of one solver [GiB].")
@click.option("--workers", type=int, help="Processes at the same time.  [default: one a core]")
@click.option("--scheduler", default="", help="Address of a Dask scheduler to spread over, such as tcp://host:8786.")
@click.option("--out", type=click.Path(file_okay=False), help="Folder for results, report and recorded episodes.")
@click.option("--resume/--fresh", default=True, help="Do what the folder lacks, or delete its results first.")
@click.option("--open", "show_page", is_flag=True, help="Open the report in a browser.")
@click.option("--json", "json_file", type=click.Path(dir_okay=False), help="File for what the table shows, as JSON.")
@click.option("--strict", is_flag=True, help="Exit with 1 if a lexicographic row does not agree, with 2 if there is none.")
def compare(
    names: str | None,
    directions: str,
    formulation: str,
    steps: int,
    links: str,
    link: str,
    shapes: str,
    diameter: str,
    tilt: str,
    seeds: str,
    accuracy: str,
    scenes: tuple[str, ...],
    recorded: str,
    rank_tolerance: float,
    damping: float,
    closed_form_first: bool,
    repeats: int,
    drive: bool,
    mink: bool,
    witness: bool,
    plugin: tuple[str, ...],
    time_limit: float,
    memory_limit: float,
    workers: int | None,
    scheduler: str,
    out: str | None,
    resume: bool,
    show_page: bool,
    json_file: str | None,
    strict: bool,
) -> None:
    """Run every solver on the same windings and compare it with Eqs. 12-14 and with the others.

    Each solver works in a process of its own: one that crashes, hangs, eats memory or returns NaN fails alone. With
    --out, a run that was interrupted goes on where it was.
    """
    require_extra("compare")
    if witness:
        require_extra("solvers")
    if scheduler:
        require_extra("cluster")
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    from comparisons.page import write_page
    from comparisons.plugins import load_plugins
    from comparisons.report import LEGEND, show, show_qps
    from comparisons.results import json_rows, write_json, write_tables
    from comparisons.run import facts, run
    from comparisons.settings import ComparisonSettings
    from comparisons.store import Store
    from comparisons.summary import summarise
    from prioritized_ik.errors import InputError

    load_plugins(plugin)
    settings = ComparisonSettings(
        solvers=_split(names or ""),
        directions=_split(directions),
        formulations=_split(formulation),
        steps=steps,
        links=_numbers("links", links, int),
        link=_numbers("link", link, int),
        shapes=_split(shapes),
        diameter=_numbers("diameter", diameter, float),
        tilt=_numbers("tilt", tilt, float),
        seeds=_seeds(seeds),
        accuracy=_numbers("accuracy", accuracy, float),
        recorded=recorded,
        scenes=scenes,
        rank_tolerance=rank_tolerance,
        damping=damping,
        closed_form_first=closed_form_first,
        repeats=repeats,
        drive=drive,
        mink=mink,
        witness=witness,
        time_limit=time_limit,
        memory_limit=memory_limit,
        workers=workers if workers is not None else os.cpu_count() or 1,
        scheduler=scheduler,
    )
    if json_file is not None:
        writable_file(json_file)
    if show_page and out is None:
        raise InputError("--open shows the report, which needs a folder to be in; give one with --out.")
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        if out is not None:
            folder = Path(out)
            if recorded and Path(recorded).resolve().is_relative_to(folder.resolve()):
                raise InputError(f"--recorded {recorded!r} lies in --out {out!r}, which is written; choose another folder.")
            made_folder(folder)
            if not resume:
                Store.clear(folder)
        bars = Console(stderr=True)
        columns = (TextColumn("{task.description:<32}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        with Progress(*columns, console=bars, disable=not bars.is_terminal, transient=True) as progress:
            bar = progress.add_task("start")
            store = run(
                settings,
                folder,
                lambda what, done, total: progress.update(bar, description=what, completed=done, total=total),
                keep_driven=out is not None,
            )
        rows = summarise(store.steps(), store.episodes(), settings.time_limit)
        own_qps = store.qps()
        if out is not None:
            write_tables(store, settings, rows)
            page = write_page(folder, store, rows)
    if json_file is not None:
        content = {"rows": [asdict(row) for row in rows], "qps": json_rows(own_qps)}
        write_json(Path(json_file), {**facts(settings), **content})
    console = Console(width=None if os.isatty(1) else FILE_WIDTH)
    show(rows, console)
    click.echo(LEGEND)
    show_qps(own_qps, console)
    for solver, accuracies in settings.left_out().items():
        values = ", ".join(f"{accuracy:g}" for accuracy in accuracies)
        click.echo(f"{solver} goes without accuracy {values}, which is finer than it reaches.", err=True)
    if out is not None:
        click.echo(f"Written to {out}.")
        click.echo(f"Report: {page}")
        if show_page:
            webbrowser.open(page.absolute().as_uri())
    if strict and not any(row.must_agree for row in rows):
        raise InputError(
            "--strict checks lexicographic rows, and there is none, so that nothing was checked; expected 'lexicographic' "
            "among --formulation, and an episode among --recorded if given."
        )
    disagreeing = [row for row in rows if row.must_agree and not row.agrees]
    if strict and disagreeing:
        for row in disagreeing:
            asked = "" if row.accuracy is None else f", accuracy {row.accuracy:g}"
            click.echo(f"{row.solver} {row.version} ({row.formulation}{asked}): {row.verdict}", err=True)
        raise SystemExit(DISAGREES)


def _split(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",") if part.strip())


def _numbers(name: str, text: str, kind: Callable[[str], Number]) -> tuple[Number, ...]:
    """Return the numbers in `text`, separated by commas."""
    from prioritized_ik.errors import InputError

    try:
        return tuple(kind(part) for part in _split(text))
    except ValueError:
        raise InputError(f"{name} is {text!r}; expected numbers separated by commas.") from None


def _seeds(text: str) -> tuple[int, ...]:
    """Return the seeds in `text`: numbers and ranges such as 0:50, without their ends."""
    from prioritized_ik.errors import InputError

    seeds: list[int] = []
    for part in _split(text):
        first, colon, end = part.partition(":")
        try:
            seeds += range(int(first), int(end)) if colon else [int(first)]
        except ValueError:
            raise InputError(f"seeds is {text!r}; expected numbers or ranges such as 0:50, separated by commas.") from None
    if text.strip() and not seeds:
        raise InputError(f"seeds is {text!r}, which holds none; expected numbers or ranges such as 0:50.")
    return tuple(seeds)
