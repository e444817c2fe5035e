import numpy as np
import pytest
from trees import ball_chain, random_problem, random_tree, rotation, unit

from prioritized_ik.kinematic_tree import BASE, KinematicTree, PointRows
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.compiled import tree as compiled_tree
from prioritized_ik.solvers.compiled.library import library
from prioritized_ik.solvers.compiled.tree import CompiledElimination
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.solvers.tree.active_set import Search
from prioritized_ik.solvers.tree.certificate import ActiveSet
from prioritized_ik.solvers.tree.elimination import Elimination
from prioritized_ik.solvers.tree.factors import Ending
from prioritized_ik.solvers.tree.posed import PosedOnTree
from prioritized_ik.tolerances import NEAR_ZERO
from prioritized_ik.tree_problem import TreeLevel, TreeRows

EXACT = 1e-9  # [of the step] what both forms may differ by; random arms have singular values down to 1e-5 of the largest

compiled = pytest.mark.skipif(library().core is None, reason="there is no compiled core")


def _random(seed: int, links: int = 12) -> IKProblem:
    rng = np.random.default_rng(seed)
    tree = ball_chain(rng, links) if seed % 2 else random_tree(rng, 3 * links, branching=0.2)
    return random_problem(
        rng, tree, 1 + seed % 3, contacts=3, reference=seed % 4 > 1, metric=seed % 5 == 1, weights=float(seed % 3)
    )


def _nothing(posed: PosedOnTree) -> tuple[np.ndarray, np.ndarray]:
    return np.zeros(posed.tree.joint_count, dtype=bool), np.zeros(len(posed.level), dtype=bool)


@pytest.mark.parametrize("seed", range(24))
def test_the_closed_form_along_the_links_is_that_of_matrices(seed):
    problem = _random(seed)
    posed, hierarchy = PosedOnTree(problem), Hierarchy(problem)
    elimination = Elimination(posed.on_joints)
    assert elimination.factor(*_nothing(posed)) is Ending.CLEAR
    u = elimination.solve(np.zeros(problem.joint_count), posed.sides, posed.reference)
    assert elimination.ranks[1:] == [block.spectrum.kept.size for block in hierarchy.blocks]
    np.testing.assert_allclose(u, hierarchy.closed_form, atol=EXACT * np.linalg.norm(u))


@compiled
@pytest.mark.parametrize("seed", range(24))
def test_the_compiled_elimination_does_what_the_python_one_does(seed):
    problem, rng = _random(seed), np.random.default_rng(seed)
    posed, m = PosedOnTree(problem), problem.joint_count
    fixed, held = rng.random(m) < 0.2, rng.random(len(posed.level)) < 0.7
    forms = Elimination(posed.on_joints), CompiledElimination(posed.on_joints)
    assert [form.factor(fixed, held) for form in forms] == [Ending.CLEAR] * 2
    assert forms[0].ranks == forms[1].ranks
    values, gradient = rng.normal(scale=0.01, size=m) * fixed, rng.normal(size=m)
    u, same = (form.solve(values, posed.sides, posed.reference) for form in forms)
    np.testing.assert_allclose(u, same, atol=EXACT * np.linalg.norm(u))
    # Bases differ; what they make of joints and rows does not.
    parts = [form.parts(gradient) for form in forms]
    np.testing.assert_allclose(*([np.linalg.norm(part) for part in some] for some in parts), atol=EXACT)
    for level in range(posed.on_joints.last):
        whitened = [form.whitened(level, some[level]) for form, some in zip(forms, parts, strict=True)]
        for ask in ("pulls", "displacement"):
            answers = [getattr(form, ask)(level, some) for form, some in zip(forms, whitened, strict=True)]
            np.testing.assert_allclose(*answers, atol=1e-6 * max(1.0, np.abs(answers[0]).max()))


@compiled
@pytest.mark.parametrize("seed", range(6))
def test_the_core_moves_points_as_the_tree_does(seed):
    rng = np.random.default_rng(seed)
    tree = random_tree(rng, 20, branching=0.3)
    joints = np.array([BASE, *rng.integers(0, 20, size=12)])  # the first point stands still
    points = PointRows(tree, joints, rng.normal(size=(13, 3)), rng.normal(size=(13, 3)))
    posed, u = PosedOnTree(IKProblem([TreeLevel(points, np.zeros(13))])), rng.normal(size=20)
    rows = posed.on_joints
    motions, sizes = CompiledElimination(rows).motions(u)
    np.testing.assert_allclose(motions, points.times(u), atol=1e-14)
    np.testing.assert_allclose(sizes, points.sizes_of_terms(u), rtol=1e-12)
    assert motions[0] == sizes[0] == 0.0


