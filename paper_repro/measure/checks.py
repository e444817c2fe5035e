"""One check a fact: what we have in the place of what the paper states.

A check returns `Ours`: a value to hold against the paper's, or for a claim whether it holds, and the figure that shows it.
Checks of `STATIC` need the model alone and run in one job; those of `WOUND` look at finished windings.
"""

import itertools
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from paper_repro.make.artefact import Scale
from paper_repro.make.jobs import Job, Results
from paper_repro.measure import audit
from paper_repro.measure.planar_cases import CASES, PLANAR, case_arm
from paper_repro.measure.posed import VIRTUAL_ARMS_OF, VIRTUAL_ENDS, relative_error
from paper_repro.measure.windings import (
    LONG,
    METHODS,
    SHORT,
    counted,
    is_within_range,
    measured_job,
    settings,
    story_job,
)
from prioritized_ik.models import DIRECTIONS, Arm
from prioritized_ik.problem import IKProblem, Level
from prioritized_ik.solvers import closed_form as solve
from prioritized_ik.validation import Array
from prioritized_ik.weights import diagonal_of_weights, winding_weights
from prioritized_ik.winding import plan
from prioritized_ik.winding.controller import WindingController
from prioritized_ik.winding.episode import Outcome, wind
from prioritized_ik.winding.settings import WindingSettings

EXACT = 1e-12  # errors up to this are rounding
SOLVED = 1e-9  # the same after a solve with weights that differ by a factor of 2e4
CLEAR = 1e-3  # what is not rounding is larger than this

QUITE = 0.1  # paths whose lengths differ by less than a tenth are not "quite different"
EVERY = 10  # a recorded state in ten is enough to compare the weights at
TILT = 0.3  # [rad] of the object that is wound in space
ELLIPSOID: dict[str, Any] = {"shape": "ellipsoid", "size": (0.06, 0.09, 0.2)}  # [m] no radius of it is the cylinder's
WEIGHTS = ("eq23", "eq24")


@dataclass(frozen=True)
class Ours:
    """What a check gives.

    Attributes:
        value: as JSON; of a claim whether it holds; None if there is nothing to hold it against.
        figure: what shows it, in a few words.
    """

    value: Any
    figure: str = ""


@dataclass(frozen=True)
class Windings:
    """Windings by method, weights and direction, as `windings.story` tells them, and those of the other objects."""

    scale: Scale
    results: Results

    def told(self, method: str, weights: str) -> dict[str, dict[str, Any]]:
        """Return the stories by direction."""
        return {d: self.results[winding_job(method, weights, d)] for d in directions(self.scale)}

    def all_told(self) -> list[dict[str, Any]]:
        """Return the stories of every method, weights and direction."""
        return [story for pair in itertools.product(METHODS, WEIGHTS) for story in self.told(*pair).values()]


STATIC: dict[str, Callable[[], Ours]] = {}
WOUND: dict[str, Callable[[Windings], Ours]] = {}


def static(name: str) -> Callable[[Callable[[], Ours]], Callable[[], Ours]]:
    """Enter a check that needs the model alone."""

    def enter(check: Callable[[], Ours]) -> Callable[[], Ours]:
        STATIC[name] = check
        return check

    return enter


def wound(name: str) -> Callable[[Callable[[Windings], Ours]], Callable[[Windings], Ours]]:
    """Enter a check that looks at windings."""

    def enter(check: Callable[[Windings], Ours]) -> Callable[[Windings], Ours]:
        WOUND[name] = check
        return check

    return enter


def directions(scale: Scale) -> tuple[str, ...]:
    """Return where objects come from in the windings that are checked: every direction, or one in the quick run."""
    return scale.directions[:1] if scale.quick else scale.directions


def jobs(scale: Scale) -> list[Job]:
    """Return all that the checks need."""
    windings = [
        winding_job(method, weights, direction)
        for method, weights, direction in itertools.product(METHODS, WEIGHTS, directions(scale))
    ]
    short = [job for weights in WEIGHTS for job in short_jobs(scale, weights)]
    return [Job(run_static), *windings, *short, *free_end_jobs(scale), TILTED, OTHER_OBJECT]


def run_static() -> dict[str, dict[str, Any]]:
    """Return what every check of `STATIC` gives, by its name."""
    return {name: asdict(check()) for name, check in STATIC.items()}


