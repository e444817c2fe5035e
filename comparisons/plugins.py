"""Methods of the user's own: modules that call `prioritized_ik.register` when imported.

What they register is sent along to the processes, here and on a cluster, that solve with it; the module must be found there
too, and so is imported as `python -m` would: from the current folder as well.
"""

import importlib
import os
import sys
from collections.abc import Iterable

from prioritized_ik.errors import InputError


def load_plugins(modules: Iterable[str]) -> None:
    """Import modules that register methods.

    Raises:
        InputError: there is no such module, or it lacks something.
    """
    for module in modules:
        if os.getcwd() not in sys.path:
            sys.path.insert(0, os.getcwd())
        try:
            importlib.import_module(module)
        except ImportError as error:
            raise InputError(
                f"cannot import plugin {module!r} ({error}); expected the name of a module here or on PYTHONPATH."
            ) from error
