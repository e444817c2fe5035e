"""Worker processes: fresh interpreters, gone when their parent is."""

import multiprocessing
import os
import threading
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

from prioritized_ik.validation import at_least

Item = TypeVar("Item")
Result = TypeVar("Result")

CHUNKS = 4  # a worker: few enough to cost little, many enough that none waits long for the last


def process_pool(workers: int) -> ProcessPoolExecutor:
    """Return a pool of `workers` processes.

    They are fresh interpreters: a fork would copy the locks and threads of the parent's libraries in whatever state they
    are.
    """
    return ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _start)


def over_processes(call: Callable[[Item], Result], items: list[Item], workers: int | None = None) -> list[Result]:
    """Return what `call`, a function of a module, makes of each item, in order, over `workers` processes.

    Raises:
        InputError: no worker.
        Exception: whatever a call raises.
    """
    count = at_least("workers", (os.cpu_count() or 1) if workers is None else workers, 1)
    count = min(count, len(items))
    if count <= 1:
        return [call(item) for item in items]
    with process_pool(count) as pool:
        return list(pool.map(call, items, chunksize=-(-len(items) // (CHUNKS * count))))


def _start() -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A worker whose parent was killed would wait for its next call for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