@pytest.mark.parametrize("form", [Elimination, pytest.param(CompiledElimination, marks=compiled)])
@pytest.mark.parametrize("seed", range(6))
def test_what_levels_leave_of_a_step_moves_none_of_their_rows(form, seed):
    rng = np.random.default_rng(seed)
    posed = PosedOnTree(_random(seed))
    m, held = posed.tree.joint_count, np.ones(len(posed.level), dtype=bool)
    fixed, step = rng.random(m) < 0.2, rng.normal(size=m)
    elimination = form(posed.on_joints)
    elimination.factor(fixed, held)
    free = np.eye(m)[:, ~fixed]
    for level in range(posed.on_joints.last):
        # The oracle: singular vectors of all rows so far.
        _, values, directions = np.linalg.svd(posed.rows.matrix[posed.level <= level] @ free)
        left = free @ directions[np.count_nonzero(values > 1e-10 * values.max(initial=0.0)) :].T
        np.testing.assert_allclose(elimination.left_by(level, step), left @ (left.T @ step), atol=EXACT)


@pytest.mark.parametrize(("apart", "ranks"), [(1e-13, [0, 1]), (5e-11, None)])
def test_what_counts_as_zero_only_nearly_is_cut_where_rows_together_say_that_it_is(apart, ranks):
    rng = np.random.default_rng(0)
    tree, point, way = random_tree(rng, 6), rng.normal(size=3), unit(rng)
    points = PointRows(tree, np.full(2, 5), np.array([point, point + apart * unit(rng)]), np.array([way, way]))
    problem = IKProblem([TreeLevel(points, np.zeros(2))])
    assert Search(PosedOnTree(problem)).ranks == [0, 1 if ranks else 2]
    assert Search(PosedOnTree(problem, NEAR_ZERO)).ranks == ranks


@pytest.mark.parametrize("form", [Elimination, pytest.param(CompiledElimination, marks=compiled)])
@pytest.mark.parametrize("seed", range(8))
def test_rows_and_joints_are_damped_together(form, seed):
    rng = np.random.default_rng(seed)
    posed = PosedOnTree(_random(seed))
    k, m = len(posed.level), posed.tree.joint_count
    rows, joints = 10.0 ** rng.uniform(-2, 2, size=k), 10.0 ** rng.uniform(-3, 3, size=m)
    elimination = form(posed.on_joints)
    elimination.damp(rows, joints)
    whole = np.vstack([rows[:, None] * posed.rows.matrix, np.diag(joints)])
    for _ in range(2):  # one factorisation serves many right-hand sides
        sides = rng.normal(size=k), rng.normal(size=m)
        expected = np.linalg.lstsq(whole, np.concatenate(sides))[0]
        np.testing.assert_allclose(elimination.damped(*sides), expected, atol=EXACT * np.linalg.norm(expected))


@pytest.mark.parametrize("seed", range(6))
def test_lengths_of_rows_are_those_of_the_matrix(seed):
    posed = PosedOnTree(_random(seed))
    for form in (Elimination, CompiledElimination) if library().core is not None else (Elimination,):
        np.testing.assert_allclose(
            form(posed.on_joints).row_lengths(), np.linalg.norm(posed.rows.matrix, axis=1), atol=1e-12
        )


