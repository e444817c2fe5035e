"""Any number of levels of either kind, with hard rows and equalities: found, proven, and equal to the optimum.

The problems are those of `hierarchies.py`. The first part of this file checks them without the library's solvers; the
second holds the solvers to them. `pytest tests/prioritized_ik/test_hierarchies.py -k campaign --campaign 20000` runs the
long version.
"""

import itertools
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hierarchies import (
    EVERYTHING,
    FEATURES,
    KnownHierarchy,
    exhausted_optimum,
    gains,
    kkt_error,
    random_hierarchy,
    sensitivity,
    solution_on,
    unplanned_hierarchy,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from winding_fixtures import QP_ONLY

from prioritized_ik.errors import WitnessError
from prioritized_ik.problem import IKProblem, Level
from prioritized_ik.solvers.methods import Method
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.solvers.step import JointStep, StepStatus
from prioritized_ik.solvers.witness import witness_step
from prioritized_ik.tolerances import CERTIFIED, GAP, UNDECIDED

PLANTED = 1e-9  # relative: conditions that were planted hold to rounding, measured 5e-15 at worst
MOVED = 1e-4  # of a step: what a check that deserves the name must see
TINY = 1e-9  # relative: measured 7e-12; least squares on rows that count twice, or nearly so, cost a few digits

#: Relative to the step. The certificate's figures are below 1e-8, and a lower level passes on what is left above it ten
#: to a hundred times; the polish makes it 1e-12 in nearly all cases. Problems are drawn so that rounding is below 1e-8.
AGREES = 1e-6
BLUR = 2e-13  # a thousand roundings, which the optimum follows as far as it is sensitive; measured 413 on 600 problems
BLURRED = 2e-8  # and never more than this, whatever the sensitivity; measured 8e-9 on those, 1.2e-8 at worst

NEARLY_ALL = 0.999  # of DAQP's steps are optimal; weights over six decades leave some of them undecided to rounding
MOST = 0.8  # of the others' steps: those that give up more often must be right where they do not
DECIDED = 0.95  # of DAQP's steps are certified; measured 198 of 200, and of others 23 of 25 at least
WITNESS = 1e-8  # of the size of a level's terms, squared: what CVXPY's strictest solver leaves of its cost

SOLVERS = {"daqp": 150, "proxqp": 25, "quadprog": 25, "clarabel": 25, "piqp": 25}
CAMPAIGNS = [("daqp", 1, NEARLY_ALL), *((solver, 8, MOST) for solver in SOLVERS if solver != "daqp")]
SEEDS = st.integers(0, 2**32 - 1)


def examples(count: int) -> settings:
    """The same `count` examples in every run."""
    return settings(max_examples=count, derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])


hierarchies = st.builds(
    random_hierarchy, SEEDS, features=st.one_of(st.just(EVERYTHING), st.frozensets(st.sampled_from(FEATURES)))
)
small_hierarchies = st.builds(
    random_hierarchy, SEEDS, features=st.frozensets(st.sampled_from(FEATURES)), joints=st.just((2, 8))
)
unplanned = st.builds(unplanned_hierarchy, SEEDS)


def error_of(step: np.ndarray, known: KnownHierarchy) -> float:
    return float(np.linalg.norm(step - known.dtheta) / np.linalg.norm(known.dtheta))


# The problems.


@examples(150)
@given(hierarchies)
def test_planted_conditions_hold(known):
    assert kkt_error(known) <= PLANTED


@examples(60)
@given(hierarchies)
def test_no_feasible_step_beats_the_planted_optimum_at_the_first_level_that_tells_them_apart(known):
    assert gains(known).best <= 0.0


def test_every_level_tells_some_feasible_steps_from_the_optimum():
    decided = Counter()
    for seed in range(60):
        decided.update(dict(enumerate(gains(random_hierarchy(seed)).decided)))
    assert all(decided[level] >= 20 for level in range(6))


@examples(60)
@given(hierarchies, st.integers(0, 2**16))
def test_a_step_off_by_a_ten_thousandth_breaks_the_planted_conditions(known, seed):
    offset = np.random.default_rng(seed).normal(size=len(known.dtheta))
    offset *= MOVED * np.linalg.norm(known.dtheta) / np.linalg.norm(offset)
    assert kkt_error(replace(known, dtheta=known.dtheta + offset)) > 100.0 * PLANTED


@pytest.mark.parametrize("seed", range(40))
def test_a_multiplier_that_is_left_out_breaks_the_planted_conditions(seed):
    known = random_hierarchy(seed, EVERYTHING - {"weights", "degenerate"})
    for i in range(len(known.presses)):
        others = (*known.presses[:i], *known.presses[i + 1 :])
        assert kkt_error(replace(known, presses=others)) > 100.0 * PLANTED


