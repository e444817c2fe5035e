"""The same step as a user of mink would ask for it today: frame tasks, costs and limits, one call of `mink.solve_ik`.

Every virtual arm is a `FrameTask` with position cost √w and no orientation cost, joint ranges a `ConfigurationLimit`, the
step limit a `VelocityLimit`, contacts a `CollisionAvoidanceLimit`. mink's collision limit divides the gap by the time step
and compares it with a displacement, so its gain is multiplied by the time step to mean the same.
"""

import time
from collections.abc import Callable

import mink
import mujoco
import numpy as np

from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.backends.qpsolvers_ import SOLVER_ERRORS
from prioritized_ik.solvers.certificate import certify
from prioritized_ik.solvers.step import JointStep, StepStatus, Timings
from prioritized_ik.tolerances import ACCEPTED_VIOLATION
from prioritized_ik.validation import Array
from prioritized_ik.winding.settings import WindingSettings


class MinkSolver:
    """Solves a winding problem by `mink.solve_ik` with its default damping."""

    def __init__(self, settings: WindingSettings, solver: str) -> None:
        self._solver = solver
        self._dt = settings.dt
        self._rank_tolerance = settings.options.rank_tolerance
        arm = settings.arm
        model = settings.model()
        self._configuration = mink.Configuration(model)
        self._ends = arm.end_sites
        joints = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, joint) for joint in range(model.njnt)]
        self._limits = [
            mink.ConfigurationLimit(model, gain=1.0),
            mink.VelocityLimit(model, dict.fromkeys(joints, settings.max_step / settings.dt)),
            mink.CollisionAvoidanceLimit(
                model,
                [(arm.link_geoms, ["object"])],
                gain=settings.contact_gain * settings.dt,
                minimum_distance_from_collisions=settings.min_distance,
                collision_detection_distance=0.05,
            ),
        ]

    def posed(self, problem: IKProblem, q: Array) -> Callable[[], Array]:
        """Return what asks mink for its step dθ `(m,)` of the one-level `problem` posed at joint positions `q`."""
        level = problem.levels[0]
        desired = level.target.reshape(-1, 3)
        costs = np.sqrt(level.weights.reshape(-1, 3))
        self._configuration.update(q)
        tasks = [self._task(end, dx, cost) for end, dx, cost in zip(self._ends, desired, costs, strict=True)]

        def ask() -> Array:
            velocity = mink.solve_ik(self._configuration, tasks, self._dt, self._solver, limits=self._limits)
            return np.asarray(velocity) * self._dt

        return ask

    def __call__(self, problem: IKProblem, q: Array) -> JointStep:
        """Return mink's step for the one-level `problem` posed at joint positions `q`."""
        level = problem.levels[0]
        started = time.perf_counter()
        ask = self.posed(problem, q)
        try:
            dtheta = ask()
        except (mink.MinkError, *SOLVER_ERRORS) as error:
            return JointStep(None, StepStatus.NOT_FOUND, f"mink: {error}", timings=self._since(started))
        timings = self._since(started)
        if not np.isfinite(dtheta).all():
            return JointStep(None, StepStatus.NOT_FOUND, "mink: values that are not finite", timings=timings)
        certificate = certify(problem, dtheta, self._rank_tolerance)
        kept = certificate.violation <= ACCEPTED_VIOLATION
        status = StepStatus.SOLVED if certificate.holds else StepStatus.UNCERTIFIED
        return JointStep(
            dtheta if kept else None,
            status if kept else StepStatus.VIOLATED,
            costs=(level.cost(dtheta),),
            tight_rows=problem.tight_rows(dtheta, ACCEPTED_VIOLATION * float(np.linalg.norm(dtheta))),
            violation=certificate.violation,
            timings=timings,
            calls=1,
            certificate=certificate,
        )

    def _task(self, end: str, dx: Array, cost: Array) -> mink.FrameTask:
        task = mink.FrameTask(end, "site", position_cost=cost, orientation_cost=0.0)
        here = self._configuration.get_transform_frame_to_world(end, "site")
        task.set_target(mink.SE3.from_rotation_and_translation(here.rotation(), here.translation() + dx))
        return task

    @staticmethod
    def _since(started: float) -> Timings:
        return Timings(build=0.0, solve=time.perf_counter() - started)
