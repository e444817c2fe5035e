from collections.abc import Callable

import numpy as np
import pytest
import qpsolvers

from prioritized_ik.solvers import refinement
from prioritized_ik.solvers.refinement import proximal_point, zoom_in
from prioritized_ik.solvers.stages import Stage

SHIFT = 1e-6  # the default of the table of abilities


class GaveUpError(Exception):
    pass


def stage_of(problem: qpsolvers.Problem, costed: int) -> Stage:
    """A stage of some QP in joint steps, of whose variables the first `costed` cost something."""
    v = len(problem.q)
    rows = 0 if problem.h is None else len(problem.h)
    return Stage(problem, np.zeros(v), np.eye(v), np.eye(v)[:, costed:], 0, np.arange(rows))


def quadprog(problem: qpsolvers.Problem) -> np.ndarray:
    """An exact solver that refuses Hessians that are not positive definite."""
    solution = qpsolvers.solve_problem(problem, solver="quadprog")
    if not solution.found:
        raise GaveUpError
    return solution.x


def semidefinite_stage(seed: int) -> tuple[Stage, np.ndarray]:
    """A stage with a semidefinite Hessian, built backwards from its optimum, which is returned with it.

    Three variables cost, two do not. Active rows come in pairs whose parts in the latter cancel, with equal multipliers.
    """
    rng = np.random.default_rng(seed)
    optimum = np.append(rng.normal(size=3), rng.normal(scale=3.0, size=2))
    pairs = []
    for direction in rng.normal(size=(2, 2)):
        pairs += [np.append(rng.normal(size=3), direction), np.append(rng.normal(size=3), -direction)]
    active, idle = np.array(pairs), rng.normal(size=(3, 5))
    multipliers = np.repeat(rng.uniform(0.5, 2.0, 2), 2)
    hessian = np.diag([1.0, 1.0, 1.0, 0.0, 0.0])
    linear = -hessian @ optimum - active.T @ multipliers
    linear[3:] = 0.0
    rows = np.vstack([active, idle])
    slack = np.append(np.zeros(4), rng.uniform(0.5, 1.0, 3))
    problem = qpsolvers.Problem(hessian, linear, rows, rows @ optimum + slack)
    return stage_of(problem, 3), optimum


def free_stage(target: np.ndarray) -> Stage:
    return stage_of(qpsolvers.Problem(np.eye(len(target)), -target), len(target))


def counted(solve_once: Callable[[qpsolvers.Problem], np.ndarray]) -> tuple[Callable, list[qpsolvers.Problem]]:
    seen: list[qpsolvers.Problem] = []

    def solve(problem: qpsolvers.Problem) -> np.ndarray:
        seen.append(problem)
        return solve_once(problem)

    return solve, seen


SEEDS = range(10)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_positive_definite_solver_alone_cannot_solve_a_semidefinite_stage(seed):
    stage, _ = semidefinite_stage(seed)
    with pytest.raises(qpsolvers.exceptions.ProblemError, match="not positive definite"):
        quadprog(stage.problem)


@pytest.fixture
def to_rest(monkeypatch):
    """Let the proximal point go on until it rests."""
    monkeypatch.setattr(refinement, "PROXIMAL_ROUNDS", 10)


@pytest.mark.usefixtures("to_rest")
@pytest.mark.parametrize("seed", SEEDS)
def test_the_proximal_point_rests_at_the_semidefinite_stages_optimum(seed):
    stage, optimum = semidefinite_stage(seed)
    x = proximal_point(stage, quadprog, SHIFT, GaveUpError)(stage.problem)
    assert x[:3] == pytest.approx(optimum[:3], abs=1e-9)
    assert (stage.problem.G @ x - stage.problem.h).max() <= 1e-9


@pytest.mark.parametrize("seed", SEEDS)
def test_the_proximal_point_as_it_is_and_one_zoom_find_the_semidefinite_stages_optimum(seed):
    stage, optimum = semidefinite_stage(seed)
    solve = proximal_point(stage, quadprog, SHIFT, GaveUpError)
    x = zoom_in(stage, solve(stage.problem), (1e-3,), solve, GaveUpError)
    assert x[:3] == pytest.approx(optimum[:3], abs=1e-9)
    assert (stage.problem.G @ x - stage.problem.h).max() <= 1e-9


@pytest.mark.parametrize("seed", SEEDS)
def test_one_round_with_a_large_shift_misses_the_optimum(seed, monkeypatch):
    monkeypatch.setattr(refinement, "PROXIMAL_ROUNDS", 1)
    stage, optimum = semidefinite_stage(seed)
    x = proximal_point(stage, quadprog, 1.0, GaveUpError)(stage.problem)
    assert np.abs(x[:3] - optimum[:3]).max() > 1e-3


def test_the_proximal_point_leaves_the_callers_problem_alone():
    stage, _ = semidefinite_stage(0)
    before = stage.problem.P.copy(), stage.problem.q.copy()
    proximal_point(stage, quadprog, SHIFT, GaveUpError)(stage.problem)
    assert np.array_equal(stage.problem.P, before[0])
    assert np.array_equal(stage.problem.q, before[1])


def test_a_stage_that_costs_every_variable_needs_no_proximal_point():
    assert proximal_point(free_stage(np.ones(2)), quadprog, SHIFT, GaveUpError) is quadprog


