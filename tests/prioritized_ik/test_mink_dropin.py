"""The drop-in for mink: one import changed, the same answers; strict levels, names and errors beyond.

`PRIORITIZED_IK_CAMPAIGN=500 pytest tests/prioritized_ik/test_mink_dropin.py -k optimum` compares that many configurations a
model and scenario instead of a sample. Robots of dm_control are among them where its files are found; its code is not run.
"""

import copy
import importlib.util
import json
import os
import pickle
import subprocess
import sys
import warnings
from decimal import localcontext
from functools import cache, partial
from pathlib import Path

import mink
import mujoco
import numpy as np
import paths
import pytest
from click.testing import CliRunner

import paper_repro.artefacts.drop_in
from comparisons.drop_in import by_mink, reference
from comparisons.exact_qp import DIGITS, decimals, minimise
from comparisons.mink_scenes import DT, MACHINES, SCALAR, SCENARIOS, Machine, configured, posed, scene
from comparisons.robot_models import HUMANOID, compiled
from paper_repro.make.artefact import QUICK
from paper_repro.make.jobs import Results
from prioritized_ik import explain, get_method
from prioritized_ik import mink as drop_in
from prioritized_ik.cli import main
from prioritized_ik.errors import InfeasibleError, InputError, SolverUnavailableError, StepNotFoundError
from prioritized_ik.mink import InfeasibleIkError, OutsideLimitsError, build_problem, levels, solve_ik, step_ik
from prioritized_ik.solvers.step import StepStatus

CAMPAIGN = "PRIORITIZED_IK_CAMPAIGN"
SAMPLE = 25  # configurations of each robot and scenario unless told
SAME = 1e-6  # of the velocity
EXACT = 1e-8  # of the velocity: rounding times the square of 1e6, by which a damping of 1e-12 conditions it, is far above
DAMPING = (-6.0, -2.0)  # [decades] that mink's own solvers can resolve
ORACLE = "quadprog"  # knows only rounding, no tolerance
BINDING = 0.2  # of limited scenes end on a limit, at least

_wheel = importlib.util.find_spec("dm_control")
FOUND = Path(_wheel.submodule_search_locations[0]) if _wheel and _wheel.submodule_search_locations else None


def _of_wheel(path: str, *frames: tuple[str, str]) -> Machine:
    assert FOUND is not None
    return Machine(Path(path).stem, cache(partial(mujoco.MjModel.from_xml_path, str(FOUND / path))), frames)


WHEEL = (
    [
        _of_wheel("suite/humanoid.xml", ("left_hand", "body"), ("right_hand", "body"), ("head", "body")),
        _of_wheel("suite/dog.xml", ("foot_L", "body"), ("hand_R", "body"), ("head", "site"), ("tail_tip", "site")),
        _of_wheel("suite/quadruped.xml", ("toe_back_left", "body"), ("toe_front_right", "body")),
        _of_wheel("suite/humanoid_CMU.xml", ("rhand", "body"), ("lhand", "body"), ("lfoot", "body")),
        _of_wheel("third_party/kinova/jaco_arm.xml", ("wristsite", "site")),
        _of_wheel("locomotion/walkers/assets/rodent.xml", ("hand_R", "body"), ("toe_L", "body")),
    ]
    if FOUND
    else []
)
ROBOTS = {machine.name: machine for machine in (*MACHINES, *WHEEL)}


def sample() -> range:
    return range(int(os.environ.get(CAMPAIGN, SAMPLE)))


def machine(name: str) -> Machine:
    return ROBOTS[name]


def distance(found: np.ndarray, wanted: np.ndarray) -> float:
    return float(np.linalg.norm(found - wanted) / (np.linalg.norm(wanted) or 1.0))


def some_damping(seed: int) -> float:
    return float(10.0 ** np.random.default_rng(seed).uniform(*DAMPING))


def arm(q: tuple[float, ...] = (0.3, 0.5, 0.2, 1.2, 0.1, 0.6, 0.2)) -> mink.Configuration:
    return posed(machine("arm").load(), np.array(q))


def drawn(configuration: mink.Configuration, frame: str, move: tuple[float, float, float], **kwargs) -> mink.FrameTask:
    """A task of a site's pose, moved from where it is [m]."""
    costs = {"position_cost": 1.0, "orientation_cost": 0.5} | kwargs
    task = mink.FrameTask(frame, "site", **costs)
    here = configuration.get_transform_frame_to_world(frame, "site")
    task.set_target(mink.SE3.from_rotation_and_translation(here.rotation(), here.translation() + np.array(move)))
    return task


def posture(configuration: mink.Configuration, cost: float = 1e-2, q: np.ndarray | None = None) -> mink.PostureTask:
    task = mink.PostureTask(configuration.model, cost)
    task.set_target(configuration.q if q is None else q)
    return task


def speeds(model: mujoco.MjModel, speed: float) -> mink.VelocityLimit:
    joints = np.flatnonzero(np.isin(model.jnt_type, SCALAR))
    return mink.VelocityLimit(model, {model.joint(int(i)).name: speed for i in joints})


# One level: mink's own optimum.


