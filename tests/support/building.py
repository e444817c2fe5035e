"""The compiled core built anew, from its sources or from changed ones."""

import importlib.util
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from repository import ROOT

from prioritized_ik.solvers.compiled import fast, workspace
from prioritized_ik.solvers.compiled.library import FOLDER, Library, load

BUILD = ROOT / "hatch_build.py"


def build_script() -> Any:
    """The script that compiles the core, as a module."""
    spec = importlib.util.spec_from_file_location("hatch_build", BUILD)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def replace_in_sources(folder: Path, changes: dict[str, str]) -> Library:
    """Return the core for any processor, compiled from sources with some text replaced."""
    script = build_script()
    copy = folder / script.CORE
    shutil.copytree(FOLDER, copy)
    for right, wrong in changes.items():
        texts = {path: path.read_text(encoding="utf-8") for path in copy.glob("*.hpp")}
        (path,) = [path for path, text in texts.items() if right in text]
        assert texts[path].count(right) == 1, right
        path.write_text(texts[path].replace(right, wrong), encoding="utf-8")
    script.VARIANTS = {script.BASELINE: ()}
    script.FLAGS = tuple(flag if flag != "-O3" else "-O0" for flag in script.FLAGS)
    script.build(folder)
    made = load(copy)
    assert made.core is not None, made.note
    return made


@contextmanager
def loaded(made: Library, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let another library answer."""
    with monkeypatch.context() as patch:
        for module in (fast, workspace):
            patch.setattr(module, "library", lambda: made)
        patch.setattr(workspace._OWN, "by_joints", {})
        yield
