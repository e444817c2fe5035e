"""What programs do to a library: pickle it, copy it, fork, use threads, and pass it nonsense."""

import copy
import importlib.metadata
import os
import pickle
import signal
import subprocess
import sys
import textwrap
import threading
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
import qpsolvers

import prioritized_ik
from prioritized_ik import errors
from prioritized_ik.errors import InfeasibleError, InputError, SolverUnavailableError, StepNotFoundError
from prioritized_ik.problem import Bounds, IKProblem, Level, Rows
from prioritized_ik.solvers.backends.native import Answer, NativeBackend
from prioritized_ik.solvers.backends.protocol import SolverFailedError
from prioritized_ik.solvers.backends.registry import get_backend, installed_solvers
from prioritized_ik.solvers.lexicographic import SolveOptions, first_stage
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.solvers.solve import solve
from prioritized_ik.solvers.stages import Stage

STAGED = installed_solvers(on_request=True)
EVERY = [*STAGED, "active-set", "daqp-hierarchy"]
NATIVE = [name for name in STAGED if isinstance(get_backend(name), NativeBackend)]
QP_ONLY = SolveOptions(closed_form_first=False)

#: min (1 - x - y)² + (x - y)², then z as near 0.7 as can be, with x <= 1/4: y = 1/2 and z = 0.3.
PROBLEM = IKProblem(
    [Level([[1.0, 1.0, 0.0], [1.0, -1.0, 0.0]], [1.0, 0.0])],
    Bounds([-1.0, -1.0, -1.0], [0.25, 1.0, 0.3]),
    reference=[0.0, 0.0, 0.7],
)
ANSWER = [0.25, 0.5, 0.3]
NEAR = 1e-6  # [rad] of the answer, of any solver
STATIONARY = 1e-5  # ‖Px + q + Gᵀ multipliers‖, of vectors of about 1

COPIES: dict[str, Callable] = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda thing: pickle.loads(pickle.dumps(thing)),
}
COPIED = pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES.keys())


def infeasible() -> IKProblem:
    return IKProblem([Level(np.eye(2), [0.05, 0.0])], Bounds([-0.1] * 2, [0.1] * 2), Rows([[-1.0, -1.0]], [-0.5], ["high"]))


def stage_of(problem: IKProblem = PROBLEM) -> Stage:
    return first_stage(problem, QP_ONLY)


def setups(monkeypatch, backend: NativeBackend) -> list[str]:
    """Return a list that grows whenever a workspace like the backend's is made."""
    made, real = [], backend._workspace.__init__

    def counted(workspace, *given):
        made.append(backend.name)
        real(workspace, *given)

    monkeypatch.setattr(backend._workspace, "__init__", counted)
    return made


def program(folder: Path, text: str) -> str:
    """Return what a program prints, which ends by itself within a minute; its children do not outlive it."""
    path = folder / "program.py"
    path.write_text(textwrap.dedent(text), encoding="utf-8")
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with subprocess.Popen([sys.executable, str(path)], text=True, start_new_session=True, **pipes) as process:
        try:
            output, _ = process.communicate(timeout=60)
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == 0, output
    return output


# errors


def every_error() -> list[errors.PrioritizedIkError]:
    kinds = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, Exception)]
    assert len(kinds) >= 8
    return [kind("what", {"x": 1}) if issubclass(kind, StepNotFoundError) else kind("what") for kind in kinds]


@COPIED
@pytest.mark.parametrize("error", every_error(), ids=lambda error: type(error).__name__)
def test_every_error_is_copied_with_what_it_holds(error, copied):
    error.add_note("and why")
    twin = copied(error)
    assert type(twin) is type(error)
    assert (str(twin), twin.args, vars(twin)) == ("what", ("what",), vars(error))


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_an_infeasible_error_is_pickled_with_its_step_and_conflict(protocol):
    with pytest.raises(InfeasibleError) as caught:
        solve(infeasible())
    twin = pickle.loads(pickle.dumps(caught.value, protocol))
    assert type(twin) is InfeasibleError
    assert str(twin) == str(caught.value)
    assert twin.conflict == caught.value.conflict
    assert "high" in twin.conflict.names
    assert twin.step.status is caught.value.step.status