def run_checks(scale: Scale, results: Results) -> dict[str, Ours]:
    """Return what every check gives, by its name."""
    windings = Windings(scale, results)
    still = {name: Ours(**given) for name, given in results[Job(run_static)].items()}
    return still | {name: check(windings) for name, check in WOUND.items()}


def _holds(error: float, allowed: float = EXACT) -> Ours:
    return Ours(bool(error <= allowed), f"error {error:.0e}")


# Section 2


@static("four-link arm with three virtual arms")
def _fig_1() -> Ours:
    return Ours([VIRTUAL_ARMS_OF.links, len(VIRTUAL_ENDS)])


@static("actual arm is the last virtual arm")
def _last_arm() -> Ours:
    arm = audit.posed()
    tip = arm.bases[-1] + Arm().link_length * arm.directions[-1]
    return _holds(relative_error(arm.positions[-1], tip))


@static("redundant")
def _redundant() -> Ours:
    arm = audit.posed()
    return Ours(arm.model.nv > arm.arms.dimension, f"m = {arm.model.nv}, l = {arm.arms.dimension}")


@static("staircase")
def _staircase() -> Ours:
    blocks = audit.posed().jacobian.reshape(audit.N, 3, audit.M)
    beyond = max(float(np.abs(block[:, 3 * link :]).max(initial=0.0)) for link, block in enumerate(blocks, 1))
    return Ours(beyond == 0.0, f"largest entry beyond an end point's joints: {beyond:g}")


@static("inner Jacobian")
def _inner() -> Ours:
    errors = _errors("2")
    printed, implemented = errors["printed"], errors["implemented"]
    holds = printed is not None and printed <= EXACT
    return Ours(holds, f"error up to {printed:.0%} as printed, {implemented:.0e} as implemented")


@static("virtual work")
def _virtual_work() -> Ours:
    return _holds(_implemented("4–5"), audit.DIFFERENCE)


@static("stiffness shapes")
def _stiffness_shapes() -> Ours:
    from prioritized_ik.virtual_arms import joint_stiffness

    jacobian = audit.posed().jacobian
    k_v = np.eye(len(jacobian))
    return Ours([len(joint_stiffness(jacobian, k_v)), len(k_v)])


def _errors(equation: str) -> audit.Measured:
    (row,) = [row for row in audit.ROWS if row.equation == equation]
    return row.measure()


def _implemented(equation: str) -> float:
    error = _errors(equation)["implemented"]
    return np.inf if error is None else error


# Section 3


@static("planar arm")
def _planar() -> Ours:
    arm = case_arm(CASES["a"])
    return Ours([arm.model.nv, arm.arms.dimension])


def _rank(jacobian: Array) -> int:
    return int(np.linalg.matrix_rank(jacobian, tol=solve.RANK_TOLERANCE * np.linalg.norm(jacobian, 2)))


@static("case a")
def _case_a() -> Ours:
    jacobian = case_arm(CASES["a"]).jacobian
    return Ours([len(jacobian), _rank(jacobian)])


@static("case a, singular")
def _case_a_singular() -> Ours:
    straight = _rank(case_arm(CASES["a"], np.zeros(PLANAR.joint_count)).jacobian)
    return Ours(straight < 2 * len(CASES["a"].points), f"rank {straight} with the arm straight")


@static("case b")
def _case_b() -> Ours:
    arm = case_arm(CASES["b"])
    return Ours([arm.arms.count, len(arm.jacobian), _rank(arm.jacobian)])


@static("case b, no solution")
def _case_b_unsolved() -> Ours:
    jacobian = case_arm(CASES["b"]).jacobian
    return _unsolved(jacobian, np.random.default_rng(32).normal(size=len(jacobian)))


@static("case c")
def _case_c() -> Ours:
    ranks = [_rank(case_arm(CASES["c"], points=points).jacobian) for points in (None, ["middle of link 5", "end_5"])]
    return Ours(max(ranks) < 4, f"rank {ranks[0]} with the point at joint 5, {ranks[1]} in the middle of link 5")


@static("decomposition")
def _decomposition() -> Ours:
    jacobian = audit.posed().jacobian
    factors = solve.rank_decomposition_svd(jacobian)
    ranks = [_rank(matrix) for matrix in (jacobian, factors.j_a, factors.j_b)]
    error = relative_error(factors.j_a @ factors.j_b, jacobian)
    return Ours(len({*ranks, factors.rank}) == 1 and error <= EXACT, f"ranks {ranks}, product within {error:.0e}")


