"""Rendering: a backend that works is found in a process of its own; where none works that is one message, never a crash."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from prioritized_ik import rendering

UNSET = ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL", "PYOPENGL_PLATFORM")
NOTHING = {"__EGL_VENDOR_LIBRARY_FILENAMES": "/nothing", "LD_LIBRARY_PATH": "/nothing"}  # EGL finds no driver
DRAW = "from prioritized_ik.cli import main; main()"


def draw(file: Path, **settings: str) -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if key not in UNSET} | settings
    command = [sys.executable, "-c", DRAW, "wind", "--link", "16", "--steps", "3", "--record", str(file)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def test_without_display_or_settings_a_picture_is_drawn(renders: None, tmp_path: Path) -> None:
    done = draw(tmp_path / "end.png")
    assert (done.returncode, done.stderr) == (1, "")  # not wound within three steps
    assert (tmp_path / "end.png").stat().st_size > 1000


@pytest.mark.parametrize("named", [{}, {"MUJOCO_GL": "egl"}, {"MUJOCO_GL": "glfw"}])
def test_where_nothing_renders_it_is_one_line_before_anything_is_wound(named: dict[str, str], tmp_path: Path) -> None:
    done = draw(tmp_path / "end.png", **NOTHING, **named)
    if not named and done.returncode == 1:
        pytest.skip("OSMesa is installed here, which renders without EGL")
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith("Error: cannot render here (")
    assert "libegl1" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert done.stdout == ""


@pytest.mark.parametrize(
    ("script", "why"),
    [
        ("import os; os.abort()", "ended by signal 6"),
        ("raise RuntimeError('no driver')", "RuntimeError: no driver"),
        ("raise SystemExit(3)", "exit code 3"),
        ("import time; time.sleep(9)", "no picture within 1 s"),
    ],
)
def test_a_probe_that_aborts_fails_or_hangs_is_a_reason(script: str, why: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rendering, "PROBE", script)
    monkeypatch.setattr(rendering, "PROBING", 1.0 if "sleep" in script else 60.0)
    assert rendering._probe("egl") == why


def test_the_first_that_works_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rendering, "_probe", lambda name: None if name == "osmesa" else "broken")
    assert rendering._found.__wrapped__("") == ("osmesa", ())
    assert rendering._found.__wrapped__("egl") == (None, ("egl: broken",))  # what the user named is not replaced
