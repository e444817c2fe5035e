"""The solve near singular poses of the 17-link arm, and ways of solving that fail there: measured as jobs."""

import math
from typing import Any

import daqp
import mujoco
import numpy as np

from paper_repro.make.jobs import Job
from paper_repro.measure.windings import settings
from prioritized_ik.models import Arm, update_kinematics
from prioritized_ik.problem import IKProblem, Level
from prioritized_ik.solvers.closed_form import (
    RANK_TOLERANCE,
    minimum_norm_solution,
    rank_decomposition_svd,
    weighted_optimum,
)
from prioritized_ik.solvers.hierarchy import strict_solution
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.validation import Array
from prioritized_ik.virtual_arms import VirtualArms
from prioritized_ik.winding.controller import WindingController

SEED = 0  # of the pose that is brought near a singular one
BENT = 0.5  # [rad] its joints are drawn between minus and plus this
REQUEST = 1e-3  # [m] length of the stacked displacement asked for
DISTANCES = (0.1, 0.01, 0.001)  # [rad] from the singular pose
TOLERANCES = (1e-15, 1e-4, 1e-3)  # of the rank; the first is rounding: nothing is truncated
RANK = 34  # of J where no pose is singular

KINDS = ("base ball", "inner ball", "collinear tip", "straight arm")
INNER = 16  # link whose ball is meant by "inner ball"; that of link 1 is the "base ball"


def approach_job(kind: str) -> Job:
    """Return the job `approach`."""
    return Job(approach, {"kind": kind})


def approach(kind: str) -> dict[str, Any]:
    """Return what a request along the direction that is being lost costs, at each of `DISTANCES` from a singular pose.

    `share`: σ₃₄/σ₁ of J; `norms` `(distances, tolerances)`: ‖dθ‖ [rad] by Eqs. (12) and (14); `rank` at the pose itself,
    by the default tolerance, and `forced`, ‖dθ‖ there if the rank is taken to be 34.
    """
    shares, norms = [], []
    for distance in DISTANCES:
        jacobian = _jacobian(_pose(kind, distance))
        u, s, _ = np.linalg.svd(jacobian)
        request = REQUEST * u[:, RANK - 1]
        shares.append(float(s[RANK - 1] / s[0]))
        norms.append([float(np.linalg.norm(_step(jacobian, request, tolerance))) for tolerance in TOLERANCES])
    jacobian = _jacobian(_pose(kind, 0.0))
    s = np.linalg.svd(jacobian, compute_uv=False)
    return {
        "share": shares,
        "norms": norms,
        "rank": rank_decomposition_svd(jacobian).rank,
        "forced": float(REQUEST / s[RANK - 1]),
    }


def plain_solve_job() -> Job:
    """Return the job `plain_solve`."""
    return Job(plain_solve)


def plain_solve() -> dict[str, Any]:
    """Return ‖dθ‖ [rad] of Eq. (17) by a plain solve, and of Eqs. (12) and (14), at initial poses of windings.

    `plain`, `ours`; `same_cost`, whether both reach the same cost of Eq. (10); and `straight`, what the plain solve says
    at the straight pose.
    """
    plain, ours, costs = [], [], []
    for pose in ({"posture": "arched"}, {"posture": "random", "seed": 0}, {"posture": "random", "seed": 1}):
        (level,) = _problem(**pose).levels
        x, truth = _normal_equations(level), strict_solution((level,), np.zeros(level.matrix.shape[1]))
        plain.append(float(np.linalg.norm(x)))
        ours.append(float(np.linalg.norm(truth)))
        costs.append(math.isclose(level.cost(x), level.cost(truth), rel_tol=1e-6))
    try:
        straight = f"‖dθ‖ = {np.linalg.norm(_normal_equations(_problem().levels[0])):.0e} rad"
    except np.linalg.LinAlgError as error:
        straight = str(error)
    return {"plain": plain, "ours": ours, "same_cost": all(costs), "straight": straight}


def row_norms_job(weights: str) -> Job:
    """Return the job `row_norms`."""
    return Job(row_norms, {"weights": weights})


