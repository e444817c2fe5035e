"""One door: every way to a step is a method, found by its name, and what one answers is judged by the problem."""

import concurrent.futures
import copy
import importlib.metadata
import multiprocessing
import pickle
import tomllib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import polars
import pytest
from click.testing import CliRunner
from repository import ROOT

import comparisons.methods  # noqa: F401  its families can be named
import prioritized_ik as pik
from comparisons.cases import cases_of
from comparisons.jobs import COLD, WARM, drives, replays
from comparisons.run import run
from comparisons.settings import ComparisonSettings
from comparisons.summary import summarise
from comparisons.tables import EPISODES, JOB
from prioritized_ik.cli import main
from prioritized_ik.errors import InputError, SolverUnavailableError, StepNotFoundError
from prioritized_ik.kinematic_tree import KinematicTree, PointRows
from prioritized_ik.problem import Bounds, IKProblem, Level
from prioritized_ik.solvers import registry
from prioritized_ik.solvers.backends.registry import installed_solvers
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.methods import ActiveSet, ClosedForm, Lexicographic, Method
from prioritized_ik.solvers.registry import get_method, installed_methods, known_methods
from prioritized_ik.solvers.solve import solve, step_of
from prioritized_ik.solvers.step import JointStep, StepStatus
from prioritized_ik.tree_problem import TreeLevel
from prioritized_ik.winding.episode import Outcome, wind
from prioritized_ik.winding.settings import WindingSettings

EVERY = installed_methods(on_request=True)
POSED = [name for name in EVERY if not name.startswith("mink:")]  # those that need no place
EXACT = [name for name in POSED if name.split(":")[0] in ("active-set", "daqp-hierarchy", "lexicographic")]

#: min (1 - x - y)² + (x - y)² + (z - 0.7)².
REACH = Level([[1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 0.0, 1.0]], [1.0, 0.0, 0.7])
FREE = IKProblem([REACH], Bounds([-1.0] * 3, [1.0] * 3))
BOUND = replace(FREE, bounds=Bounds([-1.0] * 3, [0.25, 1.0, 0.3]))
FREE_ANSWER, BOUND_ANSWER = [0.5, 0.5, 0.7], [0.25, 0.5, 0.3]
#: The same problem as points on a kinematic tree, three slides in a row, for methods that take no matrix.
SLIDES = KinematicTree([-1, 0, 1], np.zeros((3, 3)), [[1, 1, 0], [1, -1, 0], [0, 0, 1]], np.zeros((3, 3)))
REACH_ON_TREE = TreeLevel(PointRows(SLIDES, [2, 2, 2], np.zeros((3, 3)), np.eye(3)), REACH.target)
LOOSE = 0.1  # of solvers called once, with their default options


def posed(name: str, problem: IKProblem) -> IKProblem:
    """Return the problem as the method of a name takes it."""
    return problem.with_levels([REACH_ON_TREE]) if name.startswith("lifted:") else problem


class Standing(Method):
    """Answers with some step, whatever is asked."""

    version = "7"

    def __init__(self, accuracy: float = 1e-8, dtheta: tuple[float, ...] | None = None) -> None:
        self.name, self.accuracy, self.dtheta = "standing", accuracy, dtheta

    def step(self, problem, options=None, place=None):
        dtheta = np.zeros(problem.joint_count) if self.dtheta is None else np.array(self.dtheta)
        return JointStep(dtheta, StepStatus.SOLVED)


class SlightlyOff(Method):
    """The kernel's step, with its certificate, and then off in the last joint by a hundred thousandth of it."""

    version = "7"

    def __init__(self, accuracy: float = 1e-8) -> None:
        self.name = "off"
        self._honest = get_method("active-set")

    def step(self, problem, options=None, place=None):
        step = self._honest.step(problem, options, place)
        dtheta = np.array(step.dtheta)
        dtheta[-1] += 1e-5 * np.linalg.norm(dtheta)
        return replace(step, dtheta=dtheta)


