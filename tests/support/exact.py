"""An exact oracle of lexicographic least squares: rational arithmetic, nothing shared with the library.

Each level is a convex quadratic problem in the directions that the levels above leave, x = point + basis z. `_minimise`
walks down it from face to face: to the least cost of the face that the tight rows make, or to the first row on the way;
there either multipliers of the right sign exist, or Farkas' alternative is a way down, along which the cost falls
strictly. So no face is left twice, and there is nothing to tolerate. A level of soft inequalities gets one more variable
a row, its excess. Vectors are kept as integers over a common denominator; rows and objectives are scaled at will.
"""

import math
import operator
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import chain, combinations
from typing import Any

Vector = list[Fraction]
Integers = list[int]


@dataclass(frozen=True)
class ExactLevel:
    """Rows A, targets b and weights of one level; `soft` counts only what A x exceeds b by.

    A damped level that hands its optimum down has what that reaches for a target; what it asks for itself is `asked`.
    """

    matrix: list[Vector]
    target: Vector
    weights: Vector
    soft: bool = False
    asked: Vector | None = None

    def residual(self, x: Sequence[Fraction]) -> Vector:
        """Return A x - b; of a soft level only what is above zero."""
        found = [_dot(row, x) - b for row, b in zip(self.matrix, self.target, strict=True)]
        return [max(value, Fraction(0)) for value in found] if self.soft else found

    def cost(self, x: Sequence[Fraction]) -> Fraction:
        """Return the weighted sum of squares of the residual."""
        return sum((w * r * r for w, r in zip(self.weights, self.residual(x), strict=True)), Fraction(0))


@dataclass(frozen=True)
class ExactProblem:
    """A hierarchy: `rows` x <= `upper` (bounds among them), `equalities` x = `sides`, levels, and a last level.

    Damping is rows of its level; where a damped level hands its optimum down, it asks for what that reaches.
    """

    levels: list[ExactLevel]
    rows: list[Vector]
    upper: Vector
    equalities: list[Vector]
    sides: Vector
    reference: Vector
    metric: list[Vector]

    @staticmethod
    def of(problem: Any) -> "ExactProblem":
        """Return what the floats of an `IKProblem` say to the last bit."""
        m = len(problem.reference)
        unit = [[Fraction(int(i == j)) for j in range(m)] for i in range(m)]
        low, high = problem.bounds.lower.tolist(), problem.bounds.upper.tolist()
        rows = [unit[i] for i in range(m) if math.isfinite(high[i])]
        rows += [[-value for value in unit[i]] for i in range(m) if math.isfinite(low[i])]
        upper = [value for value in high if math.isfinite(value)] + [-value for value in low if math.isfinite(value)]
        metric = problem.metric
        if metric.ndim == 1:
            table = [[Fraction(float(metric[i])) * value for value in unit[i]] for i in range(m)]
        else:
            table = _table(metric)
        whole = ExactProblem(
            [],
            rows + _table(problem.rows.matrix),
            _vector(upper) + _vector(problem.rows.upper),
            _table(problem.equalities.matrix),
            _vector(problem.equalities.target),
            _vector(problem.reference),
            table,
        )
        for one in problem.levels:
            whole = replace(whole, levels=[*whole.levels, whole._level(one)])
        return whole

    def _level(self, given: Any) -> ExactLevel:
        """Return what a `Level` says below these levels."""
        level = ExactLevel(_table(given.matrix), _vector(given.target), _vector(given.weights), given.kind == "at_most")
        if not given.damping:
            return level
        damping = Fraction(given.damping)
        damped = ExactLevel(
            level.matrix + self.last.matrix,
            level.target + [Fraction(0)] * self.joint_count,
            level.weights + [damping * weight for weight in self.last.weights],
        )
        if given.below == "hold":
            return damped
        reached = optimum(replace(self, levels=[*self.levels, damped]))
        if reached is None:
            return level
        return replace(level, target=[_dot(row, reached.x) for row in level.matrix], asked=level.target)

    @property
    def joint_count(self) -> int:
        """Number of joints m."""
        return len(self.reference)

    @property
    def last(self) -> ExactLevel:
        """The implicit last level, (x - r)ᵀ M (x - r), with M = Rᵀ D R and R triangular, its diagonal of ones."""
        rows: list[Vector] = []
        weights: Vector = []
        left = self.metric  # without what the rows so far measure
        for i in range(self.joint_count):
            pivot_row, pivot = left[i], left[i][i]
            rows.append([value / pivot for value in pivot_row])
            weights.append(pivot)
            left = [
                [a - share * b for a, b in zip(row, pivot_row, strict=True)]
                for row, share in zip(left, rows[i], strict=True)
            ]
        return ExactLevel(rows, [_dot(row, self.reference) for row in rows], weights)

    @property
    def every_level(self) -> list[ExactLevel]:
        """All levels, the last one included."""
        return [*self.levels, self.last]


