"""Virtual arms: end points, their Jacobians, Eqs. (1) to (5)."""

import mujoco
import numpy as np
import pytest
from arms import Bench, central_difference, relative_error
from tolerances import FINITE_DIFFERENCE, FINITE_DIFFERENCE_STEP, ROUNDING, SABOTAGE

from prioritized_ik.errors import InputError, ModelError
from prioritized_ik.models import PLANAR_ARM, Arm, update_kinematics
from prioritized_ik.solvers.closed_form import rank_decomposition_qr, rank_decomposition_svd
from prioritized_ik.virtual_arms import (
    EndPoint,
    VirtualArms,
    jacobian_of_inner_arm,
    joint_stiffness,
    joint_torques,
    object_id,
)

FLOATING = """
<mujoco>
  <worldbody>
    <site name="fixed" pos="1 2 3"/>
    <body name="base" pos="0.1 0.2 0.3">
      <freejoint/>
      <geom name="hull" type="box" size="0.1 0.2 0.3" pos="0.02 -0.01 0.03" euler="20 30 40"/>
      <body name="upper" pos="0.2 0 0.1" euler="10 -25 40">
        <joint type="ball" pos="0.01 0.02 0"/>
        <geom name="upper" type="capsule" size="0.02" fromto="0 0 0 0.2 0.1 0.05"/>
        <site name="tilted" pos="0.1 0.05 0.02" euler="50 -10 30"/>
        <body name="slider" pos="0.2 0.1 0.05">
          <joint type="slide" axis="1 1 0"/>
          <joint type="hinge" axis="0 1 1" pos="0.03 0 0"/>
          <geom name="tip" type="sphere" size="0.03" pos="0.05 0 0"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
FLOATING_POINTS = [
    EndPoint("site", "tilted", (0.01, -0.02, 0.03)),
    EndPoint("body", "slider", (0.1, 0.0, -0.05)),
    EndPoint("geom", "hull", (0.1, 0.2, 0.3)),
    EndPoint("geom", "tip"),
    EndPoint("geom", "upper", (0.0, 0.01, 0.1)),
    EndPoint("body", "base"),
]


@pytest.fixture(scope="module")
def posed(paper_arm: Bench) -> Bench:
    """The paper's arm in a random pose of bends up to 0.9 rad."""
    paper_arm.jacobian(np.random.default_rng(3).uniform(-0.9, 0.9, 49))
    return paper_arm


def last_point_jacobians(bench: Bench) -> tuple[np.ndarray, np.ndarray]:
    linear, angular = np.empty((3, 49)), np.empty((3, 49))
    point = bench.data.site("end_17").xpos
    mujoco.mj_jac(bench.model, bench.data, linear, angular, point, bench.model.body("link_17").id)
    return linear, angular


def numeric_jacobian(arms: VirtualArms, q: np.ndarray) -> np.ndarray:
    data = mujoco.MjData(arms.model)

    def positions(q: np.ndarray) -> np.ndarray:
        update_kinematics(arms.model, data, q)
        return arms.positions(data)

    return central_difference(arms.model, q, positions, FINITE_DIFFERENCE_STEP)


def analytic_jacobian(arms: VirtualArms, q: np.ndarray) -> np.ndarray:
    data = mujoco.MjData(arms.model)
    update_kinematics(arms.model, data, q)
    return arms.jacobian(data)


def random_position(model: mujoco.MjModel, seed: int) -> np.ndarray:
    q = np.array(model.qpos0)
    mujoco.mj_integratePos(model, q, np.random.default_rng(seed).uniform(-0.8, 0.8, model.nv), 1.0)
    return q


# Eqs. (1) to (3)


@pytest.mark.parametrize("link", [4, 9, 16])
def test_eq2_as_printed_is_wrong_by_more_than_ten_percent(posed: Bench, link: int) -> None:
    linear, _ = last_point_jacobians(posed)
    truth = posed.arms.jacobian(posed.data)[3 * link - 3 : 3 * link]
    printed = linear * (np.arange(49) < 3 * link)
    assert np.linalg.norm(printed - truth) / np.linalg.norm(truth) > 0.1


@pytest.mark.parametrize("link", range(1, 17))
def test_eq2_corrected_gives_the_jacobian_of_every_inner_arm(posed: Bench, link: int) -> None:
    linear, angular = last_point_jacobians(posed)
    points = posed.arms.positions(posed.data)
    found = jacobian_of_inner_arm(linear, angular, points[16], points[link - 1], 3 * link)
    truth = posed.arms.jacobian(posed.data)[3 * link - 3 : 3 * link]
    assert relative_error(found, truth) < ROUNDING


