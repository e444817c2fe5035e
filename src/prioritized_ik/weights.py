"""Priorities as weights (Eqs. 11, 23, 24), or as strict levels in their place."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from prioritized_ik.errors import InputError
from prioritized_ik.validation import Array, at_least, finite_array, one_of

WOUND = 200.0  # arms 1 … k, whose links hold the object
NEXT = 20.0  # arm k + 1, which is to make contact next
FREE = {"eq23": 0.01, "eq24": 1.0}  # arms k + 2 … n

STRICT = "strict"  # the same three groups of arms as levels in strict order, and all weights 1
KINDS = (*FREE, STRICT)  # those of the paper, and what it says of priorities

#: Nothing is asked of arms k + 2 … n, which trail behind: not in the paper, whose free arms are held where they are. A long
#: tail that is held folds up beside the object; one that trails winds, however many links it has.
TRAILING = "trailing"
ALL_KINDS = (*KINDS, TRAILING)


def diagonal_of_weights(arm_weights: ArrayLike, dimension: int) -> Array:
    """Return diag W `(L,)` from one weight an arm `(n,)`, or one an arm and axis `(n, l)`.

    Eq. (11) with the indices mended: the upper one counts arms, the lower one axes, and arms come one after the other.

    Raises:
        InputError: a weight that is not positive, or a shape that does not fit.
    """
    l = at_least("dimension", dimension, 1)  # noqa: E741, the paper's letter
    one_each = np.ndim(arm_weights) == 1
    weights = finite_array("arm_weights", arm_weights, (None,) if one_each else (None, l))
    for place, value in np.ndenumerate(weights):
        if value <= 0.0:
            raise InputError(f"arm_weights{list(place)} is {value}; expected numbers above 0.")
    return np.repeat(weights, l) if one_each else weights.ravel()


def winding_weights(last_in_contact: int, links: int, kind: str = "eq23") -> Array:
    """Return one weight an arm `(n,)`: Eq. (23), for `kind="eq24"` Eq. (24), for `kind="strict"` ones.

    For `kind="trailing"` those of Eq. (23), and zero for arms k + 2 … n.

    Args:
        last_in_contact: k, the last of the links in successive contact, from 1; 0 where no link is.
        links: number of links n.
        kind: one of `ALL_KINDS`.
    """
    groups = _groups(last_in_contact, links)
    if one_of("weights", kind, ALL_KINDS) == STRICT:
        return np.ones(len(groups))
    return np.array([WOUND, NEXT, FREE.get(kind, 0.0)])[groups]


def winding_priorities(last_in_contact: int, links: int, kind: str = STRICT) -> NDArray[np.int64]:
    """Return the number of each arm's level `(n,)`, from 0, the most important; no number is left out.

    For `kind="strict"` the arms that Eqs. (23) and (24) weigh alike share a level: arms 1 … k, then k + 1, then the rest.
    For the other kinds every arm is in level 0, and the weights alone decide.

    Unlike a weight, a level never gives way to those below. Where only moving wound arms could bring the next one closer,
    as when the last link's one hinge axis lies in the plane of an exactly planar winding, the arm waits for ever.

    Args:
        last_in_contact: see `winding_weights`.
        links: number of links n.
        kind: one of `ALL_KINDS`.
    """
    groups = _groups(last_in_contact, links)
    if one_of("weights", kind, ALL_KINDS) != STRICT:
        return np.zeros_like(groups)
    return np.unique(groups, return_inverse=True)[1]


def _groups(last_in_contact: int, links: int) -> NDArray[np.int64]:
    """Return 0 for arms 1 … k, 1 for arm k + 1, 2 for the rest `(n,)`."""
    k, n = at_least("last_in_contact", last_in_contact, 0), at_least("links", links, 1)
    if k > n:
        raise InputError(f"last_in_contact is {k}; expected at most the number of links, {n}.")
    groups = np.full(n, 2)
    groups[: k + 1] = 1
    groups[:k] = 0
    return groups