@dataclass(frozen=True)
class Optimum:
    """The one optimum x, and the cost of every level there, the last one's included."""

    x: Vector
    costs: Vector


def optimum(problem: ExactProblem) -> Optimum | None:
    """Return the exact optimum, or None where no x keeps every row and equality."""
    face = _Face.of(problem)
    if face is None:
        return None
    for level in problem.every_level:
        face.lower(level)
    x = [Fraction(value, face.point[-1]) for value in face.point[:-1]]
    return Optimum(x, [level.cost(x) for level in problem.every_level])


def is_feasible(problem: ExactProblem, x: Sequence[Fraction]) -> bool:
    """Return whether x keeps every row and equality."""
    return all(_dot(row, x) <= h for row, h in zip(problem.rows, problem.upper, strict=True)) and all(
        _dot(row, x) == f for row, f in zip(problem.equalities, problem.sides, strict=True)
    )


def is_optimal(problem: ExactProblem, x: Sequence[Fraction]) -> bool:
    """Return whether x has multipliers at every level: -gradient = Σ λ c + Σ μ e with λ >= 0 over the tight rows c.

    e are the equalities, the rows of the levels above and the soft rows above that are exceeded; soft rows above that are
    just kept count among c.
    """
    if not is_feasible(problem, x):
        return False
    tight = [row for row, h in zip(problem.rows, problem.upper, strict=True) if _dot(row, x) == h]
    fixed = list(problem.equalities)
    for level in problem.every_level:
        pulls = [w * r for w, r in zip(level.weights, level.residual(x), strict=True)]
        gradient = [_dot(pulls, column) for column in zip(*level.matrix, strict=True)]
        generators = [*tight, *fixed, *([-value for value in row] for row in fixed)]
        joined = [_integers([*(row[i] for row in generators), -gradient[i]]) for i in range(len(gradient))]
        if _combination([row[:-1] for row in joined], [row[-1] for row in joined]) is not None:
            return False
        if not level.soft:
            fixed += level.matrix
            continue
        for row, b in zip(level.matrix, level.target, strict=True):
            height = _dot(row, x) - b
            if height >= 0:
                (fixed if height > 0 else tight).append(row)
    return True


def brute_force(problem: ExactProblem) -> Vector | None:
    """Return the optimum by trying every set of rows as equalities, at every level; none may be soft."""
    m, fixed = problem.joint_count, list(zip(problem.equalities, problem.sides, strict=True))
    rows = list(zip(problem.rows, problem.upper, strict=True))
    best: Vector | None = None
    for level in problem.every_level:
        found: list[tuple[Fraction, Vector]] = []
        form = _form([[*row, -b] for row, b in zip(level.matrix, level.target, strict=True)], level.weights)
        for chosen in chain.from_iterable(combinations(rows, count) for count in range(len(rows) + 1)):
            sides = [*fixed, *chosen]
            kkt = [[*form[i][:m], *(row[i] for row, _ in sides), -form[i][m]] for i in range(m)]
            kkt += [[*row, *([Fraction(0)] * len(sides)), side] for row, side in sides]
            solution = _solution([_integers(row) for row in kkt], m + len(sides))
            if solution is not None:
                x = [Fraction(value, solution[-1]) for value in solution[:m]]
                if is_feasible(problem, x):
                    found.append((level.cost(x), x))
        if not found:
            return None
        best = min(found)[1]
        fixed += [(row, _dot(row, best)) for row in level.matrix]
    return best


