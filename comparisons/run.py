"""Runs a comparison: records one episode a direction, then replays and drives with every solver, in processes.

*Replay*: every solver is given the same recorded problems. *Drive*: every solver winds the arm itself.
"""

import functools
import time
from collections.abc import Callable
from concurrent.futures import Future, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from comparisons.judging import Sampled, judge, sample
from comparisons.mink_today import MinkSolver
from comparisons.processes import one_thread_pool
from comparisons.settings import MINK_SOLVERS, RECORDER, ComparisonSettings
from prioritized_ik.errors import WitnessError
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.backends.abilities import abilities_of
from prioritized_ik.solvers.backends.registry import get_backend
from prioritized_ik.solvers.certificate import certify
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.solvers.lexicographic import joint_step
from prioritized_ik.solvers.step import JointStep, StepStatus, Timings
from prioritized_ik.solvers.witness import witness_step
from prioritized_ik.validation import Array
from prioritized_ik.winding.episode import Episode, Solve, wind
from prioritized_ik.winding.metrics import measure
from prioritized_ik.winding.settings import CLOSED_FORM

Record = dict[str, Any]
Progress = Callable[[str, int, int], None]  # what is done, how many are, of how many

#: Solver names of mink's rows.
MINK_ROWS = {f"mink ({solver})": solver for solver in MINK_SOLVERS}

#: The witness's row: the problem written out in CVXPY, with the solver that it calls.
WITNESS_SOLVER = "CLARABEL"
WITNESS = f"cvxpy ({WITNESS_SOLVER.lower()})"

#: These take longest, so they start first.
_SLOW = (WITNESS, "ecos", "clarabel", "scs", "highs", "cvxopt")


@dataclass(frozen=True)
class Job:
    """One thing a worker does: replay all recorded problems, or drive one direction."""

    kind: str  # "replay" or "drive"
    solver: str
    formulation: str
    directions: tuple[str, ...]

    @property
    def label(self) -> str:
        """What the progress bar shows."""
        return f"{self.kind} {self.solver}" + ("" if self.formulation == "lexicographic" else f" {self.formulation}")


def run(settings: ComparisonSettings, folder: Path, progress: Progress) -> tuple[list[Record], list[Record]]:
    """Return the replayed steps and the driven episodes, one record each, in a fixed order.

    Args:
        settings: what to run.
        folder: where the recorded episodes go, `<direction>.npz`.
        progress: called as jobs end.
    """
    with one_thread_pool(settings.workers) as pool:
        recorded = [pool.submit(record_episode, settings, direction, folder) for direction in settings.directions]
        for done, episode in enumerate(as_completed(recorded), 1):
            episode.result()
            progress("record", done, len(recorded))
        todo = jobs(settings)
        futures: dict[Future[list[Record]], Job] = {
            pool.submit(replay if job.kind == "replay" else drive, settings, job, folder): job for job in todo
        }
        for done, future in enumerate(as_completed(futures), 1):
            future.result()
            progress(futures[future].label, done, len(todo))
    results = [(job, future.result()) for future, job in futures.items()]
    results.sort(key=lambda item: (item[0].kind, item[0].solver, item[0].formulation, item[0].directions))
    return (
        [record for job, records in results if job.kind == "replay" for record in records],
        [record for job, records in results if job.kind == "drive" for record in records],
    )


def jobs(settings: ComparisonSettings) -> list[Job]:
    """Return everything to do, the longest first."""
    todo = [
        Job("replay", solver, formulation, settings.directions)
        for solver in settings.solvers
        for formulation in settings.formulations
        if formulation == "lexicographic" or not abilities_of(solver).native  # a start helps nothing in a QP solved once
    ]
    todo += [Job("replay", name, "mink", settings.directions) for name in MINK_ROWS]
    if settings.witness:
        todo.append(Job("replay", WITNESS, "witness", settings.directions))
    drivers = [(solver, "lexicographic") for solver in settings.solvers if "lexicographic" in settings.formulations]
    drivers += [(CLOSED_FORM, "closed form"), *((name, "mink") for name in MINK_ROWS)]
    todo += [Job("drive", name, formulation, (d,)) for name, formulation in drivers for d in settings.directions]
    return sorted(todo, key=lambda job: _SLOW.index(job.solver) if job.solver in _SLOW else len(_SLOW))


def record_episode(settings: ComparisonSettings, direction: str, folder: Path) -> None:
    """Wind one direction with the recorder and save the episode."""
    wind(settings.winding(direction, RECORDER)).save(folder / f"{direction}.npz")


def replay(settings: ComparisonSettings, job: Job, folder: Path) -> list[Record]:
    """Return one record for each sampled problem of each direction, solved by the job's solver."""
    records = []
    for direction in job.directions:
        solve = _solver(settings, job, direction)
        for item in _sample(folder / f"{direction}.npz", settings.steps, settings.rank_tolerance):
            step = solve(item.problem, item.q)
            records.append({"direction": direction, "step": item.step, **judge(item, step), **_names(job)})
    return records


def drive(settings: ComparisonSettings, job: Job, folder: Path) -> list[Record]:
    """Return the record of one episode that the job's solver drives itself."""
    del folder
    (direction,) = job.directions
    solver = CLOSED_FORM if job.solver == CLOSED_FORM else RECORDER
    episode = wind(
        settings.winding(direction, solver),
        None if job.solver == CLOSED_FORM else _solver(settings, job, direction),
    )
    outcome = {"outcome": episode.outcome.name, "message": episode.message}
    return [{"direction": direction, **asdict(measure(episode)), **outcome, **_names(job)}]


def _names(job: Job) -> Record:
    return {"solver": job.solver, "formulation": job.formulation}


def _solver(settings: ComparisonSettings, job: Job, direction: str) -> Solve:
    if job.solver in MINK_ROWS:
        return MinkSolver(settings.winding(direction, RECORDER), MINK_ROWS[job.solver])
    if job.solver == WITNESS:
        return functools.partial(_witness, settings.rank_tolerance)
    # Of a replayed step the solver's own answer is judged, which its refinement is part of; a driven one is polished in any
    # case, so that slow solvers go without.
    backend = get_backend(job.solver, settings.accuracy, refine=job.kind == "replay" or job.solver not in _SLOW)
    options = settings.options(job.formulation)
    return lambda problem, _: joint_step(problem, backend, options)


def _witness(rank_tolerance: float, problem: IKProblem, q: Array) -> JointStep:
    del q
    started = time.perf_counter()
    try:
        dtheta = witness_step(Hierarchy(problem, rank_tolerance).cut_problem, WITNESS_SOLVER)
    except WitnessError as error:
        return JointStep(None, StepStatus.NOT_FOUND, str(error))
    timings = Timings(build=0.0, solve=time.perf_counter() - started)
    certificate = certify(problem, dtheta, rank_tolerance)
    status = StepStatus.SOLVED if certificate.holds else StepStatus.UNCERTIFIED
    return JointStep(dtheta, status, violation=certificate.violation, timings=timings, certificate=certificate)


@functools.cache
def _sample(path: Path, steps: int, rank_tolerance: float) -> list[Sampled]:
    return sample(Episode.load(path), steps, rank_tolerance)