def differences(name: str, scenario: str) -> tuple[dict[int, float], int]:
    """How far our answers are from mink's, by seed, and how many end on a limit."""
    found, tight = {}, 0
    for seed in sample():
        given = scene(machine(name), scenario, seed, posture=bool(seed % 2))
        theirs = by_mink(given, ORACLE, some_damping(seed))
        step = step_ik(given.configuration, given.tasks, DT, damping=some_damping(seed), limits=given.limits)
        tight += bool(step.tight_rows)
        found[seed] = distance(step.dtheta, theirs)
    return found, tight


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("name", ROBOTS)
def test_with_one_level_the_answer_is_the_optimum_of_minks_qp(name, scenario):
    found, tight = differences(name, scenario)
    assert max(found.values()) <= SAME, {seed: off for seed, off in found.items() if off > SAME}
    assert (tight >= BINDING * len(found)) if scenario == "limited" else not tight


@pytest.mark.parametrize("wrong", ["cost", "gain", "lm_damping"])
def test_a_task_taken_otherwise_gives_another_answer(wrong, monkeypatch):
    given = levels.objective

    def sabotaged(configuration, task):
        if isinstance(task, mink.FrameTask):
            task = copy.copy(task)
            setattr(task, wrong, getattr(task, wrong) * 0.99 + (wrong == "lm_damping") * 1e-3)
        return given(configuration, task)

    monkeypatch.setattr(levels, "objective", sabotaged)
    assert max(differences("arm", "free")[0].values()) > SAME


@pytest.mark.parametrize("solver", ["daqp", "proxqp", "quadprog", "osqp", "active-set"])
def test_the_answer_does_not_depend_on_the_solver(solver):
    for seed in range(4):
        given = scene(machine("arm"), "limited", seed)
        wanted = solve_ik(given.configuration, given.tasks, DT, limits=given.limits)
        assert distance(solve_ik(given.configuration, given.tasks, DT, solver, limits=given.limits), wanted) <= EXACT


def test_a_solver_that_was_got_once_serves_a_loop():
    given, solver = scene(machine("arm"), "limited", 3), get_method("active-set")
    one, again = (solve_ik(given.configuration, given.tasks, DT, solver, limits=given.limits) for _ in range(2))
    assert (one == again).all()


def test_positional_arguments_are_minks():
    given = scene(machine("arm"), "limited", 1)
    arguments = (given.configuration, given.tasks, DT, "quadprog", 1e-4, False, given.limits, None)
    assert distance(solve_ik(*arguments), mink.solve_ik(*arguments)) <= SAME


# Minks's default damping: the exact answer.


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("name", [machine.name for machine in MACHINES])
def test_at_the_default_damping_the_answer_is_that_of_sixty_digits(name, scenario):
    for seed in range(2):
        given = scene(machine(name), scenario, seed, posture=False)
        step = step_ik(given.configuration, given.tasks, DT, limits=given.limits)
        assert step.certificate.holds
        given = scene(machine(name), scenario, seed, posture=False)
        assert distance(step.dtheta, reference(given)) <= EXACT


@pytest.mark.skipif(not paths.COMPILED, reason="no compiled core")
def test_the_core_answers_the_default_damping_beside_active_limits():
    """Python is some twenty times slower there, which made the drop-in slower than mink."""
    answered, count, binding = 0, 0, 0
    for name in [machine.name for machine in MACHINES if machine.name != "winding arm"]:
        for seed in range(12):
            given = scene(machine(name), "limited", seed, posture=False)
            step = get_method("active-set").step(build_problem(given.configuration, given.tasks, DT, limits=given.limits))
            count += 1
            answered += step.path == "compiled" and step.certificate.holds
            binding += step.status is StepStatus.SOLVED
    assert answered >= 0.98 * count
    assert binding >= BINDING * count


def test_sixty_digits_meet_the_conditions_of_an_optimum_and_nothing_near_them_does():
    rng, n, r = np.random.default_rng(0), 6, 9
    for _ in range(20):
        root, linear, matrix = rng.normal(size=(n, n)), rng.normal(size=n), decimals(rng.normal(size=(r, n)))
        matrix[3] = matrix[1]  # rows that say the same
        hessian, linear, sides = (decimals(each) for each in (root @ root.T, linear, 0.1 * np.abs(rng.normal(size=r))))
        found = minimise(hessian, linear, matrix, sides)
        with localcontext(prec=DIGITS):
            assert np.abs(hessian @ found.x + linear + matrix.T @ found.multipliers).max() < 1e-40
            slack = sides - matrix @ found.x
            assert slack.min() > -1e-40
            assert found.multipliers.min() >= 0
            assert np.abs(slack * found.multipliers).max() < 1e-40
            other = found.x + decimals(1e-15 * rng.normal(size=n))
            assert np.abs(hessian @ other + linear + matrix.T @ found.multipliers).max() > 1e-17


def test_rows_that_no_x_keeps_have_no_optimum_in_sixty_digits():
    matrix, sides = decimals([[1.0, 0.0], [-1.0, 0.0]]), decimals([-1.0, -1.0])
    assert minimise(decimals(np.eye(2)), decimals(np.zeros(2)), matrix, sides) is None


def test_the_demonstration_shows_who_is_nearer_to_sixty_digits(tmp_path):
    file = tmp_path / "drop-in.json"
    told = CliRunner().invoke(main, ["demo", "drop-in", "--count", "1", "--json", str(file)])
    assert told.exit_code == 0, told.output
    rows = json.loads(file.read_text())["rows"]
    assert len(rows) == len(MACHINES) * len(SCENARIOS)
    for row in rows:
        assert row["machine"] in told.output
        assert row["ours"] <= EXACT
        assert row["nearer"] == row["apart"]
    assert max(max(row["mink"].values()) for row in rows) > 0.1


