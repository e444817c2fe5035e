r"""A table, as CSV for programs, LaTeX (booktabs) for papers and Markdown for people, from the same cells.

The LaTeX is a bare `tabular`, or a `longtable` where it is longer than a page, to be put into the reader's own document
with `\usepackage{booktabs,longtable,textcomp,amssymb}`.
"""

import csv
import io
import math
from dataclasses import dataclass

from paper_repro.make.latex import latex

Cell = str | float | int | bool | None

NOTHING = "–"
PAGE = 45  # rows that fit on one


@dataclass(frozen=True)
class Column:
    """One column.

    Attributes:
        key: its name in the CSV, with the unit as a suffix: `penetration_mm`.
        title: its heading, with the unit in brackets: `penetration [mm]`.
        style: format of its numbers in Markdown and LaTeX; the CSV has six digits.
        width: of long texts in LaTeX, such as `4cm`; they are broken there.
    """

    key: str
    title: str
    style: str = ".3g"
    width: str = ""

    def text(self, cell: Cell) -> str:
        """Return a cell for people."""
        match cell:
            case None:
                return NOTHING
            case bool():
                return "yes" if cell else "no"
            case int() | str():
                return str(cell)
        return NOTHING if math.isnan(cell) else format(cell, self.style)


@dataclass(frozen=True)
class Table:
    """Rows of cells. None is a figure that there is not.

    Attributes:
        columns: as they stand.
        rows: a cell a column each.
        notes: below the table; Markdown.
    """

    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: str = ""

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"the row {row} has {len(row)} cells; expected {len(self.columns)}.")

    def csv(self) -> str:
        """Return the table with its keys as headings, six digits a number, nothing where there is no figure."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow([column.key for column in self.columns])
        writer.writerows([[_plain(cell) for cell in row] for row in self.rows])
        return text.getvalue()

    def markdown(self) -> str:
        """Return the table and its notes as Markdown."""
        lines = [_line([column.title for column in self.columns])]
        lines.append(_line(["---:" if self._is_number(i) else "---" for i in range(len(self.columns))]))
        lines += [_line(texts) for texts in self._texts()]
        return "\n".join(lines) + "\n" + (f"\n{self.notes}\n" if self.notes else "")

    def latex(self) -> str:
        """Return the table as LaTeX with booktabs, without its notes."""
        sides = [f"p{{{c.width}}}" if c.width else "r" if self._is_number(i) else "l" for i, c in enumerate(self.columns)]
        environment = "longtable" if len(self.rows) > PAGE else "tabular"
        heads = [_latex_line([column.title for column in self.columns]), r"\midrule"]
        if environment == "longtable":
            heads.append(r"\endhead")
        body = [_latex_line(texts) for texts in self._texts()]
        begin = rf"\begin{{{environment}}}{{{''.join(sides)}}}"
        return "\n".join([begin, r"\toprule", *heads, *body, r"\bottomrule", rf"\end{{{environment}}}"]) + "\n"

    def _texts(self) -> list[list[str]]:
        return [[column.text(cell) for column, cell in zip(self.columns, row, strict=True)] for row in self.rows]

    def _is_number(self, place: int) -> bool:
        """Whether a column holds numbers, which stand on the right."""
        cells = [row[place] for row in self.rows if row[place] is not None]
        return bool(cells) and all(isinstance(cell, int | float) and not isinstance(cell, bool) for cell in cells)


def _plain(cell: Cell) -> str:
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return ""
    return format(cell, ".6g") if isinstance(cell, float) else str(cell)


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cell.replace("|", r"\|").replace("\n", " ") for cell in cells) + " |"


def _latex_line(cells: list[str]) -> str:
    return " & ".join(map(latex, cells)) + r" \\"
