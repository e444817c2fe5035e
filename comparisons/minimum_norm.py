"""One task on a redundant arm: which of its many solutions each solver returns, by `mink.solve_ik` and by this library.

mink regularises by a damping of 1e-12, far below the tolerance of most solvers, so that they settle anywhere among the
solutions: interior-point solvers near the middle of the joint range, others where they happen to stop. Here the least norm
is a level of its own, so that every solver has to minimise it.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import mink
import numpy as np
import qpsolvers

from prioritized_ik.errors import StepNotFoundError
from prioritized_ik.models import Arm
from prioritized_ik.problem import IKProblem, Level, Rows
from prioritized_ik.solvers.backends.qpsolvers_ import SOLVER_ERRORS
from prioritized_ik.solvers.backends.registry import get_backend, installed_solvers
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.solve import solve
from prioritized_ik.validation import Array

POSTURE = "arched"
DISPLACEMENT = (0.0, 0.005, 0.005)  # [m] of the arm's end, at an angle to its plane, so that no symmetry helps
#: No row binds, so that the closed form would need no solver.
QP_USED = SolveOptions(rank_tolerance=RANK_TOLERANCE, closed_form_first=False)
TASKS = ("position", "pose")  # the end's position, or its orientation too, which is to stay
DT = 1.0  # [s] so that mink's velocity is the step


@dataclass(frozen=True)
class Answer:
    """What one solve returned.

    Attributes:
        norm_ratio: ‖dθ‖ over the least norm of all steps that do the task; None if the solve failed.
        off: ‖dθ - J⁺e‖ / ‖J⁺e‖, the distance from the step of least norm.
        residual: ‖J dθ - e‖ / ‖e‖, what is left of the task.
        failure: why there is no step; empty otherwise.
    """

    norm_ratio: float | None = None
    off: float | None = None
    residual: float | None = None
    failure: str = ""


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        task: one of `TASKS`.
        joint_range: whether the joint range is kept, mink's default; it binds nowhere.
        solver, version: the backend.
        mink: by `mink.solve_ik` with its default damping and the solver's default options.
        ours: by `prioritized_ik.solve`, with the same task, rows and solver, through the QP.
    """

    task: str
    joint_range: bool
    solver: str
    version: str
    mink: Answer
    ours: Answer


class Bench:
    """One task at the end of the paper's arm, in mink's terms and in this library's."""

    def __init__(self, task: str, *, joint_range: bool) -> None:
        arm = Arm()
        model = arm.spec().compile()
        self._limits = [mink.ConfigurationLimit(model)] if joint_range else []
        self._configuration = mink.Configuration(model)
        self._configuration.update(arm.posture(POSTURE))
        end = arm.end_sites[-1]
        self._task = mink.FrameTask(end, "site", position_cost=1.0, orientation_cost=float(task == "pose"))
        here = self._configuration.get_transform_frame_to_world(end, "site")
        there = mink.SE3.from_rotation_and_translation(here.rotation(), here.translation() + np.array(DISPLACEMENT))
        self._task.set_target(there)
        rows = 6 if task == "pose" else 3
        self.jacobian: Array = self._task.compute_jacobian(self._configuration)[:rows]
        self.demand: Array = -self._task.compute_error(self._configuration)[:rows]
        self.least = np.linalg.pinv(self.jacobian) @ self.demand
        qp = mink.build_ik(self._configuration, [self._task], DT, limits=self._limits)
        rows_kept = Rows(qp.G, qp.h) if joint_range else None
        self.problem = IKProblem([Level(self.jacobian, self.demand, name=task)], rows=rows_kept)

    def by_mink(self, solver: str) -> Answer:
        """Return what mink makes of it."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # about dense matrices and inaccuracy; the figures tell
                velocity = mink.solve_ik(self._configuration, [self._task], DT, solver, limits=self._limits)
        except (mink.MinkError, *SOLVER_ERRORS) as error:
            return Answer(failure=f"{type(error).__name__}: {error}")
        return self._judge(np.asarray(velocity) * DT)

    def by_us(self, solver: str) -> Answer:
        """Return what this library makes of it."""
        try:
            step = solve(self.problem, solver, QP_USED)
        except StepNotFoundError as error:
            return Answer(failure=str(error))
        return self._judge(step.dtheta)

    def _judge(self, dtheta: Array | None) -> Answer:
        if dtheta is None or not np.isfinite(dtheta).all():
            return Answer(failure="values that are not finite")
        return Answer(
            float(np.linalg.norm(dtheta) / np.linalg.norm(self.least)),
            float(np.linalg.norm(dtheta - self.least) / np.linalg.norm(self.least)),
            float(np.linalg.norm(self.jacobian @ dtheta - self.demand) / np.linalg.norm(self.demand)),
        )


def shared_solvers() -> list[str]:
    """Return the solvers that both mink and this library can call here."""
    return [name for name in installed_solvers() if name in qpsolvers.available_solvers]


def measure(solvers: Sequence[str]) -> list[Row]:
    """Return one row a task, with and without the joint range, and solver."""
    rows = []
    for task in TASKS:
        for joint_range in (True, False):
            bench = Bench(task, joint_range=joint_range)
            rows += [
                Row(task, joint_range, name, get_backend(name).version, bench.by_mink(name), bench.by_us(name))
                for name in solvers
            ]
    return rows
