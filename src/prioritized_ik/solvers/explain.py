"""Which level of a step gave way, by how much, and to what."""

from dataclasses import dataclass, replace

import numpy as np

from prioritized_ik.errors import InputError
from prioritized_ik.problem import Bounds, IKProblem, Level, Rows, replaced
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.solve import solve
from prioritized_ik.solvers.step import JointStep
from prioritized_ik.tolerances import CERTIFIED, ROUNDING
from prioritized_ik.validation import Array


@dataclass(frozen=True)
class Concession:
    """What became of one level; errors are √Q of Eq. (10), in the units of its target.

    Attributes:
        level: its name.
        alone: the error it would reach alone.
        below_others: the error it would reach under the levels above, without bounds and rows.
        error: the error of the step.
        held_by: bounds and rows that hold it back.
        tolerance: errors nearer to each other than this are equal.
        undone: what was left undone because directions of the level were cut as too weak or rounding.
    """

    level: str
    alone: float
    below_others: float
    error: float
    held_by: tuple[str, ...]
    tolerance: float
    undone: float = 0.0

    @property
    def gave_way(self) -> bool:
        """Whether the level does worse than it would alone."""
        return self.error > self.alone + self.tolerance

    def __str__(self) -> str:
        """Return one line for people."""
        cut = (
            f"; {self.undone:.3g} of it left undone along directions that were cut" if self.undone > self.tolerance else ""
        )
        if not self.gave_way:
            return f"{self.level}: error {self.error:.3g}{cut or ', as if it were alone'}"
        to_levels, to_rows = self.below_others - self.alone, self.error - self.below_others
        reasons = []
        if to_levels > self.tolerance:
            reasons.append(f"gave way by {to_levels:.3g} to the levels above")
        if to_rows > self.tolerance:
            reasons.append(f"gave way by {to_rows:.3g} to {_listed(self.held_by)}")
        if to_rows < -self.tolerance:  # rows hold a level above back, to this one's gain
            reasons.append(f"got back {-to_rows:.3g} through rows")
        return f"{self.level}: error {self.error:.3g} instead of {self.alone:.3g}; {', '.join(reasons)}{cut}"


NAMED = 5  # rows in a message


def _listed(names: tuple[str, ...]) -> str:
    """Return the first few names, and how many more there are."""
    if not names:
        return "rows that the levels above rest on"
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more


def explain(problem: IKProblem, step: JointStep, options: SolveOptions | None = None) -> tuple[Concession, ...]:
    """Return what each level of a step conceded, the most important first.

    Args:
        problem: what the step solves.
        step: found by `solve`.
        options: those it was solved with.

    Raises:
        InputError: there is no step, or it has no certificate.
        StepNotFoundError: a problem without some of the levels and rows could not be solved.
    """
    if step.dtheta is None or step.certificate is None:
        raise InputError(f"the step is {step.status.name}; expected one that was found and has a certificate.")
    options = options or SolveOptions()
    if options.soften:
        problem, options = problem.softened(options.soften), replace(options, soften=())
    undone = {level.level: level.undone for level in step.levels}
    return tuple(
        Concession(
            level.name,
            _error(problem, (level,), options),
            _error(problem, problem.levels[: i + 1], options),
            float(np.sqrt(level.cost(step.dtheta))),
            step.certificate.held_by[i],
            _tolerance(level, step.dtheta),
            undone.get(level.name, 0.0),
        )
        for i, level in enumerate(problem.levels)
    )


def _tolerance(level: Level, dtheta: Array) -> float:
    """Return what two errors of a level may differ by and be equal, rounding of what is summed up in them included."""
    terms = float(np.sqrt(level.weights @ (np.abs(level.matrix) @ np.abs(dtheta)) ** 2))
    return max(CERTIFIED * level.demand, ROUNDING * terms)


def _error(problem: IKProblem, levels: tuple[Level, ...], options: SolveOptions) -> float:
    """Return √Q of the last of `levels` where no bounds and rows are."""
    m = problem.joint_count
    without_rows = replaced(problem, levels=levels, bounds=Bounds.none(m), rows=Rows.none(m))
    step = solve(without_rows, options=options)
    return float(np.sqrt(step.costs[-1]))
