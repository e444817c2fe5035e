"""The arm in the report: rank map, planar cases, drawings of the model."""

import itertools
import warnings

import numpy as np
import pytest

from paper_repro.artefacts import (
    figure_1_virtual_arms,
    figure_2_spaces,
    figure_4_contact,
    figure_5_arm,
    table_2_ranks,
    table_3_cases,
)
from paper_repro.make.artefact import QUICK, Artefact
from paper_repro.make.jobs import Results
from paper_repro.make.projection import View
from paper_repro.measure.planar_cases import CASES, answers, case_arm, request_of
from paper_repro.measure.posed import VIRTUAL_ARMS_OF, VIRTUAL_ENDS, PosedArm, general_pose
from prioritized_ik.models import Arm
from prioritized_ik.solvers.closed_form import rank_decomposition_svd

ARM = Arm()


def rank(place: str, axis: str, order: str, shape: np.ndarray) -> int:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        q = table_2_ranks.joint_positions(shape, place, axis, order)
        arm = PosedArm.of(ARM, q, spec=table_2_ranks.variant(place, axis, order))
    return rank_decomposition_svd(arm.jacobian).rank


SHAPES = table_2_ranks.poses({})

# Table 2


@pytest.mark.parametrize("order", table_2_ranks.ORDERS)
@pytest.mark.parametrize(
    ("place", "axis", "pose", "expected"),
    [
        ("last link", "z", "straight", 33),
        ("last link", "z", "random", 34),
        ("last link", "y", "random", 34),
        ("last link", "z", "random, links 16 and 17 in line", 33),
        ("last link", "x", "random", 32),
        ("first link", "z", "random", 33),
        ("first link", "x", "random", 32),
    ],
)
def test_rank_depends_on_pose_place_and_axis_but_not_on_the_hinge_order(
    place: str, axis: str, pose: str, expected: int, order: str
) -> None:
    assert rank(place, axis, order, SHAPES[pose]) == expected


def test_hinges_twist_first_with_proper_euler_angles_leave_the_straight_arm_one_plane() -> None:
    assert rank("last link", "z", table_2_ranks.TWIST_TWICE, SHAPES["straight"]) == 17


def test_a_variant_has_as_many_joints_as_the_paper_states_and_is_the_default_arm_where_that_is_meant() -> None:
    for place, axis in itertools.product(table_2_ranks.PLACES, "xyz"):
        assert table_2_ranks.variant(place, axis, "zyx").compile().nv == 49
    default, same = Arm().spec().compile(), table_2_ranks.variant("last link", "z", "zyx").compile()
    assert np.array_equal(default.jnt_axis, same.jnt_axis)
    assert np.array_equal(default.jnt_bodyid, same.jnt_bodyid)


@pytest.mark.parametrize("order", ["xyz", "yzx", "zyx"])
def test_variants_stand_in_the_same_shape_whatever_their_hinges(order: str) -> None:
    q = table_2_ranks.joint_positions(SHAPES["random"], "last link", "z", order)
    arm = PosedArm.of(ARM, q, spec=table_2_ranks.variant("last link", "z", order))
    expected = np.eye(3)
    for rotation, found in zip(SHAPES["random"][:16], arm.data.xmat[1:17].reshape(-1, 3, 3), strict=True):
        expected = expected @ rotation
        assert np.abs(found - expected).max() < 1e-12


def test_joint_positions_of_the_default_arm_come_back() -> None:
    q = general_pose(ARM, 3)
    found = table_2_ranks.joint_positions(table_2_ranks.relative_rotations(q), "last link", "z", "zyx")
    assert np.abs(found - q).max() < 1e-12


def test_every_row_of_the_map_is_the_singular_case() -> None:
    rows = list(table_2_ranks._rows("last link", "z", table_2_ranks.ORDERS, SHAPES))
    keys = [column.key for column in table_2_ranks.COLUMNS]
    assert {row[keys.index("case")] for row in rows} == {"singular"}
    assert all(row[keys.index("sigma_next")] < 1e-10 <= row[keys.index("sigma_p")] for row in rows)


# Table 3 and Fig. 3


@pytest.mark.parametrize(("letter", "shape", "expected"), [("a", (4, 5), 4), ("b", (10, 5), 5), ("c", (4, 5), 3)])
def test_the_three_cases_have_the_papers_rows_and_ranks(letter: str, shape: tuple[int, int], expected: int) -> None:
    jacobian = case_arm(CASES[letter]).jacobian
    assert jacobian.shape == shape
    assert np.linalg.matrix_rank(jacobian) == expected


def test_ranks_of_the_three_cases_do_not_depend_on_the_bent_pose() -> None:
    rng = np.random.default_rng(5)
    for letter, expected in (("a", 4), ("b", 5), ("c", 3)):
        for q in rng.uniform(0.2, 0.9, size=(10, 5)) * rng.choice([-1.0, 1.0], size=(10, 5)):
            assert np.linalg.matrix_rank(case_arm(CASES[letter], q).jacobian, tol=1e-6) == expected


