"""Worker processes for measurements: fresh interpreters, one BLAS thread each, gone when their parent is."""

import multiprocessing
import os
import threading
from concurrent.futures import ProcessPoolExecutor

import threadpoolctl


def one_thread_pool(workers: int) -> ProcessPoolExecutor:
    """Return a pool of `workers` processes.

    They are fresh interpreters: a fork would copy the threads of the parent's libraries in whatever state they are. The
    thread counts are set before they start, because some libraries read them only once.
    """
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))
    return ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _start)


def _start() -> None:
    threadpoolctl.threadpool_limits(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A worker whose parent was killed would wait for its next call for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
