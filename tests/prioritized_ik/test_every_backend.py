"""Every installed solver: how accurate its own answers are, and that the certified step is the same to the last bit."""

from functools import cache

import numpy as np
import pytest
import qpsolvers
from tolerances import ROUNDING
from winding_fixtures import AS_RECORDED, QP_ONLY, constrained_steps, free_steps

from prioritized_ik.errors import InputError, SolverUnavailableError
from prioritized_ik.problem import Bounds, IKProblem, Level, Rows
from prioritized_ik.solvers.backends import qpsolvers_, registry
from prioritized_ik.solvers.backends.abilities import ABILITIES, abilities_of
from prioritized_ik.solvers.backends.qpsolvers_ import QpsolversBackend
from prioritized_ik.solvers.backends.registry import get_backend, installed_solvers, known_solvers
from prioritized_ik.solvers.hierarchy import strict_solution
from prioritized_ik.solvers.lexicographic import SolveOptions, first_stage
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.solvers.solve import solve
from prioritized_ik.solvers.step import JointStep, StepStatus

TEN = ["clarabel", "cvxopt", "daqp", "highs", "osqp", "piqp", "proxqp", "qpalm", "quadprog", "scs"]
ELEVEN = [*TEN, "ecos"]

CLOSED_FORM_ERROR = 1e-6  # of a solver's own joint step, relative: what the ten promise on a free step
ECOS_ERROR = 1e-5  # ECOS minimises through an epigraph cone, which blurs the answer to the root of its tolerance
BROKEN = 1e-6  # of a row, relative to the step: what is accepted of a solver
COST_GAP = 1e-6  # of a level's cost, relative to standing still
JUDGES = ("daqp", "proxqp", "clarabel")  # an active-set, a proximal and an interior-point method

Problems = tuple[IKProblem, ...]


def steps_of(name: str, problems: Problems) -> list[JointStep]:
    backend = get_method(name)
    return [backend.step(problem, AS_RECORDED) for problem in problems]


@cache
def free(name: str) -> list[JointStep]:
    return steps_of(name, free_steps())


@cache
def constrained(name: str) -> list[JointStep]:
    return steps_of(name, constrained_steps())


def worst_free_error(steps: list[JointStep]) -> float:
    """The error of the solver's own steps."""
    errors = []
    for problem, step in zip(free_steps(), steps, strict=True):
        wanted = strict_solution(problem.levels, problem.reference)
        assert step.status is StepStatus.SOLVED, step.message
        errors.append(np.linalg.norm(step.raw - wanted) / np.linalg.norm(wanted))
    return max(errors)


def test_the_steps_to_judge_by_are_free_and_constrained_as_they_should_be():
    assert (len(free_steps()), len(constrained_steps())) == (12, 8)
    assert all(step.tight_rows for step in constrained("daqp"))


def test_every_solver_of_the_table_of_eleven_is_installed():
    assert set(ELEVEN) <= set(qpsolvers.available_solvers)


# The certified step.


@pytest.mark.parametrize("name", installed_solvers(on_request=True))
def test_the_constrained_step_is_the_same_to_the_last_bit(name):
    for i, (step, wanted) in enumerate(zip(constrained(name), constrained("daqp"), strict=True)):
        assert step.certificate.holds, i
        assert (step.dtheta == wanted.dtheta).all(), i
        assert step.certificate == wanted.certificate


@pytest.mark.parametrize("name", installed_solvers(on_request=True))
def test_the_free_step_is_the_same_to_the_last_bit(name):
    for i, (step, wanted) in enumerate(zip(free(name), free("daqp"), strict=True)):
        assert step.certificate.holds, i
        assert (step.dtheta == wanted.dtheta).all(), i
        assert step.certificate == wanted.certificate


@pytest.mark.usefixtures("python_path")
def test_the_free_step_is_the_closed_form_and_to_the_last_bit_where_it_ends_on_no_row():
    same = 0
    for problem, step in zip(free_steps(), steps_of("daqp", free_steps()), strict=True):
        wanted = strict_solution(problem.levels, problem.reference)
        assert np.linalg.norm(step.dtheta - wanted) <= ROUNDING * np.linalg.norm(wanted)
        if not step.tight_rows:  # a row that it ends on, though it holds nothing back, is solved for
            assert (step.dtheta == wanted).all()
            same += 1
    assert same >= 8


