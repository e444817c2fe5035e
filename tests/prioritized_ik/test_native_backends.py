import subprocess
import sys
from dataclasses import replace

import daqp
import numpy as np
import osqp
import pytest
import qpsolvers
from winding_fixtures import AS_RECORDED, QP_ONLY, constrained_steps, free_steps, recorded

from prioritized_ik.errors import SolverUnavailableError
from prioritized_ik.problem import Bounds, Equalities, IKProblem, Level, Rows
from prioritized_ik.solvers import daqp_hierarchy
from prioritized_ik.solvers.backends import daqp_, osqp_, piqp_, proxqp_, registry
from prioritized_ik.solvers.backends.abilities import NATIVE, abilities_of
from prioritized_ik.solvers.backends.native import Answer, NativeBackend, full_pattern
from prioritized_ik.solvers.backends.protocol import StageResult
from prioritized_ik.solvers.backends.registry import get_backend, installed_solvers, known_solvers
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.hierarchy import Hierarchy, strict_solution
from prioritized_ik.solvers.lexicographic import first_stage
from prioritized_ik.solvers.registry import get_method, installed_methods
from prioritized_ik.solvers.solve import solve
from prioritized_ik.solvers.stages import Stage
from prioritized_ik.solvers.step import StepStatus
from prioritized_ik.tolerances import SETTLED_FOR_SOLVERS

WORKSPACES = {
    "daqp-warm": daqp_.DaqpWorkspace,
    "osqp-warm": osqp_.OsqpWorkspace,
    "piqp-warm": piqp_.PiqpWorkspace,
    "proxqp-sparse-warm": proxqp_.SparseProxqpWorkspace,
    "proxqp-warm": proxqp_.ProxqpWorkspace,
}
STAGED = list(WORKSPACES)
EVERY = ["daqp-hierarchy", *STAGED]
STARTED = [name for name in STAGED if name != "piqp-warm"]  # an interior-point method takes no starting point

#: Of the joint step before it is polished, relative, where rows bind: DAQP answers once, with a shift, the others zoom in.
RAW_ERROR = {"daqp-warm": 1e-4} | dict.fromkeys(["osqp-warm", "piqp-warm"], 1e-6)
RAW_ERROR |= {"daqp-hierarchy": 10.0 * SETTLED_FOR_SOLVERS}  # what a settled row has left of its length is left open
RAW_ERROR |= {"proxqp-warm": 1e-6, "proxqp-sparse-warm": 3e-6}  # stops at a residual, and scales the sparse data otherwise
CLOSED_FORM_ERROR = 1e-6  # what the solvers of qpsolvers promise on a free step
SMALL = 1e-6  # [rad] of problems of two or three joints, with steps of 1 rad: ten times the worst measured
NEAR = 1e-6  # of the step: a row this near is tight for the polish


def small_stage(limit: float = 0.25, pull: float = 1.0) -> Stage:
    """min (pull - x - y)² + (x - y)² with x, y <= limit and >= -1: a stage of two variables and four rows."""
    level = Level([[1.0, 1.0], [1.0, -1.0]], [pull, 0.0])
    return first_stage(IKProblem([level], Bounds([-1.0, -1.0], [limit, 1.0])), QP_ONLY)


def other_size() -> Stage:
    return first_stage(IKProblem([Level(np.eye(3), np.ones(3))], Bounds.none(3), Rows([[1.0, 1.0, 0.0]], [0.5])), QP_ONLY)


def infeasible() -> Stage:
    """A stage whose rows exclude each other, of the size of `small_stage`."""
    stage = small_stage()
    g = np.vstack([stage.problem.G[:2], -stage.problem.G[:2]])
    return replace(stage, problem=qpsolvers.Problem(stage.problem.P, stage.problem.q, g, np.full(4, -1.0)))


def counted(monkeypatch, name: str) -> list[str]:
    """Return a list that grows by one whenever native `name` makes an object of its solver."""
    owner, attribute = {
        "daqp-warm": (daqp_.daqp, "Model"),
        "osqp-warm": (osqp_.osqp, "OSQP"),
        "piqp-warm": (piqp_.piqp, "DenseSolver"),
        "proxqp-sparse-warm": (proxqp_.SparseProxqpWorkspace, "solver"),
        "proxqp-warm": (proxqp_.ProxqpWorkspace, "solver"),
    }[name]
    real, made = getattr(owner, attribute), []

    def make(*sizes):
        made.append(name)
        return real(*sizes)

    monkeypatch.setattr(owner, attribute, staticmethod(make) if attribute == "solver" else make)
    return made


