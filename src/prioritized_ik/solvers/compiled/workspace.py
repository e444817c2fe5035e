"""Arrays that Python and the compiled core both see, filled from a problem and reused for the next."""

import ctypes
import math
import threading
import weakref
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.packed import Layout, PackedProblem
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.compiled.library import Question, library, tolerances_of
from prioritized_ik.validation import LARGEST, Array, distinct

FIGURES = 4  # of a level: gap, relative gap, stationarity, rounding
COUNTS = 8  # corrections, faces, proofs; the lengths of the lists of active, exceeded, tight, zero and holding rows
ARRAYS = 21  # that both sides see


class Sizes(NamedTuple):
    """How much there is of everything, or room for."""

    joints: int
    levels: int
    level_rows: int
    rows: int
    equalities: int

    @staticmethod
    def of(problem: IKProblem) -> "Sizes":
        """Return the sizes of a problem."""
        return Sizes(
            len(problem.reference),
            len(problem.levels),
            sum([len(level.target) for level in problem.levels]),
            len(problem.rows.upper),
            len(problem.equalities.target),
        )

    def fits(self, room: "Sizes") -> bool:
        """Whether a problem of these sizes has room there."""
        return (
            self.joints == room.joints
            and self.levels <= room.levels
            and self.level_rows <= room.level_rows
            and self.rows <= room.rows
            and self.equalities <= room.equalities
        )

    def roomy(self, other: "Sizes | None") -> "Sizes":
        """Return room for both problems of these sizes and of others, and for some growth."""
        if other is None or other.joints != self.joints:
            other = self
        return Sizes(
            self.joints,
            max(self.levels, other.levels, 4),
            max(self.level_rows, other.level_rows),
            max(2 * self.rows, other.rows, 16),
            max(self.equalities, other.equalities),
        )


class Answer(NamedTuple):
    """What the core wrote of a step, see exchange.hpp: bytes of its own, and where in them something begins.

    Attributes:
        written: dθ first, then the rest.
        figures: of levels, violation, scale, costs; doubles.
        kept: the rows that the step was computed from, a byte for each: a guess for the next.
        lists: counts, and rows by their numbers; whole numbers of four bytes, to the end.
    """

    written: bytearray
    figures: int
    kept: int
    lists: int

    def dtheta(self, joints: int) -> Array:
        """Return dθ `(m,)` in the joint metric, where it stands."""
        return np.frombuffer(self.written, count=joints)

    def kept_rows(self, count: int) -> bytearray:
        """Return the first `count` of the rows, a byte for each."""
        return self.written[self.kept : self.kept + count]

    def all_figures(self, levels: int) -> list[float]:
        """Return the figures of a problem with so many levels."""
        end = self.figures + 8 * (FIGURES * (levels + 1) + 2 + levels)
        return list(memoryview(self.written)[self.figures : end].cast("d"))

    def all_lists(self) -> list[int]:
        """Return the counts and lists."""
        return list(memoryview(self.written)[self.lists :].cast("i"))