@pytest.mark.parametrize("seed", range(40))
def test_random_steps_beat_what_is_not_the_optimum(seed):
    known = random_hierarchy(seed, EVERYTHING - {"weights"}, joints=(4, 20))
    free = solution_on(known.problem, (), known.dtheta)
    assert (
        not known.presses or known.problem.relative_violation(free) > MOVED or gains(replace(known, dtheta=free)).best > 0.0
    )


@examples(100)
@given(hierarchies)
def test_least_squares_on_the_pressed_rows_is_the_planted_optimum(known):
    found = solution_on(known.problem, known.presses, known.dtheta)
    assert error_of(found, known) <= min(BLUR * max(sensitivity(known), 1.0), BLURRED)


@pytest.mark.parametrize("seed", range(20))
def test_a_tiny_planted_optimum_is_the_best_of_every_set_of_rows(seed):
    known = next(tiny(seed))
    assert error_of(exhausted_optimum(known.problem), known) <= TINY


def tiny(seed: int) -> Iterator[KnownHierarchy]:
    """Problems of two or three levels with few enough rows to try every set of them; every other one has a soft level."""
    for attempt in itertools.count(1000 * seed):
        known = random_hierarchy(attempt, EVERYTHING - {"weights", "scales"}, joints=(3, 4), levels=(2, 3))
        soft = sum(len(level.target) for level in known.problem.levels if level.is_soft)
        rows = len(known.problem.inequalities.upper) + soft
        if rows <= 11 and soft <= 4 and bool(soft) == bool(seed % 2) and any(press.level for press in known.presses):
            yield known


def test_every_feature_occurs_and_can_be_left_out():
    def has(feature: str, problem: IKProblem) -> bool:
        lower, upper = problem.bounds.lower, problem.bounds.upper
        ranks = [np.linalg.matrix_rank(level.matrix) for level in problem.levels if not level.is_soft]
        heights = [len(level.target) for level in problem.levels if not level.is_soft]
        return {
            "bounds": np.isfinite(lower[lower != upper]).any(),
            "locked": (lower == upper).any(),
            "rows": len(problem.rows.upper) > 0,
            "equalities": len(problem.equalities.target) > 0,
            "soft": any(level.is_soft for level in problem.levels),
            "dependent": any(rank < height for rank, height in zip(ranks, heights, strict=True)),
            "weights": any(np.ptp(level.weights) > 0.0 for level in problem.levels),
        }[feature]

    base = frozenset({"bounds", "rows"})
    for feature in ("bounds", "locked", "rows", "equalities", "soft", "dependent", "weights"):
        on = [random_hierarchy(seed, base | {feature}, joints=(4, 12)).problem for seed in range(30)]
        off = [random_hierarchy(seed, base - {feature}, joints=(4, 12)).problem for seed in range(30)]
        assert any(has(feature, problem) for problem in on), feature
        assert not any(has(feature, problem) for problem in off), feature


def test_a_seed_makes_the_same_problem_again():
    one, other = random_hierarchy(7), random_hierarchy(7)
    assert one.dtheta.tobytes() == other.dtheta.tobytes()
    for a, b in zip(one.problem.levels, other.problem.levels, strict=True):
        assert a.matrix.tobytes() == b.matrix.tobytes()


def test_an_unknown_feature_is_refused():
    with pytest.raises(ValueError, match="unknown features"):
        random_hierarchy(0, {"unheard of"})


@examples(60)
@given(unplanned)
def test_an_unplanned_problem_has_a_step_that_keeps_every_hard_row(made):
    problem, known = made
    assert problem.relative_violation(known) <= PLANTED


# The solvers.


def certified(step: JointStep) -> bool:
    """Whether the step is handed out as proven, having checked that what it says of itself is consistent."""
    assert step.status is not StepStatus.INFEASIBLE, "all these problems are feasible"
    if not step.found:
        return False
    assert step.certificate.holds == (step.status is not StepStatus.UNCERTIFIED)
    certificate = step.certificate
    optimal = certificate.worst <= CERTIFIED and max(certificate.relative_gaps[:-1], default=0.0) <= GAP
    assert certificate.is_optimal == optimal
    assert certificate.holds == (optimal and certificate.variation <= UNDECIDED)
    return certificate.holds


def assert_planted(known: KnownHierarchy, solver: str) -> None:
    step = get_method(solver).step(known.problem, QP_ONLY)
    if certified(step):
        assert error_of(step.dtheta, known) <= AGREES


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_step_is_the_planted_optimum_or_said_to_be_uncertified(solver):
    @examples(SOLVERS[solver])
    @given(hierarchies)
    def holds(known):
        assert_planted(known, solver)

    holds()


