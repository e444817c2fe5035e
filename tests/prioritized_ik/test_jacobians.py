"""Jacobians of many points at once are MuJoCo's, point by point."""

import platform
from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from tolerances import FINITE_DIFFERENCE, FINITE_DIFFERENCE_STEP, ROUNDING, SABOTAGE

from comparisons.robots import ROBOTS
from prioritized_ik.jacobians import PointJacobians
from prioritized_ik.models import update_kinematics

Array = np.ndarray

#: Every kind of joint, two trees, a body welded to another and one to the world.
EVERY_JOINT = """<mujoco><worldbody>
<body name="floating" pos="0.1 0.2 1"><freejoint/><geom size="0.1"/>
  <body pos="0.3 0 0"><joint type="ball"/><geom size="0.1"/>
    <body pos="0 0.2 0"><joint type="hinge" axis="1 2 3" pos="0.1 0 0.2"/><joint type="slide" axis="0 1 1"/>
      <geom size="0.1"/><body pos="0 0 0.3"><geom size="0.1"/></body></body></body>
  <body pos="-0.3 0 0"><joint axis="0 1 0"/><geom size="0.2"/></body></body>
<body pos="2 0 0"><joint type="slide" axis="1 0 0"/><geom size="0.1"/></body>
<body pos="0 3 0"><geom size="0.1"/></body>
</worldbody></mujoco>"""

MODELS = {"every joint": EVERY_JOINT, **{name: robot.text for name, robot in ROBOTS.items()}}


def posed(text: str, seed: int) -> tuple[mujoco.MjModel, mujoco.MjData, list[int], Array]:
    """A model at a random configuration, and random points on random bodies, the world among them."""
    model, rng = mujoco.MjModel.from_xml_string(text), np.random.default_rng(seed)
    data, q = mujoco.MjData(model), model.qpos0.copy()
    mujoco.mj_integratePos(model, q, rng.normal(size=model.nv), 1.0)
    update_kinematics(model, data, q)
    bodies = [*range(model.nbody), *rng.integers(model.nbody, size=5).tolist()]
    return model, data, bodies, rng.normal(size=(len(bodies), 3))


def by_mujoco(model: mujoco.MjModel, data: mujoco.MjData, bodies: list[int], points: Array) -> Array:
    found = np.empty((len(bodies), 3, model.nv))
    for jacobian, body, point in zip(found, bodies, points, strict=True):
        mujoco.mj_jac(model, data, jacobian, None, point, body)
    return found


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", MODELS)
def test_they_are_mujocos_to_the_last_bit_and_nothing_is_minus_zero(name: str, seed: int) -> None:
    model, data, bodies, points = posed(MODELS[name], seed)
    found, theirs = PointJacobians(model, bodies).at(data, points), by_mujoco(model, data, bodies, points)
    assert np.abs(found - theirs).max() <= ROUNDING
    if platform.machine() in ("x86_64", "AMD64"):  # elsewhere compilers may round a product and a sum as one
        assert found.tobytes() == theirs.tobytes()


def moved(text: str, seed: int, wrong: float = 0.0) -> float:
    """Largest error of the Jacobians, all entries `wrong` by a fraction, against central differences."""
    model, data, bodies, points = posed(text, seed)
    found = (1.0 + wrong) * PointJacobians(model, bodies).at(data, points)
    q = data.qpos.copy()
    local = [data.xmat[b].reshape(3, 3).T @ (p - data.xpos[b]) for b, p in zip(bodies, points, strict=True)]
    along: Callable[[int, float], Array] = lambda dof, step: places(model, q, bodies, local, dof, step)  # noqa: E731
    h = FINITE_DIFFERENCE_STEP
    differences = [(along(dof, h) - along(dof, -h)) / (2.0 * h) for dof in range(model.nv)]
    return float(np.abs(found - np.stack(differences, axis=2)).max() / np.abs(found).max())


def places(model: mujoco.MjModel, q: Array, bodies: list[int], local: list[Array], dof: int, step: float) -> Array:
    data, there = mujoco.MjData(model), q.copy()
    mujoco.mj_integratePos(model, there, step * np.eye(model.nv)[dof], 1.0)
    update_kinematics(model, data, there)
    return np.array([data.xpos[b] + data.xmat[b].reshape(3, 3) @ p for b, p in zip(bodies, local, strict=True)])


@pytest.mark.parametrize("name", MODELS)
def test_they_are_how_points_move(name: str) -> None:
    assert moved(MODELS[name], seed=7) <= FINITE_DIFFERENCE


def test_jacobians_wrong_by_a_thousandth_fail_the_finite_difference_check() -> None:
    assert moved(EVERY_JOINT, seed=7, wrong=SABOTAGE) > 100.0 * FINITE_DIFFERENCE


def test_some_of_the_points_have_the_same_jacobians_as_all() -> None:
    model, data, bodies, points = posed(EVERY_JOINT, seed=1)
    jacobians, chosen = PointJacobians(model, bodies), np.array([6, 2, 2])
    assert np.array_equal(jacobians.at(data, points[chosen], chosen), jacobians.at(data, points)[chosen])
    assert jacobians.at(data, points[:0], chosen[:0]).shape == (0, 3, model.nv)


def test_bodies_that_no_joint_moves_are_known() -> None:
    model = mujoco.MjModel.from_xml_string(EVERY_JOINT)
    jacobians = PointJacobians(model, list(range(model.nbody)))
    still = [body for body in range(model.nbody) if not jacobians.moves(body)]
    assert still == [0, model.nbody - 1]
