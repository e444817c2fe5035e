"""The compiled core beside the Python form: the same steps, proven by the same certificate, or none."""

import os
import re
import shutil
import subprocess
import sys
import threading
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import ClassVar

import campaign
import exact
import numpy as np
import paths
import pytest
from building import build_script, loaded, replace_in_sources
from repository import ROOT
from winding_fixtures import constrained_steps, free_steps, recorded

from prioritized_ik import tolerances
from prioritized_ik.errors import PrioritizedIkError
from prioritized_ik.problem import Bounds, Equalities, IKProblem, Level, Rows
from prioritized_ik.solvers import compiled
from prioritized_ik.solvers.certificate import certify
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.compiled import fast
from prioritized_ik.solvers.compiled.library import FOLDER, SWITCH, Ending, Library, digest, library, load, tolerances_of
from prioritized_ik.solvers.compiled.workspace import Sizes, workspace_for
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.solvers.solve import solve
from prioritized_ik.solvers.step import JointStep, StepStatus

pytestmark = pytest.mark.skipif(not paths.COMPILED, reason=f"no compiled core: {library().note}")

AGREES = 1e-10  # of the step: p99 of how far the two forms may be apart
WORST = 1e-7  # of the step, beyond what both certificates name as rounding
PER_KIND = 12
CUT = SolveOptions(rank_tolerance=RANK_TOLERANCE)


@cache
def answered(name: str) -> list[tuple[IKProblem, JointStep]]:
    """The members of a kind of the campaign that the core answers, with its steps."""
    found = []
    for seed in range(PER_KIND):
        try:
            problem = campaign.draw(name, seed).problem
        except PrioritizedIkError:
            continue
        if fast.answers(problem) and (step := fast.compiled_step(problem, 0.0)) is not None:
            found.append((problem, step))
    return found


def by_python(problem: IKProblem, options: SolveOptions | None = None) -> JointStep:
    with paths.only("python"):
        return get_method("active-set").step(problem, options or SolveOptions())


def apart(one: np.ndarray, other: np.ndarray, problem: IKProblem) -> float:
    """How far two steps are apart, relative to what figures of a certificate count against, in the joint metric."""
    u, v = problem.to_metric(one), problem.to_metric(other)
    hierarchy = Hierarchy(problem)
    return float(np.linalg.norm(u - v) / max(hierarchy.scale(u), hierarchy.scale(v)))


class TestBesideThePythonForm:
    @pytest.mark.parametrize("name", campaign.supported())
    def test_what_the_core_answers_the_python_certificate_accepts(self, name: str) -> None:
        for problem, step in answered(name):
            judged = certify(problem, step.dtheta)
            if (
                name == "mixed" and judged.variation > tolerances.UNDECIDED
            ):  # it sees more rounding: rational numbers decide
                best = exact.optimum(exact.ExactProblem.of(problem))
                assert best is not None
                assert apart(step.dtheta, np.array(best.x, float), problem) <= WORST + step.certificate.variation
            else:
                assert judged.holds

    @pytest.mark.parametrize("name", campaign.supported())
    def test_what_the_core_answers_is_the_step_of_the_python_form(self, name: str) -> None:
        for problem, step in answered(name):
            other = by_python(problem)
            allowed = WORST + step.certificate.variation
            if other.certificate.holds:
                assert apart(step.dtheta, other.dtheta, problem) <= allowed + other.certificate.variation
            else:  # the optimum in rational numbers decides
                best = exact.optimum(exact.ExactProblem.of(problem))
                assert best is not None
                assert apart(step.dtheta, np.array(best.x, float), problem) <= allowed

    def test_the_two_forms_agree_to_ten_digits_over_the_whole_campaign(self) -> None:
        far = [
            apart(step.dtheta, by_python(problem).dtheta, problem)
            for name in campaign.supported()
            # All of a step at rest is less than what a certificate asks for; rounding by a metric decides more than that.
            if name not in ("robot_at_rest", "rounded_by_metric")
            for problem, step in answered(name)
        ]
        assert len(far) >= 200
        assert np.percentile(far, 99) <= AGREES

    @pytest.mark.parametrize("direction", ["back", "up"])
    def test_the_two_forms_agree_to_ten_digits_along_a_winding(self, direction: str) -> None:
        problems = list(recorded(direction).problems())
        core, python = get_method("active-set"), get_method("active-set")
        steps = [core.step(problem, CUT) for problem in problems]
        with paths.only("python"):
            others = [python.step(problem, CUT) for problem in problems]
        compiled = [trio for trio in zip(problems, steps, others, strict=True) if trio[1].path == "compiled"]
        assert len(compiled) >= 0.98 * len(steps)
        assert np.percentile([apart(step.dtheta, other.dtheta, problem) for problem, step, other in compiled], 99) <= AGREES
        assert all(certify(problem, step.dtheta, RANK_TOLERANCE).holds for problem, step, _ in compiled[::5])

    def test_the_oracle_in_rational_numbers_finds_no_step_of_the_core_wrong(self) -> None:
        names = campaign.supported()
        tallies = campaign.campaign(names, range(PER_KIND), campaign.judge_compiled)
        assert not any(tally.fatal for tally in tallies.values()), campaign.table(tallies, reasons=True)
        assert sum(tally.counts[campaign.RIGHT] for tally in tallies.values()) >= 0.4 * PER_KIND * len(names)


