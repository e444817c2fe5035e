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

import numpy as np
import qpsolvers

from prioritized_ik.solvers.stages import Stage
from prioritized_ik.validation import Array

SolveOnce = Callable[[qpsolvers.Problem], Array]

PROXIMAL_ROUNDS = 2  # of one solve; every zoom adds as many
RESTED = 1e-10  # ρ‖z - z_k‖ below this leaves no trace in the costed variables
SETTLED = 1e-9  # zooming stops once it moves the joint step by less than this fraction


def proximal_point(stage: Stage, solve_once: SolveOnce, shift: float, gave_up: type[Exception]) -> SolveOnce:
    """Return `solve_once` for problems with this stage's Hessian, made positive definite without changing the optimum.

    A round shrinks what the shift ρ leaves by ρ/(ρ + a²), a the slope of the rows that tie z to the cost: a smaller shift
    is better, as far as the solver's own numerics allow.

    A later round that raises `gave_up` ends the rounds; the answer so far stays, as it is the solver's own.
    """
    if stage.costed == stage.size:
        return solve_once
    unfelt = slice(stage.costed, stage.size)

    def shifted(problem: qpsolvers.Problem, z: Array) -> Array:
        hessian, linear = problem.P.copy(), problem.q.copy()
        hessian[range(stage.costed, stage.size), range(stage.costed, stage.size)] += shift
        linear[unfelt] -= shift * z
        return solve_once(qpsolvers.Problem(hessian, linear, problem.G, problem.h))

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


def zoom_in(stage: Stage, x: Array, zooms: tuple[float, ...], solve_once: SolveOnce, gave_up: type[Exception]) -> Array:
    """Return the stage's optimum `(v,)` refined from `x` by one solve a zoom ε.

    A refining solve that raises `gave_up` ends the refinement; the answer so far stays, as it is the solver's own.
    """
    problem = stage.problem
    for epsilon in zooms:
        slack = None if problem.h is None else (problem.h - problem.G @ x) / epsilon
        try:
            d = solve_once(qpsolvers.Problem(problem.P, (problem.P @ x + problem.q) / epsilon, problem.G, slack))
        except gave_up:
            return x
        x = x + epsilon * d
        if epsilon * np.linalg.norm(stage.basis @ d) <= SETTLED * np.linalg.norm(stage.dtheta(x)):
            return x
    return x