def test_the_table_of_the_readme_is_made_of_the_demonstrations_rows():
    scale = QUICK
    first, *others = paper_repro.artefacts.drop_in.jobs(scale)
    row = first()
    found = {first.key: row} | {job.key: row for job in others}
    table = paper_repro.artefacts.drop_in.build(scale, Results(found))
    assert len(table.rows) == len(MACHINES) * len(SCENARIOS)
    assert [column.key for column in table.columns][-3:] == ["ours", "nearer", "certified"]
    assert max(row[-3] for row in table.rows) <= EXACT


# What the problem is made of.


def test_the_problem_can_be_looked_at_and_its_rank_is_the_jacobians():
    configuration = arm()
    hand = drawn(configuration, "tool", (0.1, 0.0, 0.0), position_cost=1e-4, orientation_cost=0.0, lm_damping=0.5)
    problem = build_problem(configuration, [[hand], [posture(configuration)]], DT)
    assert [level.name for level in problem.levels] == ["FrameTask tool", "PostureTask"]
    assert problem.levels[0].matrix == pytest.approx(hand.compute_jacobian(configuration)[:3])
    assert problem.levels[0].weights == pytest.approx(1e-8)
    assert problem.levels[0].damping == pytest.approx(1e-12 + 0.5 * 1e-8 * 0.01, rel=1e-6)
    assert problem.bounds.names[0] == "base"


class OneCoordinate(mink.Task):
    """A user's own task: the first joint's place."""

    def __init__(self):
        super().__init__(cost=np.ones(1), gain=0.5)

    def compute_error(self, configuration):
        return configuration.q[:1] - 0.7

    def compute_jacobian(self, configuration):
        return np.eye(1, configuration.nv)


class OwnResidual(OneCoordinate):
    """The same with a residual that says more than error, Jacobian and cost."""

    def compute_qp_residual(self, configuration):
        weighted, error, mu = super().compute_qp_residual(configuration)
        return 3.0 * weighted, 3.0 * error, mu + 0.1


class OwnObjective(levels.BaseTask):
    """A quadratic objective of rank two."""

    def compute_qp_objective(self, configuration):
        rows = np.eye(2, configuration.nv)
        return mink.Objective(rows.T @ rows, rows.T @ np.array([0.1, -0.2]))


@pytest.mark.parametrize("own", [OneCoordinate, OwnResidual, OwnObjective])
def test_a_users_own_task_counts_as_in_mink(own):
    configuration = arm()
    tasks = [own(), posture(configuration, q=np.full(7, 0.2))]
    wanted = mink.solve_ik(configuration, tasks, DT, ORACLE, damping=1e-4)
    assert distance(solve_ik(configuration, tasks, DT, damping=1e-4), wanted) <= SAME


def test_the_energy_of_motion_counts_as_in_mink():
    configuration = arm()
    energy = mink.KineticEnergyRegularizationTask(1e-4)
    energy.set_dt(DT)
    tasks = [drawn(configuration, "tool", (0.1, 0.0, 0.0)), energy]
    wanted = mink.solve_ik(configuration, tasks, DT, ORACLE, damping=1e-4)
    assert distance(solve_ik(configuration, tasks, DT, damping=1e-4), wanted) <= SAME


class Hollow(levels.BaseTask):
    """An objective without a minimum."""

    def compute_qp_objective(self, configuration):
        return mink.Objective(np.zeros((configuration.nv,) * 2), np.ones(configuration.nv))


class Saddle(levels.BaseTask):
    def compute_qp_objective(self, configuration):
        return mink.Objective(-np.eye(configuration.nv), np.zeros(configuration.nv))


@pytest.mark.parametrize(("own", "message"), [(Hollow, "no minimum"), (Saddle, "positive semidefinite")])
def test_an_objective_without_minimum_is_refused(own, message):
    with pytest.raises(InputError, match=message):
        solve_ik(arm(), [own()], DT)


@pytest.mark.parametrize("tasks", [[], [[]], [[], []]])
def test_without_tasks_the_robot_rests(tasks):
    assert (solve_ik(arm(), tasks, DT) == 0.0).all()


def test_tasks_without_cost_or_without_rows_mean_nothing():
    configuration = arm()
    hand = drawn(configuration, "tool", (0.1, 0.0, 0.0))
    nothing = mink.FrameTask("tool", "site", 0.0, 0.0)
    nothing.set_target_from_configuration(arm((0.0,) * 7))
    wanted = solve_ik(configuration, [hand], DT)
    assert distance(solve_ik(configuration, [hand, nothing], DT), wanted) <= EXACT
    assert distance(solve_ik(configuration, [[nothing], [hand]], DT), wanted) <= EXACT


# Limits and constraints.


