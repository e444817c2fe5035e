"""Prioritized inverse kinematics on MuJoCo: exact, constrained, with whichever QP solver you like.

The public names stand in `__init__.pyi`, grouped by stage, and are imported when first used, so that the command line
starts without MuJoCo and the solvers.
"""

from typing import Any

import lazy_loader

_imported, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    """Return a public name, imported when it is first asked for; `__version__` is the installed package's."""
    if name != "__version__":
        return _imported(name)
    import importlib.metadata

    try:
        return importlib.metadata.version("prioritized-ik")
    except importlib.metadata.PackageNotFoundError:  # the sources on the path, not installed
        return "unknown"
