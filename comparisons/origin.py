"""Where figures come from: versions, processor, program."""

import functools
import hashlib
import importlib.metadata
import platform
import shutil
import subprocess
from pathlib import Path

import prioritized_ik

PACKAGES = ("prioritized-ik", "mujoco", "mink", "qpsolvers", "numpy", "scipy")

#: The modules of `comparisons` that make figures; the others show them, and may change without making them anew.
MEASURING = (
    "cases", "isolation", "jobs", "judging", "mink_today", "own_qps", "run", "sample", "settings", "tables", "worker",
)  # fmt: skip


def versions(of_solvers: dict[str, str]) -> dict[str, str]:
    """Return the versions of Python, the packages that decide on figures, and solvers."""
    packages = {package: importlib.metadata.version(package) for package in PACKAGES}
    return {"python": platform.python_version(), **packages, **of_solvers}


@functools.cache
def cpu_model() -> str:
    """Return the processor's name, as far as the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


@functools.cache
def revision() -> str:
    """Return the git revision of the program, `-dirty` if changed since; its version where it is installed without git."""
    root = Path(__file__).parents[1]
    git = shutil.which("git")
    if git is not None and (root / ".git").exists():
        command = [git, "-C", str(root), "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
        told = subprocess.run(command, capture_output=True, text=True, check=False)
        if told.returncode == 0:
            return told.stdout.strip()
    return importlib.metadata.version("prioritized-ik")


@functools.cache
def code() -> str:
    """Return the beginning of a SHA-256 of the program that makes figures: two runs with the same ran the same one."""
    here = Path(__file__).parent
    texts = [*sorted(Path(prioritized_ik.__file__).parent.rglob("*.py")), *(here / f"{name}.py" for name in MEASURING)]
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in texts)).hexdigest()[:12]
