import numpy as np
import pytest
from trees import ball_chain, random_problem, random_tree

from prioritized_ik.kinematic_tree import KinematicTree, PointRows
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.compiled.library import library
from prioritized_ik.solvers.compiled.tree import CompiledElimination
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.solvers.tree.elimination import HELD, Elimination, Ending
from prioritized_ik.solvers.tree.posed import PosedOnTree
from prioritized_ik.tree_problem import TreeLevel

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
    u, _ = elimination.solve(np.zeros(problem.joint_count), posed.sides, posed.reference)
    assert [np.count_nonzero(elimination.owner == number) for number in range(1, len(posed.parts))] == [
        block.spectrum.kept.size for block in hierarchy.blocks
    ]
    np.testing.assert_allclose(u, hierarchy.closed_form, atol=EXACT * np.linalg.norm(u))


@compiled
@pytest.mark.parametrize("seed", range(24))
def test_the_compiled_elimination_does_what_the_python_one_does(seed):
    problem, rng = _random(seed), np.random.default_rng(seed)
    posed, m = PosedOnTree(problem), problem.joint_count
    fixed, held = rng.random(m) < 0.2, rng.random(len(posed.level)) < 0.7
    forms = Elimination(posed.on_joints), CompiledElimination(posed.on_joints)
    assert [form.factor(fixed, held) for form in forms] == [Ending.CLEAR] * 2
    np.testing.assert_array_equal(forms[0].owner, forms[1].owner)
    values, gradient = rng.normal(scale=0.01, size=m) * fixed, rng.normal(size=m)
    (u, missed), (same, as_much) = (form.solve(values, posed.sides, posed.reference) for form in forms)
    np.testing.assert_allclose(u, same, atol=EXACT * np.linalg.norm(u))
    assert abs(missed - as_much) <= 1e-12
    for level in range(1, posed.on_joints.last + 1):
        reduced = [form.reduced(level, gradient) for form in forms]
        # Signs of rows differ; what they make of joints and rows does not.
        np.testing.assert_allclose(*np.abs(reduced), atol=EXACT * np.abs(reduced[0]).max())
        pulls = [form.multipliers(level, part) for form, part in zip(forms, reduced, strict=True)]
        np.testing.assert_allclose(*pulls, atol=EXACT * max(1.0, np.abs(pulls[0]).max()))
        moved = [form.displacement(level, part) for form, part in zip(forms, reduced, strict=True)]
        np.testing.assert_allclose(*moved, atol=EXACT * max(1.0, np.abs(moved[0]).max()))


@pytest.mark.parametrize("seed", range(6))
def test_lengths_of_rows_are_those_of_the_matrix(seed):
    posed = PosedOnTree(_random(seed))
    for form in (Elimination, CompiledElimination) if library().core is not None else (Elimination,):
        np.testing.assert_allclose(
            form(posed.on_joints).row_lengths(), np.linalg.norm(posed.rows.matrix, axis=1), atol=1e-12
        )


@pytest.mark.parametrize("seed", range(12))
def test_multipliers_balance_a_gradient_along_all_that_levels_above_decide(seed):
    problem, rng = _random(seed), np.random.default_rng(seed)
    posed, m = PosedOnTree(problem), problem.joint_count
    fixed, held = rng.random(m) < 0.2, np.ones(len(posed.level), dtype=bool)
    elimination = Elimination(posed.on_joints)
    elimination.factor(fixed, held)
    matrix = posed.rows.matrix * posed.roots[:, None]
    gradient = rng.normal(size=m)
    for level in range(1, posed.on_joints.last + 1):
        pulls = elimination.multipliers(level, elimination.reduced(level, gradient))
        assert not pulls[posed.level >= level].any()
        rest = gradient + matrix.T @ pulls
        # The oracle: least squares of the gradient by the rows of the levels above, along joints that are free.
        above = matrix[posed.level < level][:, ~fixed]
        best = np.linalg.lstsq(above.T, -gradient[~fixed], rcond=1e-12)[0]
        left = elimination.reduced(level, rest)[~fixed & (elimination.owner < level)]
        np.testing.assert_allclose(left, 0.0, atol=1e-9 * np.abs(pulls).max(initial=1.0))
        # What is left has no part within reach of the levels above, nor has what least squares leaves.
        null = np.eye(above.shape[1]) - np.linalg.pinv(above, rcond=1e-12) @ above
        np.testing.assert_allclose(null @ rest[~fixed], null @ (gradient[~fixed] + above.T @ best), atol=1e-8)


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
    u, missed = elimination.solve(np.zeros(problem.joint_count), posed.sides, posed.reference)
    assert missed <= 1e-15
    np.testing.assert_allclose(posed.slack(u), 0.0, atol=1e-15)


def test_rows_that_contradict_each_other_are_reported_as_missed():
    rng = np.random.default_rng(2)
    tree = ball_chain(rng, 4)
    posed = PosedOnTree(random_problem(rng, tree))
    rows = posed.on_joints
    same = np.concatenate([rows.covectors[:1]] * 2)
    twice = type(rows)(rows.tree, rows.levels, np.array([5, 5]), np.array([HELD, HELD]), same, same)
    elimination = Elimination(twice)
    elimination.factor(np.zeros(tree.joint_count, dtype=bool), np.ones(2, dtype=bool))
    assert elimination.solve(np.zeros(tree.joint_count), np.array([1.0, -1.0]), posed.reference)[1] > 0.5


@pytest.mark.parametrize("form", [Elimination, pytest.param(CompiledElimination, marks=compiled)])
@pytest.mark.parametrize(("bend", "ending"), [(0.0, Ending.CLEAR), (1e-3, Ending.CLEAR), (1e-9, Ending.RANK)])
def test_a_rank_is_clear_or_declined(form, bend, ending):
    # The first link turns about its own length: what the second's end feels of that is the sine of the bend.
    anchors = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]])
    tree = KinematicTree([-1, 0], [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], np.zeros((2, 3)), anchors)
    end = anchors[1] + 0.1 * np.array([np.cos(bend), np.sin(bend), 0.0])
    points = PointRows.along_axes(tree, np.array([1]), end[None], np.eye(3))
    posed = PosedOnTree(IKProblem([TreeLevel(points, [0.0, 0.01, 0.02])]))
    elimination = form(posed.on_joints)
    assert elimination.factor(*_nothing(posed)) is ending
    if ending is Ending.CLEAR:
        assert np.count_nonzero(elimination.owner == 1) == (1 if bend == 0.0 else 2)


@compiled
def test_memory_grows_with_the_links_and_no_faster():
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
    u, _ = elimination.solve(np.zeros(len(wanted)), posed.roots * posed.rows.times(wanted), wanted)
    np.testing.assert_allclose(u, wanted, atol=EXACT * np.linalg.norm(wanted))
