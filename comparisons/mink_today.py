"""The same step as a user of mink would ask for it today: frame tasks, costs and limits, one call of `mink.solve_ik`.

Every virtual arm is a `FrameTask` with position cost √w and no orientation cost, joint ranges a `ConfigurationLimit`, the
step limit a `VelocityLimit`, contacts a `CollisionAvoidanceLimit`. mink's collision limit divides the gap by the time step
and compares it with a displacement, so its gain is multiplied by the time step to mean the same.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from importlib.metadata import version

import mink
import mujoco
import numpy as np

from prioritized_ik.errors import InputError
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.backends.protocol import StageResult
from prioritized_ik.solvers.backends.qpsolvers_ import SOLVER_ERRORS, silence
from prioritized_ik.solvers.backends.registry import get_backend
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.solvers.lexicographic import Clock, SolveOptions, joint_step
from prioritized_ik.solvers.methods import Method, Place, unaided
from prioritized_ik.solvers.step import JointStep
from prioritized_ik.validation import Array
from prioritized_ik.winding.settings import WindingSettings


class MinkToday(Method):
    """Solves a winding's problems by `mink.solve_ik` with its default damping."""

    def __init__(self, solver: str) -> None:
        self.name = f"mink:{solver}"
        self._version = f"{version('mink')} / {get_backend(solver).version}"
        self._solver = solver
        self._bench: MinkBench | None = None

    def __getstate__(self) -> dict[str, object]:
        """Return what a copy gets: all but what mink has set up."""
        return {**vars(self), "_bench": None}

    @property
    def version(self) -> str:
        """Versions of mink and of the solver."""
        return self._version

    def step(self, problem: IKProblem, options: SolveOptions | None = None, place: Place | None = None) -> JointStep:
        """See `Method.step`. The place has to be in a winding."""
        if len(problem.levels) != 1:
            raise InputError(f"{self.name} takes one level, not {len(problem.levels)}.")
        if place is None or not isinstance(place.scene, WindingSettings):
            raise InputError(
                f"{self.name} poses its problem anew, from the model and posture of a winding; use `wind` for it."
            )
        if self._bench is None or self._bench.settings != place.scene:
            self._bench = MinkBench(place.scene)
        step = joint_step(problem, partial(self._answer, self._bench, place.q), unaided(self, options), self.name)
        return replace(step, timings=replace(step.timings, build=0.0))  # which is not mink's

    def _answer(self, bench: "MinkBench", q: Array, problem: IKProblem, hierarchy: Hierarchy, clock: Clock) -> Array | str:
        result = clock.timed(partial(bench.solve, problem, q, self._solver))
        return result.message if result.x is None else problem.to_metric(result.x)


class MinkBench:
    """A winding in mink's terms."""

    def __init__(self, settings: WindingSettings) -> None:
        self.settings = settings
        arm = settings.arm
        model = settings.model()
        self.configuration = mink.Configuration(model)
        joints = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, joint) for joint in range(model.njnt)]
        self.limits = [
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

    def posed(self, problem: IKProblem, q: Array, solver: str) -> Callable[[], Array]:
        """Return what asks mink for its step dθ `(m,)` of the one-level `problem` posed at joint positions `q`."""
        level, dt = problem.levels[0], self.settings.dt
        desired = level.target.reshape(-1, 3)
        costs = np.sqrt(level.weights.reshape(-1, 3))
        self.configuration.update(q)
        ends = self.settings.arm.end_sites
        tasks = [self._task(end, dx, cost) for end, dx, cost in zip(ends, desired, costs, strict=True)]

        def ask() -> Array:
            return np.asarray(mink.solve_ik(self.configuration, tasks, dt, solver, limits=self.limits)) * dt

        return ask

    def solve(self, problem: IKProblem, q: Array, solver: str) -> StageResult:
        """Return mink's dθ `(m,)` as x, for the one-level `problem` posed at joint positions `q`."""
        ask = self.posed(problem, q, solver)
        try:
            with silence.kept():
                dtheta = ask()
        except (mink.MinkError, *SOLVER_ERRORS) as error:
            return StageResult(None, f"mink: {error}")
        return StageResult(dtheta) if np.isfinite(dtheta).all() else StageResult(None, "mink: values that are not finite")

    def _task(self, end: str, dx: Array, cost: Array) -> mink.FrameTask:
        task = mink.FrameTask(end, "site", position_cost=cost, orientation_cost=0.0)
        here = self.configuration.get_transform_frame_to_world(end, "site")
        task.set_target(mink.SE3.from_rotation_and_translation(here.rotation(), here.translation() + dx))
        return task
