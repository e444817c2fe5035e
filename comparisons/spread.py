"""Spreads pieces of work over this machine or over a Dask cluster: the same pieces, through the same interface.

Here a thread a worker waits for the isolated process that does the work. On a cluster `distributed` gives an executor of
the same kind, which sends the work to its workers, again to another one if a worker is lost:

    dask scheduler                                                  on one machine
    dask worker tcp://HOST:8786 --no-nanny --nthreads 1             once a core, on as many as there are
    prioritized-ik compare --scheduler tcp://HOST:8786 ...          anywhere

Scheduler and workers listen on all interfaces and ask nobody who they are: whoever reaches their ports can run code there.
Start them in a network you trust; on one machine, keep them to it:

    dask scheduler --host 127.0.0.1
    dask worker tcp://127.0.0.1:8786 --host 127.0.0.1 --no-nanny --nthreads 1

Without its nanny a worker is no daemon, and so may start the isolated processes; they are what the nanny would be for.
"""

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from itertools import islice
from typing import Any

from comparisons.isolation import resume, stop
from prioritized_ik.errors import InputError

CONNECTING = 10.0  # [s]
AHEAD = 2  # pieces handed out for each that is worked on: enough to keep all busy, few enough to keep them out of memory


@dataclass(frozen=True)
class Piece:
    """One piece of work.

    Attributes:
        label: what the progress bar shows.
        work: a function of a module, called where the work is done.
        arguments: makes what it is called with, when its turn comes.
        add: called here with what it returned.
    """

    label: str
    work: Callable[..., Any]
    arguments: Callable[[], tuple[Any, ...]]
    add: Callable[[Any], None]


@dataclass(frozen=True)
class Spread:
    """An executor, and how many pieces it works on at the same time."""

    executor: Executor
    slots: Callable[[], int]

    def do(self, pieces: Iterable[Piece]) -> Iterator[Piece]:
        """Do `pieces` and yield each once it is done and added."""
        waiting, running = iter(pieces), dict[Future[Any], Piece]()
        while True:
            for piece in islice(waiting, max(AHEAD * self.slots() - len(running), 0)):
                running[self.executor.submit(piece.work, *piece.arguments())] = piece
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                piece = running.pop(future)
                piece.add(future.result())
                yield piece


@contextlib.contextmanager
def spread_over(workers: int, scheduler: str = "") -> Iterator[Spread]:
    """Yield what spreads over `workers` of this machine, or over the cluster of the Dask `scheduler` at an address.

    Raises:
        InputError: the extra `cluster` is not installed, or nobody answers at the address.
    """
    if scheduler:
        with _cluster(scheduler) as spread:
            yield spread
        return
    resume()
    executor = ThreadPoolExecutor(workers)
    try:
        yield Spread(executor, lambda: workers)
    except BaseException:
        stop()
        raise
    finally:
        executor.shutdown(cancel_futures=True)


@contextlib.contextmanager
def _cluster(address: str) -> Iterator[Spread]:
    try:
        import dask
        import distributed
    except ImportError as error:
        raise InputError("a Dask scheduler needs the extra: pip install 'prioritized-ik[cluster]'.") from error
    # A piece carries its problems with it, so that it can be done again wherever a worker is left.
    with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1GB"}):
        try:
            client = distributed.Client(address, timeout=CONNECTING, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(
                f"no Dask scheduler answers at {address!r} ({error}); start one with `dask scheduler`, and workers with "
                "`dask worker ADDRESS --no-nanny --nthreads 1`."
            ) from error
        with client, client.get_executor(pure=False) as executor:
            yield Spread(executor, lambda: sum(client.nthreads().values()) or os.cpu_count() or 1)
