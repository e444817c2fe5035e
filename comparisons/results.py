"""Writes what a comparison found: Parquet for programs, Markdown for people, JSON for both. Whole files or none."""

import importlib.metadata
import json
import os
import platform
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, BinaryIO

import polars

from comparisons.report import markdown
from comparisons.run import Record
from comparisons.settings import ComparisonSettings
from comparisons.summary import Row
from prioritized_ik.errors import InputError
from prioritized_ik.files import write_whole

BEGIN, END = "<!-- table: make readme -->", "<!-- end of table -->"
PACKAGES = ("prioritized-ik", "mujoco", "mink", "qpsolvers", "numpy", "scipy")


def facts(settings: ComparisonSettings, rows: list[Row]) -> dict[str, Any]:
    """Return `versions`, `cpu`, `settings` and `rows`: what the JSON file holds."""
    return {
        "versions": versions({row.solver: row.version for row in rows if row.formulation == "lexicographic"}),
        "cpu": {"model": cpu_model(), "cores": os.cpu_count(), "workers": settings.workers, "blas_threads": 1},
        "settings": asdict(settings),
        "rows": [asdict(row) for row in rows],
    }


def versions(of_solvers: dict[str, str]) -> dict[str, str]:
    """Return the versions of Python, the packages that decide on figures, and solvers."""
    packages = {package: importlib.metadata.version(package) for package in PACKAGES}
    return {"python": platform.python_version(), **packages, **of_solvers}


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write `content` as JSON."""
    _write_text(path, json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def write_folder(
    folder: Path, settings: ComparisonSettings, rows: list[Row], steps: list[Record], episodes: list[Record]
) -> None:
    """Write `steps`, `episodes` and `rows` as Parquet, and `table.md`, into `folder`."""
    tables = {"steps": steps, "episodes": episodes, "rows": [asdict(row) for row in rows]}
    for name, records in tables.items():
        frame = polars.DataFrame(records, infer_schema_length=None)
        _write(folder / f"{name}.parquet", frame.write_parquet)
    _write_text(folder / "table.md", markdown(rows, _stated(settings)))


def around_table(file: Path) -> tuple[str, str]:
    """Return what stands before and after the place for the table in a Markdown file.

    Raises:
        InputError: the file has no such place.
    """
    before, begin, rest = file.read_text(encoding="utf-8").partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise InputError(f"{str(file)!r} has no place for the table; expected the lines {BEGIN!r} and {END!r}.")
    return before, after


def replace_table(file: Path, settings: ComparisonSettings, rows: list[Row]) -> None:
    """Put the table of `rows` between the two markers of a Markdown file.

    Raises:
        InputError: the file has no such markers, or cannot be written.
    """
    before, after = around_table(file)
    _write_text(file, f"{before}{BEGIN}\n{markdown(rows, _stated(settings))}{END}{after}")


def _stated(settings: ComparisonSettings) -> dict[str, Any]:
    return {
        "CPU": cpu_model(),
        "workers": settings.workers,
        "accuracy": f"{settings.accuracy:g}",
        "rank tolerance": f"{settings.rank_tolerance:g}",
        "damping": f"{settings.damping:g}",
        "preconditioning": "whitened residual (`solvers/stages.py`)",
    }


def cpu_model() -> str:
    """Return the processor's name, as far as the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def _write(path: Path, write: Callable[[BinaryIO], object]) -> None:
    try:
        write_whole(path, write)
    except OSError as error:
        raise InputError(f"cannot write {str(path)!r} ({error}); choose a place that is writable.") from error


def _write_text(path: Path, text: str) -> None:
    _write(path, lambda file: file.write(text.encode("utf-8")))
