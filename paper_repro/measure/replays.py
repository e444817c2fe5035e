"""Recorded winding problems, solved anew in one formulation by one solver, as jobs; and their figures over many steps.

The problems are those of `prioritized-ik compare`: every direction's winding is recorded once a process, and up to a number
of its steps taken, evenly spaced, half of them *free* (no row binds at Eqs. 12-14) as far as there are so many. The truth
is Eqs. 12-14 on a free step, and on the others the certified step that the arm took when it was recorded.

Every formulation gets J cut to the rank that all share, so that what differs is the formulation and not the rank; but for
mink, which builds its own.
"""

import functools
import os
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import qpsolvers

from comparisons.cases import windings_of
from comparisons.judging import judge
from comparisons.methods import MINK as MINK_FAMILY
from comparisons.sample import Sampled, sample
from comparisons.settings import ONE_QP, RECORDER, ComparisonSettings
from paper_repro.make.artefact import Scale
from paper_repro.make.jobs import Job, Results
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.backends.registry import get_backend, installed_solvers
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.methods import Damped, Method, Place
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.solvers.step import JointStep, StepStatus
from prioritized_ik.validation import Array
from prioritized_ik.winding.episode import Episode, wind
from prioritized_ik.winding.settings import WindingSettings


@dataclass(frozen=True)
class Formulation:
    """How the problem is handed to a solver.

    Attributes:
        name: `lexicographic`, `damped`, `slack`, or `mink` for a call of `mink.solve_ik`.
        damping: δ of the middle two.
        accurate: of a damped one, whether the solver gets the accuracy, the refinement and the second attempt that it gets
            in the lexicographic stages, in place of its default options.
    """

    name: str
    damping: float = 0.0
    accurate: bool = False

    @property
    def title(self) -> str:
        """What tables call it."""
        if self.name == "damped" and not self.damping:
            return "raw"
        words = [self.name, *([f"{self.damping:.0e}"] if self.damping else []), *(["accurate"] if self.accurate else [])]
        return " ".join(words)


#: From a problem, and the joint positions where it was posed, to a step.
Solve = Callable[[IKProblem, Array], JointStep]

BEGINNING = 40  # steps of a winding that the reduced run records

LEXICOGRAPHIC = Formulation("lexicographic")
MINK = Formulation(MINK_FAMILY)
DAMPED = Formulation("damped", 1e-12)  # mink's and pink's default

#: Everything that is compared, in the order of the tables.
FORMULATIONS = (
    LEXICOGRAPHIC,
    Formulation("slack", 1e-12),
    Formulation("slack", 1e-8),
    Formulation("damped", 0.0),
    DAMPED,
    Formulation("damped", 1e-12, accurate=True),
    *(Formulation("damped", damping) for damping in (1e-10, 1e-8, 1e-6, 1e-4, 1e-2)),
    MINK,
)


def solvers(scale: Scale) -> tuple[str, ...]:
    """Return the backends to compare."""
    return scale.solvers or tuple(installed_solvers())


def formulations(solver: str) -> tuple[Formulation, ...]:
    """Return the formulations that a backend is given: native ones only that for which they are kept warm.

    On an accurate damped QP HiGHS cycles until its time limit, so that the answer would depend on the machine.
    """
    if solver not in qpsolvers.available_solvers:
        return (LEXICOGRAPHIC,)
    return tuple(one for one in FORMULATIONS if not (one.accurate and solver == "highs"))


