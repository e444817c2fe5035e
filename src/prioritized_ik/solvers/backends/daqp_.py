"""DAQP through `daqp.Model`, a dual active-set method: its warm start is the rows with a multiplier.

DAQP calls P H, q f, G A and h bupper, reads the arrays where they stand and refuses read-only ones, so the workspace has
its own. A multiplier counts for its sign only. A list of active rows that is empty, for want of rows, is an IndexError.
"""

import daqp
import numpy as np
import qpsolvers

from prioritized_ik.solvers.backends.abilities import Options
from prioritized_ik.solvers.backends.native import Answer, Workspace
from prioritized_ik.solvers.backends.protocol import SolverFailedError
from prioritized_ik.validation import Array

SOLVED = 1  # exit flag


class DaqpWorkspace(Workspace):
    """One `daqp.Model`."""

    def __init__(self, problem: qpsolvers.Problem, options: Options, costed: int, shift: float) -> None:
        size = len(problem.q)
        hessian = np.array(problem.P)
        hessian[range(costed, size), range(costed, size)] += shift
        self._linear = np.array(problem.q)
        self._rows = np.zeros((0, size)) if problem.G is None else np.array(problem.G, order="C")
        self._upper = np.zeros(0) if problem.h is None else np.array(problem.h)
        self._sent = problem.G
        self._model = daqp.Model()
        self._model.settings = dict(options)
        flag, _ = self._model.setup(hessian, self._linear, self._rows, self._upper)
        if flag < 0:
            raise SolverFailedError(f"could not be set up (exit flag {flag})")

    def solve(self, problem: qpsolvers.Problem, multipliers: Array | None) -> Answer:
        """See `Workspace.solve`."""
        changed = {"f": self._linear}
        self._linear[:] = problem.q
        if problem.h is not None:
            self._upper[:] = problem.h
            changed["bupper"] = self._upper
            if multipliers is not None:
                changed["sense"] = (multipliers > 0.0).astype(np.intc)
        if problem.G is not self._sent:
            self._rows[:] = problem.G
            self._sent = problem.G
            changed["A"] = self._rows
        flag = self._model.update(**changed)
        if flag >= 0:
            x, _, flag, info = self._model.solve()
        if flag != SOLVED:
            raise SolverFailedError(f"found no solution (exit flag {flag})")
        return Answer(x, info["lam"], info["iterations"])
