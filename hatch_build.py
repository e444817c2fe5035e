"""Compiles the core of the solve when the package is installed, with whatever compiler there is, or else leaves it out.

Hatch calls it; `python hatch_build.py` does the same in place. The package runs without: then the Python form solves. $CXX
names another compiler, $CXXFLAGS further flags.
"""

import hashlib
import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any

try:
    from hatchling.builders.hooks.plugin.interface import BuildHookInterface
except ImportError:  # run by hand, where nothing is packed
    BuildHookInterface = object  # type: ignore[assignment,misc]

CORE = Path("src", "prioritized_ik", "solvers", "compiled")
FLAGS = ("-O3", "-std=c++17", "-shared", "-fPIC", "-fvisibility=hidden", "-Wno-psabi", "-s")

#: What is compiled, by the processor it runs on; `library.py` asks the first which of the others do.
BASELINE = "baseline"
VARIANTS: dict[str, tuple[str, ...]] = {BASELINE: ()}
if platform.machine() in ("x86_64", "AMD64"):
    VARIANTS |= {f"x86-64-v{level}": (f"-march=x86-64-v{level}",) for level in (3, 4)}


def digest(folder: Path) -> str:
    """Return the digest of the sources, which a library must carry to be loaded beside them."""
    whole = hashlib.sha256()
    for path in sorted([*folder.glob("*.hpp"), *folder.glob("*.cpp")]):
        whole.update(path.name.encode() + b"\0" + path.read_bytes())
    return whole.hexdigest()


def compiler() -> list[str] | None:
    """Return the command of the C++ compiler: $CXX, the system's, or that of the `ziglang` wheel; None if there is none."""
    if chosen := os.environ.get("CXX"):
        return shlex.split(chosen)
    for name in ("c++", "g++", "clang++"):
        if found := shutil.which(name):
            return [found]
    return [sys.executable, "-m", "ziglang", "c++"] if importlib.util.find_spec("ziglang") else None


def build(root: Path) -> list[Path]:
    """Compile every variant in place; return the libraries.

    Raises:
        RuntimeError: there is no compiler, or it failed.
    """
    folder, command = root / CORE, compiler()
    for old in folder.glob("core-*.so"):
        old.unlink()
    if command is None:
        raise RuntimeError("no C++ compiler: set CXX, or install g++, clang++ or the wheel ziglang")
    source = f'-DPRIORITIZED_IK_SOURCE="{digest(folder)}"'
    running: list[tuple[Path, subprocess.Popen[str]]] = []  # all at once
    try:
        for name, flags in VARIANTS.items():
            library = folder / f"core-{name}.so"
            every = [*FLAGS, *_translated(flags, command), *shlex.split(os.environ.get("CXXFLAGS", ""))]
            whole = [*command, *every, source, str(folder / "core.cpp"), "-o", str(library)]
            compiling = subprocess.Popen(whole, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
            running.append((library, compiling))
    except OSError as error:
        raise RuntimeError(f"{command[0]} does not run ({error})") from error
    messages = [compiling.communicate()[0] for _, compiling in running]
    for message, (_, compiling) in zip(messages, running, strict=True):
        if compiling.returncode:
            raise RuntimeError(f"{shlex.join(command)} failed: {message.strip()[:2000]}")
    return [library for library, _ in running]


def _translated(flags: tuple[str, ...], command: list[str]) -> list[str]:
    """Return flags in Zig's spelling, which has underscores in the names of processors, and no plain default."""
    if "ziglang" not in command:
        return list(flags)
    return [flag.replace("x86-64-v", "x86_64_v") for flag in flags] or ["-mcpu=baseline"]


class CustomBuildHook(BuildHookInterface):
    """Puts the compiled core into the wheel, which is one for this platform then."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, or say in one line that the package will do without."""
        try:
            libraries = build(Path(self.root))
        except RuntimeError as error:
            self.app.display_warning(f"prioritized-ik is installed without its compiled core: {error}")
            return
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{sysconfig.get_platform().replace('-', '_').replace('.', '_')}"
        build_data["artifacts"] += [f"/{CORE.as_posix()}/{library.name}" for library in libraries]


def main() -> int:
    """Compile in place."""
    try:
        print(*build(Path(__file__).parent), sep="\n")
    except RuntimeError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