def relative(found: np.ndarray, wanted: np.ndarray) -> float:
    return float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted))


@pytest.fixture(scope="module")
def answers() -> list[tuple]:
    """Steps at which rows bind, with their certified answers."""
    return [(problem, solve(problem, "daqp", AS_RECORDED)) for problem in constrained_steps()]


def test_every_native_solver_is_known_and_installed():
    assert set(STAGED) == NATIVE.keys()
    assert set(STAGED) <= set(known_solvers())
    assert set(EVERY) <= {*installed_solvers(), *installed_methods(on_request=True)}
    assert set(STAGED) <= set(installed_solvers())


@pytest.mark.parametrize("name", STAGED)
def test_a_native_solver_has_its_row_and_version(name):
    assert abilities_of(name).native
    assert not abilities_of(name.split("-")[0]).native
    assert get_backend(name).version == get_backend(name.split("-")[0]).version


@pytest.mark.parametrize("name", EVERY)
def test_a_native_step_ends_on_the_same_rows_as_through_qpsolvers(name, answers):
    backend = get_method(name)
    for problem, wanted in answers:
        step = backend.step(problem, AS_RECORDED)
        assert relative(step.raw, wanted.dtheta) <= RAW_ERROR[name]
        assert problem.tight_rows(step.raw, NEAR * float(np.linalg.norm(wanted.dtheta))) == wanted.tight_rows


@pytest.mark.parametrize("name", EVERY)
def test_a_native_step_once_polished_is_the_certified_one(name, answers):
    backend = get_method(name)
    for problem, wanted in answers:
        step = backend.step(problem, AS_RECORDED)
        assert step.status is StepStatus.SOLVED
        assert relative(step.dtheta, wanted.dtheta) <= 1e-12  # the same face: what is left is rounding


@pytest.mark.parametrize("name", EVERY)
def test_a_free_step_is_the_closed_form(name):
    backend = get_method(name)
    for problem in free_steps():
        step = backend.step(problem, AS_RECORDED)
        assert relative(step.raw, strict_solution(problem.levels, problem.reference)) <= CLOSED_FORM_ERROR


@pytest.mark.parametrize("name", STAGED)
def test_steps_in_a_row_do_not_depend_on_where_they_start(name):
    warm = get_method(name)
    for problem in list(recorded("up").problems())[60:80]:
        here, anew = (backend.step(problem, AS_RECORDED) for backend in (warm, get_method(name)))
        assert here.dtheta.tobytes() == anew.dtheta.tobytes()
        # A first-order method ends anywhere within its tolerance: two of its answers are twice their error apart.
        assert relative(here.raw, anew.raw) <= 2.0 * RAW_ERROR[name]


@pytest.mark.parametrize("name", STAGED)
def test_a_stage_of_equal_size_is_not_set_up_again(name, monkeypatch):
    made, backend = counted(monkeypatch, name), get_backend(name)
    for limit, pull in ((0.25, 1.0), (0.2, 1.0), (0.25, -1.5), (0.3, 2.0)):
        stage = small_stage(limit, pull)
        assert stage.dtheta(backend.solve(stage).x) == pytest.approx([min(pull / 2.0, limit), pull / 2.0], abs=SMALL)
    assert len(made) == 1


@pytest.mark.parametrize("name", STAGED)
def test_a_stage_of_another_size_is_set_up_anew(name, monkeypatch):
    made, backend = counted(monkeypatch, name), get_backend(name)
    for _ in range(2):
        assert small_stage().dtheta(backend.solve(small_stage()).x) == pytest.approx([0.25, 0.5], abs=SMALL)
        assert other_size().dtheta(backend.solve(other_size()).x) == pytest.approx([0.25, 0.25, 1.0], abs=SMALL)
    assert len(made) == 4


@pytest.mark.parametrize("name", STAGED)
def test_each_place_of_the_fold_keeps_a_workspace_of_its_own(name, monkeypatch):
    made, backend = counted(monkeypatch, name), get_backend(name)
    second = replace(other_size(), place=1)
    for _ in range(3):
        backend.solve(small_stage())
        backend.solve(second)
    assert len(made) == 2


def test_only_what_changed_is_sent(monkeypatch):
    sent = []

    class Watched(daqp.Model):
        def update(self, **changed):
            sent.append(set(changed))
            return super().update(**changed)

    monkeypatch.setattr(daqp_.daqp, "Model", Watched)
    backend, stage = get_backend("daqp-warm"), small_stage()
    for changed in (stage, stage, small_stage()):
        backend.solve(changed)
    always = {"f", "bupper", "sense"}
    assert sent == [always, always, always | {"A"}]


