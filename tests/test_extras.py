"""The slim core: what an optional extra brings may be missing, and whoever needs it is told how to get it."""

import subprocess
import sys
import tomllib
from importlib.util import find_spec

import pytest
from repository import ROOT

from prioritized_ik.extras import EXTRAS

#: Import names of what extras bring; none of them may be needed by the core.
OPTIONAL = (
    "PIL clarabel cvxopt cvxpy dask distributed ecos highspy imageio_ffmpeg markdown_it matplotlib mink mjviser osqp piqp "
    "polars proxsuite pylatexenc qpalm quadprog scs viser"
).split()

HIDE = """
import sys

class Hidden:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] in hidden:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

import importlib.util
found = importlib.util.find_spec
importlib.util.find_spec = lambda name, package=None: None if name.partition(".")[0] in hidden else found(name, package)
sys.meta_path.insert(0, Hidden)
"""


def without(hidden: list[str], code: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", f"hidden = {hidden!r}\n{HIDE}\n{code}"]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_the_core_solves_winds_and_lists_its_solvers_without_any_extra() -> None:
    code = """
import numpy as np, prioritized_ik as pik
problem = pik.IKProblem([pik.Level(np.eye(2), [1.0, 2.0])], pik.Bounds([-1.0] * 2, [1.0] * 2))
assert pik.solve(problem, "daqp").dtheta.tolist() == pik.solve(problem).dtheta.tolist() == [1.0, 1.0]
from click.testing import CliRunner
from prioritized_ik.cli import main
listed = CliRunner().invoke(main, ["solvers"], catch_exceptions=False)
assert "pip install scs" in listed.output
wound = CliRunner().invoke(main, ["wind", "--link", "16", "--steps", "2"], catch_exceptions=False)
assert "steps        2" in wound.output, wound.output
"""
    done = without(OPTIONAL, code)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("hidden", "arguments", "extra"),
    [
        ("polars", ["compare"], "compare"),
        ("mink", ["compare"], "compare"),
        ("cvxpy", ["compare", "--witness"], "solvers"),
        ("dask", ["compare", "--scheduler", "tcp://127.0.0.1:1"], "cluster"),
        ("mink", ["demo", "minimum-norm"], "compare"),
        ("polars", ["export-qpbenchmark", "nowhere"], "compare"),
        ("PIL", ["wind", "--record", "end.png"], "render"),
        ("imageio_ffmpeg", ["wind", "--record", "end.mp4"], "render"),
        ("viser", ["wind", "--view"], "view"),
        ("matplotlib", ["paper"], "report"),
    ],
)
def test_a_command_without_its_extra_says_in_one_line_how_to_get_it(hidden: str, arguments: list[str], extra: str) -> None:
    done = without([hidden], f"from prioritized_ik.cli import main; main({arguments!r})")
    assert done.returncode == 2, done.stderr
    assert done.stderr == f"Error: {hidden} not installed; get the extra by: pip install 'prioritized-ik[{extra}]'.\n"
    assert done.stdout == ""


def test_the_extras_that_commands_name_are_those_of_the_package_and_their_modules_are_here() -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    assert EXTRAS.keys() <= declared.keys()
    assert all(find_spec(module) for modules in EXTRAS.values() for module in modules)
