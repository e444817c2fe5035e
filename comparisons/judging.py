"""What every solver's step is judged by: figures computed from the problem, and what the closed form says of it."""

import math

import numpy as np

from comparisons.sample import Sampled
from comparisons.tables import STEP_FIGURES, Record
from prioritized_ik.problem import Level
from prioritized_ik.solvers.step import JointStep, StepStatus
from prioritized_ik.tolerances import ACCEPTED_VIOLATION
from prioritized_ik.validation import Array


def judge(item: Sampled, step: JointStep) -> Record:
    """Return the figures of one step, every one computed from the problem and none taken from the solver.

    What is judged is the solver's own answer, before the polish; the certified step has columns of its own.
    """
    level = item.level
    own = step.raw if step.raw is not None else step.dtheta
    figures: Record = {
        **blank(item),
        "status": step.status.name,
        "message": step.message,
        "found": step.found,
        "build_s": step.timings.build,
        "solve_s": step.timings.solve,
        "polish_s": step.timings.polish,
        "certified": step.status in (StepStatus.CLOSED_FORM, StepStatus.SOLVED),
        "own_guess": not step.from_nothing,
        "certificate": None if step.certificate is None else step.certificate.worst,
        "repairs": step.repairs,
    }
    if step.dtheta is None or own is None:
        figures["violation"] = step.violation if step.violation > ACCEPTED_VIOLATION else None
        return figures
    figures["dtheta"] = own.tolist()
    figures["violation"] = item.problem.relative_violation(own)
    figures["cost"] = level.cost(own)
    if figures["certified"]:
        figures["certified_dtheta"] = step.dtheta.tolist()
        figures["certified_dx_error"] = _weighed(level, level.matrix @ (own - step.dtheta)) / (
            _weighed(level, level.target) or 1.0
        )
    if item.free:
        figures["dtheta_error"] = _relative(own, item.dtheta)
        figures["dx_error"] = _relative(level.matrix @ own, item.dx)
    return figures


def blank(item: Sampled) -> Record:
    """Return the record of a step of which nothing is known but the problem."""
    blank: Record = dict.fromkeys(STEP_FIGURES)
    at_zero = item.level.cost(np.zeros_like(item.dtheta))
    return {
        **blank,
        "step": item.step,
        "free": item.free,
        "certified": False,
        "own_guess": False,
        "repairs": 0,
        "cost_at_zero": at_zero,
    }


def _weighed(level: Level, displacement: Array) -> float:
    """Return ‖W^½ dX‖ of a `displacement` dX."""
    return math.sqrt(level.weights @ displacement**2)


def _relative(value: Array, reference: Array) -> float:
    size = float(np.linalg.norm(reference))
    off = float(np.linalg.norm(value - reference))
    return off / size if size else off
