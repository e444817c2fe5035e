"""Orthogonal geometry: ranges and null spaces, least squares within them, and cones of tight rows."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from prioritized_ik.tolerances import CLEARLY, DEPENDENT, EPS, ESTIMATES, PROJECTION, UNFELT
from prioritized_ik.validation import Array, length, lengths, read_only, size


@dataclass(frozen=True)
class Range:
    """The range and null space of linear rows within some directions, in coordinates y whose least squares is ‖y - qᵀe‖².

    Attributes:
        felt: `(m, r)`: dθ = `felt` @ y.
        unfelt: orthonormal directions `(m, f - r)` that the rows do not feel.
        q: orthonormal `(p, r)`: from the rows' own coordinates to y; None for the identity.
    """

    felt: Array
    unfelt: Array
    q: Array | None

    @cached_property
    def whitened(self) -> tuple[Array, Array]:
        """Directions `(m, v)` in which a level's cost is ‖·‖², and their lengths; those not felt are there at `UNFELT`."""
        return self._with_unfelt(self._unfelt_length)

    @property
    def weakly_whitened(self) -> tuple[Array, Array]:
        """The same; those not felt are as little felt as the weakest one that is."""
        return self._with_unfelt(max(self._felt_lengths.max(initial=0.0), self._unfelt_length))

    @cached_property
    def _felt_lengths(self) -> Array:
        return lengths(self.felt.T)

    @property
    def _unfelt_length(self) -> float:
        return (float(self._felt_lengths.min()) if len(self._felt_lengths) else 1.0) / UNFELT

    def _with_unfelt(self, size: float) -> tuple[Array, Array]:
        if not self.unfelt.shape[1]:
            return self.felt, self._felt_lengths
        basis = np.concatenate([self.felt, self.unfelt * size], axis=1)
        sizes = np.empty(basis.shape[1])
        sizes[: len(self._felt_lengths)], sizes[len(self._felt_lengths) :] = self._felt_lengths, size
        return basis, sizes

    def project(self, rows: Array) -> Array:
        """Return `rows` `(p,)`, something counted in the rows' own coordinates, in y `(r,)`."""
        return rows if self.q is None else self.q.T @ rows

    def project_sizes(self, rows: Array) -> Array:
        """Return how large `project` of something as large as `rows` `(p,)` can be `(r,)`."""
        return rows if self.q is None else np.abs(self.q.T) @ rows


def range_of(directions: Array, root: Array, free: Array, dependent: float = DEPENDENT) -> Range:
    """Return the range of the rows `root` @ `directions`ᵀ within `free`.

    Args:
        directions: of unit length `(m, p)`, in any position to each other.
        root: `(p, p)`, regular.
        free: orthonormal `(m, f)`.
        dependent: directions that differ by less than this angle within `free` count as one.
    """
    seen = directions.T @ free
    if not seen.size:
        return Range(free[:, :0], free, np.zeros((len(seen), 0)))
    basis, triangle, _ = scipy.linalg.qr(seen.T, pivoting=True, check_finite=False)
    r = int(np.count_nonzero(np.abs(np.diag(triangle)) > dependent))
    felt, unfelt = free @ basis[:, :r], free @ basis[:, r:]
    q, triangle = np.linalg.qr(root @ (seen @ basis[:, :r]))
    return Range(divided(felt, triangle), unfelt, q)


def null_space(rows: Array, free: Array, dependent: float = DEPENDENT) -> Array:
    """Return the orthonormal directions `(m, f - r)` within `free` `(m, f)` that `rows` `(n, m)` do not feel."""
    if not len(rows) or not free.shape[1]:
        return free
    basis, triangle, _ = scipy.linalg.qr((rows @ free).T, pivoting=True, check_finite=False)
    return free @ basis[:, int(np.count_nonzero(np.abs(np.diag(triangle)) > dependent)) :]


def divided(columns: Array, triangle: Array) -> Array:
    """Return `columns` times the inverse of an upper `triangle`."""
    if not columns.shape[1]:
        return columns
    return scipy.linalg.lapack.dtrtrs(triangle, columns.T, trans=1)[0].T


