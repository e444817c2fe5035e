"""What a comparison runs, in one frozen record."""

from dataclasses import dataclass

from prioritized_ik.errors import InputError
from prioritized_ik.models import DIRECTIONS
from prioritized_ik.solvers.backends.registry import ACCURACY, get_backend, installed_solvers
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.lexicographic import FORMULATIONS, SolveOptions
from prioritized_ik.validation import at_least, one_of
from prioritized_ik.winding.settings import CLOSED_FORM, WindingSettings

#: Rows beside the QP backends: Eqs. (12) to (14) alone, and what a user of mink gets today.
MINK_SOLVERS = ("daqp", "proxqp")

RECORDER = "daqp"  # drives the arm while the problems for the replay are recorded


@dataclass(frozen=True)
class ComparisonSettings:
    """Settings of one comparison.

    Attributes:
        solvers: backends, by name.
        directions: keys of `models.DIRECTIONS`; one episode is recorded and driven for each.
        formulations: of the replay; the arm is driven by the lexicographic QP only.
        steps: problems replayed of each direction, half of them free as far as there are so many.
        link: the link that touches the object first.
        tilt: of the object [rad].
        accuracy: asked of every solver.
        rank_tolerance: shared by the closed form and every solver.
        damping: of the damped and slack formulations.
        closed_form_first: let a closed-form step that meets every row be the answer. Off, so that solvers are compared.
        workers: processes.
        witness: also solve the recorded steps by the problem written out in CVXPY.
    """

    solvers: tuple[str, ...] = ()
    directions: tuple[str, ...] = tuple(DIRECTIONS)
    formulations: tuple[str, ...] = ("lexicographic", "damped")
    steps: int = 60
    link: int = 6
    tilt: float = 0.0
    accuracy: float = ACCURACY
    rank_tolerance: float = RANK_TOLERANCE
    damping: float = 1e-12
    closed_form_first: bool = False
    workers: int = 1
    witness: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "solvers", self.solvers or tuple(installed_solvers()))
        for solver in self.solvers:
            get_backend(solver, self.accuracy)
        given = (("solvers", self.solvers), ("directions", self.directions), ("formulation", self.formulations))
        for name, values in given:
            if not values:
                raise InputError(f"{name} is empty; expected at least one.")
            if len(set(values)) != len(values):
                raise InputError(f"{name} names one twice: {', '.join(values)}.")
        for direction in self.directions:
            one_of("direction", direction, DIRECTIONS)
        for formulation in self.formulations:
            one_of("formulation", formulation, FORMULATIONS)
        at_least("steps", self.steps, 1)
        at_least("workers", self.workers, 1)
        self.winding(self.directions[0], RECORDER)

    def options(self, formulation: str = "lexicographic") -> SolveOptions:
        """Return how a backend is to solve."""
        return SolveOptions(
            formulation, self.accuracy, self.rank_tolerance, self.damping, closed_form_first=self.closed_form_first
        )

    def winding(self, direction: str, solver: str) -> WindingSettings:
        """Return the settings of one driven episode."""
        limited = solver != CLOSED_FORM
        return WindingSettings(
            direction=direction,
            link=self.link,
            tilt=self.tilt,
            solver=solver,
            limits=limited,
            contacts=limited,
            options=self.options(),
        )
