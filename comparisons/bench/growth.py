"""How a certified step grows with an arm's links: joint by joint on the kinematic tree, by matrices, and rivals.

The question at each number of links: the winding arm in a random posture beside its object, and the same with `LESS` of
every target, whose steps take turns, so that each starts warm from the other's rows. So that limits and contacts are active
in arms of every length, the `LIMITED` joints that move most, and links beside the object, may go half as far as in the free
step.
"""

import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import cycle

import numpy as np

from comparisons.bench.clock import rotated
from comparisons.bench.rivals import Dgelsy, Mink, answering
from comparisons.bench.settings import BenchSettings
from prioritized_ik.models import Arm
from prioritized_ik.problem import Bounds, IKProblem, Level, Rows, replaced
from prioritized_ik.solvers.compiled.fast import Remembered
from prioritized_ik.solvers.compiled.library import Question
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.methods import ActiveSet
from prioritized_ik.solvers.solve import step_of
from prioritized_ik.solvers.step import JointStep
from prioritized_ik.solvers.tree.step import tree_step
from prioritized_ik.tree_problem import TreeLevel, TreeRows
from prioritized_ik.validation import Array
from prioritized_ik.winding.controller import WindingController
from prioritized_ik.winding.settings import WindingSettings

REPEATS = 5
PATIENCE = 8.0  # [s] a program that takes longer for one step is not asked for longer arms
LIMITED = 10  # joints whose bounds the free step breaks
LESS = 0.95  # of every target, in the second question
FITTED = (50, 800)  # links between which exponents are fitted
MIB = 2.0**20

ON_TREE, MATRICES = SolveOptions(kinematics="tree"), SolveOptions(kinematics="dense")
CLOSED_TREE, WARM_TREE = "closed form, by links", "limits active, by links"
CLOSED_DENSE, WARM_DENSE = "closed form, by matrices", "limits active, by matrices"
OURS = (CLOSED_TREE, WARM_TREE, CLOSED_DENSE, WARM_DENSE)
DGELSY, MINK = "dgelsy", "mink (daqp)"


@dataclass
class Growth:
    """Times by links.

    Attributes:
        joints, active: by links, how many joints there are, and on how many bounds and rows the step rests.
        seconds: by program and links, the median [s].
        certified: by program of ours and links, whether the certificate holds.
        paths: by program of ours and links, how the step was made, see `JointStep.path`.
        apart: by links, how far the steps by links and by matrices are from each other, relative to their size.
        memory: by links, the most that a step by links allocates [MiB].
        none: by program of ours, numbers of links where it gave no step: by links, where matrices are to answer.
        left_out: by program, why there is nothing beyond some number of links.
    """

    joints: dict[int, int] = field(default_factory=dict)
    active: dict[int, int] = field(default_factory=dict)
    seconds: dict[str, dict[int, float]] = field(default_factory=dict)
    certified: dict[str, dict[int, bool]] = field(default_factory=dict)
    paths: dict[str, dict[int, str]] = field(default_factory=dict)
    apart: dict[int, float] = field(default_factory=dict)
    memory: dict[int, float] = field(default_factory=dict)
    none: dict[str, list[int]] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)

    def expected(self, program: str, links: int) -> float:
        """Return what a step by matrices takes, from that of the longest arm so far and the cube of the links [s]."""
        known = self.seconds.get(program, {})
        longest = max(known, default=links)
        return known.get(longest, 0.0) * (links / longest) ** 3

    def exponent(self, program: str) -> float | None:
        """Return the exponent of the growth between `FITTED` links, see `exponent`."""
        return exponent(self.seconds.get(program, {}))


def exponent(values: dict[int, float]) -> float | None:
    """Return b of the least-squares fit of a n^b to values by links n, between `FITTED` links; None of less than three."""
    kept = [(links, value) for links, value in values.items() if FITTED[0] <= links <= FITTED[1] and value > 0.0]
    if len(kept) < 3:
        return None
    counted, measured = np.log(np.array(kept, dtype=float)).T
    return float(np.polyfit(counted, measured, 1)[0])


def measure_growth(settings: BenchSettings, tell: Callable[[str, int, int], object]) -> Growth:
    """Return the times of steps of arms of `settings.links` links, Eq. 24."""
    growth = Growth()
    for number, links in enumerate(settings.links):
        tell("growth", number, len(settings.links))
        _measure(links, settings, growth)
    tell("growth", len(settings.links), len(settings.links))
    return growth


