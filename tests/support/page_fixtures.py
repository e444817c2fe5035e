"""A small comparison whose every figure is chosen: two solvers that agree, one that is off and fails, their windings."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import polars
from winding_fixtures import recorded

from comparisons.compared import compared
from comparisons.tables import EPISODES, JOB, ORIGIN, STEPS
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.step import StepStatus
from prioritized_ik.winding.episode import Episode, Outcome
from prioritized_ik.winding.metrics import measure

#: Names and messages come from files and solvers: they may hold anything.
CASE = "up <i>&amp;"
MESSAGE = "</script><!-- <img src=x onerror=\"throw 'markup'\"> 'quoted' ${x}"

FAST, SLOW, WRONG = "proxqp", "daqp", "scs"
TIMES = {FAST: 2e-3, SLOW: 10e-3, WRONG: 4e-3}  # [s] ordered neither as the names nor as the figures' texts
OFF = {FAST: 0.0, SLOW: 1e-9, WRONG: 1e-3}  # relative error of every dθ
COUNT = 8  # replayed steps, the last of which WRONG does not answer


@dataclass
class SmallStore:
    """What `page.source.Source` asks for."""

    folder: Path

    @cached_property
    def episode(self) -> Episode:
        return recorded(link=13)

    @cached_property
    def numbers(self) -> list[int]:
        return [int(step) for step in np.linspace(0, self.episode.steps - 1, COUNT)]

    def steps(self) -> polars.DataFrame:
        rows = []
        for solver in TIMES:
            for repeat in (0, 1):
                for place, step in enumerate(self.numbers):
                    rows.append(self._job(solver, repeat) | self._step(solver, step, place))
        return compared(polars.DataFrame(rows, schema={**JOB, **STEPS, **ORIGIN}, orient="row"))

    def episodes(self) -> polars.DataFrame:
        rows = []
        for solver in (FAST, SLOW, WRONG):
            name = f"{solver}.npz" if solver != WRONG else None
            if name is not None and not (self.folder / name).exists():
                self._driven(solver).save(self.folder / name)
            figures = vars(measure(self._driven(solver)))
            outcome = Outcome.WOUND if name else Outcome.SOLVER_FAILED
            rows.append(
                {**dict.fromkeys({**EPISODES, **ORIGIN}), **self._job(solver, 0), **figures, "outcome": outcome.name}
                | {"message": "" if name else MESSAGE, "file": name, "done": name is not None}
            )
        return polars.DataFrame(rows, schema={**JOB, **EPISODES, **ORIGIN}, orient="row")

    def facts(self) -> dict[str, Any]:
        settings = {"solvers": list(TIMES), "seeds": [], "rank_tolerance": 1e-4}
        return {"versions": {"python": "3.11", MESSAGE: MESSAGE}, "settings": settings}

    def problem(self, case: str, step: int) -> IKProblem:
        assert case == CASE
        return self.episode.problem(step)

    def model(self, case: str) -> None:
        assert case == CASE

    def _driven(self, solver: str) -> Episode:
        return self.episode if solver == FAST else recorded(link=13, tilt=0.3)  # so that they look different

    @staticmethod
    def _job(solver: str, repeat: int) -> dict[str, Any]:
        return {
            "case": CASE, "direction": "up", "solver": solver, "version": "1", "formulation": "lexicographic",
            "accuracy": 1e-8, "start": "cold", "repeat": repeat,
        }  # fmt: skip

    def _step(self, solver: str, step: int, place: int) -> dict[str, Any]:
        right = self.episode.dtheta[step]
        free = place % 2 == 0
        record = dict.fromkeys({**STEPS, **ORIGIN}) | {
            "step": step, "free": free, "status": StepStatus.SOLVED.name, "message": "", "found": True,
            "build_s": 0.25 * TIMES[solver], "solve_s": 0.75 * TIMES[solver], "polish_s": 1e-3, "violation": 0.0,
            "cost": 1.0, "cost_at_zero": 2.0, "dtheta": (right * (1.0 + OFF[solver])).tolist(), "certified": True,
            "dtheta_error": OFF[solver] if free else None, "dx_error": OFF[solver] if free else None,
            "certified_dtheta": right.tolist(), "certified_dx_error": OFF[solver], "certificate": 0.0, "repairs": 0,
        }  # fmt: skip
        if solver == WRONG and place == COUNT - 1:
            lost = ("dtheta", "certified_dtheta", "violation", "cost", "dtheta_error", "dx_error", "certified_dx_error")
            record |= dict.fromkeys(lost) | {"found": False, "failure": "crash", "message": MESSAGE, "certified": False}
        return record
