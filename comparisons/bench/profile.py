"""Where our step's time goes, function by function, beside the floor: what no loop like it can do without."""

import cProfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import CodeType

import mujoco
import numpy as np

from comparisons.bench.clock import rotated, timed
from comparisons.bench.rivals import Dgelsy
from comparisons.bench.settings import BenchSettings
from comparisons.bench.winding import Loop
from prioritized_ik.solvers.methods import ActiveSet
from prioritized_ik.winding.episode import wind
from prioritized_ik.winding.settings import WindingSettings

SHOWN = 20  # functions


@dataclass(frozen=True)
class Function:
    """One function's share: its name, calls a step, and time a step [s] by itself and with all that it calls."""

    name: str
    calls: float
    own: float
    total: float


@dataclass(frozen=True)
class Profile:
    """The functions that take most, and the floor's parts, each the median [s]."""

    functions: list[Function]
    floor: dict[str, float]


def measure_profile(settings: BenchSettings) -> Profile:
    """Return the profile of a winding: up, Eq. 23."""
    winding = WindingSettings(solver=ActiveSet.name, max_steps=settings.profiled + 1)
    episode = wind(winding)
    loop = Loop(winding)
    profiler = cProfile.Profile()
    numbers = range(1, episode.steps)
    for number in numbers:
        profiler.enable()
        loop(episode.q[number], episode.in_contact[number - 1])
        profiler.disable()
    functions = [
        Function(_name(entry.code), *(x / len(numbers) for x in (entry.callcount, entry.inlinetime, entry.totaltime)))
        for entry in profiler.getstats()
    ]
    functions.sort(key=lambda function: -function.own)
    return Profile(functions[:SHOWN], _floor(loop, winding, settings.profiled))


def _name(code: CodeType | str) -> str:
    return code if isinstance(code, str) else f"{Path(code.co_filename).stem}.{code.co_qualname}"


def _floor(loop: Loop, winding: WindingSettings, repeats: int) -> dict[str, float]:
    model, data = loop.controller.model, loop.controller.data
    q = winding.initial_posture()
    posed = loop.controller.problem(q, loop.controller.observe(q, np.zeros(winding.arm.links, dtype=bool)))
    rival = Dgelsy(winding.options.rank_tolerance)
    points = np.ones((len(posed.levels[0].target), 6))

    def kinematics() -> None:
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)

    calls: dict[str, Callable[[], object]] = {
        "kinematics": kinematics,
        "one collision pass": lambda: mujoco.mj_collision(model, data),
        "one product for J": lambda: points @ data.cdof.T,
        "one dgelsy": rival.ask(rival.asked(posed, q), q),
    }
    times: dict[str, list[float]] = {name: [] for name in calls}
    for turn in range(max(repeats, 20)):
        for name in rotated(calls, turn):
            times[name].append(timed(calls[name])[0])
    return {name: float(np.median(column)) for name, column in times.items()}
