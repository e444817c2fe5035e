"""Robots on short tracks towards what they are drawn to: strict levels beside mink's one."""

from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import mujoco
import numpy as np
import qpsolvers

from comparisons.bench.clock import Times, in_turn
from comparisons.bench.rivals import MinkOnRobot, answering
from comparisons.bench.settings import ROBOT_LEVELS, BenchSettings
from comparisons.bench.winding import gap
from comparisons.robots import ROBOTS, Robot, Scene
from comparisons.settings import MINK_SOLVERS
from prioritized_ik.models import update_kinematics
from prioritized_ik.problem import IKProblem, Level
from prioritized_ik.solvers.lexicographic import ActiveSet, SolveOptions, joint_step
from prioritized_ik.solvers.step import JointStep, StepStatus
from prioritized_ik.validation import Array

Work = tuple[int, int]  # track, step


@dataclass
class RobotTimes:
    """What was measured on one robot.

    Attributes:
        joints: m.
        times: by "1 level" and so on, and by mink's solver.
        active: of each number of levels, the states where a row or limit binds.
        cold: the first state of each track.
        gaps: of mink's answer to the first level, see `winding.gap`.
        steps: how many of ours were timed.
        certificates: how many of them had a certificate, and how many of these hold.
        paths: by which path of the library they were made, where it tells.
    """

    joints: int
    times: Times = field(default_factory=Times)
    active: dict[int, set[Work]] = field(default_factory=lambda: defaultdict(set))
    cold: set[Work] = field(default_factory=set)
    gaps: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    steps: int = 0
    certificates: int = 0
    certified: int = 0
    paths: Counter[str] = field(default_factory=Counter)


def label(levels: int) -> str:
    """Return what a hierarchy of so many levels is called."""
    return "1 level" if levels == 1 else f"{levels} levels"


def measure_robots(settings: BenchSettings, tell: Callable[[str, int, int], object]) -> dict[str, RobotTimes]:
    """Return the times of every robot; `tell` hears what is done, how much of it, and of how much."""
    measured = {}
    for number, (name, robot) in enumerate(ROBOTS.items()):
        tell("robots", number, len(ROBOTS))
        measured[name] = _measure(name, robot, settings)
    tell("robots", len(ROBOTS), len(ROBOTS))
    return measured


def problem_of(robot: Robot, scene: Scene, count: int) -> IKProblem:
    """Return the problem of a scene with `count` levels: the robot's first ones, or with the rows of each parted in two."""
    if count <= len(robot.levels):
        return robot.problem(scene, count)
    whole = robot.problem(scene)
    return whole.with_levels([half for level in whole.levels for half in _halves(level)])


def _halves(level: Level) -> list[Level]:
    places = np.array_split(np.arange(len(level.target)), 2)
    return [
        Level(level.matrix[rows], level.target[rows], level.weights[rows], f"{level.name}, part {part}", level.kind)
        for part, rows in enumerate(places, 1)
    ]


def _measure(name: str, robot: Robot, settings: BenchSettings) -> RobotTimes:
    measured = RobotTimes(robot.scene(0).model.nv)
    for repeat in range(settings.repeats):
        for track in range(settings.tracks):
            scene = robot.scene(track)
            solvers = {count: ActiveSet() for count in ROBOT_LEVELS}
            rivals = {
                f"mink ({solver})": MinkOnRobot(name, scene, solver)
                for solver in MINK_SOLVERS
                if solver in qpsolvers.available_solvers
            }
            for number in range(settings.track):
                work = (track, number)
                step = _measure_state(robot, scene, solvers, rivals, measured, work, first=repeat == 0)
                if number == 0:
                    measured.cold.add(work)
                if step.dtheta is None:
                    break
                _move(scene, step.dtheta)
    return measured


def _measure_state(
    robot: Robot,
    scene: Scene,
    solvers: dict[int, ActiveSet],
    rivals: dict[str, MinkOnRobot],
    measured: RobotTimes,
    work: Work,
    first: bool,
) -> JointStep:
    """Time every program at the scene's state, and return our step of the longest hierarchy that is the robot's own."""
    q = scene.now.qpos.copy()
    one = problem_of(robot, scene, 1)
    calls: dict[str, Callable[[], object]] = {name: answering(rival, one, q) for name, rival in rivals.items()}
    calls |= {label(count): partial(_step, robot, scene, solver, count) for count, solver in solvers.items()}
    timed = in_turn(calls, sum(work))
    for program, (seconds, _) in timed.items():
        measured.times.add(program, work, seconds)
    steps: dict[int, JointStep] = {count: timed[label(count)][1] for count in solvers}
    for count, step in steps.items():
        measured.steps += 1
        measured.certificates += step.certificate is not None
        measured.certified += bool(step.certificate is not None and step.certificate.holds)
        measured.paths[str(getattr(step, "path", "python"))] += 1
        if first and step.status is not StepStatus.CLOSED_FORM:
            measured.active[count].add(work)
    if first:
        for program in rivals:
            measured.gaps[program].append(gap(one, timed[program][1], steps[1]))
    return steps[max(count for count in steps if count <= len(robot.levels))]


def _step(robot: Robot, scene: Scene, solver: ActiveSet, count: int) -> JointStep:
    """Pose the problem of a state whose kinematics are up to date, and return its certified step."""
    return joint_step(problem_of(robot, scene, count), solver, SolveOptions())


def _move(scene: Scene, dtheta: Array) -> None:
    q = scene.now.qpos.copy()
    mujoco.mj_integratePos(scene.model, q, dtheta, 1.0)
    limited = np.flatnonzero(scene.model.jnt_limited)
    places = scene.model.jnt_qposadr[limited]
    q[places] = np.clip(q[places], *scene.model.jnt_range[limited].T)  # of rounding
    update_kinematics(scene.model, scene.now, q)
