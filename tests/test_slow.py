"""What `make unit-fast` leaves out, and what is started first, is there: a test renamed would come back unseen."""

import ast
from pathlib import Path

import slow


def test_every_slow_module_and_test_exists() -> None:
    modules = {path.stem.removeprefix("test_"): path for path in Path(__file__).parent.rglob("test_*.py")}
    assert {*slow.MODULES, *slow.LONGEST} - set(modules) == set()
    for module, names in slow.TESTS.items():
        tree = ast.parse(modules[module].read_text(encoding="utf-8"))
        there = {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
        assert {f"test_{name}" for name in names} <= there, module
