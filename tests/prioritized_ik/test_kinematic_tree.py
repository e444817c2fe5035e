import mujoco
import numpy as np
import pytest
from trees import ball_chain, end_points, random_model, random_problem, random_tree

from prioritized_ik.errors import InputError
from prioritized_ik.kinematic_tree import BASE, KinematicTree, PointRows
from prioritized_ik.model_tree import ModelTree, unit_axes
from prioritized_ik.problem import Level, Rows
from prioritized_ik.solvers.solve import solve
from prioritized_ik.tree_problem import TreeLevel, TreeRows, tree_of


@pytest.mark.parametrize("seed", range(12))
def test_the_jacobian_of_points_is_mujocos_for_every_kind_of_joint(seed):
    rng = np.random.default_rng(seed)
    model = random_model(rng, floating=seed % 3 == 0)
    data = mujoco.MjData(model)
    mujoco.mj_integratePos(model, data.qpos, rng.normal(size=model.nv), 1.0)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    bodies = np.arange(1, model.nbody)
    points = data.xpos[bodies] + rng.normal(scale=0.1, size=(len(bodies), 3))
    known = ModelTree(model)
    rows = PointRows.along_axes(known.at(data), known.carriers(bodies), points, unit_axes("xyz"))
    expected = np.zeros((len(bodies), 3, model.nv))
    for body, point, to in zip(bodies, points, expected, strict=True):
        mujoco.mj_jac(model, data, to, None, point, body)
    np.testing.assert_allclose(rows.matrix, expected.reshape(-1, model.nv), atol=1e-13)


@pytest.mark.parametrize("branching", [0.0, 0.2])
def test_products_without_the_matrix_are_products_with_it(branching):
    rng = np.random.default_rng(3)
    tree = random_tree(rng, 40, branching=branching)
    rows = end_points(tree, rng)
    x, y = rng.normal(size=40), rng.normal(size=len(rows))
    np.testing.assert_allclose(rows.times(x), rows.matrix @ x, atol=1e-13)
    np.testing.assert_allclose(rows.transposed_times(y), rows.matrix.T @ y, atol=1e-13)
    some = rows[np.arange(len(rows)) % 5 == 0]
    np.testing.assert_array_equal(some.matrix, rows.matrix[::5])


def test_a_point_that_no_joint_moves_stands_still():
    rng = np.random.default_rng(4)
    tree = random_tree(rng, 6)
    rows = PointRows(tree, [BASE, 5], rng.normal(size=(2, 3)), np.eye(3)[:2])
    assert rows.times(np.ones(6))[0] == 0.0
    assert not rows.matrix[0].any()
    np.testing.assert_allclose(rows.transposed_times(np.array([7.0, 1.0])), rows.matrix[1], atol=1e-14)


def test_joints_in_another_metric_move_points_by_as_much_less():
    rng = np.random.default_rng(5)
    tree = random_tree(rng, 9, branching=0.3)
    rows, factors = end_points(tree, rng), rng.uniform(0.5, 2.0, size=9)
    np.testing.assert_allclose(rows.on(tree.scaled(factors)).matrix, rows.matrix * factors, atol=1e-14)


def test_a_problem_on_a_tree_is_solved_as_one_of_matrices():
    rng = np.random.default_rng(6)
    problem = random_problem(rng, ball_chain(rng, 5), 2, contacts=2, bound=0.1)
    levels = [Level(level.matrix, level.target, level.weights, level.name) for level in problem.levels]
    same = type(problem)(levels, problem.bounds, Rows(problem.rows.matrix, problem.rows.upper, problem.rows.names))
    np.testing.assert_allclose(solve(problem).dtheta, solve(same).dtheta, rtol=1e-9, atol=1e-15)


def test_matrices_are_made_only_when_asked_for():
    rng = np.random.default_rng(7)
    problem = random_problem(rng, ball_chain(rng, 5), 2, contacts=2, bound=0.1)
    assert str(problem)
    assert np.isfinite([level.cost(np.ones(problem.joint_count)) for level in problem.levels]).all()
    parts = (*problem.levels, problem.rows)
    assert not any("matrix" in vars(part) for part in parts)
    assert [part.matrix.shape[1] for part in parts] == [problem.joint_count] * 3
    assert all("matrix" in vars(part) for part in parts)


def test_the_tree_of_a_problem_is_known_unless_a_matrix_is_among_its_parts():
    rng = np.random.default_rng(8)
    tree = ball_chain(rng, 4)
    problem = random_problem(rng, tree, contacts=1)
    assert tree_of(problem) is tree
    m = tree.joint_count
    assert tree_of(problem.with_levels([*problem.levels, Level(np.eye(m), np.zeros(m))])) is None
    other = random_problem(rng, ball_chain(rng, 4))
    assert tree_of(problem.with_levels([*problem.levels, *other.levels])) is None
    assert tree_of(problem.softened(["contact 5"] if "contact 5" in problem.rows.names else problem.rows.names)) is None


def test_a_level_that_is_changed_keeps_no_stale_points():
    rng = np.random.default_rng(9)
    tree = ball_chain(rng, 4)
    problem = random_problem(rng, tree, metric=True)
    (level,) = problem.in_metric.levels
    assert type(level) is Level
    np.testing.assert_allclose(level.matrix, problem.levels[0].matrix / np.sqrt(problem.metric))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: KinematicTree([-1, 1], *[np.zeros((2, 3))] * 3), "parents\\[1\\] is 1"),
        (lambda: KinematicTree([-1, 0], *[np.zeros((3, 3))] * 3), "angular"),
        (lambda: KinematicTree([-1.0], *[np.zeros((1, 3))] * 3), "whole numbers"),
        (lambda: PointRows(_two(), [2], np.zeros((1, 3)), np.zeros((1, 3))), "joints\\[0\\] is 2"),
        (lambda: PointRows(_two(), [1], np.full((1, 3), np.nan), np.zeros((1, 3))), "points"),
        (lambda: TreeLevel(np.eye(2), [1.0, 1.0]), "expected PointRows"),
        (lambda: TreeLevel(_rows(), [1.0, 2.0]), "target of level 'task'"),
        (lambda: TreeLevel(_rows(), [1.0], [-1.0]), "weights of level 'task'"),
        (lambda: TreeRows(_rows(), [-np.inf]), "-inf"),
        (lambda: TreeRows(_rows(), [1.0], ["a", "b"]), "names of rows"),
    ],
)
def test_what_is_no_tree_or_no_row_on_it_is_refused_by_name(make, said):
    with pytest.raises(InputError, match=said):
        make()


def _two() -> KinematicTree:
    return KinematicTree([-1, 0], np.eye(3)[:2], np.zeros((2, 3)), np.zeros((2, 3)))


def _rows() -> PointRows:
    return PointRows(_two(), [1], np.ones((1, 3)), np.eye(3)[:1])
