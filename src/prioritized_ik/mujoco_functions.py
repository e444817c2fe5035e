"""Functions of MuJoCo's own library, as addresses that the compiled core calls."""

import ctypes
from functools import cache
from pathlib import Path

import mujoco

#: What the core calls them, and what MuJoCo does.
NAMES = {
    "kinematics": "mj_kinematics",
    "com_pos": "mj_comPos",
    "geom_distance": "mj_geomDistance",
    "jac": "mj_jac",
    "jac_mass": "mj_jacSubtreeCom",
    "to_quaternion": "mju_mat2Quat",
    "to_vector": "mju_quat2Vel",
}


@cache
def mujoco_functions() -> dict[str, int | None] | None:
    """Return the address of each function of `NAMES`, None where MuJoCo's library is not found."""
    folder = Path(mujoco.__file__).parent
    for path in sorted([*folder.glob("libmujoco*.so*"), *folder.glob("libmujoco*.dylib")]):
        try:
            found = ctypes.CDLL(str(path))
            if found.mj_version() != mujoco.mj_version():
                continue
            functions = {name: getattr(found, function) for name, function in NAMES.items()}
        except (OSError, AttributeError):
            continue
        return {name: ctypes.cast(function, ctypes.c_void_p).value for name, function in functions.items()}
    return None
