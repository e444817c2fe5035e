"""What our step is timed beside: mink, and single calls of the C and Fortran routines that nothing can go below.

A rival prepares its question untimed, configuration, tasks and rows included, and only what answers it is timed. So each is
timed at its best: ours is timed from joint positions to certificate.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import daqp
import mink
import mujoco
import numpy as np
import scipy.linalg.lapack
from numpy.typing import NDArray

from comparisons.goals import Scene
from comparisons.mink_today import MinkBench
from prioritized_ik.problem import Bounds, IKProblem, Level, Rows, replaced
from prioritized_ik.solvers.backends.qpsolvers_ import SOLVER_ERRORS
from prioritized_ik.solvers.backends.registry import ACCURACY
from prioritized_ik.solvers.daqp_hierarchy import ATTEMPTS, LevelRows
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.validation import Array
from prioritized_ik.winding.settings import WindingSettings

INFINITY = 1e30  # DAQP's
DAMPING = 1e-12  # mink's and pink's

Failures = tuple[type[Exception], ...]

MINK_FAILURES: Failures = (mink.MinkError, *SOLVER_ERRORS)

Ask = Callable[[], Array]


class Rival(Protocol):
    """One program beside ours.

    Attributes:
        failures: what it raises where it finds no answer.
    """

    failures: Failures

    def asked(self, problem: IKProblem, q: Array) -> IKProblem:
        """Return what of `problem`, posed at joint positions `q`, it answers: the least of what ours does."""
        ...

    def ask(self, asked: IKProblem, q: Array) -> Ask:
        """Return what is timed: it answers `asked` with dθ `(m,)`."""
        ...


def answering(rival: Rival, asked: IKProblem, q: Array) -> Callable[[], Array | None]:
    """Return what is timed of a rival; it answers None where the rival finds no answer."""
    ask = rival.ask(asked, q)

    def answer() -> Array | None:
        try:
            return ask()
        except rival.failures:
            return None

    return answer


def in_one_level(problem: IKProblem) -> IKProblem:
    """Return the problem with the rows of all levels in one, for programs that know no other."""
    if len(problem.levels) == 1:
        return problem
    matrix, target, weights = (
        np.concatenate([getattr(level, name) for level in problem.levels]) for name in ("matrix", "target", "weights")
    )
    return problem.with_levels([Level(matrix, target, weights, "all levels")])


class Mink:
    """`mink.solve_ik` on the winding, with its limits on ranges, velocities and collisions."""

    failures: Failures = MINK_FAILURES

    def __init__(self, settings: WindingSettings, solver: str) -> None:
        self._bench, self._solver = MinkBench(settings), solver

    def asked(self, problem: IKProblem, q: Array) -> IKProblem:
        """See `Rival.asked`."""
        return in_one_level(problem)

    def ask(self, asked: IKProblem, q: Array) -> Ask:
        """See `Rival.ask`."""
        return self._bench.posed(asked, q, self._solver)


class Dgelsy:
    """LAPACK's least squares of least norm by complete orthogonal factorisation: Eqs. 12 to 14 without any limit."""

    failures: Failures = ()

    def __init__(self, rank_tolerance: float) -> None:
        self._rank_tolerance = rank_tolerance

    def asked(self, problem: IKProblem, q: Array) -> IKProblem:
        """See `Rival.asked`."""
        m = problem.joint_count
        return replaced(in_one_level(problem), bounds=Bounds.none(m), rows=Rows.none(m))

    def ask(self, asked: IKProblem, q: Array) -> Ask:
        """See `Rival.ask`."""
        (level,) = asked.levels
        roots = np.sqrt(level.weights)
        k, m = level.matrix.shape
        matrix, side = roots[:, None] * level.matrix, np.zeros((max(k, m), 1))
        side[:k, 0] = roots * level.target
        work, _ = scipy.linalg.lapack.dgelsy_lwork(k, m, 1, self._rank_tolerance)
        lwork, pivots = int(work), np.zeros(m, dtype=np.int32)

        def ask() -> Array:
            _, x, _, _, _ = scipy.linalg.lapack.dgelsy(matrix, side, pivots, self._rank_tolerance, lwork)
            return x[:m, 0]

        return ask


class Daqp:
    """One call of DAQP on the damped dense QP that mink and pink pose, all rows included."""

    failures: Failures = SOLVER_ERRORS

    def asked(self, problem: IKProblem, q: Array) -> IKProblem:
        """See `Rival.asked`."""
        return in_one_level(problem)

    def ask(self, asked: IKProblem, q: Array) -> Ask:
        """See `Rival.ask`."""
        (level,) = asked.levels
        weighted = level.weights[:, None] * level.matrix
        hessian = level.matrix.T @ weighted + DAMPING * np.eye(asked.joint_count)
        linear = -weighted.T @ level.target
        matrix = np.array(asked.rows.matrix)  # DAQP takes no read-only arrays
        upper = np.concatenate([asked.bounds.upper, asked.rows.upper])
        lower = np.concatenate([asked.bounds.lower, np.full(len(matrix), -INFINITY)])
        sense = np.zeros(len(upper), dtype=np.intc)

        def ask() -> Array:
            x, _, _, _ = daqp.solve(hessian, linear, matrix, upper, lower, sense)
            return x

        return ask