def pivoted_qr(matrix: Array) -> tuple[Array, Array, NDArray[np.int_]]:
    """Return Q `(k, p)`, R `(p, p)` and the order of the columns of `matrix` `(k, p)`, k >= p; LAPACK without wrapping."""
    p = matrix.shape[1]
    if p == 0:
        return matrix, np.zeros((0, 0)), np.zeros(0, dtype=int)
    work = _work(p)
    packed, order, scales, _, _ = scipy.linalg.lapack.dgeqp3(matrix, lwork=work)
    return scipy.linalg.lapack.dorgqr(packed, scales, lwork=work)[0], upper_triangle(packed[:p]), order - 1


def clear_range(rows: Array, least: float) -> tuple[Array, int, float] | None:
    """Return an orthonormal basis `(m, m)`, the first p for all that `rows` `(k, m)` feel, p, and the least singular value.

    That is an estimate, and infinite where p is zero. None where a pivoted QR does not tell the rank p: what it leaves is
    more than rounding, or a singular value may be `least` or less.
    """
    (k, m), p = rows.shape, 0
    if k and m:
        packed, _, scales, _, _ = scipy.linalg.lapack.dgeqp3(rows.T, lwork=_work(k))
        sizes = np.abs(packed.diagonal())
        p = int(np.count_nonzero(sizes > PROJECTION * EPS * sizes[0]))
    if not p:
        return np.eye(m), 0, np.inf
    inverse, _ = scipy.linalg.lapack.dtrtri(packed[:p, :p])
    inverse = upper_triangle(inverse)
    if not np.vdot(inverse, inverse) < least**-2.0:  # no singular value of the inverse is larger than that
        return None
    reflectors = np.zeros((m, m), order="F")
    reflectors[:, :p] = packed[:, :p]
    basis, _, _ = scipy.linalg.lapack.dorgqr(reflectors, scales[:p], lwork=_work(m), overwrite_a=1)
    return basis, p, 1.0 / about_largest(inverse)


def singular_values(matrix: Array, *, full: bool = False) -> tuple[Array, Array, Array]:
    """Return U, the singular values and Vᵀ of a matrix that has entries; as `numpy.linalg.svd`, faster on small ones."""
    u, s, vt, failed = scipy.linalg.lapack.dgesdd(matrix, full_matrices=int(full))
    return np.linalg.svd(matrix, full_matrices=full) if failed else (u, s, vt)


def are_independent(rows: Array, least: float) -> bool:
    """Whether every combination of `rows` `(k, m)` of length 1 is clearly longer than `least`; in doubt they are not."""
    if not len(rows) or len(rows) > rows.shape[1]:
        return not len(rows)
    packed, _, _, _, _ = scipy.linalg.lapack.dgeqp3(rows.T)
    inverse, singular = scipy.linalg.lapack.dtrtri(packed[: len(rows)])
    inverse = upper_triangle(inverse)
    return not singular and bool(np.vdot(inverse, inverse) * (CLEARLY * least) ** 2 < 1.0)


def least_squares(columns: Array, target: Array, *, some: bool = False) -> Array | None:
    """Return the x `(k,)` of the least ‖`columns` @ x - `target`‖; None where columns `(m, k)` may depend on each other.

    Unless `some` of them, that do not, may stand for all.
    """
    m, k = columns.shape
    if not k or not m:
        return None
    packed, order, scales, _, _ = scipy.linalg.lapack.dgeqp3(columns)
    sizes = np.abs(packed.diagonal())
    rank = int(np.count_nonzero(sizes > DEPENDENT * sizes[0]))
    if not rank or (rank < k and not some):
        return None
    x, triangle, order = np.zeros(k), packed[:rank, :rank], order[:rank] - 1
    reflectors, scales = packed[:, :rank], scales[:rank]
    for _ in range(2):  # once more: the first time leaves rounding
        turned, _, _ = scipy.linalg.lapack.dormqr("L", "T", reflectors, scales, (target - columns @ x)[:, None], m)
        x[order] += scipy.linalg.lapack.dtrtrs(triangle, turned[:rank, 0])[0]
    return x