def test_frozen_joints_do_not_move_and_the_others_still_serve_the_task():
    configuration = arm()
    hand = drawn(configuration, "tool", (0.05, 0.0, 0.0), orientation_cost=0.0)
    frozen = mink.VelocityLimit(configuration.model, {"base": 0.0, "elbow": 0.0})
    by_limit = solve_ik(configuration, [hand], DT, limits=[frozen])
    freezing = mink.DofFreezingTask(configuration.model, [0, 3])
    by_constraint = solve_ik(configuration, [hand], DT, limits=[], constraints=[freezing])
    for velocity in (by_limit, by_constraint):
        assert (velocity[[0, 3]] == 0.0).all()
        assert hand.compute_jacobian(configuration)[:3] @ velocity * DT == pytest.approx(
            -hand.compute_error(configuration)[:3], abs=1e-9
        )
    assert distance(by_limit, by_constraint) <= EXACT


def test_limits_that_are_infinite_are_none():
    configuration = arm()
    tasks = [drawn(configuration, "tool", (0.05, 0.0, 0.0))]
    wanted = solve_ik(configuration, tasks, DT, limits=[])
    never = speeds(configuration.model, np.inf)
    assert distance(solve_ik(configuration, tasks, DT, limits=[never]), wanted) <= EXACT
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="wheel" range="-1e10 1e10" limited="true"/><geom size="0.1"/>'
        '<site name="rim" pos="0.1 0 0"/></body></worldbody></mujoco>'
    )
    wheel = mink.Configuration(model, np.array([0.4]))
    assert solve_ik(wheel, [posture(wheel, 1.0, np.array([0.9]))], 1.0, damping=0.0) == pytest.approx([0.5])


def test_a_limit_that_is_no_number_is_refused():
    class Broken(mink.Limit):
        def compute_qp_inequalities(self, configuration, dt):
            return mink.Constraint(np.eye(configuration.nv), np.full(configuration.nv, np.nan))

    with pytest.raises(InputError, match="Broken has rows that are not finite"):
        solve_ik(arm(), [], DT, limits=[Broken()])


@pytest.mark.parametrize("hashed", [True, False])
def test_a_limit_whose_matrix_changes_is_looked_at_anew(hashed):
    class Turning(mink.Limit):
        matrix = np.eye(1, 7)
        __hash__ = mink.Limit.__hash__ if hashed else None

        def compute_qp_inequalities(self, configuration, dt):
            return mink.Constraint(self.matrix, np.array([0.25]))

    limit, configuration = Turning(), arm()
    assert build_problem(configuration, [], DT, limits=[limit]).bounds.upper[0] == 0.25
    limit.matrix = -np.eye(1, 7, 2)
    assert build_problem(configuration, [], DT, limits=[limit]).bounds.lower[2] == -0.25
    limit.matrix = np.full((1, 7), np.inf)
    with pytest.raises(InputError, match="Turning has rows that are not finite"):
        build_problem(configuration, [], DT, limits=[limit])


def test_arrays_of_a_users_task_and_limit_stay_theirs():
    class Kept(OneCoordinate):
        jacobian = np.eye(1, 7)

        def compute_jacobian(self, configuration):
            return self.jacobian

    task = Kept()
    problem = build_problem(arm(), [task], DT)
    task.jacobian[0, 0] = 2.0
    assert problem.levels[0].matrix[0, 0] == 1.0


@pytest.mark.parametrize(("jacobian", "cost"), [(np.nan, 1.0), (1e200, 1.0), (1.0, np.inf)])
def test_a_task_that_is_no_number_is_refused_by_name(jacobian, cost):
    class Odd(OneCoordinate):
        def compute_jacobian(self, configuration):
            return jacobian * np.ones((1, 7))

    task = Odd()
    task.cost = np.array([cost])
    with pytest.raises(InputError, match="level 'Odd'"):
        build_problem(arm(), [task], DT)


def test_a_hand_is_kept_off_a_post_by_the_row_that_has_their_names():
    configuration = arm((0.5, 0.9, 0.0, 1.2, 0.0, 0.4, 0.0))
    model = configuration.model
    hand = mink.FrameTask("tool", "site", 1.0, 0.0)
    hand.set_target(mink.SE3.from_translation(model.geom("post").pos))
    collision = mink.CollisionAvoidanceLimit(model, [(["hand"], ["post"])], gain=DT, collision_detection_distance=0.2)
    touched = False
    for _ in range(60):
        step = step_ik(configuration, [hand], DT, limits=[collision, speeds(model, 1.0)])
        touched |= "CollisionAvoidanceLimit: post – hand" in step.tight_rows
        apart = mujoco.mj_geomDistance(
            model, configuration.data, model.geom("hand").id, model.geom("post").id, 1.0, np.zeros(6)
        )
        assert apart > 0.004
    assert touched


def test_a_turned_ball_joint_stops_at_its_limit():
    configuration = posed(machine("ball joints").load(), machine("ball joints").load().qpos0)
    model, end = configuration.model, configuration.q
    mujoco.mj_integratePos(model, end, np.array([1.5, 0, 0, 0, 0, 0, 0, 0, 0, 0]), 1.0)
    limits = [mink.ConfigurationLimit(model), mink.VelocityLimit(model, {"hip": np.full(3, 1.0)})]
    for _ in range(60):
        step = step_ik(configuration, [posture(configuration, 1.0, end)], DT, limits=limits)
    angle = 2.0 * np.arccos(abs(configuration.q[0]))
    assert angle == pytest.approx(np.deg2rad(60.0), abs=1e-3)
    assert any("hip" in name for name in step.tight_rows)


