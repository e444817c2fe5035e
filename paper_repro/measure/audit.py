"""The audit of Eqs. 1-24: each as printed and as implemented, held against an answer that comes by another way.

One function a row measures the relative error of both forms. The other ways share no code with the library: geometry,
finite differences, requests built backwards from a chosen answer, NumPy's pseudoinverse, linear systems of optimality
conditions, and enumeration of every contact state.
"""

import inspect
import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from paper_repro.measure.posed import PosedArm, general_pose, relative_error
from prioritized_ik.errors import InputError
from prioritized_ik.models import PLANAR_ARM, Arm
from prioritized_ik.problem import Level
from prioritized_ik.solvers import closed_form as solve
from prioritized_ik.validation import Array
from prioritized_ik.virtual_arms import VirtualArms, jacobian_of_inner_arm, joint_stiffness, joint_torques
from prioritized_ik.weights import diagonal_of_weights, winding_weights
from prioritized_ik.winding import plan
from prioritized_ik.winding.settings import WindingSettings

ARM = Arm()
L, M, N = 3 * ARM.links, ARM.joint_count, ARM.links
RANK = L - N  # every link end keeps its distance from the one before: n of the L rows follow from the others
POSES = (1, 2, 3)  # seeds of the general poses, the worst of which counts
FIRST_FREE = 8  # k of the requests: links 1 … 8 hold the object, arm 9 is driven

ROUNDING = 1e-12  # a few hundred double operations lose 3 digits of 16 at most
DIFFERENCE_STEP = 1e-5  # [rad] the cube root of rounding, where truncation and cancellation are both near 1e-10
DIFFERENCE = 1e-7  # what a central difference with that step can tell
SOLVED = 1e-9  # the weights alone spread W^½ over a factor of 141, and J's singular values over another thousand
SQUARED = 1e-7  # where the inverse of J_aᵀWJ_a is formed: the condition number of W^½J_a is 1e4, and enters squared

Measured = dict[str, float | None]


@dataclass(frozen=True)
class Row:
    """One row of the audit.

    Attributes:
        equation: its number; a word more where an equation has several rows.
        printed: the printed form, shortened, as the scan has it.
        functions: what implements it.
        differs: why the implemented form is another; empty if it is the printed one.
        test: what both are held against.
        allowed: relative error up to which the implemented form agrees with that.
        allowed_printed: the same of the printed form, evaluated as it is written.
        measure: returns the errors `printed` and `implemented`, None where there is nothing to compute.
    """

    equation: str
    printed: str
    functions: tuple[Callable[..., Any], ...]
    differs: str
    test: str
    allowed: float
    allowed_printed: float
    measure: Callable[[], Measured]

    @property
    def numbers(self) -> tuple[int, ...]:
        """The equations that it audits."""
        head = self.equation.partition(" ")[0]
        first, _, last = head.partition("–")
        return tuple(range(int(first), int(last or first) + 1))

    @property
    def names(self) -> str:
        """What implements it, for people: `VirtualArms.jacobian`, `plan.plane_normal`."""
        return ", ".join(f"`{function.__qualname__}`" for function in self.functions)


ROWS: list[Row] = []


def audits(
    equation: str,
    printed: str,
    *functions: Callable[..., Any],
    test: str,
    differs: str = "",
    allowed: float = ROUNDING,
    allowed_printed: float | None = None,
) -> Callable[[Callable[[], Measured]], Callable[[], Measured]]:
    """Enter a measuring function as a row of the audit: see `Row`."""

    def enter(measure: Callable[[], Measured]) -> Callable[[], Measured]:
        as_written = allowed if allowed_printed is None else allowed_printed
        ROWS.append(Row(equation, printed, functions, differs, test, allowed, as_written, measure))
        return measure

    return enter


def measure() -> dict[str, Measured]:
    """Return the errors of every row by its equation."""
    return {row.equation: row.measure() for row in ROWS}


def both(error: float) -> Measured:
    """Return the error of a form that is implemented as printed."""
    return {"printed": error, "implemented": error}


# Eqs. 1-5: kinematics


def posed(seed: int = POSES[0]) -> PosedArm:
    """Return the arm of Fig. 5 in a general pose."""
    return PosedArm.of(ARM, general_pose(ARM, seed))