def pseudoinverse(rows: Array) -> Array:
    """Return the pseudoinverse `(m, k)` of `rows` `(k, m)`; combinations below `DEPENDENT` of the largest count as none."""
    k, m = rows.shape
    if 0 < k <= m:
        packed, order, scales, _, _ = scipy.linalg.lapack.dgeqp3(rows.T)
        inverse, singular = scipy.linalg.lapack.dtrtri(packed[:k])
        inverse = upper_triangle(inverse)
        # The least singular value is no less than one over the size of the inverse, the largest no more than that of rows.
        if not singular and size(inverse) * size(rows) * CLEARLY * DEPENDENT < 1.0:
            basis, _, _ = scipy.linalg.lapack.dorgqr(packed, scales)
            found = np.empty((m, k))
            found[:, order - 1] = basis @ inverse.T
            return found
    if not rows.size:
        return np.zeros((m, k))
    u, s, vt = singular_values(rows)
    rank = int(np.count_nonzero(s > DEPENDENT * s[0]))
    return (vt[:rank].T / s[:rank]) @ u[:, :rank].T


def about_largest(matrix: Array) -> float:
    """Return about the largest singular value of a matrix `(k, m)`, by iteration from its longest row; 1 if it is zero."""
    sizes = lengths(matrix)
    if not np.count_nonzero(sizes):
        return 1.0
    longest = int(sizes.argmax())
    direction = matrix[longest] / sizes[longest]
    for _ in range(ESTIMATES - 1):
        image = matrix @ direction
        direction = (image / length(image)) @ matrix
        direction /= length(direction)
    return length(matrix @ direction)


def upper_triangle(matrix: Array) -> Array:
    """Return a square matrix `(k, k)` with zeros below its diagonal; several times faster than `numpy.triu`."""
    return matrix * _ones_above(len(matrix))


@lru_cache(maxsize=64)
def _ones_above(k: int) -> Array:
    return read_only(np.triu(np.ones((k, k))))


def _work(columns: int) -> int:
    """Return how many numbers of room let LAPACK factor so many columns in blocks of 32."""
    return 2 * columns + 32 * (columns + 1)


def nonnegative_least_squares(matrix: Array, target: Array) -> tuple[Array, float]:
    """Return x >= 0 `(n,)` nearest to `matrix` @ x = `target`, and how near; zero and infinity if none is found.

    NNLS solves normal equations, which loses half of the digits where columns are nearly parallel: what it finds positive
    is solved for again by orthogonal least squares, twice.
    """
    from scipy.optimize import nnls  # takes longer to import than all else; most steps do without

    try:
        x, distance = nnls(matrix, target)
    except RuntimeError:  # out of iterations
        return np.zeros(matrix.shape[1]), np.inf
    positive = x > 0.0
    while distance and positive.any():
        columns, refined = matrix[:, positive], x[positive]
        for _ in range(2):
            missing = target - columns @ refined
            change = least_squares(columns, missing)
            refined = refined + (np.linalg.lstsq(columns, missing)[0] if change is None else change)
        if refined.min() >= 0.0:
            nearer = length(columns @ refined - target)
            if nearer < distance:
                x, distance = np.zeros(len(x)), nearer
                x[positive] = refined
            break
        positive[positive] = refined > 0.0  # what normal equations took for more is rounding
    return x, distance


def directions_left(free: Array, tight: Array, narrow: float, settled: float) -> Array:
    """Return the directions `(m, f)` among the `free` ones in which no tight row is bound to stay tight.

    Tight rows B can leave no room on either side: where a positive combination λᵀB vanishes, the rows in it are zero
    throughout {w: B w <= 0} (Stiemke). They are equalities then, and handing them on as inequalities would leave a
    feasible set without interior, on which most QP solvers fail. This is a matter of geometry, so it does not depend on
    the size of multipliers.

    Args:
        free: orthonormal `(m, f)`.
        tight: rows of unit length `(t, m)`.
        narrow: a wedge between rows that is narrower than this leaves no room.
        settled: rows that move by less than this fraction of their length do not count.
    """
    while len(tight) and free.shape[1]:
        cone = tight @ free
        norms = lengths(cone)
        moving = norms > settled
        if not moving.any():
            return free
        tight, cone = tight[moving], cone[moving] / norms[moving, None]
        if (cone @ cone.T).min() >= 0.0:  # no two point against each other, so that no combination vanishes
            return free
        # The shortest convex combination of the rows: if it is not zero, it points to where all of them are strict.
        convex = np.vstack([cone.T, np.ones(len(cone))])
        combination, distance = nonnegative_least_squares(convex, np.eye(len(convex))[-1])
        if distance > narrow:
            return free
        _, s, vt = np.linalg.svd(cone[combination > narrow])
        free = free @ vt[np.count_nonzero(s > narrow * s[0]) :].T
    return free
