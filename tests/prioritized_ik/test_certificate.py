"""A certificate holds at the optimum, fails off it, and says how far off and what holds which level back."""

from dataclasses import replace

import numpy as np
import paths
import pytest
from hierarchies import EVERYTHING, KnownHierarchy, random_hierarchy
from tolerances import ROUNDING
from winding_fixtures import constrained_steps, free_steps

from prioritized_ik.errors import InputError
from prioritized_ik.problem import Bounds, Equalities, IKProblem, Level, Rows
from prioritized_ik.solvers.certificate import Certificate, Proof, certify
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.hierarchy import Hierarchy
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.looks import Looks
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.solvers.solve import solve
from prioritized_ik.tolerances import CERTIFIED, FLOOR, GAP, UNDECIDED

CUT = 1e-7  # the planted problems' rank tolerance
OFF = 1e-6  # of a step: a hundred times the tolerance

#: Of the step, what rounding may explain on well-conditioned problems: a tenth of the tolerance. It is 64 roundings, times
#: 1e4 in directions without cost, which count as felt a hundred times weaker, in the conditions and in the displacement.
ALLOWED = 0.1 * CERTIFIED

#: No row in it twice or turned round: the multipliers are unique.
PLAIN = EVERYTHING - {"copies", "thin", "locked", "degenerate"}


def proof(problem: IKProblem, dtheta: object, tolerance: float = CERTIFIED) -> Proof:
    return Proof(Hierarchy(problem), np.array(dtheta, dtype=float), tolerance)


def multipliers(problem: IKProblem, dtheta: object) -> list[dict[str, float]]:
    """By level, the names of the rows that hold it back and their multipliers."""
    names = Hierarchy(problem).rows.names
    levels = proof(problem, dtheta).levels
    return [{names[i]: float(level.multipliers[i]) for i in np.flatnonzero(level.multipliers)} for level in levels]


def moved(step: np.ndarray, size: float, count: int = 10) -> list[np.ndarray]:
    """Steps off by a fraction `size` in random directions and along each joint, both ways."""
    length = size * np.linalg.norm(step)
    random = np.random.default_rng(0).normal(size=(count, len(step)))
    directions = [*(one / np.linalg.norm(one) for one in random), *np.eye(len(step)), *-np.eye(len(step))]
    return [step + length * direction for direction in directions]


# Solved by hand.

#: Joint 1 stops at its bound, half a radian short: λ = 1 - 1/2, and the second joint is where it wants to be.
ONE_BOUND = IKProblem([Level(np.eye(2), [1.0, 1.0], name="reach")], Bounds([-1.0, -1.0], [0.5, 2.0], ["hip", "knee"]))

#: x + y = 2 with both at most 1/2: (A dθ - b) = -1, so λ = (1, 1). Below, z - x = 3 with z at most 1: z - x - 3 = -5/2, so
#: λ of z is 5/2, and x, which level 1 settled, is held for good. Nothing is left to the reference.
THREE_JOINTS = IKProblem(
    [Level([[1.0, 1.0, 0.0]], [2.0], name="sum"), Level([[-1.0, 0.0, 1.0]], [3.0], name="gap")],
    Bounds([-9.0] * 3, [0.5, 0.5, 1.0], ["x", "y", "z"]),
)

#: x at most 1/5, softly, with weight 4; a hard row asks for 2 x >= 1: an excess of 3/10, λ = 4 · 3/10. Then y = 1 is met.
SOFT = IKProblem(
    [Level([[1.0, 0.0]], [0.2], [4.0], "slow", "at_most"), Level([[0.0, 1.0]], [1.0], name="reach")],
    rows=Rows([[-2.0, 0.0]], [-1.0], ["far enough"]),
)

#: The same without the hard row: x = 1 is stopped by the soft row, on the step's way from the level below it.
SOFT_STOPS = IKProblem(
    [Level([[2.0, 0.0]], [0.4], [4.0], "slow", "at_most"), Level(np.eye(2), [1.0, 1.0], name="reach")],
)

#: x + y = 1 as an equality, on which the reference (1, 1) would have x = 1/2; the bound holds x at 1/4.
EQUAL = IKProblem(
    [Level([[0.0, 0.0, 1.0]], [2.0], name="reach")],
    Bounds([-9.0] * 3, [0.25, 9.0, 9.0], ["x", "y", "z"]),
    reference=[1.0, 1.0, 0.0],
    equalities=Equalities([[1.0, 1.0, 0.0]], [1.0], ["closed"]),
)

BY_HAND = {
    "one bound": (ONE_BOUND, [0.5, 1.0], [{"hip upper": 0.5}, {}]),
    "three joints": (
        THREE_JOINTS,
        [0.5, 0.5, 1.0],
        [{"x upper": 1.0, "y upper": 1.0}, {"z upper": 2.5}, {}],
    ),
    "a soft level that gives way": (SOFT, [0.5, 1.0], [{"far enough": 1.2}, {}, {}]),
    "a soft level that does not": (SOFT_STOPS, [0.2, 1.0], [{}, {"slow row 1": 0.8}, {}]),
    # The last level's gradient (-3/4, -1/4) has the product -1/2 with (1, -1), the one direction left; so λ (1, 0) has 1/2.
    "an equality": (EQUAL, [0.25, 0.75, 2.0], [{}, {"x upper": 0.5}]),
}
by_hand = pytest.mark.parametrize(("problem", "optimum", "wanted"), BY_HAND.values(), ids=BY_HAND.keys())


