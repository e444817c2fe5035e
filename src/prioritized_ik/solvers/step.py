"""The outcome of one solve: a joint step and what is known of it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

from prioritized_ik.solvers.certificate import Certificate
from prioritized_ik.solvers.conflict import Conflict
from prioritized_ik.solvers.report import LevelReport
from prioritized_ik.validation import Array


class StepStatus(Enum):
    """How a joint step came about; the text says what to do."""

    CLOSED_FORM = "no row binds: the step is the closed form, Eqs. (12) and (13); no QP was needed"
    SOLVED = "every stage is solved, and the step is certified: it is the optimum of every level"
    UNCERTIFIED = (
        "the solver's step keeps every bound and row, but is not proven to be the one optimum: see its certificate"
    )
    VIOLATED = "the solver's step breaks a bound or row: tighten the accuracy or choose another solver"
    NOT_FOUND = "the solver gave no answer to a stage: choose another solver, or look at the rows for a conflict"
    INFEASIBLE = "no step keeps all hard rows: leave out or soften one of those named"


@dataclass(frozen=True)
class Timings:
    """Where the time of one solve went [s]."""

    build: float  # decompositions, changes of variables, stages
    solve: float  # inside the backend, refinement included
    polish: float = 0.0  # polish and certificate

    @property
    def total(self) -> float:
        """All of it."""
        return self.build + self.solve + self.polish


@dataclass(frozen=True)
class JointStep:
    """One solve's outcome.

    Attributes:
        dtheta: dθ `(m,)` [rad]; None unless the step was accepted, so that a failure cannot pass for an answer.
        status: how it came about.
        message: the solver's own words about a failure.
        costs: each level's cost (Eq. 10), the most important first.
        tight_rows: names of the bounds and rows that the step ends on.
        violation: worst violation of a bound or row, relative to the step.
        timings: where the time went.
        calls: how often the solver was called.
        certificate: the proof that the step is the optimum, or the figures that it lacks; None if there is no step.
        raw: the solver's own step `(m,)` before it was polished; None if there was none.
        repairs: how often the kernel had to correct which rows the guess rests on.
        from_nothing: whether the solver's guess led nowhere, so that the kernel made the step from nothing: it is proven or
            not like any other, but owes nothing to the solver.
        conflict: of an infeasible problem, the rows that contradict each other.
        levels: how each `equal` level was cut to its rank, and what that left undone.
        zeros: names of rows that were taken for zero, because they are rounding.
        method: name of the method that made it.
        active_rows: names of the bounds and rows that the step was computed from; none where it is the closed form.
        path: which form of the kernel made it: "compiled" or "python", by matrices, or "tree", joint by joint.
    """

    dtheta: Array | None
    status: StepStatus
    message: str = ""
    costs: tuple[float, ...] = ()
    tight_rows: tuple[str, ...] = ()
    violation: float = 0.0
    timings: Timings = Timings(0.0, 0.0)
    calls: int = 0
    certificate: Certificate | None = None
    raw: Array | None = None
    repairs: int = 0
    from_nothing: bool = False
    conflict: Conflict | None = None
    levels: Sequence[LevelReport] = ()
    zeros: tuple[str, ...] = ()
    method: str = ""
    active_rows: tuple[str, ...] = ()
    path: str = "python"

    @property
    def is_judged(self) -> bool:
        """Whether there is a certificate, holding or not."""
        return self.certificate is not None

    def made_by(self, method: str) -> "JointStep":
        """Return the same step under the name of the method that made it."""
        return self if method == self.method else replace(self, method=method)

    def __str__(self) -> str:
        """Return the step's story in a few lines."""
        if self.dtheta is None:
            return f"no step, {self.status.name}: {self.message or self.status.value}"
        lines = [
            f"{self.status.name}: {self.certificate}",
            f"  errors by level: {', '.join(f'{c**0.5:.3g}' for c in self.costs)}",
        ]
        if self.from_nothing:
            lines.append("  made from nothing: the solver's guess led nowhere")
        if self.tight_rows:
            shown = ", ".join(self.tight_rows[:5])
            more = f" and {len(self.tight_rows) - 5} more" if len(self.tight_rows) > 5 else ""
            lines.append(f"  ends on {shown}{more}")
        lines += [f"  {level}" for level in self.levels if level.undone]
        if self.zeros:
            lines.append(f"  taken for zero: {', '.join(self.zeros[:5])}{' …' if len(self.zeros) > 5 else ''}")
        return "\n".join(lines)

    @property
    def found(self) -> bool:
        """Whether there is a step to take."""
        return self.dtheta is not None
