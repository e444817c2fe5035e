"""From a problem on a kinematic tree to its joint step in O(joints), or to None where the dense form is to answer."""

from collections.abc import Collection
from time import perf_counter

import numpy as np

from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.compiled.fast import LOOSE, TIGHT, CompiledStep, Remembered, guessed
from prioritized_ik.solvers.compiled.library import Ending, Question
from prioritized_ik.solvers.compiled.tree_step import PATH, compiled_tree_step
from prioritized_ik.solvers.compiled.workspace import recent_names
from prioritized_ik.solvers.report import DeferredReports
from prioritized_ik.solvers.step import JointStep, StepStatus, Timings
from prioritized_ik.solvers.tree.active_set import Found, Search
from prioritized_ik.solvers.tree.certificate import ActiveSet, TreeProof
from prioritized_ik.solvers.tree.posed import PosedOnTree, is_on_tree
from prioritized_ik.tolerances import ACCEPTED_VIOLATION, NEAR_ZERO, TREE_ZERO

KINEMATICS = ("auto", "tree", "dense")  # see `SolveOptions.kinematics`

#: Joints from which on the tree's form is faster, see `docs/performance.md`.
WORTHWHILE = 200


def goes_along_links(kinematics: str, joints: int) -> bool:
    """Whether problems of so many joints are to be solved joint by joint, see `SolveOptions.kinematics`."""
    return kinematics == "tree" or (kinematics == "auto" and joints >= WORTHWHILE)


def is_worthwhile(problem: IKProblem, kinematics: str) -> bool:
    """Whether a problem is to be solved joint by joint, and can be."""
    return goes_along_links(kinematics, problem.joint_count) and is_on_tree(problem)


def tree_step(
    problem: IKProblem,
    rank_tolerance: float,
    rows: Collection[str] | Remembered = (),
    question: Question = Question.STEP,
    method: str = "",
) -> tuple[JointStep, Remembered] | None:
    """Return the step of a problem and the rows that it rests on; None if the dense form is to answer.

    It is certified, or the certificate says that rounding moves it by more than itself.

    Args:
        problem: one that `is_on_tree`.
        rank_tolerance: see `SolveOptions`.
        rows: those that the step may rest on, such as the last step's, or their names.
        question: the step; only a closed form that breaks no row; or no closed form first.
        method: name of who solves.
    """
    quick = compiled_tree_step(problem, rank_tolerance, rows, question, method)
    if isinstance(quick, CompiledStep):
        return quick, quick.written.active
    started = perf_counter()
    posed = PosedOnTree(problem)
    if not posed.has_clear_rows:
        return None
    names, numbers = recent_names(problem.bounds.names, problem.rows.names)
    found = flat = None
    for zero in (TREE_ZERO, NEAR_ZERO):
        search = Search(posed, is_tried=quick is Ending.UNSETTLED and zero == TREE_ZERO)
        is_cut = quick is Ending.RANK and zero == TREE_ZERO
        if not rank_tolerance or (not is_cut and search.has_clear_ranks(rank_tolerance)):
            found = _found(search, _guess(search, rows, names, numbers), question)
        flat = flat or search.flat
        if found is not None or zero == NEAR_ZERO:
            break
        posed, ranks = PosedOnTree(problem, NEAR_ZERO), search.ranks
        if not search.has_met_unclear_ranks and Search(posed).ranks in (None, ranks):  # nothing is near zero
            break
    if found is None and question is not Question.CLOSED_FORM_ONLY:
        found = flat  # which matrices would not prove either, with as many digits
    if found is None:
        return None
    step = _step(posed, found, rank_tolerance, method, perf_counter() - started)
    return step, _remembered(found.active, posed, names)


def _found(search: Search, guess: ActiveSet, question: Question) -> Found | None:
    """Return the optimum: from a guess if it is held by a multiplier, else the closed form if it breaks no row."""
    nothing = search.nothing()
    guessed = guess.key != nothing.key
    if guessed and question is Question.STEP:
        found = search.optimum(guess)
        if found is not None and found.proof.is_held:
            return found
    if question is not Question.FROM_GUESS_ONLY:
        free, _ = search.closed_form()
        if free is not None or question is Question.CLOSED_FORM_ONLY or search.flat is not None:
            return free
    return search.optimum(guess if guessed and question is Question.FROM_GUESS_ONLY else nothing)


def _guess(
    search: Search, rows: Collection[str] | Remembered, names: tuple[str, ...], numbers: dict[str, int]
) -> ActiveSet:
    """Return which bounds and rows the step may rest on, those that the problem does not have left out."""
    chosen = np.frombuffer(guessed(rows, names, numbers), dtype=np.uint8) != LOOSE
    posed, guess, m = search.posed, search.nothing(), search.posed.tree.joint_count
    free = guess.side == 0
    upper = chosen[:m] & free & np.isfinite(posed.upper)
    lower = chosen[m : 2 * m] & free & np.isfinite(posed.lower) & ~upper
    side = np.where(upper, 1, np.where(lower, -1, guess.side)).astype(np.int8)
    return ActiveSet(side, chosen[2 * m :] & np.isfinite(posed.targets[posed.parts[0]]))


def _remembered(active: ActiveSet, posed: PosedOnTree, names: tuple[str, ...]) -> Remembered:
    free = posed.lower != posed.upper
    kept = np.concatenate([(active.side > 0) & free, (active.side < 0) & free, active.held])
    return Remembered(names, np.where(kept, TIGHT, LOOSE).astype(np.uint8).tobytes())


def _status(proof: TreeProof) -> StepStatus:
    if proof.is_flat:
        return StepStatus.UNCERTIFIED
    return StepStatus.SOLVED if proof.is_held else StepStatus.CLOSED_FORM


def _step(posed: PosedOnTree, found: Found, rank_tolerance: float, method: str, seconds: float) -> JointStep:
    problem, proof, active, u = posed.problem, found.proof, found.active, found.u
    dtheta, lacking = problem.from_metric(u), posed.missing(u)
    near = ACCEPTED_VIOLATION * proof.scale
    joints, rows = problem.bounds.names, problem.rows.names
    tight = (
        *(f"{joints[j]} upper" for j in np.flatnonzero(posed.upper - u <= near)),
        *(f"{joints[j]} lower" for j in np.flatnonzero(u - posed.lower <= near)),
        *(rows[i] for i in np.flatnonzero(posed.slack(u) <= near)),
    )
    free = posed.lower != posed.upper
    resting = (
        *(f"{joints[j]} upper" for j in np.flatnonzero((active.side > 0) & free)),
        *(f"{joints[j]} lower" for j in np.flatnonzero((active.side < 0) & free)),
        *(rows[i] for i in np.flatnonzero(active.held)),
    )
    return JointStep(
        dtheta,
        _status(proof),
        costs=tuple(float(missing @ missing) for missing in (lacking[part] for part in posed.parts[1:])),
        tight_rows=tight,
        violation=proof.certificate.violation,
        timings=Timings(seconds, 0.0),
        certificate=proof.certificate,
        repairs=found.corrections,
        levels=DeferredReports(problem, rank_tolerance, dtheta),
        method=method,
        active_rows=resting,
        path=PATH,
    )
