"""The compiled core as a library: where it is, whether it may be used, and if not, why."""

import ctypes
import hashlib
import os
import warnings
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from pathlib import Path

import numpy as np

from prioritized_ik import tolerances

FOLDER = Path(__file__).parent

#: Set to 1, only the Python form runs.
SWITCH = "PRIORITIZED_IK_PURE_PYTHON"

BASELINE = "core-baseline.so"

#: The others, the fastest first, by the level of x86-64 that they need.
FASTER = {4: "core-x86-64-v4.so", 3: "core-x86-64-v3.so"}


class Ending(IntEnum):
    """How a call of the core ended; those from `ROUNDING_ROW` on decline."""

    CLOSED_FORM = 0
    SOLVED = 1
    BINDING = 2
    OPEN = 3
    ROUNDING_ROW = 4
    RANK = 5
    EQUALITIES = 6
    NEARLY_DECIDED = 7
    NEARLY_TIGHT = 8
    UNSETTLED = 9
    UNPROVEN = 10


class Question(IntEnum):
    """What is asked of the core."""

    STEP = 0
    CLOSED_FORM_ONLY = 1
    FROM_GUESS_ONLY = 2
    CLOSED_FORM_FIRST = 3  # and then from the guess


@dataclass(frozen=True)
class Library:
    """The library if it may be used, and what there is to say about it.

    Attributes:
        core: its functions, or None.
        note: which it is, or why there is none.
    """

    core: ctypes.CDLL | None
    note: str

    @property
    def path(self) -> str:
        """Which form solves: "compiled" or "python"."""
        return "python" if self.core is None else "compiled"


def digest(folder: Path = FOLDER) -> str:
    """Return the digest of the sources, which a library must carry; the same as in `hatch_build.py`."""
    whole = hashlib.sha256()
    for path in sorted([*folder.glob("*.hpp"), *folder.glob("*.cpp")]):
        whole.update(path.name.encode() + b"\0" + path.read_bytes())
    return whole.hexdigest()


@cache
def library() -> Library:
    """Return the compiled core of this process, loaded when first asked for."""
    if os.environ.get(SWITCH, "0") not in ("", "0"):
        return Library(None, f"switched off by {SWITCH}")
    found = load(FOLDER)
    if found.core is None and (FOLDER / BASELINE).exists():
        warnings.warn(f"the compiled core is not used: {found.note}", RuntimeWarning, stacklevel=2)
    return found


def load(folder: Path) -> Library:
    """Return the library in `folder`: the fastest that this processor runs, if it was compiled from the sources there."""
    if not (folder / BASELINE).exists():
        return Library(None, "not compiled: there was no C++ compiler when the package was installed")
    expected = digest(folder)
    core, note = _loaded(folder / BASELINE, expected)
    if core is not None:
        level = core.core_x86_level()
        for needed, name in FASTER.items():
            if level >= needed and (folder / name).exists():
                faster, faster_note = _loaded(folder / name, expected)
                if faster is not None:
                    return Library(faster, faster_note)
    return Library(core, note)


def _loaded(path: Path, expected: str) -> tuple[ctypes.CDLL | None, str]:
    try:
        core = ctypes.CDLL(str(path))
        core.core_source.restype = ctypes.c_char_p
        source = core.core_source().decode()
    except (OSError, AttributeError) as error:
        return None, f"{path.name} cannot be loaded ({error}); install the package again"
    if source != expected:
        return None, f"{path.name} was compiled from other sources; install the package again, or run python hatch_build.py"
    core.core_tolerances.restype = ctypes.c_char_p
    core.core_new.restype = ctypes.c_void_p
    core.core_new.argtypes = [ctypes.c_int] * 5 + [ctypes.c_void_p]
    core.core_delete.argtypes = [ctypes.c_void_p]
    core.core_delete.restype = None
    core.core_stride.argtypes = [ctypes.c_void_p]
    core.core_arrays.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
    core.core_arrays.restype = None
    core.core_size.argtypes, core.core_size.restype = [ctypes.c_void_p] + [ctypes.c_int] * 4, None
    core.core_is_sound.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double]
    core.core_solve.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p]
    core.core_scene_observe.argtypes, core.core_scene_pose.argtypes = [ctypes.c_void_p], [ctypes.c_void_p] * 2
    core.core_pose.argtypes, core.core_pose.restype = [ctypes.c_void_p], None
    core.core_tree_new.restype = ctypes.c_void_p
    core.core_tree_new.argtypes = [ctypes.c_void_p]
    core.core_tree_step.argtypes = [ctypes.c_void_p, ctypes.c_char_p]
    core.core_tree_delete.argtypes = [ctypes.c_void_p]
    core.core_tree_delete.restype = None
    core.core_tree_pose.argtypes = [ctypes.c_void_p] * 2
    core.core_tree_motions.argtypes = [ctypes.c_void_p] * 4
    core.core_tree_damped.argtypes = [ctypes.c_void_p] * 4
    core.core_tree_factor.argtypes = [ctypes.c_void_p]
    core.core_tree_solve.argtypes = [ctypes.c_void_p] * 5
    core.core_tree_ask.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p]
    core.core_tree_balance.argtypes = [ctypes.c_void_p] + [ctypes.c_int] * 2 + [ctypes.c_double] + [ctypes.c_void_p] * 7
    core.core_tree_count_below.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_double]
    core.core_tree_memory.argtypes = [ctypes.c_void_p]
    core.core_tree_memory.restype = ctypes.c_double
    return core, path.name


def tolerances_of(core: ctypes.CDLL) -> np.ndarray:
    """Return the tolerances that the core asks for by name, those of `tolerances.py`."""
    return np.array([float(getattr(tolerances, name)) for name in core.core_tolerances().decode().split()])
