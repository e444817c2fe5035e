"""The slack QP has the optimum of the damped one, without the square of its matrix, and is solved as it stands."""

import numpy as np
import pytest
from winding_fixtures import constrained_steps, free_steps

from comparisons.cases import cases_of
from comparisons.jobs import replays
from comparisons.settings import ComparisonSettings
from prioritized_ik.errors import InputError
from prioritized_ik.problem import Bounds, Equalities, IKProblem, Level, Rows
from prioritized_ik.solvers.backends import qpsolvers_
from prioritized_ik.solvers.backends.qpsolvers_ import QpsolversBackend
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.solvers.solve import solve
from prioritized_ik.solvers.stages import damped_stage, slack_stage
from prioritized_ik.solvers.step import StepStatus
from prioritized_ik.winding.episode import Outcome, wind
from prioritized_ik.winding.settings import WindingSettings

DAMPING = 1e-2  # large enough for the square of the matrix to lose nothing
ROUNDING = 1e-9  # relative: systems of condition 1e5 at most


def random_problem(seed: int, *, rows: bool = True, equalities: int = 0) -> IKProblem:
    """Six joints and a level of four rows and rank three; dθ = 0 keeps all inequalities strictly."""
    rng = np.random.default_rng(seed)
    level = Level(rng.normal(size=(4, 3)) @ rng.normal(size=(3, 6)), rng.normal(size=4), rng.uniform(0.1, 20.0, 4))
    return IKProblem(
        [level],
        Bounds(-rng.uniform(0.05, 0.4, 6), np.append(rng.uniform(0.05, 0.4, 5), np.inf)) if rows else None,
        Rows(rng.normal(size=(3, 6)), rng.uniform(0.01, 0.3, 3)) if rows else None,
        rng.normal(scale=0.1, size=6),
        Equalities(rng.normal(size=(equalities, 6)), 0.05 * rng.normal(size=equalities)) if equalities else None,
    )


def dense_kkt(problem: IKProblem, damping: float, tight: np.ndarray) -> np.ndarray:
    """The damped optimum `(m,)` with rows `tight` as equalities, by one dense solve of its conditions."""
    (level,), rows, fixed = problem.levels, problem.inequalities, problem.equalities
    c = np.vstack([rows.matrix[tight], fixed.matrix])
    d = np.concatenate([rows.upper[tight], fixed.target])
    w = np.diag(level.weights)
    hessian = level.matrix.T @ w @ level.matrix + damping * np.eye(problem.joint_count)
    right = level.matrix.T @ w @ level.target + damping * problem.reference
    kkt = np.block([[hessian, c.T], [c, np.zeros((len(c), len(c)))]])
    return np.linalg.solve(kkt, np.concatenate([right, d]))[: problem.joint_count]


def by(formulation: str, problem: IKProblem, solver: str = "quadprog", damping: float = DAMPING) -> np.ndarray:
    method = get_method(f"{formulation}:{solver}")
    stage = method.stage(problem, SolveOptions(damping=damping))
    x = method.backend.solve_once(stage).x
    assert x is not None
    return stage.dtheta(x)


CASES = [(seed, rows, equalities) for seed in range(4) for rows in (True, False) for equalities in (0, 1)]


@pytest.mark.parametrize(("seed", "rows"), [case[:2] for case in CASES if not case[2]])
def test_the_slack_qp_has_the_optimum_of_the_damped_one(seed, rows):
    problem = random_problem(seed, rows=rows)
    slack, damped = by("slack", problem), by("damped", problem)
    assert slack == pytest.approx(damped, abs=ROUNDING * np.linalg.norm(damped))


@pytest.mark.parametrize(("seed", "rows", "equalities"), CASES)
def test_the_slack_qp_has_the_optimum_of_a_dense_kkt_solve_with_its_tight_rows(seed, rows, equalities):
    problem = random_problem(seed, rows=rows, equalities=equalities)
    found = by("slack", problem)
    gaps = problem.inequalities.upper - problem.inequalities.matrix @ found
    tight = np.flatnonzero(gaps < 1e-8)
    assert bool(len(tight)) is rows  # the problems with rows have some that bind
    truth = dense_kkt(problem, DAMPING, tight)
    assert found == pytest.approx(truth, abs=ROUNDING * np.linalg.norm(truth))
    wrong = dense_kkt(problem, 1.01 * DAMPING, tight)
    if problem.joint_count > len(tight) + equalities + 3:
        assert np.linalg.norm(wrong - truth) > 1e3 * ROUNDING * np.linalg.norm(truth)


def test_the_hessian_is_diagonal_and_the_level_stands_in_the_equality_rows():
    problem = random_problem(0, equalities=2)
    (level,) = problem.levels
    stage = slack_stage(problem, level, 1e-3)
    qp = stage.problem
    assert np.array_equal(qp.P, np.diag(np.concatenate([np.full(6, 1e-3), level.weights])))
    assert np.array_equal(qp.A[:4], np.hstack([level.matrix, np.eye(4)]))
    assert np.array_equal(qp.A[4:], np.hstack([problem.equalities.matrix, np.zeros((2, 4))]))
    assert np.array_equal(qp.b, np.concatenate([level.target, problem.equalities.target]))
    assert np.array_equal(qp.G, np.hstack([problem.inequalities.matrix, np.zeros((len(qp.h), 4))]))
    assert np.array_equal(stage.dtheta(np.arange(10.0)), np.arange(6.0))


