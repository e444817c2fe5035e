"""What the isolated processes do: replay, drive, record. Every figure is computed from the problem, none told by a solver.

A backend's calls go through a guard, which tells its errors and what is no answer from answers.
"""

import contextlib
import functools
import io
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from importlib.metadata import version

import numpy as np

from comparisons.isolation import ERROR, MEMORY, NAN, BadAnswerError, Tell
from comparisons.jobs import MINK_ROWS, SLOW, WARM, WITNESS, WITNESS_SOLVER, Job
from comparisons.judging import blank, judge
from comparisons.mink_today import MinkSolver
from comparisons.sample import Sampled, free_steps
from comparisons.settings import ComparisonSettings
from comparisons.tables import Record
from prioritized_ik.errors import WitnessError
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.backends.protocol import AnyBackend, StageResult
from prioritized_ik.solvers.backends.registry import ACCURACY, get_backend, register
from prioritized_ik.solvers.certificate import certify
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.solvers.lexicographic import joint_step
from prioritized_ik.solvers.stages import Stage
from prioritized_ik.solvers.step import JointStep, StepStatus, Timings
from prioritized_ik.validation import Array
from prioritized_ik.winding.episode import Episode, Solve, wind
from prioritized_ik.winding.metrics import measure
from prioritized_ik.winding.settings import CLOSED_FORM, WindingSettings

Factories = Mapping[str, Callable[[float], AnyBackend]]

NOT_FOUND = StepStatus.NOT_FOUND.name


def record(tell: Tell, rank_tolerance: float, winding: WindingSettings, recorded: bytes | None) -> None:
    """Tell the `episode` of a winding as bytes, and which of its steps are `free`.

    Args:
        tell: called with that.
        rank_tolerance: of the closed form.
        winding: how it is recorded.
        recorded: the bytes of an episode that is there already, instead.
    """

    def goes_on(_: int) -> None:
        tell(None, ours=True)

    episode = wind(winding, on_step=goes_on) if recorded is None else episode_of(recorded)
    free = free_steps(episode, rank_tolerance, on_step=goes_on)
    tell({"episode": recorded or episode_bytes(episode), "free": free})


def replay(
    tell: Tell, settings: ComparisonSettings, job: Job, winding: WindingSettings, sample: list[Sampled], extra: Factories
) -> None:
    """Tell the solver's version, then one record for each problem of `sample`, solved by the job's solver.

    A warm start is one from the step before, which is solved first and not measured, by a solver set up for that: so no
    answer depends on which other steps are replayed, nor on an accident before.
    """
    _register(extra)
    tell({"about": {"version": version_of(job.solver)}})
    for item in sample:
        solve = _solver(settings, job, winding)
        if job.start == WARM and item.before is not None:
            with contextlib.suppress(BadAnswerError):  # to a problem that is not asked for
                solve(item.before, item.q)
                tell(None)
        try:
            step = solve(item.problem, item.q)
        except BadAnswerError as error:
            tell(failed(item, error.failure, str(error)))
        else:
            tell(None, ours=True)
            figures = judge(item, step)
            if job.repeat == 0 and figures["dtheta"] is not None:  # a certificate takes as long as a solve
                figures |= _own_certificate(item.problem, np.array(figures["dtheta"]), settings.rank_tolerance)
            tell(figures)


def drive(tell: Tell, settings: ComparisonSettings, job: Job, winding: WindingSettings, extra: Factories) -> None:
    """Tell the solver's version, then the record of a winding that the job's solver drives."""
    _register(extra)
    tell({"version": version_of(job.solver)}, ours=True)
    failure: str | None = None
    solve = None if job.solver == CLOSED_FORM else _solver(settings, job, winding)

    def guarded(problem: IKProblem, q: Array) -> JointStep:
        nonlocal failure
        assert solve is not None
        tell(None)  # the time limit is that of the solver's work on one problem
        try:
            return solve(problem, q)
        except BadAnswerError as error:
            failure = error.failure
            return JointStep(None, StepStatus.NOT_FOUND, str(error))

    episode = wind(winding, guarded if solve else None, on_step=lambda _: tell(None, ours=True))
    tell(None, ours=True)
    figures = asdict(measure(episode))
    tell(None, ours=True)
    outcome = {"outcome": episode.outcome.name, "message": episode.message, "failure": failure}
    tell({**figures, **outcome, "episode": episode_bytes(episode)})