def test_an_error_of_ones_own_is_copied_whatever_its_init_takes():
    class Own(StepNotFoundError):
        def __init__(self, *, joint: int) -> None:
            super().__init__(f"joint {joint}", None)
            self.joint = joint

    assert copy.deepcopy(Own(joint=3)).joint == 3


def test_pools_of_processes_hand_back_answers_and_infeasible_errors(tmp_path):
    output = program(
        tmp_path,
        """
        import concurrent.futures, multiprocessing
        import numpy as np, prioritized_ik as pik

        def one(need, backend="daqp"):
            rows = pik.Rows([[-1.0, -1.0]], [-need], names=["high"])
            problem = pik.IKProblem([pik.Level(np.eye(2), [0.0, 0.0])], pik.Bounds([-0.1] * 2, [0.1] * 2), rows)
            return pik.solve(problem, backend).dtheta

        def expect(wait):
            try:
                wait()
            except pik.InfeasibleError as error:
                assert "high" in error.conflict.names and "high" in str(error)
                print("handed back")

        if __name__ == "__main__":
            used = [pik.get_method(name) for name in ("daqp-warm", "proxqp-warm", "quadprog")]
            for backend in used:
                one(0.1, backend)
            for way in ("fork", "spawn"):
                context = multiprocessing.get_context(way)
                with concurrent.futures.ProcessPoolExecutor(1, mp_context=context) as executor:
                    jobs = [executor.submit(one, 0.1, backend) for backend in used]
                    for job in jobs:
                        assert np.allclose(job.result(timeout=30), 0.05, atol=1e-6)
                    expect(lambda: executor.submit(one, 0.5).result(timeout=30))
                with context.Pool(1) as pool:
                    expect(lambda: pool.map_async(one, [0.1, 0.5]).get(timeout=30))
        """,
    )
    assert output.count("handed back") == 4, output


# copies of backends


@COPIED
@pytest.mark.parametrize("used", [False, True], ids=["unused", "used"])
@pytest.mark.parametrize("name", EVERY)
def test_a_method_is_copied_used_or_not_and_the_copy_solves(name, used, copied):
    method = get_method(name)
    if used:
        solve(PROBLEM, method, QP_ONLY)
    twin = copied(method)
    assert type(twin) is type(method)
    assert (twin.name, twin.version) == (method.name, method.version)
    if name in STAGED:
        assert (twin.backend.name, twin.backend.accuracy) == (method.backend.name, method.backend.accuracy)
    for either in (twin, method, copied(twin)):
        assert solve(PROBLEM, either, QP_ONLY).dtheta == pytest.approx(ANSWER, abs=NEAR)


@COPIED
@pytest.mark.parametrize("name", NATIVE)
def test_a_copy_starts_from_nothing_and_the_original_goes_on(name, copied, monkeypatch):
    backend = get_backend(name)
    made = setups(monkeypatch, backend)
    backend.solve(stage_of())
    twin = copied(backend)
    assert (len(made), twin.iterations) == (1, 0)
    backend.solve(stage_of())
    assert len(made) == 1
    for _ in range(2):
        twin.solve(stage_of())
        assert len(made) == 2


@COPIED
@pytest.mark.parametrize("name", STAGED)
def test_a_copy_refines_its_answers_if_the_original_does(name, copied):
    for refine in (True, False):
        backend = get_backend(name, refine=refine)
        assert copied(backend).zooms == backend.zooms
        assert copied(backend).abilities == backend.abilities


@COPIED
@pytest.mark.parametrize("name", NATIVE)
def test_a_workspace_is_not_copied_by_itself(name, copied):
    stage = stage_of()
    backend = get_backend(name)
    workspace = backend._workspace(stage.problem, backend.abilities.options(1e-8), stage.costed, 1e-8)
    with pytest.raises(TypeError, match="cannot be copied; copy its backend"):
        copied(workspace)


