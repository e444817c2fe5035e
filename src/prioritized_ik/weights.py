"""Priorities as weights (Eqs. 11, 23, 24)."""

import numpy as np
from numpy.typing import ArrayLike

from prioritized_ik.errors import InputError
from prioritized_ik.validation import Array, at_least, finite_array, one_of

WOUND = 200.0  # arms 1 … k, whose links hold the object
NEXT = 20.0  # arm k + 1, which is to make contact next
FREE = {"eq23": 0.01, "eq24": 1.0}  # arms k + 2 … n


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
    """Return one weight an arm `(n,)`: Eq. (23) or, for `kind="eq24"`, Eq. (24).

    Args:
        last_in_contact: k, the last of the links in successive contact, from 1; 0 where no link is.
        links: number of links n.
        kind: a key of `FREE`.
    """
    k, n = at_least("last_in_contact", last_in_contact, 0), at_least("links", links, 1)
    if k > n:
        raise InputError(f"last_in_contact is {k}; expected at most the number of links, {n}.")
    weights = np.full(n, FREE[one_of("weights", kind, FREE)])
    weights[: k + 1] = NEXT
    weights[:k] = WOUND
    return weights