def steps_of(scale: Scale, solver: str, formulation: Formulation) -> int:
    """Return how many steps of each direction are replayed."""
    if formulation == LEXICOGRAPHIC:
        return scale.steps
    # SCS takes a second for every step of mink's, whose rows without a side it does not bear, to find nothing.
    share = 20 if (solver, formulation) == ("scs", MINK) else 2
    return max(1, scale.steps // share)


def replayed_job(scale: Scale, solver: str, formulation: Formulation) -> Job:
    """Return the job of one backend and formulation: see `replayed`."""
    given = {"solver": solver, "name": formulation.name, "damping": formulation.damping, "accurate": formulation.accurate}
    return Job(replayed, {**given, "windings": list(windings(scale)), "steps": steps_of(scale, solver, formulation)})


def replayed(
    solver: str, name: str, damping: float, accurate: bool, windings: list[str], steps: int
) -> list[dict[str, Any]]:
    """Return the figures of each sampled step: see `figures_of`."""
    formulation = Formulation(name, damping, accurate)
    figures = []
    for winding in windings:
        posed_problems = sampled(winding, steps)
        with silent():
            solve = solver_of(solver, formulation, winding)
            for posed in posed_problems:
                problem = posed.cut_problem if formulation.name in ONE_QP else posed.item.problem
                figures.append(figures_of(posed, solve(problem, posed.item.q)))
    return figures


@dataclass(frozen=True)
class Posed:
    """A recorded problem and its answer.

    Attributes:
        item: the problem, and what the closed form says of it.
        taken: the step that the arm took `(m,)`; None if it was not certified.
    """

    item: Sampled
    taken: Array | None

    @property
    def true(self) -> Array | None:
        """The optimum dθ `(m,)`, as far as it is known: Eqs. 12-14 where no row binds, else the step that was taken."""
        return self.item.dtheta if self.item.free else self.taken

    @property
    def cut_problem(self) -> IKProblem:
        """The problem with J cut to the rank that all solvers share."""
        problem = self.item.problem
        return IKProblem([self.item.level], problem.bounds, problem.rows, problem.reference, problem.equalities)


@functools.cache
def windings(scale: Scale, weights: str = "eq23") -> tuple[str, ...]:
    """Return the settings, as JSON, of the windings that are recorded: one a direction, every step of it by the QP."""
    posed = windings_of(ComparisonSettings(solvers=(RECORDER,), directions=scale.directions))
    changes: dict[str, Any] = {"weights": weights, **({"max_steps": BEGINNING} if scale.quick else {})}
    return tuple(replace(winding, **changes).to_json() for winding in posed.values())


@functools.cache
def recorded(winding: str) -> Episode:
    """Return the winding of some settings, as JSON."""
    return wind(WindingSettings.from_json(winding))


@functools.cache
def sampled(winding: str, steps: int) -> tuple[Posed, ...]:
    """Return up to `steps` problems of a recorded winding."""
    episode = recorded(winding)
    certified = episode.status == StepStatus.SOLVED.name
    items = sample(episode, steps, RANK_TOLERANCE)
    return tuple(Posed(item, episode.dtheta[item.step] if certified[item.step] else None) for item in items)


def solver_of(solver: str, formulation: Formulation, winding: str) -> Solve:
    """Return what solves the problems of a recorded winding."""
    damping = formulation.damping if formulation.name in ONE_QP else None
    options = SolveOptions(rank_tolerance=RANK_TOLERANCE, damping=damping, closed_form_first=False)
    method: Method
    if formulation.accurate:
        method = Damped(get_backend(solver), accurate=True)
    else:
        method = get_method(f"{formulation.name}:{solver}")
    settings = recorded(winding).settings
    return lambda problem, q: method.step(problem, options, Place(q, settings))


@contextmanager
def silent() -> Iterator[None]:
    """Let nothing be printed, by C libraries neither, and no warning be shown: a step's figures tell how good it is.

    PIQP and SCS write to the process's standard error, of rows without a side and of what they could not solve.
    """
    kept = [os.dup(stream) for stream in (1, 2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for stream in (1, 2):
            os.dup2(nowhere, stream)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for stream, copy in zip((1, 2), kept, strict=True):
            os.dup2(copy, stream)
            os.close(copy)
        os.close(nowhere)


def figures_of(posed: Posed, step: JointStep) -> dict[str, Any]:
    """Return the figures of one step.

    `free`, `found`, `status`; relative to the truth `dtheta_error` and `dx_error`; `cost_gap`, the level's cost above the
    truth's, over the cost of not moving; `violation`, relative to the step; `certified`; `own_guess`, whether the solver's
    answer led to that; and `same_bits`, whether a certified step is the recorded one to the last bit. None where there is
    no accepted step. All but the last three are of
    the solver's own answer, before it is polished.
    """
    judged, level = judge(posed.item, step), posed.item.level
    figures = {key: judged[key] for key in ("free", "found", "status", "violation", "certified", "own_guess")}
    figures |= dict.fromkeys(("dtheta_error", "dx_error", "cost_gap", "same_bits"))
    if judged["dtheta"] is not None and posed.true is not None:
        own, true = np.array(judged["dtheta"]), posed.true
        figures["dtheta_error"] = relative(own, true)
        figures["dx_error"] = relative(level.matrix @ own, level.matrix @ true)
        figures["cost_gap"] = (judged["cost"] - level.cost(true)) / judged["cost_at_zero"]
    if judged["certified"] and posed.taken is not None:
        figures["same_bits"] = judged["certified_dtheta"] == posed.taken.tolist()
    return figures


def relative(value: Array, reference: Array) -> float:
    """Return ‖value - reference‖ / ‖reference‖."""
    return float(np.linalg.norm(value - reference) / np.linalg.norm(reference))


@dataclass(frozen=True)
class Summary:
    """Figures of many steps; None where no step has one.

    Attributes:
        steps: how many.
        free_steps: on how many no row binds.
        failed: steps without an accepted answer.
        dtheta_median, dtheta_max: relative error of dθ on free steps.
        dx_median, dx_max: of dX on free steps.
        bound_median, bound_max: relative error of dθ on the other steps.
        cost_gap_max: largest relative excess of the level's cost.
        violation_max: worst violation of a row, of steps that were refused for it too, relative to the step.
        certified: fraction of the steps that are proven optimal.
        own_guess: fraction of the certified steps that the solver's own answer led to.
        same_bits: fraction of the certified steps that are the recorded ones to the last bit.
    """

    steps: int
    free_steps: int
    failed: int
    dtheta_median: float | None
    dtheta_max: float | None
    dx_median: float | None
    dx_max: float | None
    bound_median: float | None
    bound_max: float | None
    cost_gap_max: float | None
    violation_max: float | None
    certified: float
    own_guess: float | None
    same_bits: float | None

    @staticmethod
    def of(figures: list[dict[str, Any]]) -> "Summary":
        """Return the summary of what `replayed` returned."""
        free = [figure for figure in figures if figure["free"]]
        bound = [figure for figure in figures if not figure["free"]]
        same_bits = known(figures, "same_bits")
        guesses = [figure["own_guess"] for figure in figures if figure["certified"]]
        return Summary(
            steps=len(figures),
            free_steps=len(free),
            failed=sum(not figure["found"] for figure in figures),
            dtheta_median=median(known(free, "dtheta_error")),
            dtheta_max=max(known(free, "dtheta_error"), default=None),
            dx_median=median(known(free, "dx_error")),
            dx_max=max(known(free, "dx_error"), default=None),
            bound_median=median(known(bound, "dtheta_error")),
            bound_max=max(known(bound, "dtheta_error"), default=None),
            cost_gap_max=max(known(figures, "cost_gap"), default=None),
            violation_max=max(known(figures, "violation"), default=None),
            certified=sum(figure["certified"] for figure in figures) / len(figures),
            own_guess=sum(guesses) / len(guesses) if guesses else None,
            same_bits=sum(same_bits) / len(same_bits) if same_bits else None,
        )


def summary(scale: Scale, results: Results, solver: str, formulation: Formulation) -> Summary:
    """Return the summary of one backend and formulation."""
    return Summary.of(results[replayed_job(scale, solver, formulation)])


def known(figures: list[dict[str, Any]], name: str) -> list[float]:
    """Return the values of a figure, of the steps that have it."""
    return [figure[name] for figure in figures if figure[name] is not None]


def median(values: list[float]) -> float | None:
    """Return the median, None of nothing."""
    return float(np.median(values)) if values else None