@by_hand
def test_the_optimum_is_certified_with_its_multipliers_and_what_holds_each_level(problem, optimum, wanted):
    certificate = certify(problem, optimum)
    assert certificate.holds
    assert certificate.worst <= CERTIFIED * 1e-3
    assert certificate.violation == 0.0
    found = multipliers(problem, optimum)
    assert len(found) == len(problem.levels) + 1
    above: set[str] = set()  # those that hold a level above have any multiplier
    for names, one, other in zip(certificate.held_by, found, wanted, strict=True):
        assert set(names) - above == set(other)
        assert {name: value for name, value in one.items() if name not in above} == pytest.approx(other, rel=ROUNDING)
        above |= set(other)


@by_hand
def test_a_step_off_by_a_millionth_is_not_certified(problem, optimum, wanted):
    for step in moved(np.array(optimum), OFF):
        assert not certify(problem, step).holds


@by_hand
def test_the_step_is_the_one_that_the_solver_finds(problem, optimum, wanted):
    step = solve(problem)
    assert step.dtheta == pytest.approx(optimum, abs=ROUNDING)
    assert newly_held(step.certificate.held_by) == newly_held(certify(problem, optimum).held_by)


def newly_held(by_level: tuple[tuple[str, ...], ...]) -> list[set[str]]:
    """The rows that hold each level and none above; those that do may have any multiplier below, or none."""
    return [set(names) - {name for above in by_level[:number] for name in above} for number, names in enumerate(by_level)]


def test_the_levels_of_a_proof_are_named_and_the_last_one_is_the_last_level():
    assert [level.level for level in proof(THREE_JOINTS, [0.5, 0.5, 1.0]).levels] == ["sum", "gap", "last level"]


# Signs, in the order of levels.


def test_a_row_that_holds_a_level_may_pull_the_wrong_way_below():
    # At level 1 x stops at 1; the level below would leave the bound, and may not.
    problem = IKProblem([Level([[1.0, 0.0]], [2.0]), Level([[1.0, 0.0]], [-1.0])], Bounds([-9.0] * 2, [1.0, 9.0]))
    certificate = certify(problem, [1.0, 0.0])
    assert certificate.holds
    assert certificate.held_by == (("joint 1 upper",), (), ())


def test_a_row_whose_first_multiplier_is_negative_is_not_certified():
    # The first level does not feel x: at the second, x on its bound would rather leave.
    problem = IKProblem([Level([[0.0, 1.0]], [1.0]), Level([[1.0, 0.0]], [-1.0])], Bounds([-9.0] * 2, [1.0, 9.0]))
    certificate = certify(problem, [1.0, 1.0])
    assert not certificate.holds
    assert certificate.held_by == ((), (), ())
    # The level's whole way, from 1 to -1, over a step of length √2.
    assert certificate.stationarity == pytest.approx((0.0, 2.0 / np.sqrt(2.0), 0.0), rel=ROUNDING)
    assert certify(problem, [-1.0, 1.0]).holds


def test_of_two_rows_only_the_one_that_a_level_above_presses_on_may_pull_the_wrong_way():
    # Level 1 presses on x; level 2 would have both joints leave their bounds.
    levels = [Level([[1.0, 0.0]], [2.0]), Level(np.eye(2), [0.0, 0.0])]
    problem = IKProblem(levels, Bounds([-9.0] * 2, [1.0, 1.0]))
    assert not certify(problem, [1.0, 1.0]).holds
    assert certify(problem, [1.0, 0.0]).holds
    assert not certify(problem, [0.0, 0.0]).holds


@pytest.mark.parametrize("pull", [-3.0, -0.5, 0.5, 3.0])
def test_rows_that_leave_each_other_no_room_need_no_sign_at_all(pull):
    # x + y <= 1, -x - y <= -1: an equality in disguise.
    rows = Rows([[1.0, 1.0], [-1.0, -1.0]], [1.0, -1.0])
    problem = IKProblem([Level([[1.0, 1.0]], [1.0 + pull]), Level([[1.0, 0.0]], [0.2])], rows=rows)
    certificate = certify(problem, [0.2, 0.8])
    assert certificate.holds
    assert certificate.held_by == (("row 1",) if pull > 0.0 else ("row 2",), (), ())
    assert not certify(problem, [0.2 + OFF, 0.8 - OFF]).holds


def test_the_last_level_counts_like_any_other():
    problem = IKProblem([Level([[1.0, 0.0]], [1.0])], reference=[0.0, 0.5])
    assert certify(problem, [1.0, 0.5]).holds
    figures = certify(problem, [1.0, 0.5 + 1e-3]).stationarity
    assert figures == pytest.approx((0.0, 1e-3 / np.hypot(1.0, 0.501)), rel=1e-9, abs=1e-12)


# Figures.