def geometric_block(arm: PosedArm, link: int) -> Array:
    """Return J^i of the end of `link` (from 1) `(3, m)` from the joints' lines: column j is z_j x (p_i - o_j)."""
    columns = np.cross(arm.joint_axes, arm.positions[link - 1] - arm.joint_anchors).T
    columns[:, 3 * link :] = 0.0
    return columns


def difference_of_positions(arm: PosedArm) -> Array:
    """Return the stacked Jacobian `(L, m)` by central differences of the positions."""
    q = arm.q
    ends = [
        [arm.moved_to(q + sign * DIFFERENCE_STEP * joint).positions.ravel() for sign in (1.0, -1.0)]
        for joint in np.eye(len(q))
    ]
    arm.moved_to(q)
    return np.array([(ahead - behind) / (2.0 * DIFFERENCE_STEP) for ahead, behind in ends]).T


@audits(
    "1",
    "dX^i = J^i(θ) dθ, where θ^i is said to have an arm's index",
    VirtualArms.jacobian,
    differs="one dθ is shared by all arms: the joints are the actual arm's",
    test="J^i against z_j × (p_i − o_j) from the joints' axes",
)
def _one_arm() -> Measured:
    arm = posed()
    blocks = arm.jacobian.reshape(N, 3, M)
    return both(max(relative_error(blocks[link - 1], geometric_block(arm, link)) for link in range(1, N + 1)))


@audits(
    "2",
    "J^n = J^n [I_r 0; 0 0]",
    jacobian_of_inner_arm,
    differs="J^i is meant on the left; and of the columns of J^n, which are z_j × (p_n − o_j), dropping some leaves the "
    "lever arms of the wrong end point: J_ω × (p_n − p_i) is added first",
    test="every inner arm's J^i against z_j × (p_i − o_j)",
)
def _inner_arm() -> Measured:
    arm = posed()
    linear, angular = np.empty((3, M)), np.empty((3, M))
    points = arm.positions
    mujoco.mj_jac(arm.model, arm.data, linear, angular, points[-1], arm.model.body(f"link_{N}").id)
    printed, implemented = [], []
    for link in range(1, N):
        truth, r = geometric_block(arm, link), 3 * link
        printed.append(relative_error(linear * (np.arange(M) < r), truth))
        implemented.append(relative_error(jacobian_of_inner_arm(linear, angular, points[-1], points[link - 1], r), truth))
    return {"printed": max(printed), "implemented": max(implemented), "printed_least": min(printed)}


@audits(
    "3",
    "dX_v = J dθ, J = [J^1; …; J^n]",
    VirtualArms.jacobian,
    test="central differences of all end points",
    allowed=DIFFERENCE,
)
def _stacked() -> Measured:
    arm = posed()
    return both(relative_error(arm.jacobian, difference_of_positions(arm)))


@audits(
    "4–5",
    "τ^i = J^iᵀ F^i, τ = Σ τ^i = Jᵀ F_v",
    joint_torques,
    test="virtual work: τᵀdθ = F_vᵀdX_v, with dX_v from central differences",
    allowed=DIFFERENCE,
)
def _torques() -> Measured:
    arm, rng = posed(), np.random.default_rng(4)
    forces, numeric = rng.normal(size=L), difference_of_positions(arm)
    return both(relative_error(joint_torques(arm.jacobian, forces), numeric.T @ forces))


@audits(
    "5 (Fig. 2)",
    "K_a (m × m) and K_v (L × L), without an equation",
    joint_stiffness,
    differs="K_a = Jᵀ K_v J follows from Eqs. 3 and 5",
    test="energy: dθᵀK_a dθ = dX_vᵀK_v dX_v over a basis of dθ",
)
def _stiffness() -> Measured:
    jacobian, rng = posed().jacobian, np.random.default_rng(5)
    root = rng.normal(size=(L, L))
    k_v = root @ root.T
    k_a = joint_stiffness(jacobian, k_v)
    # The energy of every pair of joints, through the lengths of K_v^½ J dθ: a symmetric K_a is known by them.
    energies = root.T @ jacobian
    return {"printed": None, "implemented": relative_error(k_a, energies.T @ energies)}


# Eqs. 6-17: the solve


