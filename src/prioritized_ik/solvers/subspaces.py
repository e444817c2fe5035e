"""Orthogonal geometry: ranges and null spaces, least squares within them, and cones of tight rows."""

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from prioritized_ik.tolerances import DEPENDENT
from prioritized_ik.validation import Array, lengths


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
    packed, order, scales, _, _ = scipy.linalg.lapack.dgeqp3(matrix)
    return scipy.linalg.lapack.dorgqr(packed, scales)[0], np.triu(packed[:p]), order - 1


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
    if distance and positive.any():
        columns, refined = matrix[:, positive], x[positive]
        for _ in range(2):
            refined = refined + np.linalg.lstsq(columns, target - columns @ refined)[0]
        nearer = float(np.linalg.norm(columns @ refined - target))
        if nearer < distance and refined.min() >= 0.0:
            x[positive], distance = refined, nearer
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
