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

import numpy as np

from comparisons.mink_today import MinkSolver
from comparisons.processes import one_thread_pool
from comparisons.settings import MINK_SOLVERS, RECORDER, ComparisonSettings
from prioritized_ik.errors import WitnessError
from prioritized_ik.problem import IKProblem, Level
from prioritized_ik.solvers.backends.abilities import abilities_of
from prioritized_ik.solvers.backends.registry import get_backend
from prioritized_ik.solvers.certificate import certify
from prioritized_ik.solvers.closed_form import level_decomposition, resulting_displacement
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.solvers.lexicographic import ACCEPTED_VIOLATION, FREE, joint_step
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
        if formulation != "damped" or not abilities_of(solver).native  # a start helps nothing in a QP solved once
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
        sample = _sample(folder / f"{direction}.npz", settings.steps, settings.rank_tolerance)
        solve = _solver(settings, job, direction)
        for item in sample:
            step = solve(item.problem, item.q)
            records.append({"direction": direction, "step": item.step, **_judge(item, step), **_names(job)})
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


@dataclass(frozen=True)
class _Sampled:
    """A recorded problem and what the closed form says of it."""

    step: int
    problem: IKProblem
    level: Level  # the problem's, its matrix cut to the rank that all solvers share
    q: Array
    dtheta: Array  # Eqs. (12) to (14)
    dx: Array  # Eq. (15)
    free: bool


@functools.cache
def _sample(path: Path, steps: int, rank_tolerance: float) -> list[_Sampled]:
    """Return up to `steps` problems of an episode, evenly spaced, half of them free as far as there are so many."""
    episode = Episode.load(path)
    everything = [_sampled(episode, step, rank_tolerance) for step in range(episode.steps)]
    free = [item for item in everything if item.free]
    bound = [item for item in everything if not item.free]
    frees = _spread(free, max(steps // 2, steps - len(bound)))
    return sorted([*frees, *_spread(bound, steps - len(frees))], key=lambda item: item.step)


def _sampled(episode: Episode, step: int, rank_tolerance: float) -> _Sampled:
    problem = episode.problem(step)
    level = problem.levels[0]
    hierarchy = Hierarchy(problem, rank_tolerance)
    dtheta = hierarchy.closed_form
    factors, _ = level_decomposition(level, np.eye(problem.joint_count), rank_tolerance)
    return _Sampled(
        step,
        problem,
        hierarchy.cut_problem.levels[0],
        episode.q[step],
        dtheta,
        resulting_displacement(factors.j_a, level.weights, level.target),
        problem.relative_violation(dtheta) <= FREE,
    )


def _spread(items: list[_Sampled], count: int) -> list[_Sampled]:
    """Return `count` of `items`, evenly spaced."""
    if count >= len(items):
        return items
    return [items[i] for i in np.linspace(0, len(items) - 1, count).round().astype(int)]


def _judge(item: _Sampled, step: JointStep) -> Record:
    """Return the figures of one step, every one computed from the problem and none taken from the solver.

    What is judged is the solver's own answer, before the polish; the certified step has columns of its own.
    """
    level = item.level
    own = step.raw if step.raw is not None else step.dtheta
    certificate = step.certificate
    record: Record = {
        "free": item.free,
        "status": step.status.name,
        "message": step.message,
        "found": step.found,
        "solve_s": step.timings.build + step.timings.solve,
        "polish_s": step.timings.polish,
        "violation": None,
        "cost": None,
        "cost_at_zero": level.cost(np.zeros_like(item.dtheta)),
        "dtheta": None,
        "dtheta_error": None,
        "dx_error": None,
        "certified": step.status in (StepStatus.CLOSED_FORM, StepStatus.SOLVED),
        "certificate": None if certificate is None else certificate.worst,
        "certified_dtheta": None,
        "repairs": step.repairs,
    }
    if step.dtheta is None or own is None:
        record["violation"] = step.violation if step.violation > ACCEPTED_VIOLATION else None
        return record
    record["dtheta"] = own.tolist()
    record["violation"] = item.problem.relative_violation(own)
    record["cost"] = level.cost(own)
    if record["certified"]:
        record["certified_dtheta"] = step.dtheta.tolist()
    if item.free:
        record["dtheta_error"] = _relative(own, item.dtheta)
        record["dx_error"] = _relative(level.matrix @ own, item.dx)
    return record


def _relative(value: Array, reference: Array) -> float:
    return float(np.linalg.norm(value - reference) / np.linalg.norm(reference))
