"""Orthonormal coordinates of what a level decides and of what it leaves, along a chain of stages: an LQ factorisation.

The directions left to a level are described by a frame: a flow of small states x along the stages, driven by orthonormal
inputs z,

    x_k = F_k x_(k-1) + G_k z_k,    twist of the stage s = T_k x_k;

at first these are the tree's twists and joint steps. A level's rows C s of each stage are rows on x. With x_k = N_k w_k, w
orthonormal coordinates of all inputs so far that no row has decided, one orthogonal matrix per step parts what is new:

    (w_(k-1), z_k) = Q_k (e_k, w_k, f_k):

e is what the rows at hand feel, C T x = L e + what was felt before; w is what they do not feel but what is yet to come may,
and f moves nothing from here on, so that the level does not feel it at all. The level decides the e; and w, f are the
frame of what it leaves, flowing the other way: from w_k and f_k come w_(k-1) and z_k. No direction is ever divided by, so
that nothing is lost however little the rows feel of some; what the level feels in all is in the triangle of `triangle.py`.

A step decides what rows before it have not, and rows depend on each other: links keep their lengths, so that of the three
rows of a point the one along a straight arm says what others say. From the base on that one comes last, and is zero; from
the tips on it would come first, by 1e-9 of its length, and what rounding makes of that direction would count as a rank. So
every level's frame flows outwards: that of what is left is turned round by parting it once more, with no rows.
"""

from dataclasses import dataclass

import numpy as np

from prioritized_ik.validation import Array, lengths

TINY = 1e-14  # [of what moves a component] a state moved by less moves by rounding
END = -1  # number of the stage where a flow ends: none

Coordinates = list[Array]  # step by step


@dataclass
class FrameStep:
    """One step of a flow.

    Attributes:
        stage: where it arrives, or `END`, where there is no state.
        flow, inputs: F `(d, before)` and G `(d, i)`.
        twist: T `(6, d)`.
        spread: how much each component of x moves at most `(d,)`, for its rounding.
    """

    stage: int
    flow: Array
    inputs: Array
    twist: Array
    spread: Array


@dataclass
class Parted:
    """What a level made of one step.

    Attributes:
        turn: Q `(c, c)`.
        before: size of w just before, how many of the c come from it.
        decided: size of e.
        left: size of w.
        moved: what e does to x `(d, e)`.
        state: N `(d, w)`.
    """

    turn: Array
    before: int
    decided: int
    left: int
    moved: Array
    state: Array


def part(frame: list[FrameStep], rows: dict[int, Array], zeros: dict[int, Array]) -> list[Parted]:
    """Return each step parted by a level's rows.

    Args:
        frame: of the directions left to the level.
        rows: on twists, of unit length, by stage `(k, 6)`.
        zeros: what of each row is rounding, by stage `(k,)`.
    """
    steps, before = [], np.zeros((0, 0))
    for step in frame:
        whole = np.hstack([step.flow @ before, step.inputs])
        turn = np.eye(whole.shape[1])
        decided = 0
        if step.stage in rows:
            turn, decided = row_pivoted_lq((rows[step.stage] @ step.twist) @ whole, zeros[step.stage])
        rest = whole @ turn[:, decided:]
        scaled = rest / np.where(step.spread > 0.0, step.spread, 1.0)[:, None]
        again, left = row_pivoted_lq(scaled, np.full(len(rest), TINY))
        turn[:, decided:] = turn[:, decided:] @ again
        turned = whole @ turn
        moved, state = turned[:, :decided], turned[:, decided : decided + left]
        steps.append(Parted(turn, before.shape[1], decided, left, moved, state))
        before = state
    return steps


def next_frame(frame: list[FrameStep], steps: list[Parted]) -> list[FrameStep]:
    """Return the frame of what a level leaves: the same stages the other way round."""
    following = []
    for k in reversed(range(len(steps))):
        own, decided = steps[k], steps[k].decided
        above = own.turn[: own.before]
        stage, twist = (frame[k - 1].stage, frame[k - 1].twist @ steps[k - 1].state) if k else (END, np.zeros((6, 0)))
        flow, inputs = above[:, decided : decided + own.left], above[:, decided + own.left :]
        following.append(FrameStep(stage, flow, inputs, twist, np.ones(own.before)))
    return following


def split(steps: list[Parted], inputs: Coordinates) -> tuple[Coordinates, Coordinates]:
    """Return e, step by step, and f, as inputs of the next frame, of what is given in a frame's inputs z."""
    decided, left, w = Coordinates(), Coordinates(), np.zeros(0)
    for step, z in zip(steps, inputs, strict=True):
        e, w, f = np.split(step.turn.T @ np.concatenate([w, z]), [step.decided, step.decided + step.left])
        decided.append(e)
        left.append(f)
    return decided, left[::-1]


def joined(steps: list[Parted], decided: Coordinates | None, left: Coordinates | None) -> Coordinates:
    """Return the inputs z of e and f, as `split` has them; zero unless given."""
    inputs, w = Coordinates(), np.zeros(0)
    for k, step in reversed(list(enumerate(steps))):
        e = np.zeros(step.decided) if decided is None else decided[k]
        f = np.zeros(step.turn.shape[1] - step.decided - step.left) if left is None else left[len(steps) - 1 - k]
        z = step.turn @ np.concatenate([e, w, f])
        w = z[: step.before]
        inputs.append(z[step.before :])
    return inputs[::-1]


def row_pivoted_lq(matrix: Array, zeros: Array) -> tuple[Array, int]:
    """Return Q `(c, c)` and how many of the rows `(k, c)`, up to `zeros` `(k,)`, depend on its first columns alone.

    The longest row comes first. Reflectors from the right leave each row its own precision.
    """
    left, turn = matrix.copy(), np.eye(matrix.shape[1])
    for done in range(min(matrix.shape)):
        sizes = lengths(left[:, done:])
        sizes[sizes <= zeros] = 0.0
        best = int(sizes.argmax())
        if sizes[best] == 0.0:
            return turn, done
        v, factor, _ = reflector(left[best, done:])
        for some in (left, turn):
            some[:, done:] -= np.outer(some[:, done:] @ v, factor * v)
        left[best, done + 1 :] = 0.0
    return turn, min(matrix.shape)


def reflector(x: Array) -> tuple[Array, float, float]:
    """Return v, τ and β with (I - τ v vᵀ) x = β e₁."""
    beta = -float(np.copysign(np.linalg.norm(x), x[0]))
    v = x / (x[0] - beta)
    v[0] = 1.0
    return v, float((beta - x[0]) / beta), beta