def test_the_proximal_point_stops_as_soon_as_it_rests():
    solve, seen = counted(quadprog)
    hessian = np.diag([1.0, 0.0])
    stage = stage_of(qpsolvers.Problem(hessian, np.array([-1.0, 0.0])), 1)
    assert proximal_point(stage, solve, SHIFT, GaveUpError)(stage.problem) == pytest.approx([1.0, 0.0], abs=1e-12)
    assert len(seen) == 1


def shifting_stage() -> Stage:
    """A stage whose uncosted variable has to go far, so that the proximal point takes more than one round."""
    rows, side = np.array([[1.0, -0.1]]), np.array([1.0])  # y = 2 needs z = 10
    return stage_of(qpsolvers.Problem(np.diag([1.0, 0.0]), np.array([-2.0, 0.0]), rows, side), 1)


def gives_up_from(call: int) -> Callable[[qpsolvers.Problem], np.ndarray]:
    calls = 0

    def solve(problem: qpsolvers.Problem) -> np.ndarray:
        nonlocal calls
        calls += 1
        if calls >= call:
            raise GaveUpError
        return quadprog(problem)

    return solve


def test_the_answer_so_far_stays_when_a_later_round_gives_up():
    stage = shifting_stage()
    _, seen = proximal_rounds(stage)
    assert len(seen) > 1
    x = proximal_point(stage, gives_up_from(2), SHIFT, GaveUpError)(stage.problem)
    assert x == pytest.approx(quadprog(seen[0]), abs=1e-12)


def proximal_rounds(stage: Stage) -> tuple[np.ndarray, list[qpsolvers.Problem]]:
    solve, seen = counted(quadprog)
    return proximal_point(stage, solve, SHIFT, GaveUpError)(stage.problem), seen


def test_a_first_round_that_gives_up_has_no_answer():
    stage = shifting_stage()
    with pytest.raises(GaveUpError):
        proximal_point(stage, gives_up_from(1), SHIFT, GaveUpError)(stage.problem)


@pytest.mark.usefixtures("to_rest")
def test_later_rounds_remove_what_the_shift_left():
    x, seen = proximal_rounds(shifting_stage())
    assert abs(quadprog(seen[0])[0] - 2.0) > 1e-5
    assert x[0] == pytest.approx(2.0, abs=1e-9)


def noisy(scale: float) -> Callable[[qpsolvers.Problem], np.ndarray]:
    """A solver whose answers are off by `scale`, in another direction each time."""
    rng = np.random.default_rng(0)

    def solve(problem: qpsolvers.Problem) -> np.ndarray:
        x = quadprog(problem)
        off = rng.normal(size=len(x))
        return x + scale * off / np.linalg.norm(off)

    return solve


TARGET = np.array([0.3, -1.2, 0.7])
NOISE = 1e-6


@pytest.mark.parametrize(("zooms", "error"), [((), 1e-6), ((1e-3,), 1e-9), ((1e-3, 1e-5), 1e-11)])
def test_each_zoom_brings_an_inexact_solvers_error_down_to_its_own_fraction(zooms, error):
    stage, solve = free_stage(TARGET), noisy(NOISE)
    x = zoom_in(stage, solve(stage.problem), zooms, solve, GaveUpError)
    assert 0.9 * error <= np.linalg.norm(x - TARGET) <= 1.1 * error


def test_zooming_keeps_to_the_rows():
    qp = qpsolvers.Problem(np.eye(3), -TARGET, np.array([[1.0, 0.0, 1.0]]), np.array([0.4]))
    stage, solve = stage_of(qp, 3), noisy(NOISE)
    x = zoom_in(stage, solve(qp), (1e-3, 1e-5), solve, GaveUpError)
    assert x == pytest.approx([0.0, -1.2, 0.4], abs=1e-10)


def test_zooming_stops_once_the_step_rests():
    solve, seen = counted(quadprog)
    stage = free_stage(TARGET)
    zoom_in(stage, solve(stage.problem), (1e-3, 1e-5, 1e-7), solve, GaveUpError)
    assert len(seen) == 2  # the solve itself, and one zoom that moved nothing


def test_zooming_solves_the_same_hessian_and_rows():
    solve, seen = counted(noisy(NOISE))
    stage, _ = semidefinite_stage(1)
    qp = qpsolvers.Problem(np.eye(5), stage.problem.q, stage.problem.G, stage.problem.h)
    zoom_in(stage_of(qp, 5), solve(qp), (1e-3,), solve, GaveUpError)
    assert np.array_equal(seen[1].P, qp.P)
    assert np.array_equal(seen[1].G, qp.G)


def test_the_answer_so_far_stays_when_a_refining_solve_gives_up():
    stage, solve = free_stage(TARGET), noisy(NOISE)
    first = solve(stage.problem)
    refused = 0

    def gives_up_later(problem: qpsolvers.Problem) -> np.ndarray:
        nonlocal refused
        refused += 1
        if refused == 2:
            raise GaveUpError
        return solve(problem)

    x = zoom_in(stage, first, (1e-3, 1e-5), gives_up_later, GaveUpError)
    assert refused == 2
    assert np.linalg.norm(x - TARGET) == pytest.approx(1e-9, rel=0.1)


def test_a_bug_in_a_refining_solve_passes_through():
    def broken(problem: qpsolvers.Problem) -> np.ndarray:
        raise KeyError("bug")

    with pytest.raises(KeyError):
        zoom_in(free_stage(TARGET), TARGET, (1e-3,), broken, GaveUpError)