@pytest.mark.parametrize("feature", FEATURES)
def test_a_step_is_the_planted_optimum_with_one_feature_beside_bounds_and_rows(feature):
    for seed in range(8):
        assert_planted(random_hierarchy(seed, {"bounds", "rows", feature}), "daqp")


def first_worse(problem: IKProblem, found: np.ndarray, other: np.ndarray) -> str | None:
    """Return the name of the first level whose costs differ, the reference included, if it is `found` that costs more."""
    for level in (*problem.levels, Level(np.eye(len(found)), problem.reference, name="reference")):
        terms = np.abs(level.matrix) @ np.abs(other) + np.abs(level.target)
        difference = level.cost(found) - level.cost(other)
        if abs(difference) > WITNESS * float(terms @ (level.weights * terms)):
            return level.name if difference > 0.0 else None
    return None


@examples(40)
@given(unplanned)
def test_a_certified_step_is_at_no_level_worse_than_the_witness(made):
    problem, _ = made
    step, witness = get_method("daqp").step(problem, QP_ONLY), witnessed(problem)
    if certified(step) and witness is not None:
        assert first_worse(problem, step.dtheta, witness) is None


def witnessed(problem: IKProblem) -> np.ndarray | None:
    """The witness's step, if it finds one."""
    try:
        return witness_step(problem)
    except WitnessError:
        return None


@dataclass
class Tally:
    """What came of a campaign."""

    counts: Counter = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    unproven: list[int] = field(default_factory=list)
    optimal: int = 0
    errors: list[float] = field(default_factory=list)
    times: list[float] = field(default_factory=list)

    def solve(self, seed: int, problem: IKProblem, backend: Method) -> JointStep | None:
        """Return the step if it is certified."""
        started = time.perf_counter()
        try:
            step = backend.step(problem, QP_ONLY)
        except (ArithmeticError, LookupError, RuntimeError, TypeError, ValueError) as error:
            error.add_note(f"with {backend.name}, seed {seed}")
            raise
        self.times.append(time.perf_counter() - started)
        self.counts[step.status.name] += 1
        self.optimal += step.found and step.certificate.is_optimal
        if certified(step):
            return step
        self.unproven.append(seed)
        return None

    @property
    def share(self) -> float:
        """Of all steps, those that are optimal, the undecided ones among them."""
        return self.optimal / len(self.times)

    @property
    def certified(self) -> float:
        """Of all steps, those that are certified."""
        return 1.0 - len(self.unproven) / len(self.times)

    def __str__(self) -> str:
        times, errors = np.array(self.times) * 1e3, np.array(self.errors)
        return (
            f"{len(times)} problems, {dict(self.counts)}: {100.0 * self.share:.3f} % optimal, "
            f"{100.0 * self.certified:.3f} % certified, wrong: {self.wrong}; "
            f"error: worst {errors.max():.1e}, median {np.median(errors):.1e}; "
            f"time [ms]: median {np.median(times):.1f}, worst {times.max():.0f}; seeds not certified: {self.unproven[:50]}"
        )


@pytest.mark.parametrize(("solver", "part", "least"), CAMPAIGNS)
def test_campaign_of_planted_problems(solver, part, least, request, capsys):
    tally, backend = Tally(), get_method(solver)
    for seed in range(-(-request.config.getoption("--campaign") // part)):
        known = random_hierarchy(seed)
        step = tally.solve(seed, known.problem, backend)
        if step is not None:
            tally.errors.append(error_of(step.dtheta, known))
            if tally.errors[-1] > AGREES:
                tally.wrong.append(f"{seed}: {tally.errors[-1]:.1e}")
    with capsys.disabled():
        print(f"\nplanted, {solver}: {tally}")
    assert not tally.wrong
    assert tally.share >= least
    assert tally.certified >= (DECIDED if solver == "daqp" else MOST)


def test_campaign_of_unplanned_problems(request, capsys):
    tally, backend, witnesses = Tally(), get_method("daqp"), 0
    for seed in range(-(-request.config.getoption("--campaign") // 8)):
        problem, _ = unplanned_hierarchy(seed)
        step, witness = tally.solve(seed, problem, backend), witnessed(problem)
        if step is not None and witness is not None:
            witnesses += 1
            tally.errors.append(float(np.linalg.norm(step.dtheta - witness)) / float(np.linalg.norm(step.dtheta)))
            worse = first_worse(problem, step.dtheta, witness)
            if worse is not None:
                tally.wrong.append(f"{seed}: {worse}")
    with capsys.disabled():
        print(f"\nunplanned, daqp against {witnesses} witnesses: {tally}")
    assert not tally.wrong
    assert tally.share >= NEARLY_ALL
    assert tally.certified >= DECIDED
    assert witnesses >= MOST * len(tally.times)
