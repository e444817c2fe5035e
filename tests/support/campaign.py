"""Hierarchies whose degeneracy is exact, and a judge that knows each one's optimum to the last bit.

A kind draws a clean problem of small integers and powers of two, so that what is parallel, redundant or empty is exactly
so; `exact.optimum` solves it in rational numbers. The library is given the same problem, or one that means the same with
the rounding of another representation: an arm in a plane that was turned in space, single precision, rows of 1e-17 that
are zero.

    python tests/support/campaign.py --count 100 --kinds sliver,wedge --solver daqp --first-seed 0

With --path one form of the solve answers alone: the Python form, or the compiled core, which declines what is not clear.
With --feign no solver is asked: the certificate is, about steps that are feasible and wrong.
"""

import argparse
import inspect
import sys
import zlib
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property, partial
from typing import Any

import exact
import numpy as np
import paths
import scipy.linalg

import prioritized_ik as pik
from prioritized_ik.solvers.compiled import fast
from prioritized_ik.solvers.damping import handed_down

Array = np.ndarray

EPSILON = float(np.finfo(float).eps)
COST = 1e-12  # of the level's terms: what a certified step may cost more than its certificate says
STEP = 1e-6  # of the step: how far it may be off where the certificate names no variation
BROKEN = 1e-8  # of the step: how far a certified one may break a row
ROUNDED = 64 * EPSILON  # of the longest step that any row asks for alone; a certificate's figures are no finer either
SINGLE = 2.0**-24  # relative error of a number in single precision
CARRIED = 64  # times the data's noise is what small problems of small integers make of it
LOST = 1e-10  # of the step: a displacement that may cost what it costs
LEANS = 1e-13  # of the step: breaking a row by more than this can be what changes the optimum