def test_a_forked_process_does_not_use_what_its_parent_set_up_and_the_parent_goes_on(tmp_path):
    output = program(
        tmp_path,
        f"""
        import os, threading
        import prioritized_ik as pik
        from prioritized_ik.solvers.backends.registry import get_backend
        from prioritized_ik.solvers.lexicographic import first_stage

        problem = pik.IKProblem([pik.Level([[1.0, 1.0]], [1.0])], pik.Bounds([-0.1] * 2, [0.1] * 2))
        stage = first_stage(problem, pik.SolveOptions(closed_form_first=False))
        for name in {NATIVE!r}:
            backend, made = get_backend(name), []

            class Counted(backend._workspace):
                def __init__(self, *given):
                    made.append(name)
                    super().__init__(*given)

            backend._workspace = Counted
            backend.solve(stage)
            child = os.fork()
            if not child:
                found = [stage.dtheta(backend.solve(stage).x) for _ in range(2)]
                good = [len(made) == 2, *(abs(dtheta - 0.1).max() < 1e-4 for dtheta in found)]
                os._exit(0 if all(good) else 1)
            assert os.waitpid(child, 0)[1] == 0, name
            backend.solve(stage)
            assert len(made) == 1, name

            inside, go = threading.Event(), threading.Event()
            real = Counted.solve
            def slow(*given):
                inside.set()
                go.wait(30)
                return real(*given)
            Counted.solve = slow
            busy = threading.Thread(target=backend.solve, args=[stage])
            busy.start()
            inside.wait(30)
            child = os.fork()
            if not child:
                Counted.solve = real
                os._exit(0 if backend.solve(stage).x is not None else 1)
            assert os.waitpid(child, 0)[1] == 0, name
            go.set()
            busy.join()
            print("went on")
        """,
    )
    assert output.count("went on") == len(NATIVE), output


# threads


@pytest.mark.parametrize("name", EVERY)
def test_threads_with_a_method_each_get_the_right_answers(name):
    def many(pull: float) -> list[np.ndarray]:
        method = get_method(name)
        level = Level([[1.0, 1.0, 0.0], [1.0, -1.0, 0.0]], [pull, 0.0])
        problem = IKProblem([level], PROBLEM.bounds, reference=PROBLEM.reference)
        return [solve(problem, method, QP_ONLY).dtheta for _ in range(3)]

    pulls = [1.0, 1.2, 0.8, 0.6]
    with ThreadPoolExecutor(len(pulls)) as pool:
        for pull, answers in zip(pulls, pool.map(many, pulls, timeout=60), strict=True):
            for answer in answers:
                assert answer == pytest.approx([0.25, pull / 2.0, 0.3], abs=NEAR)


class Held:
    """A call that waits, once inside, until it is let go; later ones do not."""

    def __init__(self, call: Callable) -> None:
        self.call = call
        self.inside, self.go = threading.Event(), threading.Event()

    def __call__(self, *given, **named):
        first = not self.inside.is_set()
        self.inside.set()
        if first:
            assert self.go.wait(30)
        return self.call(*given, **named)


@pytest.mark.parametrize("name", NATIVE)
def test_a_backend_in_use_by_another_thread_says_so_and_is_not_harmed(name, monkeypatch):
    backend, stage = get_backend(name), stage_of()
    held = Held(backend._workspace.solve)
    monkeypatch.setattr(backend._workspace, "solve", lambda *given: held(*given))
    with ThreadPoolExecutor(1) as pool:
        other = pool.submit(backend.solve, stage)
        assert held.inside.wait(30)
        try:
            with pytest.raises(InputError, match=f"backend {name} is in use by another thread; make one a thread"):
                backend.solve(stage)
            assert copy.deepcopy(backend).solve(stage).x is not None
        finally:
            held.go.set()
        result = other.result(timeout=30)
    for answer in (result, backend.solve(stage)):
        assert stage.dtheta(answer.x)[:2] == pytest.approx(ANSWER[:2], abs=1e-4)


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError, SolverFailedError])
def test_a_call_that_is_broken_off_does_not_keep_its_backend_in_use(error, monkeypatch):
    def broken(*given):
        raise error

    backend = get_backend("daqp-warm")
    with monkeypatch.context() as patch:
        patch.setattr(backend._workspace, "solve", broken)
        if error is SolverFailedError:
            assert backend.solve(stage_of()).x is None
        else:
            with pytest.raises(error):
                backend.solve(stage_of())
    assert backend.solve(stage_of()).x is not None


