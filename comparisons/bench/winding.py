"""The paper's arm winding: our whole loop step and its parts beside every rival at the same problem."""

import math
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import qpsolvers
from numpy.typing import NDArray

from comparisons.bench.clock import Call, Times, rotated, timed
from comparisons.bench.neighbours import neighbours
from comparisons.bench.rivals import Daqp, DaqpHierarchy, Dgelsy, Mink, Rival, answering
from comparisons.bench.settings import BenchSettings
from comparisons.settings import MINK_SOLVERS
from prioritized_ik.errors import PrioritizedIkError
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.certificate import certify
from prioritized_ik.solvers.methods import ActiveSet
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.solvers.step import JointStep, StepStatus
from prioritized_ik.validation import Array
from prioritized_ik.winding.controller import Situation, WindingController
from prioritized_ik.winding.episode import Episode, wind
from prioritized_ik.winding.plan import plan
from prioritized_ik.winding.settings import WindingSettings

OURS = "whole step"
PARTS = ("observe", "plan", "problem", "solve and certificate", "certificate")
APART = ("plan", "certificate")  # of them, what is called once more by itself
NEAR_CUT = 10.0  # a singular value within this factor of the rank tolerance is near the cut

#: Kinds of steps that times are told of; all of them first.
ALL, HOT, CHANGED, FREE, BOUND, NEAR, FAR = (
    "all", "hot", "after a contact change", "limits inactive", "limits active", "near the rank's cut", "rank clear",
)  # fmt: skip
KINDS = (ALL, HOT, CHANGED, FREE, BOUND, NEAR, FAR)

Work = tuple[str, str, int]  # direction, weights, number of the step


class DifferentProblemError(PrioritizedIkError):
    """A rival would have been asked something else than our step."""


@dataclass
class WindingTimes:
    """What was measured on the windings.

    Attributes:
        times: of the whole step, its parts and every rival.
        works: the steps of each of `KINDS`, and of each of the weights.
        gaps: by rival, how much more level 1 costs at its answer than at ours to the same question, relative to dθ = 0.
        steps: how many of ours were timed.
        certificates: how many of them had a certificate, and how many of these hold.
        without_qp: how many called no QP solver.
        paths: by which path of the library they were made, where it tells.
    """

    times: Times = field(default_factory=Times)
    works: dict[str, set[Work]] = field(default_factory=lambda: defaultdict(set))
    gaps: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    steps: int = 0
    certificates: int = 0
    certified: int = 0
    without_qp: int = 0
    paths: Counter[str] = field(default_factory=Counter)


@dataclass(frozen=True)
class OurStep:
    """One step of our loop: what each part took [s], and what came of it."""

    observe: float
    problem: float
    solve: float
    situation: Situation
    posed: IKProblem
    step: JointStep


class Loop:
    """Our loop, from joint positions to a certified step."""

    def __init__(self, settings: WindingSettings) -> None:
        self.settings = settings
        self.controller = WindingController(settings)
        self.forget()

    def forget(self) -> None:
        """Forget the rows of the last step."""
        self._method = get_method(self.settings.solver)

    def __call__(self, q: Array, was_in_contact: NDArray[np.bool_]) -> OurStep:
        """Return the step from `q`, where the links `was_in_contact` touched the object the step before."""
        started = time.perf_counter()
        situation = self.controller.observe(q, was_in_contact)
        observed = time.perf_counter()
        problem = self.controller.problem(q, situation)
        posed = time.perf_counter()
        step = self._method.step(problem, self.settings.options)
        ended = time.perf_counter()
        return OurStep(observed - started, posed - observed, ended - posed, situation, problem, step)


def rivals_of(settings: WindingSettings) -> dict[str, Rival]:
    """Return every rival that can be asked here, by its name in the tables."""
    tolerance = settings.options.rank_tolerance
    found: dict[str, Rival] = {
        f"mink ({name})": Mink(settings, name) for name in MINK_SOLVERS if name in qpsolvers.available_solvers
    }
    found |= neighbours(settings)
    return found | {"dgelsy": Dgelsy(tolerance), "DAQP": Daqp(), "DAQP's hierarchy": DaqpHierarchy(tolerance)}


