"""What every solver's step is judged by: recorded problems, what the closed form says of them, figures of a step."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from prioritized_ik.problem import IKProblem, Level
from prioritized_ik.solvers.closed_form import level_decomposition, resulting_displacement
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.solvers.lexicographic import ACCEPTED_VIOLATION, FREE
from prioritized_ik.solvers.step import JointStep, StepStatus
from prioritized_ik.validation import Array
from prioritized_ik.winding.episode import Episode


@dataclass(frozen=True)
class Sampled:
    """A recorded problem and what the closed form says of it."""

    step: int
    problem: IKProblem
    level: Level  # the problem's, its matrix cut to the rank that all solvers share
    q: Array
    dtheta: Array  # Eqs. (12) to (14)
    dx: Array  # Eq. (15)
    free: bool


def sample(episode: Episode, steps: int, rank_tolerance: float) -> list[Sampled]:
    """Return up to `steps` problems of an episode, evenly spaced, half of them free as far as there are so many.

    Args:
        episode: with one level a problem.
        steps: how many.
        rank_tolerance: shared by the closed form and every solver.
    """
    everything = [_sampled(episode, step, rank_tolerance) for step in range(episode.steps)]
    free = [item for item in everything if item.free]
    bound = [item for item in everything if not item.free]
    frees = _spread(free, max(steps // 2, steps - len(bound)))
    return sorted([*frees, *_spread(bound, steps - len(frees))], key=lambda item: item.step)


def _sampled(episode: Episode, step: int, rank_tolerance: float) -> Sampled:
    problem = episode.problem(step)
    level = problem.levels[0]
    hierarchy = Hierarchy(problem, rank_tolerance)
    dtheta = hierarchy.closed_form
    factors, _ = level_decomposition(level, np.eye(problem.joint_count), rank_tolerance)
    return Sampled(
        step,
        problem,
        hierarchy.cut_problem.levels[0],
        episode.q[step],
        dtheta,
        resulting_displacement(factors.j_a, level.weights, level.target),
        problem.relative_violation(dtheta) <= FREE,
    )


def _spread(items: list[Sampled], count: int) -> list[Sampled]:
    """Return `count` of `items`, evenly spaced."""
    if count >= len(items):
        return items
    return [items[i] for i in np.linspace(0, len(items) - 1, count).round().astype(int)]


def judge(item: Sampled, step: JointStep) -> dict[str, Any]:
    """Return the figures of one step, every one computed from the problem and none taken from the solver.

    What is judged is the solver's own answer, before the polish; the certified step has columns of its own.
    """
    level = item.level
    own = step.raw if step.raw is not None else step.dtheta
    certificate = step.certificate
    record: dict[str, Any] = {
        "free": item.free,
        "status": step.status.name,
        "message": step.message,
        "found": step.found,
        "solve_s": step.timings.build + step.timings.solve,
        "polish_s": step.timings.polish,
        "violation": None,
        "cost": None,
        "cost_at_zero": level.cost(np.zeros_like(item.dtheta)),
        "dtheta": None,
        "dtheta_error": None,
        "dx_error": None,
        "certified": step.status in (StepStatus.CLOSED_FORM, StepStatus.SOLVED),
        "certificate": None if certificate is None else certificate.worst,
        "certified_dtheta": None,
        "repairs": step.repairs,
    }
    if step.dtheta is None or own is None:
        record["violation"] = step.violation if step.violation > ACCEPTED_VIOLATION else None
        return record
    record["dtheta"] = own.tolist()
    record["violation"] = item.problem.relative_violation(own)
    record["cost"] = level.cost(own)
    if record["certified"]:
        record["certified_dtheta"] = step.dtheta.tolist()
    if item.free:
        record["dtheta_error"] = _relative(own, item.dtheta)
        record["dx_error"] = _relative(level.matrix @ own, item.dx)
    return record


def _relative(value: Array, reference: Array) -> float:
    return float(np.linalg.norm(value - reference) / np.linalg.norm(reference))