def request(seed: int, kind: str = "eq23") -> tuple[Array, Array, Array]:
    """Return J, diag W and dX_v* as in winding: arm k + 1 alone is to move, by the speed times the time step."""
    settings, rng = WindingSettings(), np.random.default_rng([seed, FIRST_FREE])
    desired = np.zeros((N, 3))
    desired[FIRST_FREE] = rng.normal(size=3)
    desired *= settings.speed * settings.dt / float(np.linalg.norm(desired))
    weights = diagonal_of_weights(winding_weights(FIRST_FREE, N, kind), 3)
    return posed(seed).jacobian, weights, desired.ravel()


def pseudoinverse_answer(jacobian: Array, weights: Array, desired: Array, rank: int = RANK) -> Array:
    """Return (W^½J)⁺ W^½ dX_v* `(m,)` with the pseudoinverse of the given rank."""
    root = np.sqrt(weights)
    u, s, vt = np.linalg.svd(root[:, None] * jacobian, full_matrices=False)
    return vt[:rank].T @ ((u[:, :rank].T @ (root * desired)) / s[:rank])


def eqs_12_and_14(factors: solve.RankDecomposition, weights: Array, desired: Array) -> Array:
    """Return the library's step for one factorisation of J `(m,)`."""
    return solve.minimum_norm_solution(factors.j_b, solve.weighted_optimum(factors.j_a, weights, desired))


