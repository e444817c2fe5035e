"""Tables as the commands print them and as Markdown, drawn by Rich. Those of the paper are `paper_repro.make.table`."""

import io
from collections.abc import Collection, Sequence

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

WIDTH = 400  # of Markdown, which has no edge


def blank(
    columns: Sequence[str], left: Collection[str], *, title: str | None = None, markdown: bool = False, wrap: bool = False
) -> Table:
    """Return a table without rows.

    Args:
        columns: headings.
        left: those of the columns of text; figures stand on the right.
        title: above it; Markdown has none.
        markdown: whether it is for `as_markdown`.
        wrap: whether headings of figures may take several lines.
    """
    style = box.MARKDOWN if markdown else box.SIMPLE_HEAD
    title = None if markdown else title
    table = Table(box=style, pad_edge=markdown, collapse_padding=not markdown, title=title, title_justify="left")
    for name in columns:
        text = name in left
        table.add_column(escape(name), justify="left" if text else "right", no_wrap=text or not wrap)
    return table


def as_markdown(table: Table) -> list[str]:
    """Return the lines of a table made for Markdown."""
    text = io.StringIO()
    Console(file=text, width=WIDTH).print(table)
    return [line.strip() for line in text.getvalue().splitlines() if line.strip()]
