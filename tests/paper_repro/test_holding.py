"""Hold and lift: the carriage, the marks, the three controls, and the hierarchy of torques."""

import json
from dataclasses import asdict, replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from paper_repro.artefacts.figure_holding import build as draw
from paper_repro.artefacts.table_14_holding import build, jobs
from paper_repro.make.artefact import FULL, QUICK
from paper_repro.make.jobs import Job, Results
from paper_repro.measure import hold_trials, holding
from paper_repro.measure.hold_trials import CONTROLS, FRICTIONS, HIERARCHY, tried
from paper_repro.measure.holding import (
    AMPLITUDE,
    FREQUENCY,
    FRICTION,
    GRIP,
    HEIGHT,
    LIFT,
    MASS,
    SWELL,
    TORQUE_LIMIT,
    JointSpaceHold,
    Scene,
    TaskSpaceHold,
    Trial,
    acceleration,
    hold,
)
from paper_repro.measure.torque_hierarchy import COUNTED, LEAST, MOST, Dynamics
from prioritized_ik.solvers.solve import solve
from prioritized_ik.solvers.step import StepStatus

FRONT = Trial("cylinder", "front")


def test_the_carriage_rises_by_its_height_and_then_shakes_by_its_amplitude() -> None:
    dt = 1e-4
    times = np.arange(0.0, GRIP + LIFT + 4.0, dt)
    velocity = np.cumsum([acceleration(time) for time in times]) * dt
    height = np.cumsum(velocity) * dt
    lifted, shaken = height[round((GRIP + LIFT) / dt)], velocity[times > GRIP + LIFT + SWELL]
    assert height[round(GRIP / dt)] == 0.0
    assert lifted == pytest.approx(HEIGHT, abs=1e-4)
    speed = 2.0 * np.pi * FREQUENCY * AMPLITUDE  # peak of a sine of that frequency and amplitude
    assert 0.5 * np.ptp(shaken) == pytest.approx(speed, rel=1e-3)


def test_slip_is_how_far_the_object_has_come_away_from_the_links() -> None:
    scene = Scene(FRONT)
    assert scene.slip() == pytest.approx(0.0, abs=1e-12)
    scene.data.qpos[scene.joints : scene.joints + 3] += [0.0, 0.0, -0.01]
    mujoco.mj_forward(scene.model, scene.data)
    assert scene.slip() == pytest.approx(0.01)


def test_roll_is_the_turn_of_a_link_about_itself() -> None:
    scene = Scene(FRONT)
    scene.data.qpos[scene.model.joint("joint_16x").qposadr] += 0.3
    mujoco.mj_forward(scene.model, scene.data)
    assert scene.roll() == pytest.approx(0.3)


def test_what_virtual_end_points_do_not_feel_is_links_rolling_about_themselves() -> None:
    """Why the second approach lets objects sink along an upright axis, whatever the friction."""
    scene = Scene(FRONT)
    model, data, m = scene.model, scene.data, scene.joints
    _, values, directions = np.linalg.svd(scene.jacobian())
    unfelt = directions[np.count_nonzero(values > 1e-6) :]
    assert len(unfelt) >= 15
    turning, rolls = np.empty((3, model.nv)), []
    for body in scene.sensor.bodies:
        mujoco.mj_jacBody(model, data, None, turning, body)
        axis = data.xmat[body].reshape(3, 3)[:, 0]
        spins = turning[:, :m] @ unfelt.T  # (3, d)
        assert np.abs(np.cross(axis, spins, axisb=0)).max() < 1e-6
        rolls.append(float(np.abs(spins).max()))
    assert max(rolls) > 0.1