@pytest.mark.parametrize("name", installed_solvers(on_request=True))
def test_a_certified_step_breaks_rows_by_rounding_only(name):
    for problem, step in zip(constrained_steps(), constrained(name), strict=True):
        assert problem.relative_violation(step.dtheta) <= ROUNDING


def test_bits_tell_a_step_that_is_off_by_the_least_there_is():
    step = constrained("daqp")[0].dtheta
    assert (np.nextafter(step, np.inf) != step).all()
    assert sum(not np.array_equal(step.dtheta, step.raw) for step in constrained("daqp")) >= 4  # it is the polish's doing


# The solver's own step.


@pytest.mark.parametrize("name", TEN)
def test_a_solvers_own_free_step_is_the_closed_form(name):
    assert worst_free_error(free(name)) <= CLOSED_FORM_ERROR


def test_ecos_own_free_step_is_the_closed_form_to_its_own_bound():
    assert worst_free_error(free("ecos")) <= ECOS_ERROR


@pytest.mark.parametrize("name", ELEVEN)
def test_a_solvers_own_constrained_step_keeps_every_row(name):
    for problem, step in zip(constrained_steps(), constrained(name), strict=True):
        assert step.status is StepStatus.SOLVED, step.message
        assert problem.relative_violation(step.raw) <= BROKEN


@pytest.mark.parametrize("name", ELEVEN)
def test_a_solvers_own_constrained_step_is_as_good_as_the_optimum(name):
    for problem, step, best in zip(constrained_steps(), constrained(name), constrained("daqp"), strict=True):
        level = problem.levels[0]
        still = level.cost(np.zeros(problem.joint_count))
        assert level.cost(step.raw) <= best.costs[0] + COST_GAP * still


@pytest.mark.parametrize("name", JUDGES)
def test_no_solvers_own_step_is_better_than_the_certified_one(name):
    # By more than the rows it breaks and the rounding of the cost gain it.
    for problem, step in zip(constrained_steps(), constrained(name), strict=True):
        level = problem.levels[0]
        still = level.cost(np.zeros(problem.joint_count))
        assert level.cost(step.dtheta) <= level.cost(step.raw) + COST_GAP * still


