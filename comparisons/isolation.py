"""Work in a process of its own, which may crash, hang or eat memory without harm to anyone else.

`concurrent.futures` cannot end one task that hangs, nor say how a worker died; this can, and is little more than
`multiprocessing.Process` and a pipe. What the work tells is sent at once, so that what was done before an accident is not
lost, and the time limit holds from one thing told to the next.

Processes come from a fork server that has imported the solvers already: a start takes milliseconds, memory is shared, and
no thread of the parent's libraries is copied in whatever state it is. Each also sets itself an alarm, which ends it if it
hangs when nobody is left to end it.
"""

import contextlib
import multiprocessing
import os
import resource
import signal
import threading
import time
import traceback
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any, Protocol, TypeVar

from prioritized_ik.errors import InputError

CRASH, TIMEOUT, MEMORY, NAN, ERROR = FAILURES = ("crash", "timeout", "memory", "nan", "error")

STARTING = 60.0  # [s] a process may take for its start on top of the time limit
HEARS = 0.5  # [s] until a call of `stop` is heard
ORPHAN = 5.0  # [s] after its time limit a process ends itself

#: Work ends after as many items in a row that cost a process, each perhaps a whole time limit; the rest count as failed.
IN_A_ROW = 3

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

Item = TypeVar("Item")

_stopped = threading.Event()
_one_at_a_time = threading.Lock()  # multiprocessing looks after its processes at each start, which takes no second thread


@dataclass(frozen=True)
class Limits:
    """What a process may take: `seconds` from one thing told to the next, `memory` [bytes] beyond its start."""

    seconds: float
    memory: int


class Tell(Protocol):
    """What work in a process of its own tells by."""

    def __call__(self, thing: Any, *, ours: bool = False) -> None:
        """Send a `thing`; None says only that the work goes on.

        Args:
            thing: sent on at once.
            ours: whether what follows is no solver's work, and so may take `STARTING` on top of the time limit.
        """


class LostError(Exception):
    """A process ended before its work did. `failure` is one of `FAILURES`."""

    def __init__(self, failure: str, message: str) -> None:
        super().__init__(message)
        self.failure = failure


class StoppedError(Exception):
    """Nobody waits for the work any more."""


class BadAnswerError(Exception):
    """What a backend returned or raised is no answer. `failure` is one of `FAILURES`."""

    def __init__(self, failure: str, message: str) -> None:
        super().__init__(message)
        self.failure = failure


def isolated(work: Callable[..., None], arguments: tuple[Any, ...], limits: Limits) -> Generator[Any, None, None]:
    """Yield what `work(tell, *arguments)` tells by its `Tell`, None aside, in a process of its own.

    Raises:
        LostError: it crashed, hung, took too much memory or raised; what was yielded before stands.
    """
    context = _context()
    here, there = context.Pipe()
    process = context.Process(target=_serve, args=(there, limits), daemon=True)
    with _one_at_a_time:
        process.start()
    there.close()
    allowed = STARTING + limits.seconds
    try:
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # it is dead; below we hear of it
            here.send((work, arguments))
        while True:
            if not _comes(here, allowed):
                raise LostError(TIMEOUT, f"no answer within {allowed:g} s")
            try:
                kind, value, ours = here.recv()
            except (EOFError, OSError):  # OSError: in the middle of a message
                raise _how_it_died(_exit_code(process)) from None
            if kind == "end":
                return
            if kind == "lost":
                raise LostError(*value)
            if value is not None:
                yield value
            allowed = limits.seconds + (STARTING if ours else 0.0)
    finally:
        here.close()
        process.kill()
        _exit_code(process)


