"""Joint steps of robots as people have them: hierarchies of real tasks in metres and radians, from MuJoCo's Jacobians.

A robot's structure is fixed: its levels, limits, rows and equalities. Random are only its configuration, where some joints
stand at a limit or near it, and its targets: what it would see at another configuration, near or out of reach of a step.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from comparisons.goals import Goal, Scene
from comparisons.robot_models import ARM_7, GANTRY, HUMANOID, INDUSTRIAL_6, MOBILE_ARM, SCARA
from prioritized_ik.live import LiveProblem
from prioritized_ik.posing import Posing
from prioritized_ik.problem import IKProblem
from prioritized_ik.validation import Array


@dataclass(frozen=True)
class Robot:
    """A robot and what its user asks of it.

    Attributes:
        text: its MJCF.
        levels: what makes each level of a scene, the most important first.
        slide: longest step of a slide, and of a free joint's position [m].
        hinge: longest step of a hinge, and of a free joint's orientation [rad].
        wandering: how far a free joint is from where the model has it [m, rad].
        row: what makes its hard row, if it has one.
        equality: what makes its hard equality, if it has one.
    """

    text: str
    levels: tuple[Callable[[Scene], Goal], ...]
    slide: float = 0.05
    hinge: float = 0.1
    wandering: float = 0.0
    row: Callable[[Scene], Goal] | None = None
    equality: Callable[[Scene], Goal] | None = None

    def scene(self, seed: int) -> Scene:
        """Return the random scene of `seed`."""
        return Scene.of(self.text, seed, self.slide, self.hinge, self.wandering)

    def problem(self, scene: Scene, levels: int | None = None) -> IKProblem:
        """Return the problem of a scene's next step, with the first `levels` only if given."""
        return IKProblem(
            [level(scene).level(scene) for level in self.levels[:levels]],
            scene.bounds(),
            None if self.row is None else self.row(scene).row(scene),
            equalities=None if self.equality is None else self.equality(scene).equality(scene),
        )

    def live(self, scene: Scene, problem: IKProblem) -> Callable[[], IKProblem]:
        """Return what poses a problem of the scene anew wherever its state is, the numbers written in place.

        The problem's levels are the first ones of the robot, or those with their rows parted further.
        """
        live, posing, start = LiveProblem(problem), scene.posing(), 0
        matrix, target = live.matrix(), live.target()
        for goal in [level(scene) for level in self.levels]:
            if start < len(target):
                rows = slice(start, start := start + goal.rows)
                goal.bind(posing, matrix[rows], target[rows])
        posing.bounds(live.lower, live.upper, scene.step)
        if self.row is not None:
            self.row(scene).bind(posing, live.row_matrix, live.row_upper)
        if self.equality is not None:
            self.equality(scene).bind(posing, live.equality_matrix, live.equality_target)

        def posed() -> IKProblem:
            posing()
            return live.frozen()

        return posed


def base_at_rest(scene: Scene) -> Goal:
    """Return that a base of two slides and a hinge is not to move."""

    def bind(posing: Posing, matrix: Array, target: Array) -> None:
        matrix[:], target[:] = np.eye(scene.model.nv)[:3], 0.0

    return Goal("base at rest", 3, bind, np.array([1.0, 1.0, 0.25]))


def no_slip(scene: Scene) -> Goal:
    """Return that wheels do not slip sideways."""
    q = scene.now.qpos

    def bind(posing: Posing, matrix: Array, target: Array) -> None:
        matrix[:], target[:] = 0.0, 0.0

        def write() -> None:
            heading = float(q[2])
            matrix[0, 0], matrix[0, 1] = -math.sin(heading), math.cos(heading)

        posing.also(write)

    return Goal("no slip", 1, bind)


ROBOTS: dict[str, Robot] = {
    # A redundant arm on a table.
    "arm of 7 joints": Robot(
        ARM_7,
        (lambda scene: scene.position("tool"), lambda scene: scene.orientation("tool"), Scene.posture),
        row=lambda scene: scene.above("tool", 0.05),
    ),
    # A large arm with a tool that is round.
    "industrial arm": Robot(
        INDUSTRIAL_6,
        (lambda scene: scene.position("tool"), lambda scene: scene.pointing("tool", axis=0), Scene.posture),
        hinge=0.05,
        row=lambda scene: scene.above("tool", 0.3),
    ),
    # An arm on wheels, which do not slip sideways; 10 mm count as 0.1 rad.
    "arm on wheels": Robot(
        MOBILE_ARM,
        (lambda scene: scene.pose("tool", np.repeat([100.0, 1.0], 3)), base_at_rest, Scene.posture),
        row=lambda scene: scene.above("tool", 0.1),
        equality=no_slip,
    ),
    # A crane of 15 m with a wrist.
    "gantry": Robot(
        GANTRY,
        (lambda scene: scene.position("tool"), lambda scene: scene.pointing("tool", axis=2), Scene.posture),
        slide=0.5,
        row=lambda scene: scene.above("tool", 0.2),
    ),
    # An arm that turns about one axis only, so that its orientation has rank 1.
    "SCARA": Robot(
        SCARA,
        (lambda scene: scene.position("tool"), lambda scene: scene.orientation("tool"), Scene.posture),
        slide=0.02,
        row=lambda scene: scene.above("tool", 0.15),
    ),
    "humanoid": Robot(
        HUMANOID,
        (
            lambda scene: scene.stay(["left foot", "right foot"], "feet"),
            lambda scene: scene.balance(["left foot", "right foot"], 0.05),
            Scene.centre_of_mass,
            lambda scene: scene.positions(["left hand", "right hand"], "hands"),
            lambda scene: scene.pointing("eyes", axis=0),
            Scene.posture,
        ),
        wandering=0.1,
    ),
}


def robot_steps(name: str, seed: int) -> IKProblem:
    """Return a random step of the robot `name`, a key of `ROBOTS`."""
    robot = ROBOTS[name]
    return robot.problem(robot.scene(seed))
