"""Writes what a comparison found: Parquet for programs, Markdown for people, JSON for both. Whole files or none."""

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, BinaryIO

import polars

from comparisons.origin import cpu_model
from comparisons.profiles import success
from comparisons.report import markdown
from comparisons.settings import ComparisonSettings
from comparisons.store import Store
from comparisons.summary import Row
from prioritized_ik.files import advising, write_whole


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write `content` as JSON."""
    _write_text(path, json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def write_tables(store: Store, settings: ComparisonSettings, rows: list[Row]) -> None:
    """Write `store.TABLES` as one Parquet file each, `qps` if there are any, and `table.md`, into a store's folder."""
    qps = store.qps()
    tables = {
        "steps": store.steps(),
        "episodes": store.episodes(),
        "success": success(store.steps()),
        "rows": polars.DataFrame([asdict(row) for row in rows], infer_schema_length=None),
        **({} if qps.is_empty() else {"qps": qps}),
    }
    for name, table in tables.items():
        store.write_file(f"{name}.parquet", _parquet(table))
    store.write_file("table.md", lambda file: file.write(markdown(rows, _stated(settings)).encode("utf-8")))


def json_rows(table: polars.DataFrame) -> list[dict[str, Any]]:
    """Return the rows of `table` as JSON takes them: numbers that are not finite as null."""
    return table.with_columns(
        polars.when(polars.col(polars.Float64).is_finite()).then(polars.col(polars.Float64)).name.keep()
    ).to_dicts()


def _parquet(table: polars.DataFrame) -> Callable[[BinaryIO], object]:
    # Parquet knows no record without a field.
    empty = [name for name, kind in table.schema.items() if isinstance(kind, polars.Struct) and not kind.fields]
    return table.drop(empty).write_parquet


def _stated(settings: ComparisonSettings) -> dict[str, Any]:
    return {
        "CPU": cpu_model(),
        "workers": settings.workers,
        "repeats": settings.repeats,
        "accuracy": " ".join(f"{accuracy:g}" for accuracy in settings.accuracy),
        "rank tolerance": f"{settings.rank_tolerance:g}",
        "damping": f"{settings.damping:g}",
        "preconditioning": "whitened residual (`solvers/stages.py`)",
    }


def _write(path: Path, write: Callable[[BinaryIO], object]) -> None:
    with advising("write", path):
        write_whole(path, write)


def _write_text(path: Path, text: str) -> None:
    _write(path, lambda file: file.write(text.encode("utf-8")))
