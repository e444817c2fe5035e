"""Robots on short tracks towards what they are drawn to: strict levels beside mink's one."""

from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import mujoco
import numpy as np
import qpsolvers

from comparisons.bench.clock import Times, rotated, timed
from comparisons.bench.rivals import MinkOnRobot, answering
from comparisons.bench.settings import ROBOT_LEVELS, BenchSettings
from comparisons.bench.winding import gap
from comparisons.goals import Scene
from comparisons.robots import ROBOTS, Robot
from comparisons.settings import MINK_SOLVERS
from prioritized_ik.models import update_kinematics
from prioritized_ik.problem import IKProblem, Level
from prioritized_ik.solvers.methods import ActiveSet
from prioritized_ik.solvers.step import JointStep, StepStatus
from prioritized_ik.validation import Array

SOLVING = ", solve"  # of the times of one number of levels, those from the problem to the certified step

Work = tuple[int, int]  # track, step


@dataclass
class RobotTimes:
    """What was measured on one robot.

    Attributes:
        joints: m.
        times: by "1 level" and so on, posing and solving, by the same and `SOLVING`, and by mink's solver.
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
    for track in range(settings.tracks):
        scene = robot.scene(track)
        states = states_of(robot, scene, settings.track)
        rivals = {
            f"mink ({solver})": MinkOnRobot(name, scene, solver)
            for solver in MINK_SOLVERS
            if solver in qpsolvers.available_solvers
        }
        for repeat in range(settings.repeats):
            turn = repeat + settings.repeats * track
            _measure_track(robot, scene, states, rivals, measured, track, turn, first=repeat == 0)
    return measured


def states_of(robot: Robot, scene: Scene, count: int) -> list[Array]:
    """Return the joint positions that the robot's own hierarchy goes through, fewer than `count` where it finds no step."""
    solver, states = ActiveSet(), [scene.now.qpos.copy()]
    while len(states) < count:
        step = solver.step(robot.problem(scene))
        if step.dtheta is None:
            break
        _move(scene, step.dtheta)
        states.append(scene.now.qpos.copy())
    return states


def _measure_track(
    robot: Robot,
    scene: Scene,
    states: list[Array],
    rivals: dict[str, MinkOnRobot],
    measured: RobotTimes,
    track: int,
    turn: int,
    first: bool,
) -> None:
    """Let every program go along the track by itself, one program after the other."""
    steps: dict[int, list[JointStep]] = {count: [] for count in ROBOT_LEVELS}
    answers: dict[str, list[Array | None]] = {program: [] for program in rivals}
    questions: list[IKProblem] = []
    for q in states:
        update_kinematics(scene.model, scene.now, q)
        questions.append(problem_of(robot, scene, 1))

    def go_ours(count: int) -> None:
        update_kinematics(scene.model, scene.now, states[0])
        pose, solver = robot.live(scene, problem_of(robot, scene, count)), ActiveSet()
        ActiveSet().step(pose())  # warms up the processor, not the solver
        for number, q in enumerate(states):
            update_kinematics(scene.model, scene.now, q)
            posing, problem = timed(pose)
            solving, step = timed(partial(solver.step, problem))
            measured.times.add(label(count), (track, number), posing + solving)
            measured.times.add(label(count) + SOLVING, (track, number), solving)
            _count(step, measured)
            steps[count].append(step)

    def go(program: str) -> None:
        answering(rivals[program], questions[0], states[0])()
        for number, q in enumerate(states):
            update_kinematics(scene.model, scene.now, q)
            seconds, answer = timed(answering(rivals[program], questions[number], q))
            measured.times.add(program, (track, number), seconds)
            answers[program].append(answer)

    programs: dict[str, Callable[[], None]] = {program: partial(go, program) for program in rivals}
    programs |= {label(count): partial(go_ours, count) for count in ROBOT_LEVELS}
    for program in rotated(programs, turn):
        programs[program]()
    if first:
        measured.cold.add((track, 0))
        for number, one in enumerate(questions):
            for count in ROBOT_LEVELS:
                if steps[count][number].status is not StepStatus.CLOSED_FORM:
                    measured.active[count].add((track, number))
            for program in rivals:
                measured.gaps[program].append(gap(one, answers[program][number], steps[1][number]))


def _count(step: JointStep, measured: RobotTimes) -> None:
    measured.steps += 1
    measured.certificates += step.certificate is not None
    measured.certified += bool(step.certificate is not None and step.certificate.holds)
    measured.paths[str(getattr(step, "path", "python"))] += 1


def _move(scene: Scene, dtheta: Array) -> None:
    q = scene.now.qpos.copy()
    mujoco.mj_integratePos(scene.model, q, dtheta, 1.0)
    limited = np.flatnonzero(scene.model.jnt_limited)
    places = scene.model.jnt_qposadr[limited]
    q[places] = np.clip(q[places], *scene.model.jnt_range[limited].T)  # of rounding
    update_kinematics(scene.model, scene.now, q)
