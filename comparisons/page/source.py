"""What the page needs to know of a comparison's results: a `Store` has it."""

from pathlib import Path
from typing import Any, Protocol

import mujoco
import polars

from prioritized_ik.problem import IKProblem


class Source(Protocol):
    """Results of one comparison."""

    @property
    def folder(self) -> Path:
        """Where the files named in `episodes` are."""
        ...

    def steps(self) -> polars.DataFrame:
        """Return one row for each (case, step, solver, formulation, accuracy, repeat)."""
        ...

    def episodes(self) -> polars.DataFrame:
        """Return one row for each driven winding."""
        ...

    def facts(self) -> dict[str, Any]:
        """Return versions, processor and settings."""
        ...

    def problem(self, case: str, step: int) -> IKProblem:
        """Return a recorded problem."""
        ...

    def model(self, case: str) -> mujoco.MjModel | None:
        """Return the model of a case that is a scene."""
        ...
