"""Winding by joint torques: forces at the end points and the joints, and how windings by them end."""

from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest

from paper_repro.artefacts.table_13_torques import ROWS, SIDES, build, group, jobs
from paper_repro.make.artefact import FULL, QUICK
from paper_repro.make.jobs import Job, Results
from paper_repro.measure import torques
from paper_repro.measure.torques import (
    APPROACHES,
    RELAXATION,
    STIFFNESS,
    STRETCH,
    JointSpaceControl,
    TaskSpaceControl,
    TorqueWinding,
    dynamic_model,
    wind_by_torques,
    wound,
)
from paper_repro.measure.windings import settings
from prioritized_ik.weights import winding_weights
from prioritized_ik.winding.controller import Equilibrium, Situation, WindingController

TASK = "task space (second approach)"
JOINT = "joint space (first approach)"
CHOSEN = settings("closed form", link=15, speed=torques.SPEED)


@cache
def winding(approach: str) -> TorqueWinding:
    return wind_by_torques(approach, link=15, direction="front")


@pytest.mark.parametrize("approach", APPROACHES)
def test_both_approaches_wind_by_torques(approach: str) -> None:
    found = winding(approach)
    assert found.equilibrium is Equilibrium.WINDING
    assert found.turns_ratio > 0.95
    assert found.penetration < 2e-3
    assert 0.0 < found.torque < 1.0
    assert found.work > 0.0


def test_without_torque_nothing_winds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sabotage: it is the control that winds the arm."""
    monkeypatch.setitem(APPROACHES, TASK, lambda controller: lambda situation, data: np.zeros(len(data.qvel)))
    monkeypatch.setattr(torques, "LONGEST", 0.2)
    found = wind_by_torques(TASK, link=15)
    assert found.equilibrium is None
    assert found.torque == found.work == 0.0


def state() -> tuple[WindingController, Situation, mujoco.MjData]:
    """The controller, what it feels at a bent pose, and the arm in motion there."""
    controller = WindingController(CHOSEN)
    data = mujoco.MjData(dynamic_model(CHOSEN))
    rng = np.random.default_rng(7)
    data.qpos[:] = rng.normal(scale=0.05, size=len(data.qpos))
    data.qvel[:] = rng.normal(size=len(data.qvel))
    situation = controller.observe(data.qpos.copy(), np.zeros(17, dtype=bool))
    return controller, replace(situation, last=15), data


def test_torques_of_the_second_approach_do_the_virtual_work_of_its_end_point_forces() -> None:
    """Against finite differences: τ·δθ is the work of springs and dampers, one a virtual end point."""
    controller, situation, data = state()
    desired = np.random.default_rng(8).normal(scale=1e-3, size=(17, 3))
    tau = TaskSpaceControl(controller)(replace(situation, desired=desired), data)
    small, q = 1e-6, data.qpos.copy()

    def ends(at: np.ndarray) -> np.ndarray:
        return controller.observe(at, np.zeros(17, dtype=bool)).positions

    velocity = (ends(q + small * data.qvel) - ends(q - small * data.qvel)) / (2.0 * small)
    stiffness = STIFFNESS * winding_weights(15, 17, "eq23")[:, None]
    force = stiffness * (desired - RELAXATION * velocity)
    for seed in range(3):
        turn = np.random.default_rng(seed).normal(size=len(q))
        moved = (ends(q + small * turn) - ends(q - small * turn)) / (2.0 * small)
        assert tau @ turn == pytest.approx(np.sum(force * moved), rel=1e-6)


def test_a_spring_draws_no_harder_than_at_its_longest() -> None:
    controller, situation, data = state()
    data.qvel[:] = 0.0
    push = np.zeros((17, 3))
    push[16, 1] = STRETCH
    longest, longer = (TaskSpaceControl(controller)(replace(situation, desired=s * push), data) for s in (1.0, 5.0))
    assert np.abs(longest).max() > 0.0
    assert longer == pytest.approx(longest)


def test_wound_links_are_held_where_they_were_and_others_where_they_are() -> None:
    controller, situation, data = state()
    data.qvel[:] = 0.0
    control = TaskSpaceControl(controller)
    still = replace(situation, desired=np.zeros((17, 3)))
    assert np.abs(control(still, data)).max() == 0.0
    moved = replace(still, positions=situation.positions + 1e-3)
    assert np.abs(control(moved, data)).max() > 0.0  # k the same: all are drawn back
    freed = control(replace(moved, last=0), data)
    assert np.abs(freed).max() == 0.0  # no link is wound any more: all are held where they are


def test_the_first_approach_is_a_spring_and_a_damper_at_the_joints() -> None:
    controller, situation, data = state()
    situation = replace(situation, desired=np.zeros((17, 3)))
    tau = JointSpaceControl(controller)(situation, data)
    expected = -torques.JOINT_STIFFNESS * data.qpos - torques.DERIVATIVE * data.qvel
    assert tau == pytest.approx(expected)


def test_the_arm_touches_the_object_and_never_itself() -> None:
    model = dynamic_model(CHOSEN)
    data = mujoco.MjData(model)
    data.qpos[:] = np.random.default_rng(3).uniform(-1.0, 1.0, model.nq)  # folded into itself
    mujoco.mj_forward(model, data)
    thing = model.geom("object").id
    assert all(thing in (contact.geom1, contact.geom2) for contact in data.contact)
    assert model.opt.gravity.tolist() == [0.0, 0.0, 0.0]


class Answers(Results):
    """The same answer to every job."""

    def __init__(self) -> None:
        super().__init__({})

    def __getitem__(self, job: Job) -> dict:
        kinematic = {"outcome": "WOUND", "turns_ratio": 0.98, "penetration": 0.0, "bend": 1.0}
        return (
            {**kinematic, "seconds": 5.0, "torque": 0.1, "contact_force": 0.2, "work": 0.3}
            if job.function is wound
            else kinematic
        )


def test_the_table_has_forces_of_dynamic_windings_only() -> None:
    table = build(FULL, Answers())
    keys = [column.key for column in table.columns]
    rows = [dict(zip(keys, row, strict=True)) for row in table.rows]
    assert len(rows) == len(ROWS)
    for row in rows:
        assert (row["torque_nm"] is None) == str(row["control"]).startswith("kinematic")
        assert row["within_range"] == row["windings"]
    assert {len(group(FULL, row)) for row in ROWS if row.link == 12} == {len(SIDES[12])} == {4}
    assert len(jobs(QUICK)) == 4