@pytest.mark.parametrize("slope", [1.0, 1e-1, 1e-3])
@pytest.mark.parametrize("weight", [1e-3, 1.0, 1e3])
def test_the_figure_of_a_level_is_how_far_the_step_is_from_its_optimum_however_little_the_level_feels_it(slope, weight):
    problem = IKProblem([Level(np.diag([1.0, slope]), [3.0, 4.0 * slope], [1.0, weight])])
    for off in (1e-2, 1e-4, 1e-6):
        certificate = certify(problem, [3.0, 4.0 + 5.0 * off])
        # The step is longer by as much, and what rounding may explain is taken off.
        assert certificate.stationarity[0] == pytest.approx(off, rel=2.0 * off, abs=ALLOWED)
        assert certificate.worst == certificate.stationarity[0]
        assert not certificate.holds


def test_the_displacement_of_a_level_leads_to_its_optimum():
    rng = np.random.default_rng(1)
    matrix, reference = rng.normal(size=(3, 6)), rng.normal(size=6)
    problem = IKProblem([Level(matrix, rng.normal(size=3), [0.5, 1.0, 20.0])], reference=reference)
    step = rng.normal(size=6)
    first, last = proof(problem, step).levels
    assert matrix @ (step + first.displacement) == pytest.approx(problem.levels[0].target, abs=ROUNDING)
    assert step + first.displacement + last.displacement == pytest.approx(Hierarchy(problem).closed_form, abs=ROUNDING)


@pytest.mark.parametrize("excess", [1e-3, 1e-6, 1e-9, 0.0])
def test_the_violation_is_the_worst_of_all_hard_rows_as_a_fraction_of_the_step(excess):
    step = np.array([0.5 + excess, 1.0])
    certificate = certify(ONE_BOUND, step)
    assert certificate.violation == pytest.approx(excess / np.linalg.norm(step), rel=1e-6)
    assert certificate.violation == ONE_BOUND.relative_violation(step)
    assert certificate.holds == (excess <= 1e-9)


def test_a_row_that_is_broken_holds_a_level_like_one_that_the_step_ends_on():
    certificate = certify(ONE_BOUND, [0.6, 1.0])
    assert certificate.violation == pytest.approx(0.1 / np.hypot(0.6, 1.0), rel=ROUNDING)
    assert certificate.stationarity == pytest.approx((0.0, 0.0), abs=ROUNDING)
    assert certificate.held_by == (("hip upper",), ())


def test_the_violation_of_an_equality_counts_too():
    step = np.array([0.25, 0.75 + 1e-3, 2.0])
    assert certify(EQUAL, step).violation == pytest.approx(1e-3 / np.sqrt(2.0) / np.linalg.norm(step), rel=1e-9)


def test_an_exceeded_soft_row_is_no_violation():
    assert certify(SOFT, [0.5, 1.0]).violation == 0.0


def test_the_worst_figure_decides():
    none = (0.0, 0.0, 0.0)
    figures = {"stationarity": (0.0, 3e-9, 2e-8), "rounding": (0.0, 1e-7, 0.0), "held_by": ((), (), ())}
    figures |= {"gaps": none, "relative_gaps": none}
    assert Certificate(0.0, **figures).worst == 2e-8
    assert Certificate(5e-8, **figures).worst == 5e-8
    assert not Certificate(0.0, **figures).holds
    assert Certificate(0.0, **figures, tolerance=2e-8).holds
    assert not Certificate(3e-8, **figures, tolerance=2e-8).holds


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5, 1e-7])
@by_hand
def test_the_tolerance_is_what_a_step_may_be_off_by(problem, optimum, wanted, tolerance):
    assert certify(problem, optimum, tolerance=tolerance).holds
    for step in moved(np.array(optimum), 0.1 * tolerance):
        assert certify(problem, step, tolerance=tolerance).worst <= tolerance
    for step in moved(np.array(optimum), 100.0 * tolerance):
        certificate = certify(problem, step, tolerance=tolerance)
        assert certificate.tolerance == tolerance
        assert not certificate.holds


@pytest.mark.parametrize("size", [1.0, 1e-9, 9e-13, 1e-30, 1e-90])
def test_standing_still_is_no_answer_to_a_level_that_asks_for_a_tiny_step(size):
    problem = IKProblem([Level(np.eye(2), [size, 0.0])], Bounds([-1.0, -1.0], [1.0, 1.0]))
    assert certify(problem, [size, 0.0]).holds
    assert not certify(problem, [0.0, 0.0]).holds
    assert not certify(problem, [size * (1.0 + OFF), 0.0]).holds


def test_standing_still_counts_as_a_billionth_of_what_the_levels_ask_for():
    problem = IKProblem([Level(np.eye(2), [3.0, 0.0])])
    assert certify(problem, [0.0, 0.0]).stationarity[0] == pytest.approx(1.0 / FLOOR, rel=1e-6)
    assert certify(IKProblem([Level(np.eye(2), [0.0, 0.0])]), [0.0, 0.0]).holds


def scaled(problem: IKProblem, factor: float) -> IKProblem:
    """The problem of a step that is `factor` times as long."""
    levels = [Level(one.matrix, factor * one.target, one.weights, one.name, one.kind) for one in problem.levels]
    bounds = Bounds(factor * problem.bounds.lower, factor * problem.bounds.upper, problem.bounds.names)
    rows = Rows(problem.rows.matrix, factor * problem.rows.upper, problem.rows.names)
    equalities = Equalities(problem.equalities.matrix, factor * problem.equalities.target)
    return IKProblem(levels, bounds, rows, factor * problem.reference, equalities)