def measure_windings(settings: BenchSettings, tell: Callable[[str, int, int], object]) -> WindingTimes:
    """Return the times of all windings; `tell` hears what is done, how much of it, and of how much."""
    measured = WindingTimes()
    cases = [(direction, weights) for direction in settings.directions for weights in settings.weights]
    for number, (direction, weights) in enumerate(cases):
        tell("windings", number, len(cases))
        winding = WindingSettings(direction=direction, weights=weights, solver=ActiveSet.name)
        _measure(wind(winding), settings, measured)
    tell("windings", len(cases), len(cases))
    return measured


def stretches_of(episode: Episode, settings: BenchSettings) -> list[range]:
    """Return the steps that are timed, in stretches; the step before each warms up.

    Some are spread evenly, the others are single steps just after the contact changed.
    """
    last = max(1, episode.steps - settings.stretch)
    starts = sorted({int(start) for start in np.linspace(1, last, settings.stretches)})
    even = [range(start, min(start + settings.stretch, episode.steps)) for start in starts]
    changed = 1 + np.flatnonzero((episode.in_contact[1:-1] != episode.in_contact[:-2]).any(axis=1))
    timed = {number for stretch in even for number in stretch}
    others = [int(number) for number in changed if number not in timed]
    places = sorted({int(place) for place in np.linspace(0, len(others) - 1, settings.changes)}) if others else []
    return even + [range(others[place], others[place] + 1) for place in places]


def _measure(episode: Episode, settings: BenchSettings, measured: WindingTimes) -> None:
    rivals = rivals_of(episode.settings)
    turn = 0
    for repeat in range(settings.repeats):
        loop = Loop(episode.settings)  # anew, so that no repeat knows a kind of contact before it comes
        for stretch in stretches_of(episode, settings):
            _measure_stretch(episode, stretch, loop, rivals, measured, turn, first=repeat == 0)
            turn += 1


def _measure_stretch(
    episode: Episode,
    stretch: range,
    loop: Loop,
    rivals: dict[str, Rival],
    measured: WindingTimes,
    turn: int,
    first: bool,
) -> None:
    """Let every program go through the stretch by itself, as it would in a loop, one program after the other."""
    problems = {number: episode.problem(number) for number in stretch}
    steps: dict[int, JointStep] = {}
    answers: dict[str, dict[int, Array | None]] = {name: {} for name in rivals}

    def go_ours() -> None:
        loop.forget()
        loop(episode.q[stretch.start - 1], _was_in_contact(episode, stretch.start - 1))
        for number in stretch:
            ours = loop(episode.q[number], _was_in_contact(episode, number))
            parts = {"observe": ours.observe, "problem": ours.problem, "solve and certificate": ours.solve}
            for part, seconds in {OURS: sum(parts.values()), **parts}.items():
                measured.times.add(part, _work(episode, number), seconds)
            _count(ours.step, measured)
            steps[number] = ours.step
            if first:
                _same(ours.posed, problems[number])

    def go(name: str, ask: Callable[[int], Call]) -> None:
        ask(stretch.start)()  # warms up, as ours does
        for number in stretch:
            seconds, answer = timed(ask(number))
            measured.times.add(name, _work(episode, number), seconds)
            if name in rivals:
                answers[name][number] = answer

    def asks_of(rival: Rival) -> Callable[[int], Call]:
        return lambda number: answering(rival, rival.asked(problems[number], episode.q[number]), episode.q[number])

    programs: dict[str, Callable[[], None]] = {OURS: go_ours}
    asks = {name: asks_of(rival) for name, rival in rivals.items()} | _parts_apart(episode, problems)
    programs |= {name: partial(go, name, ask) for name, ask in asks.items()}
    for name in rotated(programs, turn):
        programs[name]()
    if first:
        for number in stretch:
            _classify(episode, number, steps[number], measured)
            for name, rival in rivals.items():
                _compare(name, rival, problems[number], episode, number, answers[name][number], steps[number], measured)


