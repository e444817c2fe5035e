"""Compiled models of long chains, kept between processes: MuJoCo takes as long to compile one as the cube of its links.

400 links take 2.5 s, 800 take 19 s; reading them takes 0.05 s and 0.3 s. The files lie in the user's cache folder, the last
read are kept, `MOST` in all, and nothing depends on them: where one cannot be written, is damaged or of another MuJoCo, the
model is compiled. The environment variable `PRIORITIZED_IK_CACHE` names another folder; empty, it turns this off.
"""

import hashlib
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import mujoco
import numpy as np

from prioritized_ik.files import write_whole

VARIABLE = "PRIORITIZED_IK_CACHE"
MOST = 512 * 2**20  # [bytes] on disk
SUFFIX = ".mjb"

_DIGEST = hashlib.sha256().digest_size


def cached_model(description: str, compiled: Callable[[], mujoco.MjModel]) -> mujoco.MjModel:
    """Return the model that `compiled` makes, or what it made before, from a file.

    Args:
        description: everything that decides what it makes, but for MuJoCo's version.
        compiled: makes it.
    """
    folder = cache_folder()
    if folder is None:
        return compiled()
    name = hashlib.sha256(f"{mujoco.__version__}\n{description}".encode()).hexdigest()
    path = folder / f"{name}{SUFFIX}"
    kept = _read(path)
    if kept is not None:
        return kept
    model = compiled()
    with suppress(OSError):  # a cache that cannot be written is none
        _write(path, model)
        _drop_oldest(folder)
    return model


def cache_folder() -> Path | None:
    """Return the folder of the models, which need not be there; None where there is to be none."""
    given = os.environ.get(VARIABLE)
    if given is not None:
        return Path(given) if given else None
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA")
    elif sys.platform == "darwin":
        base = os.path.expanduser("~/Library/Caches")
    else:
        base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(base) / "prioritized-ik" / "models" if base and os.path.isabs(base) else None


def _read(path: Path) -> mujoco.MjModel | None:
    """Return the model of a file; None where there is none, or it is not as it was written."""
    try:
        content = path.read_bytes()
        if hashlib.sha256(content[_DIGEST:]).digest() != content[:_DIGEST]:
            return None
        model = mujoco.MjModel.from_binary_path(path.name, {path.name: content[_DIGEST:]})
        os.utime(path)
    except (OSError, ValueError):
        return None
    return model


def _write(path: Path, model: mujoco.MjModel) -> None:
    content = np.empty(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, content)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, lambda file: file.write(hashlib.sha256(content.data).digest() + content.tobytes()))


def _drop_oldest(folder: Path) -> None:
    """Drop the files that were not read for longest, beyond `MOST`."""
    found = sorted(((path.stat(), path) for path in folder.glob(f"*{SUFFIX}")), key=lambda one: -one[0].st_mtime)
    total = 0
    for stat, path in found:
        total += stat.st_size
        if total > MOST:
            path.unlink(missing_ok=True)
