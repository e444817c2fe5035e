import dataclasses
import pickle
from itertools import product

import numpy as np
import pytest
from digits import judged
from trees import ball_chain, end_points, random_problem, random_tree, rotation

from comparisons.bench import growth
from prioritized_ik.errors import InputError
from prioritized_ik.kinematic_tree import KinematicTree, PointRows
from prioritized_ik.models import Arm
from prioritized_ik.problem import Bounds, Equalities, IKProblem, Level, Rows
from prioritized_ik.solvers.certificate import certify
from prioritized_ik.solvers.compiled.fast import compiled_step
from prioritized_ik.solvers.compiled.library import Ending, Question, library
from prioritized_ik.solvers.compiled.tree_step import compiled_tree_step
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.methods import ActiveSet as ActiveSetMethod
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.solvers.step import JointStep, StepStatus
from prioritized_ik.solvers.tree import step as tree
from prioritized_ik.solvers.tree.active_set import Search
from prioritized_ik.solvers.tree.certificate import ActiveSet, TreeProof
from prioritized_ik.solvers.tree.elimination import Elimination
from prioritized_ik.solvers.tree.factors import HELD
from prioritized_ik.solvers.tree.interior import guessed
from prioritized_ik.solvers.tree.posed import PosedOnTree
from prioritized_ik.solvers.tree.step import PATH, tree_step
from prioritized_ik.tolerances import NEAR_ZERO, TREE_ZERO
from prioritized_ik.tree_problem import TreeLevel
from prioritized_ik.winding.controller import WindingController
from prioritized_ik.winding.settings import WindingSettings

ALONG_LINKS, BY_MATRICES = SolveOptions(kinematics="tree"), SolveOptions(kinematics="dense")

SAME = 1e-9  # [of the step]


def _random(seed: int) -> IKProblem:
    """A problem of a chain or a tree: levels, weights, reference, metric, bounds and contact rows as the seed has it."""
    rng = np.random.default_rng(seed)
    chain = seed % 2
    links = int(rng.integers(4, 16))
    tree = ball_chain(rng, links) if chain else random_tree(rng, 3 * links, branching=0.2 * (seed % 4 == 0))
    return random_problem(
        rng,
        tree,
        1 + seed % 3,
        contacts=int(rng.integers(0, 5)),
        bound=10.0 ** rng.uniform(-3, 0) if seed % 3 else np.inf,
        reference=seed % 4 > 1,
        metric=seed % 5 == 1,
        weights=1.0 * (seed % 7 > 2),
    )


def _step(problem: IKProblem, options: SolveOptions) -> JointStep:
    return get_method("active-set").step(problem, options)


@pytest.mark.parametrize("first", range(0, 100, 10))
def test_steps_along_the_links_are_those_of_matrices(first):
    told = 0
    for seed in range(first, first + 10):
        problem = _random(seed)
        step, dense = _step(problem, ALONG_LINKS), _step(problem, BY_MATRICES)
        told += step.path == PATH
        assert dense.path != PATH
        assert step.status is dense.status, seed
        assert set(step.active_rows) == set(dense.active_rows), seed
        np.testing.assert_allclose(step.dtheta, dense.dtheta, atol=SAME * np.linalg.norm(dense.dtheta), err_msg=str(seed))
        np.testing.assert_allclose(step.costs, dense.costs, rtol=1e-6, atol=1e-12)
        assert certify(problem, step.dtheta).holds, seed
    assert told >= 9  # of ten: the others are declined, and so are the dense form's


@pytest.mark.parametrize("links", [34, 68])
def test_longer_arms_have_the_same_steps_too(links):
    for seed in range(2):
        rng = np.random.default_rng(seed)
        problem = random_problem(
            rng, ball_chain(rng, links, bend=0.3), 1 + seed, contacts=links // 10, bound=0.3, size=2e-3, weights=1.0
        )
        step, dense = _step(problem, ALONG_LINKS), _step(problem, BY_MATRICES)
        assert step.path == PATH
        assert step.status is dense.status
        np.testing.assert_allclose(step.dtheta, dense.dtheta, atol=SAME * np.linalg.norm(dense.dtheta))