def asked(links: int) -> tuple[list[IKProblem], WindingSettings, Array]:
    """Return two problems on the tree with limits and contacts to be active, their settings, and where they are posed."""
    settings = WindingSettings(
        arm=Arm(links=links),
        link=max(1, links // 3),
        posture="random",
        weights="eq24",
        solver=ActiveSet.name,
        options=ON_TREE,
    )
    controller, q = WindingController(settings), settings.initial_posture()
    problem = tightened(controller.problem(q, controller.observe(q, np.zeros(links, dtype=bool))))
    less = [
        TreeLevel(level.points, LESS * level.target, level.weights, level.name)
        for level in problem.levels
        if isinstance(level, TreeLevel)
    ]
    return [problem, replaced(problem, levels=tuple(less))], settings, q


def free(problem: IKProblem) -> IKProblem:
    """Return a problem without bounds and rows."""
    m = problem.joint_count
    return replaced(problem, bounds=Bounds.none(m), rows=Rows.none(m))


def tightened(problem: IKProblem) -> IKProblem:
    """Return a problem with some bounds and contact rows at half of what the free step does."""
    found = tree_step(free(problem), 0.0, question=Question.CLOSED_FORM_ONLY)
    dtheta = step_of(ActiveSet(), free(problem), MATRICES).dtheta if found is None else found[0].dtheta
    assert dtheta is not None
    lower, upper = problem.bounds.lower.copy(), problem.bounds.upper.copy()
    limited = np.argsort(-np.abs(dtheta))[:LIMITED]
    half = 0.5 * dtheta[limited]
    upper[limited] = np.where(half > 0.0, np.minimum(half, upper[limited]), upper[limited])
    lower[limited] = np.where(half < 0.0, np.maximum(half, lower[limited]), lower[limited])
    bounds = Bounds(lower, upper, problem.bounds.names)
    if not isinstance(problem.rows, TreeRows):
        return replaced(problem, bounds=bounds)
    way = problem.rows.points.times(dtheta)
    side = np.where(way > 0.0, np.minimum(problem.rows.upper, 0.5 * way), problem.rows.upper)
    return replaced(problem, bounds=bounds, rows=TreeRows(problem.rows.points, side, problem.rows.names))


def in_matrices(problem: IKProblem) -> IKProblem:
    """Return a problem on a tree with matrices in place of it."""
    levels = [Level(level.matrix, level.target, level.weights, level.name) for level in problem.levels]
    return replaced(problem, levels=tuple(levels), rows=Rows(problem.rows.matrix, problem.rows.upper, problem.rows.names))


def _measure(links: int, settings: BenchSettings, growth: Growth) -> None:
    problems, winding, q = asked(links)
    growth.joints[links] = problems[0].joint_count
    calls: dict[str, Callable[[], object]] = {
        CLOSED_TREE: _by_links([free(problem) for problem in problems]),
        WARM_TREE: _by_links(problems),
    }
    for name in (CLOSED_DENSE, WARM_DENSE, DGELSY, MINK):
        if links > settings.largest_rival and name == MINK:
            growth.left_out.setdefault(name, f"not asked beyond {settings.largest_rival} links")
        elif (expected := growth.expected(name, links)) > PATIENCE:
            growth.left_out.setdefault(name, f"not asked from {links} links on, where a step would take {expected:.0f} s")
        elif name not in growth.left_out:
            calls[name] = _call(name, problems, winding, q)
    growth.memory[links] = _allocated(calls[WARM_TREE])
    last = _time(calls, links, growth)
    tree, dense = (last.get(name) for name in (WARM_TREE, WARM_DENSE))
    if tree is not None:
        growth.active[links] = len(tree.active_rows)
    if tree is not None and dense is not None and tree.dtheta is not None and dense.dtheta is not None:
        size = float(np.linalg.norm(dense.dtheta)) or 1.0
        growth.apart[links] = float(np.linalg.norm(tree.dtheta - dense.dtheta)) / size


def _call(name: str, problems: list[IKProblem], winding: WindingSettings, q: Array) -> Callable[[], object]:
    posed = [in_matrices(problem) for problem in problems]
    if name == CLOSED_DENSE:
        return _by_matrices([free(problem) for problem in posed])
    if name == WARM_DENSE:
        return _by_matrices(posed)
    rival = Dgelsy(winding.options.rank_tolerance) if name == DGELSY else Mink(winding, "daqp")
    return answering(rival, rival.asked(posed[0], q), q)


def _by_links(problems: list[IKProblem]) -> Callable[[], JointStep | None]:
    """Return what takes steps of problems in turns, each warm from the one before; None where matrices are to answer."""
    turns, rows = cycle(problems), Remembered((), b"")

    def step() -> JointStep | None:
        nonlocal rows
        found = tree_step(next(turns), 0.0, rows, method=ActiveSet.name)
        if found is None:
            return None
        rows = found[1]
        return found[0]

    return step


def _by_matrices(problems: list[IKProblem]) -> Callable[[], JointStep]:
    """Return the same by the dense form."""
    method, turns = ActiveSet(), cycle(problems)
    return lambda: step_of(method, next(turns), MATRICES)


def _time(calls: dict[str, Callable[[], object]], links: int, growth: Growth) -> dict[str, JointStep]:
    """Note the median time of each program, which take turns, after a round for warming up; return our last steps."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    last: dict[str, JointStep] = {}
    for turn in range(2 * REPEATS + 1):
        for name in rotated(calls, turn):
            if len(times[name]) > 1 and sum(times[name]) > PATIENCE:
                continue
            started = time.perf_counter()
            answer = calls[name]()
            times[name].append(time.perf_counter() - started)
            if name in OURS and answer is None:
                growth.none[name] = sorted({*growth.none.get(name, []), links})
            if isinstance(answer, JointStep) and turn % 2 == 0:  # the same problem of the two, whoever was asked more often
                last[name] = answer
    for name, found in times.items():
        if links in growth.none.get(name, []):
            continue
        growth.seconds.setdefault(name, {})[links] = float(np.median(found[1:] or found))
        if growth.seconds[name][links] > PATIENCE:
            growth.left_out[name] = f"not asked beyond {links} links, where a step takes {PATIENCE:g} s and more"
    for name, step in last.items():
        if links in growth.none.get(name, []):
            continue
        growth.certified.setdefault(name, {})[links] = bool(step.certificate is not None and step.certificate.holds)
        growth.paths.setdefault(name, {})[links] = step.path
    return last


def _allocated(call: Callable[[], object]) -> float:
    """Return the most that a call allocates [MiB], after one for warming up."""
    call()
    tracemalloc.start()
    try:
        call()
        return tracemalloc.get_traced_memory()[1] / MIB
    finally:
        tracemalloc.stop()