def _unsolved(matrix: Array, target: Array) -> Ours:
    left = target - matrix @ np.linalg.lstsq(matrix, target, rcond=None)[0]
    share = float(np.linalg.norm(left) / np.linalg.norm(target))
    return Ours(share > CLEAR, f"{share:.0%} of a drawn request is out of reach")


@static("overconstrained part")
def _overconstrained_part() -> Ours:
    j_a = solve.rank_decomposition_svd(audit.posed().jacobian).j_a
    return _unsolved(j_a, np.random.default_rng(34).normal(size=len(j_a)))


@static("underconstrained part")
def _underconstrained_part() -> Ours:
    j_b = solve.rank_decomposition_svd(audit.posed().jacobian).j_b
    dx_b = np.random.default_rng(35).normal(size=len(j_b))
    return _holds(relative_error(j_b @ solve.minimum_norm_solution(j_b, dx_b), dx_b))


@static("weights are positive")
def _positive_weights() -> Ours:
    least = min(float(winding_weights(k, audit.N, kind).min()) for k in range(audit.N + 1) for kind in WEIGHTS)
    return Ours(least > 0.0, f"least {least:g}")


@static("weights are priorities")
def _weights_are_priorities() -> Ours:
    jacobian = case_arm(CASES["b"]).jacobian
    desired = np.random.default_rng(36).normal(size=len(jacobian))
    factors = solve.rank_decomposition_svd(jacobian)
    residuals = []
    for weight in (0.01, 1.0, 100.0, 1e4):
        weights = diagonal_of_weights([1.0, 1.0, weight, 1.0, 1.0], 2)
        step = audit.eqs_12_and_14(factors, weights, desired)
        residuals.append(float(np.linalg.norm((desired - jacobian @ step)[4:6])))
    falls = bool((np.diff(residuals) < 0.0).all())
    return Ours(falls, "residual of its arm for weights 0.01 … 1e4: " + ", ".join(f"{r:.1e}" for r in residuals))


@static("r is zero")
def _r_is_zero() -> Ours:
    reference = IKProblem([Level(np.eye(2), np.zeros(2))]).reference
    return Ours(float(np.abs(reference).max()))


@static("r is free")
def _r_is_free() -> Ours:
    jacobian, weights, desired = audit.request(1)
    factors = solve.rank_decomposition_svd(jacobian)
    dx_b = solve.weighted_optimum(factors.j_a, weights, desired)
    plain = solve.minimum_norm_solution(factors.j_b, dx_b)
    other = solve.general_solution(factors.j_b, dx_b, np.random.default_rng(37).normal(size=audit.M))
    moved, joints = relative_error(jacobian @ other, jacobian @ plain), relative_error(other, plain)
    return Ours(moved <= SOLVED and joints > CLEAR, f"end points change by {moved:.0e}, joints by {joints:.0e}, relative")


@static("minimum norm")
def _minimum_norm() -> Ours:
    jacobian, weights, desired = audit.request(1)
    factors, rng = solve.rank_decomposition_svd(jacobian), np.random.default_rng(38)
    dx_b = solve.weighted_optimum(factors.j_a, weights, desired)
    norms = [
        float(np.linalg.norm(solve.general_solution(factors.j_b, dx_b, r)))
        for r in (np.zeros(audit.M), *rng.normal(scale=0.01, size=(100, audit.M)))
    ]
    return Ours(min(norms[1:]) > norms[0], f"{norms[0]:.3f} rad; at least {min(norms[1:]):.3f} rad with 100 drawn r")


@static("redundant case")
def _redundant_case() -> Ours:
    jacobian = case_arm(CASES["a"]).jacobian
    desired = np.random.default_rng(39).normal(size=len(jacobian))
    weights = diagonal_of_weights([7.0, 1.0], 2)
    found = audit.eqs_12_and_14(solve.rank_decomposition_svd(jacobian), weights, desired)
    return _holds(relative_error(np.linalg.pinv(jacobian) @ desired, found), SOLVED)