def test_the_links_are_gone_along_where_that_is_faster_and_the_step_says_so():
    rng = np.random.default_rng(0)
    short, long = (random_problem(rng, ball_chain(rng, links)) for links in (10, 80))
    assert _step(short, SolveOptions()).path != PATH
    assert _step(long, SolveOptions()).path == PATH
    assert not any("matrix" in vars(level) for level in long.levels)
    assert _step(long, BY_MATRICES).path != PATH


def test_a_step_starts_from_the_rows_of_the_last_one():
    rng = np.random.default_rng(1)
    problem = random_problem(rng, ball_chain(rng, 20), 2, contacts=3, bound=0.1)
    method = ActiveSetMethod()
    first, second = (method.step(problem, ALONG_LINKS) for _ in range(2))
    assert first.status is second.status is StepStatus.SOLVED
    assert second.path == PATH
    assert first.repairs > second.repairs == 0
    np.testing.assert_allclose(first.dtheta, second.dtheta, atol=1e-12)
    assert method.step(problem, BY_MATRICES).repairs == 0  # whoever takes it up from there


@pytest.mark.skipif(library().core is None, reason="there is no compiled core")
@pytest.mark.parametrize("first", range(0, 60, 10))
def test_the_core_finds_and_proves_what_the_search_does_to_the_same_bits(first, monkeypatch):
    quick = 0
    for seed in range(first, first + 10):
        problem = _random(seed)
        last = _searched(problem, 0.0, (), Question.STEP, monkeypatch)
        assert last is not None
        questions = (Question.STEP, Question.CLOSED_FORM_ONLY, Question.FROM_GUESS_ONLY)
        for question, rows, tolerance in product(questions, ((), last[1]), (0.0, 1e-6, 1e-2)):
            found = compiled_tree_step(problem, tolerance, rows, question, "")
            if isinstance(found, Ending):
                assert found is not Ending.RANK or _searched(problem, tolerance, rows, question, monkeypatch) is None
                continue
            quick += 1
            searched = _searched(problem, tolerance, rows, question, monkeypatch)
            assert searched is not None
            step, active = searched
            np.testing.assert_array_equal(found.dtheta, step.dtheta)
            assert found.written.active == active
            for name in ("status", "path", "active_rows", "tight_rows", "repairs"):
                assert getattr(found, name) == getattr(step, name), (seed, name)
            np.testing.assert_allclose(found.costs, step.costs, rtol=1e-9, atol=1e-25)
            for name in ("gaps", "relative_gaps", "stationarity", "rounding"):
                one, other = getattr(found.certificate, name), getattr(step.certificate, name)
                np.testing.assert_allclose(one, other, rtol=0.3, atol=1e-13, err_msg=f"{seed} {name}")
    assert quick >= 50  # of 180: from nothing, many take an interior point, and the larger tolerance cuts most


def _searched(problem, tolerance, rows, question, monkeypatch):
    """Return what the search in Python finds, by the factors of the core."""
    with monkeypatch.context() as patched:
        patched.setattr(tree, "compiled_tree_step", lambda *_: Ending.UNPROVEN)
        return tree_step(problem, tolerance, rows, question)


def _declined() -> dict[str, IKProblem]:
    rng = np.random.default_rng(2)
    tree = ball_chain(rng, 4)
    problem, m = random_problem(rng, tree, bound=1.0), tree.joint_count
    (level,) = problem.levels
    coupled = np.eye(m) + 0.1 * np.ones((m, m))
    row = np.ones((1, m))
    return {
        "a level of a matrix": problem.with_levels([*problem.levels, Level(row, [0.01])]),
        "damping": problem.with_levels([Level(level.matrix, level.target, damping=1e-3)]),
        "soft inequalities": problem.with_levels([*problem.levels, Level(row, [0.0], kind="at_most")]),
        "rows of a matrix": IKProblem(problem.levels, problem.bounds, Rows(row, [0.01])),
        "equalities": IKProblem(problem.levels, equalities=Equalities(row, [0.01])),
        "a metric that couples joints": IKProblem(problem.levels, metric=coupled),
        "noise": IKProblem(problem.levels, noise=1e-9),
        "no level": IKProblem([], problem.bounds),
    }