class Workspace:
    """One core and its arrays, see exchange.hpp; for one thread at a time."""

    def __init__(self, room: Sizes) -> None:
        core = library().core
        assert core is not None
        self.room, self._solve, self._is_sound, self._size = room, core.core_solve, core.core_is_sound, core.core_size
        m, k, r, e = room.joints, room.level_rows, room.rows, room.equalities
        values = tolerances_of(core)
        address = core.core_new(m, room.levels, k, r, e, values.ctypes.data)
        if not address:
            raise MemoryError("no memory for the compiled core")
        self._address = ctypes.c_void_p(address)
        weakref.finalize(self, core.core_delete, self._address)
        stride, every = core.core_stride(self._address), 2 * m + r + k
        levels = room.levels
        addresses = (ctypes.c_void_p * ARRAYS)()
        core.core_arrays(self._address, addresses)
        at = iter(addresses)
        # In the order of Exchange.
        self.matrix = _reals(next(at), k, stride)[:, :m]
        self.target, self.weights = _reals(next(at), k), _reals(next(at), k)
        self.damping = _reals(next(at), levels)
        self.lower, self.upper = _reals(next(at), m), _reals(next(at), m)
        self.row_matrix, self.row_upper = _reals(next(at), r, stride)[:, :m], _reals(next(at), r)
        self.equality_matrix, self.equality_target = _reals(next(at), e, stride)[:, :m], _reals(next(at), e)
        self.metric_root, self.reference = _reals(next(at), m), _reals(next(at), m)
        self.settings = _reals(next(at), 4)
        self.ends = _integers(next(at), levels)
        self.soft, self._guess = _flags(next(at), levels), _flags(next(at), every).data
        self.multipliers = _reals(next(at), (levels + 1) * every)
        start, *parts = (place or 0 for place in at)
        self._places = [part - start for part in parts]
        self._lists = self._places[-1]
        size = self._lists + 4 * (COUNTS + 2 * every + k + r + 2 * (levels + 1) * every)
        self._answer = _flags(start, size).data
        self._names: tuple[tuple[str, ...], tuple[str, ...], tuple[tuple[str, int], ...]] | None = None
        self.names: tuple[str, ...] = ()  # of upper bounds, lower bounds, rows and soft levels' rows, as lists number them
        self.numbers: dict[str, int] = {}
        self._metric: Array | None = None
        self._sizes: Sizes | None = None  # that the core was told last
        self._layout: Layout | None = None  # of the problem that was filled in, if it is packed

    def fill(self, problem: IKProblem, sizes: Sizes, rank_tolerance: float, *, rounded: bool = False) -> None:
        """Write a problem that has room, whose metric is diagonal; `rounded` if its rows are not those that were given."""
        self._layout = None
        end = 0
        for number, level in enumerate(problem.levels):
            start, end = end, end + len(level.target)
            self.matrix[start:end] = level.matrix
            self.target[start:end] = level.target
            self.weights[start:end] = level.weights
            self.damping[number] = level.damping
            self.soft[number] = level.is_soft
            self.ends[number] = end
        self.lower[:] = problem.bounds.lower
        self.upper[:] = problem.bounds.upper
        if n := sizes.rows:
            self.row_matrix[:n] = problem.rows.matrix
            self.row_upper[:n] = problem.rows.upper
        if n := sizes.equalities:
            self.equality_matrix[:n] = problem.equalities.matrix
            self.equality_target[:n] = problem.equalities.target
        if problem.metric is not self._metric:  # arrays of a problem do not change, and most problems share this one
            self._metric = problem.metric
            np.sqrt(problem.metric, out=self.metric_root)
        self.reference[:] = problem.reference
        self.settings[0] = rank_tolerance
        self.settings[1] = problem.noise
        self.settings[2] = rounded

    @property
    def layout(self) -> Layout | None:
        """That of the problem that is filled in, if it is packed."""
        return self._layout

    def take(self, layout: Layout, sizes: Sizes) -> None:
        """Fill in the pattern of problems of a layout, unless it is there."""
        if layout is not self._layout:
            self.fill(layout.pattern, sizes, 0.0)
            self.name(layout.pattern)
            self._layout = layout

    def is_sound(self, problem: PackedProblem, sizes: Sizes) -> bool:
        """Whether the numbers of a problem whose pattern was filled in are beyond doubt, see packed.hpp."""
        self._tell(sizes)
        return bool(self._is_sound(self._address, problem.memory, LARGEST))

    def guess_rows(self, guess: bytes | bytearray, *, of_another: bool = False) -> None:
        """Write which rows a step may rest on, a byte for each of `names`; `of_another` kind of problem than this."""
        self._guess[: len(guess)] = guess
        self.settings[3] = of_another

    def name(self, problem: IKProblem) -> None:
        """Let `names` and `numbers` be those of a problem."""
        soft = tuple([(level.name, len(level.target)) for level in problem.levels if level.kind == "at_most"])
        found = problem.bounds.names, problem.rows.names, soft
        if found != self._names:
            self._names = found
            self.names, self.numbers = numbered_names(*found)

    def solve(self, sizes: Sizes, question: Question, memory: Any = None) -> tuple[int, int]:
        """Return the `Ending` of the problem that was written, or has its numbers in `memory`, and how long lists are."""
        self._tell(sizes)
        told: int = self._solve(self._address, question, memory)
        if told < 0:
            raise MemoryError("no memory for the compiled core")
        return told & 0xFF, told >> 8

    def answer(self, listed: int) -> Answer:
        """Return what the core wrote of the step that was solved last, with lists of this length."""
        return Answer(bytearray(self._answer[: self._lists + 4 * listed]), *self._places)

    def _tell(self, sizes: Sizes) -> None:
        """Tell the core the sizes of what comes next, unless it knows."""
        if sizes is not self._sizes:
            self._sizes = sizes
            self._size(self._address, sizes.levels, sizes.level_rows, sizes.rows, sizes.equalities)