@pytest.mark.parametrize("hard", [True, False])
def test_a_closed_loop_stays_closed(hard):
    configuration = posed(machine("four-bar").load(), np.zeros(5))
    loop = mink.EqualityConstraintTask(configuration.model, 100.0)
    hand = drawn(configuration, "tool", (0.05, 0.02, 0.0), orientation_cost=0.0)
    levels_ = [[hand]] if hard else [[loop], [hand]]
    for _ in range(50):
        step_ik(configuration, levels_, DT, limits=[speeds(configuration.model, 1.0)], constraints=[loop] if hard else None)
        assert np.linalg.norm(loop.compute_error(configuration)) < 2e-3  # a step of 0.05 rad squared, in a link of 0.3 m
    assert np.linalg.norm(loop.compute_error(configuration)) < 1e-6
    assert np.linalg.norm(hand.compute_error(configuration)[:3]) < 0.02  # of the 0.054 m that it was away


def test_coupled_tendons_and_joints_stay_coupled_though_mink_leaves_tendons_out_of_date():
    configuration = mink.Configuration(machine("coupled hand").load())  # as mink makes it
    model = configuration.model
    coupling = mink.EqualityConstraintTask(model, 1.0)
    bent = posture(configuration, 1.0, np.where(np.arange(model.nq) % 4 == 1, 0.3, 0.5))
    for _ in range(20):
        step_ik(configuration, [bent], DT, constraints=[coupling])
    for finger in ("index", "ring"):
        outer, middle = (configuration.q[model.joint(f"{finger} {i}").qposadr[0]] for i in (3, 2))
        assert middle > 0.2
        assert outer == pytest.approx(0.8 * middle, abs=1e-6)


def test_constraints_that_contradict_each_other_are_named_and_caught_as_in_mink():
    configuration = arm()
    here, there = drawn(configuration, "tool", (0.0, 0.0, 0.0)), drawn(configuration, "tool", (0.01, 0.0, 0.0))
    with pytest.raises(mink.NoSolutionFound, match=r"FrameTask tool 1 row \d.*FrameTask tool 2 row \d") as caught:
        solve_ik(configuration, [], DT, constraints=[here, there])
    assert isinstance(caught.value, InfeasibleError)
    assert caught.value.conflict is not None


def test_limits_that_leave_no_room_are_named_by_limit_and_joint():
    configuration = arm((0.3, 0.5, 0.2, -0.5, 0.1, 0.6, 0.2))  # the elbow is half a radian outside its range
    limits = [mink.ConfigurationLimit(configuration.model), speeds(configuration.model, 1.0)]
    with pytest.raises(InfeasibleIkError, match="elbow") as caught:
        solve_ik(configuration, [], DT, limits=limits)
    assert "ConfigurationLimit: elbow lower" in str(caught.value)
    assert "VelocityLimit: elbow upper" in str(caught.value)
    with pytest.raises(mink.NoSolutionFound):
        mink.solve_ik(configuration, [], DT, ORACLE, damping=1e-6, limits=limits)


@pytest.mark.parametrize("what", ["limits", "constraints"])
def test_what_no_joint_moves_but_must_change_is_no_solution_and_is_named(what):
    class Wall(mink.Limit):
        def compute_qp_inequalities(self, configuration, dt):
            return mink.Constraint(np.zeros((1, configuration.nv)), np.array([-0.1]))

    class Far(OneCoordinate):
        def compute_jacobian(self, configuration):
            return np.zeros((1, configuration.nv))

    with pytest.raises(mink.NoSolutionFound, match=r"(Wall|Far) row 1 moves with no joint"):
        solve_ik(arm(), [], DT, **{what: [Wall() if what == "limits" else Far()]})


def test_outside_its_range_the_robot_is_drawn_back_or_stops_as_safety_break_says():
    configuration = arm((0.3, 0.5, 0.2, -0.01, 0.1, 0.6, 0.2))
    velocity = solve_ik(configuration, [posture(configuration)], DT)
    assert velocity[3] * DT >= 0.0095 - 1e-12
    with pytest.raises(mink.NotWithinConfigurationLimits, match=r"elbow.*safety_break=False") as caught:
        solve_ik(configuration, [], DT, safety_break=True)
    assert isinstance(caught.value, InputError)


def test_errors_survive_copies_and_pickles():
    step = object()
    for error in (InfeasibleIkError("a", None), drop_in.NoStepFoundError("b", None), OutsideLimitsError("c")):
        for same in (copy.copy(error), pickle.loads(pickle.dumps(error))):
            assert (type(same), str(same)) == (type(error), str(error))
    assert drop_in.NoStepFoundError("b", step).step is step
    assert issubclass(InfeasibleIkError, StepNotFoundError)


# Strict levels.


def test_nested_lists_and_priorities_say_the_same():
    configuration = arm()
    hand, rest = drawn(configuration, "tool", (0.2, 0.1, 0.0)), posture(configuration, 1.0)
    wanted = solve_ik(configuration, [[hand], [rest]], DT)
    for tasks, priority in (
        ([[hand], rest], None),
        ([rest, hand], {hand: 1, rest: 2}),
        ([hand, rest], {hand: -5, rest: 7}),
    ):
        assert (solve_ik(configuration, tasks, DT, priority=priority) == wanted).all()
    assert distance(solve_ik(configuration, [[rest], [hand]], DT), wanted) > SAME
    assert distance(solve_ik(configuration, [hand, rest], DT), wanted) > SAME