def damped_problem(rng: np.random.Generator, damping: float, at_rest: bool) -> tuple[IKProblem, exact.Optimum]:
    """A damped level beside bounds and a row, and its exact optimum; at rest limits are in the way of all of it."""
    m = int(rng.integers(4, 10))
    k = int(rng.integers(2, m))
    matrix, target = rng.normal(size=(k, m)), 0.3 * rng.normal(size=k)
    room = np.where(rng.random(m) < (0.7 if at_rest else 0.1), 0.0, 0.03)
    upper, lower = np.where(matrix.T @ target > 0.0, room, 0.03), np.where(matrix.T @ target > 0.0, -0.03, -room)
    hard = rng.normal(size=(1, m))
    bounds, rows = Bounds(lower, upper), Rows(hard, [0.0 if at_rest else 0.01])
    level = Level(matrix, target, rng.uniform(0.3, 3.0, k), damping=damping, below="hold")
    whole = Level(
        np.vstack([matrix, np.sqrt(damping) * np.eye(m)]),
        np.append(target, np.zeros(m)),
        np.append(level.weights, np.ones(m)),
    )
    best = exact.optimum(exact.ExactProblem.of(IKProblem([whole], bounds, rows)))
    assert best is not None
    return IKProblem([level], bounds, rows), best


