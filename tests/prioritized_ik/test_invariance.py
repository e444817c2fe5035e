"""The same physical problem in other units has the same answer: units are the caller's, and no tolerance is tied to one.

Factors are powers of two, so that the problem is the same to the last bit. Others round it anew: then the answer moves by
what that much noise moves the optimum.

`PRIORITIZED_IK_CAMPAIGN=1000 pytest tests/prioritized_ik/test_invariance.py` takes so many problems of each kind instead of
a few.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, partial

import mujoco
import numpy as np
import pytest
from hierarchies import random_hierarchy, sensitivity
from tolerances import ROUNDING
from units import physical, reposed

from comparisons import goals
from comparisons.robots import ROBOTS, robot_steps
from prioritized_ik.problem import IKProblem, Level
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.solvers.step import JointStep, StepStatus

CAMPAIGN = "PRIORITIZED_IK_CAMPAIGN"
SAMPLE = 8  # problems of each kind unless told
OCTAVES = (-10, 20)  # of factors, 1e-3 to 1e6: from kilometres to micrometres where metres were
SAME = 1e-8  # of the step
ROUNDED_ANEW = 2e-13  # times how sensitive a problem is: how far rounding its numbers moves its optimum
ANOTHER = 1e-4  # of the step: far beyond
OFTEN = 0.1  # of the levels feel a weight: those that are met in full do not
LIMITED = 0.25  # of a robot's steps end on a limit, at least

SOURCES: dict[str, Callable[[int], IKProblem]] = {
    "random hierarchies": lambda seed: random_hierarchy(seed).problem,
    **{name: partial(robot_steps, name) for name in ROBOTS},
}
UNITS = ("a level", "a row of a level", "hard rows", "joints", "everything")


@dataclass(frozen=True)
class Units:
    """Random factors of what has units: each level's rows, hard rows, equalities, and joints (None leaves them alone)."""

    levels: list[np.ndarray]
    rows: np.ndarray | float = 1.0
    equalities: np.ndarray | float = 1.0
    joints: np.ndarray | None = None

    @staticmethod
    def random(of: str, problem: IKProblem, seed: int, *, whole: bool = True) -> "Units":
        """Return random units of one of `UNITS`: powers of two if `whole`, else anything between them."""
        rng = np.random.default_rng([seed, UNITS.index(of)])

        def factors(count: int) -> np.ndarray:
            octaves = rng.uniform(*OCTAVES, count)
            return 2.0 ** (np.round(octaves) if whole else octaves)

        levels = [np.ones(1) for _ in problem.levels]
        if of == "a level":
            levels = [factors(1) for _ in problem.levels]
        if of in ("a row of a level", "everything"):
            levels = [factors(len(level.target)) for level in problem.levels]
        rows, equalities, joints = 1.0, 1.0, None
        if of in ("hard rows", "everything"):
            rows, equalities = factors(len(problem.rows.upper)), factors(len(problem.equalities.target))
        if of in ("joints", "everything"):
            joints = factors(problem.joint_count)
        return Units(levels, rows, equalities, joints)

    def of(self, problem: IKProblem) -> IKProblem:
        """Return the problem in these units."""
        return reposed(problem, self.levels, self.rows, self.equalities, self.joints)


def sample() -> range:
    return range(int(os.environ.get(CAMPAIGN, SAMPLE)))


def solved(problem: IKProblem) -> JointStep:
    return get_method("active-set").step(problem, SolveOptions())


@cache
def posed_and_solved(source: str, seed: int) -> tuple[IKProblem, JointStep]:
    problem = SOURCES[source](seed)
    return problem, solved(problem)


def difference(step: np.ndarray, wanted: np.ndarray) -> float:
    return float(np.linalg.norm(step - wanted) / (np.linalg.norm(wanted) or 1.0))


@dataclass
class Differences:
    """What came out otherwise in other units, by seed."""

    seen: int = 0
    statuses: dict[int, str] = field(default_factory=dict)
    steps: dict[int, float] = field(default_factory=dict)

    def count(self, seed: int, before: JointStep, after: JointStep, joints: np.ndarray | None) -> None:
        self.seen += 1
        if before.status is not after.status:
            self.statuses[seed] = f"{before.status.name} became {after.status.name}"
        if before.dtheta is not None and after.dtheta is not None:
            moved = difference(physical(after.dtheta, joints), before.dtheta)
            if not moved <= SAME:
                self.steps[seed] = moved

    def __str__(self) -> str:
        """Say how many of how many differ."""
        return (
            f"of {self.seen}, {len(self.statuses)} have another status {self.statuses} "
            f"and {len(self.steps)} another step {self.steps}"
        )


# The claim.


@pytest.mark.parametrize("of", UNITS)
@pytest.mark.parametrize("source", SOURCES)
def test_other_units_give_the_same_step_and_the_same_status(source, of):
    differences = Differences()
    for seed in sample():
        problem, before = posed_and_solved(source, seed)
        units = Units.random(of, problem, seed)
        differences.count(seed, before, solved(units.of(problem)), units.joints)
    assert not differences.statuses, str(differences)
    assert not differences.steps, str(differences)