@lru_cache(maxsize=64)  # in a loop links come near and go away again
def numbered_names(
    joints: tuple[str, ...], rows: tuple[str, ...], soft: tuple[tuple[str, int], ...]
) -> tuple[tuple[str, ...], dict[str, int]]:
    """Return names of upper bounds, lower bounds, rows and soft levels' rows, and the number of each."""
    called = distinct(name for name, _ in soft)
    names = (
        *(f"{name} upper" for name in joints),
        *(f"{name} lower" for name in joints),
        *rows,
        *(f"{name} row {i + 1}" for name, (_, count) in zip(called, soft, strict=True) for i in range(count)),
    )
    return names, {name: number for number, name in reversed(list(enumerate(names)))}


_recent: list[tuple[tuple[str, ...], tuple[str, ...], tuple[tuple[str, ...], dict[str, int]]]] = []
MOST_RECENT = 4


def recent_names(joints: tuple[str, ...], rows: tuple[str, ...]) -> tuple[tuple[str, ...], dict[str, int]]:
    """Return `numbered_names` without soft levels; hashing names of a thousand joints takes longer than comparing a few."""
    for known, others, found in _recent:
        if known is joints and others == rows:
            return found
    found = numbered_names(joints, rows, ())
    _recent.insert(0, (joints, rows, found))
    del _recent[MOST_RECENT:]
    return found


def _reals(address: int | None, rows: int, width: int | None = None) -> Array:
    shape = (rows,) if width is None else (rows, width)
    if address is None or not rows:
        return np.zeros(shape)
    return np.ctypeslib.as_array((ctypes.c_double * math.prod(shape)).from_address(address)).reshape(shape)


def _integers(address: int | None, count: int) -> NDArray[np.int32]:
    if address is None or not count:
        return np.zeros(0, dtype=np.int32)
    return np.ctypeslib.as_array((ctypes.c_int32 * count).from_address(address))


def _flags(address: int | None, count: int) -> NDArray[np.uint8]:
    if address is None or not count:
        return np.zeros(0, dtype=np.uint8)
    return np.ctypeslib.as_array((ctypes.c_uint8 * count).from_address(address))


class _Own(threading.local):
    """Each thread's workspaces, by number of joints, and the sizes of problems that are packed, by their layout."""

    def __init__(self) -> None:
        self.by_joints: dict[int, Workspace] = {}
        self.sizes: weakref.WeakKeyDictionary[Layout, Sizes] = weakref.WeakKeyDictionary()
        self.last: tuple[Workspace, Sizes] | None = None


_OWN = _Own()


def workspace_for(sizes: Sizes) -> Workspace:
    """Return this thread's workspace with room for a problem of `sizes`."""
    found = _OWN.by_joints.get(sizes.joints)
    if found is None or not sizes.fits(found.room):
        found = _OWN.by_joints[sizes.joints] = Workspace(sizes.roomy(None if found is None else found.room))
    return found


def workspace_of(layout: Layout) -> tuple[Workspace, Sizes]:
    """Return this thread's workspace for problems of a layout, their pattern filled in, and their sizes."""
    if _OWN.last is not None and _OWN.last[0].layout is layout:
        return _OWN.last
    sizes = _OWN.sizes.get(layout)
    if sizes is None:
        sizes = _OWN.sizes[layout] = Sizes.of(layout.pattern)
    workspace = workspace_for(sizes)
    workspace.take(layout, sizes)
    _OWN.last = workspace, sizes
    return _OWN.last