def test_eq2_corrected_of_the_last_end_point_itself_changes_nothing(posed: Bench) -> None:
    linear, angular = last_point_jacobians(posed)
    last = posed.arms.positions(posed.data)[16]
    assert relative_error(jacobian_of_inner_arm(linear, angular, last, last, 49), linear) < ROUNDING


def test_eq2_with_the_lever_arm_reversed_would_be_noticed(posed: Bench) -> None:
    linear, angular = last_point_jacobians(posed)
    points = posed.arms.positions(posed.data)
    reversed_lever = jacobian_of_inner_arm(linear, angular, points[8], points[16], 27)
    assert relative_error(reversed_lever, posed.arms.jacobian(posed.data)[24:27]) > 0.1


def test_the_last_block_of_the_stacked_jacobian_is_mujocos_point_jacobian(posed: Bench) -> None:
    assert np.array_equal(posed.arms.jacobian(posed.data)[48:], last_point_jacobians(posed)[0])


def test_eq1_joints_beyond_an_end_point_do_not_move_it(posed: Bench) -> None:
    blocks = posed.arms.jacobian(posed.data).reshape(17, 3, 49)
    for link in range(1, 17):
        assert np.all(blocks[link - 1, :, 3 * link :] == 0.0)


def test_eq3_stacks_the_arms_one_after_the_other(posed: Bench) -> None:
    stacked = posed.arms.jacobian(posed.data)
    for i, site in enumerate(posed.arm.end_sites):
        alone = VirtualArms(posed.model, [site]).jacobian(posed.data)
        assert np.array_equal(stacked[3 * i : 3 * i + 3], alone)


def test_eq3_one_joint_step_shared_by_all_arms_moves_every_end_point(posed: Bench) -> None:
    rng = np.random.default_rng(5)
    q, dtheta = rng.uniform(-0.9, 0.9, 49), 1e-6 * rng.normal(size=49)
    predicted = posed.jacobian(q) @ dtheta
    before = posed.arms.positions(posed.data)
    update_kinematics(posed.model, posed.data, q + dtheta)
    moved = (posed.arms.positions(posed.data) - before).ravel()
    assert relative_error(predicted, moved) < 1e-4  # second order in a step of 1e-5 rad over 17 links


# Eqs. (4), (5) and Fig. 2


def test_eqs_4_and_5_the_joint_torques_do_the_work_of_the_end_point_forces(posed: Bench) -> None:
    jacobian, rng = posed.arms.jacobian(posed.data), np.random.default_rng(7)
    forces = rng.normal(size=51)
    torques = joint_torques(jacobian, forces)
    for dtheta in rng.normal(size=(50, 49)):
        assert torques @ dtheta == pytest.approx(forces @ (jacobian @ dtheta), rel=ROUNDING, abs=ROUNDING)


def test_eq5_is_the_sum_over_the_arms_of_eq4(posed: Bench) -> None:
    jacobian, forces = posed.arms.jacobian(posed.data), np.random.default_rng(8).normal(size=51)
    each = [joint_torques(jacobian[i : i + 3], forces[i : i + 3]) for i in range(0, 51, 3)]
    assert relative_error(np.sum(each, axis=0), joint_torques(jacobian, forces)) < ROUNDING


def test_torques_wrong_by_a_thousandth_do_another_amount_of_work(posed: Bench) -> None:
    jacobian, rng = posed.arms.jacobian(posed.data), np.random.default_rng(7)
    forces, dtheta = rng.normal(size=51), rng.normal(size=49)
    torques = (1.0 + SABOTAGE) * joint_torques(jacobian, forces)
    assert torques @ dtheta != pytest.approx(forces @ (jacobian @ dtheta), rel=ROUNDING, abs=ROUNDING)


def test_fig2_joint_stiffness_is_symmetric_and_stores_the_energy_of_the_end_points(posed: Bench) -> None:
    jacobian, rng = posed.arms.jacobian(posed.data), np.random.default_rng(9)
    root = rng.normal(size=(51, 51))
    k_v = root @ root.T
    k_a = joint_stiffness(jacobian, k_v)
    assert relative_error(k_a, k_a.T) < ROUNDING
    for dtheta in rng.normal(size=(20, 49)):
        dx = jacobian @ dtheta
        assert dtheta @ k_a @ dtheta == pytest.approx(dx @ k_v @ dx, rel=ROUNDING)


def test_fig2_joint_stiffness_gives_the_torques_of_the_springs_forces(posed: Bench) -> None:
    jacobian, rng = posed.arms.jacobian(posed.data), np.random.default_rng(10)
    k_v, dtheta = np.diag(rng.uniform(1.0, 2.0, 51)), rng.normal(size=49)
    springs = joint_torques(jacobian, k_v @ jacobian @ dtheta)
    assert relative_error(joint_stiffness(jacobian, k_v) @ dtheta, springs) < ROUNDING