def test_an_upper_level_is_met_whatever_those_below_want_and_explain_says_what_gave_way():
    configuration = arm()
    hand = drawn(configuration, "tool", (0.02, 0.01, 0.0))
    rest = posture(configuration, 100.0, np.array([-1.0, 0.0, 1.0, 0.3, 1.0, -0.5, 0.0]))
    problem = build_problem(configuration, [[hand], [rest]], DT, limits=[])
    step = step_ik(configuration, [[hand], [rest]], DT, limits=[])
    assert step.status is StepStatus.CLOSED_FORM
    assert np.sqrt(step.costs[0]) < 1e-9
    assert any("FrameTask tool" in str(line) for line in explain(problem, step))


def test_a_level_that_strains_makes_those_below_careful_and_never_those_above():
    configuration = arm()
    near = drawn(configuration, "tool", (0.01, 0.0, 0.0), orientation_cost=0.0)
    far = drawn(configuration, "tool", (5.0, 0.0, 0.0), position_cost=0.1, lm_damping=1.0)
    problem = build_problem(configuration, [[near], [far], [posture(configuration)]], DT)
    first, second, third = (level.damping for level in problem.levels)
    assert first == 0.0  # mink's default damping only makes the answer unique, which is the last level's part
    assert second > 0.1
    assert third >= second
    damped = build_problem(configuration, [[near], [posture(configuration)]], DT, damping=1e-3)
    assert [level.damping for level in damped.levels] == [1e-3, 1e-3]


@pytest.mark.parametrize(("name", "seed"), [("mobile arm", 0), ("mobile arm", 2), ("ball joints", 1), ("winding arm", 2)])
def test_a_robot_that_has_come_to_rest_at_its_stops_still_gets_its_steps(name, seed):
    given = scene(machine(name), "limited", seed)
    for _ in range(40):
        step = step_ik(given.configuration, [[task] for task in given.tasks], DT, limits=given.limits)
        assert step.violation <= 1e-6


def standing() -> tuple[mink.Configuration, list[mink.FrameTask], mink.ComTask, list[mink.FrameTask], mink.PostureTask]:
    model = machine("biped").load()
    q = model.qpos0.copy()
    bent = {"hip pitch": -0.4, "knee": 0.8, "ankle pitch": -0.4, "shoulder pitch": -0.3, "elbow": -0.8}
    for side in ("left", "right"):
        for joint, angle in bent.items():
            q[model.joint(f"{side} {joint}").qposadr[0]] = angle
    configuration = posed(model, q)
    sides = ("left", "right")
    feet = [drawn(configuration, f"{side} foot", (0, 0, 0), position_cost=10.0, orientation_cost=10.0) for side in sides]
    mass = mink.ComTask(10.0)
    mass.set_target_from_configuration(configuration)
    hands = [
        drawn(configuration, f"{side} hand", (0, 0, 0), position_cost=4.0, orientation_cost=0.0, gain=0.2, lm_damping=100.0)
        for side in sides
    ]
    return configuration, feet, mass, hands, posture(configuration, 0.1)


@pytest.mark.parametrize("forward", [0.05, 0.8])
def test_a_humanoid_keeps_its_feet_and_its_balance_with_hands_in_reach_and_far_out_of_it(forward):
    configuration, feet, mass, hands, rest = standing()
    dt, velocities, off, weighted_off = 0.01, [], [], []
    for hand in hands:
        place = hand.transform_target_to_world.translation()
        hand.set_target(mink.SE3.from_translation(place + np.array([forward, 0.0, 0.02])))
    limits = [mink.ConfigurationLimit(configuration.model), speeds(configuration.model, 2.0)]
    weighted = copy.deepcopy(configuration)
    for _ in range(220):
        velocities.append(step_ik(configuration, [feet, [mass], hands, [rest]], dt, limits=limits).dtheta / dt)
        velocity = mink.solve_ik(weighted, [*feet, mass, *hands, rest], dt, "daqp", limits=limits)
        weighted.integrate_inplace(velocity, dt)
        for found, where in ((off, configuration), (weighted_off, weighted)):
            found.append(max(np.linalg.norm(task.compute_error(where)[:3]) for task in (*feet, mass)))
    assert max(off) < 1e-4
    assert np.abs(np.diff(velocities[-50:], axis=0)).max() / dt < 1.0
    assert max(weighted_off) > 1e-3  # mink, with the same costs as weights
    if forward < 0.1:
        assert max(np.linalg.norm(hand.compute_error(configuration)[:3]) for hand in hands) < 1e-3


def test_an_arm_drawn_out_of_reach_is_calm_and_comes_back():
    configuration = arm()
    hand = drawn(configuration, "tool", (0, 0, 0), orientation_cost=0.0, lm_damping=1.0)
    turn = drawn(configuration, "tool", (0, 0, 0), position_cost=0.0, lm_damping=1.0)
    home, dt, velocities = hand.transform_target_to_world, 0.01, []
    limits = [mink.ConfigurationLimit(configuration.model), speeds(configuration.model, 2.0)]
    rest = posture(configuration, 0.1)
    for step in range(400):
        away = np.array([1.0, 0.3, 0.2]) if step < 250 else np.zeros(3)
        hand.set_target(mink.SE3.from_rotation_and_translation(home.rotation(), home.translation() + away))
        velocities.append(step_ik(configuration, [[hand], [turn], [rest]], dt, limits=limits).dtheta / dt)
    accelerations = np.abs(np.diff(velocities, axis=0)).max(axis=1) / dt
    assert accelerations[200:248].max() < 1.0
    assert np.linalg.norm(hand.compute_error(configuration)[:3]) < 1e-3
    assert accelerations[-20:].max() < 1.0