def isolated_each(
    work: Callable[..., None],
    items: Sequence[Item],
    arguments: Callable[[Sequence[Item]], tuple[Any, ...]],
    failed: Callable[[Item, str, str], dict[str, Any]],
    limits: Limits,
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return what work tells about itself, and one record for each of `items`, whatever becomes of its processes.

    An item that costs a process counts as failed, and a new process does the rest, or none after `IN_A_ROW` in a row. A
    process that is lost once all records are there, such as by what a library does at its end, is of no account.

    Args:
        work: tells one record for each item in turn; and may tell, as `{"about": ...}`, what holds for all of them.
        items: what there is to do.
        arguments: makes those of the work from the items that are left.
        failed: makes the record of an item from it, one of `FAILURES`, and a message.
        limits: of each process.
    """
    about: dict[str, Any] = {}
    records: list[dict[str, Any]] = []
    in_a_row = 0
    while len(records) < len(items):
        before = len(records)
        try:
            with contextlib.closing(isolated(work, arguments(items[before:]), limits)) as things:
                for thing in things:
                    if "about" in thing:
                        about = thing["about"]
                    else:
                        records.append(thing)
                    if len(records) == len(items):
                        break
        except LostError as lost:
            in_a_row = in_a_row + 1 if len(records) == before else 1
            records.append(failed(items[len(records)], lost.failure, str(lost)))
            if in_a_row == IN_A_ROW:
                message = f"not tried, after {IN_A_ROW} in a row: {lost}"
                records += [failed(item, lost.failure, message) for item in items[len(records) :]]
    return about, records


def prepare() -> None:
    """Say what the processes of this one import, and how many threads they use."""
    # Libraries read these when they are imported.
    os.environ.update(dict.fromkeys(THREADS, "1"))
    multiprocessing.get_context("forkserver").set_forkserver_preload(["comparisons.worker"])


def stop() -> None:
    """End all isolated processes of this one, until `resume` is called."""
    _stopped.set()


def resume() -> None:
    """Let there be isolated processes again."""
    _stopped.clear()


def _comes(connection: Connection, seconds: float) -> bool:
    """Wait until something comes through `connection`, and return whether it did in time.

    Raises:
        StoppedError: `stop` was called.
    """
    deadline = time.monotonic() + seconds
    while not connection.poll(min(HEARS, max(deadline - time.monotonic(), 0.0))):
        if _stopped.is_set():
            raise StoppedError
        if time.monotonic() >= deadline:
            return connection.poll()  # it may have come while this process had no turn
    return True


def _context() -> Any:
    if multiprocessing.current_process().daemon:
        raise InputError(
            "this process is a daemon, which may not start others; start Dask workers with `dask worker --no-nanny`."
        )
    return multiprocessing.get_context("forkserver")


def _exit_code(process: Any) -> int | None:
    """Return the exit code of a process that ends now; None if it does not."""
    wait([process.sentinel], STARTING)
    with _one_at_a_time:
        process.join(0)
        code: int | None = process.exitcode
    return code


def _how_it_died(code: int | None) -> LostError:
    if code == -signal.SIGALRM:
        return LostError(TIMEOUT, "ended by its own alarm")
    if code is not None and code < 0:
        return LostError(CRASH, f"killed by {signal.Signals(-code).name}")
    return LostError(CRASH, f"ended with exit code {code}")


def _serve(connection: Connection, limits: Limits) -> None:
    """Do the work that comes through `connection` and send back what it tells."""
    import threadpoolctl

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # which ends the process, whatever it is at
    signal.setitimer(signal.ITIMER_REAL, STARTING + limits.seconds + ORPHAN)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # solvers that chat
    work, arguments = connection.recv()
    threadpoolctl.threadpool_limits(1)
    soft = _address_space() + limits.memory
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (soft if hard == resource.RLIM_INFINITY else min(soft, hard), hard))

    def tell(thing: Any, *, ours: bool = False) -> None:
        connection.send(("thing", thing, ours))
        signal.setitimer(signal.ITIMER_REAL, limits.seconds + (STARTING if ours else 0.0) + ORPHAN)

    try:
        work(tell, *arguments)
        last: tuple[str, Any, bool] = ("end", None, False)
    except MemoryError:
        last = ("lost", (MEMORY, f"took more than {limits.memory / 2**30:g} GiB"), False)
    except Exception as error:  # whose ever it is, it belongs to this work, and is told
        place = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{os.path.basename(place.filename)}:{place.lineno}"
        last = ("lost", (ERROR, f"{type(error).__name__}: {error} ({where})"), False)
    with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # who has all records waits for no end
        connection.send(last)


def _address_space() -> int:
    """Return the size of this process's address space [bytes]."""
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[0]) * resource.getpagesize()
