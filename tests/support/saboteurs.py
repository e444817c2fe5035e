"""Backends that crash, hang, lie, return NaN or eat memory, some only now and then."""

import os
import signal
import time
import zlib
from functools import partial

import numpy as np

from prioritized_ik.solvers import registry
from prioritized_ik.solvers.backends.protocol import StageResult
from prioritized_ik.solvers.backends.qpsolvers_ import QpsolversBackend
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.solvers.lexicographic import Clock, fold
from prioritized_ik.solvers.methods import Guessing, Lexicographic
from prioritized_ik.solvers.stages import Stage

OFF = 1e-5  # [rad] of the last joint
ONE_IN = 100

EATEN: list[np.ndarray] = []


def crash(stage: Stage) -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def crash_sometimes(stage: Stage) -> None:
    if stage.place == 0 and zlib.crc32(stage.problem.q.tobytes()) % 4 == 0:
        crash(stage)


def hang(stage: Stage) -> None:
    if stage.place == 0 and zlib.crc32(stage.problem.q.tobytes()) % 4 == 0:
        time.sleep(3600)


def eat(stage: Stage) -> None:
    while True:
        EATEN.append(np.ones(2**21))


def fault(stage: Stage) -> None:
    raise KeyError("forgotten")


def nan(stage: Stage) -> StageResult:
    return StageResult(np.full(stage.size, np.nan))


def silent(stage: Stage) -> StageResult:
    return StageResult(None, "no idea")


def shapeless(stage: Stage) -> StageResult:
    return StageResult(np.zeros(stage.size + 1))


def off(stage: Stage, honest: QpsolversBackend) -> StageResult:
    """The last stage off by a hundred thousandth of the step."""
    answer = honest.solve(stage)
    if stage.costed < stage.size or answer.x is None:
        return answer
    wrong = 1e-5 * np.linalg.norm(stage.dtheta(answer.x)) / np.linalg.norm(stage.basis[:, 0])
    return StageResult(answer.x + wrong * np.eye(stage.size)[0])


HABITS = {
    "crash": crash, "crash-sometimes": crash_sometimes, "hang": hang, "eat": eat, "fault": fault, "nan": nan,
    "silent": silent, "shapeless": shapeless, "off": off,
}  # fmt: skip


class Saboteur:
    """A backend that answers as its habit makes it, or, where that says nothing, as DAQP does."""

    version = "0"

    def __init__(self, name: str, accuracy: float) -> None:
        self.name = name
        self._habit = HABITS[name]
        self._honest = QpsolversBackend("daqp", accuracy)

    def solve(self, stage: Stage) -> StageResult:
        if self._habit is off:
            return off(stage, self._honest)
        return self._habit(stage) or self._honest.solve(stage)

    solve_once = solve


class Grave:
    """Answers as DAQP does, and crashes once nobody needs it any more, as a library with a broken destructor would."""

    version = "0"

    def __init__(self, name: str, accuracy: float) -> None:
        self.name = name
        self._honest = QpsolversBackend("daqp", accuracy)
        self._used = False

    def solve(self, stage: Stage) -> StageResult:
        self._used = True
        return self._honest.solve(stage)

    solve_once = solve

    def __del__(self) -> None:
        if self._used:
            os.kill(os.getpid(), signal.SIGSEGV)


class Wrong(Guessing):
    """A method whose guess is off in the last joint on one step in a hundred, from number `first` on."""

    version = "0"
    calls = 0  # of all there are: a cold start makes a new one for each problem

    def __init__(self, name: str, first: int, accuracy: float) -> None:
        self.name = name
        self._first = first
        self._honest = QpsolversBackend("daqp", accuracy)

    def guess(self, hierarchy: Hierarchy, clock: Clock) -> np.ndarray | str:
        Wrong.calls += 1
        u = np.array(fold(self._honest, hierarchy, clock))
        if (Wrong.calls - 1) % ONE_IN == self._first:
            u[-1] += OFF
        return u


def made(kind: type, name: str, accuracy: float) -> Lexicographic:
    return Lexicographic(kind(name, accuracy))


def register_all() -> None:
    for habit in HABITS:
        registry.register(habit, partial(made, Saboteur, habit))
    registry.register("grave", partial(made, Grave, "grave"))
    registry.register("wrong", partial(Wrong, "wrong", ONE_IN // 2))