def built_backwards(matrix: Array, weights: Array, seed: int) -> tuple[Array, Array]:
    """Return a request `(L,)` and the x `(p,)` that serves it best: dX* = A x + W⁻¹ z, where Aᵀz = 0."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(matrix.shape[1],))
    normal_to = np.linalg.qr(matrix, mode="complete")[0][:, matrix.shape[1] :]
    return matrix @ x + (normal_to @ rng.normal(size=normal_to.shape[1])) / weights, x


def normal_equations(matrix: Array, weights: Array, desired: Array) -> Array:
    """Return (AᵀWA)⁻¹AᵀW dX* as it is written."""
    gram = matrix.T @ (weights[:, None] * matrix)
    return np.linalg.inv(gram) @ (matrix.T @ (weights * desired))


FACTORISATIONS = (solve.rank_decomposition_svd, solve.rank_decomposition_qr)


@audits(
    "6",
    "J = J_a J_b, rank J = rank J_a = rank J_b = p",
    *FACTORISATIONS,
    test="J_a J_b returns J; p is L less the n lengths that stay; Eqs. 12 and 14 answer alike for both factorisations",
    allowed=SOLVED,
)
def _decomposition() -> Measured:
    worst = 0.0
    for seed in POSES:
        jacobian, weights, desired = request(seed)
        answers = []
        for factorise in FACTORISATIONS:
            factors = factorise(jacobian)
            if factors.rank != RANK:
                return both(np.inf)
            worst = max(worst, relative_error(factors.j_a @ factors.j_b, jacobian))
            answers.append(eqs_12_and_14(factors, weights, desired))
        worst = max(worst, relative_error(*answers))
    return both(worst)


@audits(
    "7–9",
    "dX_v = J_a J_b dθ; dX_b = J_b dθ; dX_v = J_a dX_b",
    solve.RankDecomposition,
    test="J_a (J_b dθ) against central differences along dθ",
    allowed=DIFFERENCE,
)
def _composition() -> Measured:
    arm, dtheta = posed(), np.random.default_rng(7).normal(size=M)
    factors = solve.rank_decomposition_svd(arm.jacobian)
    return both(relative_error(factors.j_a @ (factors.j_b @ dtheta), difference_of_positions(arm) @ dtheta))


@audits(
    "10",
    "Q = (dX_v* − J_a dX_b)ᵀ W (dX_v* − J_a dX_b)",
    solve.weighted_cost,
    Level.cost,
    test="the sum over rows of weight × residual²",
)
def _cost() -> Measured:
    jacobian, weights, desired = request(POSES[0])
    factors, dtheta = solve.rank_decomposition_svd(jacobian), np.random.default_rng(10).normal(size=M)
    truth = sum(
        w * (x - sum(a * b for a, b in zip(row, dtheta, strict=True))) ** 2
        for w, x, row in zip(weights.tolist(), desired.tolist(), jacobian.tolist(), strict=True)
    )
    cost = solve.weighted_cost(factors.j_a, weights, desired, factors.j_b @ dtheta)
    return both(max(relative_error(cost, truth), relative_error(Level(jacobian, desired, weights).cost(dtheta), truth)))


@audits(
    "11",
    "diag[w_1^1 … w_1^l, w_2^1 … w_n^l], w_j^i for element j of arm i",
    diagonal_of_weights,
    differs="the indices are the wrong way round: w_n^l would be element 17 of a vector of 3; upper arm, lower axis, as in "
    "the text and in Eqs. 23 and 24",
    test="Q of Eq. 10 against the arms' own sums Σ_j w_j^i r_j²",
)
def _weights() -> Measured:
    rng = np.random.default_rng(11)
    each, residual = rng.uniform(0.1, 9.0, size=(N, 3)), rng.normal(size=(N, 3))
    total = float(np.einsum("ij,ij,ij->", each, residual, residual))
    found = residual.ravel() @ (diagonal_of_weights(each, 3) * residual.ravel())
    return {"printed": None, "implemented": relative_error(found, total)}


@audits(
    "12",
    "dX_b = (J_aᵀWJ_a)⁻¹ J_aᵀW dX_v*",
    solve.weighted_optimum,
    test="requests built backwards from a chosen dX_b; printed: the inverse, formed",
    allowed=SOLVED,
    allowed_printed=SQUARED,
)
def _weighted_optimum() -> Measured:
    printed, implemented = 0.0, 0.0
    for seed in POSES:
        jacobian, weights, _ = request(seed)
        j_a = solve.rank_decomposition_svd(jacobian).j_a
        desired, truth = built_backwards(j_a, weights, seed)
        printed = max(printed, relative_error(normal_equations(j_a, weights, desired), truth))
        implemented = max(implemented, relative_error(solve.weighted_optimum(j_a, weights, desired), truth))
    return {"printed": printed, "implemented": implemented}


@audits(
    "13",
    "dθ = J_b⁺ dX_b + (I − J_b⁺J_b) r, J_b⁺ = J_bᵀ(J_bJ_bᵀ)⁻¹",
    solve.general_solution,
    test="the linear system of min ‖dθ − r‖ subject to J_b dθ = dX_b",
    allowed=SOLVED,
)
def _general_solution() -> Measured:
    rng = np.random.default_rng(13)
    j_b = solve.rank_decomposition_qr(posed().jacobian).j_b
    p, dx_b, r = len(j_b), rng.normal(size=len(j_b)), rng.normal(size=M)
    system = np.block([[np.eye(M), j_b.T], [j_b, np.zeros((p, p))]])
    truth = np.linalg.solve(system, np.concatenate([r, dx_b]))[:M]
    inverse = j_b.T @ np.linalg.inv(j_b @ j_b.T)
    written = inverse @ dx_b + (np.eye(M) - inverse @ j_b) @ r
    found = solve.general_solution(j_b, dx_b, r)
    return {"printed": relative_error(written, truth), "implemented": relative_error(found, truth)}


@audits(
    "14",
    "dθ = J_b⁺ dX_b",
    solve.minimum_norm_solution,
    test="with Eq. 12 against (W^½J)⁺ W^½ dX_v*, both weights",
    allowed=SOLVED,
)
def _minimum_norm() -> Measured:
    worst = 0.0
    for seed, kind in itertools.product(POSES, ("eq23", "eq24")):
        jacobian, weights, desired = request(seed, kind)
        found = eqs_12_and_14(solve.rank_decomposition_svd(jacobian), weights, desired)
        worst = max(worst, relative_error(found, pseudoinverse_answer(jacobian, weights, desired)))
    return both(worst)


@audits(
    "15",
    "dX_v = J_a(J_aᵀWJ_a)⁻¹J_aᵀW dX_v*",
    solve.resulting_displacement,
    test="J times the step of the pseudoinverse; printed: the inverse, formed",
    allowed=SOLVED,
    allowed_printed=SQUARED,
)
def _resulting() -> Measured:
    jacobian, weights, desired = request(POSES[0])
    j_a = solve.rank_decomposition_svd(jacobian).j_a
    truth = jacobian @ pseudoinverse_answer(jacobian, weights, desired)
    return {
        "printed": relative_error(j_a @ normal_equations(j_a, weights, desired), truth),
        "implemented": relative_error(solve.resulting_displacement(j_a, weights, desired), truth),
    }


def planar(points: list[str]) -> Array:
    """Return J of the five-link planar arm of Fig. 3 with these end points, in a general pose."""
    return PosedArm.of(PLANAR_ARM, general_pose(PLANAR_ARM, POSES[0]), list(points), "xy").jacobian


@audits(
    "16",
    "dθ = J⁺ dX_v*, if J has full row rank (Fig. 3a)",
    solve.redundant_solution,
    test="the linear system of min ‖dθ‖ subject to J dθ = dX_v*",
    allowed=SOLVED,
)
def _redundant() -> Measured:
    jacobian, rng = planar(["end_3", "end_5"]), np.random.default_rng(16)
    rows, m = jacobian.shape
    desired = rng.normal(size=(rows,))
    system = np.block([[np.eye(m), jacobian.T], [jacobian, np.zeros((rows, rows))]])
    truth = np.linalg.solve(system, np.concatenate([np.zeros(m), desired]))[:m]
    return {
        "printed": relative_error(np.linalg.pinv(jacobian) @ desired, truth),
        "implemented": relative_error(solve.redundant_solution(jacobian, desired), truth),
    }


@audits(
    "16 on Fig. 5",
    "the same, where rank J < L",
    solve.redundant_solution,
    differs="the case is checked first, and Eq. 16 refused: J⁺ knows no weights",
    test="(W^½J)⁺ W^½ dX_v*",
)
def _redundant_misapplied() -> Measured:
    jacobian, weights, desired = request(POSES[0])
    truth = pseudoinverse_answer(jacobian, weights, desired)
    wrong = relative_error(np.linalg.pinv(jacobian, rcond=solve.RANK_TOLERANCE) @ desired, truth)
    return {"printed": wrong, "implemented": refused(solve.redundant_solution, jacobian, desired)}


@audits(
    "17",
    "dθ = (JᵀWJ)⁻¹ JᵀW dX_v*, if J has full column rank (Fig. 3b)",
    solve.overconstrained_solution,
    differs="only its derivation: the text before it says Eq. 11 for Eq. 12",
    test="requests built backwards from a chosen dθ; printed: the inverse, formed",
    allowed=SOLVED,
)
def _overconstrained() -> Measured:
    jacobian = planar([f"end_{link}" for link in range(1, 6)])
    weights = np.random.default_rng(17).uniform(0.01, 200.0, size=len(jacobian))
    desired, truth = built_backwards(jacobian, weights, 17)
    return {
        "printed": relative_error(normal_equations(jacobian, weights, desired), truth),
        "implemented": relative_error(solve.overconstrained_solution(jacobian, weights, desired), truth),
    }


@audits(
    "17 on Fig. 5",
    "the same, where JᵀWJ is singular",
    solve.overconstrained_solution,
    differs="the case is checked first, and Eq. 17 refused: a plain solve gives a step without any error",
    test="(W^½J)⁺ W^½ dX_v*",
)
def _overconstrained_misapplied() -> Measured:
    jacobian, weights, desired = request(POSES[0])
    truth = pseudoinverse_answer(jacobian, weights, desired)
    gram = jacobian.T @ (weights[:, None] * jacobian)
    try:
        wrong: float | None = relative_error(np.linalg.solve(gram, jacobian.T @ (weights * desired)), truth)
    except np.linalg.LinAlgError:
        wrong = None  # rounding happened to leave a pivot at exactly zero
    return {"printed": wrong, "implemented": refused(solve.overconstrained_solution, jacobian, weights, desired)}


def refused(function: Callable[..., Array], *arguments: Array) -> float | None:
    """Return None if `function` refuses its arguments, infinity if it answers."""
    try:
        function(*arguments)
    except InputError:
        return None
    return np.inf


# Eqs. 18-24: winding


def unit(seed: int, count: int) -> Array:
    """Return unit vectors `(count, 3)` in directions drawn evenly."""
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def scenes(count: int = 200) -> list[tuple[Array, Array, Array]]:
    """Return links a^{i-1}, contact vectors c^{i-1} square to them, and next links a^i less than 60° off."""
    drawn = zip(unit(18, count), unit(19, count), unit(20, count), strict=True)
    found = []
    for before, side, other in drawn:
        contact = side - before * (before @ side)
        after = before + 0.8 * other  # a triangle's side of 0.8 against 1: at most 53°
        found.append((before, contact / np.linalg.norm(contact), after / np.linalg.norm(after)))
    return found


@audits(
    "18",
    "dX^i* = η α^i (1 − M^i)(M^{i−1} − M^i)",
    plan.desired_displacement,
    differs="η dt for η: η = 2.0 read as metres would be a step of many links; and M^{i−1}(1 − M^i), which is equal",
    test="all four contact states of two links",
)
def _desired() -> Measured:
    alpha, settings = np.array([0.3, -0.5, 0.7]), WindingSettings()
    worst = 0.0
    for before, now in itertools.product((0, 1), repeat=2):
        written = settings.speed * settings.dt * alpha * (1 - now) * (before - now)
        found = plan.desired_displacement(alpha, bool(before), bool(now), speed=settings.speed, dt=settings.dt)
        worst = max(worst, float(np.abs(found - written).max()))
    return both(worst)


@audits(
    "18 (equilibria)",
    "all dX^i* are zero only in [1] M = 0…01…1 and [2] M = 0…0",
    plan.driven_arms,
    test="every contact state of the 17 links; the share of equilibria of another kind",
)
def _equilibria() -> Measured:
    at_rest = resting_states(N)
    # 0…01…1, with no ones or any number of them: the differences are never negative.
    expected = sum(bool((np.diff(state.astype(int)) >= 0).all()) for state in at_rest)
    missing = abs(N + 1 - expected)
    return both(float(len(at_rest) - expected + missing) / (N + 1))


def resting_states(links: int) -> list[Array]:
    """Return every contact state M `(links,)` in which no arm is driven."""
    states = (np.arange(2**links)[:, None] >> np.arange(links)) & 1 == 1
    return [state for state in states if not plan.driven_arms(state).any()]


@audits("19", "α^i = β^i + γ^i", plan.winding_direction, test="β and γ are the parts of α along e and square to it")
def _alpha() -> Measured:
    worst = 0.0
    for before, contact, after in scenes():
        e = plan.plane_normal(before, contact)
        sign = plan.side_sign(after, e)
        into, towards = plan.into_plane(sign, e), plan.towards_object(after, e)
        alpha = plan.winding_direction(into, towards)
        along = e * (alpha @ e) / (e @ e)
        worst = max(worst, float(np.abs(along - into).max()), float(np.abs(alpha - along - towards).max()))
    return both(worst)


@audits(
    "20 β",
    "β^i = s^i e^{i−1}",
    plan.into_plane,
    test="β is −sign(a^i·e) e: it never points away from the plane P",
)
def _beta() -> Measured:
    wrong = 0.0
    for before, contact, after in scenes():
        e = np.cross(before, contact)
        into = plan.into_plane(plan.side_sign(after, e, 0.0), e)
        wrong = max(wrong, float(np.abs(into + np.sign(after @ e) * e).max()))
    return both(wrong)


@audits(
    "20 γ",
    "γ^i = α^i × e^{i−1}",
    plan.towards_object,
    differs="a^i for α^i: the scan prints both alike. With α^i, Eqs. 19-21 define α^i by itself, and α^i = 0 is the only "
    "solution: the arm would never move",
    test="γ turns link i in the plane P, about e: the rate of change of a^i turned about −e",
    allowed=DIFFERENCE,
)
def _gamma() -> Measured:
    printed, implemented = [], []
    for before, contact, after in scenes():
        e = np.cross(before, contact)
        ahead, behind = (turned(after, -e, sign * DIFFERENCE_STEP) for sign in (1.0, -1.0))
        truth = (ahead - behind) / (2.0 * DIFFERENCE_STEP)
        printed.append(relative_error(np.cross(self_defined_alpha(e), e), truth))
        implemented.append(relative_error(plan.towards_object(after, e), truth))
    return {"printed": max(printed), "implemented": max(implemented)}


def turned(vector: Array, axis: Array, angle: float) -> Array:
    """Return `vector` turned about a unit `axis` by `angle` [rad]: Rodrigues' formula."""
    along = axis * (axis @ vector) * (1.0 - np.cos(angle))
    return vector * np.cos(angle) + np.cross(axis, vector) * np.sin(angle) + along


