"""Table 7: what a step takes, by backend, on stretches of the recorded windings."""

import time
from typing import Any

import numpy as np

from comparisons.origin import cpu_model
from comparisons.settings import MINK_SOLVERS
from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.jobs import Job, Results
from paper_repro.make.table import Cell, Column, Table
from paper_repro.measure.replays import (
    DAMPED,
    LEXICOGRAPHIC,
    MINK,
    Formulation,
    Solve,
    recorded,
    silent,
    solver_of,
    solvers,
    windings,
)
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.backends.abilities import abilities_of
from prioritized_ik.solvers.hierarchy import strict_solution
from prioritized_ik.solvers.step import JointStep, StepStatus, Timings
from prioritized_ik.validation import Array

REPEATS, QUICK_REPEATS = 3, 1  # of everything, one after the other, so that a slow minute does not hit one backend alone
STRETCH = 0.4  # of the sampled steps, which is what 90 s allow

PARTS = ("build", "solve", "polish")  # of `Timings`
COLD, WARM = "cold", "warm"
CLOSED_FORM = Formulation("closed form")

#: What is timed: a formulation, a backend and how it starts; empty where there is no such thing.
Contender = tuple[Formulation, str, str]


def contenders(names: tuple[str, ...]) -> list[Contender]:
    """Return everything that is timed, in the order of the table."""
    found: list[Contender] = [(CLOSED_FORM, "", "")]
    found += [(LEXICOGRAPHIC, name, COLD) for name in names]
    found += [(LEXICOGRAPHIC, name, WARM) for name in names if abilities_of(name).native]
    found += [(DAMPED, name, COLD) for name in names if name in MINK_SOLVERS]
    found += [(MINK, name, "") for name in names if name in MINK_SOLVERS]
    return found


def timed_jobs(scale: Scale) -> list[Job]:
    """Return one job a repeat: see `timed`."""
    given = {"windings": list(windings(scale)), "steps": stretch(scale), "names": list(solvers(scale))}
    repeats = QUICK_REPEATS if scale.quick else REPEATS
    return [Job(timed, {**given, "repeat": repeat}, alone=True) for repeat in range(repeats)]


def stretch(scale: Scale) -> int:
    """Return how many steps in succession are timed of each direction."""
    return max(2, round(STRETCH * scale.steps))


def timed(windings: list[str], steps: int, names: list[str], repeat: int) -> dict[str, Any]:
    """Return the `cpu`, and of each contender each step's `build`, `solve` and `polish` [s], and how many steps `failed`.

    Args:
        windings: settings of those that are recorded, as JSON.
        steps: in succession, from the middle of each.
        names: backends.
        repeat: which repeat it is; the same is done in each.
    """
    del repeat
    with silent():
        return {
            "cpu": cpu_model(),
            "rows": [_times(contender, windings, steps) for contender in contenders(tuple(names))],
        }


def _times(contender: Contender, windings: list[str], steps: int) -> dict[str, Any]:
    times: dict[str, list[float]] = {name: [] for name in PARTS}
    failed = 0
    for winding in windings:
        episode, solve = recorded(winding), None
        first = (episode.steps - steps) // 2
        for number in range(first - 1, first + steps):
            if solve is None or contender[2] == COLD:
                solve = _solve_of(contender, winding)
            # A fresh problem, as a controller makes one each step: it remembers nothing of an earlier solve.
            step = solve(episode.problem(number), episode.q[number])
            if number >= first:  # the one before loads libraries, and warms what starts warm
                failed += not step.found
                for name, values in times.items():
                    values.append(getattr(step.timings, name))
    return {**times, "failed": failed}


def _solve_of(contender: Contender, winding: str) -> Solve:
    formulation, solver, _ = contender
    return _closed_form if formulation == CLOSED_FORM else solver_of(solver, formulation, winding)


def _closed_form(problem: IKProblem, q: Array) -> JointStep:
    """Return Eqs. 12-14, timed."""
    del q
    started = time.perf_counter()
    dtheta = strict_solution(problem.levels, problem.reference)
    timings = Timings(build=0.0, solve=time.perf_counter() - started)
    return JointStep(dtheta, StepStatus.CLOSED_FORM, timings=timings)


COLUMNS = (
    Column("formulation", "formulation"),
    Column("backend", "backend"),
    Column("start", "start"),
    Column("assembly_p50_ms", "assembly p50 [ms]", ".2f"),
    Column("solve_p50_ms", "solve p50 [ms]", ".2f"),
    Column("polish_p50_ms", "polish, certificate p50 [ms]", ".2f"),
    Column("total_p50_ms", "total p50 [ms]", ".2f"),
    Column("total_p95_ms", "p95 [ms]", ".2f"),
    Column("total_p99_ms", "p99 [ms]", ".2f"),
    Column("total_max_ms", "max [ms]", ".2f"),
    Column("failed", "failed"),
)

#: Where a part cannot be told apart, or there is none.
PARTS_UNKNOWN = {CLOSED_FORM.name: ("build", "polish"), MINK.name: ("build", "polish"), DAMPED.name: ("polish",)}


def build(scale: Scale, results: Results) -> Table:
    """Return one row a contender: of each step the median of the repeats, then quantiles over the steps."""
    repeats = [results[job] for job in timed_jobs(scale)]
    rows: list[tuple[Cell, ...]] = []
    for place, (formulation, solver, start) in enumerate(contenders(solvers(scale))):
        found = [repeat["rows"][place] for repeat in repeats]
        without = PARTS_UNKNOWN.get(formulation.name, ())
        every = {name: 1e3 * np.array([row[name] for row in found]) for name in PARTS if name not in without}
        parts = {name: np.median(times, axis=0) for name, times in every.items()}
        total = np.median(np.sum(list(every.values()), axis=0), axis=0)
        medians = (float(np.median(parts[name])) if name in parts else None for name in PARTS)
        quantiles = (float(np.quantile(total, share)) for share in (0.5, 0.95, 0.99, 1.0))
        failed = f"{max(row['failed'] for row in found)}/{len(total)}"
        rows.append((formulation.title, solver or None, start or None, *medians, *quantiles, failed))
    notes = (
        f"{repeats[-1]['cpu']}, one process, one BLAS thread, shared with whatever else ran there. {stretch(scale)} "
        f"successive steps from the middle of each of {len(scale.directions)} windings; repeats: {len(repeats)}."
    )
    return Table(COLUMNS, tuple(rows), notes)


CAPTION = """\
Wall-clock time of one joint step of the 49-joint arm, limits and contact rows included, on stretches of successive
steps of the recorded windings; the closed form is not tried first, so that every backend has to solve. *Assembly*:
decompositions, changes of variables and stages; *solve*: inside the backend, refinement included; *polish,
certificate*: of the lexicographic formulation. *Cold*: set up anew at every step, as qpsolvers does in any case;
*warm*: set up once and started from the step before (native backends). *Closed form*: Eqs. 12–14 alone, without limits
or contacts. *Damped*: the one QP that mink and pink solve, uncertified; *mink* itself, with its own limits: its
assembly of 17 frame tasks and its solve are one figure. Everything is repeated in turn, so that a slow minute does not
hit one backend alone; every step's time is the median of its repeats, and p50, p95, p99 and max are over the steps.
With as few steps as these, p99 is close to max.

**To see:** ratios between rows. Absolute times are of a shared machine, hang on its load and differ from run to run:
this table is kept apart from the others. It does *not* show larger arms, nor solvers at looser accuracies than 1e-8."""

ARTEFACT = Artefact("table-7", "Table 7: time of a step", CAPTION, timed_jobs, build, timed=True)
