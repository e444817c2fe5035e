import itertools

import numpy as np
import pytest
import scipy.optimize
from winding_fixtures import QP_ONLY, constrained_steps, free_steps

from prioritized_ik.errors import InputError, StepNotFoundError
from prioritized_ik.problem import Bounds, IKProblem, Level, Rows
from prioritized_ik.solvers.backends import registry
from prioritized_ik.solvers.backends.protocol import StageResult
from prioritized_ik.solvers.backends.registry import get_backend
from prioritized_ik.solvers.closed_form import strict_solution
from prioritized_ik.solvers.lexicographic import ACCEPTED_VIOLATION, SolveOptions, _directions_left, joint_step, solve
from prioritized_ik.solvers.stages import Room, Stage
from prioritized_ik.solvers.step import StepStatus

EXACT = 1e-9  # answers of size 1 from a solver whose figures are at 1e-10 here

#: What the fold makes of a solver that needs the proximal point, relative to the step: the accuracy asked for. The proximal
#: point rests with up to 1e-10 left in y, which the rows of lower levels pass on a hundredfold.
ASKED = registry.ACCURACY
SEEDS = range(12)


def witness(problem: IKProblem) -> np.ndarray:
    """The lexicographic optimum by trying every set of rows as equalities: slow, and with nothing in common with stages.

    At every level the best of all feasible points is the least-squares point on the rows that hold on the whole face of
    optima, so it is among those tried.
    """
    g, h = problem.inequalities.matrix, problem.inequalities.upper
    m = problem.joint_count
    reference = Level(np.eye(m), problem.reference)
    matrix, side = np.zeros((0, m)), np.zeros(0)  # what the levels so far fix
    best = np.zeros(m)
    for level in (*problem.levels, reference):
        costs = []
        for count in range(min(m, len(h)) + 1):
            for rows in itertools.combinations(range(len(h)), count):
                chosen = list(rows)
                x = _least_squares_on(level, np.vstack([matrix, g[chosen]]), np.append(side, h[chosen]))
                if x is not None and (g @ x <= h + EXACT).all():
                    costs.append((level.cost(x), x))
        best = min(costs, key=lambda pair: pair[0])[1]
        matrix, side = np.vstack([matrix, level.matrix]), np.append(side, level.matrix @ best)
    return best


def _least_squares_on(level: Level, matrix: np.ndarray, side: np.ndarray) -> np.ndarray | None:
    """The least-norm optimum of `level` subject to matrix @ x = side, or None if there is no such x."""
    m = matrix.shape[1]
    start, free = np.zeros(m), np.eye(m)
    if len(matrix):
        start = np.linalg.lstsq(matrix, side, rcond=1e-9)[0]
        if np.abs(matrix @ start - side).max() > EXACT:
            return None
        _, s, vt = np.linalg.svd(matrix)
        free = vt[np.count_nonzero(s > 1e-9) :].T
    root = np.sqrt(level.weights)[:, None]
    a, b = root * level.matrix @ free, root[:, 0] * (level.target - level.matrix @ start)
    return start + free @ np.linalg.lstsq(a, b, rcond=1e-9)[0] if free.shape[1] else start


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


@pytest.mark.parametrize("seed", SEEDS)
def test_a_problem_built_backwards_from_its_optimum_is_solved(seed):
    problem, optimum = built_backwards(seed)
    step = solve(problem, "proxqp", QP_ONLY)
    assert step.status is StepStatus.SOLVED
    assert step.dtheta == pytest.approx(optimum, abs=EXACT)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_problem_built_backwards_is_solved_by_the_default_solver_to_the_accuracy_asked(seed):
    problem, optimum = built_backwards(seed)
    assert np.linalg.norm(solve(problem).dtheta - optimum) <= ASKED * np.linalg.norm(optimum)


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
    optimum = witness(problem)
    assert solve(problem, "proxqp", QP_ONLY).dtheta == pytest.approx(optimum, abs=EXACT)
    assert np.linalg.norm(solve(problem, "daqp", QP_ONLY).dtheta - optimum) <= ASKED * np.linalg.norm(optimum)


def test_the_random_problems_bind_rows_at_every_number_of_levels():
    for levels in (1, 2, 3):
        assert sum(bool(solve(random_problem(seed, levels)).tight_rows) for seed in SEEDS) >= 6


@pytest.mark.parametrize("seed", SEEDS)
def test_bounded_least_squares_of_full_rank_is_scipys(seed):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(8, 5)), 3.0 * rng.normal(size=8)
    lower, upper = -rng.uniform(0.1, 1.0, 5), rng.uniform(0.1, 1.0, 5)
    oracle = scipy.optimize.lsq_linear(a, b, (lower, upper), method="bvls", tol=1e-15).x
    step = solve(IKProblem([Level(a, b)], Bounds(lower, upper)), "daqp", QP_ONLY)
    assert step.dtheta == pytest.approx(oracle, abs=EXACT)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_second_level_does_not_raise_the_firsts_cost(seed):
    both = random_problem(seed, 2)
    alone = solve(IKProblem(both.levels[:1], both.bounds, both.rows, both.reference), "daqp", QP_ONLY)
    first, _ = solve(both, "daqp", QP_ONLY).costs
    assert first <= alone.costs[0] + EXACT


