"""Checks of the caller's values, each raising one `InputError` that says what to do about it."""

import difflib
import math
from collections.abc import Iterable, Sequence
from functools import lru_cache
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from prioritized_ik.errors import InputError
from prioritized_ik.tolerances import ROUNDING

Array = NDArray[np.float64]

LARGEST = 1e100  # squares of larger numbers, and products of those, overflow


def positive(name: str, value: float) -> float:
    """Return `value` as a float if it is finite and above zero."""
    if not _number(value) > 0.0:
        raise InputError(f"{name} is {value!r}; expected a finite number above 0.")
    return float(value)


def non_negative(name: str, value: float) -> float:
    """Return `value` as a float if it is finite and not below zero."""
    if not _number(value) >= 0.0:
        raise InputError(f"{name} is {value!r}; expected a finite number of at least 0.")
    return float(value)


def at_least(name: str, value: int, minimum: int) -> int:
    """Return `value` if it is a whole number of at least `minimum`."""
    number = _number(value)
    if not (number >= minimum and number == int(number)):
        raise InputError(f"{name} is {value!r}; expected a whole number of at least {minimum}.")
    return int(value)


def fraction(name: str, value: float, *, below: float = 1.0) -> float:
    """Return `value` as a float if it is above zero and below `below`."""
    if not 0.0 < _number(value) < below:
        raise InputError(f"{name} is {value!r}; expected a number above 0 and below {below:g}.")
    return float(value)


def gain_of(name: str, value: float) -> float:
    """Return `value` as a float if it is above zero and at most 1."""
    if not 0.0 < _number(value) <= 1.0:
        raise InputError(f"{name} is {value!r}; expected a number above 0 and up to 1.")
    return float(value)


def tolerance_above_rounding(name: str, value: float) -> float:
    """Return `value` as a float if it is a fraction that doubles can tell from rounding."""
    if 0.0 < _number(value) < ROUNDING:
        raise InputError(f"{name} is {value!r}, less than rounding leaves in doubles; expected at least {ROUNDING:.1g}.")
    return fraction(name, value)


def one_of(name: str, value: str, choices: Iterable[str]) -> str:
    """Return `value` if it is one of `choices`."""
    known = choices if isinstance(choices, tuple) else list(choices)
    if value not in known:
        raise InputError(f"unknown {name} {value!r}; choose one of: {', '.join(known)}.")
    return value


def nearest_first(wanted: str, names: Sequence[str]) -> list[str]:
    """Return `names`, those that resemble `wanted` first."""
    near = difflib.get_close_matches(wanted, names, n=max(len(names), 1), cutoff=0.4)
    return list(dict.fromkeys([*near, *names]))


@lru_cache(maxsize=256)  # in a loop names seldom change
def first_repeated(names: tuple[str, ...]) -> str | None:
    """Return the first of `names` that stands there before, if any."""
    if len(set(names)) == len(names):
        return None
    return next(name for place, name in enumerate(names) if name in names[:place])


def distinct(names: Iterable[str]) -> tuple[str, ...]:
    """Return `names` that differ: the second of a name is "name (2)", the third "name (3)"."""
    given = tuple(names)
    if first_repeated(given) is None:
        return given
    taken, made = set(given), list(given)
    for place, name in enumerate(given):
        if name in given[:place]:
            made[place] = next(new for number in count(2) if (new := f"{name} ({number})") not in taken)
            taken.add(made[place])
    return tuple(made)


def finite_array(name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> Array:
    """Return a read-only float copy of `value`, which must be finite and of `shape` (None: any length).

    Raises:
        InputError: wrong shape, or NaN or an infinity, naming the first place where it stands.
    """
    array = _array_of_shape(name, value, shape)
    if _unremarkable(array):
        return array
    _refuse_unusable(name, array)
    bad = ~np.isfinite(array)
    if bad.any():
        place = tuple(int(i) for i in np.argwhere(bad)[0])
        raise InputError(f"{name}{list(place)} is {array[place]}; expected finite numbers only.")
    return array


def shaped_array(name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> Array:
    """Return a read-only float copy of `value`, which must have `shape` (None: any length) and hold no NaN."""
    array = _array_of_shape(name, value, shape)
    if not _unremarkable(array):
        _refuse_unusable(name, array)
    return array


def _array_of_shape(name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> Array:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} is not an array of numbers ({error}); expected shape {_text(shape)}.") from error
    have = array.shape
    if have != shape and not (
        len(have) == len(shape) and all([want in (None, n) for want, n in zip(shape, have, strict=True)])
    ):
        raise InputError(f"{name} has shape {array.shape}; expected {_text(shape)}.")
    array.setflags(write=False)
    return array


def shape_of(name: str, value: ArrayLike) -> tuple[int, ...]:
    """Return the shape of `value`.

    Raises:
        InputError: it has none, because its rows are of different lengths.
    """
    try:
        return np.shape(value)
    except ValueError as error:
        raise InputError(f"{name} is not an array: its rows are of different lengths.") from error


def _refuse_unusable(name: str, array: Array) -> None:
    if np.isnan(array).any():
        place = [int(i) for i in np.argwhere(np.isnan(array))[0]]
        raise InputError(f"{name}{place} is nan; expected numbers only.")
    beyond = np.isfinite(array) & (np.abs(array) > LARGEST)
    if beyond.any():
        place = [int(i) for i in np.argwhere(beyond)[0]]
        raise InputError(f"{name}{place} is {array[tuple(place)]}; expected at most {LARGEST:g}: choose other units.")


def _unremarkable(array: Array) -> bool:
    """Whether all of `array` is finite and far from too large, in one look: if not, it is worth a closer one."""
    return bool(np.vdot(array, array) <= LARGEST)


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only copy of `array`."""
    copy = np.array(array)
    copy.setflags(write=False)
    return copy


def lengths(rows: Array) -> Array:
    """Return the length of each of `rows` `(r, n)`; several times faster than `numpy.linalg.norm` on small arrays."""
    return np.sqrt(np.vecdot(rows, rows))


def length(vector: Array) -> float:
    """Return the length of a vector `(n,)`; `dot` takes half as long as `@` on short ones."""
    return math.sqrt(vector.dot(vector))


def size(matrix: Array) -> float:
    """Return the Frobenius norm of a matrix; several times faster than `numpy.linalg.norm` on small arrays."""
    return math.sqrt(np.vdot(matrix, matrix))


@lru_cache(maxsize=64)
def identity(m: int) -> Array:
    """Return the identity matrix `(m, m)`, read-only."""
    return read_only(np.eye(m))


@lru_cache(maxsize=64)
def ones(k: int) -> Array:
    """Return ones `(k,)`, read-only."""
    return read_only(np.ones(k))


def _number(value: object) -> float:
    """Return `value` as a float, NaN if it is no finite number (NaN fails every comparison)."""
    if type(value) is float:
        return value if math.isfinite(value) else math.nan
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return math.nan
    return number if math.isfinite(number) else math.nan


def _text(shape: tuple[int | None, ...]) -> str:
    return "(" + ", ".join("any" if n is None else str(n) for n in shape) + ("," if len(shape) == 1 else "") + ")"
