"""Every example runs as it stands, says something, and draws the picture that the gallery shows."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from repository import ROOT

EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
GALLERY = ROOT / "docs" / "gallery"
FEW_FRAMES = {"long_arm": 4}  # of films that take longer to draw than all else
SHORTENED = (
    "import runpy, sys; from prioritized_ik.winding import picture; picture.FRAMES = {}; runpy.run_path(sys.argv[1])"
)


@pytest.mark.parametrize("script", EXAMPLES, ids=lambda script: script.stem)
def test_an_example_runs_and_draws_its_picture(renders: None, script: Path, tmp_path: Path) -> None:
    environment = os.environ | {"MPLBACKEND": "agg"}
    frames = FEW_FRAMES.get(script.stem)
    command = [sys.executable, "-W", "error", *(["-c", SHORTENED.format(frames)] if frames else []), str(script)]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    assert done.stdout
    (made,) = tmp_path.iterdir()
    with Image.open(made) as new, Image.open(GALLERY / made.name) as shown:
        assert new.size == shown.size
        assert getattr(new, "n_frames", 1) == (frames or getattr(shown, "n_frames", 1))
        assert np.asarray(new.convert("L")).std() > 5.0  # not one colour all over


def test_the_gallery_shows_every_example_and_nothing_else() -> None:
    page = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    names = {script.stem for script in EXAMPLES}
    assert {picture.stem for picture in GALLERY.iterdir()} == names
    assert all(f"../examples/{name}.py" in page and f"gallery/{name}." in page for name in names)