@pytest.mark.parametrize("what", _declined())
def test_what_the_links_do_not_know_is_solved_by_matrices(what):
    step = _step(_declined()[what], ALONG_LINKS)
    assert step.path != PATH
    assert step.dtheta is not None


def test_problems_on_a_tree_go_to_other_processes_and_their_steps_come_back():
    problem = _random(1)
    there = pickle.loads(pickle.dumps(problem))
    step = pickle.loads(pickle.dumps(_step(there, ALONG_LINKS)))
    assert step.path == PATH
    np.testing.assert_array_equal(step.dtheta, _step(problem, ALONG_LINKS).dtheta)


def test_an_unknown_form_is_refused():
    with pytest.raises(InputError, match="kinematics"):
        SolveOptions(kinematics="lifted")


def test_frozen_joints_and_infinite_sides_mean_what_they_mean_to_matrices():
    rng = np.random.default_rng(3)
    problem = random_problem(rng, ball_chain(rng, 8), 2, contacts=4, bound=0.2)
    lower, upper = problem.bounds.lower.copy(), problem.bounds.upper.copy()
    lower[3:6] = upper[3:6] = 0.01
    upper[10:14] = np.inf
    changed = IKProblem(problem.levels, Bounds(lower, upper), problem.rows)
    step, dense = _step(changed, ALONG_LINKS), _step(changed, BY_MATRICES)
    assert step.path == PATH
    assert step.status is dense.status
    np.testing.assert_allclose(step.dtheta, dense.dtheta, atol=SAME * np.linalg.norm(dense.dtheta))
    np.testing.assert_array_equal(step.dtheta[3:6], 0.01)


# ---- The interior point


def _limited(seed: int, links: int, levels: int = 1) -> IKProblem:
    rng = np.random.default_rng(seed)
    return random_problem(
        rng, ball_chain(rng, links, bend=0.3), levels, contacts=links // 10, bound=0.02, size=2e-3, weights=1.0
    )


def _named(active: ActiveSet, posed: PosedOnTree) -> set[str]:
    joints, rows = posed.problem.bounds.names, posed.problem.rows.names
    bounds = {f"{joints[j]} {'upper' if active.side[j] > 0 else 'lower'}" for j in np.flatnonzero(active.side)}
    return bounds | {rows[i] for i in np.flatnonzero(active.held)}


@pytest.mark.parametrize("seed", range(4))
def test_an_interior_point_tells_the_rows_that_the_optimum_rests_on(seed):
    problem = _limited(seed, 12, 1 + seed % 2)
    posed = PosedOnTree(problem)
    inside = guessed(posed, 0.1)
    dense = _step(problem, BY_MATRICES)
    assert inside is not None
    assert len(dense.active_rows) > 10
    assert len(_named(inside.active, posed) ^ set(dense.active_rows)) <= seed % 2  # one level is told to the last row
    assert ((posed.lower <= inside.u) & (inside.u <= posed.upper)).all()


def test_frozen_joints_and_infinite_sides_are_nothing_to_an_interior_point():
    problem = _limited(4, 12)
    lower, upper = problem.bounds.lower.copy(), problem.bounds.upper.copy()
    lower[3:6] = upper[3:6] = 0.001
    upper[10:14], lower[20] = np.inf, -np.inf
    posed = PosedOnTree(IKProblem(problem.levels, Bounds(lower, upper), problem.rows))
    inside = guessed(posed, 0.1)
    assert inside is not None
    np.testing.assert_array_equal(inside.u[3:6], 0.001)
    found = Search(posed).optimum(inside.active)
    assert found is not None
    np.testing.assert_array_equal(inside.active.side, found.active.side)


@pytest.mark.parametrize("levels", [1, 2])
def test_a_cold_start_with_many_active_limits_takes_few_corrections(levels):
    step = _step(_limited(5, 80, levels), ALONG_LINKS)
    assert step.path == PATH
    assert step.status is StepStatus.SOLVED
    assert len(step.active_rows) > 100
    assert step.repairs < 30