@pytest.mark.parametrize("seed", SEEDS)
def test_the_second_level_gains_over_leaving_its_directions_to_the_reference(seed):
    both = random_problem(seed, 2)
    alone = solve(IKProblem(both.levels[:1], both.bounds, both.rows, both.reference), "daqp", QP_ONLY)
    assert solve(both, "daqp", QP_ONLY).costs[1] <= both.levels[1].cost(alone.dtheta) + EXACT


def test_the_reference_is_met_in_the_free_directions_and_nowhere_else():
    problem = IKProblem([Level([[1.0, 0.0, 0.0]], [0.5])], reference=[9.0, 0.3, -0.2])
    for options in (SolveOptions(), QP_ONLY):
        assert solve(problem, "daqp", options).dtheta == pytest.approx([0.5, 0.3, -0.2], abs=EXACT)


def test_the_reference_stops_at_a_bound():
    problem = IKProblem([Level([[1.0, 0.0]], [0.5])], Bounds([-1.0, -1.0], [1.0, 0.1]), reference=[0.0, 0.3])
    step = solve(problem)
    assert step.dtheta == pytest.approx([0.5, 0.1], abs=EXACT)
    assert step.tight_rows == ("joint 2 upper",)


def test_a_closed_form_that_meets_every_row_is_the_answer_bit_for_bit():
    for problem in free_steps():
        step = solve(problem)
        assert (step.status, step.calls) == (StepStatus.CLOSED_FORM, 0)
        assert step.dtheta.tobytes() == strict_solution(problem.levels, problem.reference).tobytes()


def test_the_closed_form_is_no_answer_where_it_breaks_a_row():
    for problem in constrained_steps():
        step = solve(problem)
        assert step.status is StepStatus.SOLVED
        assert step.calls >= 2  # the level's stage and the last


def test_without_the_closed_form_first_the_solver_finds_the_same_step():
    for problem in free_steps():
        step, wanted = solve(problem, "daqp", QP_ONLY), strict_solution(problem.levels, problem.reference)
        assert step.status is StepStatus.SOLVED
        assert step.dtheta == pytest.approx(wanted, abs=1e-9 * np.linalg.norm(wanted))


def test_trying_the_closed_form_first_does_not_change_a_constrained_step():
    for problem in constrained_steps():
        assert solve(problem).dtheta.tobytes() == solve(problem, "daqp", QP_ONLY).dtheta.tobytes()


def test_costs_are_those_of_every_level_at_the_step():
    problem = random_problem(0, 3)
    step = solve(problem)
    assert step.costs == tuple(level.cost(step.dtheta) for level in problem.levels)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_damped_formulation_is_the_damped_least_squares_step_where_nothing_binds(seed):
    rng = np.random.default_rng(seed)
    a, b, reference = rng.normal(size=(3, 5)), rng.normal(size=3), rng.normal(size=5)
    step = solve(IKProblem([Level(a, b)], reference=reference), "daqp", SolveOptions("damped", damping=1e-2))
    wanted = np.linalg.solve(a.T @ a + 1e-2 * np.eye(5), a.T @ b + 1e-2 * reference)
    assert step.dtheta == pytest.approx(wanted, abs=EXACT)
    assert step.calls == 1


def test_the_damped_formulation_refuses_a_second_level():
    with pytest.raises(InputError, match="use 'lexicographic'"):
        solve(random_problem(0, 2), "daqp", SolveOptions("damped"))


def left(rows: list[list[float]], slack: float = 0.0) -> int:
    """How many of three directions the tight `rows` leave."""
    return _directions_left(Room(np.zeros(3), np.eye(3), np.array(rows), np.full(len(rows), slack))).shape[1]


CONES = {
    "no row": (np.zeros((0, 3)), 3),
    "one row": ([[1.0, 0.0, 0.0]], 3),
    "a wedge": ([[1.0, 0.0, 0.0], [-1.0, 0.1, 0.0]], 3),
    "two antiparallel rows": ([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]], 2),
    "of unequal lengths": ([[1e3, 0.0, 0.0], [-1e-2, 0.0, 0.0]], 2),
    "and one beside them": ([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], 2),
    "three rows that cancel": ([[1.0, 0.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0]], 1),
    "two that cancel once two others have": (
        [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.5, 1.0, 0.0], [0.7, -1.0, 0.0]],
        1,
    ),
    "a corner that is a point": ([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [-1.0, -1.0, -1.0]], 0),
}


@pytest.mark.parametrize(("rows", "dimension"), CONES.values(), ids=CONES.keys())
def test_tight_rows_leave_the_directions_of_their_cone(rows, dimension):
    assert left(rows) == dimension


def test_rows_that_are_not_tight_leave_every_direction():
    assert left([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]], slack=1e-3) == 3