class TestMoreDigits:
    """Where rounding of doubles hides whether a step is optimal, the core looks with twice the digits."""

    @pytest.mark.parametrize("at_rest", [False, True])
    @pytest.mark.parametrize("damping", [1e-12, 1e-9, 1e-6, 1e-3])
    def test_damping_far_below_the_rows_is_answered_beside_active_limits_and_exact(
        self, damping: float, at_rest: bool
    ) -> None:
        rng = np.random.default_rng([int(-np.log10(damping)), at_rest])
        drawn = [damped_problem(rng, damping, at_rest) for _ in range(40)]
        steps = [fast.compiled_step(problem, 0.0) for problem, _ in drawn]
        found = [(step, best) for step, (_, best) in zip(steps, drawn, strict=True) if step is not None]
        assert len(found) >= 0.95 * len(drawn)
        assert sum(step.status is StepStatus.SOLVED for step, _ in found) >= 0.5 * len(drawn)
        for step, best in found:
            scale = step.written.answer.all_figures(1)[-2]  # of one level
            off = np.linalg.norm([float(a - Fraction(b)) for a, b in zip(best.x, step.dtheta.tolist(), strict=True)])
            assert off <= (tolerances.CERTIFIED + step.certificate.variation) * scale

    def test_what_the_core_leaves_open_python_does_not_certify(self) -> None:
        rng, seen = np.random.default_rng(8), 0
        for _ in range(150):
            m = 7
            above, ask = rng.normal(size=(3, m)), rng.normal(size=(2, m))
            room = np.where(rng.random(m) < 0.4, 0.0, 0.03)
            levels = [
                Level(above, above @ (0.01 * rng.uniform(0.0, room))),
                Level(ask, rng.normal(size=2), damping=1e-12, below="hold"),
            ]
            # The root of a metric rounds what is given: there are no more digits to look at.
            problem = IKProblem(levels, Bounds(np.full(m, -0.03), room), metric=rng.uniform(0.5, 2.0, m))
            step = fast.compiled_step(problem, 0.0)
            if step is None or step.status is not StepStatus.UNCERTIFIED:
                continue
            seen += 1
            other = by_python(problem)
            assert other.status is StepStatus.UNCERTIFIED
            assert other.certificate.is_optimal
            assert apart(step.dtheta, other.dtheta, problem) <= step.certificate.variation + other.certificate.variation
        assert seen >= 10

    @pytest.mark.skipif(build_script().compiler() is None, reason="no C++ compiler")
    @pytest.mark.parametrize(
        "change",
        [
            {"add(-left[j], basis": "add(0.999 * left[j], basis"},
            {"low += std::fma(a, b, -product);": ""},
        ],
        ids=["mended the wrong way", "products of a double's digits"],
    )
    def test_one_that_looks_wrongly_declines(
        self, change: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        rng = np.random.default_rng(3)
        drawn = [damped_problem(rng, 1e-12, at_rest=False) for _ in range(20)]
        honest = sum(fast.compiled_step(problem, 0.0) is not None for problem, _ in drawn)
        with loaded(replace_in_sources(tmp_path, change), monkeypatch):
            steps = [fast.compiled_step(problem, 0.0) for problem, _ in drawn]
        assert sum(step is not None for step in steps) < honest
        for step, (problem, best) in zip(steps, drawn, strict=True):
            assert step is None or apart(step.dtheta, np.array(best.x, float), problem) <= tolerances.UNDECIDED


def features() -> dict[str, IKProblem]:
    rng = np.random.default_rng(5)
    m = 6
    a, b, c = (Level(rng.normal(size=(k, m)), rng.normal(size=k), name=name) for k, name in ((2, "a"), (2, "b"), (4, "c")))
    bounds = Bounds(np.full(m, -0.3), np.full(m, 0.3))
    frozen = Bounds(np.where(np.arange(m) == 2, 0.1, -0.4), np.where(np.arange(m) == 2, 0.1, 0.4))
    rows = Rows(rng.normal(size=(3, m)), [0.1, np.inf, 0.2])
    equalities = Equalities(rng.normal(size=(1, m)), [0.05])
    root = rng.normal(size=(m, m))
    damped = {below: Level(a.matrix, a.target, name="a", damping=0.1, below=below) for below in ("free", "hold")}
    return {
        "no row": IKProblem([a, b]),
        "bounds": IKProblem([a, b, c], bounds),
        "rows": IKProblem([a, b, c], rows=rows),
        "frozen joint": IKProblem([a, c], frozen),
        "equalities": IKProblem([a, b], bounds, equalities=equalities),
        "reference": IKProblem([a], bounds, reference=np.ones(m)),
        "diagonal metric": IKProblem([a, b, c], bounds, rows, metric=rng.uniform(0.1, 10.0, m)),
        "metric that couples joints": IKProblem([a, b, c], bounds, rows, metric=root @ root.T + np.eye(m)),
        "metric and frozen joint": IKProblem([a, b, c], frozen, rows, metric=root @ root.T + np.eye(m)),
        "damped and free below": IKProblem([damped["free"], c], bounds),
        "damped and held below": IKProblem([damped["hold"], c], bounds),
        "repeated equalities": IKProblem([b], bounds, equalities=Equalities(equalities.matrix[[0, 0]], [0.05, 0.05])),
        "no level": IKProblem([], bounds, reference=np.ones(m)),
        "zero weight": IKProblem([Level(c.matrix, c.target, [1.0, 0.0, 2.0, 0.0])], bounds),
        "no wish": IKProblem([Level(a.matrix, np.zeros(2))], bounds),
        "soft level that is kept": IKProblem([Level(np.eye(m), np.full(m, 9.0), kind="at_most"), a], bounds),
        "soft level that binds": IKProblem([Level(b.matrix, b.target - 2.0, kind="at_most"), a, c], bounds, rows),
        "soft level in between": IKProblem([a, Level(c.matrix, c.target, [1, 2, 3, 0], "c", "at_most"), b], bounds),
        "soft levels, one without sides": IKProblem(
            [
                Level(-c.matrix, [-0.4, np.inf, np.inf, -0.2], name="c", kind="at_most"),
                Level(b.matrix, [np.inf, np.inf], name="b", kind="at_most"),
                a,
            ],
            bounds,
            equalities=equalities,
        ),
        "soft level and metric": IKProblem(
            [Level(b.matrix, b.target - 2.0, name="b", kind="at_most"), a, c], bounds, metric=root @ root.T + np.eye(m)
        ),
    }


class TestFeatures:
    @pytest.mark.parametrize("name", features())
    def test_each_feature_of_the_table_runs_compiled_and_agrees(self, name: str) -> None:
        problem = features()[name]
        step, other = get_method("active-set").step(problem, SolveOptions()), by_python(problem)
        assert (step.path, other.path) == ("compiled", "python")
        assert step.status is other.status
        assert step.certificate.holds
        assert apart(step.dtheta, other.dtheta, problem) <= AGREES
        assert step.costs == pytest.approx(other.costs, rel=1e-9, abs=1e-18)
        assert step.tight_rows == other.tight_rows
        assert set(step.active_rows) <= set(other.active_rows)  # which has the bounds of frozen joints too
        assert [str(report) for report in step.levels] == [str(report) for report in other.levels]

    def test_the_page_has_the_table_of_the_package(self) -> None:
        page = (ROOT / "docs" / "performance.md").read_text(encoding="utf-8")
        rows = [line for line in (compiled.__doc__ or "").splitlines() if line.startswith("| ")]
        assert len(rows) > 8
        assert all(row in page for row in rows)

    @pytest.mark.parametrize("name", ["noise", "nearly repeated equalities", "conflict"])
    def test_what_the_table_leaves_to_the_python_form_is_answered_there(self, name: str) -> None:
        eye, ask = np.eye(3), Level(np.eye(3)[:2], [1.0, 2.0])
        problem = {
            "noise": IKProblem([ask], noise=1e-6),
            "nearly repeated equalities": IKProblem([ask], equalities=Equalities([eye[2], [0.0, 1e-9, 1.0]], [0.5, 0.5])),
            "conflict": IKProblem([ask], rows=Rows([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]], [1.0, -2.0])),
        }[name]
        step = get_method("active-set").step(problem, SolveOptions())
        assert step.path == "python"
        assert step.status is (StepStatus.INFEASIBLE if name == "conflict" else StepStatus.CLOSED_FORM)

    def test_rows_of_levels_that_are_rounding_are_named(self) -> None:
        level = Level([[1.0, 0.0], [1e-17, 0.0], [0.0, 1e-14]], [1.0, 1.0, 1.0], name="arm")
        problem = IKProblem([level], rows=Rows([[1e-16, 0.0], [1.0, 1.0]], [0.5, 0.5], ["dust", "wall"]))
        step = solve(problem)
        assert (step.path, step.zeros) == ("compiled", ("arm row 2", "arm row 3", "dust"))
        assert step.zeros == by_python(problem).zeros


