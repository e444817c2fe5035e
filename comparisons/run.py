"""Runs a comparison: records the cases, then replays and drives them with every solver, and puts it all into a store.

*Replay*: every solver is given the same recorded problems. *Drive*: every solver winds the arm itself.

The pieces of work are spread (`spread`) over this machine or a cluster; each is done in an isolated process there
(`isolation`) and comes back as records, which only this process writes. What the store has already is not done again.
"""

import hashlib
import os
import pickle
import platform
import sys
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict
from functools import lru_cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from comparisons import origin, worker
from comparisons.cases import Case, cases_of, file_name, own_files
from comparisons.episodes import Posed, driven_by, ended_well
from comparisons.isolation import Limits, LostError, isolated, isolated_each, prepare
from comparisons.jobs import WITNESS_SOLVER, Job, drives, replays
from comparisons.own_qps import load_qp, measure_qps
from comparisons.sample import Sampled, chosen, sampled
from comparisons.settings import MINK_SOLVERS, RECORDER, ComparisonSettings
from comparisons.spread import Piece, spread_over
from comparisons.store import Store
from comparisons.tables import EPISODES, Record
from prioritized_ik.errors import InputError, PrioritizedIkError
from prioritized_ik.scene.task_file import load_scene
from prioritized_ik.solvers.backends.abilities import abilities_of
from prioritized_ik.solvers.registry import LEXICOGRAPHIC, get_method, parts_of, registered
from prioritized_ik.winding.episode import Outcome

Progress = Callable[[str, int, int], None]  # what is done, how many are, of how many

SAMPLES = 4  # cases whose problems are kept in memory

#: What does not decide figures but only where and how fast they are made.
WHERE = ("workers", "scheduler", "recorded", "scenes")


class RunError(PrioritizedIkError):
    """A comparison cannot go on."""


def run(settings: ComparisonSettings, folder: Path, progress: Progress, *, keep_driven: bool = True) -> Store:
    """Return the store in `folder` once it holds everything that `settings` ask for.

    Args:
        settings: what to run.
        folder: where the results go, or are already in part.
        progress: called as pieces of it end.
        keep_driven: whether the episodes of driven windings, some 4 MB each, are kept.

    Raises:
        InputError: the folder holds results of other settings, or nobody answers at the scheduler's address.
        RunError: a case cannot be recorded, or a worker of the cluster runs another program.
    """
    prepare()
    run_ = _Run(settings, folder, keep_driven=keep_driven)
    with spread_over(settings.workers, settings.scheduler) as spread:
        for pieces in (run_.recordings(), run_.qps(), run_.replays_and_drives()):
            total = len(pieces)
            for done, piece in enumerate(spread.do(pieces), 1):
                progress(piece.label, done, total)
    return run_.store