DIRECTIONS = ((1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (2.0, -1.0), (3.0, 4.0), (5.0, -3.0))  # in the ground, of any length

RIGHT = "right"
LOOSE = "loose"  # certified, and better than any step that keeps the rows, by breaking them within tolerance
WRONG = "wrong certified"
UNCERTIFIED = "uncertified"
NO_STEP = "no step"
CALLED_INFEASIBLE = "called infeasible"
MISSED = "infeasible missed"
DECLINED = "declined"  # by the compiled core, where it alone is asked
VERDICTS = (RIGHT, LOOSE, WRONG, UNCERTIFIED, NO_STEP, CALLED_INFEASIBLE, MISSED, DECLINED)
FATAL = (WRONG, CALLED_INFEASIBLE)


class Unsupported(Exception):
    """The library has no such option."""


class Sketch:
    """A problem while it is drawn; `anchor` keeps every row, so that it is feasible unless that is undone."""

    def __init__(self, rng: np.random.Generator, m: int | None = None) -> None:
        self.rng = rng
        self.m = int(rng.integers(2, 7)) if m is None else m
        self.levels: list[tuple[Array, Array, Array, bool]] = []
        self.anchor = rng.integers(-2, 3, self.m).astype(float)
        self.lower, self.upper = np.full(self.m, -np.inf), np.full(self.m, np.inf)
        self.rows: list[tuple[Array, float]] = []
        self.equalities: list[tuple[Array, float]] = []
        self.reference = np.zeros(self.m)
        self.metric: Array | None = None
        self.damping: dict[int, tuple[float, str]] = {}  # by level, and what it leaves to those below

    def integers(self, *shape: int, most: int = 3) -> Array:
        """Return whole numbers from -most to most."""
        return self.rng.integers(-most, most + 1, shape).astype(float)

    def vector(self) -> Array:
        """Return one that is not zero."""
        while True:
            found = self.integers(self.m)
            if found.any():
                return found

    def power(self, low: int, high: int) -> float:
        """Return a power of two."""
        return 2.0 ** int(self.rng.integers(low, high + 1))

    def chance(self, probability: float) -> bool:
        return bool(self.rng.random() < probability)

    def level(self, matrix: Any, target: Any, weights: Any = None, soft: bool = False) -> "Sketch":
        matrix, target = np.atleast_2d(np.array(matrix, float)), np.atleast_1d(np.array(target, float))
        weights = np.ones(len(target)) if weights is None else np.broadcast_to(np.array(weights, float), target.shape)
        self.levels.append((matrix, target, weights.copy(), soft))
        return self

    def random_levels(self, count: int | None = None, soft: float = 0.0, most: int = 9) -> "Sketch":
        """Add levels of one to three rows."""
        for _ in range(int(self.rng.integers(1, 4)) if count is None else count):
            k = int(self.rng.integers(1, 4))
            weights = 2.0 ** self.rng.integers(-2, 3, k) if self.chance(0.3) else None
            matrix = np.array([self.vector() for _ in range(k)])
            self.level(matrix, self.integers(k, most=most), weights, self.chance(soft))
        return self

    def posture(self) -> "Sketch":
        """Add a level that asks every joint for something."""
        return self.level(np.eye(self.m), self.integers(self.m, most=4))

    def box(self, least: int = 0, most: int = 3) -> "Sketch":
        """Bound the joints at whole distances around the anchor."""
        self.lower = self.anchor - self.rng.integers(least, most + 1, self.m)
        self.upper = self.anchor + self.rng.integers(max(least, 1), most + 1, self.m)
        return self

    def row(self, normal: Array, gap: float = 0.0) -> "Sketch":
        self.rows.append((normal, float(normal @ self.anchor + gap)))
        return self

    def random_rows(self, count: int | None = None, least: int = 0) -> "Sketch":
        for _ in range(int(self.rng.integers(1, 4)) if count is None else count):
            self.row(self.vector(), float(self.rng.integers(least, 4)))
        return self

    def equal(self, normal: Array) -> "Sketch":
        self.equalities.append((normal, float(normal @ self.anchor)))
        return self

    def limits(self) -> "Sketch":
        """Add bounds, rows or both."""
        which = self.rng.integers(3)
        if which != 0:
            self.box()
        if which != 1:
            self.random_rows()
        return self

    def times(self, factor: float) -> "Sketch":
        """Multiply every step of the problem."""
        self.levels = [(a, b * factor, w, soft) for a, b, w, soft in self.levels]
        self.lower, self.upper = self.lower * factor, self.upper * factor
        self.rows = [(g, h * factor) for g, h in self.rows]
        self.equalities = [(e, f * factor) for e, f in self.equalities]
        self.reference, self.anchor = self.reference * factor, self.anchor * factor
        return self

    def in_units(self, units: Array) -> "Sketch":
        """Measure joint j in units 1 / units[j]."""
        self.levels = [(a / units, b, w, soft) for a, b, w, soft in self.levels]
        self.lower, self.upper = self.lower * units, self.upper * units
        self.rows = [(g / units, h) for g, h in self.rows]
        self.equalities = [(e / units, f) for e, f in self.equalities]
        self.reference, self.anchor = self.reference * units, self.anchor * units
        return self

    def copy(self) -> "Sketch":
        """Return one with lists of its own."""
        twin = Sketch(self.rng, self.m)
        vars(twin).update(vars(self))
        twin.levels, twin.rows, twin.equalities = list(self.levels), list(self.rows), list(self.equalities)
        twin.damping = dict(self.damping)
        return twin

    def problem(self, **options: float) -> pik.IKProblem:
        """Return it as the library takes it."""
        if self.metric is not None:
            options["metric"] = self.metric  # type: ignore[assignment]
        for name in options:
            if name not in inspect.signature(pik.IKProblem).parameters:
                raise Unsupported(name)
        return pik.IKProblem(
            [
                pik.Level(a, b, w, f"level {i + 1}", "at_most" if s else "equal", *self.damping.get(i, ()))
                for i, (a, b, w, s) in enumerate(self.levels)
            ],
            pik.Bounds(self.lower, self.upper),
            pik.Rows(np.reshape([g for g, _ in self.rows], (-1, self.m)), [h for _, h in self.rows]),
            self.reference,
            pik.Equalities(np.reshape([e for e, _ in self.equalities], (-1, self.m)), [f for _, f in self.equalities]),
            **options,
        )


@dataclass(frozen=True)
class Case:
    """A problem for the library, the clean one that it means, and the relative noise that is between them."""

    kind: str
    seed: int
    problem: pik.IKProblem
    clean: exact.ExactProblem
    noise: float = 0.0

    @cached_property
    def optimum(self) -> exact.Optimum | None:
        """The exact one; None where no step keeps the rows."""
        return exact.optimum(self.clean)

    @cached_property
    def asked(self) -> float:
        """How long a step the levels ask for, each row alone or all without hard rows, in the metric."""
        free = replace(self.clean, rows=[], upper=[])
        reached = exact.optimum(free)
        assert reached is not None
        return max(_longest(free, self.measure), self.measure.length(reached.x))

    @cached_property
    def measure(self) -> "Measure":
        """Of lengths, in the metric."""
        return Measure.of(self.clean)

    @cached_property
    def aimed(self) -> pik.IKProblem:
        """The library's problem, its damped levels asking for what their damped optimum reaches."""
        return self.problem.with_levels(
            [
                pik.Level(given.matrix, [float(b) for b in level.target], given.weights, given.name)
                if given.hands_down
                else given
                for given, level in zip(self.problem.levels, self.clean.levels, strict=True)
            ]
        )


@dataclass(frozen=True)
class Measure:
    """Lengths in a joint metric M = Rᵀ R, R upper triangular."""

    root: Array
    inverse: Array

    @staticmethod
    def of(problem: exact.ExactProblem) -> "Measure":
        root = np.linalg.cholesky(np.array(problem.metric, float)).T
        return Measure(root, scipy.linalg.solve_triangular(root, np.eye(len(root))))

    def length(self, step: exact.Vector) -> float:
        return float(np.linalg.norm(self.root @ np.array(step, float)))

    def row_length(self, row: exact.Vector) -> float:
        """Return by how much a step of length 1 changes `row` x at most."""
        return float(np.linalg.norm(np.array(row, float) @ self.inverse))

    @property
    def of_joints(self) -> Array:
        """By how much a step of length 1 moves each joint at most."""
        return np.linalg.norm(self.inverse, axis=1)


@dataclass(frozen=True)
class Drawn:
    """What a kind draws where the library is given something else than the clean problem."""

    clean: Sketch
    given: Sketch
    noise: float = 4 * EPSILON
    options: dict[str, float] = field(default_factory=dict)


Kind = Callable[[np.random.Generator], "Sketch | Drawn"]
KINDS: dict[str, Kind] = {}


def kind(draw_one: Kind) -> Kind:
    """Enter a kind under its function's name."""
    KINDS[draw_one.__name__] = draw_one
    return draw_one


def draw(name: str, seed: int) -> Case:
    """Return a hierarchy of the kind.

    Raises:
        Unsupported: the library lacks an option that the kind needs.
    """
    drawn = KINDS[name](np.random.default_rng([seed, zlib.crc32(name.encode())]))
    if isinstance(drawn, Sketch):
        problem = drawn.problem()
        return Case(name, seed, problem, exact.ExactProblem.of(problem))
    clean = exact.ExactProblem.of(drawn.clean.problem())
    return Case(name, seed, drawn.given.problem(**drawn.options), clean, drawn.noise)


def supported() -> list[str]:
    """Return the kinds for which the library has the options."""
    return [name for name in KINDS if _is_supported(name)]


def _is_supported(name: str) -> bool:
    try:
        draw(name, 0)
    except Unsupported:
        return False
    return True


# Plain.


@kind
def dyadic(rng: np.random.Generator) -> Sketch:
    """Normal numbers, rounded to 2^-12."""
    s = Sketch(rng)

    def normal(*shape: int) -> Array:
        return np.round(rng.normal(size=shape) * 2**12) / 2**12

    for _ in range(rng.integers(1, 4)):
        k = int(rng.integers(1, 4))
        s.level(normal(k, s.m), 3 * normal(k), 2.0 ** rng.integers(-3, 4, k), s.chance(0.2))
    s.lower, s.upper = -np.abs(normal(s.m)), np.abs(normal(s.m))
    s.anchor[:] = 0.0
    for _ in range(rng.integers(0, 3)):
        s.row(normal(s.m), float(np.abs(normal(1))[0]))
    return s


@kind
def integer(rng: np.random.Generator) -> Sketch:
    return Sketch(rng).random_levels().limits()


@kind
def free(rng: np.random.Generator) -> Sketch:
    """No row at all: the closed form."""
    return Sketch(rng).random_levels()


@kind
def reference(rng: np.random.Generator) -> Sketch:
    s = Sketch(rng).random_levels(int(rng.integers(1, 3))).limits()
    s.reference = s.integers(s.m, most=5)
    return s


@kind
def many_levels(rng: np.random.Generator) -> Sketch:
    return Sketch(rng, int(rng.integers(4, 7))).random_levels(4, soft=0.2).limits()


@kind
def soft_mix(rng: np.random.Generator) -> Sketch:
    return Sketch(rng).random_levels(int(rng.integers(2, 5)), soft=0.6, most=3).limits()


@kind
def soft_first(rng: np.random.Generator) -> Sketch:
    s = Sketch(rng).random_levels(1, soft=1.0, most=3).random_levels(2).posture()
    return s.box() if s.chance(0.5) else s


# Repeated, redundant and contradictory tasks.


@kind
def copies(rng: np.random.Generator) -> Sketch:
    """Rows twice: in a level, in the next one, among the hard rows."""
    s = Sketch(rng).random_levels(2).limits()
    a, b, w, soft = s.levels[int(rng.integers(2))]
    s.level(np.vstack([a, a]), np.concatenate([b, b]), np.concatenate([w, w]), soft)
    s.rows += s.rows[:2]
    return s.posture()


@kind
def scaled_copies(rng: np.random.Generator) -> Sketch:
    """Rows once more, of another length."""
    s = Sketch(rng).random_levels(2).limits()
    a, b, _, _ = s.levels[0]
    scale = 2.0 ** rng.integers(-8, 9, len(b))
    s.level(np.vstack([a, a * scale[:, None]]), np.concatenate([b, b * scale + rng.integers(0, 2)]))
    s.rows += [(g * factor, h * factor) for g, h in s.rows[:2] for factor in (s.power(-8, 8),)]
    return s.posture()


@kind
def rank_one(rng: np.random.Generator) -> Sketch:
    s = Sketch(rng)
    for _ in range(rng.integers(1, 4)):
        k = int(rng.integers(2, 5))
        s.level(np.outer(s.integers(k), s.vector()), s.integers(k, most=9))
    return s.limits()


@kind
def conflicts(rng: np.random.Generator) -> Sketch:
    """Each level wants otherwise what one above has settled, besides something new."""
    s = Sketch(rng).random_levels(1)
    for _ in range(rng.integers(1, 4)):
        a = s.levels[-1][0]
        mixed = s.integers(2, len(a), most=2) @ a
        s.level(np.vstack([mixed, s.vector()]), s.integers(3, most=9))
    return s.limits()


@kind
def near_redundant(rng: np.random.Generator) -> Sketch:
    """Two rows of a level are apart by 2^-k."""
    s = Sketch(rng)
    a, step = s.vector(), s.power(-20, -5)
    s.level([a, a + step * s.vector()], s.integers(2, most=4) * np.array([1.0, step])).posture()
    return s.box() if s.chance(0.5) else s


@kind
def nearly_parallel_levels(rng: np.random.Generator) -> Sketch:
    """A level feels what the one above leaves to it only by 2^-k."""
    s = Sketch(rng)
    a, step, target = s.vector(), s.power(-24, -5), s.integers(1, most=4)
    return s.level(a, target).level(a + step * s.vector(), target + step * s.integers(1)).posture().box()


@kind
def zero_rows(rng: np.random.Generator) -> Sketch:
    """Rows of zeros, everywhere."""
    s = Sketch(rng).random_levels(1)
    nothing = np.zeros(s.m)
    s.level([nothing, s.vector()], s.integers(2)).level(nothing, [1.0]).level(nothing, s.integers(1), soft=True)
    s.limits().row(nothing, float(rng.integers(0, 2)))
    return s.equal(nothing).posture() if s.chance(0.5) else s


# Bounds, equalities, feasible sets.


@kind
def bounds_at_zero(rng: np.random.Generator) -> Sketch:
    """Joints at a stop: one of their bounds is zero."""
    s = Sketch(rng)
    s.anchor[:] = 0.0
    s.random_levels(int(rng.integers(1, 4)), soft=0.2)
    side = rng.integers(0, 3, s.m)
    s.lower, s.upper = np.where(side == 0, 0.0, -2.0), np.where(side == 1, 0.0, 2.0)
    return s.random_rows(2) if s.chance(0.5) else s


@kind
def frozen_joints(rng: np.random.Generator) -> Sketch:
    """Joints whose bounds are one."""
    s = Sketch(rng).random_levels(soft=0.2).box().random_rows(1)
    frozen = rng.random(s.m) < 0.5
    s.lower, s.upper = np.where(frozen, s.anchor, s.lower), np.where(frozen, s.anchor, s.upper)
    return s


@kind
def equalities(rng: np.random.Generator) -> Sketch:
    s = Sketch(rng).random_levels(soft=0.2).limits()
    for _ in range(rng.integers(1, max(2, s.m - 1))):
        s.equal(s.vector())
    return s


@kind
def repeated_equalities(rng: np.random.Generator) -> Sketch:
    """Equalities once more, of another length, and as combinations."""
    s = Sketch(rng, int(rng.integers(3, 7))).random_levels(soft=0.2).limits()
    for _ in range(rng.integers(1, 3)):
        s.equal(s.vector())
    s.equalities += [(e * factor, f * factor) for e, f in s.equalities for factor in (s.power(-4, 4),)]
    e, f = (sum(part) for part in zip(*s.equalities, strict=True))
    s.equalities.append((e, f))
    return s


@kind
def nearly_repeated_equalities(rng: np.random.Generator) -> Drawn:
    """Equalities once more with a relative rounding of 1e-15."""
    clean = Sketch(rng, int(rng.integers(3, 7))).random_levels(soft=0.2).box(1).random_rows(1, 1)
    for _ in range(rng.integers(1, 3)):
        clean.equal(clean.vector())
    given = clean.copy()
    given.equalities += [(e * (1 + 1e-15 * rng.normal(size=clean.m)), f) for e, f in clean.equalities]
    return Drawn(clean, given, 1e-15)


@kind
def thin_set(rng: np.random.Generator) -> Sketch:
    """Two opposite rows with nothing, or 2^-k, between them."""
    s = Sketch(rng).random_levels(soft=0.2).limits()
    for _ in range(rng.integers(1, 3)):
        normal = s.vector()
        s.row(normal).row(-normal * s.power(-3, 3), s.power(-40, -5) if s.chance(0.5) else 0.0)
    return s


@kind
def thin_for_the_step(rng: np.random.Generator) -> Sketch:
    """Two opposite rows about as far apart as a certificate lets a step break one; levels above may all but settle them."""
    s = Sketch(rng, int(rng.integers(3, 7))).random_levels().random_rows(2).times(2.0**10)
    normal = s.vector()
    if s.chance(0.5):
        level = s.levels[0][0]
        normal = s.integers(len(level), most=2) @ level + s.power(-10, -2) * normal
    s.row(normal).row(-normal)
    best = exact.optimum(exact.ExactProblem.of(s.problem()))
    assert best is not None
    normal, _ = s.rows.pop()
    size = np.linalg.norm(np.array(best.x, float)) or 1.0
    return s.row(normal, 2.0 ** np.floor(np.log2(1e-8 * size * np.linalg.norm(normal))))


@kind
def empty_interior(rng: np.random.Generator) -> Sketch:
    """Three or more rows that only together leave no room: a positive combination of them is zero."""
    s = Sketch(rng, int(rng.integers(3, 7))).random_levels(soft=0.2)
    normals = [s.vector() for _ in range(int(rng.integers(2, 4)))]
    for normal in [*normals, -np.sum(normals, axis=0)]:
        s.row(normal)
    return s.box() if s.chance(0.5) else s


@kind
def degenerate_vertex(rng: np.random.Generator) -> Sketch:
    """More rows through the anchor than there are joints, and levels that press on it."""
    s = Sketch(rng, int(rng.integers(2, 5)))
    for _ in range(s.m + int(rng.integers(1, 4))):
        s.row(np.abs(s.vector()) if s.chance(0.7) else s.vector())
    s.level(np.eye(s.m), s.anchor + s.integers(s.m, most=2) + 2.0)
    return s.random_levels(1)


@kind
def barely_feasible(rng: np.random.Generator) -> Sketch:
    """A row that only one corner of the box reaches, or one face of it."""
    s = Sketch(rng).random_levels(soft=0.2).box()
    normal = s.vector()
    corner = np.where(normal > 0, s.upper, s.lower)
    s.rows.append((-normal, float(-normal @ corner)))
    return s


@kind
def infeasible(rng: np.random.Generator) -> Sketch:
    """A row that no corner of the box reaches, by 2^-4 or more."""
    s = Sketch(rng).random_levels(soft=0.2).box()
    normal = s.vector()
    corner = np.where(normal > 0, s.upper, s.lower)
    if s.chance(0.5):
        s.rows.append((-normal, float(-normal @ corner) - s.power(-4, 3)))
    else:
        s.equalities.append((normal, float(normal @ corner) + s.power(-4, 3)))
    return s.random_rows(1)


@kind
def sliver(rng: np.random.Generator) -> Sketch:
    """y <= 0, -y + d x <= e and -y - d x <= e: a triangle 2 e / d long and e high; level 1 wants along it."""
    s = Sketch(rng, 3)
    d, e, room = s.power(-28, -5), s.power(-30, -5), s.power(-3, 2)
    e = d * room if s.chance(0.7) else e
    s.rows = [(np.array(g), h) for g, h in (((0.0, 1.0, 0.0), 0.0), ((d, -1.0, 0.0), e), ((-d, -1.0, 0.0), e))]
    s.level([1.0, 0.0, 0.0], s.integers(1)).level([0.0, 0.0, 1.0], [1.0])
    return s.level([0.0, 1.0, 1.0], s.integers(1), soft=s.chance(0.3))


@kind
def wedge(rng: np.random.Generator) -> Sketch:
    """Two rows at an angle of 2^-k, open on one side; the step can be where they are far apart or near."""
    s = Sketch(rng, 3)
    d, room = s.power(-28, -5), s.power(-3, 2)
    s.rows = [(np.array([0.0, 1.0, 0.0]), 0.0), (np.array([d, -1.0, 0.0]), d * room)]
    s.level([1.0, 0.0, 0.0], s.integers(1)).level([0.0, 0.0, 1.0], [1.0])
    return s.level(s.vector(), s.integers(1))


@kind
def row_nearly_parallel(rng: np.random.Generator) -> Sketch:
    """A hard row that leaves room for the next level only in the ratio 2^-k to the level above."""
    s = Sketch(rng, int(rng.integers(2, 4)))
    d, target, room = s.power(-28, -5), float(rng.integers(1, 3)), s.power(-6, 1)
    across, along = np.eye(s.m)[0], np.eye(s.m)[1]
    s.rows = [(across + d * along, target + d * room * float(rng.integers(0, 2)))]
    return s.level(across, target).level(along, s.integers(1)).posture()


@kind
def pushed_hard(rng: np.random.Generator) -> Sketch:
    """A row that hardly feels what the level above leaves: a turn of what that decides moves the optimum along it."""
    s = Sketch(rng, int(rng.integers(3, 6)))
    task = [s.vector() for _ in range(s.m - 2)]
    s.level(task, s.integers(s.m - 2, most=9))
    s.row(s.integers(s.m - 2, most=2) @ np.array(task) + s.power(-24, -14) * s.vector())
    s.reference = s.integers(s.m, most=5)
    return s


@kind
def row_needs_far_joint(rng: np.random.Generator) -> Sketch:
    """x1 <= r x2 with r = 2^-k, where x2 has room of about 1 / r and level 1 feels x1 alone."""
    s = Sketch(rng, 2)
    r = s.power(-26, -5)
    far = s.power(-3, 1) / r
    s.lower, s.upper = np.array([-1.0, -far]), np.array([1.0, far])
    s.rows = [(np.array([1.0, -r]), 0.0)]
    return s.level([1.0, 0.0], [s.power(-2, 1)])


# Sizes and units.


@kind
def far_targets(rng: np.random.Generator) -> Sketch:
    """A level demands 2^10 to 2^30 times what the bounds allow."""
    s = Sketch(rng).random_levels(1).box()
    a, b, w, soft = s.levels[0]
    s.levels[0] = (a, b * s.power(10, 30), w, soft)
    return s.random_levels(1, soft=0.3).posture()


@kind
def far_weak(rng: np.random.Generator) -> Sketch:
    """The same beside a direction of the same level that is felt 2^-k as much."""
    s = Sketch(rng, int(rng.integers(2, 5))).box(1)
    weak = s.power(-14, -4)
    return s.level(np.eye(s.m)[:2] * [[1.0], [weak]], [s.power(5, 24), weak * float(rng.integers(-2, 3)) / 2]).posture()


@kind
def weight_ratio(rng: np.random.Generator) -> Sketch:
    """Weights up to 2^40 apart in one level, with bounds."""
    s = Sketch(rng)
    k = int(rng.integers(2, s.m + 2))
    s.level([s.vector() for _ in range(k)], s.integers(k, most=5), 2.0 ** rng.integers(-20, 21, k))
    return s.box() if s.chance(0.8) else s.posture()


@kind
def tiny_steps(rng: np.random.Generator) -> Sketch:
    """All steps are 2^-10 to 2^-40 as long."""
    s = Sketch(rng).random_levels(soft=0.2).limits()
    return s.times(s.power(-40, -10))


@kind
def huge_steps(rng: np.random.Generator) -> Sketch:
    s = Sketch(rng).random_levels(soft=0.2).limits()
    return s.times(s.power(10, 20))


@kind
def row_units(rng: np.random.Generator) -> Sketch:
    """Rows in units from 2^-10 to 2^20 of one another, weights to match."""
    s = Sketch(rng).random_levels(soft=0.3).limits()
    if s.chance(0.3):
        s.equal(s.vector())
    for i, (a, b, w, soft) in enumerate(s.levels):
        units = 2.0 ** rng.integers(-10, 21, len(b))
        s.levels[i] = (a * units[:, None], b * units, w / units**2, soft)
    s.rows = [(g * unit, h * unit) for g, h in s.rows for unit in (s.power(-10, 20),)]
    s.equalities = [(e * unit, f * unit) for e, f in s.equalities for unit in (s.power(-10, 20),)]
    return s


@kind
def joint_units(rng: np.random.Generator) -> Sketch:
    """Joints in units up to 2^20 apart; the last level measures in the units of each."""
    s = Sketch(rng).random_levels(soft=0.2).limits()
    return s.in_units(2.0 ** rng.integers(-10, 11, s.m))


@kind
def joint_units_and_metric(rng: np.random.Generator) -> Sketch:
    """The same with the metric that makes up for it."""
    s = Sketch(rng).random_levels(soft=0.2).limits()
    units = 2.0 ** rng.integers(-10, 11, s.m)
    s.metric = units**-2
    return s.in_units(units)


@kind
def metric(rng: np.random.Generator) -> Sketch:
    s = Sketch(rng).random_levels(soft=0.2).limits()
    s.metric = 2.0 ** rng.integers(-6, 7, s.m)
    s.reference = s.integers(s.m)
    return s


@kind
def posture_as_rows(rng: np.random.Generator) -> Sketch:
    """c I below J in one level, c = 2^-k."""
    return _posture_below(rng, as_weights=False)


@kind
def posture_as_weights(rng: np.random.Generator) -> Sketch:
    """The same with I below J and weights c²."""
    return _posture_below(rng, as_weights=True)


def _posture_below(rng: np.random.Generator, as_weights: bool) -> Sketch:
    s = Sketch(rng, int(rng.integers(3, 7)))
    k, c = int(rng.integers(1, 4)), s.power(-20, -5)
    jacobian, target, rest = s.integers(k, s.m), s.integers(k), s.integers(s.m)
    factor, weight = (1.0, c**2) if as_weights else (c, 1.0)
    weights = np.concatenate([np.ones(k), np.full(s.m, weight)])
    s.level(np.vstack([jacobian, factor * np.eye(s.m)]), np.concatenate([target, factor * rest]), weights)
    return s.box() if s.chance(0.5) else s


# Robots.


@kind
def arm_on_wheels(rng: np.random.Generator) -> Sketch:
    """An arm whose links turn in one plane, on wheels that do not slip: up to six levels, the last one damped or not."""
    return _damped(_arm_on_wheels(rng))


@kind
def robot_at_rest(rng: np.random.Generator) -> Sketch:
    """The same where it has arrived at what it can reach, seen from there: what is left of its step is rounding."""
    s = _arm_on_wheels(rng)
    there = exact.optimum(exact.ExactProblem.of(s.problem()))
    assert there is not None

    def left(row: Array, side: float) -> float:
        return float(Fraction(side) - sum((Fraction(a) * x for a, x in zip(row, there.x, strict=True)), Fraction(0)))

    s.levels = [(a, np.array(list(map(left, a, b))), w, soft) for a, b, w, soft in s.levels]
    s.lower, s.upper = (np.array(list(map(left, np.eye(s.m), side))) for side in (s.lower, s.upper))
    s.rows = [(row, left(row, side)) for row, side in s.rows]
    s.equalities = [(row, left(row, side)) for row, side in s.equalities]
    return _damped(s)


def _arm_on_wheels(rng: np.random.Generator) -> Sketch:
    """Return levels of a tool's position and orientation, a base at rest and a posture, in coordinates of whole numbers."""
    s = Sketch(rng, 9)
    heading, plane = (np.array(DIRECTIONS[rng.integers(len(DIRECTIONS))]) for _ in range(2))
    position, orientation = np.zeros((3, s.m)), np.zeros((3, s.m))
    position[:2, :2] = np.eye(2)
    position[:2, 2], position[:2, 3] = s.integers(2), int(rng.integers(1, 4)) * np.array([-plane[1], plane[0]])
    position[:2, 4:7], position[2, 4:7] = np.outer(plane, s.integers(3)), s.integers(3)
    position[:, 7] = s.integers(3) if s.chance(0.5) else 0.0
    orientation[2, 2:4], orientation[:2, 4:7] = 1.0, np.array([[-plane[1]], [plane[0]]])
    orientation[:, 7] = s.integers(3)
    orientation[:, 8] = [*int(rng.integers(1, 3)) * plane, float(rng.integers(0, 3))]
    far = s.power(-1, 3)
    for rows, weight in ((position, float(rng.choice([1.0, 100.0]))), (orientation, 1.0)):
        s.level(rows, far * s.integers(3), weight)
    base, posture = np.eye(s.m)[:3], np.eye(s.m)
    s.level(base[:2], np.zeros(2)).level(base[2:], [0.0], 0.25)
    for part in (posture[:5], posture[5:]):
        s.level(part, s.integers(len(part)), 2.0 ** rng.integers(-9, 1, len(part)))
    del s.levels[int(rng.integers(1, 7)) :]
    s.anchor[:] = 0.0
    s.lower, s.upper = -rng.integers(0, 3, s.m).astype(float), rng.integers(1, 3, s.m).astype(float)
    s.lower, s.upper = np.where(rng.random(s.m) < 0.5, (s.lower, s.upper), (-s.upper, -s.lower))
    s.equal(np.array([-heading[1], heading[0], *np.zeros(7)]))
    return s.row(-position[2], float(rng.integers(0, 4))) if s.chance(0.5) and position[2].any() else s


def _damped(s: Sketch) -> Sketch:
    """Add damping to the last level, as its rows, or none."""
    if s.chance(0.7):
        a, b, w, _ = s.levels.pop()
        root = 2.0 ** -float(s.rng.choice([5, 10, 20]))
        s.level(np.vstack([a, root * np.eye(s.m)]), [*b, *np.zeros(s.m)], [*w, *np.ones(s.m)])
    return s


# Rounding of another representation.


@kind
def planar_levels(rng: np.random.Generator) -> Drawn:
    """An arm in a plane, turned in space: three rows a level of which a combination is rounding."""
    clean = Sketch(rng, int(rng.integers(3, 7)))
    given, turn = clean.copy(), _turn(rng)
    for _ in range(rng.integers(1, 3)):
        jacobian, target = clean.integers(2, clean.m), clean.integers(2, most=6)
        clean.level(jacobian, target)
        given.level(turn[:, :2] @ jacobian, turn[:, :2] @ target)
    return _finished(clean, given)


@kind
def planar_rows(rng: np.random.Generator) -> Drawn:
    """Such an arm that slides on a plane: contact rows along its own normal are rounding, others are not."""
    clean = Sketch(rng, int(rng.integers(3, 7))).random_levels(int(rng.integers(1, 3)))
    given, turn = clean.copy(), _turn(rng)
    for _ in range(rng.integers(1, 4)):
        jacobian, side = turn[:, :2] @ clean.integers(2, clean.m), turn[:, :2] @ clean.integers(2)
        sign = float(rng.choice([-1.0, 1.0]))
        given.rows.append((sign * turn[:, 2] @ jacobian, float(rng.choice([0.0, 1.0]) * (turn[:, 2] @ side))))
    jacobian, normal = clean.integers(2, clean.m), clean.integers(2)
    clean.row(normal @ jacobian, 1.0)
    given.rows.append(((turn[:, :2] @ normal) @ (turn[:, :2] @ jacobian), clean.rows[-1][1]))
    return _finished(clean, given)


@kind
def planar_equalities(rng: np.random.Generator) -> Drawn:
    """A closed loop in a plane, turned in space: three equalities of rank two."""
    clean = Sketch(rng, int(rng.integers(3, 7))).random_levels(int(rng.integers(1, 3)))
    given, turn = clean.copy(), _turn(rng)
    jacobian = clean.integers(2, clean.m)
    for row in jacobian:
        clean.equal(row)
    sides = np.array([f for _, f in clean.equalities])
    given.equalities = list(zip(turn[:, :2] @ jacobian, map(float, turn[:, :2] @ sides), strict=True))
    return _finished(clean, given)


@kind
def planar_soft(rng: np.random.Generator) -> Drawn:
    """A soft level of contact rows in a plane, beside some along the normal of the plane."""
    clean = Sketch(rng, int(rng.integers(3, 7)))
    given, turn = clean.copy(), _turn(rng)
    jacobian, normals, side = clean.integers(2, clean.m), clean.integers(2, 2), clean.integers(2)
    clean.level(normals @ jacobian, side, soft=True)
    turned = turn[:, :2] @ jacobian
    flat = np.array([turn[:, 2] @ turned, -turn[:, 2] @ turned])
    given.level(np.vstack([normals @ turn[:, :2].T @ turned, flat]), [*side, 0.0, 0.0], soft=True)
    for sketch, task in ((clean, jacobian), (given, turned)):
        sketch.level(task, [3.0, 4.0] if sketch is clean else turn[:, :2] @ [3.0, 4.0])
    return _finished(clean, given)


@kind
def rounding_rows(rng: np.random.Generator) -> Drawn:
    """Hard rows and equalities of 1e-17 beside whole ones."""
    clean = Sketch(rng).random_levels(soft=0.2).random_rows(1, 1)
    given = clean.copy()
    for _ in range(rng.integers(1, 3)):
        given.rows.append((_dust(rng, clean.m), float(rng.choice([0.0, 1.0, -1e-17, 1e-17]))))
    if clean.chance(0.5):
        given.equalities.append((_dust(rng, clean.m), float(rng.choice([0.0, 1e-17]))))
    return _finished(clean, given)


@kind
def rounding_levels(rng: np.random.Generator) -> Drawn:
    """Levels of 1e-17, alone or as a row of one, with a target that nothing can reach, or none."""
    clean = Sketch(rng)
    given = clean.copy()
    target, other = float(rng.choice([0.0, 0.25])), clean.integers(1)
    soft = clean.chance(0.3)
    row, whole = _dust(rng, clean.m), clean.vector()
    clean.level([np.zeros(clean.m), whole], [target, *other], soft=soft)
    given.level([row, whole], [target, *other], soft=soft)
    if clean.chance(0.5):
        clean.levels.insert(0, (np.zeros((1, clean.m)), np.array([0.25]), np.ones(1), False))
        given.levels.insert(0, (_dust(rng, clean.m)[None], np.array([0.25]), np.ones(1), False))
    return _finished(clean, given)


@kind
def single_precision(rng: np.random.Generator) -> Drawn:
    """A planar arm turned in space whose numbers went through single precision; the library is told of the noise."""
    clean = Sketch(rng, int(rng.integers(3, 7)))
    given, turn = clean.copy(), _turn(rng)
    while np.linalg.svd(jacobian := clean.integers(2, clean.m), compute_uv=False)[1] < 1.0:
        pass
    target = clean.integers(2, most=6)
    clean.level(jacobian, target)
    given.level(*(np.float32(turn[:, :2] @ part) for part in (jacobian, target)))
    return Drawn(*_both(clean, given), SINGLE, {"noise": 1e-6})


def _turn(rng: np.random.Generator) -> Array:
    """Return a rotation: any, or one of a right angle with the rounding that a quaternion leaves."""
    w, x, y, z = rng.normal(size=4) if rng.random() < 0.6 else np.array([1.0, *rng.permutation([1.0, 0.0, 0.0])])
    n = np.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w / n, x / n, y / n, z / n
    return np.array([
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ])  # fmt: skip


def _dust(rng: np.random.Generator, m: int) -> Array:
    """Return a row of rounding."""
    return 1e-17 * rng.normal(size=m)


def _finished(clean: Sketch, given: Sketch) -> Drawn:
    return Drawn(*_both(clean, given))


def _both(clean: Sketch, given: Sketch) -> tuple[Sketch, Sketch]:
    """Give both the same bounds, or none, and the same level of all joints."""
    if clean.chance(0.6):
        clean.box(1)
    if clean.chance(0.6):
        clean.posture()
        given.levels.append(clean.levels[-1])
    given.lower, given.upper = clean.lower, clean.upper
    return clean, given


# Several at once.


@kind
def mixed(rng: np.random.Generator) -> Sketch:
    """One of the kinds above with one to three features more; no row is so short, in the metric, that it counts as none."""
    while True:
        s = KINDS[str(rng.choice(MIXABLE))](rng)
        if not isinstance(s, Sketch):
            continue
        for number in rng.choice(len(FEATURES), int(rng.integers(1, 4)), replace=False):
            FEATURES[number](s)
        matrix = [*(row for a, *_ in s.levels for row in a), *(g for g, _ in (*s.rows, *s.equalities)), np.zeros(s.m)]
        measure = Measure.of(exact.ExactProblem.of(s.problem()))
        sizes = np.array([1.0, *map(measure.row_length, matrix)])
        if not ((sizes > 0.0) & (sizes < SHORTEST * sizes.max())).any():
            return s


@kind
def rounded_by_metric(rng: np.random.Generator) -> Sketch:
    """Rows that a metric rounds, where that decides: a held level misses much, or large multipliers cancel."""
    s = Sketch(rng, int(rng.integers(2, 6)))
    factors = s.rng.integers(1, 4, int(rng.integers(2, 4))) * rng.choice((-1.0, 1.0))
    s.level(factors[:, None] * s.vector(), s.integers(len(factors), most=9))
    s.random_levels(int(rng.integers(0, 3)))
    s.damping[int(rng.integers(len(s.levels)))] = (s.power(-44, -12), "hold")
    if s.chance(0.5):
        row = s.vector()
        s.row(row).row(s.power(-26, -8) * s.vector() - row, s.power(-30, -6))
    _with_metric(s)
    return s


def _with_metric(s: Sketch) -> None:
    """Measure in a matrix that couples joints."""
    root = s.integers(s.m, s.m, most=2)
    own = np.ones(s.m) if s.metric is None else s.metric
    s.metric = np.diag(own) + s.power(-6, 6) * (root.T @ root)


def _with_damping(s: Sketch) -> None:
    """Damp a level of least squares, if there is one; what holds all joints, or leaves what it does not reach."""
    among = [number for number, (*_, soft) in enumerate(s.levels) if not soft]
    if among:
        s.damping[int(s.rng.choice(among))] = (s.power(-40, 2), str(s.rng.choice(BELOW)))


def _with_reference(s: Sketch) -> None:
    """Aim the last level, near or far."""
    s.reference = s.integers(s.m, most=5) * s.power(-10, 10)


def _scaled(s: Sketch) -> None:
    """Multiply the hard rows, a level or its rows by powers of two: the levels of all rows mean another problem then."""
    which = int(s.rng.integers(3))
    if which == 0:
        s.rows = [(g * factor, h * factor) for g, h in s.rows for factor in (s.power(-20, 20),)]
    elif s.levels:
        number = int(s.rng.integers(len(s.levels)))
        a, b, w, soft = s.levels[number]
        factors = np.full(len(b), s.power(-20, 20)) if which == 1 else 2.0 ** s.rng.integers(-20, 21, len(b))
        s.levels[number] = (a * factors[:, None], b * factors, w, soft)


def _with_rows_nearly_parallel(s: Sketch) -> None:
    """Turn rows that there are by 2^-k: as further hard rows near the optimum, or as a level's."""
    there = [row for a, *_ in s.levels for row in a if row.any()] + [g for g, _ in s.rows if g.any()]
    if not there:
        return
    for _ in range(s.rng.integers(1, 3)):
        row = there[int(s.rng.integers(len(there)))]
        turned = row + s.power(-24, -3) * np.abs(row).max() * s.vector()
        if s.chance(0.5):
            near = _Near.of(s)
            turned = turned if near.is_above(turned) else -turned
            s.rows.append((turned, near.side(turned)))
            continue
        number = int(s.rng.integers(len(s.levels) + 1))
        if number == len(s.levels):
            s.level(turned, s.integers(1, most=4) * np.abs(row).max())
        else:
            a, b, w, soft = s.levels[number]
            target = float(turned @ s.anchor) + float(s.integers(1)[0]) * np.abs(row).max()
            s.levels[number] = (np.vstack([a, turned]), np.append(b, target), np.append(w, 1.0), soft)


def _with_bounds_near(s: Sketch) -> None:
    """Bound joints close to the optimum, on either side of it."""
    near = _Near.of(s)
    for joint in s.rng.choice(s.m, int(s.rng.integers(1, s.m + 1)), replace=False):
        unit = np.eye(s.m)[joint]
        if near.is_above(unit):
            s.upper[joint] = min(s.upper[joint], near.side(unit))
        else:
            s.lower[joint] = max(s.lower[joint], -near.side(-unit))


@dataclass(frozen=True)
class _Near:
    """Where further rows may be that leave a step which keeps all rows: `kept`, the optimum or near it."""

    sketch: Sketch
    best: exact.Vector
    kept: exact.Vector

    @staticmethod
    def of(s: Sketch) -> "_Near":
        """Choose whether the optimum is to keep the rows, or only a step at a small distance from it."""
        problem = exact.ExactProblem.of(s.problem())
        best, other = exact.optimum(problem), exact.optimum(replace(problem, levels=[]))
        assert best is not None
        assert other is not None
        share = Fraction(0 if s.chance(0.5) else s.power(-30, -1))
        return _Near(s, best.x, [x + share * (y - x) for x, y in zip(best.x, other.x, strict=True)])

    def is_above(self, normal: Array) -> bool:
        """Whether a row is to bound steps from above: that which bars the optimum, or any."""
        towards = _dot(normal, self.best) - _dot(normal, self.kept)
        return self.sketch.chance(0.5) if towards == 0 else towards > 0

    def side(self, normal: Array) -> float:
        """Return a side that `kept` keeps, on it but for rounding or nearly on it."""
        size = max((abs(Fraction(a) * x) for a, x in zip(normal, self.kept, strict=True)), default=Fraction(0)) or Fraction(
            1
        )
        gap = Fraction(0 if self.sketch.chance(0.3) else self.sketch.power(-40, -3)) * size
        exactly = _dot(normal, self.kept) + gap
        side = float(exactly)
        return side if side >= exactly else float(np.nextafter(side, np.inf))


def _dot(row: Array, x: exact.Vector) -> Fraction:
    return sum((Fraction(a) * value for a, value in zip(row, x, strict=True)), Fraction(0))


SHORTEST = 2.0**-44  # of the longest row; the library takes what is 64 units in the last place of it for rounding
BELOW = ("free", "hold")
FEATURES = (_with_metric, _with_damping, _with_reference, _scaled, _with_rows_nearly_parallel, _with_bounds_near)
MIXABLE = [name for name in KINDS if name not in ("infeasible", "mixed", "rounded_by_metric")]  # one more changes all draws


# The judge.


@dataclass(frozen=True)
class Verdict:
    """What a step, or its absence, is worth, and why."""

    word: str
    why: str = ""


def judge(case: Case, solver: str = "daqp") -> Verdict:
    """Return what the library makes of a case."""
    try:
        step = pik.solve(case.problem, solver)
    except pik.InfeasibleError as error:
        return Verdict(RIGHT if case.optimum is None else CALLED_INFEASIBLE, str(error))
    except pik.PrioritizedIkError as error:  # anything else is a bug, and passes
        told = case.optimum is None and isinstance(error, pik.InputError)
        return Verdict(RIGHT if told else MISSED if case.optimum is None else NO_STEP, f"{type(error).__name__}: {error}")
    certificate = step.certificate or pik.certify(case.aimed, step.dtheta)
    return judge_step(case, step.dtheta, certificate)


def judge_compiled(case: Case) -> Verdict:
    """Return what the compiled core alone makes of a case."""
    if not fast.answers(case.problem):
        return Verdict(DECLINED)
    aimed = handed_down(case.problem, _core_step)
    step = aimed if isinstance(aimed, pik.JointStep) else _core_step(aimed)
    return Verdict(DECLINED) if step.dtheta is None else judge_step(case, step.dtheta, step.certificate)


def _core_step(problem: pik.IKProblem) -> pik.JointStep:
    """Return the compiled core's step, or one without any where it declines."""
    return fast.compiled_step(problem, 0.0) or pik.JointStep(None, pik.StepStatus.NOT_FOUND)


def judge_python(case: Case, solver: str = "daqp") -> Verdict:
    """Return what the Python form makes of a case."""
    with paths.only("python"):
        return judge(case, solver)


def judge_step(case: Case, dtheta: Array, certificate: Any) -> Verdict:
    """Return what a step is worth beside what its certificate says of it."""
    best = case.optimum
    if best is None:
        return Verdict(MISSED, f"a step was returned, certificate {certificate.holds}")
    if not certificate.holds:
        return Verdict(UNCERTIFIED, f"violation {certificate.violation:.0e}, worst {certificate.worst:.0e}")
    clean, x = case.clean, [Fraction(float(value)) for value in dtheta]
    measure = case.measure
    off = measure.length([a - b for a, b in zip(x, best.x, strict=True)])
    size, asked = measure.length(best.x), _longest(clean, measure)
    if size < ROUNDED / BROKEN * asked:  # at rest
        asked = case.asked
    floor = ROUNDED * asked
    broken = _broken(clean, x, measure)
    if broken > (BROKEN + CARRIED * case.noise) * size + floor:
        return Verdict(WRONG, f"breaks a row by {broken:.1e}, step {size:.1e}")
    gaps = getattr(certificate, "gaps", (0.0,) * len(best.costs))
    displaced = LOST * np.minimum(size * measure.of_joints, _reach(case.problem)) + floor * measure.of_joints
    leans = broken > (LEANS + CARRIED * case.noise) * size
    for number, (level, cost, gap) in enumerate(zip(clean.every_level, best.costs, gaps, strict=True)):
        allowed = gap + (COST + CARRIED * case.noise) * float(_terms(level, best.x))
        felt = _felt(level, displaced)
        allowed += 2.0 * float(np.sqrt(felt * float(cost))) + felt
        excess = float(level.cost(x) - cost)
        if excess > allowed:
            return Verdict(
                WRONG, f"level {number + 1} costs {excess:.1e} more than {float(cost):.1e}; allowed {allowed:.1e}"
            )
        if excess < -allowed and leans:
            return Verdict(LOOSE, f"level {number + 1} costs {-excess:.1e} less; a row is broken by {broken:.1e}")
    # The noise can move the optimum by more than itself: by no more than a thousand times in the kinds that have noise.
    variation = max(getattr(certificate, "rounding", (0.0,)))
    counted = max(size, ROUNDED / BROKEN * asked)  # steps of robots at rest count as this long
    if off > (STEP + 1000 * CARRIED * case.noise) * size + 2 * variation * counted + floor:
        return Verdict(LOOSE if leans else WRONG, f"dθ is off by {off:.1e} of {size:.1e}; variation said {variation:.0e}")
    return Verdict(RIGHT)


def _terms(level: exact.ExactLevel, x: exact.Vector) -> Fraction:
    """Return the weighted squares of the terms whose difference the residual is: its demand, and A x part by part."""
    parts = [
        b * b + sum(abs(a * value) for a, value in zip(row, x, strict=True)) ** 2
        for row, b in zip(level.matrix, level.target, strict=True)
    ]
    return sum((w * part for w, part in zip(level.weights, parts, strict=True)), Fraction(0))


def _felt(level: exact.ExactLevel, displaced: Array) -> float:
    """Return what moving each joint by so much costs at most where the cost is zero."""
    moved = np.abs(np.array(level.matrix, float)) @ displaced
    return float(np.array(level.weights, float) @ moved**2)


def _reach(problem: pik.IKProblem) -> Array:
    """Return how far from zero the bounds let each joint."""
    return np.maximum(np.abs(problem.bounds.lower), np.abs(problem.bounds.upper))


def _longest(clean: exact.ExactProblem, measure: Measure) -> float:
    """Return the longest step that a row of a level, of the last one included, asks for alone."""
    lengths = [
        abs(float(b)) / size
        for level in clean.every_level
        for row, b in zip(level.matrix, level.asked or level.target, strict=True)
        if (size := measure.row_length(row))
    ]
    return max(lengths)


def _broken(clean: exact.ExactProblem, x: exact.Vector, measure: Measure) -> float:
    """Return by how much the step breaks a hard row or equality at worst, as a distance."""
    worst = 0.0
    sides = [(row, h, False) for row, h in zip(clean.rows, clean.upper, strict=True)]
    sides += [(row, f, True) for row, f in zip(clean.equalities, clean.sides, strict=True)]
    for row, side, both in sides:
        above = float(sum((a * value for a, value in zip(row, x, strict=True)), Fraction(0)) - side)
        size = measure.row_length(row)
        if size:
            worst = max(worst, (abs(above) if both else above) / size)
    return worst


def judge_feigned(case: Case) -> Verdict:
    """Return whether a certificate holds for feasible steps that are wrong: optima of fewer levels, and halfway there."""
    if case.optimum is None:
        return Verdict(RIGHT)
    truth = np.array(case.optimum.x)
    for left_out in range(len(case.clean.levels)):
        levels = [level for i, level in enumerate(case.clean.levels) if i != left_out]
        other = exact.optimum(replace(case.clean, levels=levels))
        assert other is not None
        for part in (Fraction(1), Fraction(1, 2), Fraction(1, 1024)):
            step = (truth + part * (np.array(other.x) - truth)).astype(float)
            verdict = judge_step(case, step, pik.certify(case.aimed, step))
            if verdict.word == WRONG:
                return Verdict(WRONG, f"without level {left_out + 1}: {verdict.why}")
    return Verdict(RIGHT)


@dataclass
class Tally:
    """Verdicts of one kind, with the first seeds of each that is not right, and the first reason."""

    counts: Counter[str] = field(default_factory=Counter)
    seeds: dict[str, list[int]] = field(default_factory=lambda: defaultdict(list))
    reasons: dict[str, str] = field(default_factory=dict)
    supported: bool = True

    @property
    def fatal(self) -> int:
        """How many must never be."""
        return sum(self.counts[word] for word in FATAL)


def campaign(kinds: Iterable[str], seeds: Iterable[int], ask: Callable[[Case], Verdict] = judge) -> dict[str, Tally]:
    """Return the verdicts by kind, as `ask` gives them."""
    tallies: dict[str, Tally] = {}
    seeds = list(seeds)
    for name in kinds:
        tally = tallies[name] = Tally()
        for seed in seeds:
            try:
                case = draw(name, seed)
            except Unsupported:
                tally.supported = False
                break
            verdict = ask(case)
            tally.counts[verdict.word] += 1
            if verdict.word != RIGHT:
                tally.seeds[verdict.word].append(seed)
                tally.reasons.setdefault(verdict.word, verdict.why)
    return tallies


def table(tallies: dict[str, Tally], reasons: bool = False) -> str:
    """Return one line a kind: counts, and the first seeds of each verdict that is not right."""
    lines = [f"{'kind':27}" + "".join(f"{word.split()[-1]:>12}" for word in VERDICTS) + "  first seeds"]
    for name, tally in tallies.items():
        if not tally.supported:
            lines.append(f"{name:27}  (the library lacks the option)")
            continue
        seeds = "; ".join(f"{word}: {', '.join(map(str, found[:3]))}" for word, found in tally.seeds.items())
        lines.append(f"{name:27}" + "".join(f"{tally.counts[word] or '.':>12}" for word in VERDICTS) + f"  {seeds}")
        if reasons:
            lines += [f"    {word}: {why[:160]}" for word, why in tally.reasons.items()]
    return "\n".join(lines)


def main() -> int:
    """Run a campaign; 1 if any step was certified wrongly, or any feasible problem called infeasible."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--count", type=int, default=100, help="problems a kind")
    parser.add_argument("--kinds", default=",".join(KINDS), help="separated by commas; all unless given")
    parser.add_argument("--solver", default="daqp")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--reasons", action="store_true", help="print the first reason of each verdict")
    parser.add_argument("--path", choices=("compiled", "python"), help="ask one form of the solve only")
    parser.add_argument("--feign", action="store_true", help="ask the certificate about wrong steps instead")
    given = parser.parse_args()
    unknown = set(given.kinds.split(",")) - set(KINDS)
    if unknown:
        parser.error(f"unknown kinds {sorted(unknown)}; there are {', '.join(KINDS)}")
    seeds = range(given.first_seed, given.first_seed + given.count)
    asked = {None: partial(judge, solver=given.solver), "python": partial(judge_python, solver=given.solver)}
    ask = judge_feigned if given.feign else asked.get(given.path, judge_compiled)
    tallies = campaign(given.kinds.split(","), seeds, ask)
    print(table(tallies, given.reasons))
    total = sum((tally.counts for tally in tallies.values()), Counter())
    print(f"total {total.total()}: " + ", ".join(f"{total[word]} {word}" for word in VERDICTS))
    return int(any(tally.fatal for tally in tallies.values()))


if __name__ == "__main__":
    sys.exit(main())