def test_the_directions_left_are_orthonormal_and_move_no_cancelling_row():
    rows = np.array([[1.0, 2.0, 0.5], [-1.0, -2.0, -0.5]])
    free = _directions_left(Room(np.zeros(3), np.eye(3), rows, np.zeros(2)))
    assert free.T @ free == pytest.approx(np.eye(2), abs=1e-15)
    assert np.abs(rows @ free).max() <= 1e-15


def test_a_level_that_presses_into_a_corner_leaves_the_thin_direction_fixed():
    # At x = 1 the two rows leave y no room on either side, and z is the reference's.
    rows = Rows([[1.0, 1.0, 0.0], [1.0, -1.0, 0.0]], [1.0, 1.0])
    step = solve(IKProblem([Level([[1.0, 0.0, 0.0]], [5.0])], rows=rows, reference=[0.0, 0.7, -0.4]))
    assert step.dtheta == pytest.approx([1.0, 0.0, -0.4], abs=EXACT)


def test_a_joint_that_is_locked_by_its_bounds_stays():
    step = solve(IKProblem([Level([[1.0, 1.0]], [1.0])], Bounds([0.0, -2.0], [0.0, 2.0])), "daqp", QP_ONLY)
    assert step.dtheta == pytest.approx([0.0, 1.0], abs=EXACT)


class FakeBackend:
    """Answers every stage with what `answer` makes of it."""

    name, version = "fake", "0"

    def __init__(self, answer):
        self._answer = answer

    def solve(self, stage: Stage) -> StageResult:
        return self._answer(stage)


@pytest.fixture
def fake(monkeypatch):
    """Register a backend called "fake" for one test."""
    monkeypatch.setattr(registry, "_factories", {})

    def register(answer):
        registry.register("fake", lambda accuracy: FakeBackend(answer))

    return register


BOXED = IKProblem([Level(np.eye(2), [1.0, 1.0], name="reach")], Bounds([-0.5, -0.5], [0.5, 0.5]))


def refuse(stage: Stage) -> StageResult:
    return StageResult(None, "fake found no solution")


def jump(stage: Stage) -> StageResult:
    return StageResult(np.full(stage.size, 100.0))


def test_a_registered_backend_is_known_installed_and_asked(fake):
    fake(refuse)
    assert "fake" in registry.known_solvers()
    assert "fake" in registry.installed_solvers()
    assert isinstance(get_backend("fake"), FakeBackend)


def test_a_registered_backend_is_given_the_accuracy(fake):
    fake(refuse)
    seen = []
    registry.register("fake", seen.append)
    get_backend("fake", 1e-5)
    assert seen == [1e-5]


def test_an_answer_that_is_not_found_is_a_status_without_a_step(fake):
    fake(refuse)
    step = joint_step(BOXED, get_backend("fake"), QP_ONLY)
    assert (step.status, step.dtheta, step.found) == (StepStatus.NOT_FOUND, None, False)
    assert step.message == "level 'reach': fake found no solution"


def test_a_failure_of_the_last_level_is_named_so(fake):
    fake(lambda stage: refuse(stage) if stage.costed == stage.size else StageResult(-stage.problem.q))
    problem = IKProblem([Level([[1.0, 0.0]], [0.1])], Bounds([-0.5, -0.5], [0.5, 0.5]))
    assert joint_step(problem, get_backend("fake"), QP_ONLY).message == "last level: fake found no solution"


def test_a_step_that_breaks_a_row_is_not_handed_out(fake):
    fake(jump)
    step = joint_step(BOXED, get_backend("fake"), QP_ONLY)
    assert (step.status, step.dtheta) == (StepStatus.VIOLATED, None)
    assert step.violation > ACCEPTED_VIOLATION
    assert "worst relative violation" in step.message


@pytest.mark.parametrize("fraction", [0.5, 2.0])
def test_a_step_may_break_a_row_by_the_accepted_fraction_only(fake, fraction):
    # x = 0 is not an answer of dθ = 0 alone: the basis turns the wanted joint step into variables.
    wanted = np.full(2, 0.5) * (1.0 + fraction * ACCEPTED_VIOLATION * np.sqrt(2.0))
    fake(lambda stage: StageResult(np.linalg.solve(stage.basis, wanted)))
    assert joint_step(BOXED, get_backend("fake"), QP_ONLY).found == (fraction < 1.0)


def test_calls_of_all_stages_are_counted(fake):
    fake(lambda stage: StageResult(np.zeros(stage.size), calls=3))
    problem = IKProblem([Level([[1.0, 0.0]], [0.1])], Bounds([-0.5, -0.5], [0.5, 0.5]))
    assert joint_step(problem, get_backend("fake"), QP_ONLY).calls == 6


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
        solve(BOXED, "fake", QP_ONLY)
    assert caught.value.step.violation > 0.1


def test_rows_without_a_common_point_are_a_failure_and_not_a_step():
    problem = IKProblem([Level([[1.0, 0.0]], [5.0])], rows=Rows([[1.0, 0.0], [-1.0, 0.0]], [-1.0, -1.0]))
    with pytest.raises(StepNotFoundError, match=r"^daqp"):
        solve(problem)