@static("overconstrained case")
def _overconstrained_case() -> Ours:
    jacobian = case_arm(CASES["b"]).jacobian
    desired = np.random.default_rng(40).normal(size=len(jacobian))
    weights = diagonal_of_weights([7.0, 1.0, 3.0, 0.5, 2.0], 2)
    found = audit.eqs_12_and_14(solve.rank_decomposition_svd(jacobian), weights, desired)
    return _holds(relative_error(audit.normal_equations(jacobian, weights, desired), found), SOLVED)


@static("equal priorities")
def _equal_priorities() -> Ours:
    jacobian = case_arm(CASES["b"]).jacobian
    desired = np.random.default_rng(41).normal(size=len(jacobian))
    # Arms 1 and 2 leave no more than three joints; 3, 4 and 5 share what is left, and conflict.
    weights = diagonal_of_weights([1e4, 1e4, 1.0, 1.0, 1.0], 2)
    step = audit.eqs_12_and_14(solve.rank_decomposition_svd(jacobian), weights, desired)
    slope = jacobian.T @ (weights * (desired - jacobian @ step))
    scale = np.abs(jacobian.T * weights) @ np.abs(desired)
    return _holds(float(np.abs(slope).max() / scale.max()))


# Section 4.2


@static("task space of winding")
def _task_space() -> Ours:
    return Ours(WindingController(WindingSettings()).arms.dimension)


@static("end points at link ends")
def _ends() -> Ours:
    arm = audit.posed()
    ends = arm.bases + Arm().link_length * arm.directions
    at_ends = np.linalg.norm(arm.positions - ends, axis=1) <= EXACT
    return Ours(int(np.count_nonzero(at_ends)))


@static("only the next arm is driven")
def _only_next() -> Ours:
    wrong = 0
    for first, last in itertools.combinations_with_replacement(range(1, audit.N + 1), 2):
        touching = (np.arange(1, audit.N + 1) >= first) & (np.arange(1, audit.N + 1) <= last)
        driven = (np.flatnonzero(plan.driven_arms(touching)) + 1).tolist()
        wrong += driven != ([last + 1] if last < audit.N else [])
    return Ours(wrong == 0, f"{wrong} exceptions in all runs of links in contact")


@static("wound arms come first")
def _wound_first() -> Ours:
    least = min(
        float(weights[:k].min() / weights[k:].max())
        for kind, k in itertools.product(WEIGHTS, range(1, audit.N))
        for weights in [winding_weights(k, audit.N, kind)]
    )
    return Ours(least > 1.0, f"at least {least:g} times any other weight")


@static("two equilibria")
def _equilibria() -> Ours:
    at_rest = audit.resting_states(audit.N)
    kinds = {"free" if not s.any() else "winding" if (np.diff(s.astype(int)) >= 0).all() else "other" for s in at_rest}
    return Ours(len(kinds), f"{len(at_rest)} of the {2**audit.N} contact states, {' or '.join(sorted(kinds))}")


@static("direction needs contact")
def _direction_needs_contact() -> Ours:
    lengths, without = [], 0.0
    for before, contact, after in audit.scenes():
        lengths.append(np.linalg.norm(_alpha(before, contact, after)))
        without = max(without, float(np.linalg.norm(_alpha(before, np.zeros(3), after))))
    figure = (
        f"length {min(lengths):.2f} to {max(lengths):.2f}, {without:g} without; also 0 if the contact is head-on, c ∥ a"
    )
    return Ours(min(lengths) > CLEAR and without == 0.0, figure)


def _alpha(before: Array, contact: Array, after: Array) -> Array:
    e = plan.plane_normal(before, contact)
    return plan.winding_direction(plan.into_plane(plan.side_sign(after, e), e), plan.towards_object(after, e))


@static("normal of the plane")
def _normal() -> Ours:
    return _holds(_implemented("22"))


@static("into the plane")
def _into_plane() -> Ours:
    nearer = []
    for before, contact, after in audit.scenes():
        e = plan.plane_normal(before, contact)
        into = plan.into_plane(plan.side_sign(after, e), e)
        nearer.append(not into.any() or abs((after + CLEAR * into) @ e) < abs(after @ e))
    return Ours(all(nearer), f"nearer to P in {sum(nearer)} of {len(nearer)} drawn contacts")


@static("towards the object")
def _towards() -> Ours:
    inside, towards = 0.0, []
    for before, contact, after in audit.scenes():
        e = plan.plane_normal(before, contact)
        gamma = plan.towards_object(after, e)
        inside = max(inside, abs(float(gamma @ e)))
        towards.append(float(-contact @ gamma))
    return Ours(
        inside <= EXACT and min(towards) > 0.0, f"γ·e within {inside:.0e}; γ·(−c) {min(towards):.2f} to {max(towards):.2f}"
    )