@dataclass
class _Face:
    """What the levels so far leave: point + basis z with rows x <= side. The point ends with its denominator, above 0."""

    point: Integers
    basis: list[Integers]  # directions
    rows: list[Integers]  # each ends with minus its side, so that row · point <= 0

    @staticmethod
    def of(problem: ExactProblem) -> "_Face | None":
        """Return all x that keep rows and equalities, with one of them for the point; None if there is none."""
        m = problem.joint_count
        fixed = [_integers([*row, side]) for row, side in zip(problem.equalities, problem.sides, strict=True)]
        start = _solution(fixed, m)
        if start is None:
            return None
        basis = [[*direction, 0] for direction in _null_space([row[:m] for row in fixed], m)]
        rows = [_integers([*row, -side]) for row, side in zip(problem.rows, problem.upper, strict=True)]
        values = [_dot(row, start) for row in rows]
        if max(values, default=0) > 0:
            table = []
            for i, row in enumerate(rows):
                across = [_dot(row, direction) for direction in basis]
                slack = [int(i == j) for j in range(len(rows))]
                table.append([*across, *(-value for value in across), *slack])
            solution: list[Fraction] = []
            if _combination(table, [-value for value in values], solution) is not None:
                return None
            z = [solution[j] - solution[j + len(basis)] for j in range(len(basis))]
            denominator = Fraction(1, start[-1])
            moved = [
                Fraction(start[i], start[-1]) + denominator * sum(zj * d[i] for zj, d in zip(z, basis, strict=True))
                for i in range(m)
            ]
            start = _integers([*moved, Fraction(1)])
        return _Face(start, basis, rows)

    def lower(self, level: ExactLevel) -> None:
        """Move the point to an optimum of the level, and leave only such optima."""
        m = len(self.point) - 1
        matrix = [[*row, -b] for row, b in zip(level.matrix, level.target, strict=True)]
        if level.soft:
            self._lower_soft(level, matrix)
            return
        self.point = _minimise(self.point, self.basis, self.rows, _form(matrix, level.weights))
        self._keep([self._felt(row[:m]) for row in matrix])

    def _lower_soft(self, level: ExactLevel, matrix: list[Vector]) -> None:
        """The same with the excesses as variables: minimise Σ w v² with A x - v <= b."""
        m, k, zero = len(self.point) - 1, len(matrix), Fraction(0)
        units = [[Fraction(int(i == j)) for j in range(k)] for i in range(k)]
        excess = [max(value, zero) for value in level.residual([Fraction(v, self.point[-1]) for v in self.point[:-1]])]
        wide = _integers([*(Fraction(v, self.point[-1]) for v in self.point[:-1]), *excess, Fraction(1)])
        basis = [[*direction[:m], *([0] * k), 0] for direction in self.basis]
        basis += [[*([0] * m), *(int(i == j) for j in range(k)), 0] for i in range(k)]
        rows = [[*row[:m], *([0] * k), row[-1]] for row in self.rows]
        rows += [
            _integers([*row[:m], *(-value for value in unit), row[-1]]) for row, unit in zip(matrix, units, strict=True)
        ]
        form = _form([[*([zero] * m), *unit, zero] for unit in units], level.weights)
        wide = _minimise(wide, basis, rows, form)
        self.point = _reduced([*wide[:m], wide[-1]])
        felt = []
        for i, row in enumerate(matrix):
            if wide[m + i] > 0:
                felt.append(self._felt(row[:m]))
            else:
                self.rows.append(_integers(row))
        self._keep(felt)

    def _felt(self, row: Vector) -> Integers:
        """Return a positive multiple of how much the row feels each direction."""
        return [_dot(_integers(row), direction[:-1]) for direction in self.basis]

    def _keep(self, felt: list[Integers]) -> None:
        """Leave only directions z that the rows `felt` do not feel, and only rows that feel a direction left."""
        count, size = len(self.basis), len(self.point)
        left = _null_space(felt, count)
        self.basis = [_reduced([sum(z[j] * self.basis[j][i] for j in range(count)) for i in range(size)]) for z in left]
        self.rows = [row for row in self.rows if any(_dot(row, direction) for direction in self.basis)]