def test_threads_that_overlap_leave_the_warnings_as_they_were(monkeypatch):
    first = Held(qpsolvers.solve_problem)
    monkeypatch.setattr(qpsolvers, "solve_problem", first)
    before = list(warnings.filters)
    with ThreadPoolExecutor(2) as pool:
        one = pool.submit(get_backend("daqp").solve, stage_of())
        assert first.inside.wait(30)
        second = Held(first.call)
        monkeypatch.setattr(qpsolvers, "solve_problem", second)
        two = pool.submit(get_backend("daqp").solve, stage_of())
        assert second.inside.wait(30)
        first.go.set()
        assert one.result(timeout=30).x is not None
        warnings.warn("nobody hears this", UserWarning, stacklevel=1)  # the second is inside still
        second.go.set()
        assert two.result(timeout=30).x is not None
    assert warnings.filters == before
    with pytest.raises(UserWarning):  # as the tests have it
        warnings.warn("but this", UserWarning, stacklevel=1)


# multipliers


def left_over(stage: Stage, x: np.ndarray, multipliers: np.ndarray) -> float:
    """‖Px + q + Gᵀ multipliers‖ of a stage, without norm if there are no rows."""
    pull = stage.problem.P @ x + stage.problem.q
    return float(np.abs(pull if stage.problem.G is None else pull + stage.problem.G.T @ multipliers).max())


MULTIPLIED = {
    "a task": PROBLEM,
    "a soft level": IKProblem(
        [Level([[1.0, 0.0], [-1.0, 0.0]], [-1e-3, -2e-3], [1.0, 3.0], kind="at_most")], Bounds([-5e-3] * 2, [1e-3, 5e-3])
    ),
    "no row": IKProblem([Level([[1.0, 1.0]], [1.0])]),
}


@pytest.mark.parametrize("name", STAGED)
@pytest.mark.parametrize("problem", MULTIPLIED.values(), ids=MULTIPLIED.keys())
def test_the_multipliers_of_an_answer_balance_its_cost(name, problem):
    backend, stage = get_backend(name), stage_of(problem)
    for _ in range(2):
        result = backend.solve(stage)
        assert result.multipliers.shape == stage.row_ids.shape
        assert (result.multipliers >= 0.0).all()
        assert left_over(stage, result.x, result.multipliers) <= STATIONARY
        if stage.problem.G is not None:
            slack = stage.problem.h - stage.problem.G @ result.x
            assert np.abs(result.multipliers * slack).max() <= STATIONARY
            assert result.multipliers.max() > 0.1  # a row binds


@pytest.mark.parametrize("name", NATIVE)
def test_what_a_caller_does_with_the_multipliers_is_no_start_for_the_next_call(name):
    used, spoilt, stage = get_backend(name), get_backend(name), stage_of()
    for backend in (used, spoilt, used, spoilt):
        result = backend.solve(stage)
        if backend is spoilt:
            result.multipliers[:] = np.nan
    assert (result.calls, spoilt.iterations) == (used.solve(stage).calls, used.iterations)


def test_a_multiplier_that_rounding_made_negative_is_zero(monkeypatch):
    backend, stage = get_backend("daqp-warm"), stage_of()
    answer = Answer(np.zeros(stage.size), np.full(len(stage.row_ids), -1e-17), 1)
    monkeypatch.setattr(backend._workspace, "solve", lambda *given: answer)
    assert (backend.solve(stage).multipliers == 0.0).all()


@pytest.mark.parametrize("name", ["daqp", "daqp-warm", "proxqp", "proxqp-warm", "quadprog", "clarabel"])
def test_a_qp_solved_once_has_multipliers_too(name):
    stage = get_method(f"damped:{name}").stage(PROBLEM)
    result = get_backend(name).solve_once(stage)
    assert result.multipliers.shape == stage.row_ids.shape
    assert left_over(stage, result.x, result.multipliers) <= STATIONARY


@pytest.mark.parametrize("name", ["clarabel", "proxqp", "daqp", "quadprog", "cvxopt"])
@pytest.mark.parametrize("good", [1, 2, 3])
def test_an_answer_whose_refinement_failed_keeps_the_multipliers_it_had(name, good, monkeypatch):
    calls, real = [], qpsolvers.solve_problem

    def fails_later(*given, **named):
        calls.append(name)
        if len(calls) > good:
            raise qpsolvers.exceptions.SolverError("later")
        return real(*given, **named)

    monkeypatch.setattr(qpsolvers, "solve_problem", fails_later)
    stage = stage_of()
    result = get_backend(name).solve(stage)
    assert left_over(stage, result.x, result.multipliers) <= STATIONARY


