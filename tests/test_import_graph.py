"""Imports run one way: each layer imports only what stands before it, deferred imports included."""

import ast
import importlib
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

import prioritized_ik

PACKAGE = "prioritized_ik"
ROOT = Path(prioritized_ik.__file__).parent

#: A layer imports those before it; the entries of one layer do not import each other.
LAYERS = [
    {"errors", "tolerances", "late"},
    {"validation", "files", "rendering", "extras"},
    {"double_double"},
    {"pictures", "processes", "kinematic_tree", "model_cache", "mujoco_functions"},
    {"models", "jacobians", "model_tree"},
    {"virtual_arms"},
    {"touch", "problem", "weights"},
    {"tree_problem"},
    {"limits", "packed", "problem_file", "model_file"},
    {"recording"},
    {"robot"},
    {"tasks", "guard", "examples"},
    {"joint_limits", "collision", "support", "model_equalities"},
    {"solvers"},
    {"curvature", "live", "posing"},
    {"motion"},
    {"reaching"},
    {"scene"},
    {"winding", "mink", "viewer"},
    {"cli", "comparisons", "paper_repro"},
]
SOLVERS = {"qpsolvers", "cvxpy", "daqp", "proxsuite", "osqp"}
FOLD = (
    "stages",
    "stagewise",
    "lexicographic",
    "methods",
    "registry",
    "refinement",
    "backends",
)  # how a step is found, as opposed to proven
RANK = {part: rank for rank, layer in enumerate(LAYERS) for part in layer}


@cache
def _sources() -> dict[str, str]:
    """Every module's dotted name below the package, and its text; the package's own lazy `__init__` aside."""
    names = {}
    for path in sorted(ROOT.rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        parts = parts[:-1] if parts[-1] == "__init__" else parts
        if parts:
            names[".".join(parts)] = path.read_text(encoding="utf-8")
    return names


@cache
def _imported(module: str, text: str) -> set[str]:
    """Absolute dotted names that a module's text imports, at whatever depth the statement stands."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            parents = [PACKAGE, *module.split(".")][: -node.level or None]
            base = node.module if not node.level else ".".join([*parents, *([node.module] if node.module else [])])
            found |= {base} | {f"{base}.{alias.name}" for alias in node.names}
    return found


def _part(name: str) -> str | None:
    """The part of the house that a dotted name belongs to, or None for another library."""
    top, _, rest = name.partition(".")
    if top in ("comparisons", "paper_repro"):
        return top
    return rest.split(".")[0] if top == PACKAGE and rest else None


def _wrong_ways(sources: dict[str, str]) -> list[str]:
    """Every import that does not run backwards along the layers."""
    wrong = []
    for module, text in sources.items():
        own = module.split(".")[0]
        for name in sorted(_imported(module, text)):
            part = _part(name)
            if part in RANK and part != own and RANK[part] >= RANK.get(own, len(LAYERS)):
                wrong.append(f"{module} imports {name}")
    return wrong


def _reachable(start: str, sources: dict[str, str]) -> set[str]:
    """Absolute names that importing module `start` brings in, through modules of the package."""
    seen, waiting = set(), [start]
    while waiting:
        module = waiting.pop()
        for name in _imported(module, sources[module]) - seen:
            seen.add(name)
            inner = name.removeprefix(f"{PACKAGE}.")
            if name != inner and inner in sources:
                waiting.append(inner)
    return seen


def test_every_module_has_a_layer():
    assert {module.split(".")[0] for module in _sources()} <= RANK.keys()


def test_imports_run_only_backwards_along_the_layers():
    assert _wrong_ways(_sources()) == []


def test_no_two_modules_import_each_other():
    sources = _sources()
    for module in sources:
        assert f"{PACKAGE}.{module}" not in _reachable(module, sources), module


@pytest.mark.parametrize(
    "module", sorted(name for name in _sources() if name.split(".")[0] in ("problem", "weights", "solvers"))
)
def test_problems_and_their_solution_know_nothing_of_mujoco(module):
    assert not any(name.split(".")[0] in ("mujoco", "mink") for name in _reachable(module, _sources()))


@pytest.mark.parametrize("module", ["problem", "solvers.closed_form", "solvers.hierarchy", "winding.plan", "weights"])
def test_the_papers_equations_and_strict_levels_know_no_solver(module):
    assert not any(name.split(".")[0] in SOLVERS for name in _reachable(module, _sources()))


@pytest.mark.parametrize("module", ["solvers.certificate", "solvers.active_set"])
def test_the_proof_of_a_step_knows_no_solver(module):
    reached = _reachable(module, _sources())
    assert not any(name.split(".")[0] in SOLVERS for name in reached)
    assert not any(name.startswith(f"{PACKAGE}.solvers.{part}") for part in FOLD for name in reached)


def test_the_certificate_does_not_know_the_active_set():
    assert f"{PACKAGE}.solvers.active_set" not in _reachable("solvers.certificate", _sources())


def test_the_witness_shares_no_code_with_the_solvers():
    assert not any(name.startswith(f"{PACKAGE}.solvers") for name in _reachable("solvers.witness", _sources()))


def test_the_comparisons_do_not_know_the_paper():
    folder = Path(importlib.import_module("comparisons").__file__).parent
    for path in folder.rglob("*.py"):
        assert not any(name.startswith("paper_repro") for name in _imported(path.stem, path.read_text(encoding="utf-8"))), (
            path
        )


SABOTAGE = {
    "absolute": ("solvers.stages", "from prioritized_ik.winding import plan"),
    "plain": ("problem", "import prioritized_ik.solvers.stages"),
    "from the package": ("limits", "from prioritized_ik import winding"),
    "relative": ("solvers.stages", "from ..winding.plan import plan"),
    "deferred": ("models", "def late():\n    from prioritized_ik.touch import TouchSensor"),
    "same layer": ("problem", "from prioritized_ik.weights import WOUND"),
    "experiments": ("winding.episode", "import comparisons"),
}


@pytest.mark.parametrize(("module", "statement"), SABOTAGE.values(), ids=SABOTAGE.keys())
def test_the_check_catches_an_import_that_runs_forwards(module, statement):
    sources = _sources()
    sources[module] += f"\n{statement}\n"
    assert any(wrong.startswith(f"{module} imports") for wrong in _wrong_ways(sources))


def test_the_check_catches_mujoco_behind_another_module():
    sources = _sources()
    sources["validation"] += "\nimport mujoco\n"
    assert "mujoco" in _reachable("solvers.closed_form", sources)


def test_the_check_catches_a_solver_behind_the_certificate():
    sources = _sources()
    sources["solvers.subspaces"] += f"\ndef late():\n    from {PACKAGE}.solvers.stages import Room\n"
    assert {"qpsolvers", f"{PACKAGE}.solvers.stages"} <= _reachable("solvers.certificate", sources)


def test_importing_the_package_loads_neither_mujoco_nor_solvers():
    check = f"import {PACKAGE}, sys; sys.exit(any(name in sys.modules for name in ('mujoco', 'qpsolvers', 'scipy')))"
    assert subprocess.run([sys.executable, "-c", check], check=False).returncode == 0


def test_the_solve_runs_without_mujoco():
    check = f"import {PACKAGE}.solvers.solve, sys; sys.exit('mujoco' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", check], check=False).returncode == 0