@pytest.fixture
def added(monkeypatch: pytest.MonkeyPatch) -> Callable[[str, Callable[[float], Method]], None]:
    monkeypatch.setattr(registry, "_added", {})
    return registry.register


# Names.


@pytest.mark.parametrize("name", POSED)
def test_every_method_solves_a_small_problem_and_names_itself_in_its_step(name: str) -> None:
    step = solve(posed(name, FREE), name)
    assert step.method == get_method(name).name == name
    assert step.certificate is not None
    assert step.dtheta == pytest.approx(FREE_ANSWER, abs=LOOSE)
    if name in (*EXACT, "closed-form"):
        assert step.status is StepStatus.CLOSED_FORM
        assert step.dtheta == pytest.approx(FREE_ANSWER, abs=1e-12)


@pytest.mark.parametrize("name", EXACT)
def test_every_exact_method_proves_the_same_bits_where_rows_bind(name: str) -> None:
    options = SolveOptions(closed_form_first=False)
    step = solve(BOUND, name, options)
    assert step.status is StepStatus.SOLVED
    assert step.dtheta.tobytes() == solve(BOUND, options=options).dtheta.tobytes()
    assert step.dtheta == pytest.approx(BOUND_ANSWER, abs=1e-12)


@pytest.mark.parametrize("name", EVERY)
def test_every_method_has_a_version_and_a_path(name: str) -> None:
    method = get_method(name)
    assert method.version[0].isdigit()
    assert method.path in ("python", "compiled")


