"""Recorded winding problems as a test set of qpbenchmark, for authors of QP solvers.

Every stage of the fold over a problem's levels is one QP (see `prioritized_ik.solvers.stages`), just as the solvers of a
comparison are given it. The set comes in two subsets, each a Parquet file with the small Python file that `qpbenchmark`
is run on:

    winding_positive_definite   stages whose cost feels every variable, P = I: the last of each step, which takes the
                                shortest of the steps that the levels above leave
    winding_semidefinite        the others, P = diag(1, 0)

Stages that no point satisfies are left out.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from string import Template

import numpy as np
import polars

from prioritized_ik.errors import InputError
from prioritized_ik.files import advising, write_whole
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.backends.protocol import Backend, StageResult
from prioritized_ik.solvers.backends.qpsolvers_ import QpsolversBackend
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.methods import Lexicographic
from prioritized_ik.solvers.stages import Stage
from prioritized_ik.validation import Array, at_least
from prioritized_ik.winding.episode import Episode

FOLDS = "daqp"  # the solver that leads from each stage to the next

#: A stage whose rows its solver's answer breaks by more is left out as infeasible. Rows are of unit length, and what is
#: feasible is solved to 1e-12; an infeasible row misses by the size of a step, from 1e-4 on.
BROKEN = 1e-7

ALIKE = (
    "The variables are scaled: the cost of the residual is ½‖y - t‖² with t of length one or less, and the rows of G are "
    "of unit length. Every problem is feasible. Exported by prioritized-ik from windings of a redundant arm."
)


@dataclass(frozen=True)
class Subset:
    """One of the two test sets.

    Attributes:
        module: name of its files.
        title: heading of the report.
        description: what the problems are.
    """

    module: str
    title: str
    description: str

    @property
    def class_name(self) -> str:
        """What `qpbenchmark` expects the class in the file `module` to be called."""
        return self.module.title().replace("_", "")


POSITIVE_DEFINITE = Subset(
    "winding_positive_definite",
    "Winding of a redundant arm, positive definite",
    "Last stages of prioritized inverse kinematics: the shortest joint step among those that the tasks leave, within joint "
    f"and contact limits. P is the identity. {ALIKE}",
)
SEMIDEFINITE = Subset(
    "winding_semidefinite",
    "Winding of a redundant arm, semidefinite",
    "Task stages of prioritized inverse kinematics: weighted least squares over the positions of an arm's links, within "
    "joint and contact limits. P is diagonal, of ones and zeros: the optimum is a face, and solvers that need a positive "
    f"definite P fail by design. {ALIKE}",
)


@dataclass(frozen=True)
class NamedStage:
    """A stage and the name of its problem in the set."""

    name: str
    stage: Stage

    @property
    def subset(self) -> Subset:
        """Where it belongs."""
        return POSITIVE_DEFINITE if self.stage.costed == self.stage.size else SEMIDEFINITE


class _Recorder:
    """A backend that keeps the stages it is handed, and gives up at the first without a feasible point."""

    def __init__(self, backend: Backend) -> None:
        self.name, self.version = backend.name, backend.version
        self.stages: list[Stage] = []
        self._backend = backend

    def solve_once(self, stage: Stage) -> StageResult:
        """See `Backend.solve_once`."""
        return self._backend.solve_once(stage)

    def solve(self, stage: Stage) -> StageResult:
        """Return the solver's answer."""
        result = self._backend.solve(stage)
        if result.x is None or _worst_row(stage, result.x) > BROKEN:
            return StageResult(None, "infeasible")
        self.stages.append(stage)
        return result


def feasible_stages(problem: IKProblem, options: SolveOptions | None = None) -> list[Stage]:
    """Return the QPs of `problem`, the most important level first, without those that no point satisfies."""
    options = options or SolveOptions(rank_tolerance=RANK_TOLERANCE)
    recorder = _Recorder(QpsolversBackend(FOLDS, options.accuracy))
    # Neither shortcut nor polish: every level is a QP, whose stage follows from the QP above it.
    Lexicographic(recorder).step(problem, replace(options, closed_form_first=False, polish=False))
    return recorder.stages


def named_stages(episodes: dict[str, Episode], steps: int, options: SolveOptions | None = None) -> Iterator[NamedStage]:
    """Yield the stages of up to `steps` problems of each episode, evenly spaced; `episodes` by name.

    Raises:
        InputError: fewer than one step.
    """
    at_least("steps", steps, 1)
    for case, episode in episodes.items():
        chosen = np.unique(np.linspace(0, episode.steps - 1, min(steps, episode.steps)).round().astype(int))
        for step in chosen:
            for stage in feasible_stages(episode.problem(int(step)), options):
                yield NamedStage(f"{case}_{step:04d}_{stage.place}", stage)


def write_test_set(folder: Path, stages: Iterable[NamedStage]) -> dict[str, int]:
    """Write both subsets into `folder`, and return how many problems each holds, by the name of its files.

    Raises:
        InputError: a subset would be empty, or the folder cannot be written.
    """
    sorted_out: dict[Subset, list[NamedStage]] = {POSITIVE_DEFINITE: [], SEMIDEFINITE: []}
    for item in stages:
        sorted_out[item.subset].append(item)
    for subset, items in sorted_out.items():
        if not items:
            raise InputError(f"there is no problem for {subset.module}; expected episodes with at least one feasible step.")
    with advising("write into", folder):
        folder.mkdir(parents=True, exist_ok=True)
        for subset, items in sorted_out.items():
            write_whole(folder / f"{subset.module}.parquet", _table(items).write_parquet)
            text = _test_set_file(subset).encode("utf-8")
            write_whole(folder / f"{subset.module}.py", lambda file, text=text: file.write(text))  # type: ignore[misc]
    return {subset.module: len(items) for subset, items in sorted_out.items()}


def _worst_row(stage: Stage, x: Array) -> float:
    qp = stage.problem
    return 0.0 if qp.G is None else float((qp.G @ x - qp.h).max(initial=0.0))


def _table(items: list[NamedStage]) -> polars.DataFrame:
    """Return the columns that `qpbenchmark.ParquetTestSet` reads: matrices as flat lists, row by row, null for none."""
    columns: dict[str, list[list[float] | None]] = {
        key: [None if (part := getattr(item.stage.problem, key)) is None else np.ravel(part).tolist() for item in items]
        for key in ("P", "q", "G", "h", "A", "b", "lb", "ub")
    }
    table = polars.DataFrame(columns, schema=dict.fromkeys(columns, polars.List(polars.Float64)))
    return table.with_columns(polars.Series("name", [item.name for item in items]))


def _test_set_file(subset: Subset) -> str:
    template = Template(files("comparisons").joinpath("data/qpbenchmark_test_set.py.in").read_text(encoding="utf-8"))
    return template.substitute(
        module=subset.module,
        class_name=subset.class_name,
        title=repr(subset.title),
        description=repr(subset.description),
    )