# What mink's own tasks and programs do, with the drop-in.


def test_a_frame_converges_to_its_target_and_stays():
    configuration = arm()
    hand = drawn(configuration, "tool", (0.1, -0.1, 0.05))
    for _ in range(40):
        step_ik(configuration, [hand], DT, limits=[mink.ConfigurationLimit(configuration.model)])
    assert np.linalg.norm(hand.compute_error(configuration)) < 1e-6
    assert np.linalg.norm(solve_ik(configuration, [hand], DT)) < 1e-6


@pytest.mark.parametrize("kind", ["look at", "align"])
def test_an_axis_is_pointed_and_the_turn_about_it_stays_free(kind):
    configuration = arm()
    if kind == "look at":
        task, target = mink.LookAtTask("tool", "site", (0.0, 0.0, 1.0)), np.array([0.8, -0.3, 0.2])
    else:
        task, target = mink.AxisAlignTask("tool", "site", (0.0, 0.0, 1.0)), np.array([0.2, 0.1, -1.0])
    task.set_target(target)
    spun = configuration.q + np.array([0, 0, 0, 0, 0, 0, 1.0])
    for _ in range(60):
        step_ik(configuration, [[task], [posture(configuration, 1.0, spun)]], DT, limits=[speeds(configuration.model, 2.0)])
    pose = configuration.get_transform_frame_to_world("tool", "site")
    axis = pose.rotation().as_matrix()[:, 2]
    wanted = target - pose.translation() if kind == "look at" else target
    assert axis @ wanted / np.linalg.norm(wanted) == pytest.approx(1.0, abs=1e-9)
    assert np.linalg.norm(task.compute_error(configuration)) < 1e-6


@pytest.mark.parametrize("task", [mink.LookAtTask, mink.AxisAlignTask])
def test_a_task_of_rank_two_has_two_rows_and_minks_objective(task):
    configuration = arm()
    pointing = task("tool", "site", (0.0, 0.0, 1.0), cost=0.7, gain=0.6)
    pointing.set_target(np.array([0.8, -0.3, 0.2]))
    found = levels.objective(configuration, pointing)
    assert found.matrix.shape == (2, 7)
    rows = np.sqrt(found.weights)[:, None] * found.matrix
    hessian, linear = pointing.compute_qp_objective(configuration)
    assert rows.T @ rows == pytest.approx(hessian, abs=1e-14)
    assert -rows.T @ (np.sqrt(found.weights) * found.target) == pytest.approx(linear, abs=1e-14)


@pytest.mark.parametrize("task", [mink.LookAtTask, mink.AxisAlignTask])
def test_a_direction_can_be_a_constraint_of_two_rows_however_far_off_it_points(task):
    configuration = arm()
    pointing = task("tool", "site", (0.0, 0.0, 1.0), cost=1.0)
    pointing.set_target(np.array([0.8, -0.3, 0.2]))
    assert np.linalg.norm(pointing.compute_error(configuration)) > 0.5
    step = step_ik(configuration, [posture(configuration, 1.0)], DT, limits=[], constraints=[pointing])
    problem = build_problem(arm(), [posture(configuration, 1.0)], dt=DT, limits=[], constraints=[pointing])
    assert len(problem.equalities.target) == 2
    assert step.certificate.holds


def test_hands_keep_a_pose_relative_to_each_other_while_one_is_moved():
    configuration, feet, mass, hands, rest = standing()
    together = mink.RelativeFrameTask("left hand", "site", "right hand", "site", 1.0, 0.0)
    together.set_target_from_configuration(configuration)
    lead = hands[0]
    place = lead.transform_target_to_world.translation()
    lead.set_target(mink.SE3.from_translation(place + np.array([0.03, 0.02, 0.05])))
    for _ in range(60):
        step_ik(configuration, [[*feet, mass], [together], [lead], [rest]], DT, limits=[speeds(configuration.model, 1.0)])
    assert np.linalg.norm(together.compute_error(configuration)[:3]) < 1e-4
    assert np.linalg.norm(lead.compute_error(configuration)[:3]) < 1e-3


def test_a_mobile_arm_spares_its_base_until_the_arm_alone_does_not_reach():
    configuration = posed(machine("mobile arm").load(), np.array([0, 0, 0, 0.2, 0.4, 0.8, 0.1, 0.3]))
    model = configuration.model
    still = mink.DampingTask(model, np.where(np.arange(model.nv) < 3, 1.0, 0.0))
    near = drawn(configuration, "tool", (0.02, 0.0, 0.03), orientation_cost=0.0)
    velocity = solve_ik(configuration, [[near], [still]], DT)
    assert np.abs(velocity[:3]).max() < 1e-6
    far = drawn(configuration, "tool", (1.5, 0.3, 0.0), orientation_cost=0.0)
    calm = mink.DampingTask(
        model, np.where(np.arange(model.nv) < 3, 1.0, 0.1)
    )  # an arm at the edge of its reach must not sweep
    for _ in range(80):
        step_ik(configuration, [[far], [calm]], DT, limits=[speeds(model, 1.0), mink.ConfigurationLimit(model)])
    assert np.linalg.norm(far.compute_error(configuration)[:3]) < 1e-6
    assert configuration.q[0] > 0.5