def test_a_solve_by_a_method_does_not_look_up_versions(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which are read from files of the installation: it would take longer than the solve."""
    method = get_method("active-set")
    monkeypatch.setattr(ActiveSet, "version", property(lambda method: pytest.fail("asked for its version")))
    problem = IKProblem([Level(np.eye(2), [1.0, 0.0])], Bounds([-0.5] * 2, [0.5] * 2))
    assert solve(problem, method).dtheta.tolist() == [0.5, 0.0]


@pytest.mark.parametrize("name", [name for name in EVERY if name.startswith("mink:")])
def test_mink_steps_where_a_winding_posed_the_problem_and_nowhere_else(name: str) -> None:
    episode = wind(WindingSettings(solver=name, max_steps=1, weights="eq24", speed=0.02, posture="random", seed=3))
    assert episode.settings.solver == name
    assert episode.status[0] in ("UNCERTIFIED", "SOLVED", "VIOLATED", "NOT_FOUND")
    with pytest.raises(InputError, match=f"{name} poses its problem anew"):
        solve(FREE, name)


def test_installed_methods_are_known_and_the_default_is_the_kernel_by_itself() -> None:
    assert set(EVERY) <= set(known_methods())
    assert set(installed_methods()) <= set(EVERY)
    assert solve(FREE).method == WindingSettings().solver == registry.DEFAULT == "active-set"
    assert ComparisonSettings().solvers == ("active-set", *installed_solvers())


@pytest.mark.parametrize("name", installed_solvers(on_request=True))
def test_the_bare_name_of_a_qp_solver_is_its_lexicographic_method(name: str) -> None:
    assert get_method(name).name == f"lexicographic:{name}"


def test_the_formulation_of_the_command_line_is_the_family_of_a_method() -> None:
    few = ["wind", "--steps", "2"]
    for arguments in (
        ["--formulation", "damped"],
        ["--solver", "daqp", "--formulation", "damped"],
        ["--solver", "damped:daqp"],
    ):
        assert CliRunner().invoke(main, [*few, *arguments]).exit_code == 1  # not wound in two steps
    assert registry.old_name("quadprog", "slack") == "slack:quadprog"
    assert registry.old_name("quadprog", "lexicographic") == "quadprog"
    with pytest.raises(
        InputError, match="unknown formulation 'magic'; choose one of: lexicographic, dense, lifted, damped, slack"
    ):
        registry.old_name("quadprog", "magic")


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("dapq", "'daqp'"),
        ("active_set", "'active-set'"),
        ("closedform", "'closed-form'"),
        ("damped:quadprg", "'damped:quadprog'"),
        ("lexicografic:daqp", "'lexicographic:daqp'"),
        ("mink:dapq", "'mink:daqp'"),
    ],
)
def test_a_misspelt_method_is_told_the_nearest_name_first_and_what_there_is(name: str, meant: str) -> None:
    message = rf"unknown solver '{name}'; did you mean {meant}.*\? choose one of: active-set, closed-form.*damped.*quadprog"
    with pytest.raises(SolverUnavailableError, match=message):
        solve(FREE, name)


@pytest.mark.parametrize("name", [None, 3, [], b"daqp"])
def test_a_method_that_is_no_name_is_refused_with_the_choices(name: object) -> None:
    with pytest.raises(InputError, match=r"solver is .*; expected a name, one of: active-set.*quadprog") as caught:
        get_method(name)
    assert repr(name) in str(caught.value)


@pytest.mark.parametrize("name", ["active-set", "closed-form", "daqp-hierarchy", "daqp"])
def test_a_damping_is_refused_by_methods_that_have_none(name: str) -> None:
    with pytest.raises(InputError, match=r"damping is 0\.1, but .* has none; damp a level instead"):
        solve(FREE, name, SolveOptions(damping=0.1))


def test_the_closed_form_is_refused_where_it_breaks_a_row() -> None:
    with pytest.raises(StepNotFoundError, match=r"closed-form: .*breaks a bound or row"):
        solve(BOUND, "closed-form")
    assert solve(FREE, ClosedForm()).status is StepStatus.CLOSED_FORM


def test_the_entry_point_of_the_package_brings_the_families_of_the_comparison() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    (module,) = project["project"]["entry-points"]["prioritized_ik.methods"].values()
    importlib.import_module(module)
    assert {"mink", "reference"} <= registry.families().keys()


def test_families_of_other_packages_are_found_by_their_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_families", dict(registry._families))
    family = registry.Family(lambda *given: Standing(), lambda: ["still"], lambda on_request: ["still"], "stands")

    class Entry:
        def load(self) -> None:
            registry.register_family("other", family)

    monkeypatch.setattr(registry, "entry_points", lambda group: [Entry()] if group == "prioritized_ik.methods" else [])
    monkeypatch.setattr(registry, "_load_other_packages", registry._load_other_packages.__wrapped__)
    assert isinstance(get_method("other:still"), Standing)
    assert "other:still" in known_methods()
    assert "other:still" in installed_methods()


# Programs.


@pytest.mark.parametrize("used", [False, True], ids=["unused", "used"])
@pytest.mark.parametrize("name", POSED)
def test_methods_pickle_and_copy_used_or_not(name: str, used: bool) -> None:
    method, options = get_method(name), SolveOptions(closed_form_first=False)
    if used:
        step_of(method, posed(name, FREE), options)
    for twin in (copy.copy(method), copy.deepcopy(method), pickle.loads(pickle.dumps(method))):
        assert (type(twin), twin.name, twin.version) == (type(method), method.name, method.version)
        assert twin.step(posed(name, FREE), options).dtheta == pytest.approx(FREE_ANSWER, abs=LOOSE)


def test_a_used_mink_is_pickled_without_what_mink_set_up() -> None:
    settings = WindingSettings(max_steps=2)
    method = get_method("mink:daqp")
    first = wind(settings, method)
    again = wind(settings, pickle.loads(pickle.dumps(method)))
    assert first.dtheta.tobytes() == again.dtheta.tobytes()


def _dtheta(method: Method) -> list[float]:
    return solve(BOUND, method, SolveOptions(closed_form_first=False)).dtheta.tolist()


@pytest.mark.parametrize("way", ["fork", "forkserver"])
def test_a_pool_of_processes_takes_methods_and_hands_back_their_steps(way: str) -> None:
    methods = [get_method(name) for name in ("active-set", "daqp", "daqp-warm", "daqp-hierarchy")]
    here = [_dtheta(method) for method in methods]
    context = multiprocessing.get_context(way)
    with concurrent.futures.ProcessPoolExecutor(1, mp_context=context) as pool:
        assert list(pool.map(_dtheta, methods, timeout=60)) == here


def test_methods_work_one_a_thread() -> None:
    names = ["active-set", "daqp-warm", "proxqp", "daqp-hierarchy"] * 2

    def many(name: str) -> set[bytes]:
        method = get_method(name)
        return {solve(BOUND, method, SolveOptions(closed_form_first=False)).dtheta.tobytes() for _ in range(5)}

    with concurrent.futures.ThreadPoolExecutor(len(names)) as pool:
        assert len(set().union(*pool.map(many, names, timeout=60))) == 1


# A user's own.


def test_a_registered_method_is_usable_by_its_name_everywhere(added, tmp_path: Path) -> None:
    added("mine", SlightlyOff)
    assert "mine" in known_methods()
    assert "mine" in installed_methods()
    step = solve(FREE, "mine")
    assert step.method == "mine"
    settings = WindingSettings(solver="mine", max_steps=2, link=14)
    assert wind(settings).outcome is Outcome.OUT_OF_STEPS
    assert CliRunner().invoke(main, ["wind", "--solver", "mine", "--steps", "2"]).exit_code == 1
    assert "mine" in CliRunner().invoke(main, ["solvers"]).output
    jobs = replays(ComparisonSettings(solvers=("mine",), mink=False, directions=("up",)), cases_of(ComparisonSettings()))
    assert {(job.solver, job.formulation) for job in jobs} == {("mine", "lexicographic")}


def test_a_registered_method_is_given_the_accuracy_and_its_registered_name(added) -> None:
    added("mine", Standing)
    method = get_method("mine", 1e-5)
    assert (method.accuracy, method.name) == (1e-5, "mine")


def test_a_qp_solver_of_ones_own_becomes_a_method(added) -> None:
    added("mine", lambda accuracy: Lexicographic(get_method("quadprog", accuracy).backend))
    step = solve(BOUND, "mine")
    assert step.method == "mine"
    assert step.dtheta == pytest.approx(BOUND_ANSWER, abs=1e-12)


@pytest.mark.parametrize(("name", "said"), [("a:b", "a word without a colon"), ("", "a word"), ("active-set", "own has")])
def test_a_name_that_cannot_be_registered_is_refused(added, name: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        added(name, Standing)


def test_a_factory_that_makes_no_method_is_refused(added) -> None:
    added("mine", lambda accuracy: 3)
    with pytest.raises(InputError, match="what was registered as 'mine' made a int; expected a Method"):
        get_method("mine")


# Sabotage.


def test_a_wrong_step_without_a_certificate_is_given_one_that_does_not_hold(added) -> None:
    added("mine", Standing)
    step = solve(FREE, "mine")
    assert step.status is StepStatus.UNCERTIFIED
    assert not step.certificate.holds
    right = step_of(Standing(dtheta=tuple(FREE_ANSWER)), FREE, SolveOptions())
    assert right.status is StepStatus.SOLVED
    assert right.dtheta.tolist() == FREE_ANSWER


@pytest.mark.parametrize(
    ("dtheta", "said"),
    [((9.0, 0.0, 0.0), "breaks a bound or row"), ((np.nan, 0.0, 0.0), "all of it finite"), ((0.0,), r"shape \(1,\)")],
    ids=["row", "nan", "shape"],
)
def test_a_step_that_breaks_a_row_or_is_none_is_refused(added, dtheta: tuple[float, ...], said: str) -> None:
    added("mine", partial(Standing, dtheta=dtheta))
    with pytest.raises(StepNotFoundError, match=said):
        solve(FREE, "mine")


def test_what_is_no_step_is_refused() -> None:
    class Nothing(Standing):
        def step(self, problem, options=None, place=None):
            return np.zeros(3)

    with pytest.raises(InputError, match=r"standing returned array.*; expected a JointStep"):
        solve(FREE, Nothing())


def test_a_method_that_lies_is_named_by_the_comparison_and_the_kernel_agrees(added, tmp_path: Path) -> None:
    mine = {"off": SlightlyOff, "standing": Standing}
    for name, factory in mine.items():
        added(name, factory)
    settings = ComparisonSettings(
        solvers=("active-set", "daqp", "quadprog", "daqp-hierarchy", "closed-form", "reference:clarabel", *mine),
        directions=("up",), link=(13,), steps=6, mink=False, drive=False, formulations=("lexicographic",), workers=2,
    )  # fmt: skip
    steps = run(settings, tmp_path, lambda *_: None).steps()
    rows = {row.solver: row for row in summarise(steps, polars.DataFrame(schema={**JOB, **EPISODES}))}
    assert rows["active-set"].verdict == rows["daqp"].verdict == rows["daqp-hierarchy"].verdict == "agrees"
    assert rows["active-set"].certified_same_bits_fraction == 1.0
    assert rows["reference:clarabel"].formulation == "reference"
    assert rows["off"].verdict.startswith("disagrees")
    assert rows["standing"].verdict.startswith(("disagrees", "fails"))
    assert rows["standing"].certified_fraction == 0.0


# What a comparison runs.


def test_every_method_can_be_named_to_the_comparison() -> None:
    cases = cases_of(ComparisonSettings(solvers=("daqp",), directions=("up",)))

    def jobs(kind: Callable, *names: str) -> set[tuple[str, str, str, str]]:
        settings = ComparisonSettings(solvers=names, directions=("up",), mink=False)
        return {(job.method, job.solver, job.formulation, job.start) for job in kind(settings, cases)}

    assert jobs(replays, "active-set") == {("active-set", "active-set", "lexicographic", start) for start in (COLD, WARM)}
    assert jobs(replays, "damped:quadprog") == {("damped:quadprog", "quadprog", "damped", COLD)}
    assert jobs(replays, "lexicographic:daqp") == {("daqp", "daqp", "lexicographic", COLD)}
    assert jobs(replays, "mink:quadprog") == {("mink:quadprog", "mink:quadprog", "mink", COLD)}
    assert jobs(replays, "reference:clarabel") == {("reference:clarabel", "reference:clarabel", "reference", COLD)}
    assert jobs(replays, "closed-form") == set()  # the truth that the others are held against
    driven = {method for method, *_ in jobs(drives, "closed-form", "damped:daqp", "mink:daqp", "daqp", "active-set")}
    assert driven == {"closed-form", "damped:daqp", "mink:daqp", "daqp", "active-set"}


def test_a_method_that_the_comparison_does_not_know_is_refused() -> None:
    with pytest.raises(SolverUnavailableError, match="unknown solver 'damped:dapq'; did you mean 'damped:daqp'"):
        ComparisonSettings(solvers=("damped:dapq",))


def test_the_public_names_of_the_door() -> None:
    assert pik.get_method is get_method
    assert pik.register is registry.register
    assert pik.solve is solve
    assert issubclass(Standing, pik.Method)


def test_a_backend_stands_for_the_method_that_it_makes_guesses_for() -> None:
    problem = pik.IKProblem([pik.Level([[1.0, 1.0]], [1.0])], pik.Bounds([-0.1] * 2, [0.1] * 2))
    step = pik.solve(problem, pik.get_backend("quadprog"))
    assert step.method == "lexicographic:quadprog"
    assert step.dtheta.tolist() == pik.solve(problem, "quadprog").dtheta.tolist()
