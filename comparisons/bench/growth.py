"""How a step's time grows with the arm's links."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from comparisons.bench.rivals import Dgelsy, Mink, Rival, answering
from comparisons.bench.settings import BenchSettings
from comparisons.bench.winding import OURS, Loop
from prioritized_ik.models import Arm
from prioritized_ik.solvers.methods import ActiveSet
from prioritized_ik.winding.settings import WindingSettings

REPEATS = 5
PATIENCE = 8.0  # [s] a program that takes longer for one step is not asked for longer arms


@dataclass
class Growth:
    """Times by links.

    Attributes:
        joints: by links.
        seconds: by program and links, the median [s].
        left_out: by program, why there is nothing beyond some number of links.
    """

    joints: dict[int, int] = field(default_factory=dict)
    seconds: dict[str, dict[int, float]] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)


def measure_growth(settings: BenchSettings, tell: Callable[[str, int, int], object]) -> Growth:
    """Return the times of the first step of arms of `settings.links` links, Eq. 23."""
    growth = Growth()
    for number, links in enumerate(settings.links):
        tell("growth", number, len(settings.links))
        _measure(links, settings, growth)
    tell("growth", len(settings.links), len(settings.links))
    return growth


def _measure(links: int, settings: BenchSettings, growth: Growth) -> None:
    winding = WindingSettings(arm=Arm(links=links), link=max(1, links // 3), posture="random", solver=ActiveSet.name)
    loop, q = Loop(winding), winding.initial_posture()
    growth.joints[links] = len(q)
    untouched = np.zeros(links, dtype=bool)
    posed = loop.controller.problem(q, loop.controller.observe(q, untouched))
    makers: dict[str, Callable[[], Rival]] = {
        "dgelsy": lambda: Dgelsy(winding.options.rank_tolerance),
        "mink (daqp)": lambda: Mink(winding, "daqp"),
    }
    calls: dict[str, Callable[[], object]] = {OURS: lambda: loop(q, untouched)}
    for name, make in makers.items():
        if links > settings.largest_rival and name != "dgelsy":
            growth.left_out.setdefault(name, f"not asked beyond {settings.largest_rival} links")
        elif name not in growth.left_out:
            rival = make()
            calls[name] = answering(rival, rival.asked(posed, q), q)
    for name, call in calls.items():
        if name not in growth.left_out:
            growth.seconds.setdefault(name, {})[links] = _median(call)
            if growth.seconds[name][links] > PATIENCE:
                growth.left_out[name] = f"not asked beyond {links} links, where a step takes {PATIENCE:g} s and more"


def _median(call: Callable[[], object]) -> float:
    """Return the median time of some calls, after one for warming up; of a single one that takes long."""
    times: list[float] = []
    while len(times) < REPEATS + 1 and sum(times) < PATIENCE:
        started = time.perf_counter()
        call()
        times.append(time.perf_counter() - started)
    return float(np.median(times[1:] or times))
