"""What the isolated processes do: replay, drive, record. Every figure is computed from the problem, none told by a solver.

A backend's calls go through a guard, which tells its errors and what is no answer from answers.
"""

import contextlib
import time
from collections.abc import Callable, Mapping
from typing import TypeVar

import numpy as np

from comparisons.episodes import Posed, content_of, figures_of, play, record_of
from comparisons.isolation import ERROR, MEMORY, NAN, BadAnswerError, Tell
from comparisons.jobs import SLOW, WARM, Job
from comparisons.judging import blank, judge
from comparisons.sample import Sampled, free_steps
from comparisons.settings import RECORDER, ComparisonSettings
from comparisons.tables import Record
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.backends.protocol import Backend, StageResult
from prioritized_ik.solvers.backends.registry import ACCURACY
from prioritized_ik.solvers.certificate import certify
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.methods import Lexicographic, Method, OneQp, Place
from prioritized_ik.solvers.registry import get_method, register
from prioritized_ik.solvers.solve import step_of
from prioritized_ik.solvers.stages import Stage
from prioritized_ik.solvers.step import JointStep, StepStatus
from prioritized_ik.validation import Array

Factories = Mapping[str, Callable[[float], Method]]

Found = TypeVar("Found", StageResult, JointStep)

NOT_FOUND = StepStatus.NOT_FOUND.name


def record(tell: Tell, settings: ComparisonSettings, posed: Posed | None, recorded: bytes | None) -> None:
    """Tell the `episode` of a case as bytes, and which of its steps are `free`.

    Args:
        tell: called with that.
        settings: of the comparison.
        posed: what is recorded.
        recorded: the bytes of an episode that is there already, instead.
    """

    def goes_on(_: int) -> None:
        tell(None, ours=True)

    if recorded is None:
        assert posed is not None
        options = settings.options()
        recorded = content_of(play(posed, get_method(RECORDER, options.accuracy), options, goes_on))
    tell({"episode": recorded, "free": free_steps(record_of(recorded), settings.rank_tolerance, on_step=goes_on)})


def replay(
    tell: Tell, settings: ComparisonSettings, job: Job, posed: Posed | None, sample: list[Sampled], extra: Factories
) -> None:
    """Tell the solver's version, then one record for each problem of `sample`, solved by the job's solver.

    A warm start is one from the step before, which is solved first and not measured, by a solver set up for that: so no
    answer depends on which other steps are replayed, nor on an accident before.
    """
    _register(extra)
    tell({"about": {"version": get_method(job.method).version}})
    options = settings.options(job.formulation, job.accuracy)
    for item in sample:
        method, place = _guarded(job), Place(item.q, posed)
        if job.start == WARM and item.before is not None:
            with contextlib.suppress(BadAnswerError):  # to a problem that is not asked for
                step_of(method, item.before, options, place)
                tell(None)
        try:
            step = step_of(method, item.problem, options, place)
        except BadAnswerError as error:
            tell(failed(item, error.failure, str(error)))
        else:
            tell(None, ours=True)
            figures = judge(item, step)
            if job.repeat == 0 and figures["dtheta"] is not None:  # a certificate takes as long as a solve
                figures |= _own_certificate(item.problem, np.array(figures["dtheta"]), settings.rank_tolerance)
            tell(figures)


def drive(tell: Tell, settings: ComparisonSettings, job: Job, posed: Posed, extra: Factories) -> None:
    """Tell the solver's version, then the record of an episode that the job's solver drives."""
    _register(extra)
    tell({"version": get_method(job.method).version}, ours=True)
    driver = _Driver(_guarded(job), tell)
    options = settings.options(job.formulation, job.accuracy)
    played = play(posed, driver, options, lambda _: tell(None, ours=True))
    tell(None, ours=True)
    figures = figures_of(played)
    tell(None, ours=True)
    tell({**figures, "failure": driver.failure, "episode": content_of(played)})