class _Run:
    """What one run has to do, as pieces of work; those that the store has are left out."""

    def __init__(self, settings: ComparisonSettings, folder: Path, *, keep_driven: bool) -> None:
        self._settings = settings
        self._keep_driven = keep_driven
        self._extra = sendable(settings.solvers)
        self._cases = {case.name: case for case in cases_of(settings)}
        self.store = Store.create(folder, made_by(settings), facts(settings))
        self._digest = self.store.digest()
        self._limits = Limits(settings.time_limit, int(settings.memory_limit * 2**30))
        self._sample = lru_cache(SAMPLES)(self._load_sample)

    def recordings(self) -> list[Piece]:
        """Return the pieces that record the cases."""
        there = self.store.parts("recorded")
        cases = [case for case in self._cases.values() if file_name(case.name) not in there]
        return [
            Piece(f"record {case.name}", record, partial(self._recording, case), partial(self._add_case, case))
            for case in cases
        ]

    def qps(self) -> list[Piece]:
        """Return the pieces that solve the user's own QPs."""
        if not self._settings.recorded:
            return []
        problems = {path.stem: load_qp(path) for path in own_files(self._settings.recorded)[1]}
        there, pieces = self.store.parts("qps"), []
        for repeat in range(self._settings.repeats):
            for solver in self._settings.solvers if problems else ():
                family, name = parts_of(solver)
                if family != LEXICOGRAPHIC or abilities_of(name).native:
                    continue  # these take stages or hierarchies, not QPs
                for accuracy in self._settings.accuracies_of(solver):
                    file = file_name(name, f"{accuracy:g}", repeat)
                    who = {"solver": name, "accuracy": accuracy, "repeat": repeat, "version": get_method(name).version}
                    if file not in there:
                        arguments = (name, accuracy, problems, self._limits)
                        add = partial(self._add_rows, "qps", file, who)
                        pieces.append(Piece(f"QPs {solver}", qps, partial(tuple, arguments), add))
        return pieces

    def replays_and_drives(self) -> list[Piece]:
        """Return the pieces that compare the solvers."""
        cases, pieces = list(self._cases.values()), []
        there = self.store.parts("steps")
        for job in replays(self._settings, cases):
            if job.file not in there:
                add = partial(self._add_steps, job)
                pieces.append(Piece(job.label, replay, partial(self._replaying, job), add))
        there = self.store.parts("episodes")
        for job in drives(self._settings, cases):
            if job.file not in there:
                pieces.append(Piece(job.label, drive, partial(self._driving, job), partial(self._add_driven, job)))
        return pieces

    def _load_sample(self, case: str) -> list[Sampled]:
        episode = self.store.recorded(case)
        return [sampled(episode, step, self._settings.rank_tolerance) for step in self.store.replayed(case)]

    def _recording(self, case: Case) -> tuple[Any, ...]:
        recorded = None if case.file is None else case.file.read_bytes()
        return case.name, self._settings, case.posed, recorded, self._limits

    def _replaying(self, job: Job) -> tuple[Any, ...]:
        return self._settings, job, self._cases[job.case].posed, self._sample(job.case), self._extra_of(job), self._limits

    def _driving(self, job: Job) -> tuple[Any, ...]:
        posed = self._cases[job.case].posed
        assert posed is not None
        options = self._settings.options(job.formulation, job.accuracy)
        return self._settings, job, driven_by(posed, job.method, options), self._extra_of(job), self._limits

    def _extra_of(self, job: Job) -> worker.Factories:
        return {name: factory for name, factory in self._extra.items() if name == job.solver}

    def _add_case(self, case: Case, told: tuple[Record, Record]) -> None:
        where, recorded = told
        _same_program(where)
        free = recorded["free"]
        self.store.add_case(case, recorded["episode"], free, chosen(free, self._settings.steps))

    def _add_steps(self, job: Job, told: tuple[Record, list[Record]]) -> None:
        self._add_rows("steps", job.file, self._who(job), told)

    def _add_driven(self, job: Job, told: tuple[Record, list[Record]]) -> None:
        where, (row,) = told
        content = row.pop("episode", None)
        file = f"driven/{job.file}.npz" if content is not None and self._keep_driven else None
        if file is not None:
            self.store.write_file(file, lambda opened: opened.write(content))
        done = ended_well(row["outcome"], self.store.recorded(job.case))
        self._add_rows("episodes", job.file, self._who(job), (where, [{**row, "done": done, "file": file}]))

    def _add_rows(self, kind: str, name: str, who: Record, told: tuple[Record, list[Record]]) -> None:
        where, rows = told
        _same_program(where)
        where = {name: value for name, value in where.items() if name != "host"}
        self.store.add(kind, name, [{**row, **where, **who, "settings": self._digest} for row in rows])

    def _who(self, job: Job) -> Record:
        who = {name: value for name, value in asdict(job).items() if name != "kind"}
        winding = self._cases[job.case].winding
        return {**who, "direction": None if winding is None else winding.direction}


def record(
    case: str, settings: ComparisonSettings, posed: Posed | None, recorded: bytes | None, limits: Limits
) -> tuple[Record, Record]:
    """Return where it was done, and the `episode` of a case and which of its steps are `free`.

    Work for `Spread`, as are those below.
    """
    prepare()
    try:
        with closing(isolated(worker.record, (settings, posed, recorded), limits)) as things:
            return _here(), next(things)
    except LostError as lost:
        raise RunError(f"case {case!r} cannot be recorded: {lost}") from lost


def replay(
    settings: ComparisonSettings,
    job: Job,
    posed: Posed | None,
    sample: list[Sampled],
    extra: worker.Factories,
    limits: Limits,
) -> tuple[Record, list[Record]]:
    """Return where it was done, and the record of each problem of `sample`, in spite of whatever the solver does."""
    prepare()
    about, records = isolated_each(
        worker.replay, sample, lambda rest: (settings, job, posed, rest, extra), worker.failed, limits
    )
    return {**_here(), **about}, records