@pytest.mark.parametrize("name", STAGED)
def test_a_stage_solved_again_takes_fewer_iterations(name):
    cold, warm = [], []
    for problem in constrained_steps():
        backend, stage = get_backend(name), first_stage(problem, AS_RECORDED)
        for iterations in (cold, warm):
            backend.solve(stage)
            iterations.append(backend.iterations)
    if name == "daqp-warm":
        assert max(warm) == 1 < min(cold)  # the rows are right from the start
    if name not in STARTED:  # the data of the last stage is replaced, its scaling is kept: rounding is another
        assert np.max(np.abs(np.subtract(warm, cold))) <= 1
    elif name != "osqp-warm":  # the step size that it ended with can cost it more than the start saves
        assert sum(warm) < sum(cold)


@pytest.mark.parametrize("name", STARTED)
def test_steps_in_a_row_take_fewer_iterations_than_each_from_nothing(name):
    problems, warm, counts = list(recorded("up").problems())[100:140], get_backend(name), np.zeros(2, dtype=int)
    for problem in problems:
        stage, cold = first_stage(problem, AS_RECORDED), get_backend(name)
        for i, backend in enumerate((warm, cold)):
            backend.solve(stage)
            counts[i] += backend.iterations
    assert counts[0] < counts[1]


def test_multipliers_follow_their_rows_to_another_position():
    stage = first_stage(constrained_steps()[2], AS_RECORDED)
    turned = np.arange(len(stage.row_ids))[::-1]
    qp = qpsolvers.Problem(stage.problem.P, stage.problem.q, stage.problem.G[turned], stage.problem.h[turned])
    moved = replace(stage, problem=qp, row_ids=stage.row_ids[turned])
    strangers = replace(moved, row_ids=moved.row_ids + 1000)
    iterations = []
    for second in (moved, strangers):
        backend = get_backend("daqp-warm")
        backend.solve(stage)
        backend.solve(second)
        iterations.append(backend.iterations)
    assert iterations[0] == 1 < iterations[1]


@pytest.mark.parametrize("name", EVERY)
def test_nothing_is_printed(name, capfd):
    method = get_method(name)
    for problem in (constrained_steps()[0], free_steps()[0], IKProblem([Level([[1.0, 0.0]], [5.0])])):
        method.step(problem, AS_RECORDED)
    if name in STAGED:
        get_backend(name).solve(infeasible())
        get_method(f"damped:{name}").step(constrained_steps()[0])
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", STAGED)
def test_a_feasible_stage_is_solved_after_one_that_is_not(name, monkeypatch):
    made, backend = counted(monkeypatch, name), get_backend(name)
    backend.solve(small_stage())
    result = backend.solve(infeasible())
    assert result.x is None
    assert result.message.startswith(f"{name} found no solution (")
    assert result.calls == 2  # the second from nothing
    assert small_stage().dtheta(backend.solve(small_stage()).x) == pytest.approx([0.25, 0.5], abs=SMALL)
    assert len(made) == 3  # what failed is not used again


@pytest.mark.parametrize("name", STAGED)
@pytest.mark.parametrize("part", ["x", "multipliers"])
def test_an_answer_that_is_not_finite_is_a_failure(name, part, monkeypatch):
    def broken(workspace, problem, multipliers):
        answer = Answer(np.zeros(len(problem.q)), np.zeros(len(problem.h)), 1)
        getattr(answer, part)[0] = np.nan
        return answer

    backend = get_backend(name)
    backend.solve(small_stage())
    with monkeypatch.context() as patch:
        patch.setattr(WORKSPACES[name], "solve", broken)
        result = backend.solve(small_stage())
    assert result == StageResult(None, f"{name} returned values that are not finite", 2)
    assert small_stage().dtheta(backend.solve(small_stage()).x) == pytest.approx([0.25, 0.5], abs=SMALL)


@pytest.mark.parametrize("error", [ValueError("rank"), RuntimeError("C++"), ZeroDivisionError("0"), osqp.OSQPException(3)])
@pytest.mark.parametrize("where", ["__init__", "solve"])
def test_what_a_solver_raises_is_a_failure(where, error, monkeypatch):
    def failing(*given):
        raise error

    monkeypatch.setattr(osqp_.OsqpWorkspace, where, failing)
    result = get_backend("osqp-warm").solve(small_stage())
    assert result.x is None
    assert result.message == f"osqp-warm raised {type(error).__name__}: {error}"