# ---- Arms that are kinked and otherwise nearly straight


def _kinked(seed: int, links: int = 30) -> IKProblem:
    """Two levels of an arm's points: some of them, and all others."""
    rng = np.random.default_rng(seed)
    bend = 10.0 ** rng.uniform(-12, -2) if seed % 2 else 0.0
    tree = ball_chain(rng, links, bend=bend, kinks=int(rng.integers(1, 5)), turned=True)
    ends = np.arange(2, 3 * links - 3, 3)
    points = PointRows.along_axes(tree, ends, tree.anchors[ends + 1], np.eye(3))
    first = np.isin(np.arange(len(ends)), rng.choice(len(ends), size=int(rng.integers(1, 5)), replace=False)).repeat(3)
    return IKProblem([TreeLevel(points[some], rng.normal(scale=0.01, size=some.sum())) for some in (first, ~first)])


@pytest.mark.parametrize("seed", [760077, 760305, 760397])
def test_ranks_that_single_rows_overstate_are_looked_at_anew(seed):
    problem = _kinked(seed)
    overstated, ranks = (Search(PosedOnTree(problem, zero)).ranks for zero in (TREE_ZERO, NEAR_ZERO))
    step, dense = _step(problem, ALONG_LINKS), _step(problem, BY_MATRICES)
    assert overstated[2] >= ranks[2] == dense.levels[1].rank  # by how much hangs on rounding
    assert step.path == PATH
    assert step.status is dense.status
    np.testing.assert_allclose(step.dtheta, dense.dtheta, atol=SAME * np.linalg.norm(dense.dtheta))


@pytest.mark.parametrize("seed", [760095, 760161, 760233, 760265])
def test_what_rounding_of_weak_levels_above_leaves_is_felt_by_no_level(seed):
    # The first level decides a direction so weakly that what it leaves is known to eight digits; matrices are less exact.
    problem = _kinked(seed)
    step, verdict = _step(problem, ALONG_LINKS), judged(problem, ())
    assert step.path == PATH
    assert step.status is StepStatus.CLOSED_FORM
    assert verdict.is_optimum, verdict
    np.testing.assert_allclose(step.dtheta, verdict.u, atol=SAME * np.linalg.norm(verdict.u))


# ---- Limits that hold a level by little


def _weighed_apart(seed: int, links: int) -> IKProblem:
    """An arm in a random posture with the weights of Eq. 23, whose joints that move most may go half as far."""
    settings = WindingSettings(
        arm=Arm(links=links), link=links // 3, posture="random", seed=seed, solver="active-set", options=ALONG_LINKS
    )
    controller, q = WindingController(settings), settings.initial_posture()
    return growth.tightened(controller.problem(q, controller.observe(q, np.zeros(links, dtype=bool))))


@pytest.mark.parametrize(("seed", "links", "limited"), [(760153, 16, 8), (760260, 13, 8)])
def test_limits_that_hold_a_level_by_little_are_told_by_letting_them_go(seed, links, limited, monkeypatch):
    monkeypatch.setattr(growth, "LIMITED", limited)
    problem, told = _weighed_apart(seed, links), []
    asked = Search._told
    monkeypatch.setattr(Search, "_told", lambda *given: told.append(asked(*given)) or told[-1])
    step = _step(problem, ALONG_LINKS)
    assert step.path == PATH
    assert step.status is StepStatus.SOLVED
    assert not told[-1].is_unclear
    verdict = judged(problem, step.active_rows)
    assert verdict.is_optimum, verdict
    np.testing.assert_allclose(step.dtheta, verdict.u, atol=SAME * np.linalg.norm(verdict.u))


# ---- The certificate