# Rank of the stacked Jacobian


@pytest.mark.parametrize("factorise", [rank_decomposition_svd, rank_decomposition_qr])
def test_rank_of_the_paper_arm_is_34_in_general_poses(paper_arm: Bench, factorise: object) -> None:
    for q in paper_arm.general_poses(10, seed=11):
        jacobian = paper_arm.jacobian(q)
        assert jacobian.shape == (51, 49)
        assert factorise(jacobian).rank == 34


def test_rank_is_33_when_straight(paper_arm: Bench) -> None:
    assert rank_decomposition_svd(paper_arm.jacobian(np.zeros(49))).rank == 33


def test_rank_is_33_when_links_16_and_17_are_collinear(paper_arm: Bench) -> None:
    for q in paper_arm.general_poses(5, seed=12):
        q[48] = 0.0
        assert rank_decomposition_svd(paper_arm.jacobian(q)).rank == 33


@pytest.mark.parametrize("order", ["xyz", "xzy", "yxz", "yzx", "zxy", "zyx"])
def test_rank_when_straight_does_not_depend_on_the_hinge_order(order: str) -> None:
    # At zero the three axes of a ball are x, y and z, whichever comes first.
    assert rank_decomposition_svd(Bench.of(Arm(hinge_order=order)).jacobian(np.zeros(49))).rank == 33


def test_each_link_end_moves_square_to_its_link_relative_to_the_one_before(posed: Bench) -> None:
    # The 17 length constraints that take the rank from 51 down to 34.
    blocks = posed.arms.jacobian(posed.data).reshape(17, 3, 49)
    relative = np.diff(blocks, axis=0, prepend=0.0)
    directions = posed.data.xmat[1:].reshape(17, 3, 3)[:, :, 0]
    assert np.abs(np.einsum("nk,nkm->nm", directions, relative)).max() < ROUNDING


# Positions and Jacobians of any end point


def test_positions_of_the_straight_arm_are_the_link_ends(paper_arm: Bench) -> None:
    paper_arm.jacobian(np.zeros(49))
    expected = np.outer(0.06 * np.arange(1, 18), [1.0, 0.0, 0.0])
    assert np.abs(paper_arm.arms.positions(paper_arm.data) - expected).max() < ROUNDING


def test_positions_of_the_planar_arm_are_sums_of_cosines_and_sines() -> None:
    bench = Bench.of(PLANAR_ARM, "xy")
    q = np.random.default_rng(13).uniform(-1.0, 1.0, 5)
    bench.jacobian(q)
    angles = np.cumsum(q)
    expected = 0.06 * np.cumsum(np.column_stack([np.cos(angles), np.sin(angles)]), axis=0)
    assert np.abs(bench.arms.positions(bench.data) - expected).max() < ROUNDING


def test_jacobian_of_the_paper_arm_is_the_derivative_of_its_positions(paper_arm: Bench) -> None:
    q = np.random.default_rng(14).uniform(-0.9, 0.9, 49)
    assert relative_error(paper_arm.jacobian(q), numeric_jacobian(paper_arm.arms, q)) < FINITE_DIFFERENCE


def test_a_jacobian_wrong_by_a_thousandth_fails_the_finite_difference_check(paper_arm: Bench) -> None:
    q = np.random.default_rng(14).uniform(-0.9, 0.9, 49)
    wrong = (1.0 + SABOTAGE) * paper_arm.jacobian(q)
    assert relative_error(wrong, numeric_jacobian(paper_arm.arms, q)) > FINITE_DIFFERENCE


@pytest.mark.parametrize("axes", ["xy", "yx", "z"])
def test_planar_axes_keep_the_derivative_of_the_positions_they_keep(axes: str) -> None:
    bench = Bench.of(Arm(links=4), axes)
    q = np.random.default_rng(15).uniform(-0.9, 0.9, bench.model.nv)
    jacobian = bench.jacobian(q)
    assert jacobian.shape == (4 * len(axes), bench.model.nv)
    assert bench.arms.positions(bench.data).shape == (4, len(axes))
    assert relative_error(jacobian, numeric_jacobian(bench.arms, q)) < FINITE_DIFFERENCE


@pytest.mark.parametrize("seed", range(3))
def test_jacobian_on_free_ball_slide_and_hinge_joints_is_the_derivative_of_the_positions(seed: int) -> None:
    model = mujoco.MjModel.from_xml_string(FLOATING)
    arms = VirtualArms(model, FLOATING_POINTS)
    q = random_position(model, seed)
    assert analytic_jacobian(arms, q).shape == (3 * len(FLOATING_POINTS), 11)
    assert relative_error(analytic_jacobian(arms, q), numeric_jacobian(arms, q)) < FINITE_DIFFERENCE


