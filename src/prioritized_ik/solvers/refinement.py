"""Making one solver's answer to a stage exact, using nothing but that solver.

Two devices, both of which solve the stage's own QP:

*Proximal point.* A solver that needs a positive definite Hessian gets ½ρ‖z - z_k‖² added for the variables z without cost,
and is called again from its own answer, until z rests or the rounds are over. What the shift leaves in the answer shrinks
with every round.

*Zooming in*, the scaled iterative refinement of Weber, Sager and Gleixner (Math. Prog. Comp. 11, 2019), primal part. With
x = x_0 + ε d the same QP is posed for d, its cost divided by ε², so that a tolerance in d is ε times as large in x. It
matters because interior-point solvers stop at a distance from the rows that their tolerance sets, which shifts the weakest
directions of a free step by 1e-6 to 1e-1, and first-order ones stop at a residual.
"""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
import qpsolvers
import scipy.sparse

from prioritized_ik.tolerances import PROXIMAL_ROUNDS, RESTED, ZOOMED
from prioritized_ik.validation import Array


class Posed(Protocol):
    """What is refined: a QP in x `(v,)` whose first variables have a cost, and the way back to the joint step."""

    @property
    def problem(self) -> qpsolvers.Problem:
        """The QP."""
        ...

    @property
    def basis(self) -> Any:
        """How the step moves with x `(m, v)`, dense or sparse."""
        ...

    @property
    def costed(self) -> int:
        """How many of the variables, the first ones, the cost feels."""
        ...

    @property
    def size(self) -> int:
        """Number of variables v."""
        ...

    def dtheta(self, x: Array) -> Array:
        """Return the step at the variables `x`."""
        ...


SolveOnce = Callable[[qpsolvers.Problem], Array]


def proximal_point(stage: Posed, solve_once: SolveOnce, shift: float, gave_up: type[Exception]) -> SolveOnce:
    """Return `solve_once` for problems with this stage's Hessian, made positive definite without changing the optimum.

    A round shrinks what the shift ρ leaves by ρ/(ρ + a²), a the slope of the rows that tie z to the cost: a smaller shift
    is better, as far as the solver's own numerics allow.

    A later round that raises `gave_up` ends the rounds; the answer so far stays, as it is the solver's own.
    """
    if stage.costed == stage.size:
        return solve_once
    unfelt = slice(stage.costed, stage.size)
    shifts = np.repeat([0.0, shift], [stage.costed, stage.size - stage.costed])

    def shifted(problem: qpsolvers.Problem, z: Array) -> Array:
        sparse = scipy.sparse.issparse(problem.P)
        hessian, linear = problem.P + (scipy.sparse.diags(shifts) if sparse else np.diag(shifts)), problem.q.copy()
        linear[unfelt] -= shift * z
        return solve_once(_like(problem, hessian, linear, problem.h, problem.b, problem.lb, problem.ub))

    def solve(problem: qpsolvers.Problem) -> Array:
        z = np.zeros(stage.size - stage.costed)
        x = shifted(problem, z)
        for _ in range(PROXIMAL_ROUNDS - 1):
            if shift * np.abs(x[unfelt] - z).max() <= RESTED:
                break
            z = x[unfelt]
            try:
                x = shifted(problem, z)
            except gave_up:
                break
        return x

    return solve


def zoom_in(stage: Posed, x: Array, zooms: tuple[float, ...], solve_once: SolveOnce, gave_up: type[Exception]) -> Array:
    """Return the stage's optimum `(v,)` refined from `x` by one solve a zoom ε.

    A refining solve that raises `gave_up` ends the refinement; the answer so far stays, as it is the solver's own.
    """
    problem = stage.problem
    for epsilon in zooms:
        sides = (
            None if side is None else (side - (x if matrix is None else matrix @ x)) / epsilon
            for side, matrix in (
                (problem.h, problem.G), (problem.b, problem.A), (problem.lb, None), (problem.ub, None),
            )
        )  # fmt: skip
        try:
            d = solve_once(_like(problem, problem.P, (problem.P @ x + problem.q) / epsilon, *sides))
        except gave_up:
            return x
        x = x + epsilon * d
        if epsilon * np.linalg.norm(stage.basis @ d) <= ZOOMED * np.linalg.norm(stage.dtheta(x)):
            return x
    return x


def _like(
    problem: qpsolvers.Problem,
    hessian: Any,
    linear: Array,
    h: Array | None,
    b: Array | None,
    lb: Array | None,
    ub: Array | None,
) -> qpsolvers.Problem:
    """Return a QP of another cost and other sides."""
    return qpsolvers.Problem(hessian, linear, problem.G, h, problem.A, b, lb, ub)