def test_a_floating_humanoid_of_another_make_follows_a_moving_hand():
    model = compiled(HUMANOID)
    configuration = mink.Configuration(model, configured(model, np.random.default_rng(3), 0.0))
    hand, eyes = (drawn(configuration, site, (0, 0, 0), orientation_cost=0.0) for site in ("right hand", "eyes"))
    base = mink.FreeJointVelocityLimit(model, max_linear_velocity=0.5, max_angular_velocity=0.5)
    centre = hand.transform_target_to_world.translation()
    for step in range(60):
        moved = centre + 0.02 * np.array([np.sin(0.1 * step), np.cos(0.1 * step) - 1.0, 0.0])
        hand.set_target(mink.SE3.from_translation(moved))
        limits = [mink.ConfigurationLimit(model), base]
        assert step_ik(configuration, [[hand], [eyes], [posture(configuration)]], DT, limits=limits).found
        assert np.linalg.norm(hand.compute_error(configuration)[:3]) < 1e-3


# Bad input.


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"dt": 0.0}, "dt"),
        ({"damping": -1.0}, "damping"),
        ({"below": "above"}, "below"),
        ({"tasks": ["hand"]}, "expected mink's tasks"),
        ({"limits": ["range"]}, "expected mink's limits"),
        ({"constraints": ["weld"]}, "constraints holds 'weld'"),
        ({"configuration": np.zeros(7)}, r"expected a mink\.Configuration"),
        ({"priority": [1]}, "expected a mapping"),
    ],
)
def test_a_wrong_argument_is_named(arguments, message):
    call = {"configuration": arm(), "tasks": [posture(arm())], "dt": DT} | arguments
    with pytest.raises(InputError, match=message):
        solve_ik(**call)


def test_priorities_are_one_a_task_and_only_where_tasks_are_not_nested():
    configuration = arm()
    hand, rest = drawn(configuration, "tool", (0, 0, 0)), posture(configuration)
    with pytest.raises(InputError, match="no number for PostureTask"):
        solve_ik(configuration, [hand, rest], DT, priority={hand: 1})
    with pytest.raises(InputError, match="none of the tasks"):
        solve_ik(configuration, [hand], DT, priority={hand: 1, rest: 2})
    with pytest.raises(InputError, match="nested"):
        solve_ik(configuration, [[hand], [rest]], DT, priority={hand: 1, rest: 2})


@pytest.mark.parametrize("what", ["tasks", "limits", "constraints"])
def test_tasks_and_limits_of_another_model_are_refused(what):
    other = posed(machine("gantry").load(), np.zeros(5))
    strange = speeds(other.model, 1.0) if what == "limits" else mink.DofFreezingTask(other.model, [0])
    with pytest.raises(InputError, match="another model"):
        solve_ik(arm(), **{"tasks": [], what: [strange]}, dt=DT)


def test_what_mink_says_of_its_tasks_comes_through():
    with pytest.raises(mink.TargetNotSet):
        solve_ik(arm(), [mink.FrameTask("tool", "site", 1.0, 1.0)], DT)


def test_an_unknown_solver_is_told_with_those_that_there_are():
    with pytest.raises(SolverUnavailableError, match="dapq"):
        solve_ik(arm(), [posture(arm())], DT, "dapq")


def test_options_of_a_qp_solver_are_named_in_one_warning_and_of_no_effect():
    given = scene(machine("arm"), "limited", 2)
    wanted = solve_ik(given.configuration, given.tasks, DT, "daqp", limits=given.limits)
    with pytest.warns(UserWarning, match=r"eps_abs=0\.1, max_iter=3") as caught:
        found = solve_ik(given.configuration, given.tasks, DT, "daqp", limits=given.limits, eps_abs=0.1, max_iter=3)
    assert len(caught) == 1
    assert caught[0].filename == __file__
    assert (found == wanted).all()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        solve_ik(given.configuration, given.tasks, DT, "daqp", limits=given.limits, verbose=False, initvals=None)


def test_an_error_leaves_the_configuration_where_it_was():
    configuration = arm()
    here, there = drawn(configuration, "tool", (0.0, 0.0, 0.0)), drawn(configuration, "tool", (0.01, 0.0, 0.0))
    before = configuration.q
    with pytest.raises(mink.NoSolutionFound):
        step_ik(configuration, [], DT, constraints=[here, there])
    assert (configuration.q == before).all()


def test_without_mink_one_message_says_which_extra_to_install():
    check = (
        "import sys; sys.modules['mink'] = None\n"
        "import prioritized_ik\n"
        "try:\n    import prioritized_ik.mink\n"
        "except ImportError as error:\n    print(isinstance(error, prioritized_ik.PrioritizedIkError), error)"
    )
    told = subprocess.run([sys.executable, "-c", check], check=True, capture_output=True, text=True).stdout
    assert told.startswith("True")
    assert "pip install 'prioritized-ik[mink]'" in told


def test_importing_the_package_does_not_import_mink():
    check = "import sys, prioritized_ik; prioritized_ik.solve; sys.exit('mink' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", check], check=False).returncode == 0
