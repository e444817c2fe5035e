"""What is proven of one level at one step, and which of its active rows pull; `certificate` works it out."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.tolerances import GAP
from prioritized_ik.validation import Array, length


@dataclass(frozen=True)
class LevelProof:
    """One level's optimality.

    Attributes:
        level: its name.
        gap: how much lower its cost could be, beyond rounding, those above as they are; in its own units, squared.
        carried: how much lower it could be by rounding, of its own or of those above, or if these were mended.
        demand: √(bᵀ W b), or its error √Q if that is more, what the gap is relative to, squared.
        displacement: what would still lower the level's cost without harm to those above `(m,)`, beyond rounding.
        feigned: how long a displacement the rounding of doubles can feign.
        rounding: how long a displacement the rounding of the conditions' own terms explains.
        multipliers: λ `(r,)` of the pooled rows; zero for those that do not hold the level back.
        gradient: the level's, in scaled coordinates `(v,)`.
        near: numbers of the rows that may hold it back `(t,)`.
        normals: those rows in the same coordinates `(t, v)`, of unit length.
        scale: what displacements are relative to.
        tolerance: what displacements may reach, relative to that.
    """

    level: str
    gap: float
    carried: float
    demand: float
    displacement: Array
    feigned: float
    rounding: float
    multipliers: Array
    gradient: Array
    near: NDArray[np.int_]
    normals: Array
    scale: float
    tolerance: float

    @cached_property
    def excess(self) -> float:
        """Length of the displacement."""
        return length(self.displacement)

    @property
    def relative_gap(self) -> float:
        """The gap relative to the demand, squared; zero if there is none."""
        return self.gap / self.demand**2 if self.gap and self.demand else 0.0

    @property
    def is_off(self) -> bool:
        """Whether a displacement beyond the tolerance would lower the level's cost: the step is no optimum."""
        return self.excess > self.tolerance * self.scale

    @property
    def fails(self) -> bool:
        """Whether the level is not proven optimal."""
        return self.is_off or self.relative_gap > GAP

    def pulls(self, active: NDArray[np.bool_]) -> Iterator[int]:
        """Yield the `active` rows that pull, most first: their multipliers are negative if all are to be equalities."""
        among = active[self.near]
        if among.any():
            signed = np.linalg.lstsq(self.normals[among].T, -self.gradient)[0]
            for place in np.argsort(signed):
                if signed[place] < 0.0:
                    yield int(self.near[among][place])
