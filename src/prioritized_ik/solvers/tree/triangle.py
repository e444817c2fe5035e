"""The weighted rows of a level in the coordinates that it decides: a QR factorisation against the flow of its frame.

With t the state that the e alone make, t_k = F_k t_(k-1) + M_k e_k, every row is a row on some t. From the last step to the
first, reflectors turn the rows that have been met into R_k e_k + S_k t_(k-1) = q_k and rows without e_k, which are rows on
t_(k-1). R is square and regular: its singular values are those of W^½ A that are not zero.
"""

from dataclasses import dataclass

import numpy as np

from prioritized_ik.solvers.tree.frames import Coordinates, FrameStep, Parted
from prioritized_ik.validation import Array


@dataclass
class _Step:
    own: list[int]  # numbers of its rows
    turn: Array  # Q, of the rows handed on to it and its own
    root: Array  # R
    behind: Array  # S
    squeezed: Array | None  # Q of what is left, where that is more rows than numbers in t
    left: int


class Triangle:
    """One level's R and Q.

    Args:
        frame: of the directions left to the level.
        steps: parted by it.
        rows: on twists, weighted, by stage `(k, 6)`.
        numbers: of these rows.

    Attributes:
        strongest, weakest: largest and smallest pivot; zero and infinite if there is none.
    """

    def __init__(
        self, frame: list[FrameStep], steps: list[Parted], rows: dict[int, Array], numbers: dict[int, list[int]]
    ) -> None:
        self._frame, self._parted, self._steps = frame, steps, list[_Step]()
        self.strongest, self.weakest = 0.0, np.inf
        c = np.zeros((0, 0))
        for at, parted in zip(reversed(frame), reversed(steps), strict=True):
            own = numbers.get(at.stage, [])
            if own:
                c = np.vstack([c, rows[at.stage] @ at.twist])
            e = parted.decided
            turn = np.linalg.qr(c @ parted.moved, mode="complete")[0] if e else np.eye(len(c))
            both = turn.T @ np.hstack([c @ parted.moved, c @ at.flow])
            root, behind, c = np.triu(both[:e, :e]), both[:e, e:], both[e:, e:]
            squeezed = None
            if len(c) > c.shape[1]:
                squeezed, c = np.linalg.qr(c, mode="complete")
                c = c[: c.shape[1]]
            self._steps.append(_Step(own, turn, root, behind, squeezed, len(c)))
            pivots = np.abs(np.diag(root))
            self.strongest = max(self.strongest, float(pivots.max(initial=0.0)))
            self.weakest = min(self.weakest, float(pivots.min(initial=np.inf)))
        self._steps.reverse()

    def from_sides(self, sides: Array) -> Coordinates:
        """Return Qᵀ of right-hand sides `(k,)`, weighted."""
        q, y = [], np.zeros(0)
        for parted, step in zip(reversed(self._parted), reversed(self._steps), strict=True):
            y = step.turn.T @ np.concatenate([y, sides[step.own]])
            q.append(y[: parted.decided])
            y = y[parted.decided :]
            if step.squeezed is not None:
                y = step.squeezed.T @ y
            y = y[: step.left]
        return q[::-1]

    def pulls(self, whitened: Coordinates, out: Array) -> None:
        """Write Q of what is `whitened` to `out` `(k,)`."""
        y = np.zeros(0)
        for parted, step, given in zip(self._parted, self._steps, whitened, strict=True):
            rest = np.zeros(len(step.turn) - parted.decided)
            rest[: len(y)] = y
            if step.squeezed is not None:
                rest = step.squeezed @ rest
            y = step.turn @ np.concatenate([given, rest])
            handed = len(y) - len(step.own)
            out[step.own] = y[handed:]
            y = y[:handed]

    def solve(self, q: Coordinates) -> Coordinates:
        """Return R⁻¹ q."""
        e, t = Coordinates(), np.zeros(0)
        for at, parted, step, given in zip(self._frame, self._parted, self._steps, q, strict=True):
            own = _solved(step.root, given - step.behind @ t)
            t = at.flow @ t + parted.moved @ own
            e.append(own)
        return e

    def whitened(self, gradient: Coordinates) -> Coordinates:
        """Return R⁻ᵀ of a gradient."""
        w, back = Coordinates(), np.zeros(0)
        whole = zip(self._frame, self._parted, self._steps, gradient, strict=True)
        for at, parted, step, given in reversed(list(whole)):
            own = _solved(step.root.T, given - parted.moved.T @ back)
            back = at.flow.T @ back + step.behind.T @ own
            w.append(own)
        return w[::-1]


def _solved(matrix: Array, right: Array) -> Array:
    return np.asarray(np.linalg.solve(matrix, right), dtype=float)