class DaqpHierarchy:
    """One call of DAQP's own solver of hierarchies, its rows made before."""

    failures: Failures = SOLVER_ERRORS

    def __init__(self, rank_tolerance: float) -> None:
        self._rank_tolerance = rank_tolerance

    def asked(self, problem: IKProblem, q: Array) -> IKProblem:
        """See `Rival.asked`."""
        return problem

    def ask(self, asked: IKProblem, q: Array) -> Ask:
        """See `Rival.ask`."""
        hierarchy = Hierarchy(asked, self._rank_tolerance)
        levels = LevelRows.of(hierarchy)
        hessian, linear = np.eye(len(levels.target)), -levels.target
        sense = np.zeros(len(levels.upper), dtype=np.intc)
        multiple, rho = ATTEMPTS[0]

        def ask() -> Array:
            x, _, _, _ = daqp.solve(
                hessian, linear, levels.rows, levels.upper, levels.lower, sense, levels.break_points,
                primal_tol=multiple * ACCURACY, rho_soft=rho,
            )  # fmt: skip
            return x

        return lambda: hierarchy.start + levels.basis @ ask()


# Robots.


@dataclass(frozen=True)
class Frame:
    """A frame task of mink's: a site, its costs, and whether it is to stay where it is."""

    site: str
    position: float = 1.0
    orientation: float = 0.0
    stays: bool = False


#: What the first level of each of `ROBOTS` is in mink.
FIRST_LEVELS = {
    "arm of 7 joints": (Frame("tool"),),
    "industrial arm": (Frame("tool"),),
    "arm on wheels": (Frame("tool", 10.0, 1.0),),
    "gantry": (Frame("tool"),),
    "SCARA": (Frame("tool"),),
    "humanoid": (Frame("left foot", 1.0, 1.0, stays=True), Frame("right foot", 1.0, 1.0, stays=True)),
}


class GivenRows(mink.Limit):  # type: ignore[misc]
    """Rows that mink has no limit for, handed to it ready made: equalities as two rows."""

    def __init__(self, problem: IKProblem, free: NDArray[np.int_]) -> None:
        rows, fixed = problem.rows, problem.equalities
        eye = np.eye(problem.joint_count)[free]
        self._constraint = mink.Constraint(
            np.vstack([rows.matrix, fixed.matrix, -fixed.matrix, eye, -eye]),
            np.concatenate(
                [rows.upper, fixed.target, -fixed.target, problem.bounds.upper[free], -problem.bounds.lower[free]]
            ),
        )

    def compute_qp_inequalities(self, configuration: mink.Configuration, dt: float) -> mink.Constraint:
        """Return the rows G dθ <= h."""
        del configuration, dt
        return self._constraint


class MinkOnRobot:
    """`mink.solve_ik` on the first level of a robot, with all its limits and rows."""

    failures: Failures = MINK_FAILURES

    def __init__(self, name: str, scene: Scene, solver: str) -> None:
        self._scene, self._solver = scene, solver
        model = scene.model
        kinds = model.jnt_type
        self._free = np.flatnonzero(kinds[model.dof_jntid] == mujoco.mjtJoint.mjJNT_FREE)
        self._configuration = mink.Configuration(model)
        self._frames = FIRST_LEVELS[name]
        self._tasks = [
            mink.FrameTask(frame.site, "site", position_cost=frame.position, orientation_cost=frame.orientation)
            for frame in self._frames
        ]
        joints = [j for j in range(model.njnt) if kinds[j] != mujoco.mjtJoint.mjJNT_FREE]
        longest = {model.joint(j).name: float(scene.step[model.jnt_dofadr[j]]) for j in joints}
        self._limits = [mink.ConfigurationLimit(model, gain=1.0), mink.VelocityLimit(model, longest)]

    def asked(self, problem: IKProblem, q: Array) -> IKProblem:
        """See `Rival.asked`."""
        return problem.with_levels(problem.levels[:1])

    def posed(self, asked: IKProblem, q: Array) -> list[mink.Limit]:
        """Bring configuration and tasks up to date and return the limits."""
        self._configuration.update(q)
        for frame, task in zip(self._frames, self._tasks, strict=True):
            now, wanted = self._scene.now.site(frame.site), self._scene.wanted.site(frame.site)
            there = now if frame.stays else wanted
            turned = there if frame.orientation else now  # a wanted turn would change mink's error in position
            rotation = mink.SO3.from_matrix(turned.xmat.reshape(3, 3))
            task.set_target(mink.SE3.from_rotation_and_translation(rotation, there.xpos.copy()))
        return [*self._limits, GivenRows(asked, self._free)]

    def qp(self, asked: IKProblem, q: Array) -> object:
        """Return the QP that mink poses, a `qpsolvers.Problem`."""
        limits = self.posed(asked, q)
        return mink.build_ik(self._configuration, self._tasks, 1.0, limits=limits)

    def ask(self, asked: IKProblem, q: Array) -> Ask:
        """See `Rival.ask`. The time step is 1 s, so that velocities are steps."""
        limits = self.posed(asked, q)
        return lambda: np.asarray(mink.solve_ik(self._configuration, self._tasks, 1.0, self._solver, limits=limits))