def _minimise(point: Integers, basis: list[Integers], rows: list[Integers], form: list[Integers]) -> Integers:
    """Return a point of least cost (p, 1)ᵀ form (p, 1) among those the rows leave."""
    across = [[_dot(row, direction) for direction in basis] for row in rows]
    half = [[_dot(line, direction) for line in form] for direction in basis]  # form @ direction
    hessian = [[_dot(one, other) for other in basis] for one in half]
    while True:
        gradient = [_dot(one, point) for one in half]  # times the point's denominator
        values = [_dot(row, point) for row in rows]
        tight = [cut for cut, value in zip(across, values, strict=True) if value == 0]
        free = _null_space(tight, len(basis))
        slopes = [_dot(direction, gradient) for direction in free]
        if any(slopes):
            curved = [[_dot(one, line) for line in hessian] for one in free]
            table = [[*(_dot(one, other) for other in free), -s] for one, s in zip(curved, slopes, strict=True)]
            step = _solution(table, len(free))
            assert step is not None  # a sum of squares is bounded below
            z = [sum(u * direction[i] for u, direction in zip(step[:-1], free, strict=True)) for i in range(len(basis))]
            longest = Fraction(1, step[-1])
        else:
            table = [[cut[i] for cut in tight] for i in range(len(basis))]
            downhill = _combination(table, [-value for value in gradient])
            if downhill is None:
                return point
            z = downhill
            curvature = sum(z[i] * _dot(hessian[i], z) for i in range(len(z)))
            longest = Fraction(-_dot(z, gradient), curvature) if curvature else None
        # In units of z over the point's denominator.
        for cut, value in zip(across, values, strict=True):
            rate = _dot(cut, z)
            if rate > 0 and value < 0 and (longest is None or -value < longest * rate):
                longest = Fraction(-value, rate)
        assert longest is not None
        n, d = longest.numerator, longest.denominator
        move = [sum(zj * direction[i] for zj, direction in zip(z, basis, strict=True)) for i in range(len(point))]
        point = _reduced([d * p + n * step for p, step in zip(point, move, strict=True)])


def _combination(table: list[Integers], side: Integers, solution: list[Fraction] | None = None) -> Integers | None:
    """Look for λ >= 0 with table λ = side; return None if there is, else y with yᵀ table <= 0 and yᵀ side > 0.

    The simplex method's first phase with Bland's rule, rows scaled to integers. A `solution` given is filled with λ.
    """
    height, width = len(table), len(table[0]) if table else 0
    signs = [-1 if value < 0 else 1 for value in side]
    # Columns: λ, one artificial variable a row, the objective's own scale, the right side.
    rows = [
        [*(sign * value for value in row), *(int(i == j) for j in range(height)), 0, abs(value_of_side)]
        for i, (row, sign, value_of_side) in enumerate(zip(table, signs, side, strict=True))
    ]
    goal = [-sum(row[j] for row in rows) for j in range(width)] + [0] * height + [1, -sum(row[-1] for row in rows)]
    base = list(range(width, width + height))
    while goal[-1]:
        enter = next((j for j in range(width) if goal[j] < 0), None)
        if enter is None:
            scale = goal[width + height]
            return _reduced([sign * (scale - goal[width + i]) for i, sign in enumerate(signs)])
        leave = -1
        for i, row in enumerate(rows):
            if row[enter] > 0:
                if leave >= 0:
                    first, second = row[-1] * rows[leave][enter], rows[leave][-1] * row[enter]
                if leave < 0 or first < second or (first == second and base[i] < base[leave]):
                    leave = i
        pivot_row, pivot = rows[leave], rows[leave][enter]
        for i, row in enumerate(rows):
            if i != leave and row[enter]:
                rows[i] = _less(row, pivot, pivot_row, row[enter])
        goal = _less(goal, pivot, pivot_row, goal[enter])
        base[leave] = enter
    if solution is not None:
        solution[:] = [Fraction(0)] * width
        for row, j in zip(rows, base, strict=True):
            if j < width:
                solution[j] = Fraction(row[-1], row[j])
    return None


