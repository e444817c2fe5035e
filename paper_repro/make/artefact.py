"""What an artefact is: a table or a figure, the jobs it needs, and how it is made of their answers."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from paper_repro.make.jobs import Job, Results, library_digest
from paper_repro.make.table import Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Scale:
    """How much is measured.

    Attributes:
        name: `full` or `quick`.
        seeds: random initial poses of a winding.
        steps: recorded problems of each direction.
        directions: where the object comes from.
        solvers: backends to compare; None for all that are installed, the native warm ones included.
    """

    name: str
    seeds: int
    steps: int
    directions: tuple[str, ...]
    solvers: tuple[str, ...] | None

    @property
    def stamp(self) -> str:
        """What an artefact says of how it was made: the scale, and a digest of the library, packages and solvers."""
        return f"<!-- {self.name} {library_digest()} -->"

    @property
    def quick(self) -> bool:
        """Whether this is the reduced run."""
        return self.name == "quick"


FULL = Scale("full", seeds=20, steps=60, directions=("up", "down", "front", "back"), solvers=None)
QUICK = Scale("quick", seeds=1, steps=6, directions=("up", "front"), solvers=("daqp", "proxqp", "quadprog"))


@dataclass(frozen=True)
class Artefact:
    """A table or figure of the report.

    Attributes:
        name: what `--only` calls it, and its files: `table-4`, `figure-6`.
        title: one line.
        caption: what it shows, how it was measured, and what it does not show; Markdown.
        jobs: everything to be done for it at a scale.
        build: makes it of their answers; fast, and always the same.
        timed: whether it holds measured times, which no two runs share: such tables are kept apart.
    """

    name: str
    title: str
    caption: str
    jobs: Callable[[Scale], list[Job]]
    build: "Callable[[Scale, Results], Table | Figure]"
    timed: bool = False

    def file(self, out: Path, kind: str) -> Path:
        """Return where its file of a kind, such as `csv`, stands in a folder of artefacts."""
        folder = "timed" if self.timed else "figures" if self.name.startswith("figure-") else "tables"
        return out / folder / f"{self.name}.{kind}"


def no_jobs(scale: Scale) -> list[Job]:
    """Return nothing to do, for artefacts that are made at once."""
    del scale
    return []
