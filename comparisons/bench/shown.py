"""A table of a bench, for a terminal or as Markdown."""

from collections.abc import Sequence
from dataclasses import dataclass

from rich.markup import escape
from rich.table import Table as Drawn

from comparisons.drawn import blank


@dataclass(frozen=True)
class Shown:
    """One table: its title, columns (the first to the left, the others to the right) and rows."""

    title: str
    columns: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


def drawn_as(shown: Shown, *, markdown: bool = False) -> Drawn:
    """Return a table as rich draws it."""
    drawn = blank(shown.columns, shown.columns[:1], title=shown.title, markdown=markdown)
    for row in shown.rows:
        drawn.add_row(*map(escape, row))
    return drawn