class TestBits:
    def test_every_start_leads_to_the_same_bits(self) -> None:
        rng, seen = np.random.default_rng(1), 0
        for problem in constrained_steps():
            warm = get_method("active-set")
            first = warm.step(problem, CUT)
            if first.path != "compiled":
                continue
            seen += 1
            names = problem.inequalities.names
            half = [name for name in first.active_rows if rng.random() < 0.5]
            for guess in (first.active_rows, half, (), [*half, *rng.choice(names, 3)]):
                again = fast.compiled_step(problem, RANK_TOLERANCE, guess)
                assert again is not None
                assert again.dtheta.tobytes() == first.dtheta.tobytes()
                assert again.certificate == first.certificate
        assert seen >= 6

    @pytest.mark.parametrize(
        "name",
        ["dyadic", "conflicts", "many_levels", "soft_mix", "soft_first", "planar_soft", "degenerate_vertex", "joint_units"],
    )
    def test_every_start_leads_to_the_same_bits_on_the_campaign(self, name: str) -> None:
        rng = np.random.default_rng(2)
        for problem, step in answered(name):
            for _ in range(4):
                guess = [row for row in step.written.active.names if rng.random() < 0.3]
                again = fast.compiled_step(problem, 0.0, guess)
                assert again is None or again.dtheta.tobytes() == step.dtheta.tobytes()

    @pytest.mark.parametrize("solver", ["daqp", "proxqp", "osqp"])
    def test_every_solver_s_guess_leads_to_the_same_bits(self, solver: str) -> None:
        for problem in (*constrained_steps(), *free_steps()[:2]):
            own, other = solve(problem, options=CUT), solve(problem, solver, CUT)
            if "python" not in (own.path, other.path):
                assert own.dtheta.tobytes() == other.dtheta.tobytes()

    def test_threads_do_not_share_their_arrays(self) -> None:
        problems = [problem for problem, _ in answered("integer") + answered("conflicts")]
        alone = [solve(problem).dtheta.tobytes() for problem in problems]
        found: dict[int, list[bytes]] = {}

        def run(number: int) -> None:
            found[number] = [solve(problem).dtheta.tobytes() for problem in problems]

        threads = [threading.Thread(target=run, args=(i,)) for i in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert all(found[i] == alone for i in range(4))

    def test_the_rows_of_a_larger_problem_leave_no_trace(self) -> None:
        small = features()["bounds"]
        alone = solve(small).dtheta.tobytes()
        for name in ("rows", "equalities", "diagonal metric", "damped and held below", "reference"):
            solve(features()[name])
            assert solve(small).dtheta.tobytes() == alone


class TestTheLibrary:
    def test_its_tolerances_are_those_of_the_table(self) -> None:
        core = library().core
        assert core is not None
        assert tolerances.CERTIFIED in tolerances_of(core)
        named = core.core_tolerances().decode().split()
        assert tolerances_of(core).tolist() == [float(getattr(tolerances, name)) for name in named]

    def test_its_endings_are_named_alike_on_both_sides(self) -> None:
        text = (FOLDER / "exchange.hpp").read_text(encoding="utf-8")
        block = re.search(r"enum Ending : int \{(.*?)\};", text, re.DOTALL)
        assert block is not None
        assert re.findall(r"^\s+([A-Z_]+),", block[1], re.MULTILINE) == [ending.name for ending in Ending]

    def test_one_of_other_sources_is_refused(self, tmp_path: Path) -> None:
        copy = copied(tmp_path)
        assert load(copy).core is not None
        with (copy / "step.hpp").open("a") as source:
            source.write("// changed\n")
        refused = load(copy)
        assert refused.core is None
        assert "other sources" in refused.note

    def test_one_that_is_damaged_is_refused(self, tmp_path: Path) -> None:
        copy = copied(tmp_path)
        (copy / "core-baseline.so").write_bytes(b"nothing")
        refused = load(copy)
        assert refused.core is None
        assert "cannot be loaded" in refused.note

    def test_where_there_is_none_the_python_form_runs_and_says_so(self, tmp_path: Path) -> None:
        assert load(tmp_path) == Library(None, "not compiled: there was no C++ compiler when the package was installed")

    def test_it_is_not_loaded_before_the_first_solve(self) -> None:
        check = "import prioritized_ik, sys; sys.exit('prioritized_ik.solvers.compiled.library' in sys.modules)"
        assert subprocess.run([sys.executable, "-c", check], check=False).returncode == 0

    @pytest.mark.parametrize(("value", "path"), [("1", "python"), ("0", "compiled")])
    def test_the_switch_leaves_the_python_form_alone(self, value: str, path: str) -> None:
        code = (
            "from prioritized_ik.problem import IKProblem, Level\nfrom prioritized_ik.solvers.solve import solve\n"
            "print(solve(IKProblem([Level([[1.0, 2.0]], [1.0])])).path)"
        )
        done = subprocess.run(
            [sys.executable, "-c", code], env=os.environ | {SWITCH: value}, check=True, capture_output=True, text=True
        )
        assert done.stdout.strip() == path

    def test_the_digest_is_that_of_the_build(self) -> None:
        root = ROOT
        code = "import hatch_build, pathlib; print(hatch_build.digest(hatch_build.CORE))"
        done = subprocess.run([sys.executable, "-c", code], cwd=root, check=True, capture_output=True, text=True)
        assert done.stdout.strip() == digest()


def copied(folder: Path) -> Path:
    copy = folder / "compiled"
    shutil.copytree(FOLDER, copy)
    return copy


class TestTheBuild:
    def test_without_a_compiler_it_says_what_to_install(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        script = build_script()
        monkeypatch.setattr(script, "compiler", lambda: None)
        with pytest.raises(
            RuntimeError, match=r"no C\+\+ compiler: set CXX, or install g\+\+, clang\+\+ or the wheel ziglang"
        ):
            script.build(tmp_path)

    def test_a_compiler_that_fails_is_an_error_and_leaves_no_library(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        script = build_script()
        folder = tmp_path / script.CORE
        shutil.copytree(FOLDER, folder)
        monkeypatch.setattr(script, "compiler", lambda: [sys.executable, "-c", "import sys; sys.exit('no such flag')"])
        with pytest.raises(RuntimeError, match="failed: no such flag"):
            script.build(tmp_path)
        assert load(folder).core is None
        assert not list(folder.glob("*.so"))

    def test_a_compiler_that_is_not_there_is_an_error(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        script = build_script()
        monkeypatch.setattr(script, "compiler", lambda: ["no-such-compiler"])
        with pytest.raises(RuntimeError, match="no-such-compiler does not run"):
            script.build(tmp_path)

    def test_the_library_for_any_processor_answers_too(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        copy = copied(tmp_path)
        for other in set(copy.glob("core-*.so")) - {copy / "core-baseline.so"}:
            other.unlink()
        baseline = load(copy)
        assert (baseline.core is not None, baseline.note) == (True, "core-baseline.so")
        problem = features()["bounds"]
        fastest = solve(problem)
        with loaded(baseline, monkeypatch):
            step = solve(problem)
            assert step.path == "compiled"
            assert apart(step.dtheta, fastest.dtheta, problem) <= AGREES


@pytest.mark.skipif(build_script().compiler() is None, reason="no C++ compiler")
class TestSabotage:
    """A core whose step is wrong must be refused by its own certificate, which looks at the rows as they are given."""

    CHANGES: ClassVar[dict[str, dict[str, str]]] = {
        "a level's share of the step": {
            "block.R.solve(y);\n            copy": "block.R.solve(y);\n            y[0] *= 1.000001;\n            copy"
        },
        "a side that is not kept": {"sides[i] = side_[ids[i]];": "sides[i] = 1.000001 * side_[ids[i]];"},
        "a target among the factors": {"block.target()[at] = block.root": "block.target()[at] = 1.00001 * block.root"},
    }

    @pytest.mark.parametrize("name", CHANGES)
    def test_a_wrong_step_is_declined_and_the_python_form_answers(
        self, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        problems = [features()[kind] for kind in ("bounds", "rows", "diagonal metric", "reference")]
        honest = [solve(problem) for problem in problems]
        assert all(step.path == "compiled" for step in honest)
        with loaded(replace_in_sources(tmp_path, self.CHANGES[name]), monkeypatch):
            for problem, before in zip(problems, honest, strict=True):
                step = solve(problem)
                assert step.path == "python"
                assert step.certificate.holds
                assert apart(step.dtheta, before.dtheta, problem) <= AGREES

    def test_soft_rows_that_are_not_held_below_their_level_are_noticed(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        rng = np.random.default_rng(4)
        problems = []
        while len(problems) < 3:  # where a soft row is tight, and the level below pulls at it
            soft, ask = Level(rng.normal(size=(3, 5)), rng.normal(size=3), kind="at_most"), rng.normal(size=(3, 5))
            problem = IKProblem([soft, Level(ask, 3.0 * rng.normal(size=3))])
            if solve(problem).certificate.held_by[1]:
                problems.append(problem)
        honest = [solve(problem) for problem in problems]
        assert all(step.path == "compiled" for step in honest)
        made = replace_in_sources(tmp_path, {"level_of_[ids[next]] == l;": "level_of_[ids[next]] == l - 100;"})
        with loaded(made, monkeypatch):
            for problem, before in zip(problems, honest, strict=True):
                step = solve(problem)
                assert step.path == "python"
                assert apart(step.dtheta, before.dtheta, problem) <= AGREES

    def test_a_step_off_by_a_millionth_is_refused_by_the_python_certificate(self) -> None:
        for problem in features().values():
            step = solve(problem)
            size = np.linalg.norm(step.dtheta)
            if size:
                assert not certify(problem, step.dtheta + 1e-6 * size * np.ones(6) / np.sqrt(6)).holds


def test_sizes_of_another_problem_find_another_room() -> None:
    one, other = workspace_for(Sizes(3, 1, 3, 0, 0)), workspace_for(Sizes(3, 9, 90, 40, 2))
    assert other.room.level_rows >= 90
    assert one.room.joints == other.room.joints


def test_no_step_is_made_of_rows_in_conflict_without_any_level() -> None:
    problem = IKProblem([], rows=Rows([[1.0, 0.0], [-1.0, 0.0]], [0.1, -0.5], ["slow", "back"]))
    step = get_method("active-set").step(problem, SolveOptions())
    assert step.status is StepStatus.INFEASIBLE
    assert step.dtheta is None
