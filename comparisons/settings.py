"""What a comparison runs, in one frozen record. Whatever takes several values is swept: the cases are their product."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from comparisons.methods import MINK
from prioritized_ik.errors import InputError
from prioritized_ik.models import DIRECTIONS
from prioritized_ik.solvers.backends.abilities import abilities_of
from prioritized_ik.solvers.backends.registry import ACCURACY, installed_solvers
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.methods import DAMPING
from prioritized_ik.solvers.registry import DAMPED, DEFAULT, LEXICOGRAPHIC, SLACK, get_method, parts_of, registered
from prioritized_ik.validation import at_least, fraction, non_negative, one_of, positive
from prioritized_ik.winding.metrics import ROUND_SHAPES

#: Families that a QP solver named by itself is replayed in.
FORMULATIONS = (LEXICOGRAPHIC, DAMPED, SLACK)

#: Those whose problem is another one, with a damping of its own.
ONE_QP = (DAMPED, SLACK)

#: Whose problems have one level.
ONE_LEVEL = (*ONE_QP, MINK)

#: Rows beside those asked for: Eqs. (12) to (14) alone, and what a user of mink gets today.
MINK_SOLVERS = ("daqp", "proxqp")

RECORDER = "daqp"  # drives the arm while the problems for the replay are recorded


@dataclass(frozen=True)
class ComparisonSettings:
    """Settings of one comparison.

    Attributes:
        solvers: methods by name, see `solvers.registry`; unless given, the kernel alone and every installed QP solver.
        directions: keys of `models.DIRECTIONS`.
        formulations: that a QP solver named by itself is replayed in; the arm is driven by the lexicographic one only.
        steps: problems replayed of each case, half of them free as far as there are so many.
        links: how many the arm has.
        link: the link that touches the object first.
        shapes: of the object, some of `metrics.ROUND_SHAPES`.
        diameter: of the object [m].
        tilt: of the object [rad].
        seeds: of random initial postures; empty for the straight one.
        accuracy: asked of every solver; one that does not reach some of them goes without these.
        rank_tolerance: shared by the closed form and every solver.
        damping: of the damped and slack formulations.
        closed_form_first: let a closed-form step that meets every row be the answer. Off, so that solvers are compared.
        repeats: how often each problem is solved; the figures of time are medians over these.
        drive: let every solver wind the arm itself as well.
        mink: compare with `mink.solve_ik`.
        witness: also solve the recorded steps by the problem written out in CVXPY.
        recorded: folder with the user's own episodes, problems and QPs, instead of the windings; empty for none.
        scenes: task files, instead of the windings.
        time_limit: of one problem [s].
        memory_limit: of one solver, beyond what a process has before it is called [GiB].
        workers: processes that work at the same time. Decides nothing but times.
        scheduler: address of a Dask scheduler that spreads the work instead; empty for this machine.
    """

    solvers: tuple[str, ...] = ()
    directions: tuple[str, ...] = tuple(DIRECTIONS)
    formulations: tuple[str, ...] = ("lexicographic", "damped")
    steps: int = 60
    links: tuple[int, ...] = (17,)
    link: tuple[int, ...] = (6,)
    shapes: tuple[str, ...] = ("cylinder",)
    diameter: tuple[float, ...] = (0.14,)
    tilt: tuple[float, ...] = (0.0,)
    seeds: tuple[int, ...] = ()
    accuracy: tuple[float, ...] = (ACCURACY,)
    rank_tolerance: float = RANK_TOLERANCE
    damping: float = DAMPING
    closed_form_first: bool = False
    repeats: int = 1
    drive: bool = True
    mink: bool = True
    witness: bool = False
    recorded: str = ""
    scenes: tuple[str, ...] = ()
    time_limit: float = 10.0
    memory_limit: float = 2.0
    workers: int = 1
    scheduler: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "solvers", self.solvers or (DEFAULT, *installed_solvers()))
        for name, values in self._lists().items():
            if not values:
                raise InputError(f"{name} is empty; expected at least one.")
            if len(set(values)) != len(values):
                raise InputError(f"{name} names one twice: {', '.join(map(str, values))}.")
        for direction in self.directions:
            one_of("direction", direction, DIRECTIONS)
        for formulation in self.formulations:
            one_of("formulation", formulation, FORMULATIONS)
        for shape in self.shapes:
            one_of("shape", shape, ROUND_SHAPES)
        for diameter in self.diameter:
            positive("diameter", diameter)
        for seed in self.seeds:
            at_least("seed", seed, 0)
        for accuracy in self.accuracy:
            fraction("accuracy", accuracy)
        for solver in self.solvers:
            if solver not in registered():  # what was added is not called here: it may crash
                get_method(solver, max(self.accuracy))
        for name in ("steps", "repeats", "workers"):
            at_least(name, getattr(self, name), 1)
        for name in ("time_limit", "memory_limit"):
            positive(name, getattr(self, name))
        non_negative("damping", self.damping)
        self.options()
        if self.recorded and self.scenes:
            raise InputError("recorded episodes and scenes are both given; expected either.")
        stems = [Path(file).stem for file in self.scenes]
        if len(set(stems)) != len(stems):
            raise InputError(f"scenes are {', '.join(self.scenes)}; expected names of which no two are the same.")
        if self.recorded and not Path(self.recorded).is_dir():
            raise InputError(
                f"cannot read {self.recorded!r}; expected a folder with saved episodes, problems or QPs (.npz)."
            )

    def options(self, formulation: str = "lexicographic", accuracy: float | None = None) -> SolveOptions:
        """Return how a backend is to solve, by default at the finest accuracy."""
        finest = min(self.accuracy) if accuracy is None else accuracy
        return SolveOptions(
            finest,
            self.rank_tolerance,
            self.damping if formulation in ONE_QP else None,
            closed_form_first=self.closed_form_first,
        )

    def accuracies_of(self, solver: str) -> tuple[float, ...]:
        """Return those accuracies that method `solver` reaches."""
        finest = 0.0 if solver in registered() else abilities_of(parts_of(solver)[1]).finest
        return tuple(accuracy for accuracy in self.accuracy if accuracy >= finest)

    def left_out(self) -> dict[str, list[float]]:
        """Return by solver the accuracies that it does not reach, and so goes without."""
        missing = {name: [a for a in self.accuracy if a not in self.accuracies_of(name)] for name in self.solvers}
        return {name: accuracies for name, accuracies in missing.items() if accuracies}

    def _lists(self) -> dict[str, tuple[Any, ...]]:
        lists: dict[str, tuple[Any, ...]] = {
            "solvers": self.solvers, "directions": self.directions, "formulation": self.formulations,
            "links": self.links, "link": self.link, "object": self.shapes, "diameter": self.diameter,
            "tilt": self.tilt, "accuracy": self.accuracy,
        }  # fmt: skip
        return {**lists, **({"seeds": self.seeds} if self.seeds else {})}