@pytest.mark.parametrize("of", UNITS)
def test_units_that_round_the_problem_anew_move_the_step_by_no_more_than_rounding_does(of):
    for seed in sample():
        known = random_hierarchy(seed)
        units = Units.random(of, known.problem, seed, whole=False)
        step = solved(units.of(known.problem))
        assert step.dtheta is not None, (seed, step)
        off = difference(physical(step.dtheta, units.joints), known.dtheta)
        assert off <= max(SAME, ROUNDED_ANEW * sensitivity(known)), (seed, off)


# What makes the claim one.


@pytest.mark.parametrize("of", UNITS)
@pytest.mark.parametrize("source", SOURCES)
def test_other_units_pose_the_same_problem(source, of):
    for seed in range(SAMPLE):
        problem, step = posed_and_solved(source, seed)
        units = Units.random(of, problem, seed)
        other = units.of(problem)
        joints = np.ones(problem.joint_count) if units.joints is None else units.joints
        dtheta = step.dtheta + 0.1 * np.abs(step.dtheta).max() * np.random.default_rng(seed).normal(size=len(joints))
        for level, same in zip(problem.levels, other.levels, strict=True):
            terms = level.weights @ (np.abs(level.matrix) @ np.abs(dtheta) + np.abs(level.target)) ** 2
            assert abs(same.cost(joints * dtheta) - level.cost(dtheta)) <= ROUNDING * terms
        assert physical(other.bounds.upper, units.joints) == pytest.approx(problem.bounds.upper, rel=ROUNDING)
        assert physical(other.bounds.lower, units.joints) == pytest.approx(problem.bounds.lower, rel=ROUNDING)
        for hard, same, factor in (
            (problem.rows.matrix, other.rows.matrix, units.rows),
            (problem.rows.upper[:, None], other.rows.upper[:, None] / joints, units.rows),
            (problem.equalities.matrix, other.equalities.matrix, units.equalities),
            (problem.equalities.target[:, None], other.equalities.target[:, None] / joints, units.equalities),
        ):
            assert same * joints / np.reshape(factor, (-1, 1)) == pytest.approx(
                np.broadcast_to(hard, same.shape), rel=ROUNDING, abs=0.0
            )
        if units.joints is not None:
            offset, same = dtheta - problem.reference, joints * dtheta - other.reference
            assert same @ (other.metric * same) == pytest.approx(offset @ offset, rel=ROUNDING)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_factor_that_the_weights_do_not_make_up_for_gives_another_step(name):
    moved = []
    for seed in range(SAMPLE):
        problem, before = posed_and_solved(name, seed)
        for place, level in enumerate(problem.levels):
            factor = np.ones(len(level.target))
            factor[-1] = 1e3
            levels = list(problem.levels)
            levels[place] = Level(
                level.matrix * factor[:, None], level.target * factor, level.weights, level.name, level.kind
            )
            after = solved(IKProblem(levels, problem.bounds, problem.rows, problem.reference, problem.equalities))
            moved.append(difference(after.dtheta, before.dtheta))
    assert np.mean(np.array(moved) > ANOTHER) > OFTEN


def test_joint_units_that_the_metric_does_not_make_up_for_give_another_step():
    moved = []
    for seed in range(SAMPLE):
        problem, before = posed_and_solved("random hierarchies", seed)
        units = Units.random("joints", problem, seed)
        other = units.of(problem)
        after = solved(IKProblem(other.levels, other.bounds, other.rows, other.reference, other.equalities))
        moved.append(np.inf if after.dtheta is None else difference(physical(after.dtheta, units.joints), before.dtheta))
    assert max(moved) > ANOTHER


# The robots.


@pytest.mark.parametrize("name", ROBOTS)
def test_a_robots_steps_are_certified_and_many_end_on_limits(name):
    steps = [posed_and_solved(name, seed)[1] for seed in range(SAMPLE)]
    assert {step.status for step in steps} <= {StepStatus.CLOSED_FORM, StepStatus.SOLVED}
    assert np.mean([bool(step.tight_rows) for step in steps]) >= LIMITED


@pytest.mark.parametrize("name", ROBOTS)
def test_a_robot_has_one_structure_and_a_seed_one_step(name):
    first, again, other = robot_steps(name, 0), robot_steps(name, 0), robot_steps(name, 1)
    assert [level.name for level in first.levels] == [level.name for level in other.levels]
    for one, same, another in zip(first.levels[:-1], again.levels, other.levels, strict=False):
        assert one.matrix.shape == another.matrix.shape
        assert (one.matrix == same.matrix).all()
        assert (one.target == same.target).all()


@pytest.mark.parametrize("seed", range(SAMPLE))
def test_a_short_way_is_what_the_jacobians_say(seed, monkeypatch):
    monkeypatch.setattr(goals, "REACH", (-4.0, -4.0))
    scene = ROBOTS["humanoid"].scene(seed)
    way = np.empty(scene.model.nv)
    mujoco.mj_differentiatePos(scene.model, way, 1.0, scene.now.qpos, scene.wanted.qpos)
    for goal in (scene.position("left hand"), scene.orientation("right hand"), scene.centre_of_mass()):
        level = goal.level(scene)
        assert level.matrix @ way == pytest.approx(level.target, abs=1e-3 * np.linalg.norm(level.target))