def _parts_apart(episode: Episode, problems: dict[int, IKProblem]) -> dict[str, Callable[[int], Call]]:
    """Return how to call by itself each part that is called `APART`, by the number of the step."""
    given = episode.settings
    planned = partial(plan, speed=given.speed, dt=given.dt, dead_band=given.dead_band)
    seen = (episode.directions, episode.contact_vectors, episode.in_contact)
    tolerance = given.options.rank_tolerance
    return {
        "plan": lambda number: partial(planned, *(column[number] for column in seen)),
        "certificate": lambda number: partial(certify, problems[number], episode.dtheta[number], tolerance),
    }


def _compare(
    name: str,
    rival: Rival,
    problem: IKProblem,
    episode: Episode,
    number: int,
    answer: Array | None,
    step: JointStep,
    measured: WindingTimes,
) -> None:
    """Note how far a rival's answer is from ours, to what it was asked, unless that had its levels in one."""
    asked = rival.asked(problem, episode.q[number])
    if len(asked.levels) == len(problem.levels):
        own = step if asked is problem else ActiveSet().step(asked, episode.settings.options)
        measured.gaps[name].append(gap(asked, answer, own))


def gap(asked: IKProblem, answer: Array | None, ours: JointStep) -> float:
    """Return how much more level 1 costs at `answer` than at our step, relative to dθ = 0; infinite if there is none."""
    level = asked.levels[0]
    if ours.dtheta is None or answer is None or not np.isfinite(answer).all():
        return math.inf
    most = level.cost(np.zeros(asked.joint_count)) or 1.0
    return (level.cost(answer) - level.cost(ours.dtheta)) / most


def _count(step: JointStep, measured: WindingTimes) -> None:
    measured.steps += 1
    measured.certificates += step.certificate is not None
    measured.certified += bool(step.certificate is not None and step.certificate.holds)
    measured.without_qp += step.calls == 0
    measured.paths[str(getattr(step, "path", "python"))] += 1


def _work(episode: Episode, number: int) -> Work:
    return episode.settings.direction, episode.settings.weights, number


def _classify(episode: Episode, number: int, step: JointStep, measured: WindingTimes) -> None:
    changed = (episode.in_contact[number] != _was_in_contact(episode, number)).any()
    free, tolerance = step.status is StepStatus.CLOSED_FORM, episode.settings.options.rank_tolerance
    near = any(
        (level.smallest_kept is not None and level.smallest_kept < NEAR_CUT * tolerance)
        or (level.largest_cut is not None and level.largest_cut > tolerance / NEAR_CUT)
        for level in step.levels
    )
    kinds = (ALL, CHANGED if changed else HOT, FREE if free else BOUND, NEAR if near else FAR, episode.settings.weights)
    for kind in kinds:
        measured.works[kind].add(_work(episode, number))


def _was_in_contact(episode: Episode, number: int) -> NDArray[np.bool_]:
    return episode.in_contact[number - 1] if number else np.zeros_like(episode.in_contact[0])


def _same(ours: IKProblem, recorded: IKProblem) -> None:
    """Make sure that what our loop poses is what the rivals are asked.

    Raises:
        DifferentProblemError: it is not.
    """
    pairs = [(ours.rows.matrix, recorded.rows.matrix), (ours.rows.upper, recorded.rows.upper)]
    pairs += [(ours.bounds.lower, recorded.bounds.lower), (ours.bounds.upper, recorded.bounds.upper)]
    for one, other in zip(ours.levels, recorded.levels, strict=True):
        pairs += [(one.matrix, other.matrix), (one.target, other.target), (one.weights, other.weights)]
    if not all(np.array_equal(one, other) for one, other in pairs):
        raise DifferentProblemError("our loop poses another problem than was recorded: rivals would be asked another one.")