def self_defined_alpha(e: Array) -> Array:
    """Return the α that meets Eqs. 19-21 read literally, α = s e + α × e with s = -sign(α·e) `(3,)`.

    For each s the first is a linear system. Its solution for s = ±1 has α·e = s e·e, of the sign that the second forbids.
    """
    crossing = np.array([[0.0, e[2], -e[1]], [-e[2], 0.0, e[0]], [e[1], -e[0], 0.0]])  # crossing @ α = α × e
    solutions = [(s, np.linalg.solve(np.eye(3) - crossing, s * e)) for s in (1.0, 0.0, -1.0)]
    consistent = [alpha for s, alpha in solutions if s == -np.sign(alpha @ e)]
    (alpha,) = consistent
    return alpha


@audits(
    "21",
    "s^i = 1, 0, −1 for (α^i, e^{i−1}) below, at, above 0",
    plan.side_sign,
    differs="a^i for α^i; and 0 within a dead band: β has a fixed size and would overshoot the plane at almost every step",
    test="the three cases, outside the dead band",
)
def _side() -> Measured:
    wrong, band = 0.0, plan.DEAD_BAND
    for out_of_plane, sign in ((-1.0, 1), (-band - 1e-9, 1), (-band, 0), (0.0, 0), (band, 0), (band + 1e-9, -1), (1.0, -1)):
        link = np.array([0.0, np.sqrt(1.0 - out_of_plane**2), out_of_plane])
        wrong = max(wrong, abs(float(plan.side_sign(link, np.array([0.0, 0.0, 1.0]))) - sign))
    return {"printed": None, "implemented": wrong}


