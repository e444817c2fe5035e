"""The README and the pages in docs run: their Python and their commands, as they stand."""

import re
import shlex
from pathlib import Path

import pytest
from click.testing import CliRunner
from repository import ROOT

from prioritized_ik.cli import main

PAGES = {page: page.read_text(encoding="utf-8") for page in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))}
TEXT = "\n".join(PAGES.values())
PYTHON = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
CONSOLE = [
    line.split("#")[0].strip()
    for block in re.findall(r"```console\n(.*?)```", TEXT, re.DOTALL)
    for line in block.splitlines()
]
COMMANDS = list(dict.fromkeys(line for line in CONSOLE if line.startswith("prioritized-ik")))


@pytest.mark.parametrize("code", PYTHON)
def test_the_python_of_the_readme_runs_and_prints_what_it_says(
    code: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "README.md", "exec"), {})
    printed, told = capsys.readouterr().out.splitlines(), re.findall(r"# prints: (.*)", code)
    assert printed[len(printed) - len(told) :] == told


@pytest.mark.parametrize("command", COMMANDS)
def test_the_commands_of_the_readme_run(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    result = CliRunner().invoke(main, shlex.split(command)[1:])
    assert result.exit_code == 0, result.output


def test_the_readme_has_code_and_commands_and_its_make_targets_exist() -> None:
    assert PYTHON
    assert len(COMMANDS) >= 3
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    assert {line.split()[1] for line in CONSOLE if line.startswith("make ")} <= targets


def test_every_link_inside_the_project_leads_somewhere() -> None:
    for page, text in PAGES.items():
        for target in re.findall(r"\]\(([^):#]+)\)", text):
            assert (page.parent / target).exists(), f"{target} in {page.name}"