@static("index of a")
def _index() -> Ours:
    largest = max(abs(float(before @ plan.plane_normal(before, contact))) for before, contact, _ in audit.scenes())
    return Ours(largest > CLEAR, f"largest |a^i·e^(i−1)| so: {largest:.0e}")


@static("planned in parallel")
def _parallel() -> Ours:
    rng, given = np.random.default_rng(44), {"speed": 2.0, "dt": 1.0}
    directions, contacts, touching = audit.unit(45, audit.N), audit.unit(46, audit.N), rng.random(audit.N) < 0.5
    moves, _ = plan.plan(directions, contacts, touching, **given)
    changed = 0
    for i in range(1, audit.N):
        others = np.setdiff1d(np.arange(audit.N), (i - 1, i))
        a, c, m = directions.copy(), contacts.copy(), touching.copy()
        a[others], c[others], m[others] = audit.unit(47, len(others)), audit.unit(48, len(others)), ~m[others]
        changed += not np.array_equal(plan.plan(a, c, m, **given)[0][i], moves[i])
    return Ours(changed == 0, f"{changed} of {audit.N - 1} arms changed their plan when all links but i − 1 and i did")


# Section 4.3


@static("links")
def _links() -> Ours:
    return Ours(len(audit.posed().directions))


@static("joints")
def _joints() -> Ours:
    return Ours(int(audit.posed().model.nv))