def drive(
    settings: ComparisonSettings, job: Job, posed: Posed, extra: worker.Factories, limits: Limits
) -> tuple[Record, list[Record]]:
    """Return where it was done, and the record of a driven episode, with the `episode` as bytes if there is one."""
    prepare()
    about: Record = {}
    row: Record = {**dict.fromkeys(EPISODES), "outcome": Outcome.SOLVER_FAILED.name}
    try:
        with closing(isolated(worker.drive, (settings, job, posed, extra), limits)) as things:
            about = next(things)
            row = next(things)
    except LostError as lost:
        row |= {"failure": lost.failure, "message": str(lost)}
    return {**_here(), **about}, [row]


def qps(solver: str, accuracy: float, problems: dict[str, Any], limits: Limits) -> tuple[Record, list[Record]]:
    """Return where it was done, and the record of each QP."""
    prepare()
    return _here(), measure_qps(solver, accuracy, problems, limits)


def sendable(solvers: tuple[str, ...]) -> worker.Factories:
    """Return the factories of those methods that were added to the registry, which are sent along.

    Raises:
        InputError: one cannot be sent to another process.
    """
    extra = {name: factory for name, factory in registered().items() if name in solvers}
    for name, factory in extra.items():
        try:
            pickle.dumps(factory)
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise InputError(
                f"method {name!r} cannot be sent to a process of its own ({error}); register a function or a class of a "
                "module that can be imported."
            ) from error
    return extra


def made_by(settings: ComparisonSettings) -> dict[str, Any]:
    """Return what decides the figures: settings, versions, program, the user's own files, and those of added backends."""
    deciding = {name: value for name, value in asdict(settings).items() if name not in WHERE}
    files = [path for paths in own_files(settings.recorded) for path in paths] if settings.recorded else []
    digests = {path.name: hashlib.sha256(path.read_bytes()).hexdigest()[:12] for path in files}
    scenes = {Path(file).name: scene_digest(Path(file)) for file in settings.scenes}
    plugins = {name: _source_digest(factory) for name, factory in registered().items() if name in settings.solvers}
    made = {
        "recorded": digests,
        "scenes": scenes,
        "plugins": plugins,
        "version": _versions(settings),
        "program": origin.code(),
    }
    return {**deciding, **made}


def scene_digest(file: Path) -> str:
    """Return the beginning of the SHA-256 of a task file and of the model that it loads, meshes included."""
    model = load_scene(file).model
    compiled = np.empty(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, compiled)
    return hashlib.sha256(file.read_bytes() + compiled.tobytes()).hexdigest()[:12]


def facts(settings: ComparisonSettings) -> dict[str, Any]:
    """Return what else is to be known of a run."""
    return {
        "versions": _versions(settings),
        "cpu": {"model": origin.cpu_model(), "cores": os.cpu_count(), "workers": settings.workers, "blas_threads": 1},
        "revision": origin.revision(),
        "program": origin.code(),
        "settings": asdict(settings),
        "accuracies_left_out": settings.left_out(),
    }


def _versions(settings: ComparisonSettings) -> dict[str, str]:
    """Return the versions of what decides on figures, also of solvers that are called without being compared."""
    names = dict.fromkeys(settings.solvers)
    if not settings.recorded:
        names[RECORDER] = None
    if settings.mink:
        names |= dict.fromkeys(MINK_SOLVERS)
    known = {name: get_method(name).version for name in names if name not in registered()}
    if settings.witness:
        known |= {package: version(package) for package in ("cvxpy", WITNESS_SOLVER)}
    return origin.versions(known)


def _source_digest(factory: Callable[..., Any]) -> str:
    """Return the beginning of the SHA-256 of the file of the module that `factory` comes from; what that imports aside."""
    while isinstance(factory, partial):
        factory = factory.func
    file = getattr(sys.modules.get(factory.__module__), "__file__", None)
    return "unknown" if file is None else hashlib.sha256(Path(file).read_bytes()).hexdigest()[:12]


def _same_program(where: Record) -> None:
    """Refuse what a worker made with another program.

    Raises:
        RunError: it did.
    """
    if where["code"] != origin.code():
        raise RunError(
            f"the worker on {where['host']!r} runs another program ({where['code']}, here {origin.code()}); install "
            "the same version there, and start its worker again."
        )


def _here() -> Record:
    program = {"revision": origin.revision(), "code": origin.code()}
    return {"version": "unknown", "cpu": origin.cpu_model(), **program, "host": platform.node()}