class _Proven:
    """A step that rests on bounds and rows, and what its proof is made of."""

    def __init__(self) -> None:
        rng = np.random.default_rng(5)
        self.posed = PosedOnTree(random_problem(rng, ball_chain(rng, 12), 2, contacts=6, bound=0.3, weights=1.0))
        self.factors = self.posed.factors
        found = Search(self.posed).optimum(Search(self.posed).nothing())
        assert found is not None
        self.u, self.active, self.scale = found.u, found.active, found.proof.scale
        assert np.count_nonzero(self.active.side) > 2
        assert self.active.held.any()

    def holds(self, u=None, active=None, posed=None, factors=None) -> bool:
        """Whether the certificate of something else holds, by factors of its own face unless given."""
        posed, active = posed or self.posed, active or self.active
        if factors is None:
            factors = self.factors
            held = np.zeros(len(posed.level), dtype=bool)
            held[posed.parts[0]] = active.held
            factors.factor(active.side != 0, held)
        return TreeProof(posed, factors, self.u if u is None else u, active, self.scale).holds_with_margin


@pytest.fixture(scope="module")
def proven() -> _Proven:
    return _Proven()


def test_the_certificate_of_an_optimum_holds(proven):
    assert proven.holds()


@pytest.mark.parametrize("joint", range(0, 34, 3))
def test_a_step_that_is_off_in_one_joint_by_a_millionth_is_not_proven(proven, joint):
    u = proven.u.copy()
    u[joint] += 1e-6 * proven.scale
    assert not proven.holds(u=u)


def test_a_row_that_pulls_is_not_proven(proven):
    # A joint inside its bounds is taken for active, at a step that is off in it.
    free = np.flatnonzero(proven.active.side == 0)
    for joint in free[:5]:
        found = []
        for sign in (1, -1):
            side = proven.active.side.copy()
            side[joint] = sign
            found.append(proven.holds(active=ActiveSet(side, proven.active.held), u=_nudged(proven, joint)))
        assert found == [False, False]


def _nudged(proven: _Proven, joint: int) -> np.ndarray:
    u = proven.u.copy()
    u[joint] *= 1.01
    return u


def test_a_step_of_too_few_active_rows_is_not_proven(proven):
    at_bound = np.flatnonzero(proven.active.side)
    side = proven.active.side.copy()
    side[at_bound[0]] = 0
    assert not proven.holds(active=ActiveSet(side, proven.active.held))
    held = proven.active.held.copy()
    held[np.flatnonzero(held)[0]] = False
    assert not proven.holds(active=ActiveSet(proven.active.side, held))


@pytest.mark.parametrize("number", [1, 2])
def test_another_target_is_not_proven(proven, number):
    problem = proven.posed.problem
    levels = list(problem.levels)
    level = levels[number - 1]
    levels[number - 1] = type(level)(level.points, level.target + 1e-6, level.weights, level.name)
    assert not proven.holds(posed=PosedOnTree(problem.with_levels(levels)))


def test_a_broken_row_is_not_proven(proven):
    problem = proven.posed.problem
    rows = type(problem.rows)(problem.rows.points, problem.rows.upper - 1e-5, problem.rows.names)
    assert not proven.holds(posed=PosedOnTree(IKProblem(problem.levels, problem.bounds, rows)))


class _Lying(Elimination):
    """Factors that tell a lie about a level's multipliers; about none if it is None."""

    lie: int | None = None

    def pulls(self, level, whitened):
        return super().pulls(level, whitened) * (1.0 + 1e-4 * (level == self.lie))


@pytest.mark.parametrize("level", [HELD, 1, 2])
def test_multipliers_that_are_not_right_leave_a_rest_that_the_figures_show(proven, level):
    held = np.zeros(len(proven.posed.level), dtype=bool)
    held[proven.posed.parts[0]] = proven.active.held
    factors = _Lying(proven.posed.on_joints)
    factors.factor(proven.active.side != 0, held)
    honest = TreeProof(proven.posed, factors, proven.u, proven.active, proven.scale)
    factors.lie = level
    lying = TreeProof(proven.posed, factors, proven.u, proven.active, proven.scale)
    assert honest.holds_with_margin
    assert not lying.holds_with_margin
    assert max(one.excess / other.excess for one, other in zip(lying.levels, honest.levels, strict=True)) > 1e3