def failed(item: Sampled, failure: str | None, message: str) -> Record:
    """Return the record of a problem to which there is no answer."""
    return {**blank(item), "status": NOT_FOUND, "message": message, "found": False, "failure": failure}


def version_of(solver: str) -> str:
    """Return the version of what a row names as its solver."""
    if solver == CLOSED_FORM:
        return ""
    if solver == WITNESS:
        return version("cvxpy")
    if solver in MINK_ROWS:
        return f"{version('mink')} / {get_backend(MINK_ROWS[solver]).version}"
    return get_backend(solver, 0.01).version


def episode_bytes(episode: Episode) -> bytes:
    """Return the file of an episode."""
    file = io.BytesIO()
    episode.write(file)
    return file.getvalue()


def episode_of(content: bytes) -> Episode:
    """Return the episode whose file is `content`."""
    with tempfile.NamedTemporaryFile(suffix=".npz") as file:
        file.write(content)
        file.flush()
        return Episode.load(file.name)


def _solver(settings: ComparisonSettings, job: Job, winding: WindingSettings) -> Solve:
    if job.solver in MINK_ROWS:
        return MinkSolver(winding, MINK_ROWS[job.solver])
    if job.solver == WITNESS:
        return functools.partial(_witness, settings.rank_tolerance)
    # Of a replayed step the solver's own answer is judged, which its refinement is part of; a driven one is polished in any
    # case, so that slow solvers go without.
    accuracy = ACCURACY if job.accuracy is None else job.accuracy
    backend = _Guard(get_backend(job.solver, accuracy, refine=job.kind == "replay" or job.solver not in SLOW))
    options = settings.options(job.formulation, accuracy)
    return lambda problem, _: joint_step(problem, backend, options)


def _witness(rank_tolerance: float, problem: IKProblem, q: Array) -> JointStep:
    from prioritized_ik.solvers.witness import witness_step  # CVXPY is an extra

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


def _own_certificate(problem: IKProblem, dtheta: Array, rank_tolerance: float) -> Record:
    started = time.perf_counter()
    worst = certify(problem, dtheta, rank_tolerance).worst
    return {"own_certificate": worst, "certificate_s": time.perf_counter() - started}


def _register(factories: Factories) -> None:
    for name, factory in factories.items():
        register(name, factory)


class _Guard:
    """A backend whose errors, and answers that are none, are `BadAnswerError`."""

    def __init__(self, backend: AnyBackend) -> None:
        self._backend = backend
        self.name = backend.name
        self.version = backend.version
        if hasattr(backend, "solve_whole"):
            self.solve_whole = lambda hierarchy: self._checked(
                lambda: backend.solve_whole(hierarchy), hierarchy.problem.joint_count
            )

    def solve(self, stage: Stage) -> StageResult:
        """See `Backend.solve`."""
        return self._checked(lambda: self._backend.solve(stage), stage.size)  # type: ignore[union-attr]

    def _checked(self, call: Callable[[], StageResult], size: int) -> StageResult:
        try:
            result = call()
            x = None if result.x is None else np.asarray(result.x, dtype=float)
        except MemoryError as error:
            raise BadAnswerError(MEMORY, f"{self.name} took more memory than it may") from error
        except Exception as error:  # a backend never raises for a failure; one that does is not to stop the others
            raise BadAnswerError(ERROR, f"{self.name} raised {type(error).__name__}: {error}") from error
        if x is not None and x.shape != (size,):
            raise BadAnswerError(ERROR, f"{self.name} returned shape {x.shape}; expected ({size},)")
        if x is not None and not np.isfinite(x).all():
            raise BadAnswerError(NAN, f"{self.name} returned values that are not finite")
        return result