def slightly_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every solver be off by a hundred thousandth."""
    exact = qpsolvers_.qpsolvers.solve_problem

    def solve_problem(problem, solver, **options):
        solution = exact(problem, solver, **options)
        solution.x = solution.x * (1.0 + 1e-5)
        return solution

    monkeypatch.setattr(qpsolvers_.qpsolvers, "solve_problem", solve_problem)


def test_the_free_steps_tell_a_solver_that_is_off_by_a_hundred_thousandth(monkeypatch):
    recorded = free_steps()  # by the solver as it is
    slightly_off(monkeypatch)
    assert worst_free_error(steps_of("osqp", recorded)) > CLOSED_FORM_ERROR  # no zooms, which would mend it


def test_the_certified_steps_of_a_solver_that_is_off_by_a_hundred_thousandth_are_the_same_to_the_last_bit(monkeypatch):
    wanted = constrained("daqp")
    slightly_off(monkeypatch)
    steps = steps_of("osqp", constrained_steps())
    assert all((step.dtheta == other.dtheta).all() for step, other in zip(steps, wanted, strict=True))


def assert_solved(problem: IKProblem, name: str, wanted: list[float]) -> None:
    step = solve(problem, get_method(name), QP_ONLY)  # a backend given as such refines its answer
    assert step.dtheta == pytest.approx(wanted, abs=ROUNDING)
    assert step.raw == pytest.approx(wanted, abs=1e-6)
    assert (step.dtheta == solve(problem, "daqp", QP_ONLY).dtheta).all()


@pytest.mark.parametrize("name", ELEVEN)
def test_a_level_that_presses_into_a_corner_is_solved(name):
    # The two rows leave the second joint no room once the first is at its best: no interior for the last stage.
    rows = Rows([[1.0, 1.0, 0.0], [1.0, -1.0, 0.0]], [1.0, 1.0])
    problem = IKProblem([Level([[1.0, 0.0, 0.0]], [5.0])], rows=rows, reference=[0.0, 0.7, -0.4])
    assert_solved(problem, name, [1.0, 0.0, -0.4])


@pytest.mark.parametrize("name", ELEVEN)
def test_a_direction_without_cost_or_row_is_solved(name):
    problem = IKProblem([Level([[1.0, 0.0]], [5.0])], rows=Rows([[1.0, 0.0]], [1.0]), reference=[0.0, 0.7])
    assert_solved(problem, name, [1.0, 0.7])


@pytest.mark.parametrize("name", ELEVEN)
def test_a_problem_without_rows_is_solved(name):
    assert_solved(IKProblem([Level([[1.0, 0.0]], [0.5])], reference=[0.0, 0.7]), name, [0.5, 0.7])


@pytest.mark.parametrize("name", ELEVEN)
def test_two_strict_levels_with_a_reference_are_solved(name):
    levels = [Level([[1.0, 1.0, 0.0]], [1.0]), Level([[1.0, 0.0, 0.0]], [5.0])]
    problem = IKProblem(levels, Bounds([-2.0, -0.5, -2.0], [2.0, 2.0, 0.3]), reference=[0.0, 0.0, 0.7])
    assert_solved(problem, name, [1.5, -0.5, 0.3])


@pytest.mark.parametrize("name", ELEVEN)
def test_a_soft_level_between_two_others_is_solved(name):
    soft = Level([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [0.25, 1.0], [4.0, 1.0], "soft", "at_most")
    levels = [Level([[1.0, 1.0, 0.0]], [2.0]), soft, Level([[0.0, 1.0, 1.0]], [3.0])]
    # min 4 (x - 1/4)² + (y - 1)² on x + y = 2: x = 2/5, y = 8/5; the third joint then is 7/5.
    assert_solved(IKProblem(levels, Bounds([-2.0] * 3, [2.0] * 3)), name, [0.4, 1.6, 1.4])


@pytest.mark.parametrize("name", ELEVEN)
def test_rows_without_a_common_point_are_a_failure_and_not_a_step(name):
    problem = IKProblem([Level([[1.0, 0.0]], [5.0])], rows=Rows([[1.0, 0.0], [-1.0, 0.0]], [-1.0, -1.0]))
    step = get_method(name).step(problem, SolveOptions())
    assert step.dtheta is None
    assert step.status in (StepStatus.NOT_FOUND, StepStatus.VIOLATED, StepStatus.INFEASIBLE)


@pytest.mark.parametrize("name", ELEVEN)
def test_a_row_of_zeros_binds_nothing(name):
    rows = Rows([[0.0, 0.0], [1.0, 0.0]], [1.0, 0.5])
    assert_solved(IKProblem([Level(np.eye(2), [1.0, 1.0])], rows=rows), name, [0.5, 1.0])


def test_every_solver_has_its_row_in_the_table_of_abilities():
    assert set(ELEVEN) <= ABILITIES.keys()
    assert not any(ABILITIES[name].on_request for name in ELEVEN)


@pytest.mark.parametrize("name", ABILITIES)
def test_the_flags_of_the_table_are_booleans_and_its_zooms_shrink(name):
    abilities = ABILITIES[name]
    flags = (abilities.semidefinite, abilities.sparse, abilities.warm_start, abilities.on_request)
    assert all(type(flag) is bool for flag in flags)
    assert all(0.0 < zoom < 1.0 for zoom in abilities.zooms)
    assert list(abilities.zooms) == sorted(abilities.zooms, reverse=True)


@pytest.mark.parametrize("name", ABILITIES)
def test_an_accuracy_becomes_a_dictionary_of_options(name):
    assert isinstance(ABILITIES[name].options(1e-8), dict)


@pytest.mark.parametrize("name", ELEVEN)
@pytest.mark.parametrize("accuracy", [1e-4, 1e-8])
def test_the_solver_takes_the_tables_options(name, accuracy):
    level = Level([[1.0, 1.0], [1.0, -1.0]], [1.0, 0.0])
    stage = first_stage(IKProblem([level], Bounds([-1.0, -1.0], [0.25, 1.0])), QP_ONLY)
    result = QpsolversBackend(name, accuracy).solve(stage)
    assert result.x is not None, result.message
    # min (1 - x - y)² + (x - y)² with x <= 1/4: y = 1/2.
    assert stage.dtheta(result.x) == pytest.approx([0.25, 0.5], abs=10.0 * accuracy**0.5)


def test_a_solver_outside_the_table_is_handled_with_care():
    abilities = abilities_of("newcomer")
    assert (abilities.package, abilities.semidefinite, abilities.sparse) == ("newcomer", False, False)
    assert abilities.on_request


def test_an_unknown_solver_is_refused_with_the_list_of_those_installed():
    with pytest.raises(SolverUnavailableError, match="unknown solver 'sorcery'; choose one of: ") as caught:
        get_backend("sorcery")
    assert all(name in str(caught.value) for name in installed_solvers(on_request=True))


def test_a_solver_that_is_not_installed_is_refused_with_the_command_that_installs_it(monkeypatch):
    monkeypatch.setattr(qpsolvers, "available_solvers", [name for name in TEN if name not in ("scs", "highs")])
    with pytest.raises(SolverUnavailableError, match="'scs' is not installed; install it with: pip install scs "):
        get_backend("scs")
    with pytest.raises(SolverUnavailableError, match="pip install highspy "):
        get_backend("highs")


@pytest.fixture
def only(monkeypatch):
    """Let only some solvers of qpsolvers be installed, and no native one."""
    monkeypatch.setattr(registry, "_is_installed", lambda name: False)

    def installed(*names):
        monkeypatch.setattr(qpsolvers, "available_solvers", list(names))

    return installed


def test_a_solver_that_is_not_installed_stays_known(only):
    only("daqp")
    assert "scs" in known_solvers()
    assert "daqp-warm" in known_solvers()
    assert installed_solvers() == ["daqp"]


def test_solvers_on_request_are_listed_only_on_request(only):
    only("daqp", "kvxopt")
    assert installed_solvers() == ["daqp"]
    assert installed_solvers(on_request=True) == ["daqp", "kvxopt"]


@pytest.mark.parametrize("accuracy", [0.0, -1e-8, 1.0, np.nan, np.inf])
def test_an_accuracy_out_of_range_is_refused(accuracy):
    with pytest.raises(InputError, match=rf"accuracy is {accuracy}; expected a number above 0 and below 1"):
        get_backend("daqp", accuracy)


@pytest.mark.parametrize("name", ELEVEN)
def test_the_version_of_an_installed_solver_is_known(name):
    assert get_backend(name).version[0].isdigit()


def test_the_version_of_a_solver_without_package_is_unknown():
    assert QpsolversBackend("newcomer", 1e-8).version == "unknown"


class Answers:
    """Stands in for `qpsolvers.solve_problem`."""

    def __init__(self, x, *, found=True, error=None):
        self.x, self.found, self.error = x, found, error

    def __call__(self, problem, solver, **options):
        if self.error is not None:
            raise self.error
        solution = qpsolvers.Solution(problem)
        solution.found, solution.x = self.found, self.x
        return solution


STAGE = first_stage(IKProblem([Level(np.eye(2), [1.0, 1.0])]), QP_ONLY)
FAILURES = {
    "not found": (Answers(np.ones(2), found=False), "proxqp found no solution"),
    "no x": (Answers(None), "proxqp found no solution"),
    "nan": (Answers(np.array([1.0, np.nan])), "proxqp returned values that are not finite"),
    "inf": (Answers(np.array([1.0, np.inf])), "proxqp returned values that are not finite"),
    "qpsolvers": (Answers(None, error=qpsolvers.exceptions.ProblemError("bad")), "proxqp raised ProblemError: bad"),
    "lapack": (Answers(None, error=np.linalg.LinAlgError("singular")), "proxqp raised LinAlgError: singular"),
    "division": (Answers(None, error=ZeroDivisionError("by zero")), "proxqp raised ZeroDivisionError: by zero"),
    "value": (Answers(None, error=ValueError("rank")), r"proxqp raised ValueError: rank"),
    "binding": (Answers(None, error=RuntimeError("C++")), "proxqp raised RuntimeError: C++"),
}


@pytest.mark.parametrize(("answers", "message"), FAILURES.values(), ids=FAILURES.keys())
def test_a_failure_of_the_solver_is_a_result_without_x(answers, message, monkeypatch):
    monkeypatch.setattr(qpsolvers_.qpsolvers, "solve_problem", answers)
    result = QpsolversBackend("proxqp", 1e-8).solve(STAGE)
    assert (result.x, result.message) == (None, message)
    assert result.calls == 2  # the second at a looser accuracy


@pytest.mark.parametrize("error", [KeyError("bug"), TypeError("bug"), AttributeError("bug")])
def test_a_bug_passes_through(error, monkeypatch):
    monkeypatch.setattr(qpsolvers_.qpsolvers, "solve_problem", Answers(None, error=error))
    with pytest.raises(type(error)):
        QpsolversBackend("proxqp", 1e-8).solve(STAGE)


def test_the_answer_stays_when_only_its_refinement_fails(monkeypatch):
    exact, calls = qpsolvers_.qpsolvers.solve_problem, []

    def once(problem, solver, **options):
        calls.append(solver)
        return exact(problem, solver, **options) if len(calls) == 1 else Answers(None, found=False)(problem, solver)

    monkeypatch.setattr(qpsolvers_.qpsolvers, "solve_problem", once)
    result = QpsolversBackend("proxqp", 1e-8).solve(STAGE)
    assert STAGE.dtheta(result.x) == pytest.approx([1.0, 1.0], abs=1e-6)
    assert result.calls == 2


def test_a_solver_that_fails_at_the_accuracy_asked_is_tried_once_more_at_a_looser_one(monkeypatch):
    exact, asked = qpsolvers_.qpsolvers.solve_problem, []

    def strict_fails(problem, solver, **options):
        asked.append(options["eps_abs"])
        return exact(problem, solver, **options) if len(asked) > 1 else Answers(None, found=False)(problem, solver)

    monkeypatch.setattr(qpsolvers_.qpsolvers, "solve_problem", strict_fails)
    result = QpsolversBackend("proxqp", 1e-8).solve(STAGE)
    assert STAGE.dtheta(result.x) == pytest.approx([1.0, 1.0], abs=1e-6)
    options = ABILITIES["proxqp"].options
    assert asked[:2] == [options(accuracy)["eps_abs"] for accuracy in (1e-8, 1e-8 * qpsolvers_.LOOSER)]
    assert asked[0] < asked[1]
    assert (result.message, result.calls) == ("", len(asked))


def test_the_damped_qp_is_solved_once_with_default_options(monkeypatch):
    exact, seen = qpsolvers_.qpsolvers.solve_problem, []
    stage = get_method("damped:proxqp").stage(constrained_steps()[0])

    def watched(problem, solver, **options):
        seen.append((problem, options))
        return exact(problem, solver, **options)

    monkeypatch.setattr(qpsolvers_.qpsolvers, "solve_problem", watched)
    assert QpsolversBackend("proxqp", 1e-8).solve_once(stage).calls == 1
    assert seen == [(stage.problem, {})]


def test_a_damped_qp_that_fails_is_not_tried_again(monkeypatch):
    stage = get_method("damped:proxqp").stage(constrained_steps()[0])
    monkeypatch.setattr(qpsolvers_.qpsolvers, "solve_problem", Answers(None, found=False))
    assert QpsolversBackend("proxqp", 1e-8).solve_once(stage).calls == 1


@pytest.mark.parametrize(("name", "accuracy"), [("highs", 1e-9), ("clarabel", 1e-13), ("daqp-warm", 1e-15)])
def test_an_accuracy_that_a_solver_does_not_reach_is_refused(name, accuracy):
    with pytest.raises(InputError, match=f"accuracy is {accuracy:g}, finer than {name} reaches; expected at least"):
        get_backend(name, accuracy)
    with pytest.raises(InputError, match="finer than"):
        solve(IKProblem([Level(np.eye(2), [1.0, 2.0])]), name, SolveOptions(accuracy=accuracy))