@pytest.mark.parametrize("seed", range(12))
def test_a_gradient_falls_into_what_levels_decide_and_what_they_leave(seed):
    problem, rng = _random(seed), np.random.default_rng(seed)
    posed, m = PosedOnTree(problem), problem.joint_count
    fixed, held = rng.random(m) < 0.2, np.ones(len(posed.level), dtype=bool)
    elimination = Elimination(posed.on_joints)
    elimination.factor(fixed, held)
    matrix = posed.rows.matrix * posed.roots[:, None]
    gradient = np.where(fixed, 0.0, rng.normal(size=m))
    parts = elimination.parts(gradient)
    free = np.eye(m)[:, ~fixed]
    for level in range(posed.on_joints.last):
        # The oracle: singular vectors of the level's rows within what the levels above leave.
        rows = matrix[posed.level == level]
        _, values, directions = np.linalg.svd(rows @ free)
        rank = int(np.count_nonzero(values > 1e-10 * values.max(initial=0.0)))
        assert len(parts[level]) == rank
        within = free @ directions[:rank].T
        np.testing.assert_allclose(np.linalg.norm(parts[level]), np.linalg.norm(within.T @ gradient), atol=1e-10)
        whitened = elimination.whitened(level, parts[level])
        felt = np.linalg.norm((within.T @ gradient) @ np.linalg.pinv(rows @ within))
        np.testing.assert_allclose(np.linalg.norm(whitened), felt, rtol=1e-6)
        # Multipliers of the level's rows balance its part of the gradient, and no more of them than that.
        pulls = elimination.pulls(level, whitened)
        assert not pulls[posed.level != level].any()
        np.testing.assert_allclose(
            within.T @ (matrix.T @ pulls - gradient), 0.0, atol=1e-9 * np.abs(pulls).max(initial=1.0)
        )
        moved = rows @ elimination.displacement(level, whitened)
        np.testing.assert_allclose(np.linalg.norm(moved), np.linalg.norm(whitened), rtol=1e-6)
        free = free @ directions[rank:].T
    np.testing.assert_allclose(np.linalg.norm(parts[-1]), np.linalg.norm(free.T @ gradient), atol=1e-10)


@pytest.mark.parametrize("seed", range(20))
def test_singular_values_below_a_cut_are_counted_at_every_level(seed):
    rng = np.random.default_rng(seed)
    tree = ball_chain(rng, 8, bend=10.0 ** rng.uniform(-3, 0)) if seed % 2 else random_tree(rng, 24, branching=0.2)
    problem = random_problem(rng, tree, 1 + seed % 3, metric=seed % 5 == 1, weights=1.0)
    posed, m = PosedOnTree(problem), problem.joint_count
    forms = [Elimination(posed.on_joints)]
    if library().core is not None:
        forms.append(CompiledElimination(posed.on_joints))
    assert all(form.factor(*_nothing(posed)) is Ending.CLEAR for form in forms)
    free = np.eye(m)
    for number, level in enumerate(problem.in_metric.levels, 1):
        _, values, directions = np.linalg.svd(level.matrix @ free)
        values = np.append(values, np.zeros(m))[: free.shape[1]]
        largest = np.linalg.norm(level.matrix, 2)
        assert 0.99 * largest <= posed.norm_of_matrix(number) <= largest * (1.0 + 1e-12)
        for cut in largest * 10.0 ** rng.uniform(-5, 0, size=4):
            expected = np.count_nonzero(values < cut)
            assert [form.count_below(number, cut) for form in forms] == [expected] * len(forms)
        free = free @ directions[np.count_nonzero(values > 1e-10 * largest) :].T


def test_held_rows_are_kept_whatever_the_levels_want():
    problem = _random(1)
    posed = PosedOnTree(problem)
    elimination = Elimination(posed.on_joints)
    elimination.factor(_nothing(posed)[0], np.ones(len(posed.level), dtype=bool))
    u = elimination.solve(np.zeros(problem.joint_count), posed.sides, posed.reference)
    np.testing.assert_allclose(posed.slack(u), 0.0, atol=1e-15)


def test_rows_that_contradict_each_other_are_no_face():
    rng = np.random.default_rng(2)
    problem = random_problem(rng, ball_chain(rng, 4), contacts=2)
    points = problem.rows.points
    same = PointRows(points.tree, points.joints[[0, 0]], points.points[[0, 0]], points.directions[[0, 0]])
    posed = PosedOnTree(IKProblem(problem.levels, rows=TreeRows(same, [0.01, 0.02])))
    nobody = np.zeros(problem.joint_count, dtype=np.int8)
    assert Search(posed).face(ActiveSet(nobody, np.array([True, False]))) is not None
    assert Search(posed).face(ActiveSet(nobody, np.array([True, True]))) is None