def _echelon(rows: Iterable[Integers], width: int) -> list[tuple[int, Integers]]:
    """Return the reduced rows with the column of each one's pivot, which is positive and alone in that column."""
    done: list[tuple[int, Integers]] = []
    for row in rows:
        for column, other in done:
            if row[column]:
                row = _less(row, other[column], other, row[column])
        pivot = next((j for j in range(width) if row[j]), None)
        if pivot is None:
            if any(row[width:]):
                return [(-1, row)]  # 0 = something
            continue
        if row[pivot] < 0:
            row = [-value for value in row]
        done = [(c, _less(other, row[pivot], row, other[pivot]) if other[pivot] else other) for c, other in done]
        done.append((pivot, row))
    return done


def _null_space(rows: list[Integers], width: int) -> list[Integers]:
    """Return integer directions that span what no row feels."""
    done = _echelon(rows, width)
    taken = {column for column, _ in done}
    directions = []
    for j in range(width):
        if j not in taken:
            scale = math.lcm(*(row[column] // math.gcd(row[column], row[j]) for column, row in done))
            direction = [0] * width
            direction[j] = scale
            for column, row in done:
                direction[column] = -(scale * row[j]) // row[column]
            directions.append(direction)
    return directions


def _solution(rows: list[Integers], width: int) -> Integers | None:
    """Return a solution of the rows, each ending with its side, as integers and their denominator; None if none is."""
    done = _echelon(rows, width)
    if done and done[0][0] < 0:
        return None
    scale = math.lcm(*(row[column] // math.gcd(row[column], row[-1]) for column, row in done))
    found = [0] * width + [scale]
    for column, row in done:
        found[column] = scale * row[-1] // row[column]
    return found


def _form(matrix: list[Vector], weights: Vector) -> list[Integers]:
    """Return a positive multiple of Σ w (row, -b)(row, -b)ᵀ in integers."""
    size = len(matrix[0])
    flat = [
        sum((w * row[i] * row[j] for w, row in zip(weights, matrix, strict=True)), Fraction(0))
        for i in range(size)
        for j in range(size)
    ]
    whole = _integers(flat)
    return [whole[i * size : (i + 1) * size] for i in range(size)]


def _less(row: Integers, factor: int, other: Integers, times: int) -> Integers:
    """Return `factor` row - `times` other, divided by what is common."""
    return _reduced([factor * a - times * b for a, b in zip(row, other, strict=True)])


def _reduced(row: Integers) -> Integers:
    common = math.gcd(*row)
    return [value // common for value in row] if common > 1 else row


def _integers(values: Iterable[Fraction]) -> Integers:
    """Return the smallest positive multiple of the values that is whole."""
    values = [Fraction(value) for value in values]
    scale = math.lcm(*(value.denominator for value in values))
    return _reduced([value.numerator * (scale // value.denominator) for value in values])


def _dot(one: Sequence[Any], other: Sequence[Any]) -> Any:
    return sum(map(operator.mul, one, other))


def _vector(values: Iterable[float]) -> Vector:
    return [Fraction(float(value)) for value in values]


def _table(matrix: Any) -> list[Vector]:
    return [_vector(row) for row in matrix]
