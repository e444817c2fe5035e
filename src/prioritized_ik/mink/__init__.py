"""A drop-in for `mink.solve_ik` with strict priorities: mink's tasks, limits and constraints, solved by this library.

    from prioritized_ik.mink import solve_ik  # instead of: from mink import solve_ik

The arguments mean what they mean in mink; with one level of tasks the answer is the optimum of mink's own QP, whichever
solver is named. Beyond mink, `tasks` can be nested lists, the most important level first, or `priority={task: n}` numbers
the levels. `build_problem` returns the `IKProblem` to look at; `step_ik` moves the configuration and returns the step.

mink is an optional package (`pip install 'prioritized-ik[mink]'`) and is imported only with this module.
"""

from prioritized_ik.mink.errors import InfeasibleIkError, NoStepFoundError, OutsideLimitsError
from prioritized_ik.mink.solve import build_problem, solve_ik, step_ik

__all__ = ["build_problem", "solve_ik", "step_ik", "InfeasibleIkError", "NoStepFoundError", "OutsideLimitsError"]