def test_both_forms_prove_alike(proven):
    held = np.zeros(len(proven.posed.level), dtype=bool)
    held[proven.posed.parts[0]] = proven.active.held
    nudged = proven.u.copy()
    nudged[np.flatnonzero(proven.active.side == 0)[3]] += 1e-5
    proofs = []
    for form in (Elimination(proven.posed.on_joints), proven.factors):
        form.factor(proven.active.side != 0, held)
        proofs.append(TreeProof(proven.posed, form, nudged, proven.active, proven.scale))
    for one, other in zip(*(proof.levels for proof in proofs), strict=True):
        np.testing.assert_allclose([one.gap, one.excess], [other.gap, other.excess], rtol=1e-4, atol=1e-14)
        np.testing.assert_allclose(one.bounds, other.bounds, rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(one.rows, other.rows, rtol=1e-6, atol=1e-12)
        assert 0.3 < one.rounding / other.rounding < 3.0


class _Rounded(Elimination):
    """Factors that say that rounding feigns a step so long, and that one half as long is to be mended."""

    feigned = 0.0

    def balance(self, level, *given, **known):
        found = super().balance(level, *given, **known)
        return dataclasses.replace(
            found, feigned=max(found.feigned, self.feigned), moved=max(found.moved, 0.5 * self.feigned)
        )


@pytest.mark.parametrize(("feigned", "flat"), [(0.0, False), (0.5, False), (2.0, True)])
def test_an_optimum_that_rounding_moves_by_more_than_itself_is_flat(proven, feigned, flat):
    held = np.zeros(len(proven.posed.level), dtype=bool)
    held[proven.posed.parts[0]] = proven.active.held
    factors = _Rounded(proven.posed.on_joints)
    factors.feigned = feigned * proven.scale
    factors.factor(proven.active.side != 0, held)
    proof = TreeProof(proven.posed, factors, proven.u, proven.active, proven.scale)
    assert proof.is_flat is flat
    assert proof.holds_with_margin is (feigned == 0.0)
    nudged = proven.u.copy()
    nudged[np.flatnonzero(proven.active.side == 0)[3]] += 3.0 * proven.scale
    assert not TreeProof(proven.posed, factors, nudged, proven.active, proven.scale).is_flat


def test_a_flat_optimum_on_limits_is_not_left_to_matrices(monkeypatch):
    problem = _limited(1, 8)
    monkeypatch.setattr(tree, "compiled_tree_step", lambda *_: Ending.UNPROVEN)
    monkeypatch.setattr(_Rounded, "feigned", 1e3)
    monkeypatch.setattr(
        PosedOnTree, "factors", property(lambda posed: posed.__dict__.setdefault("f", _Rounded(posed.on_joints)))
    )
    step = _step(problem, ALONG_LINKS)
    assert step.path == PATH
    assert step.status is StepStatus.UNCERTIFIED
    assert step.certificate.is_optimal
    assert not step.certificate.holds
    np.testing.assert_allclose(step.dtheta, _step(problem, BY_MATRICES).dtheta, atol=SAME * np.linalg.norm(step.dtheta))


def test_the_certificate_names_the_rows_that_hold_a_level():
    problem = _random(1)
    step, dense = _step(problem, ALONG_LINKS), _step(problem, BY_MATRICES)
    assert step.path == PATH
    assert step.certificate is not None
    assert dense.certificate is not None
    assert set(step.certificate.held_by[0]) == set(dense.certificate.held_by[0])


def _spread() -> tuple[IKProblem, float, int]:
    """A chain, its smallest singular value as a fraction of the largest, which no joint shows, and its rank."""
    rng = np.random.default_rng(6)
    problem = random_problem(rng, ball_chain(rng, 8, bend=0.6))
    values = np.linalg.svd(problem.levels[0].points.matrix, compute_uv=False)
    values = values[values > 1e-10 * values[0]]
    return problem, float(values[-1] / values[0]), len(values)


@pytest.mark.parametrize(("part", "path"), [(0.9, True), (1.1, False)])
def test_a_rank_tolerance_that_cuts_what_no_joint_shows_is_left_to_matrices(part, path):
    problem, weakest, rank = _spread()
    tolerance = part * weakest
    options = [SolveOptions(kinematics=form, rank_tolerance=tolerance) for form in ("tree", "dense")]
    step, dense = (_step(problem, option) for option in options)
    assert (step.path == PATH) is path
    assert step.status is dense.status
    assert (dense.levels[0].rank == rank) is path
    np.testing.assert_allclose(step.dtheta, dense.dtheta, atol=SAME * np.linalg.norm(dense.dtheta))


@pytest.mark.parametrize("first", range(0, 40, 10))
def test_with_a_rank_tolerance_steps_are_those_of_matrices(first):
    told = 0
    for seed in range(first, first + 10):
        problem, tolerance = _random(seed), 10.0 ** -(2 + seed % 4)
        step, dense = (
            _step(problem, SolveOptions(kinematics=form, rank_tolerance=tolerance)) for form in ("tree", "dense")
        )
        told += step.path == PATH
        assert step.status is dense.status, seed
        np.testing.assert_allclose(step.dtheta, dense.dtheta, atol=SAME * np.linalg.norm(dense.dtheta), err_msg=str(seed))
    assert told >= 2  # the others have singular values that the tolerance cuts


def test_options_travel(proven):
    assert dataclasses.asdict(ALONG_LINKS)["kinematics"] == "tree"


def _nearly_straight(seed: int, links: int = 7) -> IKProblem:
    rng = np.random.default_rng(seed)
    bend, kinks, turned = 10.0 ** rng.uniform(-14, -4), int(rng.integers(0, 3)), bool(rng.integers(0, 2))
    tree = ball_chain(rng, links, bend=bend, kinks=kinks, turned=turned)
    levels, contacts = int(rng.integers(2, 4)), int(rng.integers(0, 5))
    return random_problem(rng, tree, min(levels, links // 3), contacts=contacts, bound=10.0 ** rng.uniform(-2, -0.5))


@pytest.mark.parametrize("first", [8, 16])
def test_what_is_proven_of_nearly_straight_arms_is_the_optimum_to_150_digits(first):
    proven = 0
    for seed in range(first, first + 8):
        problem = _nearly_straight(seed)
        step = _step(problem, ALONG_LINKS)
        if step.path != PATH or step.status is not StepStatus.SOLVED:
            continue
        proven += 1
        verdict = judged(problem, step.active_rows)
        assert verdict.is_optimum, (seed, verdict)
        np.testing.assert_allclose(step.dtheta, verdict.u, atol=1e-8 * np.linalg.norm(verdict.u), err_msg=str(seed))
    assert proven > 2


def test_the_oracle_of_digits_sees_a_row_too_few_and_one_too_many():
    problem = random_problem(np.random.default_rng(5), ball_chain(np.random.default_rng(5), 6), 2, contacts=3, bound=0.1)
    step = _step(problem, ALONG_LINKS)
    assert len(step.active_rows) > 3
    assert judged(problem, step.active_rows).is_optimum
    assert not any(judged(problem, set(step.active_rows) - {name}).is_optimum for name in step.active_rows[:3])
    free = next(name for name in problem.bounds.names if not any(row.startswith(f"{name} ") for row in step.active_rows))
    assert not any(judged(problem, [*step.active_rows, f"{free} {side}"]).is_optimum for side in ("upper", "lower"))


def _out_of_reach(seed: int, size: float = 1e-9) -> IKProblem:
    """Return a problem whose level misses a millimetre whatever it does, and wants a step of `size` beside that [rad]."""
    rng = np.random.default_rng(seed)
    tree = ball_chain(rng, 8)
    points, m = end_points(tree, rng), tree.joint_count
    missed = rng.normal(scale=1e-3, size=len(points))
    missed -= points.matrix @ np.linalg.lstsq(points.matrix, missed, rcond=1e-10)[0]
    limits = np.where(rng.random(m) < 0.2, 0.3 * size, 1.0)
    return IKProblem([TreeLevel(points, missed + points.matrix @ rng.normal(scale=size, size=m))], Bounds(-limits, limits))


@pytest.mark.parametrize(("seed", "size"), [(770010, 1e-9), (770013, 1e-9), (770016, 1e-9), (770419, 1e-12)])
def test_a_step_is_proven_beside_what_a_level_misses_by_a_million_times_as_much(seed, size, monkeypatch):
    problem = _out_of_reach(seed, size)
    found = tree_step(problem, 0.0)
    assert found is not None
    step, _ = found
    assert step.status is StepStatus.SOLVED
    verdict = judged(problem, step.active_rows)
    assert verdict.is_optimum
    np.testing.assert_allclose(step.dtheta, verdict.u, atol=SAME * np.linalg.norm(verdict.u))
    monkeypatch.setattr(Search, "_finely", lambda self, u, proof, active: (u, proof))
    assert tree_step(problem, 0.0) is None  # doubles do not have the digits


@pytest.mark.parametrize(("upper", "is_optimum"), [(1e-17, True), (1e-3, False)])
def test_to_the_oracle_of_digits_a_limit_that_a_level_is_at_anyway_does_no_harm(upper, is_optimum):
    rng = np.random.default_rng(770001)
    tree = ball_chain(rng, 6)
    points = end_points(tree, rng)
    levels = [TreeLevel(points[:6], np.zeros(6)), TreeLevel(points[6:], np.full(len(points) - 6, 0.01))]
    limits = np.where(np.arange(tree.joint_count) == 1, upper, 1.0)
    problem = IKProblem(levels, Bounds(-np.ones(tree.joint_count), limits))
    assert judged(problem, []).is_optimum
    assert judged(problem, [f"{problem.bounds.names[1]} upper"]).is_optimum is is_optimum


@pytest.mark.parametrize("first", [12, 24])
def test_where_both_forms_prove_a_step_of_a_nearly_straight_arm_it_is_the_same(first):
    for seed in range(first, first + 12):
        problem = _nearly_straight(seed)
        step, dense = _step(problem, ALONG_LINKS), _step(problem, BY_MATRICES)
        if step.status is dense.status is StepStatus.SOLVED:
            np.testing.assert_allclose(
                step.dtheta, dense.dtheta, atol=1e-7 * np.linalg.norm(dense.dtheta), err_msg=str(seed)
            )


@pytest.mark.skipif(library().core is None, reason="there is no compiled core")
@pytest.mark.parametrize("seed", [16, 35, 95, 131])
def test_rows_that_hold_by_rounding_alone_are_no_proof_of_a_nearly_straight_arm(seed):
    problem = _nearly_straight(seed)
    wanted, rng = _step(problem, ALONG_LINKS), np.random.default_rng(seed)
    names = [f"{name} {end}" for end in ("upper", "lower") for name in problem.bounds.names] + list(problem.rows.names)
    for _ in range(40):
        right = [name for name in wanted.active_rows if rng.random() < 0.9]
        wrong = rng.choice(names, rng.integers(1, 4), replace=False)
        step = compiled_step(problem, 0.0, [*right, *wrong])
        if step is not None and step.status is StepStatus.SOLVED:
            np.testing.assert_allclose(step.dtheta, wanted.dtheta, atol=1e-5 * np.linalg.norm(wanted.dtheta))


@pytest.mark.parametrize(
    ("bend", "seed", "turned"), [(4e-11, 2, True), (1e-11, 1, True), (4e-11, 1, True), (1e-11, 1, False)]
)
def test_a_step_of_a_nearly_straight_arm_that_is_proven_keeps_its_limits(bend, seed, turned):
    rng = np.random.default_rng(seed)
    tree = ball_chain(rng, 20, bend=bend)
    if turned:
        turn = rotation(rng.normal(size=3))
        tree = KinematicTree(tree.parents, tree.angular @ turn.T, tree.linear, tree.anchors @ turn.T)
    problem = random_problem(rng, tree, 2, contacts=4, bound=0.05)
    found = tree_step(problem, 0.0)
    if found is not None:
        step, _ = found
        assert step.dtheta is not None
        over = max(np.max(step.dtheta - problem.bounds.upper), np.max(problem.bounds.lower - step.dtheta))
        broken = np.max(problem.rows.matrix @ step.dtheta - problem.rows.upper)
        assert max(over, broken) <= 1e-8 * np.linalg.norm(step.dtheta)