def assert_alike(found: Certificate, wanted: Certificate, factor: float, last: float | None = None) -> None:
    """All figures are the same, but for costs, which are as the squares of lengths; the last level's has its own unit."""
    units = [factor] * (len(wanted.gaps) - 1) + [factor if last is None else last]
    gaps = tuple(unit**2 * gap for unit, gap in zip(units, wanted.gaps, strict=True))
    assert found == replace(wanted, gaps=gaps)


@pytest.mark.parametrize("seed", range(20))
def test_figures_are_relative_to_the_step(seed):
    known = random_hierarchy(seed, EVERYTHING - {"scales"}, joints=(2, 25))
    rng = np.random.default_rng(seed)
    for off in (0.0, 1e-6, 1e-2):
        step = known.dtheta * (1.0 + off * rng.normal(size=len(known.dtheta)))
        certificate = certify(known.problem, step, CUT)
        for factor in (2.0**-10, 2.0**10):
            assert_alike(certify(scaled(known.problem, factor), factor * step, CUT), certificate, factor)
        for factor in (1e-3, 1e3):
            other = certify(scaled(known.problem, factor), factor * step, CUT)
            assert other.holds == certificate.holds
            # Rounding moves figures by a hundredth of the tolerance at most.
            assert other.stationarity == pytest.approx(certificate.stationarity, rel=1e-6, abs=1e-2 * CERTIFIED)
            assert other.violation == pytest.approx(certificate.violation, rel=1e-6, abs=ROUNDING)


@pytest.mark.parametrize("factor", [2.0**-20, 2.0**20])
@by_hand
def test_figures_do_not_depend_on_the_units_of_levels_and_rows(problem, optimum, wanted, factor):
    levels = [Level(factor * one.matrix, factor * one.target, one.weights, one.name, one.kind) for one in problem.levels]
    heavy = [Level(one.matrix, one.target, factor**2 * one.weights, one.name, one.kind) for one in problem.levels]
    rows = Rows(factor * problem.rows.matrix, factor * problem.rows.upper, problem.rows.names)
    equalities = Equalities(factor * problem.equalities.matrix, factor * problem.equalities.target)
    for step in (np.array(optimum), *moved(np.array(optimum), 1e-4, count=3)):
        certificate = certify(problem, step)
        for others in (levels, heavy):
            other = certify(IKProblem(others, problem.bounds, rows, problem.reference, equalities), step)
            assert_alike(other, certificate, factor, last=1.0)


# Problems built backwards from their optimum.


def planted(known: KnownHierarchy, hierarchy: Hierarchy) -> list[np.ndarray]:
    """The multipliers of all pooled rows, by level, as they were chosen."""
    found = [np.zeros(len(hierarchy.rows.upper)) for _ in range(len(known.problem.levels) + 1)]
    for press in known.presses:
        kind, number = press.kind, press.index + 1
        name = f"row {number}" if kind == "row" else f"joint {number} {kind}"
        if kind.startswith("soft"):
            name = f"{known.problem.levels[int(kind.split()[1])].name} row {number}"
        length = np.linalg.norm(press.row(known.problem)[0])
        found[press.level][hierarchy.rows.names.index(name)] = press.multiplier * length
    return found


def size_of_terms(known: KnownHierarchy, number: int) -> float:
    """Of what the conditions of a level are the difference."""
    if number == len(known.problem.levels):
        return float(np.linalg.norm(known.dtheta) + np.linalg.norm(known.problem.reference))
    level = known.problem.levels[number]
    residual = np.abs(level.matrix) @ np.abs(known.dtheta) + np.abs(level.target)
    return float(np.linalg.norm(np.abs(level.matrix.T) @ (level.weights * residual)))


@pytest.mark.parametrize("seed", range(60))
def test_the_multipliers_are_those_that_were_planted(seed):
    known = random_hierarchy(seed, PLAIN, joints=(2, 25))
    hierarchy = Hierarchy(known.problem, CUT)
    levels = Proof(hierarchy, known.dtheta).levels
    held = np.zeros(len(hierarchy.rows.upper), dtype=bool)
    for number, (level, wanted) in enumerate(zip(levels, planted(known, hierarchy), strict=True)):
        off = np.where(held, 0.0, level.multipliers - wanted)  # below, a row that is held for good has any multiplier
        assert np.abs(off).max(initial=0.0) <= ROUNDING * size_of_terms(known, number)
        held |= wanted > 0.0


def test_the_rows_that_hold_a_level_are_those_that_were_planted():
    for seed in range(60):
        known = random_hierarchy(seed, PLAIN, joints=(2, 25))
        hierarchy = Hierarchy(known.problem, CUT)
        held_by = Proof(hierarchy, known.dtheta).certificate.held_by
        above: set[str] = set()
        for names, wanted in zip(held_by, planted(known, hierarchy), strict=True):
            pressing = {hierarchy.rows.names[i] for i in np.flatnonzero(wanted)}
            assert set(names) - above == pressing
            above |= pressing