def test_a_native_answer_whose_refinement_failed_keeps_the_multipliers_it_had(monkeypatch):
    backend, stage, calls = get_backend("proxqp-warm"), stage_of(), []
    real = backend._workspace.solve

    def fails_later(*given) -> Answer:
        calls.append(1)
        if len(calls) == 2:
            raise ValueError("later")
        return real(*given)

    monkeypatch.setattr(backend._workspace, "solve", fails_later)
    result = backend.solve(stage)
    assert len(calls) == 2
    assert left_over(stage, result.x, result.multipliers) <= STATIONARY


@pytest.mark.parametrize("z", [None, np.full(6, np.nan), np.zeros(2)], ids=["none", "not finite", "too few"])
def test_multipliers_that_a_solver_does_not_give_are_none(z, monkeypatch):
    real = qpsolvers.solve_problem

    def without(*given, **named):
        solution = real(*given, **named)
        solution.z = z
        return solution

    monkeypatch.setattr(qpsolvers, "solve_problem", without)
    result = get_backend("proxqp").solve(stage_of())
    assert result.x is not None
    assert result.multipliers is None


@pytest.mark.parametrize("name", STAGED)
def test_a_stage_without_answer_has_no_multipliers(name):
    stage = get_method(f"damped:{name}").stage(infeasible())
    result = get_backend(name).solve_once(stage)
    if result.x is None:  # not every solver tells, with its default options
        assert result.multipliers is None


# the front door


def test_the_errors_that_a_program_handles_stand_in_the_package():
    assert prioritized_ik.InputError is InputError
    assert prioritized_ik.SolverUnavailableError is SolverUnavailableError
    assert {"InputError", "SolverUnavailableError", "InfeasibleError"} <= set(prioritized_ik.__all__)


def test_the_version_is_that_of_the_installed_package_and_costs_no_heavy_import():
    heavy = ("numpy", "scipy", "mujoco", "qpsolvers")
    check = (
        f"import prioritized_ik, sys; print(prioritized_ik.__version__); sys.exit(any(m in sys.modules for m in {heavy}))"
    )
    done = subprocess.run([sys.executable, "-c", check], check=False, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout.strip()) == (0, importlib.metadata.version("prioritized-ik"))
    assert "__version__" not in prioritized_ik.__all__  # a module that imports * keeps its own


def test_a_package_that_is_not_installed_has_no_version(monkeypatch):
    def missing(name: str) -> str:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "version", missing)
    assert prioritized_ik.__version__ == "unknown"


def test_a_name_that_the_package_lacks_is_an_attribute_error():
    with pytest.raises(AttributeError, match="sorcery"):
        _ = prioritized_ik.sorcery


# nonsense


@pytest.mark.parametrize("name", [None, 3, [], b"daqp", np.nan])
def test_a_solver_that_is_no_name_is_refused_with_the_choices(name):
    with pytest.raises(InputError, match=r"solver is .*; expected a name, one of: .*daqp.*quadprog") as caught:
        get_backend(name)
    assert repr(name) in str(caught.value)


@pytest.mark.parametrize(
    ("name", "meant"),
    [("dapq", "'daqp'"), ("DAQP-Warm", "'daqp-warm'"), ("proxqp_warm", "'proxqp-warm'"), ("highspy", "'highs'")],
)
def test_a_misspelt_solver_is_told_the_nearest_name_first(name, meant):
    with pytest.raises(SolverUnavailableError, match=rf"unknown solver '{name}'; did you mean {meant}.*\? choose one of: "):
        get_backend(name, 1e-15)  # as for its accuracy, nothing is known


@pytest.mark.parametrize("accuracy", ["1e-8", None, np.nan, -np.inf, 1j, Decimal("1e-8"), [1e-8], True, 10**400])
def test_an_accuracy_that_is_none_is_refused(accuracy):
    with pytest.raises(InputError, match=r"accuracy is .*; expected a number above 0 and below 1"):
        get_backend("daqp", accuracy)


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_an_accuracy_of_numpy_is_a_number(kind):
    backend = get_backend("daqp", kind(1e-7))
    assert type(backend.accuracy) is float
    assert backend.solve(stage_of()).x is not None
