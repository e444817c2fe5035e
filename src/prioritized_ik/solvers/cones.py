"""Geometry of tight rows: in which directions they leave room, and how a descent is stopped by them."""

import numpy as np
import scipy.optimize

from prioritized_ik.solvers.hierarchy import SETTLED_ROW
from prioritized_ik.validation import Array, lengths


def nonnegative_least_squares(matrix: Array, target: Array) -> tuple[Array, float]:
    """Return x >= 0 `(n,)` nearest to `matrix` @ x = `target`, and how near; zero and infinity if none is found."""
    try:
        return scipy.optimize.nnls(matrix, target)
    except RuntimeError:  # out of iterations
        return np.zeros(matrix.shape[1]), np.inf


def directions_left(free: Array, tight: Array, narrow: float) -> Array:
    """Return the directions `(m, f)` among the `free` ones in which no tight row is bound to stay tight.

    Tight rows B can leave no room on either side: where a positive combination λᵀB vanishes, the rows in it are zero
    throughout {w: B w <= 0} (Stiemke). They are equalities then, and handing them on as inequalities would leave a
    feasible set without interior, on which most solvers fail. This is a matter of geometry, so it does not depend on
    the size of multipliers.

    Args:
        free: orthonormal `(m, f)`.
        tight: rows of unit length `(t, m)`.
        narrow: a wedge between rows that is narrower than this leaves no room.
    """
    while len(tight) and free.shape[1]:
        cone = tight @ free
        norms = lengths(cone)
        moving = norms > SETTLED_ROW
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
