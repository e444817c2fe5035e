"""Work that is done once: calls with JSON arguments and JSON answers, run in processes, each answer kept in a file.

A run that was interrupted goes on with what is done. An answer counts only for the very code, packages and solvers that
gave it: the folder is named by a digest of the library, the packages and the solvers, and folders of others are removed
once all is done; the file is named by the call and a digest of the modules of `paper_repro` and `comparisons` that its
function can reach.
"""

import ast
import functools
import hashlib
import importlib.metadata
import json
import os
import platform
import re
import shutil
from collections.abc import Callable, Iterable
from concurrent.futures import Future, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import comparisons
import paper_repro
import prioritized_ik
from prioritized_ik.files import write_whole
from prioritized_ik.processes import process_pool
from prioritized_ik.solvers.backends.abilities import abilities_of
from prioritized_ik.solvers.backends.registry import installed_solvers

Json = Any  # what `json` writes and reads back unchanged
Progress = Callable[[str, int, int], None]  # what is done, how many are, of how many

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")  # one a worker, so that times mean something

_DESK = re.compile("[0-9a-f]{16}")  # names of folders of answers

PACKAGES = {"paper_repro": paper_repro, "comparisons": comparisons}  # of ours, beside the library
CALLED = ("mujoco", "mink", "qpsolvers", "numpy", "scipy", "cvxpy", "matplotlib")


@dataclass(frozen=True)
class Job:
    """One call.

    Attributes:
        function: of a module, so that another process finds it; its answer is JSON, and hangs on its arguments alone.
        arguments: by name, JSON.
        alone: whether nothing else may run meanwhile, for what measures time.
    """

    function: Callable[..., Json]
    arguments: dict[str, Json] = field(default_factory=dict)
    alone: bool = False

    @property
    def name(self) -> str:
        """The function, with its module."""
        return f"{self.function.__module__}.{self.function.__qualname__}"

    @property
    def key(self) -> str:
        """A name for the call as the code stands, the same in every process."""
        text = json.dumps([self.name, self.arguments, _module_digest(self.function.__module__)], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:32]

    def __call__(self) -> Json:
        """Return the answer."""
        return self.function(**self.arguments)


class Results:
    """Answers of jobs, as they were read from their files."""

    def __init__(self, answers: dict[str, Json]) -> None:
        self._answers = answers

    def __getitem__(self, job: Job) -> Json:
        """Return the answer of `job`; a KeyError if it was not run."""
        return self._answers[job.key]


def run(jobs: Iterable[Job], folder: Path, workers: int, progress: Progress) -> Results:
    """Return the answers of `jobs`, each done once, whether now or in an earlier run into `folder`.

    Args:
        jobs: what to do; doubles are done once.
        folder: where answers are kept; of one run at a time.
        workers: processes.
        progress: called as jobs end.

    Raises:
        Exception: whatever a job raises; what was done is kept.
    """
    desk = folder / library_digest()
    desk.mkdir(parents=True, exist_ok=True)
    wanted = {job.key: job for job in jobs}
    answers = {key: answer for key in wanted if (answer := _kept(desk / f"{key}.json")) is not None}
    todo = [job for key, job in wanted.items() if key not in answers]
    progress("found what is done", len(answers), len(wanted))
    os.environ.update(dict.fromkeys(THREADS, "1"))  # some libraries read it only when they are loaded
    together, alone = ([job for job in todo if job.alone is flag] for flag in (False, True))
    # What measures time comes last, one at a time, in a process of its own kind.
    for group, processes in ((together, workers), (alone, 1)):
        if group:
            with process_pool(processes) as pool:
                futures: dict[Future[Json], Job] = {pool.submit(job): job for job in group}
                try:
                    for future in as_completed(futures):
                        job = futures[future]
                        answers[job.key] = _keep(desk / f"{job.key}.json", job, future.result())
                        progress(job.name.rpartition(".")[2], len(answers), len(wanted))
                except BaseException:
                    pool.shutdown(wait=False, cancel_futures=True)
                    raise
    for other in folder.iterdir():
        if other != desk and other.is_dir() and _DESK.fullmatch(other.name):
            shutil.rmtree(other)
    return Results(answers)


@functools.cache
def library_digest() -> str:
    """Return a digest of the library and of the versions of what it calls."""
    digest = hashlib.sha256(platform.python_version().encode())
    root = Path(next(iter(prioritized_ik.__path__)))
    for path in sorted(path for path in root.rglob("*") if path.suffix in (".py", ".hpp", ".cpp")):
        digest.update(str(path.relative_to(root)).encode() + path.read_bytes())
    solvers = {abilities_of(name).package for name in installed_solvers(on_request=True)}
    for name in sorted({*CALLED, *solvers}):
        digest.update(f"{name} {importlib.metadata.version(name)}".encode())
    return digest.hexdigest()[:16]


@functools.cache
def _module_digest(module: str) -> str:
    """Return a digest of a module and of all of `PACKAGES` that it imports, at whatever depth."""
    digest = hashlib.sha256()
    for name in sorted(_reached(module)):
        digest.update(name.encode() + _source(name))
    return digest.hexdigest()


def _reached(module: str) -> set[str]:
    seen, waiting = set(), [module]
    while waiting:
        name = waiting.pop()
        if name in seen or not _source(name):
            continue
        seen.add(name)
        for node in ast.walk(ast.parse(_source(name))):
            if isinstance(node, ast.ImportFrom) and node.module:
                waiting += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
            elif isinstance(node, ast.Import):
                waiting += [alias.name for alias in node.names]
    return seen


def _source(name: str) -> bytes:
    """Return the text of a module of `PACKAGES`, nothing for any other name."""
    package, *rest = name.split(".")
    if package not in PACKAGES or not rest:
        return b""
    path = Path(next(iter(PACKAGES[package].__path__))).joinpath(*rest).with_suffix(".py")
    return path.read_bytes() if path.is_file() else b""


def _keep(path: Path, job: Job, answer: Json) -> Json:
    """Write an answer and return it as it will be read, so that both are the same."""
    text = json.dumps({"function": job.name, "arguments": job.arguments, "answer": answer})
    write_whole(path, lambda file: file.write(text.encode()))
    return json.loads(text)["answer"]


def _kept(path: Path) -> Json:
    """Return the answer in a file, None if there is none or it cannot be read."""
    try:
        return json.loads(path.read_bytes())["answer"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