@static("ball joints")
def _balls() -> Ours:
    arm = audit.posed()
    balls = 3 * (audit.M // 3)
    anchors, axes = arm.joint_anchors[:balls].reshape(-1, 3, 3), arm.joint_axes[:balls].reshape(-1, 3, 3)
    apart = float(np.abs(anchors - anchors[:, :1]).max())
    volume = float(np.abs(np.linalg.det(axes)).min())
    figure = f"{len(anchors)} balls; axes meet within {apart:g} m and span at least {volume:.2f} of a cube"
    return Ours(apart <= EXACT and volume > CLEAR, figure)


@static("link length")
def _link_length() -> Ours:
    points = np.vstack([np.zeros(3), audit.posed().positions])
    return Ours(float(np.linalg.norm(np.diff(points, axis=0), axis=1).mean()))


@static("rows")
def _rows() -> Ours:
    return Ours(len(diagonal_of_weights(winding_weights(6, Arm().links), 3)))


@static("shape")
def _shape() -> Ours:
    return Ours(WindingSettings().shape)


@static("diameter")
def _diameter() -> Ours:
    return Ours(2.0 * float(WindingSettings().model().geom("object").size[0]))


@static("eta")
def _eta() -> Ours:
    return Ours(WindingSettings().speed)


def _groups(kind: str) -> Ours:
    values = winding_weights(6, audit.N, kind).tolist()
    return Ours(list(dict.fromkeys(values)))


@static("weights of Eq. 23")
def _eq23() -> Ours:
    return _groups("eq23")


@static("weights of Eq. 24")
def _eq24() -> Ours:
    return _groups("eq24")


@static("k of the weights")
def _k() -> Ours:
    wrong = 0
    for state in itertools.product((False, True), repeat=10):
        text = "".join("1" if touch else " " for touch in state)
        last = text.index("1") + len(text.split()[0]) if text.strip() else 0
        wrong += plan.first_and_last_in_contact(np.array(state))[1] != last
    return Ours(wrong == 0, f"{wrong} exceptions in all states of ten links; links beyond a gap do not count")


@static("four directions")
def _directions() -> Ours:
    return Ours(len(DIRECTIONS))


# Windings


def winding_job(method: str, weights: str, direction: str) -> Job:
    """Return the job of one winding with the default settings."""
    return story_job(settings(method, weights=weights, direction=direction))


TILTED = story_job(settings(tilt=TILT))
OTHER_OBJECT = measured_job(settings(**ELLIPSOID))


@wound("same initial pose")
def _same_pose(windings: Windings) -> Ours:
    poses = [story["q"][0] for story in windings.all_told()]
    apart = float(np.ptp(np.array(poses), axis=0).max())
    return Ours(apart == 0.0, f"{len(poses)} windings start within {apart:g} rad")


@wound("stops at equilibrium")
def _stops(windings: Windings) -> Ours:
    outcomes = [story["outcome"] for story in windings.all_told()]
    stopped = outcomes.count(Outcome.WOUND.name)
    return Ours(stopped == len(outcomes), f"{stopped} of {len(outcomes)} windings, closed form and QP, both weights")


@wound("k becomes n")
def _k_becomes_n(windings: Windings) -> Ours:
    stories = windings.all_told()
    ended = [story["wound_to"][-1] == audit.N for story in stories]
    falls = sum(int((np.diff(story["wound_to"]) < 0).sum()) for story in stories)
    return Ours(all(ended), f"in {sum(ended)} of {len(stories)} windings; k falls back {falls} times on the way")


def _how_wound(stories: list[dict[str, Any]]) -> str:
    """Return in words in how many of windings the arm is wound, in each of the three terms, and the worst figures."""
    turns, depth = min(s["turns_ratio"] or 0.0 for s in stories), max(s["penetration"] for s in stories)
    contact, turned, within = counted(stories)
    return (
        f"of {len(stories)} all links in contact {contact}, by turns and depth {turned}, within a joint's range {within}; "
        f"worst: {turns:.0%} of the ideal turns, {_depth(depth)}, bend {max(s['bend'] for s in stories):.2f} rad"
    )


def _depth(penetration: float) -> str:
    """Return a penetration [m] for people; what is negative is how far links stayed off."""
    return f"penetration {1e3 * penetration:.1f} mm" if penetration > 0.0 else f"clearance {-1e3 * penetration:.1f} mm"


def short_jobs(scale: Scale, weights: str) -> list[Job]:
    """Return the windings by the closed form that have less than a turn to go, by direction."""
    return [measured_job(settings("closed form", link=SHORT, weights=weights, direction=d)) for d in directions(scale)]


def _by_turns(windings: Windings, *kinds: str) -> Ours:
    """Return whether the closed form winds from every direction, by turns and depth, with less than a turn to go."""
    short = [windings.results[job] for weights in kinds for job in short_jobs(windings.scale, weights)]
    long = [story for weights in kinds for story in windings.told("closed form", weights).values()]
    figure = (
        f"first link {SHORT}: {_how_wound(short)}. First link {LONG}, with more than a turn to wind: {_how_wound(long)}"
    )
    return Ours(counted(short)[1] == len(short), figure)


@wound("winds, closed form")
def _winds_closed_form(windings: Windings) -> Ours:
    return _by_turns(windings, "eq23")


@wound("winds with both weights")
def _winds_both(windings: Windings) -> Ours:
    return _by_turns(windings, *WEIGHTS)


@wound("winds, with limits")
def _winds_with_limits(windings: Windings) -> Ours:
    stories = [story for weights in WEIGHTS for story in windings.told("qp", weights).values()]
    return Ours(counted(stories)[2] == len(stories), f"first link {LONG}: {_how_wound(stories)}")


def free_end_jobs(scale: Scale) -> list[Job]:
    """Return the jobs that compare what the weights do to free ends, by direction."""
    chosen = [settings("closed form", link=SHORT, direction=direction) for direction in directions(scale)]
    return [Job(free_ends, {"settings": each.to_json()}) for each in chosen]


def free_ends(settings: str) -> list[list[float]]:
    """Return how far Eqs. 24 and 23 each move arms in one step from the same state [m].

    Of each state: by Eq. 24 and by Eq. 23 the end points k + 2 … n together, and by each of them the driven one, k + 1. The
    states are those of a winding, one in `EVERY`, as long as such end points are left.
    """
    episode = wind(WindingSettings.from_json(settings))
    moves = []
    for step in range(0, episode.steps, EVERY):
        k = plan.first_and_last_in_contact(episode.in_contact[step])[1]
        if k + 1 < audit.N:
            jacobian, desired = episode.jacobian[step], episode.desired[step]
            factors = solve.rank_decomposition_svd(jacobian)
            weights = [diagonal_of_weights(winding_weights(k, audit.N, kind), 3) for kind in WEIGHTS]
            moved = [jacobian @ audit.eqs_12_and_14(factors, each, desired) for each in weights]
            first, second = (dx.reshape(-1, 3) for dx in moved)
            parts = (second[k + 1 :], first[k + 1 :], second[k], first[k])
            moves.append([float(np.linalg.norm(part)) for part in parts])
    return moves


@wound("free ends hold")
def _free_ends_hold(windings: Windings) -> Ours:
    by_direction = [np.array(windings.results[job]) for job in free_end_jobs(windings.scale)]
    totals = [moves[:, 0].sum() / moves[:, 1].sum() for moves in by_direction]
    after, before, driven_after, driven_before = np.concatenate(by_direction).T
    free, driven = after / before, driven_after / driven_before
    figure = (
        f"closed form from link {SHORT}, from the same states: {max(totals):.2f} times as far at most, summed over a "
        f"winding; by state {np.median(free):.2f} in the median, {free.min():.2f} to {free.max():.2f}, further in "
        f"{int((free > 1.0 + EXACT).sum())} of {len(free)}; the driven arm {np.median(driven):.2f}, {driven.min():.2f} to "
        f"{driven.max():.2f}"
    )
    return Ours(bool(max(totals) < 1.0), figure)


@wound("free ends differ")
def _free_ends_differ(windings: Windings) -> Ours:
    short = {w: [windings.results[job] for job in short_jobs(windings.scale, w)] for w in WEIGHTS}
    long = {w: list(windings.told("qp", w).values()) for w in WEIGHTS}
    ratios = {}
    for name, paths in ((f"closed form from link {SHORT}", short), (f"QP from link {LONG}", long)):
        pairs = zip(paths["eq24"], paths["eq23"], strict=True)
        ratios[name] = [after["tail_path"] / before["tail_path"] for after, before in pairs]
    differ = all(abs(ratio - 1.0) > QUITE for each in ratios.values() for ratio in each)
    figure = "; ".join(f"{method} {', '.join(f'{ratio:.2f}' for ratio in each)}" for method, each in ratios.items())
    return Ours(differ, f"path of the arm's end, Eq. 24 over Eq. 23, by direction: {figure}")


@wound("winds in space")
def _in_space(windings: Windings) -> Ours:
    story = windings.results[TILTED]
    ends = np.array(story["positions"][-1])[settings(tilt=TILT).link - 1 :]
    centred = ends - ends.mean(axis=0)
    thickness = float(np.ptp(centred @ np.linalg.svd(centred)[2][-1]))  # across the plane that fits them best
    turns = f"{story['turns_ratio']:.0%} of the ideal turns"
    figure = f"tilt {TILT} rad: {turns}, wound ends up to {1e3 * thickness:.0f} mm apart across their best plane"
    return Ours(is_within_range(story) and thickness > Arm().radius, figure)


@wound("winds unknown objects")
def _unknown(windings: Windings) -> Ours:
    story = windings.results[OTHER_OBJECT]
    # There is no ideal for what is not round: links stopped by contact alone, once round at least, must do.
    figure = f"{story['turns']:.2f} turns, {_depth(story['penetration'])}"
    return Ours(story["outcome"] == Outcome.WOUND.name and story["turns"] >= 1.0, figure)


# What is not stated, where a default alone does not say it


@static("axis of joint 49")
def _joint_49() -> Ours:
    model = audit.posed().model
    body, axis = int(model.jnt_bodyid[-1]), "xyz"[int(np.argmax(np.abs(model.jnt_axis[-1])))]
    return Ours(None, f"at the base of link {body}, about its {axis}")


@static("meaning of the directions")
def _meaning() -> Ours:
    signs = {1.0: "+", -1.0: "−"}
    words = [f"{name} {signs[v[i]]}{'xyz'[i]}" for name, v in DIRECTIONS.items() for i in range(3) if v[i]]
    return Ours(None, ", ".join(words))


@static("length of the cylinder")
def _length_of_cylinder() -> Ours:
    return Ours(None, f"{2.0 * WindingSettings().size[1]:g} m")


@static("sense of c")
def _sense() -> Ours:
    state = WindingController(WindingSettings())
    touch = state.observe(WindingSettings().initial_posture(), np.zeros(audit.N, dtype=bool))
    touching = int(np.argmax(touch.in_contact))
    place = WindingSettings().wound_object().position
    into_link = float(touch.contact_vectors[touching] @ (touch.touch.point[touching] - place)) > 0.0
    return Ours(None, "from the object into the link" if into_link else "from the link into the object")