def failed(item: Sampled, failure: str | None, message: str) -> Record:
    """Return the record of a problem to which there is no answer."""
    return {**blank(item), "status": NOT_FOUND, "message": message, "found": False, "failure": failure}


def _guarded(job: Job) -> Method:
    """Return the method of a job; its errors, and answers that are none, are `BadAnswerError`."""
    # Of a replayed step the solver's own answer is judged, which its refinement is part of; a driven one is polished in any
    # case, so that slow solvers go without.
    accuracy = ACCURACY if job.accuracy is None else job.accuracy
    method = get_method(job.method, accuracy, refine=job.kind == "replay" or job.solver not in SLOW)
    if isinstance(method, Lexicographic | OneQp):
        method.backend = _GuardedBackend(method.backend)
    return _Guarded(method)


def _own_certificate(problem: IKProblem, dtheta: Array, rank_tolerance: float) -> Record:
    started = time.perf_counter()
    worst = certify(problem, dtheta, rank_tolerance).worst
    return {"own_certificate": worst, "certificate_s": time.perf_counter() - started}


def _register(factories: Factories) -> None:
    for name, factory in factories.items():
        register(name, factory)


class _Guarded(Method):
    """A method whose errors, and steps that are none, are `BadAnswerError`."""

    def __init__(self, method: Method) -> None:
        self._method = method
        self.name = method.name

    @property
    def version(self) -> str:
        """Version of the method."""
        return self._method.version

    def step(self, problem: IKProblem, options: SolveOptions | None = None, place: Place | None = None) -> JointStep:
        """See `Method.step`."""
        return _checked(
            self.name, lambda: self._method.step(problem, options, place), lambda step: step.dtheta, problem.joint_count
        )


class _Driver(_Guarded):
    """A method that winds the arm: it tells before each step, and keeps what failed."""

    def __init__(self, method: Method, tell: Tell) -> None:
        super().__init__(method)
        self._tell = tell
        self.failure: str | None = None

    def step(self, problem: IKProblem, options: SolveOptions | None = None, place: Place | None = None) -> JointStep:
        """See `Method.step`."""
        self._tell(None)  # the time limit is that of the solver's work on one problem
        try:
            return super().step(problem, options, place)
        except BadAnswerError as error:
            self.failure = error.failure
            return JointStep(None, StepStatus.NOT_FOUND, str(error))


class _GuardedBackend:
    """A backend whose errors, and answers that are none, are `BadAnswerError`."""

    def __init__(self, backend: Backend) -> None:
        self._backend = backend
        self.name = backend.name
        self.version = backend.version

    def solve(self, stage: Stage) -> StageResult:
        """See `Backend.solve`."""
        return self._checked(lambda: self._backend.solve(stage), stage)

    def solve_once(self, stage: Stage) -> StageResult:
        """See `Backend.solve_once`."""
        return self._checked(lambda: self._backend.solve_once(stage), stage)

    def _checked(self, call: Callable[[], StageResult], stage: Stage) -> StageResult:
        return _checked(self.name, call, lambda result: result.x, stage.size)


def _checked(name: str, call: Callable[[], Found], answer: Callable[[Found], Array | None], size: int) -> Found:
    """Return what a call returns, if its answer is none or `(size,)` finite numbers.

    Raises:
        BadAnswerError: it is not, or the call raised.
    """
    try:
        result = call()
        found = answer(result)
        x = None if found is None else np.asarray(found, dtype=float)
    except BadAnswerError:
        raise
    except MemoryError as error:
        raise BadAnswerError(MEMORY, f"{name} took more memory than it may") from error
    except Exception as error:  # a solver never raises for a failure; one that does is not to stop the others
        raise BadAnswerError(ERROR, f"{name} raised {type(error).__name__}: {error}") from error
    if x is not None and x.shape != (size,):
        raise BadAnswerError(ERROR, f"{name} returned shape {x.shape}; expected ({size},)")
    if x is not None and not np.isfinite(x).all():
        raise BadAnswerError(NAN, f"{name} returned values that are not finite")
    return result
