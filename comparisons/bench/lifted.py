"""Sparse QP solvers in the lifted form beside each other, on steps of windings of arms of several lengths."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from comparisons.bench.settings import BenchSettings
from prioritized_ik.models import Arm
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.backends.registry import installed_sparse
from prioritized_ik.solvers.backends.sparse import SparseBackend
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.lifted.method import Lifted
from prioritized_ik.solvers.methods import ActiveSet
from prioritized_ik.solvers.solve import step_of
from prioritized_ik.solvers.step import JointStep
from prioritized_ik.validation import Array
from prioritized_ik.winding.controller import WindingController
from prioritized_ik.winding.loop import moments
from prioritized_ik.winding.settings import WindingSettings, in_proportion

PAPERS = 17  # links up to which the arm is the paper's and winds as it does
LENGTH = 1.02  # [m] of longer ones
PATIENCE = 60.0  # [s] a solver that has taken longer is not asked for further steps


@dataclass
class LiftedTimes:
    """What a solver made of some steps.

    Attributes:
        links: of the arm.
        steps: how many it was asked for.
        answered: of them, how many guesses are an answer.
        certified: of them, how many steps ended certified.
        guess, step: median time [s], from the posed problem to the solver's own answer and to the certified step.
        gap: median over its answers, how much more they cost in level 1 than the certified step, relative to not moving.
        worst: the largest of these.
        message: of its first failure; empty for none.
    """

    links: int
    steps: int
    answered: int
    certified: int
    guess: float
    step: float
    gap: float | None
    worst: float | None
    message: str


def measure_lifted(settings: BenchSettings, tell: Callable[[str, int, int], object]) -> dict[str, list[LiftedTimes]]:
    """Return what each solver makes of steps of arms of `settings.lifted` links."""
    found: dict[str, list[LiftedTimes]] = {name: [] for name in installed_sparse()}
    for number, links in enumerate(settings.lifted):
        tell("lifted", number, len(settings.lifted))
        steps = winding_steps(links, settings.lifted_steps)
        options = replace(winding(links).options, closed_form_first=False)  # every step goes through the solver
        for name, measured in found.items():
            measured.append(_measured(name, links, steps, options))
    tell("lifted", len(settings.lifted), len(settings.lifted))
    return found


def winding_steps(links: int, count: int) -> list[tuple[IKProblem, Array]]:
    """Return problems on the tree of a winding, evenly spaced, and their certified steps."""
    settings = winding(links)
    every = 8 if links <= PAPERS else 2
    taken: list[tuple[IKProblem, Array]] = []
    for number, moment in enumerate(moments(WindingController(settings), ActiveSet(), settings.initial_posture())):
        step, problem = moment.step, moment.problem
        if number % every == 0 and problem is not None and step is not None and step.dtheta is not None:
            taken.append((problem, step.dtheta))
        if len(taken) == count:
            break
    return taken


def winding(links: int) -> WindingSettings:
    """Return the paper's winding of short arms, and that of long ones around a thin post, see `docs/winding.md`."""
    if links <= PAPERS:
        return WindingSettings(
            arm=Arm(links=links), link=max(1, links // 3), options=SolveOptions(kinematics="tree", rank_tolerance=1e-4)
        )
    length = LENGTH / links
    touch: dict[str, Any] = dict(in_proportion(length))
    return WindingSettings(
        arm=Arm(links=links, link_length=length, radius=0.004), link=links // 3, size=(0.03, 0.5), tilt=0.2,
        posture="random", weights="trailing", options=SolveOptions(kinematics="tree"), **touch,
    )  # fmt: skip


def _measured(name: str, links: int, steps: list[tuple[IKProblem, Array]], options: SolveOptions) -> LiftedTimes:
    method = Lifted(SparseBackend(name, 1e-8))
    guesses: list[float] = []
    whole: list[float] = []
    gaps: list[float] = []
    certified, message = 0, ""
    for problem, expected in steps:
        if sum(guesses) + sum(whole) > PATIENCE:
            break
        started = time.perf_counter()
        guess = method.guess(problem)
        middle = time.perf_counter()
        step = step_of(method, problem, options)
        guesses.append(middle - started)
        whole.append(time.perf_counter() - middle)
        certified += _holds(step)
        if isinstance(guess, str):
            message = message or guess
        else:
            gaps.append(_gap(problem, guess, expected))
    return LiftedTimes(
        links, len(guesses), len(gaps), certified, float(np.median(guesses)), float(np.median(whole)),
        float(np.median(gaps)) if gaps else None, float(max(gaps, key=abs)) if gaps else None, message,
    )  # fmt: skip


def _holds(step: JointStep) -> bool:
    return bool(step.certificate is not None and step.certificate.holds)


def _gap(problem: IKProblem, guess: Array, expected: Array) -> float:
    level = problem.levels[0]
    most = level.cost(np.zeros(problem.joint_count)) or 1.0
    return (level.cost(guess) - level.cost(expected)) / most