def test_a_level_that_is_met_is_held_back_by_nothing():
    # 0.1 x - 0.1 y = 0.05 is met at the bound, where the reference holds x.
    level, bounds = Level([[0.1, -0.1]], [0.05], name="reach"), Bounds([-np.inf] * 2, [0.6, np.inf])
    step = solve(IKProblem([level], bounds, reference=[1.6, 0.1]))
    assert step.costs[0] <= 1e-30
    assert step.certificate.held_by == ((), ("joint 1 upper",))


@pytest.mark.parametrize("seed", range(40))
def test_every_planted_optimum_is_certified_unless_rounding_leaves_it_undecided(seed):
    known = random_hierarchy(seed)
    certificate = certify(known.problem, known.dtheta, CUT)
    assert certificate.is_optimal
    assert certificate.holds or certificate.variation > UNDECIDED


def test_rounding_leaves_next_to_no_planted_optimum_undecided():
    certificates = [certify(known.problem, known.dtheta, CUT) for known in map(random_hierarchy, range(40))]
    assert sum(certificate.holds for certificate in certificates) >= 36


@pytest.mark.parametrize("seed", range(20))
def test_the_proof_knows_which_rows_the_step_ends_on(seed):
    known = random_hierarchy(seed, joints=(2, 25))
    hierarchy = Hierarchy(known.problem, CUT)
    ends_on = Proof(hierarchy, known.dtheta).ends_on
    slack = hierarchy.rows.slack(known.dtheta)
    near = 1e-9 * np.linalg.norm(known.dtheta)
    assert (np.abs(slack[ends_on & (hierarchy.rows.level < 0)]) <= near).all()
    assert (slack[~ends_on] > near).all()
    for wanted in planted(known, hierarchy):
        assert ends_on[wanted > 0.0].all()


@pytest.mark.parametrize("seed", range(20))
def test_a_row_that_pulls_most_is_the_one_that_should_not_be_held(seed):
    # One idle row made tight on top of the optimum of what presses.
    rng = np.random.default_rng(seed)
    optimum = rng.normal(size=5)
    row = rng.normal(size=5)
    row /= np.linalg.norm(row)
    bounds = Bounds(np.full(5, -np.inf), np.append(optimum[0] - 0.3, np.full(4, np.inf)))
    problem = IKProblem([Level(np.eye(5), optimum)], bounds, Rows([row], [row @ optimum + 2.0]))
    on_both = np.append(bounds.upper[0], optimum[1:])
    on_both = on_both + (problem.rows.upper - row @ on_both) / (1.0 - row[0] ** 2) * (row - row[0] * np.eye(5)[0])
    level = proof(problem, on_both).levels[0]
    names = problem.inequalities.names
    assert names[next(level.pulls(np.array([True, True])))] == "row 1"
    assert list(level.pulls(np.array([True, False]))) == []
    assert list(level.pulls(np.array([False, False]))) == []


# Rounding.