@audits(
    "22",
    "e^{i−1} = α^{i−1} × c^{i−1}, a^i the direction of link i − 1",
    plan.plane_normal,
    differs="a for α, and a^i the direction of link i: with the text's index a^i·e^{i−1} is always 0, so that β is",
    test="e is square to a^{i−1} and c^{i−1} and as long as both: the 3 × 3 determinant",
)
def _normal() -> Measured:
    implemented, printed = 0.0, []
    for before, contact, after in scenes():
        e = plan.plane_normal(before, contact)
        implemented = max(implemented, abs(e @ before), abs(e @ contact), abs(np.linalg.det([before, contact, e]) - 1.0))
        out_of_plane, as_indexed = after @ np.cross(before, contact), before @ np.cross(before, contact)
        printed.append(abs(as_indexed - out_of_plane) / abs(out_of_plane))
    return {"printed": float(max(printed)), "implemented": float(implemented)}


@audits(
    "22 (sign of c)",
    "c is “a direction from which the object makes contact”",
    plan.towards_object,
    differs="read as the unit normal from the object into the link; the other sense would turn the arm away",
    test="γ of a link in line with the one in contact is −c, towards the object",
)
def _contact_vector() -> Measured:
    errors = [
        [relative_error(plan.towards_object(before, plan.plane_normal(before, sense * c)), -c) for sense in (-1.0, 1.0)]
        for before, c, _ in scenes()
    ]
    printed, implemented = np.max(errors, axis=0)
    return {"printed": float(printed), "implemented": float(implemented)}


