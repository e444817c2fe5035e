"""Isolated work is told as it is done, and whatever ends its process is named."""

import ctypes
import os
import signal
import struct
import time
from collections.abc import Callable, Sequence
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
import pytest

from comparisons.isolation import (
    IN_A_ROW,
    Limits,
    LostError,
    StoppedError,
    isolated,
    isolated_each,
    prepare,
    resume,
    stop,
)

LIMITS = Limits(seconds=20.0, memory=2**28)
Tell = Callable[..., None]


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
        case "half a message":
            connection = next(cell.cell_contents for cell in tell.__closure__ if isinstance(cell.cell_contents, Connection))
            os.write(connection.fileno(), struct.pack("!i", 1000) + b"half")
            os._exit(7)
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
        ("half a message", "crash", "exit code 7"),
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


def spell(tell: Tell, letters: str, then: str) -> None:
    tell({"about": {"letters": "known"}})
    for letter in letters:
        if letter.isupper():
            os._exit(7)
        tell({"letter": letter})
    count(tell, 0, then)


@pytest.mark.parametrize("then", ["segfault", "hang", "raise"])
def test_a_process_that_is_lost_after_its_last_record_is_of_no_account(then: str) -> None:
    assert spelt("abc", then) == ({"letters": "known"}, ["a", "b", "c"])


def test_an_item_that_costs_a_process_fails_alone_until_several_in_a_row_do() -> None:
    assert spelt("aBcDEf") == ({"letters": "known"}, ["a", "crash", "c", "crash", "crash", "f"])
    assert spelt("a" + "B" * (IN_A_ROW - 1) + "c")[1] == ["a", *["crash"] * (IN_A_ROW - 1), "c"]
    assert spelt("a" + "B" * IN_A_ROW + "cde")[1] == ["a", *["crash"] * IN_A_ROW, *["not tried"] * 3]
    assert spelt("") == ({}, [])


def spelt(letters: str, then: str = "") -> tuple[dict[str, Any], list[str]]:
    def arguments(rest: Sequence[str]) -> tuple[Any, ...]:
        return "".join(rest), then

    def failed(letter: str, failure: str, message: str) -> dict[str, Any]:
        return {"letter": "not tried" if "not tried" in message else failure}

    about, records = isolated_each(spell, letters, arguments, failed, LIMITS)
    return about, [record["letter"] for record in records]


def book_keeping(tell: Tell, *, ours: bool) -> None:
    tell(None, ours=ours)
    time.sleep(1.0)
    tell("done")


def test_the_time_limit_is_not_that_of_our_own_work() -> None:
    limits = Limits(0.3, LIMITS.memory)
    assert list(isolated(partial(book_keeping, ours=True), (), limits)) == ["done"]
    with pytest.raises(LostError, match=r"no answer within 0\.3 s"):
        list(isolated(partial(book_keeping, ours=False), (), limits))


def test_work_that_nobody_waits_for_is_ended() -> None:
    work = isolated(count, (1, "hang"), LIMITS)
    assert next(work) == 0
    stop()
    try:
        with pytest.raises(StoppedError):
            next(work)
    finally:
        resume()
