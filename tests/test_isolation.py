"""Isolated work is told as it is done, and whatever ends its process is named."""

import ctypes
import os
import signal
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from comparisons.isolation import Limits, LostError, StoppedError, isolated, prepare, resume, stop

LIMITS = Limits(seconds=20.0, memory=2**28)
Tell = Callable[[Any], None]


def count(tell: Tell, until: int, then: str) -> None:
    for number in range(until):
        tell(number)
        tell(None)
    match then:
        case "segfault":
            ctypes.string_at(0)
        case "exit":
            os._exit(7)
        case "raise":
            raise LookupError("nothing there")
        case "hang":
            time.sleep(3600)
        case "hang deaf":
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM, signal.SIGTERM, signal.SIGINT})
            time.sleep(3600)
        case "eat":
            np.ones(2**27)
        case "chat":
            os.write(1, b"chatter")


def identity(tell: Tell) -> None:
    tell((os.getpid(), os.environ["OPENBLAS_NUM_THREADS"]))


@pytest.fixture(autouse=True)
def _prepared() -> None:
    prepare()


def test_work_is_done_in_a_process_of_its_own_with_one_thread() -> None:
    ((first, threads),) = isolated(identity, (), LIMITS)
    ((second, _),) = isolated(identity, (), LIMITS)
    assert len({os.getpid(), first, second}) == 3
    assert threads == "1"


def test_what_is_told_arrives_and_what_solvers_print_does_not(capfd: pytest.CaptureFixture[str]) -> None:
    assert list(isolated(count, (3, "chat"), LIMITS)) == [0, 1, 2]
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize(
    ("then", "failure", "message"),
    [
        ("segfault", "crash", "SIGSEGV"),
        ("exit", "crash", "exit code 7"),
        ("raise", "error", "LookupError: nothing there"),
        ("eat", "memory", "0.25 GiB"),
        ("hang", "timeout", "no answer within 1 s"),
        ("hang deaf", "timeout", "no answer within 1 s"),
    ],
)
def test_what_ends_a_process_is_named_and_what_was_told_before_stands(then: str, failure: str, message: str) -> None:
    limits = Limits(1.0, LIMITS.memory) if "hang" in then else LIMITS
    work = isolated(count, (2, then), limits)
    assert [next(work), next(work)] == [0, 1]
    with pytest.raises(LostError, match=message) as lost:
        next(work)
    assert lost.value.failure == failure


def test_work_that_nobody_waits_for_is_ended() -> None:
    work = isolated(count, (1, "hang"), LIMITS)
    assert next(work) == 0
    stop()
    try:
        with pytest.raises(StoppedError):
            next(work)
    finally:
        resume()