def row_norms(weights: str) -> dict[str, float]:
    """Return what DAQP's own solver of hierarchies makes of levels handed over as they are, without limits.

    DAQP measures a row's violation over the row's length. `raw`: relative error of dθ if the rows are W^½ J;
    `normalised`: relative distance of that answer from the least squares with rows of unit length, of a single level;
    `cost`: its cost at the first level where it misses the optimum, relative; `adapter`: relative error of
    `daqp-hierarchy`, not polished.
    """
    problem = IKProblem(_problem(posture="random", weights=weights).levels)
    truth = strict_solution(problem.levels, problem.reference)
    options = SolveOptions(rank_tolerance=RANK_TOLERANCE, closed_form_first=False, polish=False)
    ours = get_method("daqp-hierarchy").step(problem, options).dtheta
    raw = _daqp_as_is(problem)
    found = {"raw": _error(raw, truth), "adapter": math.nan if ours is None else _error(ours, truth)}
    if len(problem.levels) == 1:
        (level,) = problem.levels
        sizes = np.linalg.norm(level.matrix, axis=1)
        scaled = Level(level.matrix, level.target, 1.0 / sizes**2)
        found["normalised"] = _error(raw, strict_solution((scaled,), problem.reference))
        found["cost"] = level.cost(raw) / level.cost(truth)
    return found


def _error(found: Array, truth: Array) -> float:
    return float(np.linalg.norm(found - truth) / np.linalg.norm(truth))


def _daqp_as_is(problem: IKProblem) -> Array:
    """Return DAQP's answer to the levels' weighted rows, and dθ = 0 as the last level."""
    roots = [np.sqrt(level.weights) for level in problem.levels]
    m = problem.joint_count
    rows = np.vstack(
        [*(root[:, None] * level.matrix for root, level in zip(roots, problem.levels, strict=True)), np.eye(m)]
    )
    sides = np.concatenate([*(root * level.target for root, level in zip(roots, problem.levels, strict=True)), np.zeros(m)])
    ends = np.cumsum([0, *map(len, roots), m]).astype(np.intc)  # no hard rows, then the levels
    kinds = np.zeros(len(sides), dtype=np.intc)
    x, _, _, _ = daqp.solve(np.eye(m), np.zeros(m), rows, sides, sides.copy(), kinds, ends, primal_tol=1e-9, rho_soft=1e-8)
    return np.array(x)


def _problem(**changes: Any) -> IKProblem:
    """Return the first problem of a winding without limits."""
    chosen = settings("closed form", **changes)
    controller, q = WindingController(chosen), chosen.initial_posture()
    return controller.problem(q, controller.observe(q, np.zeros(chosen.arm.links, dtype=bool)))


def _normal_equations(level: Level) -> Array:
    """Eq. (17) as it is printed, whatever the rank."""
    weighted = level.matrix.T * level.weights
    return np.asarray(np.linalg.solve(weighted @ level.matrix, weighted @ level.target), dtype=float)


def _step(jacobian: Array, request: Array, rank_tolerance: float) -> Array:
    parts = rank_decomposition_svd(jacobian, rank_tolerance)
    return minimum_norm_solution(parts.j_b, weighted_optimum(parts.j_a, np.ones(len(request)), request))


def _pose(kind: str, distance: float) -> Array:
    """Return joint positions `(m,)` [rad] at a distance [rad] from a singular pose."""
    arm = Arm()
    q = np.random.default_rng(SEED).uniform(-BENT, BENT, arm.joint_count)
    names = [f"{link}{axis}" for link in arm.link_numbers for axis in arm.hinge_axes(link)]
    match kind:
        case "base ball":
            q[names.index("1y")] = 0.5 * math.pi - distance
        case "inner ball":
            q[names.index(f"{INNER}y")] = 0.5 * math.pi - distance
        case "collinear tip":
            q[-1] = distance
        case _:
            q *= distance / np.abs(q).max()
    return q


def _jacobian(q: Array) -> Array:
    arm = Arm()
    model = arm.spec().compile()
    data = mujoco.MjData(model)
    update_kinematics(model, data, q)
    return VirtualArms(model, arm.end_sites).jacobian(data)