@pytest.mark.parametrize("error", [KeyError("bug"), TypeError("bug"), AttributeError("bug")])
def test_a_bug_passes_and_costs_the_memory(error, monkeypatch):
    def failing(*given):
        raise error

    made, backend = counted(monkeypatch, "daqp-warm"), get_backend("daqp-warm")
    backend.solve(small_stage())
    with monkeypatch.context() as patch:
        patch.setattr(daqp_.DaqpWorkspace, "solve", failing)
        with pytest.raises(type(error)):
            backend.solve(small_stage())
    backend.solve(small_stage())
    assert len(made) == 2


def test_a_second_attempt_is_looser_and_shifts_more_and_is_not_remembered(monkeypatch):
    seen = []

    class Stubborn(daqp_.DaqpWorkspace):
        def __init__(self, problem, options, costed, shift):
            super().__init__(problem, options, costed, shift)
            seen.append((options["primal_tol"], shift))
            self.fails = len(seen) % 2 == 1

        def solve(self, problem, multipliers):
            if self.fails:
                raise ValueError("stubborn")
            return super().solve(problem, multipliers)

    backend = NativeBackend("daqp-warm", 1e-8, Stubborn)
    for _ in range(2):
        result = backend.solve(small_stage())
        assert (result.message, result.calls) == ("", 2)
        assert small_stage().dtheta(result.x) == pytest.approx([0.25, 0.5], abs=SMALL)
    assert seen == [(1e-10, 1e-10), (1e-8, 1e-6)] * 2


@pytest.mark.parametrize("name", [name for name in STAGED if abilities_of(name).zooms])
def test_a_refinement_that_fails_leaves_the_answer_but_no_memory(name, monkeypatch):
    made, backend, calls, real = counted(monkeypatch, name), get_backend(name), [], WORKSPACES[name].solve

    def once(*given):
        calls.append(name)
        if len(calls) == 2:
            raise ValueError("refinement")
        return real(*given)

    monkeypatch.setattr(WORKSPACES[name], "solve", once)
    for _ in range(2):
        assert small_stage().dtheta(backend.solve(small_stage()).x) == pytest.approx([0.25, 0.5], abs=1e-4)
    assert len(made) == 2


@pytest.mark.parametrize("name", STAGED)
def test_the_damped_qp_is_solved_once_with_default_options(name, monkeypatch):
    given, real = [], WORKSPACES[name].__init__

    def watched(workspace, problem, options, costed, shift):
        given.append((dict(options), shift))
        real(workspace, problem, options, costed, shift)

    monkeypatch.setattr(WORKSPACES[name], "__init__", watched)
    problem = constrained_steps()[0]
    stage, backend = get_method(f"damped:{name}").stage(problem), get_backend(name)
    results = [backend.solve_once(stage) for _ in range(2)]
    assert [result.calls for result in results] == [1, 1]
    assert (results[0].x == results[1].x).all()  # each from nothing
    assert given == [({}, 0.0)] * 2
    cost = problem.levels[0].cost
    # The default tolerance of OSQP, 1e-3, is the largest.
    assert cost(results[0].x) <= 1.01 * cost(get_backend("daqp").solve_once(stage).x) + 1e-3 * cost(
        np.zeros(len(stage.origin))
    )


@pytest.mark.parametrize("name", STAGED)
def test_read_only_data_is_solved(name):
    backend = get_backend(name)
    for pull in (1.0, 1.2):
        stage = small_stage(pull=pull)
        for array in (stage.problem.P, stage.problem.q, stage.problem.G, stage.problem.h):
            array.setflags(write=False)
        assert stage.dtheta(backend.solve(stage).x) == pytest.approx([0.25, pull / 2.0], abs=SMALL)


@pytest.mark.parametrize("name", STAGED)
def test_what_a_caller_does_with_its_arrays_later_does_not_matter(name):
    backend, stage = get_backend(name), small_stage()
    result = backend.solve(stage)
    kept = np.array(result.x)
    stage.problem.G[:] = np.nan
    second = backend.solve(small_stage(0.2))
    assert (result.x == kept).all()
    assert small_stage(0.2).dtheta(second.x) == pytest.approx([0.2, 0.5], abs=SMALL)