@pytest.mark.parametrize("joints", [2, 5, 10])
@pytest.mark.parametrize("seed", range(5))
def test_rounding_explains_next_to_nothing_on_well_conditioned_problems(joints, seed):
    rng = np.random.default_rng([seed, joints])
    matrix = np.linalg.qr(rng.normal(size=(joints, joints - 1)))[0].T
    optimum = rng.normal(size=joints)
    bounds = Bounds(np.full(joints, -np.inf), np.where(np.arange(joints) < joints // 2, optimum, np.inf))
    problem = IKProblem([Level(matrix, matrix @ optimum)], bounds, reference=rng.normal(size=joints))
    for level in proof(problem, solve(problem).dtheta).levels:
        assert level.rounding <= ALLOWED * np.linalg.norm(optimum)
        assert np.linalg.norm(level.displacement) <= ROUNDING * np.linalg.norm(optimum)


def test_the_certificate_says_how_much_of_a_step_rounding_may_feign():
    for problem, optimum, _ in BY_HAND.values():
        found = proof(problem, optimum)
        wanted = [level.rounding / np.linalg.norm(optimum) for level in found.levels]
        assert found.certificate.rounding == tuple(wanted)
        assert max(wanted) <= ALLOWED


@pytest.mark.parametrize("seed", range(40))
def test_rounding_explains_all_that_is_left_at_the_optimum(seed):
    known = random_hierarchy(seed)
    for level in Proof(Hierarchy(known.problem, CUT), known.dtheta).levels:
        assert level.excess == np.linalg.norm(level.displacement)
        assert level.excess <= ROUNDING * np.linalg.norm(known.dtheta)


@pytest.mark.parametrize("far", [1e2, 1e4, 1e6])
def test_what_a_level_wants_and_cannot_have_does_not_cover_an_error_elsewhere(far):
    # The first joint stops at 1 of `far`. The second, 1/2, is off by a millionth: a million times its own rounding.
    problem = IKProblem([Level(np.eye(3)[:2], [far, 0.5])], Bounds([-1.0] * 3, [1.0] * 3))
    assert certify(problem, [1.0, 0.5, 0.0]).holds
    assert not certify(problem, [1.0, 0.5 + OFF, 0.0]).holds


# One kind of check at a time: each of these steps passes all checks but one.

#: Two rows that meet in a wedge of 3e-9: both are 1e-8 away at most, and still leave the level all of its way.
WEDGE = IKProblem(
    [Level([[1.0, 0.0, 0.0]], [1.0])],
    rows=Rows([[0.0, 1.0, 0.0], [3e-9, -1.0, 0.0]], [0.0, 9.9e-9]),
    equalities=Equalities([[0.0, 0.0, 1.0]], [1.0]),
)
#: A row that the level above holds still, but for 3e-7 of its length; it is 1e-8 away, which is 3 % of a
#: step for level 2.
NEARLY_PARALLEL = IKProblem(
    [Level([[1.0, 0.0]], [1.0]), Level([[0.0, 1.0]], [0.03])], rows=Rows([[1.0, 3.2e-7]], [1.0 + 9.9e-9])
)
#: Level 1 wants ten million times what the bound of x allows. Its share of y is weak, but nothing else decides y.
FAR = IKProblem([Level([[1.0, 0.0], [0.0, 2e-4]], [1e7, 1e-4])], Bounds([-1.0, -1.0], [1.0, 1.0]))
#: y at its bound, which holds nothing back.
LEFT_ALONE = IKProblem([Level(np.eye(2), [1.0, 0.2])], Bounds([-9.0, -9.0], [9.0, 0.5]))

MISSED = {
    "violation": (ONE_BOUND, [0.5 + 1e-6, 1.0], [0.5, 1.0]),
    "stationarity": (ONE_BOUND, [0.5, 1.0 - 1e-6], [0.5, 1.0]),
    "stationarity of a soft level": (SOFT, [0.5 + 1e-6, 1.0], [0.5, 1.0]),
    "sign of a multiplier": (LEFT_ALONE, [1.0, 0.5], [1.0, 0.2]),
    "slackness in a wedge": (WEDGE, [0.0, 0.0, 1.0], [1.0, 0.0, 1.0]),
    "slackness of a row nearly parallel to the level above": (NEARLY_PARALLEL, [1.0, 0.0], [1.0, 0.03]),
    "a weak direction of a level that wants far more than it gets": (FAR, [1.0, 0.5 - 4e-4], [1.0, 0.5]),
}


@pytest.mark.parametrize(("problem", "missing", "optimum"), MISSED.values(), ids=MISSED.keys())
def test_a_step_that_misses_one_condition_only_is_not_proven_and_the_optimum_is(problem, missing, optimum):
    assert not certify(problem, missing).holds
    assert not certify(problem, missing).is_optimal or certify(problem, missing).variation > UNDECIDED
    assert certify(problem, optimum).holds


@pytest.mark.parametrize("name", ["violation", "stationarity", "sign of a multiplier"])
def test_what_a_step_misses_is_the_figure_that_says_so(name):
    problem, missing, _ = MISSED[name]
    certificate = certify(problem, missing)
    assert (certificate.violation > CERTIFIED) == (name == "violation")
    assert (max(certificate.stationarity) > CERTIFIED) == (name != "violation")


@pytest.mark.parametrize("name", [name for name in MISSED if name.startswith("slackness")])
def test_rows_merely_near_balance_every_gradient_but_not_the_gap(name):
    problem, missing, _ = MISSED[name]
    certificate = certify(problem, missing)
    assert certificate.worst <= CERTIFIED  # all other conditions hold
    assert max(certificate.relative_gaps) > GAP or certificate.variation > UNDECIDED


@pytest.mark.parametrize("name", MISSED)
def test_the_gap_is_no_less_than_what_the_level_still_gains(name):
    problem, missing, optimum = MISSED[name]
    if name == "violation":
        return  # the bound is on steps that keep the rows
    certificate, best = certify(problem, missing), np.array(optimum)
    for level, gap in zip(problem.levels, certificate.gaps, strict=False):
        gain = level.cost(np.array(missing)) - level.cost(best)
        assert gain <= gap * (1.0 + ROUNDING) + ROUNDING * level.cost(best)
        if gain > ROUNDING * level.cost(best):
            break  # levels below pay for it


@pytest.mark.parametrize("off", [1e-4, 4e-4, 1e-3, 5e-3])
def test_what_a_level_cannot_have_does_not_hide_an_error_in_its_weak_direction(off):
    assert not certify(FAR, [1.0, 0.5 - off]).holds


def sliver(narrow: float, room: float) -> IKProblem:
    """Level 1 wants x = 1 within a triangle of height `room` and of length room / narrow either way along x."""
    rows = Rows([[0.0, 1.0, 0.0], [narrow, -1.0, 0.0], [-narrow, -1.0, 0.0]], [0.0, room, room])
    return IKProblem([Level([[1.0, 0.0, 0.0]], [1.0]), Level([[0.0, 0.0, 1.0]], [1.0])], rows=rows)


SLIVERS = [(3e-9, 6e-9), (1e-8, 9e-9), (1e-8, 2e-9), (3e-8, 9e-9), (1e-7, 9e-9), (1e-6, 9e-9), (1e-5, 9e-9), (1e-4, 9e-9)]


@pytest.mark.parametrize(("narrow", "room"), SLIVERS)
def test_the_far_end_of_a_sliver_is_not_proven(narrow, room):
    far = min(1.0, room / narrow)
    assert not certify(sliver(narrow, room), [-0.9 * far, 0.0, 1.0]).holds
    assert not certify(sliver(narrow, room), [0.0, 0.0, 1.0]).holds


@pytest.mark.parametrize(("narrow", "room"), SLIVERS)
def test_in_a_sliver_the_near_end_is_found_and_proven(narrow, room):
    far = min(1.0, room / narrow)
    for solver in ("active-set", "daqp", "quadprog"):
        step = solve(sliver(narrow, room), solver)
        assert step.certificate.holds
        assert step.dtheta == pytest.approx([far, 0.0, 1.0], rel=1e-6, abs=1e-15)


@pytest.mark.parametrize("last", [False, True])
@pytest.mark.parametrize("seed", range(10))
def test_a_step_between_two_near_rows_states_how_far_it_is_from_the_one_that_pushes(seed, last):
    """Two opposite rows, nearer than the tolerance, of which the lower levels feel little: the middle is no optimum."""
    rng = np.random.default_rng(seed)
    weak, room = 10.0 ** rng.uniform(-3, -1), 0.4 * CERTIFIED
    wide = np.array([1.0, weak, 0.0])
    levels = [Level([[1.0, 0.0, 0.0]], [0.0]), Level([[0.0, 0.0, 1.0]], [1.0])]
    pushing = [] if last else [Level([[0.0, 1.0, 0.0]], [9.0])]
    problem = IKProblem([*levels, *pushing], rows=Rows([wide, -wide], [0.0, room]), reference=[0.0, 9.0, 0.0])
    step = solve(problem)
    assert step.dtheta == pytest.approx([0.0, 0.0, 1.0], abs=1e-14)
    assert step.certificate.holds
    middle = np.array([0.0, -0.5 * room / weak, 1.0])
    stated = certify(problem, middle)
    assert stated.variation >= 0.499 * room / weak
    assert not stated.holds or stated.variation <= UNDECIDED


@pytest.mark.parametrize(("asked", "holds"), [(1e-18, True), (1e-12, False)])
def test_a_level_that_asks_for_the_rounding_of_what_others_ask_asks_for_nothing(asked, holds):
    """As of robots at rest: feet are where they belong but for rounding, and hands that cannot move are far from theirs."""
    row = [[0.6, 0.8, 0.0]]
    problem = IKProblem([Level(row, [asked]), Level(row, [0.2])])
    assert certify(problem, np.zeros(3)).holds is holds
    assert solve(problem).certificate.holds


def test_a_bound_broken_by_twice_its_size_is_told_however_small_it_is():
    problem = IKProblem([Level(np.eye(2), [1e-9, 0.0])], Bounds([-1.0, -1.0], [5e-13, 1.0]))
    assert not certify(problem, [1.4e-12, 0.0]).holds
    assert certify(problem, [5e-13, 0.0]).holds


# Whose step it is does not matter.


@pytest.mark.usefixtures("python_path")
@pytest.mark.parametrize("seed", range(5))
def test_a_certificate_does_not_depend_on_which_solver_made_the_step(seed):
    known = random_hierarchy(seed, joints=(2, 25))
    for polish in (True, False):
        options = SolveOptions(rank_tolerance=CUT, closed_form_first=False, polish=polish)
        certificates = set()
        for solver in ("daqp", "proxqp", "clarabel"):
            step = get_method(solver).step(known.problem, options)
            assert step.certificate == certify(known.problem, step.dtheta, CUT)
            certificates.add(step.certificate)
        assert len(certificates) == 1 or not polish


@pytest.mark.usefixtures("python_path")
def test_the_steps_of_a_winding_are_certified_from_problem_and_step_alone():
    for problem in (*free_steps(), *constrained_steps()):
        step = solve(problem, options=SolveOptions(rank_tolerance=RANK_TOLERANCE))
        assert certify(problem, step.dtheta, RANK_TOLERANCE) == step.certificate
        assert step.certificate.holds
        for other in moved(step.dtheta, 1e-5, count=2)[:2]:
            assert not certify(problem, other, RANK_TOLERANCE).holds


# Input.


@pytest.mark.parametrize(
    ("dtheta", "message"),
    [
        ([1.0], r"dtheta has shape \(1,\); expected \(2,\)"),
        ([[1.0, 2.0]], r"dtheta has shape \(1, 2\); expected \(2,\)"),
        ([1.0, np.nan], r"dtheta\[1\] is nan"),
        ([np.inf, 0.0], r"dtheta\[0\] is inf; expected finite numbers only"),
        (["a", "b"], "dtheta is not an array of numbers"),
    ],
    ids=["short", "a matrix", "nan", "inf", "text"],
)
def test_a_step_that_is_none_is_refused(dtheta, message):
    with pytest.raises(InputError, match=message):
        certify(ONE_BOUND, dtheta)


@pytest.mark.parametrize("tolerance", [0.0, -1e-8, 1.0, np.nan])
def test_a_tolerance_out_of_range_is_refused(tolerance):
    with pytest.raises(InputError, match=f"tolerance is {tolerance}; expected a number above 0 and below 1"):
        certify(ONE_BOUND, [0.5, 1.0], tolerance=tolerance)


def test_a_rank_tolerance_out_of_range_is_refused():
    with pytest.raises(InputError, match=r"rank_tolerance is 1\.0"):
        certify(ONE_BOUND, [0.5, 1.0], rank_tolerance=1.0)


def test_a_step_may_be_a_plain_list():
    assert certify(ONE_BOUND, [0.5, 1.0]) == certify(ONE_BOUND, np.array([0.5, 1.0]))


def test_the_rank_tolerance_is_part_of_the_problem():
    # A direction of 1e-5 is a task to the one, and the reference's to the other.
    problem = IKProblem([Level(np.diag([1.0, 1e-5]), [1.0, 1e-5])])
    assert certify(problem, [1.0, 0.0], rank_tolerance=1e-4).holds
    assert not certify(problem, [1.0, 1.0], rank_tolerance=1e-4).holds
    assert certify(problem, [1.0, 1.0], rank_tolerance=1e-6).holds
    assert not certify(problem, [1.0, 0.0], rank_tolerance=1e-6).holds


@pytest.mark.parametrize("seed", range(10))
def test_a_proof_in_a_search_is_the_whole_one_up_to_the_first_level_that_is_off(seed):
    known = random_hierarchy(seed)
    hierarchy = Hierarchy(known.problem)
    for off, u in [(False, known.dtheta), *((True, step) for step in moved(known.dtheta, 1e-3, 3))]:
        whole, searching = Proof(hierarchy, u), Proof(hierarchy, u, searching=True)
        ends = next((i for i, level in enumerate(whole.levels, 1) if level.is_off), len(whole.levels))
        assert len(searching.levels) == ends
        assert all(
            np.array_equal(a.displacement, b.displacement) for a, b in zip(searching.levels, whole.levels, strict=False)
        )
        assert searching.certificate.holds == whole.certificate.holds
        assert searching.certificate.is_optimal == whole.certificate.is_optimal
        assert off or ends == len(whole.levels)


@pytest.mark.parametrize("is_soft", [False, True])
def test_a_row_broken_within_tolerance_that_hardly_moves_leaves_the_step_open(is_soft: bool) -> None:
    turn = 2.0**-27
    row, side = [[1.0, turn]], [1.0 + turn / 2.0]
    levels = [Level([[1.0, 0.0]], [1.0]), Level([[0.0, 1.0]], [1.0])]
    soft = IKProblem([Level(row, side, kind="at_most"), *levels])
    certificate = certify(soft if is_soft else IKProblem(levels, rows=Rows(row, side)), [1.0, 1.0])
    assert certificate.violation < 1e-8
    assert certificate.variation > 0.5 / np.sqrt(2.0) * 0.99  # the optimum is (1, 0.5)
    assert not certificate.holds


@pytest.mark.parametrize("broken", [1e-13, 1e-12, 1e-11])
@pytest.mark.parametrize("path", ["python", "compiled"])
def test_a_closed_form_that_breaks_a_row_that_hardly_moves_is_not_the_step(path: str, broken: float) -> None:
    turn = 2.0**-30
    side = 1.0 + turn - broken
    levels = [Level([[1.0, 0.0]], [1.0]), Level([[0.0, 1.0]], [1.0])]
    problem = IKProblem(levels, rows=Rows([[1.0, turn]], [side]))
    with paths.only(path):
        step = solve(problem)
    assert step.certificate is not None
    assert step.certificate.holds
    assert step.dtheta == pytest.approx([1.0, (side - 1.0) / turn], abs=1e-6)


def test_what_an_equality_misses_within_tolerance_counts_in_the_gap() -> None:
    problem = IKProblem([Level([[1.0, 0.0]], [11.0])], equalities=Equalities([[1.0, 0.0]], [1.0]))
    certificate = certify(problem, [1.0 - 5e-9, 0.0])
    assert certificate.violation < 1e-8
    assert certificate.gaps[0] >= (1.0 - 1e-6) * ((10.0 + 5e-9) ** 2 - 100.0)


def test_what_a_weak_level_settles_is_not_settled_for_those_above() -> None:
    # Rows 1 and 2 leave a wedge that a long way along z opens: level 1 can be met, and misses by 8191 without it.
    rows = [[0.0, 1.0, 0.0], [2.0**-13, -1.0, 0.0], [-3 * 2.0**-31, 1.0 + 3 * 2.0**-31, 2.0**-31]]
    levels = [Level([[1.0, 0.0, 0.0]], [0.0]), Level([[0.0, 0.0, 1.0]], [1.0])]
    weak = Level([[3.0, -(2.0**-22), -(2.0**-22)]], [-1.0])
    limits = Rows(rows, [0.0, 2.0**-13, -1.0 + 9 * 2.0**-32])
    shut = [-8191.093711017985, -1.0000114395660806, 1.0]
    assert not certify(IKProblem(levels, rows=limits), shut).holds
    assert not certify(IKProblem([*levels, weak], rows=limits), shut).holds


def test_a_step_that_is_plainly_off_is_not_looked_at_with_more_digits(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = constrained_steps()[0]
    step = solve(problem, options=SolveOptions(rank_tolerance=RANK_TOLERANCE)).dtheta
    monkeypatch.setattr(Looks, "_closer", None)
    for size in (1e-1, 1e-3, 1e-5):
        for other in moved(step, size, 3)[:3]:
            assert not certify(problem, other, RANK_TOLERANCE).is_optimal