def _listed(kind: str, last: float) -> Measured:
    """Compare the library's weights with the printed cases, for every k."""
    worst = 0.0
    for k in range(N + 1):
        listed = [200.0 if i <= k else 20.0 if i == k + 1 else last for i in range(1, N + 1)]
        worst = max(worst, relative_error(winding_weights(k, N, kind), np.array(listed)))
    return both(worst)


@audits("23", "w = 200 (i ≤ k), 20 (i = k + 1), 0.01 (i ≥ k + 2)", winding_weights, test="the cases, for k = 0 … 17")
def _eq23() -> Measured:
    return _listed("eq23", 0.01)


@audits("24", "w = 200 (i ≤ k), 20 (i = k + 1), 1.0 (i ≥ k + 2)", winding_weights, test="the cases, for k = 0 … 17")
def _eq24() -> Measured:
    return _listed("eq24", 1.0)


def paths() -> dict[int, set[str]]:
    """Return the dotted paths of the functions of each equation, as docs/notation.md gives them."""
    found: dict[int, set[str]] = {}
    for row in ROWS:
        for function in row.functions:
            module = inspect.getmodule(function)
            path = f"{module.__name__ if module else ''}.{function.__qualname__}"
            for number in row.numbers:
                found.setdefault(number, set()).add(path)
    return found
