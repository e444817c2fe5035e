"""What `make unit-fast` leaves out is there: a test renamed would come back unseen, and a whole module would go with it."""

import ast
from pathlib import Path

import slow


def test_every_slow_module_and_test_exists() -> None:
    folder = Path(__file__).parent
    assert [name for name in slow.MODULES if not (folder / f"test_{name}.py").exists()] == []
    for module, names in slow.TESTS.items():
        tree = ast.parse((folder / f"test_{module}.py").read_text(encoding="utf-8"))
        there = {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
        assert {f"test_{name}" for name in names} <= there, module
