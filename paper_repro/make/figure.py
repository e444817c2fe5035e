"""How figures look, and how they are written: SVG, PDF and PNG, the same bytes from the same data.

Widths are those of a two-column page. Colours are Okabe and Ito's, which readers with any colour vision can tell apart;
lines differ in dash or marker too, so that print without colour is enough.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from prioritized_ik.files import write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMN, PAGE = 3.4, 7.1  # widths [in]
KINDS = ("svg", "pdf", "png")

#: Okabe and Ito's colours by name.
COLOURS = {
    "black": "#000000",
    "blue": "#0072B2",
    "orange": "#E69F00",
    "green": "#009E73",
    "vermilion": "#D55E00",
    "purple": "#CC79A7",
    "sky": "#56B4E9",
    "grey": "#7F7F7F",
}
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
DASHES = ("-", "--", "-.", ":")

STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 8.0,
    "axes.titlesize": 8.5,
    "axes.titleweight": "bold",
    "axes.labelsize": 8.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 7.0,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "lines.linewidth": 1.2,
    "lines.markersize": 3.5,
    "figure.dpi": 100,
    "savefig.dpi": 200,
    "svg.hashsalt": "prioritized_ik",  # names inside the file would be drawn by lot
}


def new_figure(
    rows: int = 1, columns: int = 1, *, width: float = PAGE, height: float = 2.6, **options: Any
) -> tuple["Figure", Any]:
    """Return a figure in the one style and its axes, as `matplotlib.pyplot.subplots` does.

    Args:
        rows: of axes.
        columns: of axes.
        width: [in].
        height: [in].
        options: of `Figure.subplots`; `layout` is constrained.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    mpl.rcParams.update(mpl.rcParamsDefault)
    mpl.rcParams.update(STYLE)
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, **options)


def write_figure(figure: "Figure", path: Path) -> Path:
    """Write a figure to a file of one of `KINDS`, whole or not at all, and return the file."""
    import matplotlib as mpl

    kind = path.suffix[1:]
    undated: dict[str, Any] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
    with mpl.rc_context(STYLE):
        write_whole(path, lambda file: figure.savefig(file, format=kind, metadata=undated.get(kind)))
    return path
