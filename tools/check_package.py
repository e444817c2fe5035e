"""Build the source archive and of it the wheel, and check what they hold and say, and that the wheel starts on its own.

Nothing beside the sources is touched. The core is compiled without optimization, on which nothing here hangs. The wheel is
installed beside nothing but this environment's own packages, so that no network is needed.
"""

import os
import subprocess
import sys
import tarfile
import tempfile
import venv
import zipfile
from email.parser import HeaderParser
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = {"prioritized_ik": ROOT / "src", "comparisons": ROOT, "paper_repro": ROOT}
CORE = {"click", "daqp", "lazy-loader", "mujoco", "numpy", "qpsolvers", "rich", "scipy", "threadpoolctl"}
EXTRAS = {
    "all",
    "bench",
    "cluster",
    "compare",
    "dev",
    "docs",
    "mink",
    "render",
    "report",
    "solvers",
    "solvers-wide",
    "view",
}
IN_SOURCE = ("pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "src/prioritized_ik/py.typed")
UNWANTED = (".venv/", "results/", "__pycache__", ".pyc")


def main() -> None:
    """Check both archives."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        build = (sys.executable, "-m", "hatchling", "build", "-d", str(folder), "-t")
        _run(*build, "sdist", cwd=ROOT)
        (source,) = folder.glob("*.tar.gz")
        _check_source(source)
        with tarfile.open(source) as archive:
            archive.extractall(folder, filter="data")
        _run(*build, "wheel", cwd=folder / source.name.removesuffix(".tar.gz"))
        (wheel,) = folder.glob("*.whl")
        _check_wheel(wheel)
        _check_install(wheel, folder / "environment")
    print(f"{wheel.name}, {source.name}: contents, metadata, install and --help as they should be")


def _check_wheel(path: Path) -> None:
    with zipfile.ZipFile(path) as archive:
        names = set(archive.namelist())
        metadata = next(name for name in names if name.endswith(".dist-info/METADATA"))
        said = HeaderParser().parsestr(archive.read(metadata).decode())
    wanted = {str(path.relative_to(base)) for name, base in PACKAGES.items() for path in _files(base / name)}
    _expect("files of the packages that the wheel lacks", wanted - names, set())
    _expect("unwanted files in the wheel", {name for name in names if any(part in name for part in UNWANTED)}, set())
    tops = {name.partition("/")[0] for name in names if ".dist-info/" not in name}
    _expect("packages in the wheel", tops, set(PACKAGES))
    required = said.get_all("Requires-Dist", [])
    core = {_name(each) for each in required if "extra ==" not in each}
    _expect("what the wheel requires", core, CORE)
    _expect("extras that the wheel lacks", EXTRAS - set(said.get_all("Provides-Extra", [])), set())
    _expect("licence", said["License-Expression"], "Apache-2.0 AND MIT")


def _check_source(path: Path) -> None:
    with tarfile.open(path) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    _expect("files that the source archive lacks", set(IN_SOURCE) - names, set())
    _expect("unwanted files in the source archive", {n for n in names if any(part in n for part in UNWANTED)}, set())


def _check_install(wheel: Path, environment: Path) -> None:
    """Install the wheel in a fresh environment, with this one's packages to lean on, and start it away from the sources."""
    venv.create(environment, with_pip=False)
    python = str(environment / "bin" / "python")
    _run(sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps", "--no-index", str(wheel))
    (site,) = environment.glob("lib/*/site-packages")
    (here,) = {path for path in map(Path, sys.path) if (path / "numpy").is_dir()}
    # A plain folder on the path: its own .pth files, with this project's sources, are not read.
    (site / "lean.pth").write_text(f"{here}\n", encoding="utf-8")
    command = str(environment / "bin" / "prioritized-ik")
    _expect("--help", "wind" in _run(command, "--help", cwd=environment), True)
    place = _run(python, "-c", "import prioritized_ik; print(prioritized_ik.__file__)", cwd=environment)
    _expect("place of the package", Path(place.strip()).is_relative_to(environment), True)
    _run(python, "-c", "import prioritized_ik as pik; pik.solve, pik.Arm, pik.certify", cwd=environment)


def _files(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts]


def _name(requirement: str) -> str:
    return requirement.split(";")[0].split(">")[0].split("=")[0].strip()


def _run(*command: str, cwd: Path | None = None) -> str:
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"} | {"CXXFLAGS": "-O0"}
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)} ended with {done.returncode}:\n{done.stdout}{done.stderr}")
    return done.stdout


def _expect(what: str, found: object, wanted: object) -> None:
    if found != wanted:
        raise SystemExit(f"{what}: {found}; expected {wanted}")


if __name__ == "__main__":
    main()