def test_without_rows_there_are_only_the_equality_rows():
    problem = random_problem(0, rows=False)
    qp = slack_stage(problem, problem.levels[0], 1e-3).problem
    assert (qp.G, qp.h, qp.lb, qp.ub) == (None, None, None, None)
    assert len(qp.b) == 4


@pytest.mark.parametrize("seed", range(3))
def test_at_a_feasible_point_both_qps_have_the_same_cost_up_to_a_constant(seed):
    problem = random_problem(seed)
    (level,) = problem.levels
    slack, damped = (make(problem, level, DAMPING).problem for make in (slack_stage, damped_stage))
    gaps = []
    for dtheta in np.random.default_rng(seed).normal(size=(10, 6)):
        x = np.concatenate([dtheta, level.target - level.matrix @ dtheta])
        assert slack.A @ x == pytest.approx(slack.b, abs=ROUNDING)
        values = (0.5 * v @ qp.P @ v + qp.q @ v for qp, v in ((slack, x), (damped, dtheta)))
        gaps.append(next(values) - next(values))
    assert np.ptp(gaps) <= ROUNDING * level.cost(np.zeros(6))


def test_a_damping_too_weak_for_the_square_of_the_matrix_still_decides_in_the_slack_qp():
    # On free steps of the winding 1e-12 is lost in the rounding of JᵀWJ, whose largest entries are near 1e4.
    errors = {"damped": [], "slack": []}
    for problem in free_steps():
        hierarchy = Hierarchy(problem)
        for formulation, found in errors.items():
            off = by(formulation, hierarchy.cut_problem, damping=1e-12) - hierarchy.closed_form
            found.append(np.linalg.norm(off) / np.linalg.norm(hierarchy.closed_form))
    assert np.median(errors["slack"]) <= 1e-8
    assert np.median(errors["damped"]) > 1e-6


@pytest.mark.parametrize(
    "solver", ["daqp", "quadprog", "cvxopt", "clarabel", "piqp", "ecos", "proxqp", "qpalm", "scs", "osqp"]
)
def test_every_kind_of_solver_takes_the_slack_qp_with_its_equality_rows(solver):
    problem = random_problem(1, equalities=1)
    truth = by("slack", problem)
    assert by("slack", problem, solver) == pytest.approx(truth, abs=1e-2 * np.linalg.norm(truth))  # default options


def test_the_slack_qp_is_solved_once_with_default_options(monkeypatch):
    exact, seen = qpsolvers_.qpsolvers.solve_problem, []

    def watched(problem, solver, **options):
        seen.append((problem, options))
        return exact(problem, solver, **options)

    monkeypatch.setattr(qpsolvers_.qpsolvers, "solve_problem", watched)
    stage = get_method("slack:proxqp").stage(constrained_steps()[0])
    assert QpsolversBackend("proxqp", 1e-8).solve_once(stage).calls == 1
    assert seen == [(stage.problem, {})]


def test_a_slack_step_keeps_the_rows_and_is_never_polished():
    problem = random_problem(2)
    step = solve(problem, "slack:quadprog", SolveOptions(damping=0.5))
    assert step.status is StepStatus.UNCERTIFIED  # it is another problem than the hierarchy's
    assert np.array_equal(step.dtheta, step.raw)
    assert problem.relative_violation(step.dtheta) <= 1e-9


def test_raw_is_the_damped_formulation_without_damping():
    problem = random_problem(3)
    (level,) = problem.levels
    qp = get_method("damped:quadprog").stage(problem, SolveOptions(damping=0.0)).problem
    assert np.linalg.matrix_rank(qp.P) == 3
    assert np.array_equal(qp.P, level.matrix.T @ (level.weights[:, None] * level.matrix))


@pytest.mark.parametrize("solver", ["daqp-warm", "osqp-warm", "proxqp-warm", "proxqp-sparse-warm"])
def test_native_backends_refuse_the_slack_qp(solver):
    with pytest.raises(InputError, match=f"{solver} takes no equality rows; the slack formulation needs a solver called"):
        get_method(f"slack:{solver}")


def test_the_slack_formulation_takes_one_equal_level_only():
    two = IKProblem([Level(np.eye(2), [1.0, 1.0]), Level(np.eye(2), [1.0, 0.0])])
    soft = IKProblem([Level(np.eye(2), [1.0, 1.0], kind="at_most")])
    for problem, said in ((two, "one level, not 2"), (soft, "a level of kind 'equal', not 'at_most'")):
        with pytest.raises(InputError, match=f"the slack formulation takes {said}; use 'lexicographic'"):
            get_method("slack:quadprog").stage(problem)


def test_the_arm_winds_by_the_slack_qp():
    settings = WindingSettings(solver="slack:quadprog", max_steps=5)
    episode = wind(settings)
    assert episode.outcome is Outcome.OUT_OF_STEPS
    assert WindingSettings.from_json(settings.to_json()) == settings


def test_the_comparison_replays_the_slack_qp_with_solvers_that_take_it():
    settings = ComparisonSettings(solvers=("daqp", "daqp-warm"), directions=("up",), formulations=("slack",))
    replayed = {(job.solver, job.formulation) for job in replays(settings, cases_of(settings))}
    assert {solver for solver, formulation in replayed if formulation == "slack"} == {"daqp"}
