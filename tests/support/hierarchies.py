"""Hierarchies of levels to test solvers on: some whose optimum is known because it was chosen first, some open.

`random_hierarchy` goes backwards from an optimum x. From the top level down it keeps the directions that are settled: what
equalities, the levels above and the rows they press on leave no choice about. At each level it chooses rows that become
pressed there, c with multipliers λ > 0, and any vector d in the settled directions, and makes the level's gradient

    AᵀW(Ax - b) = -Σ λ c - d

by its choice of b (of A too where the level is one of soft inequalities, whose excesses may not be negative). The reference
ends the same way: x - r = -Σ λ c - d. Every problem of the hierarchy is convex, so these conditions are sufficient, and
the last level makes x the only optimum. Nothing is drawn between clear and nothing: singular values, slacks and the new
part of a pressed row are clear of zero, or zero. `kkt_error` and `gains` check all that without the library's solvers;
`solution_on` computes x again from the rows that press.
"""

import itertools
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.optimize

from prioritized_ik.problem import Bounds, Equalities, IKProblem, Level, Rows

FEATURES = (
    "bounds",  # joints that end on a bound, others near one
    "locked",  # a joint whose two bounds are one
    "rows",  # hard rows, pressed and idle
    "copies",  # pressed rows once more: of other length, moved away, turned round, or as a positive combination
    "thin",  # two hard rows that leave nothing between them
    "equalities",  # equality rows, some of them twice, some as tight rows too
    "soft",  # levels of soft inequalities
    "overlap",  # levels that feel what is settled above them, and agree with it
    "conflict",  # levels that want otherwise than what is settled above them
    "dependent",  # levels of more rows than rank, with targets out of reach; a level that feels nothing at all
    "weights",  # weights over six decades
    "degenerate",  # tight rows without a multiplier at any level
    "scales",  # steps from 1e-3 to 10 rad and levels from 1e-2 to 1e2, instead of 1
)
EVERYTHING = frozenset(FEATURES)

CLEAR = 0.1  # the part of a pressed row that is new, at least: problems near to degenerate have answers near to arbitrary
SPREAD = 2.5  # [decades] of a level's singular values at most: 40 times above the rank tolerance of 1e-4
SAME = 1e-13  # relative: residuals are sums of up to 60 products, with an error of 60 times 2e-16 at most
BLURRED = 1e7  # sensitivity at most: beyond, rounding alone moves the optimum by 1e-9 of itself and more
LIGHT = 1e-2  # weight of a soft row that is kept, relative to the heaviest of those exceeded, at least
NOTHING = 1e-9  # relative: what rounding leaves of directions that are built to be settled is below 1e-12

Array = np.ndarray


@dataclass(frozen=True)
class Press:
    """A tight row that presses at a level: its first multiplier above zero.

    Attributes:
        level: at which level, `len(problem.levels)` for the reference.
        kind: "upper" and "lower" for bounds, "row", or "soft 2" for a row of the level of number 2.
        index: of the joint or the row.
        multiplier: λ.
    """

    level: int
    kind: str
    index: int
    multiplier: float

    def row(self, problem: IKProblem) -> tuple[Array, float]:
        """Return the row c and its side d, from c x <= d."""
        if self.kind == "row":
            return problem.rows.matrix[self.index], problem.rows.upper[self.index]
        if self.kind.startswith("soft"):
            level = problem.levels[int(self.kind.split()[1])]
            return level.matrix[self.index], level.target[self.index]
        unit = np.eye(problem.joint_count)[self.index]
        if self.kind == "upper":
            return unit, problem.bounds.upper[self.index]
        return -unit, -problem.bounds.lower[self.index]


@dataclass(frozen=True)
class KnownHierarchy:
    """A problem, its optimum `dtheta` `(m,)` and the rows that press, at the level where they first do."""

    problem: IKProblem
    dtheta: Array
    presses: tuple[Press, ...]
    features: frozenset[str] = EVERYTHING
    seed: int = 0

    def __repr__(self) -> str:
        """Return what makes it again: Hypothesis prints it."""
        return f"random_hierarchy({self.seed}, {sorted(self.features)})"


def random_hierarchy(
    seed: int,
    features: Collection[str] = EVERYTHING,
    joints: tuple[int, int] = (2, 60),
    levels: tuple[int, int] = (1, 6),
) -> KnownHierarchy:
    """Return a problem built backwards from its optimum.

    Args:
        seed: of all that is random.
        features: which of `FEATURES` may occur.
        joints: least and greatest number of joints; small numbers are more frequent.
        levels: least and greatest number of levels.
    """
    unknown = set(features) - EVERYTHING
    if unknown:
        raise ValueError(f"unknown features {sorted(unknown)}; choose from {FEATURES}.")
    rng = np.random.default_rng(seed)
    while True:
        draft = _Draft(rng, round(_log_uniform(rng, *joints)), frozenset(features))
        draft.equalities()
        for _ in range(int(rng.integers(levels[0], levels[1] + 1))):
            draft.level()
        known = replace(draft.finished(), seed=seed)
        if sensitivity(known) <= BLURRED:
            return known


