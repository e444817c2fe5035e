"""Times of several programs at the same work. They take turns, so that a slow moment hits all alike."""

import time
from collections import defaultdict
from collections.abc import Callable, Collection, Hashable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from prioritized_ik.validation import Array

Call = Callable[[], Any]


def timed(call: Call) -> tuple[float, Any]:
    """Return what a call took [s] and returned."""
    started = time.perf_counter()
    answer = call()
    return time.perf_counter() - started, answer


def rotated(names: Iterable[str], turn: int) -> list[str]:
    """Return names in the order of their turns: which is the first depends on `turn`."""
    known = list(names)
    first = turn % len(known)
    return known[first:] + known[:first]


@dataclass
class Times:
    """The times [s] of every program at every piece of work, all repeats."""

    seconds: dict[str, dict[Hashable, list[float]]] = field(default_factory=lambda: defaultdict(lambda: defaultdict(list)))

    def add(self, program: str, work: Hashable, seconds: float) -> None:
        """Add one more time of `program` at `work`."""
        self.seconds[program][work].append(seconds)

    def of(self, program: str, works: Collection[Hashable] | None = None) -> Array:
        """Return one time a piece of work [s], the median over its repeats; only of `works` if given."""
        found = self.seconds.get(program, {})
        return np.array([np.median(times) for work, times in found.items() if works is None or work in works])


def quantile(times: Array, share: float) -> float | None:
    """Return the quantile of times, None if there is none."""
    return float(np.quantile(times, share)) if len(times) else None


def ratio(one: float | None, other: float | None) -> float | None:
    """Return one / other, None where there is no such thing."""
    return None if one is None or not other else one / other