CORNERS = {
    "a corner": (
        IKProblem(
            [Level([[1.0, 0.0, 0.0]], [5.0])],
            rows=Rows([[1.0, 1.0, 0.0], [1.0, -1.0, 0.0]], [1.0, 1.0]),
            reference=[0.0, 0.7, -0.4],
        ),
        [1.0, 0.0, -0.4],
    ),
    "a direction without cost or row": (
        IKProblem([Level([[1.0, 0.0]], [5.0])], rows=Rows([[1.0, 0.0]], [1.0]), reference=[0.0, 0.7]),
        [1.0, 0.7],
    ),
    "no rows": (IKProblem([Level([[1.0, 0.0]], [0.5])], reference=[0.0, 0.7]), [0.5, 0.7]),
    "two levels": (
        IKProblem(
            [Level([[1.0, 1.0, 0.0]], [1.0]), Level([[1.0, 0.0, 0.0]], [5.0])],
            Bounds([-2.0, -0.5, -2.0], [2.0, 2.0, 0.3]),
            reference=[0.0, 0.0, 0.7],
        ),
        [1.5, -0.5, 0.3],
    ),
    "a soft level, then one that would exceed it": (
        IKProblem(
            [Level([[1.0, 0.0], [-1.0, 0.0]], [-1.0, -2.0], [1.0, 3.0], kind="at_most"), Level(np.eye(2), [9.0, 9.0])],
            Bounds([-5.0, -5.0], [5.0, 5.0]),
        ),
        [1.25, 5.0],  # (x + 1)² + 3 (2 - x)² is least where x + 1 = 3 (2 - x)
    ),
    "equalities, one of them twice": (
        IKProblem(
            [Level([[1.0, 0.0, 0.0]], [5.0])],
            Bounds(np.full(3, -1.0), np.full(3, 1.0)),
            equalities=Equalities([[1.0, 1.0, 0.0], [2.0, 2.0, 0.0]], [0.5, 1.0]),
            reference=[0.0, 0.0, 0.2],
        ),
        [1.0, -0.5, 0.2],
    ),
    "a joint that is locked": (
        IKProblem([Level([[1.0, 1.0]], [2.0])], Bounds([0.3, -1.0], [0.3, 1.0]), reference=[0.0, 0.0]),
        [0.3, 1.0],
    ),
}


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize(("problem", "wanted"), CORNERS.values(), ids=CORNERS.keys())
def test_corner_cases_are_solved(name, problem, wanted):
    step = solve(problem, get_method(name), QP_ONLY)
    assert step.dtheta == pytest.approx(wanted, abs=SMALL)
    assert step.raw == pytest.approx(wanted, abs=1e-5)  # before the polish


@pytest.mark.parametrize("name", STAGED)
def test_a_solver_that_is_not_installed_is_refused_with_the_command_that_installs_it(name, monkeypatch):
    monkeypatch.setattr(registry.importlib.util, "find_spec", lambda module: None)
    with pytest.raises(SolverUnavailableError, match=rf"'{name}' is not installed; install it with: pip install \w+ \("):
        get_backend(name)
    assert name in known_solvers()
    assert name not in installed_solvers(on_request=True)


def test_the_hierarchical_solver_that_is_not_installed_is_refused_with_the_command_that_installs_it(monkeypatch):
    monkeypatch.setattr(registry.importlib.util, "find_spec", lambda module: None)
    with pytest.raises(
        SolverUnavailableError, match="'daqp-hierarchy' is not installed; install it with: pip install daqp"
    ):
        get_method("daqp-hierarchy")
    assert "daqp-hierarchy" not in installed_methods(on_request=True)


@pytest.mark.parametrize("entries", [[[1.0, 0.0], [0.0, 0.0], [0.0, 2.0]], np.zeros((2, 3)), np.zeros((0, 2))])
def test_the_full_pattern_stores_zeros_too(entries):
    dense = np.array(entries)
    matrix = full_pattern(dense)
    assert matrix.nnz == dense.size
    assert (matrix.toarray() == dense).all()


# DAQP's own hierarchies.


def whole(problem: IKProblem) -> np.ndarray:
    result = get_method("daqp-hierarchy").solve_whole(Hierarchy(problem))
    assert result.x is not None, result.message
    return result.x


def test_the_hierarchical_solver_takes_whole_hierarchies_in_one_call(answers):
    assert get_method("daqp-hierarchy").step(answers[0][0], AS_RECORDED).calls == 1