@pytest.mark.parametrize("form", [Elimination, pytest.param(CompiledElimination, marks=compiled)])
@pytest.mark.parametrize("bend", [0.0, 1e-14, 1e-11, 1e-9, 1e-7, 1e-5, 1e-3])
@pytest.mark.parametrize("turned", [False, True])
def test_arms_that_are_nearly_straight_are_as_exact_as_others(form, bend, turned):
    rng = np.random.default_rng(3)
    tree = ball_chain(rng, 20, bend=bend)
    if turned:  # not along an axis of the world, so that rows are long and directions are weak
        turn = rotation(rng.normal(size=3))
        tree = KinematicTree(tree.parents, tree.angular @ turn.T, tree.linear, tree.anchors @ turn.T)
    problem = random_problem(rng, tree)
    posed, hierarchy = PosedOnTree(problem), Hierarchy(problem)
    elimination = form(posed.on_joints)
    assert elimination.factor(*_nothing(posed)) is Ending.CLEAR
    assert elimination.ranks[1:] == [block.spectrum.kept.size for block in hierarchy.blocks]
    u = elimination.solve(np.zeros(problem.joint_count), posed.sides, posed.reference)
    np.testing.assert_allclose(u, hierarchy.closed_form, atol=EXACT * np.linalg.norm(u))


@pytest.mark.parametrize("form", [Elimination, pytest.param(CompiledElimination, marks=compiled)])
@pytest.mark.parametrize("first", [0, 1, 2])
def test_rows_that_are_held_leave_a_level_the_rank_that_singular_values_say_however_straight_the_arm(form, first):
    # Points keep their distances, so that most rows depend on others, and those held on the level's too.
    clear = 0
    for seed in range(first, 15, 3):
        rng = np.random.default_rng(seed)
        bend = 10.0 ** rng.uniform(-12, -2) if seed % 2 else 0.0
        tree = ball_chain(rng, 30, bend=bend, kinks=seed % 4, turned=True)
        ends = np.arange(2, 87, 3)
        points = PointRows.along_axes(tree, ends, tree.anchors[ends + 1], np.eye(3))
        level = points[np.arange(3 * rng.integers(10, 29))]
        joints = np.sort(rng.choice(np.arange(5, 87, 3), size=3, replace=False))
        held = PointRows(tree, joints, tree.anchors[joints + 1], np.array([unit(rng) for _ in joints]))
        problem = IKProblem([TreeLevel(level, np.zeros(len(level)))], rows=TreeRows(held, np.zeros(3)))
        rows = held.matrix / np.linalg.norm(held.matrix, axis=1, keepdims=True)
        left = np.linalg.svd(rows)[2][3:].T
        sizes = np.linalg.norm(level.matrix, axis=1, keepdims=True)
        values = np.linalg.svd(level.matrix @ left / np.where(sizes > 0.0, sizes, 1.0), compute_uv=False)
        rank = int(np.count_nonzero(values > 1e-12))
        if values[rank - 1] < 1e-8:  # it is clear neither way
            continue
        posed, clear = PosedOnTree(problem), clear + 1
        elimination = form(posed.on_joints)
        assert (
            elimination.factor(np.zeros(tree.joint_count, dtype=bool), np.ones(len(posed.level), dtype=bool))
            is Ending.CLEAR
        )
        assert elimination.ranks == [3, rank], seed
    assert clear > 3


@compiled
def test_memory_grows_with_the_links_and_no_faster(monkeypatch):
    monkeypatch.setattr(compiled_tree, "_idle", [])
    monkeypatch.setattr(compiled_tree, "MOST_IDLE", 0)
    held = []
    for links in (100, 200, 400):
        rng = np.random.default_rng(3)
        posed = PosedOnTree(random_problem(rng, ball_chain(rng, links), 3))
        elimination = CompiledElimination(posed.on_joints)
        elimination.factor(*_nothing(posed))
        elimination.solve(np.zeros(posed.tree.joint_count), posed.sides, posed.reference)
        held.append(elimination.memory)
    assert held[2] / held[1] < 2.6  # storage doubles its room when it is short of it
    assert held[1] / held[0] < 2.6
    assert held[2] < 8e6


@pytest.mark.parametrize("links", [100, 400])
def test_long_chains_are_as_exact_as_short_ones(links):
    rng = np.random.default_rng(4)
    posed = PosedOnTree(random_problem(rng, ball_chain(rng, links, bend=0.3), 2))
    form = Elimination if library().core is None else CompiledElimination
    elimination = form(posed.on_joints)
    assert elimination.factor(*_nothing(posed)) is Ending.CLEAR
    wanted = rng.normal(size=posed.tree.joint_count)
    # A step is the optimum of its own motions: with the reference there, it is the answer.
    u = elimination.solve(np.zeros(len(wanted)), posed.roots * posed.rows.times(wanted), wanted)
    np.testing.assert_allclose(u, wanted, atol=EXACT * np.linalg.norm(wanted))