def test_nothing_is_held_without_torque_or_without_friction(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sabotage: it is the control that holds, and along an upright axis it is friction."""
    monkeypatch.setattr(holding, "SHAKE", 0.5)
    scene = Scene(FRONT)
    assert not hold(FRONT, scene, lambda grip: np.zeros(scene.joints)).held
    smooth = replace(FRONT, friction=0.01)
    for control in CONTROLS:
        assert not tried(smooth, control).held


def test_the_hierarchy_holds_gently(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(holding, "SHAKE", 1.0)
    gentle, springs = tried(FRONT, HIERARCHY), tried(FRONT, CONTROLS[1])
    assert gentle.held
    assert gentle.contact_force < MOST
    assert gentle.uncertified <= 0.01 * gentle.steps
    assert gentle.work < springs.work


@pytest.mark.parametrize("control", CONTROLS)
def test_a_trial_ends_the_same_to_the_last_bit_each_time(control: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(holding, "SHAKE", 0.5)
    first, again = (asdict(tried(FRONT, control)) for _ in range(2))
    assert json.dumps(first) == json.dumps(again)


def moving(trial: Trial = FRONT) -> Scene:
    """The arm at its object, in motion."""
    scene = Scene(trial)
    scene.data.qvel[: scene.joints] = 0.05 * np.random.default_rng(4).normal(size=scene.joints)
    mujoco.mj_forward(scene.model, scene.data)
    return scene


def test_torques_of_the_hierarchy_give_its_accelerations_and_forces() -> None:
    """Against MuJoCo's forward dynamics, contacts switched off and the forces put in their place."""
    scene = moving()
    dynamics = Dynamics(scene)
    rng = np.random.default_rng(5)
    unknowns = rng.normal(size=scene.joints + 3 * len(scene.wound))
    model, data, touch = scene.model, scene.data, scene.touch()
    tau = dynamics.torques(unknowns)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    data.qfrc_applied[: scene.joints] = tau
    forces = unknowns[scene.joints :].reshape(-1, 3)
    for link, force in zip(scene.wound, forces, strict=True):
        body = scene.sensor.bodies[link]
        mujoco.mj_applyFT(model, data, -force, np.zeros(3), touch.point[link], body, data.qfrc_applied)
    mujoco.mj_forward(model, data)
    assert data.qacc[: scene.joints] == pytest.approx(unknowns[: scene.joints], abs=1e-6)


def test_contact_force_limits_come_first_then_the_weight_then_the_posture() -> None:
    scene = moving()
    problem = Dynamics(scene).problem(1.0, TORQUE_LIMIT, COUNTED * FRICTION)
    step = solve(problem)
    assert step.status is StepStatus.SOLVED
    forces = step.dtheta[scene.joints :].reshape(-1, 3)
    normal = scene.touch().normal[scene.wound]
    pressing = -np.einsum("ci,ci->c", forces, normal)
    sideways = np.linalg.norm(forces + pressing[:, None] * normal, axis=1)
    assert pressing.min() >= LEAST - 1e-9
    assert pressing.max() <= MOST + 1e-9
    assert (sideways <= np.sqrt(2.0) * COUNTED * FRICTION * pressing + 1e-9).all()  # a pyramid, not a cone
    assert forces.sum(axis=0) == pytest.approx([0.0, 0.0, MASS * 9.81], abs=1e-9)
    assert [level.name for level in problem.levels] == ["weight of the object", "ends of links", "posture"]


def test_where_torques_do_not_suffice_the_hold_gives_way_and_no_limit() -> None:
    scene = moving()
    weak = 0.05
    dynamics = Dynamics(scene)
    problem = dynamics.problem(1.0, weak, COUNTED * FRICTION)
    step = solve(problem)
    assert step.certificate.holds
    assert np.abs(dynamics.torques(step.dtheta)).max() <= weak + 1e-9
    assert problem.violation(step.dtheta) < 1e-9
    weight, ends, _ = step.costs
    assert weight == pytest.approx(0.0, abs=1e-12)
    assert ends > 2.0 * solve(Dynamics(scene).problem(1.0, TORQUE_LIMIT, COUNTED * FRICTION)).costs[1]


def test_the_second_approach_presses_and_the_first_asks_for_displacements() -> None:
    scene = Scene(FRONT)
    assert TaskSpaceHold(scene)(0.0) == pytest.approx(0.0, abs=1e-9)
    assert JointSpaceHold(scene)(0.0) == pytest.approx(0.0, abs=1e-9)
    pressed = scene.jacobian().T @ _inward(scene).ravel()
    assert TaskSpaceHold(scene)(1.0) == pytest.approx(holding.PRESS * pressed)
    asked = JointSpaceHold(scene)(1.0) / holding.JOINT_STIFFNESS
    moved = (scene.jacobian() @ asked).reshape(-1, 3)
    assert np.sum(moved * _inward(scene)) > 0.0


def _inward(scene: Scene) -> np.ndarray:
    inward = np.zeros((17, 3))
    inward[scene.wound] = -scene.touch().normal[scene.wound]
    return inward


@pytest.mark.parametrize("edge", [0.01, 0.07, 0.25, 0.45, 0.6, 2.0])
def test_the_bracket_is_where_holding_begins(edge: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hold_trials, "tried", lambda trial, control: SimpleNamespace(held=trial.friction >= edge))
    low, high = hold_trials._bracket(FRONT, HIERARCHY, "friction", FRICTIONS, edge <= FRICTION)
    assert low == max((value for value in FRICTIONS if value < edge), default=None)
    assert high == min((value for value in FRICTIONS if value >= edge), default=None)


class Answers(Results):
    """The same answer to every job: held weightless, not under gravity."""

    def __init__(self) -> None:
        super().__init__({})

    def __getitem__(self, job: Job) -> dict:
        figures = {
            "held": False, "seconds": 3.0, "slip": 0.06, "slip_shaken": 0.05, "roll": 1.0, "torque": 5.0,
            "contact_force": 8.0, "squeeze": 40.0, "work": 20.0, "course": [[0.0, 0.0], [3.0, 0.06]],
            "uncertified": 1, "steps": 100,
        }  # fmt: skip
        return {
            **figures,
            "weightless": {**figures, "held": True, "slip": 0.001},
            "friction": [0.5, None],
            "torque_limit": [None, 1.0],
            "ends": np.zeros((17, 3)).tolist(),
        }


def test_the_table_has_a_row_a_control_and_says_what_was_sought() -> None:
    table = build(FULL, Answers())
    keys = [column.key for column in table.columns]
    rows = [dict(zip(keys, row, strict=True)) for row in table.rows]
    assert len(rows) == len(jobs(FULL)) == 3 * 4 * 3
    assert {row["friction"] for row in rows} == {"0.5 / none"}
    assert {row["torque_limit"] for row in rows} == {"none / 1"}
    assert all(row["held_weightless"] and not row["held"] and row["seconds"] == 3.0 for row in rows)
    assert f"{HIERARCHY} 0 (weightless 12)" in table.notes
    assert len(jobs(QUICK)) == 3


def test_the_figure_shows_every_object_and_what_it_is_measured_in() -> None:
    figure = draw(FULL, Answers())
    assert [axes.get_title() for axes in figure.axes[:3]] == list(holding.OBJECTS)
    assert {axes.get_ylabel() for axes in figure.axes[3::3]} == {"slip [mm]"}
