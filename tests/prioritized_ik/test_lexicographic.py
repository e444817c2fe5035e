"""The fold over levels: the optimum, whichever way, and what becomes of a solver that fails."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from hierarchies import exhausted_optimum, random_hierarchy
from oracles import norm_error
from tolerances import ROUNDING
from winding_fixtures import AS_RECORDED, QP_ONLY, constrained_steps, free_steps

from prioritized_ik.errors import InputError, StepNotFoundError
from prioritized_ik.problem import Bounds, Equalities, IKProblem, Level, Rows
from prioritized_ik.solvers import lexicographic, registry
from prioritized_ik.solvers.backends.protocol import StageResult
from prioritized_ik.solvers.backends.registry import get_backend
from prioritized_ik.solvers.certificate import certify
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.hierarchy import Hierarchy, strict_solution
from prioritized_ik.solvers.lexicographic import Clock, SolveOptions
from prioritized_ik.solvers.methods import Guessing, Lexicographic
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.solvers.solve import solve
from prioritized_ik.solvers.stages import Stage
from prioritized_ik.solvers.step import StepStatus
from prioritized_ik.tolerances import ACCEPTED_VIOLATION

#: The solver's own answer, by the QP stages alone.
RAW = SolveOptions(closed_form_first=False, polish=False)

#: The rank cut as in all that reproduces the paper.
CUT_AS_RECORDED = SolveOptions(rank_tolerance=RANK_TOLERANCE)

EXACT = 1e-9  # answers of size 1 from solvers whose figures are at 1e-10 here; a polished one is held to `ROUNDING`
SEEDS = range(12)


def random_problem(seed: int, levels: int) -> IKProblem:
    """Four joints, levels of one row each, bounds on three joints and two rows, with dθ = 0 strictly inside."""
    rng = np.random.default_rng(seed)
    tasks = [Level(rng.normal(size=(1, 4)), 3.0 * rng.normal(size=1), name=f"task {i + 1}") for i in range(levels)]
    bounds = Bounds(np.append(-rng.uniform(0.1, 1.0, 2), [-np.inf, -np.inf]), np.append(rng.uniform(0.1, 1.0, 3), np.inf))
    return IKProblem(tasks, bounds, Rows(rng.normal(size=(2, 4)), rng.uniform(0.1, 0.5, 2)), rng.normal(size=4))


def built_backwards(seed: int) -> tuple[IKProblem, np.ndarray]:
    """A one-level problem on six joints and its optimum, chosen first.

    Row 1 is tight against the level (so it lies in the span of A), row 2 against the reference only, row 3 is idle:
    Aᵀ W (A dθ - b) + λ₁ c₁ = 0 and dθ - r + Aᵀ μ + ν c₁ + λ₂ c₂ = 0, where λ₁ > 0 and λ₂ > 0, ν of any sign.
    """
    rng = np.random.default_rng(seed)
    a, weights, optimum = rng.normal(size=(3, 6)), rng.uniform(0.01, 200.0, 3), rng.normal(size=6)
    combination = rng.normal(size=3)
    c1, c2, c3 = a.T @ combination, rng.normal(size=6), rng.normal(size=6)
    residual = rng.uniform(0.5, 2.0) * combination / weights  # b - A dθ, so that AᵀW of it is λ₁ c₁
    reference = optimum + a.T @ rng.normal(size=3) + rng.normal() * c1 + rng.uniform(0.5, 2.0) * c2
    rows = Rows([c1, c2, c3], [c1 @ optimum, c2 @ optimum, c3 @ optimum + 0.3], ["first", "second", "idle"])
    return IKProblem([Level(a, a @ optimum + residual, weights)], rows=rows, reference=reference), optimum


@pytest.mark.parametrize("solver", ["proxqp", "daqp"])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_problem_built_backwards_from_its_optimum_is_solved(seed, solver):
    problem, optimum = built_backwards(seed)
    step = solve(problem, get_method(solver), QP_ONLY)
    assert step.status is StepStatus.SOLVED
    assert step.certificate.holds
    assert norm_error(step.dtheta, optimum) <= ROUNDING


@pytest.mark.parametrize("solver", ["proxqp", "daqp"])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_problem_built_backwards_is_solved_by_the_stages_alone(seed, solver):
    problem, optimum = built_backwards(seed)
    step = solve(problem, solver, RAW)
    assert np.array_equal(step.dtheta, step.raw)
    assert norm_error(step.raw, optimum) <= EXACT


@pytest.mark.parametrize("seed", SEEDS)
def test_the_rows_that_the_step_ends_on_are_named(seed):
    problem, _ = built_backwards(seed)
    assert solve(problem).tight_rows == ("first", "second")


@pytest.mark.parametrize("seed", SEEDS)
def test_a_target_off_by_a_thousandth_is_another_answer(seed):
    problem, optimum = built_backwards(seed)
    level = problem.levels[0]
    other = Level(level.matrix, 1.001 * level.target, level.weights)
    step = solve(IKProblem([other], rows=problem.rows, reference=problem.reference))
    assert np.abs(step.dtheta - optimum).max() > 1e3 * EXACT


@pytest.mark.parametrize("levels", [1, 2, 3])
@pytest.mark.parametrize("seed", SEEDS)
def test_the_step_is_that_of_a_brute_force_search_over_active_rows(seed, levels):
    problem = random_problem(seed, levels)
    optimum = exhausted_optimum(problem)
    for solver in ("proxqp", "daqp"):
        step = solve(problem, get_method(solver), QP_ONLY)
        assert step.dtheta == pytest.approx(optimum, abs=ROUNDING)
        assert step.raw == pytest.approx(optimum, abs=EXACT)


def test_the_random_problems_bind_rows_at_every_number_of_levels():
    for levels in (1, 2, 3):
        assert sum(bool(solve(random_problem(seed, levels)).tight_rows) for seed in SEEDS) >= 6


@pytest.mark.parametrize("seed", SEEDS)
def test_bounded_least_squares_of_full_rank_is_scipys(seed):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(8, 5)), 3.0 * rng.normal(size=8)
    lower, upper = -rng.uniform(0.1, 1.0, 5), rng.uniform(0.1, 1.0, 5)
    oracle = scipy.optimize.lsq_linear(a, b, (lower, upper), method="bvls", tol=1e-15).x
    step = solve(IKProblem([Level(a, b)], Bounds(lower, upper)), get_method("daqp"), QP_ONLY)
    assert step.dtheta == pytest.approx(oracle, abs=ROUNDING)
    assert step.raw == pytest.approx(oracle, abs=EXACT)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_second_level_does_not_raise_the_firsts_cost(seed):
    both = random_problem(seed, 2)
    alone = solve(IKProblem(both.levels[:1], both.bounds, both.rows, both.reference), "daqp", QP_ONLY)
    first, _ = solve(both, "daqp", QP_ONLY).costs
    assert first <= alone.costs[0] + ROUNDING


@pytest.mark.parametrize("seed", SEEDS)
def test_the_second_level_gains_over_leaving_its_directions_to_the_reference(seed):
    both = random_problem(seed, 2)
    alone = solve(IKProblem(both.levels[:1], both.bounds, both.rows, both.reference), "daqp", QP_ONLY)
    assert solve(both, "daqp", QP_ONLY).costs[1] <= both.levels[1].cost(alone.dtheta) + ROUNDING


def test_the_reference_is_met_in_the_free_directions_and_nowhere_else():
    problem = IKProblem([Level([[1.0, 0.0, 0.0]], [0.5])], reference=[9.0, 0.3, -0.2])
    for options in (SolveOptions(), QP_ONLY):
        assert solve(problem, "daqp", options).dtheta == pytest.approx([0.5, 0.3, -0.2], abs=ROUNDING)


def test_the_reference_stops_at_a_bound():
    problem = IKProblem([Level([[1.0, 0.0]], [0.5])], Bounds([-1.0, -1.0], [1.0, 0.1]), reference=[0.0, 0.3])
    step = solve(problem)
    assert step.dtheta == pytest.approx([0.5, 0.1], abs=ROUNDING)
    assert step.tight_rows == ("joint 2 upper",)


@pytest.mark.usefixtures("python_path")
def test_a_closed_form_that_meets_every_row_is_the_answer_bit_for_bit():
    for problem in free_steps():
        step = solve(problem, options=CUT_AS_RECORDED)
        assert (step.status, step.calls) == (StepStatus.CLOSED_FORM, 0)
        assert step.dtheta.tobytes() == strict_solution(problem.levels, problem.reference).tobytes()


def test_the_closed_form_is_no_answer_where_it_breaks_a_row():
    for problem in constrained_steps():
        step = solve(problem, "daqp", CUT_AS_RECORDED)
        assert step.status is StepStatus.SOLVED
        assert step.calls >= 2  # the level's stage and the last


def test_without_the_closed_form_first_the_solver_finds_the_same_step():
    for problem in free_steps():
        step, wanted = solve(problem, "daqp", AS_RECORDED), strict_solution(problem.levels, problem.reference)
        assert step.status is StepStatus.SOLVED
        assert norm_error(step.dtheta, wanted) <= ROUNDING
        assert norm_error(step.raw, wanted) <= EXACT


def test_trying_the_closed_form_first_does_not_change_a_constrained_step():
    for problem in constrained_steps():
        first = solve(problem, options=CUT_AS_RECORDED)
        assert first.dtheta.tobytes() == solve(problem, "daqp", AS_RECORDED).dtheta.tobytes()


def test_costs_are_those_of_every_level_at_the_step():
    problem = random_problem(0, 3)
    step = solve(problem)
    costs = [level.cost(step.dtheta) for level in problem.levels]  # the core sums in another order
    np.testing.assert_allclose(step.costs, costs, rtol=ROUNDING)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_damped_formulation_is_the_damped_least_squares_step_where_nothing_binds(seed):
    rng = np.random.default_rng(seed)
    a, b, reference = rng.normal(size=(3, 5)), rng.normal(size=3), rng.normal(size=5)
    step = solve(IKProblem([Level(a, b)], reference=reference), "damped:daqp", SolveOptions(damping=1e-2))
    wanted = np.linalg.solve(a.T @ a + 1e-2 * np.eye(5), a.T @ b + 1e-2 * reference)
    assert step.dtheta == pytest.approx(wanted, abs=EXACT)
    assert step.calls == 1


def test_the_damped_formulation_refuses_a_second_level():
    with pytest.raises(InputError, match="use 'lexicographic'"):
        solve(random_problem(0, 2), "damped:daqp")


def test_a_level_that_presses_into_a_corner_leaves_the_thin_direction_fixed():
    # At x = 1 the two rows leave y no room on either side, and z is the reference's.
    rows = Rows([[1.0, 1.0, 0.0], [1.0, -1.0, 0.0]], [1.0, 1.0])
    step = solve(IKProblem([Level([[1.0, 0.0, 0.0]], [5.0])], rows=rows, reference=[0.0, 0.7, -0.4]))
    assert step.dtheta == pytest.approx([1.0, 0.0, -0.4], abs=ROUNDING)


def test_rows_that_no_level_ends_on_leave_every_direction():
    levels = [Level([[0.0, 1.0]], [1.0]), Level([[1.0, 0.0]], [5.0])]
    step = solve(IKProblem(levels, rows=Rows([[1.0, 0.0], [-1.0, 0.0]], [1e-3, 1e-3])), "daqp", RAW)
    assert step.raw == pytest.approx([1e-3, 1.0], abs=EXACT)


def test_a_joint_that_is_locked_by_its_bounds_stays():
    step = solve(IKProblem([Level([[1.0, 1.0]], [1.0])], Bounds([0.0, -2.0], [0.0, 2.0])), "daqp", QP_ONLY)
    assert step.dtheta == pytest.approx([0.0, 1.0], abs=ROUNDING)


class FakeBackend:
    """Answers every stage with what `answer` makes of it."""

    name, version = "fake", "0"

    def __init__(self, answer):
        self._answer = answer

    def solve(self, stage: Stage) -> StageResult:
        return self._answer(stage)

    solve_once = solve


@pytest.fixture
def fake(monkeypatch):
    """Register a method called "fake" for one test."""
    monkeypatch.setattr(registry, "_added", {})

    def register(answer):
        registry.register("fake", lambda accuracy: Lexicographic(FakeBackend(answer)))

    return register


BOXED = IKProblem([Level(np.eye(2), [1.0, 1.0], name="reach")], Bounds([-0.5, -0.5], [0.5, 0.5]))
NONE = np.zeros(4, dtype=bool)  # of its rows


def refuse(stage: Stage) -> StageResult:
    return StageResult(None, "fake found no solution")


def jump(stage: Stage) -> StageResult:
    return StageResult(np.full(stage.size, 100.0))


def test_an_answer_that_is_not_found_is_a_status_without_a_step(fake):
    fake(refuse)
    step = get_method("fake").step(BOXED, QP_ONLY)
    assert (step.status, step.dtheta, step.found) == (StepStatus.NOT_FOUND, None, False)
    assert step.message == "level 'reach': fake found no solution"


def test_a_failure_of_the_last_level_is_named_so(fake):
    fake(lambda stage: refuse(stage) if stage.costed == stage.size else StageResult(-stage.problem.q))
    problem = IKProblem([Level([[1.0, 0.0]], [0.1])], Bounds([-0.5, -0.5], [0.5, 0.5]))
    assert get_method("fake").step(problem, QP_ONLY).message == "last level: fake found no solution"


def test_a_step_that_breaks_a_row_is_not_handed_out(fake):
    fake(jump)
    step = get_method("fake").step(BOXED, RAW)
    assert (step.status, step.dtheta) == (StepStatus.VIOLATED, None)
    assert step.violation > ACCEPTED_VIOLATION
    assert not step.certificate.holds
    assert "worst relative violation" in step.message
    assert np.abs(step.raw).max() > 1.0


def test_a_step_that_breaks_a_row_is_mended_where_it_can_be(fake):
    fake(jump)
    step = get_method("fake").step(BOXED, QP_ONLY)
    assert step.status is StepStatus.SOLVED
    assert step.certificate.holds
    assert np.array_equal(step.dtheta, [0.5, 0.5])
    assert np.abs(step.raw).max() > 1.0


def test_a_step_that_is_not_the_optimum_is_handed_out_as_uncertified(fake):
    fake(lambda stage: StageResult(np.zeros(stage.size)))
    step = get_method("fake").step(BOXED, RAW)
    assert step.status is StepStatus.UNCERTIFIED
    assert step.found
    assert np.array_equal(step.dtheta, np.zeros(2))
    assert step.certificate == certify(BOXED, np.zeros(2))
    assert not step.certificate.holds
    assert solve(BOXED, "fake", RAW).status is StepStatus.UNCERTIFIED  # no exception: it breaks nothing


def test_a_step_that_cannot_be_mended_is_found_from_nothing(fake, monkeypatch):
    monkeypatch.setattr("prioritized_ik.solvers.active_set.ITERATIONS", 1)
    fake(lambda stage: StageResult(np.zeros(stage.size)))
    step = get_method("fake").step(BOXED, QP_ONLY)
    assert step.status is StepStatus.SOLVED
    assert step.dtheta == pytest.approx([0.5, 0.5], abs=ROUNDING)
    assert np.array_equal(step.raw, np.zeros(2))
    assert step.calls == 1


@pytest.mark.usefixtures("python_path")
def test_a_step_that_cannot_be_mended_at_all_is_handed_out_as_uncertified(fake, monkeypatch):
    monkeypatch.setattr("prioritized_ik.solvers.active_set.ITERATIONS", 1)
    monkeypatch.setattr("prioritized_ik.solvers.lexicographic.stagewise", lambda *given: (np.full(2, 0.2), NONE))
    fake(lambda stage: StageResult(np.zeros(stage.size)))
    step = get_method("fake").step(BOXED, QP_ONLY)
    assert step.status is StepStatus.UNCERTIFIED
    assert np.array_equal(step.dtheta, np.full(2, 0.2))
    assert not step.certificate.holds


def quadprog(stage: Stage) -> StageResult:
    return get_backend("quadprog").solve(stage)


def test_a_step_that_is_certified_is_solved_once(fake):
    asked = []

    def right(stage):
        asked.append(stage.place)
        return quadprog(stage)

    fake(right)
    assert get_method("fake").step(BOXED, QP_ONLY).status is StepStatus.SOLVED
    assert asked == [0]  # the level decides all joints


def held_at(fraction: float) -> np.ndarray:
    """The optimum of `BOXED`, too long by some fraction of what is accepted."""
    return np.full(2, 0.5) * (1.0 + fraction * ACCEPTED_VIOLATION * np.sqrt(2.0))


@pytest.mark.parametrize("fraction", [0.5, 2.0])
def test_a_step_may_break_a_row_by_the_accepted_fraction_only(fake, fraction):
    # x = 0 is not an answer of dθ = 0 alone: the basis turns the wanted joint step into variables.
    fake(lambda stage: StageResult(np.linalg.solve(stage.basis, held_at(fraction))))
    step = get_method("fake").step(BOXED, RAW)
    assert step.found == (fraction < 1.0)
    assert step.status is (StepStatus.UNCERTIFIED if fraction < 1.0 else StepStatus.VIOLATED)


@pytest.mark.parametrize("fraction", [0.5, 2.0])
def test_a_step_that_breaks_a_row_by_a_little_is_polished_to_the_optimum(fake, fraction):
    fake(lambda stage: StageResult(np.linalg.solve(stage.basis, held_at(fraction))))
    step = get_method("fake").step(BOXED, QP_ONLY)
    assert (step.status, step.repairs) == (StepStatus.SOLVED, 0)
    assert np.array_equal(step.dtheta, [0.5, 0.5])


def test_calls_of_all_stages_are_counted(fake):
    fake(lambda stage: StageResult(np.zeros(stage.size), calls=3))
    problem = IKProblem([Level([[1.0, 0.0]], [0.1])], Bounds([-0.5, -0.5], [0.5, 0.5]))
    assert get_method("fake").step(problem, QP_ONLY).calls == 6


def test_the_exception_for_a_failure_names_the_solver_and_keeps_the_step(fake):
    fake(refuse)
    with pytest.raises(
        StepNotFoundError, match=r"^fake: the solver gave no answer .* level 'reach': fake found no"
    ) as caught:
        solve(BOXED, "fake", QP_ONLY)
    assert caught.value.step.status is StepStatus.NOT_FOUND
    assert caught.value.step.dtheta is None


def test_the_exception_for_a_broken_row_keeps_the_figures(fake):
    fake(jump)
    with pytest.raises(StepNotFoundError, match=r"^fake: the solver's step breaks a bound or row") as caught:
        solve(BOXED, "fake", RAW)
    assert caught.value.step.violation > 0.1
    assert caught.value.step.raw is not None


def test_rows_without_a_common_point_are_a_failure_and_not_a_step():
    problem = IKProblem([Level([[1.0, 0.0]], [5.0])], rows=Rows([[1.0, 0.0], [-1.0, 0.0]], [-1.0, -1.0]))
    with pytest.raises(StepNotFoundError) as caught:
        solve(problem)
    assert caught.value.step.dtheta is None
    assert caught.value.step.status is not StepStatus.SOLVED


# Equalities and soft levels, and what is known of a step.


def test_equalities_hold_before_any_level():
    equalities = Equalities([[1.0, 1.0, 0.0]], [1.0])
    problem = IKProblem([Level(np.eye(3), [3.0, 1.0, 2.0])], Bounds([-1.0] * 3, [1.5] * 3), equalities=equalities)
    step = solve(problem)  # without the bounds: (1.5, -0.5, 2)
    assert step.dtheta == pytest.approx([1.5, -0.5, 1.5], abs=ROUNDING)
    assert step.status is StepStatus.SOLVED


def test_a_soft_level_is_kept_by_those_below():
    levels = [Level([[1.0, 0.0]], [0.2], name="speed", kind="at_most"), Level(np.eye(2), [1.0, 1.0], name="reach")]
    step = solve(IKProblem(levels))
    assert step.dtheta == pytest.approx([0.2, 1.0], abs=ROUNDING)
    assert step.costs == pytest.approx((0.0, 0.64), abs=ROUNDING)
    assert step.certificate.held_by == ((), ("speed row 1",), ())


def test_a_soft_level_below_others_only_takes_what_they_leave():
    levels = [Level([[1.0, 1.0]], [2.0]), Level(np.eye(2), [0.5, 0.5], kind="at_most")]
    step = solve(IKProblem(levels, reference=[9.0, 0.0]))
    # Both exceed by a half: the one split of x + y = 2 whose squares are least.
    assert step.dtheta == pytest.approx([1.0, 1.0], abs=ROUNDING)


def test_the_closed_form_is_an_answer_only_if_it_keeps_the_soft_rows_too():
    free = solve(IKProblem([Level(np.eye(2), [1.0, 1.0]), Level([[1.0, 0.0]], [2.0], kind="at_most")]))
    held = solve(IKProblem([Level(np.eye(2), [1.0, 1.0]), Level([[1.0, 0.0]], [0.5], kind="at_most")]))
    assert (free.status, held.status) == (StepStatus.CLOSED_FORM, StepStatus.SOLVED)
    assert held.dtheta == pytest.approx([1.0, 1.0], abs=ROUNDING)


@pytest.mark.usefixtures("python_path")
@pytest.mark.parametrize("seed", range(10))
def test_a_certificate_is_that_of_the_step_alone(seed):
    known = random_hierarchy(seed)
    for polish in (True, False):
        options = SolveOptions(rank_tolerance=1e-7, closed_form_first=False, polish=polish)
        step = get_method("daqp").step(known.problem, options)
        if step.found:
            assert step.certificate == certify(known.problem, step.dtheta, 1e-7)
            assert (step.status is StepStatus.SOLVED) == step.certificate.holds


def test_a_closed_form_step_is_certified_without_a_solver():
    step = solve(free_steps()[0], options=CUT_AS_RECORDED)
    assert step.certificate.holds
    assert (step.raw, step.repairs) == (None, 0)


def test_a_polished_step_keeps_the_solvers_own():
    problem = constrained_steps()[0]
    raw, polished = (solve(problem, get_method("daqp"), options) for options in (RAW, QP_ONLY))
    assert np.array_equal(raw.raw, polished.raw)
    assert np.array_equal(raw.dtheta, raw.raw)
    assert not np.array_equal(polished.dtheta, polished.raw)


def test_the_damped_step_is_never_polished():
    problem = IKProblem([Level(np.eye(2), [1.0, 1.0])], Bounds([-0.5, -0.5], [0.5, 0.5]))
    step = solve(problem, "damped:daqp", SolveOptions(damping=0.5))
    assert np.array_equal(step.dtheta, step.raw)


class Whole(Guessing):
    """A method that guesses some step."""

    name, version = "whole", "0"

    def __init__(self, u: np.ndarray | None) -> None:
        self._u, self.seen = u, []

    def guess(self, hierarchy: Hierarchy, clock: Clock) -> np.ndarray | str:
        self.seen.append(hierarchy)
        clock.timed(lambda: StageResult(self._u, calls=7))
        return "whole gave up" if self._u is None else self._u


def test_a_method_that_guesses_is_asked_once_for_the_joint_step():
    method = Whole(np.array([0.5, 0.5 - 1e-7]))
    step = method.step(BOXED, QP_ONLY)
    assert len(method.seen) == 1
    assert method.seen[0].problem.levels[0].name == "reach"
    assert (step.status, step.calls) == (StepStatus.SOLVED, 7)
    assert np.array_equal(step.raw, [0.5, 0.5 - 1e-7])
    assert np.array_equal(step.dtheta, [0.5, 0.5])


def test_a_method_that_gives_up_is_a_status_without_a_step():
    step = Whole(None).step(BOXED, QP_ONLY)
    assert (step.status, step.dtheta, step.message) == (StepStatus.NOT_FOUND, None, "whole gave up")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"damping": -1.0}, "damping is -1.0; expected a finite number of at least 0"),
        ({"rank_tolerance": 1.0}, "rank_tolerance is 1.0; expected a number above 0 and below 1"),
        ({"rank_tolerance": -1e-4}, "rank_tolerance is -0.0001; expected a finite number of at least 0"),
        ({"accuracy": 1.0}, "accuracy is 1.0; expected a number above 0 and below 1"),
    ],
    ids=["damping", "rank of one", "negative rank", "accuracy"],
)
def test_options_out_of_range_are_refused(values, message):
    with pytest.raises(InputError, match=message):
        SolveOptions(**values)


def test_the_times_of_a_solve_are_inside_and_outside_the_backend_and_of_the_polish():
    step = solve(constrained_steps()[0], "daqp", QP_ONLY)
    assert min(step.timings.build, step.timings.solve, step.timings.polish) > 0.0
    assert step.timings.total == step.timings.build + step.timings.solve + step.timings.polish


# Damped levels.


def damped_least_squares(level: Level, metric: np.ndarray) -> np.ndarray:
    """What the damped level reaches alone: (AᵀWA + δM)⁻¹ AᵀW b."""
    weighted = level.matrix.T * level.weights
    return np.linalg.solve(weighted @ level.matrix + level.damping * np.diag(metric), weighted @ level.target)


def damped_problem(seed: int, below: str) -> IKProblem:
    """A damped level with a weak direction, and a posture below it, in a metric of its own."""
    rng = np.random.default_rng(seed)
    matrix = np.linalg.qr(rng.normal(size=(6, 3)))[0].T * np.array([[1.0], [0.3], [1e-3]])
    reach = Level(matrix, rng.normal(size=3), rng.uniform(0.5, 2.0, 3), "reach", damping=1e-2, below=below)
    return IKProblem([reach, Level(np.eye(6), rng.normal(size=6), name="posture")], metric=rng.uniform(0.3, 3.0, 6))


@pytest.mark.parametrize("seed", SEEDS)
def test_a_damped_level_reaches_what_damped_least_squares_reaches(seed):
    for below in ("free", "hold"):
        problem = damped_problem(seed, below)
        reach = problem.levels[0]
        wanted = reach.matrix @ damped_least_squares(reach, problem.metric)
        step = solve(problem)
        assert reach.matrix @ step.dtheta == pytest.approx(wanted, abs=EXACT)
        # The damping is felt: undamped, the weak direction would be met, by a step a hundred times as long.
        assert np.abs(wanted - reach.target).max() > 1e-2


@pytest.mark.parametrize("seed", SEEDS)
def test_a_damped_level_leaves_those_below_every_motion_that_does_not_change_what_it_reaches(seed):
    problem = damped_problem(seed, "free")
    reach, posture = problem.levels
    start = damped_least_squares(reach, problem.metric)
    null = np.linalg.svd(reach.matrix)[2][3:].T
    wanted = start + null @ np.linalg.lstsq(null, posture.target - start)[0]
    assert solve(problem).dtheta == pytest.approx(wanted, abs=EXACT)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_damped_level_that_holds_leaves_nothing_to_those_below(seed):
    problem = damped_problem(seed, "hold")
    step = solve(problem)
    assert step.dtheta == pytest.approx(damped_least_squares(problem.levels[0], problem.metric), abs=EXACT)


@pytest.mark.parametrize("below", ["free", "hold"])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_damped_level_under_bounds_is_bounded_least_squares_of_its_rows_and_its_damping(seed, below):
    rng = np.random.default_rng(seed)
    reach = Level(rng.normal(size=(3, 5)), 3.0 * rng.normal(size=3), rng.uniform(0.5, 2.0, 3), damping=0.1, below=below)
    roots = np.sqrt(reach.weights)
    stacked = np.vstack([roots[:, None] * reach.matrix, np.sqrt(0.1) * np.eye(5)])
    wanted = scipy.optimize.lsq_linear(
        stacked, np.append(roots * reach.target, np.zeros(5)), (-0.3, 0.3), method="bvls", tol=1e-15
    ).x
    step = solve(IKProblem([reach], Bounds([-0.3] * 5, [0.3] * 5)))
    assert reach.matrix @ step.dtheta == pytest.approx(reach.matrix @ wanted, abs=EXACT)
    if below == "hold":
        assert step.dtheta == pytest.approx(wanted, abs=EXACT)


@pytest.mark.parametrize("below", ["free", "hold"])
def test_a_damped_level_under_another_does_not_disturb_it(below):
    levels = [Level([[1.0, 1.0, 0.0]], [0.7]), Level([[1.0, -1.0, 0.0]], [3.0], damping=2.0, below=below)]
    # With x = 0.35 + s and y = 0.35 - s: (2 s - 3)² + 2 (0.245 + 2 s²) is least at s = 3/4.
    step = solve(IKProblem([*levels, Level([[0.0, 0.0, 1.0]], [0.5])]))
    assert step.dtheta == pytest.approx([1.1, -0.4, 0.5 if below == "free" else 0.0], abs=EXACT)


def test_costs_of_a_damped_level_are_those_of_its_own_target():
    problem = damped_problem(0, "free")
    step = solve(problem)
    costs = [level.cost(step.dtheta) for level in problem.levels]  # the core sums in another order
    np.testing.assert_allclose(step.costs, costs, rtol=ROUNDING)


@pytest.mark.parametrize("undecided", [0.0, 1e-9, 1e-3])
def test_a_step_is_no_surer_than_the_damped_optimum_that_it_asks_for(undecided, monkeypatch):
    problem, solved = damped_problem(0, "free"), lexicographic._undamped_step

    def less_sure(asked, *others):
        step = solved(asked, *others)
        if any(level.damping for level in asked.levels):  # the optimum that is handed down, its damping as rows
            found = step.certificate
            step = replace(step, certificate=replace(found, rounding=tuple(max(one, undecided) for one in found.rounding)))
        return step

    sure = solve(problem)
    monkeypatch.setattr(lexicographic, "_undamped_step", less_sure)
    step = solve(problem)
    assert step.certificate.variation == max(sure.certificate.variation, undecided)
    assert (step.status is StepStatus.UNCERTIFIED) == (undecided > 1e-6)
    assert np.array_equal(step.dtheta, sure.dtheta)


# Arguments in the wrong place: an error also where no row binds and the solver is never called.


@pytest.mark.parametrize("target", [[0.1, 0.2], [0.9, 2.0]], ids=["free", "bound"])
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((Bounds([-0.05] * 3, [0.05] * 3),), r"solver is of type Bounds; .*limits belong into the IKProblem"),
        ((SolveOptions(accuracy=1e-6),), r"solver is .*SolveOptions.*options into options="),
        ((None,), "solver is None"),
        (("daqp", {"accuracy": 1e-6}), "options is .*dict.*; expected SolveOptions"),
    ],
    ids=["limits as solver", "options as solver", "no solver", "options as a dictionary"],
)
def test_what_is_handed_over_in_the_wrong_place_is_refused_by_name(target, arguments, message):
    level = Level([[1.0, 0.5, 0.2], [0.0, 1.0, 0.3]], target)
    with pytest.raises(InputError, match=message):
        solve(IKProblem([level], Bounds([-1.0] * 3, [1.0] * 3)), *arguments)


def test_levels_in_place_of_a_problem_are_refused():
    with pytest.raises(InputError, match="expected an IKProblem, with its levels and limits"):
        solve([Level([[1.0, 0.5]], [0.1])])


# Small inputs of many kinds, each with the answer that it has by hand or by another way.

FEW = ("active-set", "daqp", "quadprog", "proxqp", "clarabel")


@pytest.mark.parametrize("solver", FEW)
@pytest.mark.parametrize(
    "nothing",
    [
        Level([[0.0, 0.0]], [-1.0], kind="at_most"),
        Level([[0.0, 0.0]], [1.0], kind="at_most"),
        Level([[0.0, 0.0]], [1.0]),
        Level(np.zeros((0, 2)), []),
        Level([[1.0, 1.0]], [5.0], [0.0]),
        Level([[1.0, 1.0]], [np.inf], kind="at_most"),
    ],
    ids=["broken zeros", "kept zeros", "zeros out of reach", "no row", "no weight", "no side"],
)
def test_a_level_that_no_step_changes_leaves_the_others_alone(nothing, solver):
    soft = Level([[1.0, 0.0]], [-1.0], kind="at_most")
    for levels in ([nothing, soft], [soft, nothing], [nothing, nothing, soft]):
        step = solve(IKProblem(levels), solver)
        assert step.certificate.holds
        assert step.dtheta == pytest.approx([-1.0, 0.0], abs=ROUNDING)


@pytest.mark.parametrize("solver", ["active-set", "daqp"])
def test_a_problem_of_no_levels_is_the_step_nearest_to_the_reference(solver):
    problem = IKProblem([], Bounds([-1.0, -1.0], [0.5, 1.0]), reference=[2.0, 0.3])
    assert solve(problem, solver).dtheta == pytest.approx([0.5, 0.3], abs=ROUNDING)


@pytest.mark.parametrize("room", [1e4, 1e5, 1e6])
@pytest.mark.parametrize("slope", [2.9e-7, 3.1e-7])
def test_another_joint_makes_room_for_a_level_however_little_of_it_is_in_the_row(slope, room):
    # x <= slope · y, and y up to `room` costs level 1 nothing.
    bounds, rows = Bounds([-1.0, -room], [1.0, room]), Rows([[1.0, -slope]], [0.0])
    step = solve(IKProblem([Level([[1.0, 0.0]], [0.3])], bounds, rows))
    assert step.certificate.holds
    assert np.sqrt(step.costs[0]) == pytest.approx(max(0.0, 0.3 - slope * room), abs=EXACT)


@pytest.mark.parametrize("seed", range(20))
def test_frozen_joints_stay_and_the_others_are_bounded_least_squares(seed):
    rng = np.random.default_rng(seed)
    m = int(rng.integers(6, 10))
    moving = np.sort(rng.choice(m, int(rng.integers(1, 7)), replace=False))
    limit = np.zeros(m)
    limit[moving] = 0.1
    matrix, target = rng.normal(size=(6, m)), 0.2 * rng.normal(size=6)
    wanted = np.zeros(m)
    among = (-limit[moving], limit[moving])
    wanted[moving] = scipy.optimize.lsq_linear(matrix[:, moving], target, among, method="bvls", tol=1e-15).x
    for solver in FEW:
        step = solve(IKProblem([Level(matrix, target)], Bounds(-limit, limit)), solver)
        assert step.certificate.holds, solver
        assert norm_error(step.dtheta, wanted) <= EXACT, solver


@pytest.mark.parametrize("cost", [1e-2, 1e-3, 1e-4, 1e-5, 1e-6])
def test_a_weak_posture_among_the_rows_of_a_level_decides_what_the_others_leave(cost):
    rng = np.random.default_rng(0)
    matrix, target, posture = rng.normal(size=(3, 7)), np.array([0.02, -0.01, 0.03]), 0.1 * rng.normal(size=7)
    # By hand of the null space: least squares in it, and of order cost² elsewhere.
    null = np.linalg.svd(matrix)[2][3:]
    rows = Level(np.vstack([matrix, cost * np.eye(7)]), np.concatenate([target, cost * posture]))
    weights = Level(np.vstack([matrix, np.eye(7)]), np.concatenate([target, posture]), [1.0] * 3 + [cost**2] * 7)
    for level in (rows, weights):
        step = solve(IKProblem([level]))
        assert step.certificate.holds
        assert null @ step.dtheta == pytest.approx(null @ posture, rel=1e-6)
        assert matrix @ step.dtheta == pytest.approx(target, abs=cost**2)


def test_steps_scale_with_the_time_step():
    def problem(seed: int, dt: float) -> IKProblem:
        rng = np.random.default_rng(seed)
        tool = Level(rng.normal(size=(4, 7)), 0.3 * dt * rng.normal(size=4))
        limit, rest = rng.uniform(0.02, 0.3, 7) * dt, 0.2 * dt * rng.normal(size=7)
        rows = Rows(rng.normal(size=(2, 7)), dt * rng.uniform(0.0, 0.1, 2))
        return IKProblem([tool, Level(np.eye(7), rest)], Bounds(-limit, limit), rows)

    for seed in range(10):
        wanted = solve(problem(seed, 1.0)).dtheta
        for dt in (1e-2, 1e-4, 1e-6, 1e-12):
            for solver in FEW:
                step = solve(problem(seed, dt), solver)
                assert step.certificate.holds
                assert norm_error(step.dtheta, dt * wanted) <= EXACT


@pytest.mark.parametrize("decades", [2, 4, 6, 8])
def test_weights_however_far_apart_are_nearly_two_levels_and_no_obstacle(decades):
    rng = np.random.default_rng(0)
    for _ in range(10):
        matrix, target = rng.normal(size=(8, 6)), 0.1 * rng.normal(size=8)
        weights = np.where(np.arange(8) < 3, 10.0**decades, 10.0**-decades)
        bounds = Bounds([-0.03] * 6, [0.03] * 6)
        problem = IKProblem([Level(matrix, target, weights)], bounds)
        step = solve(problem)
        (level,) = problem.levels
        two = solve(IKProblem([Level(matrix[:3], target[:3]), Level(matrix[3:], target[3:])], bounds))
        assert level.cost(step.dtheta) <= level.cost(two.dtheta) + step.certificate.gaps[0] + ROUNDING * level.demand**2
        if decades == 8:
            continue  # sixteen decades apart is all that doubles have: some are said to be undecided, or unproven
        assert step.certificate.is_optimal
        # Better by the lighter rows than two levels, so worse by the heavier ones by no more than that weighs.
        heavy = float(np.sum((matrix[:3] @ step.dtheta - target[:3]) ** 2))
        # What the certificate leaves open is in the level's units, in which the heavier rows weigh 10**decades.
        unproven = step.certificate.gaps[0] * 10.0**-decades
        weighed = 10.0 ** (-2 * decades) * two.costs[1]
        assert heavy <= two.costs[0] * (1.0 + ROUNDING) + weighed + unproven + ROUNDING**2
        for solver in FEW:  # some give up on such weights; none may answer otherwise
            other = get_method(solver).step(problem, SolveOptions())
            if other.found and other.certificate.holds:
                assert other.dtheta.tobytes() == step.dtheta.tobytes(), solver


@pytest.mark.parametrize("solver", FEW)
def test_rows_that_are_rounding_are_no_rows(solver):
    noise, want = [[3e-18, 1e-17]], Level(np.eye(2), [0.1, 0.2])
    for problem in (
        IKProblem([want], rows=Rows(noise, [0.0])),
        IKProblem([want], equalities=Equalities(noise, [0.0])),
        IKProblem([want], equalities=Equalities(noise, [1e-17])),
        IKProblem([Level(noise, [0.0], kind="at_most"), want]),
        IKProblem([Level(noise, [0.0]), want]),
        IKProblem([Level(noise, [0.01]), want]),
    ):
        step = solve(problem, solver, QP_ONLY)
        assert step.certificate.holds
        assert step.dtheta == pytest.approx([0.1, 0.2], abs=ROUNDING)
        assert len(step.zeros) == 1


def test_an_equality_and_a_row_that_say_the_same_to_eight_digits_have_one_answer():
    rng = np.random.default_rng(4)
    a = 0.1 * rng.normal(size=6)
    rows = Rows([np.round(a, 8)], [-0.01045375 - 3e-8], ["limit"])
    equalities = Equalities([np.round(-2.7182818 * a, 8)], [0.01045375 * 2.7182818], ["hold"])
    problem = IKProblem([Level(np.eye(6), rng.normal(size=6))], rows=rows, equalities=equalities)
    answers = set()
    for solver in FEW:
        step = get_method(solver).step(problem, SolveOptions())
        if step.status is StepStatus.INFEASIBLE:
            answers.add(step.conflict.names)
        else:
            assert step.status is not StepStatus.UNCERTIFIED or not step.certificate.is_optimal
            answers.add(step.dtheta.tobytes())
    assert len(answers) == 1