@dataclass
class _Tight:
    """A row that is tight at the optimum, by kind and index as in `Press`."""

    kind: str
    index: int
    row: Array


@dataclass
class _Draft:
    """A hierarchy on its way from the optimum back to the problem."""

    rng: np.random.Generator
    m: int
    features: frozenset[str]
    levels: list[Level] = field(default_factory=list)
    presses: list[Press] = field(default_factory=list)

    def __post_init__(self) -> None:
        direction = self.rng.normal(size=self.m)
        self.scale = 10.0 ** self.rng.uniform(-3.0, 1.0) if "scales" in self.features else 1.0
        self.x = self.scale * direction / np.linalg.norm(direction)
        self.settled = np.zeros((self.m, 0))  # orthonormal
        self.decided = np.zeros((self.m, 0))  # likewise, what equalities and equal levels alone settle
        self.lower, self.upper = np.full(self.m, -np.inf), np.full(self.m, np.inf)
        self.rows: list[Array] = []
        self.sides: list[float] = []
        self.equal_rows: list[Array] = []
        self.soft_tight: list[_Tight] = []  # of the levels so far, not pressed yet

    # Directions.

    @property
    def free(self) -> Array:
        """The orthonormal directions that are not settled."""
        return _complement(self.settled)

    def settle(self, vectors: Array) -> None:
        """Count the `vectors` `(k, m)` as settled from here on."""
        self.settled = np.hstack([self.settled, _span(vectors - (vectors @ self.settled) @ self.settled.T)])

    def normal(self, *size: int) -> Array:
        return self.rng.normal(size=size)

    def decades(self, low: float, high: float) -> float:
        return float(10.0 ** self.rng.uniform(low, high))

    def chance(self, probability: float) -> bool:
        return bool(self.rng.random() < probability)

    def gap(self) -> float:
        """How far from its row an idle step stays [rad]."""
        return self.scale * self.decades(-1.3, 0.7)

    # Hard rows.

    def add_row(self, row: Array, gap: float = 0.0) -> int:
        """Add a row that the optimum keeps with `gap` to spare, as a distance; return its index."""
        self.rows.append(row)
        self.sides.append(float(row @ self.x + gap * np.linalg.norm(row)))
        return len(self.rows) - 1

    def random_row(self) -> Array:
        row = self.normal(self.m)
        if self.chance(0.5):
            row[self.rng.random(self.m) < 0.6] = 0.0
        row = row if row.any() else self.normal(self.m)
        return row / np.linalg.norm(row) * (self.decades(-2.0, 2.0) if "scales" in self.features else 1.0)

    def equalities(self) -> None:
        """Settle what holds before the first level: equalities, locked joints, pairs of rows with nothing between."""
        rng = self.rng
        if "equalities" in self.features and self.m > 2 and self.chance(0.5):
            for _ in range(rng.integers(1, max(2, self.m // 4) + 1)):
                self.equal_rows.append(self.random_row())
            basis = np.array(self.equal_rows)
            if self.chance(0.4):  # twice
                self.equal_rows.append(self.decades(-1.0, 1.0) * basis[0])
            if self.chance(0.4):  # a combination of the others
                self.equal_rows.append(self.normal(len(basis)) @ basis)
            if self.chance(0.4):  # and as a tight row
                self.add_row(self.decades(-1.0, 1.0) * rng.choice([-1.0, 1.0]) * basis[-1])
            self.settle(basis)
            self.decided = self.settled
        if "locked" in self.features and self.m > 2 and self.chance(0.4):
            for joint in rng.choice(self.m, rng.integers(1, max(2, self.m // 6) + 1), replace=False):
                if self._new_part(np.eye(self.m)[joint], self.settled) >= CLEAR:
                    self.lower[joint] = self.upper[joint] = self.x[joint]
                    self.settle(np.eye(self.m)[[joint]])
        if "thin" in self.features and self.m > 2 and self.chance(0.4):
            row = self.random_row()
            if self._new_part(row, self.settled) >= CLEAR:
                self.add_row(row)
                self.add_row(-self.decades(-1.0, 1.0) * row)
                self.settle(row[None])

    def _new_part(self, row: Array, settled: Array) -> float:
        """Return which fraction of `row` is not settled."""
        return float(np.linalg.norm(row - settled @ (settled.T @ row)) / np.linalg.norm(row))

    def pressed(self, most: int) -> list[_Tight]:
        """Return up to `most` rows that are tight at x and clear of what is settled and of each other."""
        chosen: list[_Tight] = []
        settled = self.settled
        for _ in range(int(self.rng.integers(0, most + 1))):
            kinds = [name for name in ("bounds", "rows") if name in self.features]
            kinds += ["soft"] * bool(self.soft_tight)
            if not kinds:
                break
            kind = kinds[self.rng.integers(len(kinds))]
            tight = self._tight_bound() if kind == "bounds" else self._tight_row() if kind == "rows" else self._tight_soft()
            if self._new_part(tight.row, settled) < CLEAR:
                continue
            if kind == "bounds":
                (self.upper if tight.kind == "upper" else self.lower)[tight.index] = self.x[tight.index]
            elif kind == "rows":
                tight = replace(tight, index=self.add_row(tight.row))
            else:
                self.soft_tight = [other for other in self.soft_tight if other is not tight]
            chosen.append(tight)
            new = tight.row - settled @ (settled.T @ tight.row)
            settled = np.hstack([settled, _span(new[None])])
        return chosen

    def _tight_bound(self) -> _Tight:
        joint = int(self.rng.integers(self.m))
        side = "upper" if self.chance(0.5) else "lower"
        return _Tight(side, joint, np.eye(self.m)[joint] * (1.0 if side == "upper" else -1.0))

    def _tight_row(self) -> _Tight:
        return _Tight("row", -1, self.random_row())

    def _tight_soft(self) -> _Tight:
        return self.soft_tight[int(self.rng.integers(len(self.soft_tight)))]

    # Levels.

    def level(self) -> None:
        """Add a level of either kind."""
        soft = "soft" in self.features and self.chance(0.4)
        for _ in range(20):
            chosen = self.pressed(3)
            multipliers = np.array([self.decades(-1.0, 0.0) / np.linalg.norm(tight.row) for tight in chosen])
            pull = -sum((value * tight.row for value, tight in zip(multipliers, chosen, strict=True)), np.zeros(self.m))
            gradient = pull - self.settled @ (self.settled.T @ pull)
            if "conflict" in self.features and self.settled.shape[1] and self.chance(0.7):
                gradient = gradient + self.decades(-1.0, 0.5) * _unit(self.settled @ self.normal(self.settled.shape[1]))
            new, old = self.felt(gradient)
            built = self._soft_level(gradient, new, old) if soft else self._equal_level(gradient, new, old)
            if built is None:
                self.abandon(chosen)
                continue
            level, stretch, tight, fixed = built
            break
        else:
            raise RuntimeError("no level found that is clear of degeneracy")
        number = len(self.levels)
        self.levels.append(level)
        for value, press in zip(multipliers, chosen, strict=True):
            self.presses.append(Press(number, press.kind, press.index, float(stretch * value)))
        self.soft_tight += [_Tight(f"soft {number}", i, level.matrix[i]) for i in tight]
        self.settle(np.vstack([fixed, *(press.row[None] for press in chosen)]))

    def abandon(self, chosen: list[_Tight]) -> None:
        """Give rows some room that were to press and do not; soft ones are back in the pool."""
        for tight in chosen:
            if tight.kind == "upper":
                self.upper[tight.index] += self.gap()
            elif tight.kind == "lower":
                self.lower[tight.index] -= self.gap()
            elif tight.kind == "row":
                self.sides[tight.index] += self.gap() * np.linalg.norm(tight.row)
            else:
                self.soft_tight.append(tight)

    def felt(self, gradient: Array) -> tuple[Array, Array]:
        """Return the directions that a level is to feel, new ones and settled ones, with `gradient` in their span."""
        free, settled = self.free, self.settled
        most = free.shape[1]
        count = int(self.rng.integers(0, min(most, max(1, (most + 2) // 3)) + 1)) if most else 0
        new = (free @ self.normal(most, count)).T
        old = np.zeros((0, self.m))
        if settled.shape[1] and ("overlap" in self.features or not most):
            few = int(self.rng.integers(0, min(3, settled.shape[1]) + 1))
            old = (settled @ self.normal(settled.shape[1], few)).T
        within = settled @ (settled.T @ gradient)
        spans = []
        for vectors, part in ((new, gradient - within), (old, within)):
            extra = [_unit(part)[None]] if np.linalg.norm(part) > NOTHING * max(np.linalg.norm(gradient), NOTHING) else []
            spans.append(_span(np.vstack([*extra, vectors])))
        if not spans[0].shape[1] + spans[1].shape[1]:
            spans[not most] = _span(((free if most else settled) @ self.normal(most or settled.shape[1]))[None])
        return spans[0], spans[1]

    def size(self) -> float:
        return self.decades(-2.0, 2.0) if "scales" in self.features else 1.0

    def weights(self, k: int) -> Array:
        return 10.0 ** self.rng.uniform(-3.0, 3.0, k) if "weights" in self.features else np.ones(k)

    def excess(self) -> float:
        """How far from its target a level ends, in units of a step."""
        return self.decades(-1.0, 1.0)

    def _equal_level(self, gradient: Array, new: Array, old: Array) -> tuple[Level, float, list[int], Array] | None:
        """Return the level, by how much its gradient is longer than `gradient`, and what it settles."""
        basis = np.hstack([new, old])
        p = basis.shape[1]
        extra = int(self.rng.integers(0, 4)) if "dependent" in self.features else 0
        k, size = p + extra, self.size()
        spectrum = size * 10.0 ** -self.rng.uniform(0.0, SPREAD, p)
        spectrum[0] = size
        left, turn = _orthonormal(self.rng, k, p), _orthonormal(self.rng, p, p)
        weights = self.weights(k)
        residual = left @ ((turn.T @ (basis.T @ gradient)) / spectrum)
        if extra:
            beyond = self.normal(k)
            beyond -= left @ (left.T @ beyond)
            residual = residual + _unit(beyond) * (np.linalg.norm(residual) or 1.0) * self.decades(-1.0, 0.5)
        residual = residual / weights
        stretch = 1.0
        if residual.any():
            stretch = self.excess() * size * self.scale / np.linalg.norm(residual)
        matrix = left @ (spectrum[:, None] * (turn.T @ basis.T))
        if extra and not gradient.any() and self.chance(0.05):
            matrix, new = np.zeros_like(matrix), new[:, :0]
        # Also where ranks are counted without regard to inequalities.
        if not _is_clear(matrix, _complement(self.decided)):
            return None
        self.decided = np.hstack([self.decided, _span(matrix @ _complement(self.decided) @ _complement(self.decided).T)])
        level = Level(matrix, matrix @ self.x - stretch * residual, weights, f"task {len(self.levels) + 1}")
        return level, stretch, [], new.T

    def _soft_level(self, gradient: Array, new: Array, old: Array) -> tuple[Level, float, list[int], Array] | None:
        """Return the level, by how much its gradient is longer than `gradient`, its tight rows, and what it settles."""
        rng, size = self.rng, self.size()
        basis = np.hstack([new, old])
        fight = bool(gradient.any())
        violated = int(rng.integers(1 if fight else 0, min(basis.shape[1], 5) + 2))
        if not fight and (violated == 1 or "conflict" not in self.features):
            violated = 0
        rows, excesses, weights, stretch = [], [], list(self.weights(violated)), 1.0
        total = np.zeros(self.m)
        for i in range(violated - 1):
            rows.append(size * self.decades(-0.5, 0.0) * _unit(basis @ self.normal(basis.shape[1])))
            excesses.append(size * self.scale * self.excess())
            total += weights[i] * excesses[i] * rows[i]
        if violated:
            if fight and violated > 1:
                stretch = np.linalg.norm(total) / np.linalg.norm(gradient) * self.decades(-1.0, 1.0)
            elif fight:
                stretch = weights[-1] * size**2 * self.scale * self.excess() / np.linalg.norm(gradient)
            last = stretch * gradient - total
            rows.append(size * _unit(last))
            excess = size * self.scale * self.excess()
            if "weights" in self.features:
                weights[-1] = float(np.clip(np.linalg.norm(last) / (size * excess), 1e-3, 1e3))
            excesses.append(float(np.linalg.norm(last)) / (weights[-1] * size))
        matrix = np.array(rows).reshape(-1, self.m)
        if not _is_clear(matrix, self.free):
            return None
        kept = int(rng.integers(0 if violated else 1, 4))
        tight = rng.random(kept) < 0.4
        others = np.array([size * self.decades(-0.5, 0.0) * _unit(self.normal(self.m)) for _ in range(kept)])
        others = others.reshape(-1, self.m)
        room = np.where(tight, 0.0, [self.gap() * np.linalg.norm(row) for row in others])
        order = rng.permutation(violated + kept)
        every = np.vstack([matrix, others])
        target = np.concatenate([matrix @ self.x - excesses, others @ self.x + room])
        # Beside rows exceeded by far, a row of a millionth of their weight would be kept as well as rounding keeps it.
        light = LIGHT * max(weights, default=0.0)
        heavy = np.concatenate([weights, np.maximum(self.weights(kept), light)])
        level = Level(every[order], target[order], heavy[order], f"soft {len(self.levels) + 1}", "at_most")
        place = np.argsort(order)
        return level, float(stretch), [int(place[violated + i]) for i in np.flatnonzero(tight)], matrix

    # The end.

    def finished(self) -> KnownHierarchy:
        """Choose the reference and add what does not press."""
        chosen = self.pressed(3)
        last = len(self.levels)
        reference = np.array(self.x)
        for tight in chosen:
            force = self.scale * self.decades(-1.0, 0.5)
            reference += force * _unit(tight.row)
            self.presses.append(Press(last, tight.kind, tight.index, float(force / np.linalg.norm(tight.row))))
        d = self.settled.shape[1]
        reference += self.scale * self.decades(-1.0, 0.5) * (self.settled @ _unit(self.normal(d)) if d else 0.0)
        if "copies" in self.features:
            self._add_copies()
        if "degenerate" in self.features:
            self._add_degenerate()
        else:
            self._relax_soft()
        self._add_idle()
        rows = Rows(np.array(self.rows), np.array(self.sides)) if self.rows else None
        equal = np.array(self.equal_rows).reshape(-1, self.m)
        problem = IKProblem(self.levels, Bounds(self.lower, self.upper), rows, reference, Equalities(equal, equal @ self.x))
        return KnownHierarchy(problem, self.x, tuple(self.presses), self.features)

    def _hard_rows(self) -> list[Array]:
        eye = np.eye(self.m)
        hard = [press for press in self.presses if not press.kind.startswith("soft")]
        signs = {"upper": 1.0, "lower": -1.0}
        return [self.rows[p.index] if p.kind == "row" else signs[p.kind] * eye[p.index] for p in hard]

    def _add_copies(self) -> None:
        hard = self._hard_rows()
        for row in hard:
            length = self.decades(-2.0, 2.0)
            kind = self.rng.integers(6)
            if kind == 0:
                self.add_row(length * row)
            elif kind == 1:
                self.add_row(length * row, self.gap())
            elif kind == 2:
                self.add_row(-length * row, self.gap())
        if len(hard) > 1 and self.chance(0.7):
            one, other = self.rng.choice(len(hard), 2, replace=False)
            self.add_row(self.decades(-1.0, 1.0) * _unit(hard[one]) + self.decades(-1.0, 1.0) * _unit(hard[other]))

    def _add_degenerate(self) -> None:
        for _ in range(self.rng.integers(0, 4)):
            if "rows" in self.features and self.chance(0.5):
                self.add_row(self.random_row())
            elif "bounds" in self.features:
                joint = int(self.rng.integers(self.m))
                (self.upper if self.chance(0.5) else self.lower)[joint] = self.x[joint]

    def _relax_soft(self) -> None:
        """Give every soft row some room that is tight and presses nowhere."""
        for tight in self.soft_tight:
            number = int(tight.kind.split()[1])
            level = self.levels[number]
            target = np.array(level.target)
            target[tight.index] += self.gap() * np.linalg.norm(tight.row)
            self.levels[number] = Level(level.matrix, target, level.weights, level.name, level.kind)

    def _add_idle(self) -> None:
        if "rows" in self.features:
            for _ in range(self.rng.integers(0, self.m // 2 + 2)):
                self.add_row(self.random_row(), self.gap())
            if self.chance(0.2):
                self.add_row(np.zeros(self.m))
        if "bounds" in self.features:
            for joint in np.flatnonzero(self.rng.random(self.m) < 0.7):
                if np.isinf(self.upper[joint]):
                    self.upper[joint] = self.x[joint] + self.gap()
                if np.isinf(self.lower[joint]):
                    self.lower[joint] = self.x[joint] - self.gap()


# Problems whose optimum is open.


def unplanned_hierarchy(
    seed: int, joints: tuple[int, int] = (2, 30), levels: tuple[int, int] = (1, 5)
) -> tuple[IKProblem, Array]:
    """Return a random problem whose levels fight, and a step that keeps all its hard rows."""
    rng = np.random.default_rng([seed, 1])
    m = round(_log_uniform(rng, *joints))
    scale = 10.0 ** rng.uniform(-3.0, 1.0)
    known = scale * rng.normal(size=m) / np.sqrt(m) * rng.integers(0, 2)  # zero half the time
    tasks = []
    for number in range(rng.integers(levels[0], levels[1] + 1)):
        k = int(rng.integers(1, max(2, m // 2) + 3))
        p = int(rng.integers(1, min(k, m) + 1))
        spectrum = 10.0 ** -rng.uniform(0.0, 2.0, p)
        matrix = 10.0 ** rng.uniform(-1.0, 1.0) * _orthonormal(rng, k, p) @ (spectrum[:, None] * _orthonormal(rng, m, p).T)
        target = (
            matrix @ (known + 3.0 * scale * rng.normal(size=m)) + 0.3 * scale * rng.normal(size=k) * np.abs(matrix).max()
        )
        weights = 10.0 ** rng.uniform(-2.0, 2.0, k) if rng.random() < 0.5 else np.ones(k)
        kind = "at_most" if rng.random() < 0.35 else "equal"
        tasks.append(Level(matrix, target, weights, f"task {number + 1}", kind))
    near = scale * 10.0 ** rng.uniform(-1.0, 0.5, (2, m)) * rng.integers(0, 2, (2, m))
    bounds = Bounds(
        np.where(rng.random(m) < 0.6, known - near[0], -np.inf), np.where(rng.random(m) < 0.6, known + near[1], np.inf)
    )
    matrix = rng.normal(size=(rng.integers(0, m + 2), m))
    room = scale * 10.0 ** rng.uniform(-1.5, 0.5, len(matrix)) * rng.integers(0, 2, len(matrix))
    equal = rng.normal(size=(int(rng.integers(0, max(1, m // 4) + 1)) * int(rng.integers(0, 2)), m))
    reference = known + scale * rng.normal(size=m)
    rows, equalities = Rows(matrix, matrix @ known + room), Equalities(equal, equal @ known)
    return IKProblem(tasks, bounds, rows, reference, equalities), known


# Checks that share nothing with the library's solvers.


def settled_before(known: KnownHierarchy, number: int) -> Array:
    """Return the orthonormal directions that are settled when level `number` comes, `len(levels)` for the reference."""
    problem = known.problem
    m = problem.joint_count
    rows = [problem.equalities.matrix, np.eye(m)[problem.bounds.lower == problem.bounds.upper], _thin_pairs(problem)]
    rows += [level.matrix[_counted(level, known.dtheta)] for level in problem.levels[:number]]
    rows += [press.row(problem)[0][None] for press in known.presses if press.level < number]
    return _span(np.vstack(rows))


def _thin_pairs(problem: IKProblem) -> Array:
    """Return the rows `(t, m)` that stand with their opposite, at one and the same distance."""
    matrix, lengths = problem.rows.matrix, np.linalg.norm(problem.rows.matrix, axis=1)
    keep = lengths > 0.0
    unit, distance = matrix[keep] / lengths[keep, None], problem.rows.upper[keep] / lengths[keep]
    size = max(float(np.abs(distance).max(initial=0.0)), 1e-300)
    opposite = np.abs(unit[:, None] + unit).max(axis=2, initial=0.0) < NOTHING
    opposite &= np.abs(distance[:, None] + distance) < NOTHING * size
    return unit[opposite.any(axis=1)]


def _counted(level: Level, dtheta: Array) -> Array:
    """Return which rows of a level are at work at `dtheta`: of a soft level those that exceed their target."""
    noise = NOTHING * (np.abs(level.matrix) @ np.abs(dtheta) + np.abs(level.target))
    return (level.matrix @ dtheta > level.target + noise) | (not level.is_soft)


def gradient(level: Level, dtheta: Array) -> Array:
    """Half the slope of a level's cost `(m,)`."""
    return level.matrix.T @ (level.weights * level.residual(dtheta))


def kkt_error(known: KnownHierarchy) -> float:
    """Return by how much, relatively, the worst of the conditions fails that make `dtheta` the optimum."""
    problem, x = known.problem, known.dtheta
    size = np.linalg.norm(x)
    hard, equal = problem.inequalities, problem.equalities
    lengths = np.maximum(np.linalg.norm(hard.matrix, axis=1), 1e-300)
    errors = [((hard.matrix @ x - hard.upper) / lengths).max(initial=0.0) / size]
    if len(equal.target):
        errors.append((np.abs(equal.matrix @ x - equal.target) / np.linalg.norm(equal.matrix, axis=1)).max() / size)
    for number in range(len(problem.levels) + 1):
        if number < len(problem.levels):
            level = problem.levels[number]
            force = gradient(level, x)
            scale = np.linalg.norm(np.abs(level.matrix.T) @ (level.weights * (np.abs(level.matrix) @ np.abs(x))))
            scale += np.linalg.norm(np.abs(level.matrix.T) @ (level.weights * np.abs(level.residual(x))))
        else:
            force = x - problem.reference
            scale = size + np.linalg.norm(force)
        for press in known.presses:
            if press.level == number:
                row, side = press.row(problem)
                errors.append(abs(row @ x - side) / np.linalg.norm(row) / size)
                errors.append(0.0 if press.multiplier > 0.0 else 1.0)
                force = force + press.multiplier * row
                scale += press.multiplier * np.linalg.norm(row)
        settled = settled_before(known, number)
        errors.append(np.linalg.norm(force - settled @ (settled.T @ force)) / scale if scale else 0.0)
    return float(max(errors))


@dataclass(frozen=True)
class Gains:
    """What tries to beat an optimum came to: how many changed the costs of which level first, and the best of them."""

    decided: tuple[int, ...]
    best: float


def gains(known: KnownHierarchy, tries: int = 30) -> Gains:
    """Try feasible steps at random, and return the largest gain at the first level that tells them from `dtheta`.

    A try keeps what is settled above some level and steps into the cone that the tight rows leave. A gain is relative to
    the level's cost. A try that a level feels, but whose costs differ by less than rounding, decides nothing.
    """
    problem, x = known.problem, known.dtheta
    rng = np.random.default_rng([known.seed, 2])
    levels = [*problem.levels, Level(np.eye(len(x)), problem.reference, name="reference")]
    decided, best = [0] * len(levels), 0.0
    spaces = [_complement(settled_before(known, number)) for number in range(len(levels))]
    cones = [_tight_normals(known, number) for number in range(len(levels))]
    for _ in range(tries):
        number = int(rng.integers(len(levels)))
        free = spaces[number]
        if not free.shape[1]:
            continue
        direction = _into_cone(free @ rng.normal(size=free.shape[1]), cones[number], free)
        length = np.linalg.norm(direction)
        if length < NOTHING:
            continue
        hard = problem.inequalities
        rate, slack = hard.matrix @ direction, hard.upper - hard.matrix @ x
        norms = np.linalg.norm(hard.matrix, axis=1)
        ahead = rate > 1e-12 * norms * length
        reach = float(np.min(np.maximum(slack[ahead], 0.0) / rate[ahead], initial=np.inf))
        step = min(np.linalg.norm(x) / length * 10.0 ** rng.uniform(-2.0, 0.5), reach)
        for i, level in enumerate(levels):
            here, there = level.residual(x), level.residual(x + step * direction)
            change = float((there - here) @ (level.weights * (there + here)))
            noise = np.abs(level.matrix) @ np.abs(x) + np.abs(level.target)
            sizes = np.abs(there) + np.abs(here) + SAME * noise
            threshold = SAME * float(sizes @ (level.weights * noise))
            if abs(change) > threshold:
                decided[i] += 1
                best = max(best, -change / (level.cost(x) + level.cost(x + step * direction)))
                break
            if i >= number and (np.abs(there - here) > SAME * noise).any():
                break  # a change too small to see, as where an excess of 1e-9 stands beside one of 1
    return Gains(tuple(decided), best)


def _tight_normals(known: KnownHierarchy, number: int) -> Array:
    """Return the tight rows `(t, m)` that a step may not exceed at level `number`, soft ones above it included."""
    problem, x = known.problem, known.dtheta
    near = 1e-9 * np.linalg.norm(x)
    parts = [(problem.inequalities.matrix, problem.inequalities.upper)]
    parts += [(level.matrix, level.target) for level in problem.levels[:number] if level.is_soft]
    matrix, side = (np.concatenate(part) for part in zip(*parts, strict=True))
    norms = np.linalg.norm(matrix, axis=1)
    tight = (np.abs(side - matrix @ x) <= near * norms) & (norms > 0.0)
    return matrix[tight] / norms[tight, None]


def _into_cone(direction: Array, normals: Array, free: Array) -> Array:
    """Return the nearest to `direction` of those within `free` that exceed none of the `normals`."""
    cone = normals @ free
    norms = np.linalg.norm(cone, axis=1)
    cone = cone[norms > NOTHING] / norms[norms > NOTHING, None]
    inner = free.T @ direction
    if len(cone):
        inner = inner - cone.T @ scipy.optimize.nnls(cone.T, inner)[0]
    return free @ inner


def solution_on(problem: IKProblem, presses: Iterable[Press], like: Array) -> Array:
    """Return the lexicographic least squares step `(m,)` with the rows of `presses` as equalities from their level on.

    Args:
        problem: the levels.
        presses: rows to hold.
        like: a step whose violated soft rows are those that count.
    """
    m = problem.joint_count
    x, free = np.zeros(m), np.eye(m)
    locked = problem.bounds.lower == problem.bounds.upper
    thin = _thin_pairs(problem)
    fixed = [(problem.equalities.matrix, problem.equalities.target), (np.eye(m)[locked], problem.bounds.upper[locked])]
    fixed.append((thin, thin @ like))
    x, free = _meet(np.vstack([part[0] for part in fixed]), np.concatenate([part[1] for part in fixed]), x, free)
    presses = list(presses)
    for number in range(len(problem.levels) + 1):
        held = [press.row(problem) for press in presses if press.level == number]
        if held:
            x, free = _meet(np.array([row for row, _ in held]), np.array([side for _, side in held]), x, free)
        if number < len(problem.levels):
            level = problem.levels[number]
            counts = _counted(level, like)
            root = np.sqrt(level.weights[counts])
            x, free = _meet(level.matrix[counts], level.target[counts], x, free, root)
    return x + free @ (free.T @ (problem.reference - x))


def _meet(matrix: Array, target: Array, x: Array, free: Array, root: Array | None = None) -> tuple[Array, Array]:
    """Return x moved along `free` to the weighted least squares of matrix x = target, and what is free then."""
    if not len(matrix) or not free.shape[1]:
        return x, free
    lengths = np.linalg.norm(matrix, axis=1)
    root = (1.0 / np.maximum(lengths, 1e-300)) if root is None else root
    inner = matrix @ free
    _, s, vt = np.linalg.svd(inner, full_matrices=True)
    p = int(np.count_nonzero(s > 1e-6 * np.linalg.norm(matrix, 2)))
    felt = vt[:p].T
    move = (
        np.linalg.lstsq(root[:, None] * (inner @ felt), root * (target - matrix @ x), rcond=None)[0] if p else np.zeros(0)
    )
    return x + free @ (felt @ move), free @ vt[p:].T


def sensitivity(known: KnownHierarchy, change: float = 1e-9) -> float:
    """Return how much the optimum moves, relatively, per relative change of the problem's numbers (three random ones)."""
    rng = np.random.default_rng([known.seed, 3])
    still = solution_on(known.problem, known.presses, known.dtheta)
    moves = []
    for _ in range(3):
        levels = [
            Level(
                level.matrix * (1.0 + change * rng.normal(size=level.matrix.shape)),
                level.target * (1.0 + change * rng.normal(size=level.target.shape)),
                level.weights,
                level.name,
                level.kind,
            )
            for level in known.problem.levels
        ]
        problem = known.problem
        other = IKProblem(levels, problem.bounds, problem.rows, problem.reference, problem.equalities)
        moves.append(np.linalg.norm(solution_on(other, known.presses, known.dtheta) - still))
    return float(max(moves) / (change * np.linalg.norm(known.dtheta)))


def exhausted_optimum(problem: IKProblem) -> Array:
    """Return the lexicographic optimum of a tiny problem by trying every set of rows as equalities.

    A soft level becomes least squares of excesses v with A dθ - v <= b as further rows. At every level the best of all
    feasible points is the least squares point on the rows that hold on the whole face of optima: it is among those tried.
    """
    m = problem.joint_count
    soft = [len(level.target) * level.is_soft for level in problem.levels]
    total = m + sum(soft)
    starts = m + np.concatenate([[0], np.cumsum(soft)]).astype(int)
    hard = problem.inequalities
    g, h = [_widened(hard.matrix, total)], [hard.upper]
    stages = []
    for level, start, count in zip(problem.levels, starts, soft, strict=False):
        root = np.sqrt(level.weights)
        if level.is_soft:
            excess = np.eye(total)[start : start + count]
            g.append(_widened(level.matrix, total) - excess)
            h.append(level.target)
            stages.append((root[:, None] * excess, np.zeros(count)))
        else:
            stages.append((root[:, None] * _widened(level.matrix, total), root * level.target))
    stages.append((_widened(np.eye(m), total), problem.reference))
    g, h = np.vstack(g), np.concatenate(h)
    fixed, side = _widened(problem.equalities.matrix, total), problem.equalities.target
    size = 1.0 + np.abs(h).max(initial=0.0)
    best = np.zeros(total)
    for matrix, target in stages:
        costs = []
        for count in range(min(total, len(h)) + 1):
            for chosen in itertools.combinations(range(len(h)), count):
                rows = list(chosen)
                x = _least_squares_on(matrix, target, np.vstack([fixed, g[rows]]), np.append(side, h[rows]), size)
                if x is not None and (g @ x <= h + 1e-8 * size).all():
                    costs.append((float(np.linalg.norm(matrix @ x - target)), x))
        best = min(costs, key=lambda pair: pair[0])[1]
        fixed, side = np.vstack([fixed, matrix]), np.append(side, matrix @ best)
    return best[:m]


def _widened(matrix: Array, width: int) -> Array:
    return np.hstack([matrix, np.zeros((len(matrix), width - matrix.shape[1]))])


def _least_squares_on(matrix: Array, target: Array, fixed: Array, side: Array, size: float) -> Array | None:
    """The least-norm least squares point of matrix x = target on fixed x = side, or None if there is no such x."""
    start, free = np.zeros(matrix.shape[1]), np.eye(matrix.shape[1])
    if len(fixed):
        start = np.linalg.lstsq(fixed, side, rcond=1e-9)[0]
        if np.abs(fixed @ start - side).max() > 1e-8 * size:
            return None
        free = _complement(_span(fixed))
    if not free.shape[1]:
        return start
    return start + free @ np.linalg.lstsq(matrix @ free, target - matrix @ start, rcond=1e-9)[0]


# Small linear algebra.


def _unit(vector: Array) -> Array:
    return vector / np.linalg.norm(vector)


def _span(vectors: Array) -> Array:
    """Return an orthonormal basis `(m, d)` of the span of `vectors` `(k, m)`, each of which counts as of length 1.

    Vectors of no length, `NOTHING` and less, are rounding.
    """
    norms = np.linalg.norm(vectors, axis=1)
    kept = vectors[norms > NOTHING] / norms[norms > NOTHING, None]
    if not len(kept):
        return np.zeros((vectors.shape[1], 0))
    _, s, vt = np.linalg.svd(kept, full_matrices=False)
    return vt[s > NOTHING * s[0]].T


def _complement(basis: Array) -> Array:
    """Return an orthonormal basis of what is orthogonal to the orthonormal `basis` `(m, d)`."""
    q, _ = np.linalg.qr(np.hstack([basis, np.eye(len(basis))]))
    return q[:, basis.shape[1] :]


def _orthonormal(rng: np.random.Generator, rows: int, columns: int) -> Array:
    return np.linalg.qr(rng.normal(size=(rows, columns)))[0]


def _is_clear(matrix: Array, free: Array) -> bool:
    """Return whether all singular values of `matrix` in the `free` directions are clear of zero, or zero."""
    if not matrix.any() or not free.shape[1]:
        return True
    s = np.linalg.svd(matrix @ free, compute_uv=False) / np.linalg.norm(matrix, 2)
    return not ((s > NOTHING) & (s < 0.99 * 10.0**-SPREAD)).any()


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