def test_positions_of_sites_bodies_and_geoms_with_offsets_are_mujocos_frames() -> None:
    model = mujoco.MjModel.from_xml_string(FLOATING)
    data = mujoco.MjData(model)
    update_kinematics(model, data, random_position(model, 4))
    found = VirtualArms(model, FLOATING_POINTS).positions(data)
    for position, point in zip(found, FLOATING_POINTS, strict=True):
        frame = getattr(data, point.kind)(point.name)
        rotation = (frame.xmat).reshape(3, 3)
        assert np.abs(position - (frame.xpos + rotation @ point.offset)).max() < ROUNDING


def test_a_site_on_the_world_has_a_zero_jacobian() -> None:
    model = mujoco.MjModel.from_xml_string(FLOATING)
    assert np.all(analytic_jacobian(VirtualArms(model, ["fixed"]), model.qpos0) == 0.0)


def test_a_plain_string_names_a_site(paper_arm: Bench) -> None:
    assert VirtualArms(paper_arm.model, ["end_3"]).points == (EndPoint("site", "end_3"),)


def test_count_and_dimension_are_n_and_l(paper_arm: Bench) -> None:
    assert (paper_arm.arms.count, paper_arm.arms.dimension) == (17, 3)


# Bad input


@pytest.mark.parametrize(
    ("kind", "known"), [("site", "end_1, end_2"), ("body", "world, link_1"), ("geom", "link_1, link_2")]
)
def test_an_unknown_name_is_refused_with_the_names_there_are(paper_arm: Bench, kind: str, known: str) -> None:
    with pytest.raises(ModelError, match=f"no {kind} called 'elbow'; its {kind}s: {known}"):
        VirtualArms(paper_arm.model, [EndPoint(kind, "elbow")])


def test_an_unknown_name_in_a_model_without_sites_is_refused_with_none() -> None:
    with pytest.raises(ModelError, match="no site called 'end_1'; its sites: none"):
        object_id(mujoco.MjModel.from_xml_string("<mujoco/>"), "site", "end_1")


def test_an_unknown_kind_is_refused(paper_arm: Bench) -> None:
    with pytest.raises(ModelError, match="unknown kind of end point 'camera'; choose one of: site, body, geom"):
        VirtualArms(paper_arm.model, [EndPoint("camera", "end_1")])


def test_no_point_at_all_is_refused(paper_arm: Bench) -> None:
    with pytest.raises(ModelError, match=r"points is \[\]; expected a list of at least one"):
        VirtualArms(paper_arm.model, [])


@pytest.mark.parametrize("axes", ["", "xx", "xw", "XY"])
def test_unknown_or_doubled_axes_are_refused(paper_arm: Bench, axes: str) -> None:
    with pytest.raises(ModelError, match=f"axes is '{axes}'"):
        VirtualArms(paper_arm.model, ["end_1"], axes)


@pytest.mark.parametrize(("offset", "named"), [((0.0, np.nan, 0.0), r"\[1\] is nan"), ((0.0, 1.0), r"shape \(2,\)")])
def test_an_offset_of_no_use_is_refused(paper_arm: Bench, offset: tuple[float, ...], named: str) -> None:
    with pytest.raises(InputError, match=f"offset of geom 'link_2'.*{named}"):
        VirtualArms(paper_arm.model, [EndPoint("geom", "link_2", offset)])


@pytest.mark.parametrize("joints_before", [-1, 50])
def test_eq2_refuses_a_joint_number_beyond_the_arm(joints_before: int) -> None:
    with pytest.raises(InputError, match=f"joints_before is {joints_before}; expected 0 to 49"):
        jacobian_of_inner_arm(np.zeros((3, 49)), np.zeros((3, 49)), np.zeros(3), np.zeros(3), joints_before)


def test_eq2_refuses_jacobians_of_different_widths() -> None:
    with pytest.raises(InputError, match=r"angular has shape \(3, 4\); expected \(3, 5\)"):
        jacobian_of_inner_arm(np.zeros((3, 5)), np.zeros((3, 4)), np.zeros(3), np.zeros(3), 2)


def test_torques_refuse_nan_and_a_wrong_number_of_forces() -> None:
    with pytest.raises(InputError, match=r"forces has shape \(2,\); expected \(3,\)"):
        joint_torques(np.zeros((3, 5)), np.zeros(2))
    with pytest.raises(InputError, match=r"jacobian\[1, 0\] is nan"):
        joint_torques([[0.0], [np.nan]], np.zeros(2))


def test_stiffness_refuses_a_matrix_that_does_not_fit() -> None:
    with pytest.raises(InputError, match=r"end_point_stiffness has shape \(2, 3\); expected \(3, 3\)"):
        joint_stiffness(np.zeros((3, 5)), np.zeros((2, 3)))