@pytest.mark.parametrize(
    ("letter", "applying"), [("a", [True, True, False]), ("b", [True, False, True]), ("c", [True, False, False])]
)
def test_special_forms_apply_where_the_paper_says_and_are_refused_elsewhere(letter: str, applying: list[bool]) -> None:
    found = answers(CASES[letter])
    assert [answer.applies for answer in found] == applying
    assert [answer.library == "answers" for answer in found] == applying
    for answer in found:
        if answer.applies:
            assert answer.dtheta is not None
            assert np.abs(answer.dtheta - found[0].dtheta).max() < 1e-10


@pytest.mark.parametrize("letter", CASES)
def test_no_other_formula_costs_less_or_as_much_with_a_shorter_step(letter: str) -> None:
    jacobian = case_arm(CASES[letter]).jacobian
    weights, desired = request_of(CASES[letter])

    def cost(step: np.ndarray) -> float:
        left = desired - jacobian @ step
        return float(left @ (weights * left))

    best, *others = [answer.dtheta for answer in answers(CASES[letter]) if answer.dtheta is not None]
    for other in others:
        # The plain Eq. 17 of a singular case may be of any size: rounding then costs more than the tolerance.
        assert cost(other) >= cost(best) - 1e-9 * cost(np.zeros(5))
        if cost(other) <= cost(best) + 1e-9 * cost(np.zeros(5)):
            assert np.linalg.norm(other) >= np.linalg.norm(best) - 1e-9


def test_table_3_shows_rounding_as_zero() -> None:
    table = table_3_cases.build(QUICK, Results({}))
    costs = [row[9] for row in table.rows]
    assert all(cost is None or cost == 0.0 or cost > 1e-6 for cost in costs)


# Figures


def test_fig_1_each_virtual_arm_moves_with_the_joints_before_its_end_point() -> None:
    arm = PosedArm.of(VIRTUAL_ARMS_OF, figure_1_virtual_arms.POSE, [*VIRTUAL_ENDS, "end_4"], "xy")
    assert [figure_1_virtual_arms.moving_joints(arm, number) for number in range(4)] == [1, 3, 3, 4]


def test_fig_2_relations_hold_on_the_model() -> None:
    shapes, errors = figure_2_spaces.measured()
    assert (shapes["j"], shapes["jt"], shapes["k_a"], shapes["k_v"]) == ("51 × 49", "49 × 51", "49 × 49", "51 × 51")
    assert max(errors.values()) < 1e-7
    assert errors["k"] < 1e-12


def test_fig_4_the_direction_leads_back_to_the_plane_and_to_the_object() -> None:
    state = figure_4_contact.contact()
    moved = state.end_next + 1e-3 * state.alpha
    assert abs(moved @ state.e) < abs(state.end_next @ state.e)
    assert np.linalg.norm(moved[[0, 2]]) < np.linalg.norm(state.end_next[[0, 2]])


def test_fig_5_numbers_the_joints_as_the_paper_does() -> None:
    numbers = figure_5_arm.joint_numbers()
    assert numbers[:2] == [(1, 2, 3), (4, 5, 6)]
    assert numbers[-2:] == [(46, 47, 48), (49,)]


def test_projection_keeps_lengths_square_to_the_line_of_sight() -> None:
    view = View(azimuth=-1.1, elevation=0.4)
    assert np.allclose(view.frame @ view.frame.T, np.eye(3))
    assert np.linalg.det(view.frame) == pytest.approx(1.0)
    assert np.allclose(view.page(view.frame[2]), 0.0)
    assert view.page([0.0, 0.0, 1.0])[1] > 0.0


@pytest.mark.parametrize(
    "module", ["figure_1_virtual_arms", "figure_2_spaces", "figure_3_cases", "figure_4_contact", "figure_5_arm"]
)
def test_figures_need_no_jobs_and_keep_their_text_inside(module: str) -> None:
    import importlib

    artefact: Artefact = importlib.import_module(f"paper_repro.artefacts.{module}").ARTEFACT
    assert artefact.jobs(QUICK) == []
    figure = artefact.build(QUICK, Results({}))
    figure.draw_without_rendering()
    page = figure.bbox
    texts = [text for ax in figure.axes for text in [*ax.texts, ax.title] if text.get_text()]
    assert texts
    for text in texts:
        box = text.get_window_extent()
        assert box.x0 >= page.x0 - 1.0, text.get_text()
        assert box.x1 <= page.x1 + 1.0, text.get_text()
        assert box.y0 >= page.y0 - 1.0, text.get_text()
        assert box.y1 <= page.y1 + 1.0, text.get_text()
        assert text.get_fontsize() >= 6.5
