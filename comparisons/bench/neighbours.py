"""pink and placo on the winding arm, where they are installed (extra `bench`).

Neither knows contacts: they answer less than ours does. placo is timed with joint limits and with velocity limits too.
"""

import importlib.util
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from comparisons.bench.rivals import Ask, Rival, in_one_level
from comparisons.bench.urdf import urdf
from prioritized_ik.limits import joint_range_bounds
from prioritized_ik.problem import IKProblem, Rows, replaced
from prioritized_ik.solvers.backends.qpsolvers_ import SOLVER_ERRORS
from prioritized_ik.validation import Array
from prioritized_ik.winding.settings import WindingSettings

#: The module of each neighbour, and the package that it comes in.
PACKAGES = {"pink": "pin-pink", "placo": "placo"}


def missing() -> dict[str, str]:
    """Return the neighbours that are not installed, and how to get them."""
    return {name: f"pip install {package}" for name, package in PACKAGES.items() if not importlib.util.find_spec(name)}


def neighbours(settings: WindingSettings) -> dict[str, Rival]:
    """Return those that are installed."""
    found: dict[str, Callable[[WindingSettings], Rival]] = {
        "pink": Pink,
        "placo": lambda given: Placo(given, velocity_limits=False),
        "placo, velocity limits": Placo,
    }
    absent = missing()
    return {name: make(settings) for name, make in found.items() if name.split(",")[0] not in absent}


class _Neighbour:
    """What both share: the arm as URDF, and the problem without contacts."""

    velocity_limits = True
    failures: tuple[type[Exception], ...] = (RuntimeError,)  # placo's

    def __init__(self, settings: WindingSettings) -> None:
        self._settings = settings
        self._arm = settings.arm.spec().compile()
        self._data = mujoco.MjData(self._arm)
        self._ends = settings.arm.end_sites
        self.urdf = urdf(self._arm, settings.max_step / settings.dt)

    def asked(self, problem: IKProblem, q: Array) -> IKProblem:
        """See `Rival.asked`."""
        bounds = problem.bounds if self.velocity_limits else joint_range_bounds(self._arm, q)
        return replaced(in_one_level(problem), rows=Rows.none(problem.joint_count), bounds=bounds)

    def _targets(self, asked: IKProblem, q: Array) -> tuple[Array, Array]:
        """Return where the end points are to be `(n, 3)` [m], and each one's weight `(n,)`."""
        (level,) = asked.levels
        self._data.qpos[:] = q
        mujoco.mj_kinematics(self._arm, self._data)
        here = np.array([self._data.site(end).xpos for end in self._ends])
        return here + level.target.reshape(-1, 3), level.weights.reshape(-1, 3)[:, 0]


class Pink(_Neighbour):
    """`pink.solve_ik` with DAQP, its default damping, configuration and velocity limits."""

    def __init__(self, settings: WindingSettings) -> None:
        super().__init__(settings)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # among their own packages
            import pink
            import pink.exceptions
            import pinocchio

        self._pink, self._pinocchio = pink, pinocchio
        self.failures = (pink.exceptions.PinkError, *SOLVER_ERRORS)
        self.model = pinocchio.buildModelFromXML(self.urdf)
        self._data_of_pin = self.model.createData()
        self._limits = [pink.limits.ConfigurationLimit(self.model, 1.0), pink.limits.VelocityLimit(self.model)]

    def ask(self, asked: IKProblem, q: Array) -> Ask:
        """See `Rival.ask`."""
        pink, dt = self._pink, self._settings.dt
        configuration = pink.Configuration(self.model, self._data_of_pin, q, copy_data=False)
        tasks = []
        for end, there, weight in zip(self._ends, *self._targets(asked, q), strict=True):
            task = pink.tasks.FrameTask(end, position_cost=float(np.sqrt(weight)), orientation_cost=0.0)
            rotation = configuration.get_transform_frame_to_world(end).rotation
            task.set_target(self._pinocchio.SE3(rotation, there))
            tasks.append(task)

        def ask() -> Array:
            velocity = pink.solve_ik(configuration, tasks, dt, "daqp", limits=self._limits, safety_break=False)
            return np.asarray(velocity) * dt

        return ask


class Placo(_Neighbour):
    """placo's kinematics solver: its kinematics and one call."""

    def __init__(self, settings: WindingSettings, velocity_limits: bool = True) -> None:
        super().__init__(settings)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            import placo

        self.velocity_limits = velocity_limits
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "robot.urdf"
            file.write_text(self.urdf, encoding="utf-8")
            self.robot: Any = placo.RobotWrapper(str(file), placo.Flags.ignore_collisions)
        self._solver = placo.KinematicsSolver(self.robot)
        self._solver.mask_fbase(True)
        self._solver.enable_joint_limits(True)
        self._solver.enable_velocity_limits(velocity_limits)
        self._solver.dt = settings.dt
        self._tasks = [self._solver.add_position_task(end, np.zeros(3)) for end in self._ends]
        self._free = len(self.robot.state.q) - self._arm.nq  # places of the floating base

    def ask(self, asked: IKProblem, q: Array) -> Ask:
        """See `Rival.ask`."""
        state = self.robot.state.q.copy()
        state[self._free :] = q
        self.robot.state.q = state
        self.robot.update_kinematics()
        for task, there, weight in zip(self._tasks, *self._targets(asked, q), strict=True):
            task.target_world = there
            task.configure("end", "soft", float(weight))

        def ask() -> Array:
            self.robot.update_kinematics()
            return np.asarray(self._solver.solve(False))[-len(q) :]

        return ask