def test_a_levels_weights_count_although_daqp_makes_its_rows_equally_long():
    # The bound keeps x at 1, and 100 (x + 10 y - 4)² + (y - 1)² + 4 (2 x - y - 4)² is then least at y = 2993 / 10005. With
    # each row cut to unit length it would be elsewhere.
    fought = Level([[1.0, 10.0], [0.0, 1.0], [2.0, -1.0]], [4.0, 1.0, 4.0], [100.0, 1.0, 4.0])
    wanted = [1.0, (100.0 * 10.0 * 3.0 + 1.0 - 4.0 * 2.0) / (100.0 * 100.0 + 1.0 + 4.0)]
    bound, above = Bounds([-9.0, -9.0], [1.0, 9.0]), Level([[1e-3, 0.0]], [2e-3])
    assert whole(IKProblem([above, fought], bound)) == pytest.approx(wanted, abs=SMALL)  # as a lower level
    pulled = Level(np.vstack([fought.matrix, [1.0, 0.0]]), [*fought.target, 9.0], [*fought.weights, 1e4])
    assert whole(IKProblem([pulled], bound)) == pytest.approx(wanted, abs=SMALL)  # as the top level


def test_a_level_that_daqp_loses_is_tried_with_looser_tolerances_and_then_a_failure(monkeypatch):
    seen, real = [], daqp_hierarchy.daqp.solve

    def losing(*given, primal_tol, rho_soft):
        seen.append((primal_tol, rho_soft))
        x, value, _, info = real(*given, primal_tol=primal_tol, rho_soft=rho_soft)
        return x, value, 3, info

    monkeypatch.setattr(daqp_hierarchy.daqp, "solve", losing)
    result = get_method("daqp-hierarchy", 1e-8).solve_whole(Hierarchy(constrained_steps()[0], RANK_TOLERANCE))
    lost = "daqp-hierarchy found no solution (exit flag 3: a level was lost, as where rows are nearly dependent)"
    assert result == StageResult(None, lost, len(daqp_hierarchy.ATTEMPTS))
    assert seen == [(pytest.approx(factor * 1e-8), rho) for factor, rho in daqp_hierarchy.ATTEMPTS]


def test_values_of_the_hierarchical_solver_that_are_not_finite_are_a_failure(monkeypatch):
    monkeypatch.setattr(daqp_hierarchy.daqp, "solve", lambda *given, **options: (np.full(49, np.nan), 0.0, 1, {}))
    result = get_method("daqp-hierarchy").solve_whole(Hierarchy(constrained_steps()[0], RANK_TOLERANCE))
    assert (result.x, result.message) == (None, "daqp-hierarchy returned values that are not finite")


def test_what_the_hierarchical_solver_raises_is_a_failure(monkeypatch):
    def failing(*given, **options):
        raise ValueError("buffer")

    monkeypatch.setattr(daqp_hierarchy.daqp, "solve", failing)
    result = get_method("daqp-hierarchy").solve_whole(Hierarchy(constrained_steps()[0], RANK_TOLERANCE))
    assert (result.x, result.message) == (None, "daqp-hierarchy raised ValueError: buffer")


def test_hard_rows_without_a_common_point_are_a_failure_of_the_hierarchical_solver():
    problem = IKProblem([Level([[1.0, 0.0]], [5.0])], rows=Rows([[1.0, 0.0], [-1.0, 0.0]], [-1.0, -1.0]))
    assert get_method("daqp-hierarchy").solve_whole(Hierarchy(problem)).x is None


def test_a_step_that_equalities_decide_needs_no_solver():
    problem = IKProblem([Level(np.eye(2), [5.0, 5.0])], equalities=Equalities(np.eye(2), [0.25, -0.5]))
    result = get_method("daqp-hierarchy").solve_whole(Hierarchy(problem))
    assert result.x == pytest.approx([0.25, -0.5], abs=1e-15)
    assert result.calls == 0


@pytest.mark.parametrize("name", STAGED)
def test_a_copy_of_a_used_solver_solves_and_leaves_the_process_alive(name):
    """In a process of its own, as a copy of memory that belongs to a library in C++ would end it."""
    script = """
import copy, pickle, sys
from prioritized_ik import Bounds, IKProblem, Level, get_method, solve
problem = IKProblem([Level([[1.0, 1.0]], [1.0])], Bounds([-0.1] * 2, [0.1] * 2))
used = get_method(sys.argv[1])
solve(problem, used)
for other in (copy.deepcopy(used), pickle.loads(pickle.dumps(used))):
    assert abs(solve(problem, other).dtheta - 0.1).max() < 1e-12
print("alive")
"""
    done = subprocess.run([sys.executable, "-c", script, name], check=False, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "alive\n"), done.stderr
