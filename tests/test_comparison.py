"""The comparison judges by figures of its own: what disagrees or fails is shown as such."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from comparisons import run as running
from comparisons.mink_today import MinkSolver
from comparisons.run import MINK_ROWS, Job, jobs, replay
from comparisons.settings import ComparisonSettings
from comparisons.summary import summarise
from prioritized_ik.solvers.backends import registry
from prioritized_ik.solvers.backends.protocol import StageResult
from prioritized_ik.solvers.backends.qpsolvers_ import QpsolversBackend
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.lexicographic import FREE
from prioritized_ik.solvers.stages import Stage
from prioritized_ik.winding.episode import Episode, wind
from prioritized_ik.winding.settings import WindingSettings


class Crooked:
    """A real backend whose answers can be spoiled: the step off by 1e-5 of itself, or not found."""

    version = "0"

    def __init__(self, name: str, accuracy: float) -> None:
        self.name = name
        self._honest = QpsolversBackend("daqp", accuracy)

    def solve(self, stage: Stage) -> StageResult:
        answer = self._honest.solve(stage)
        if stage.costed < stage.size or answer.x is None:
            return answer
        if self.name == "silent":
            return StageResult(None, "no idea")
        wrong = 1e-5 * np.linalg.norm(stage.dtheta(answer.x)) / np.linalg.norm(stage.basis[:, 0])
        return StageResult(answer.x + wrong * np.eye(stage.size)[0])


@pytest.fixture
def crooked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_factories", {})
    for name in ("off", "silent"):
        registry.register(name, lambda accuracy, name=name: Crooked(name, accuracy))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("recorded")
    wind(ComparisonSettings(solvers=("daqp",), link=13).winding("up", "daqp")).save(place / "up.npz")
    return place


def rows_of(folder: Path, *solvers: str, formulation: str = "lexicographic") -> dict[str, Any]:
    settings = ComparisonSettings(solvers=solvers, directions=("up",), steps=12, link=13)
    records = [
        record for solver in solvers for record in replay(settings, Job("replay", solver, formulation, ("up",)), folder)
    ]
    return {row.solver: row for row in summarise(records, [])}


@pytest.mark.usefixtures("crooked")
def test_a_backend_that_is_off_by_a_hundred_thousandth_disagrees(folder: Path) -> None:
    rows = rows_of(folder, "daqp", "off")
    assert rows["daqp"].verdict == "agrees"
    assert rows["off"].verdict.startswith(("disagrees", "fails"))
    assert rows["off"].free_dtheta_error_max > 1e-6


@pytest.mark.usefixtures("crooked")
def test_a_backend_that_finds_nothing_is_counted_as_failed(folder: Path) -> None:
    row = rows_of(folder, "silent")["silent"]
    assert row.not_found == 12
    assert row.verdict == "fails: 12/12 steps"
    assert row.free_dtheta_error_max is None


def test_the_damped_formulation_is_another_problem(folder: Path) -> None:
    assert rows_of(folder, "quadprog", formulation="damped")["quadprog"].verdict != "agrees"


def test_the_sample_holds_free_and_constrained_steps_of_the_whole_episode(folder: Path) -> None:
    sample = running._sample(folder / "up.npz", 12, RANK_TOLERANCE)
    assert [item.step for item in sample] == sorted({item.step for item in sample})
    assert len(sample) == 12
    assert {item.free for item in sample} == {True, False}
    for item in sample:
        assert item.free == (item.problem.relative_violation(item.dtheta) <= FREE)


def test_every_solver_replays_and_drives_and_so_does_mink() -> None:
    settings = ComparisonSettings(solvers=("daqp", "scs"), directions=("up", "back"))
    todo = {(job.kind, job.solver, job.formulation, job.directions) for job in jobs(settings)}
    assert len(todo) == len(jobs(settings)) == 2 * 2 + 2 + (2 + 1 + 2) * 2
    assert ("drive", "closed-form", "closed form", ("up",)) in todo
    assert {("replay", name, "mink", ("up", "back")) for name in MINK_ROWS} <= todo


def test_mink_is_given_the_same_problem() -> None:
    # Far from singular and with nothing binding, mink's damping does no harm: both take the same step.
    settings = WindingSettings(posture="random", seed=3, max_steps=1, weights="eq24", speed=0.02)
    episode = wind(settings)
    step = MinkSolver(settings, "quadprog")(episode.problem(0), episode.q[0])
    dx = episode.jacobian[0] @ step.dtheta
    assert np.linalg.norm(dx - episode.jacobian[0] @ episode.dtheta[0]) <= 1e-6 * np.linalg.norm(dx)


def test_minks_limits_bind_where_ours_do(folder: Path) -> None:
    episode = Episode.load(folder / "up.npz")
    solver = MinkSolver(episode.settings, "daqp")
    for number in range(0, episode.steps, 10):
        problem = episode.problem(number)
        solver(problem, episode.q[number])
        ours = {tuple(np.round(row, 9)): side for row, side in zip(problem.rows.matrix, problem.rows.upper, strict=True)}
        g, h = solver._limits[2].compute_qp_inequalities(solver._configuration, episode.settings.dt)
        theirs = {tuple(np.round(row, 9)): side for row, side in zip(g, h, strict=True) if math.isfinite(side)}
        assert len(theirs) == len(ours)
        for mine, other in zip(sorted(ours.items()), sorted(theirs.items()), strict=True):
            assert np.allclose(mine[0], other[0], atol=1e-4)
            assert mine[1] == pytest.approx(other[1], abs=1e-9)


@pytest.mark.usefixtures("crooked")
def test_steps_of_a_backend_that_is_off_lie_apart_where_rows_bind(folder: Path) -> None:
    rows = rows_of(folder, "daqp", "quadprog", "off")
    assert rows["daqp"].constrained_dtheta_spread_max <= 1e-6
    assert rows["off"].constrained_dtheta_spread_max > 1e-6


def test_no_replayed_step_is_no_agreement() -> None:
    episode = {"direction": "up", "solver": "daqp", "formulation": "lexicographic", "outcome": "WOUND", "turns_ratio": None,
               "penetration": 0.0, "bend": 0.0, "drift": 0.0}  # fmt: skip
    (row,) = summarise([], [episode])
    assert row.verdict == "fails: no steps"
    assert row.turns_ratio_min is None
