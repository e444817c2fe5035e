"""Prioritized inverse kinematics on MuJoCo: exact, constrained, with whichever QP solver you like.

The public names stand in `__init__.pyi`, grouped by stage, and are imported when first used, so that the command line
starts without MuJoCo and the solvers.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
