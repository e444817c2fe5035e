"""Table 4: the closed form against every backend and formulation."""

from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.jobs import Job, Results
from paper_repro.make.table import Cell, Column, Table
from paper_repro.measure.replays import FORMULATIONS, Summary, formulations, replayed_job, summary
from paper_repro.measure.steady import steady_solvers
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE

COLUMNS = (
    Column("formulation", "formulation"),
    Column("backend", "backend"),
    Column("free_dtheta_error_median", "free dθ, median", ".0e"),
    Column("free_dtheta_error_max", "free dθ, max", ".0e"),
    Column("free_dx_error_median", "free dX, median", ".0e"),
    Column("free_dx_error_max", "free dX, max", ".0e"),
    Column("bound_dtheta_error_median", "bound dθ, median", ".0e"),
    Column("bound_dtheta_error_max", "bound dθ, max", ".0e"),
    Column("cost_gap_max", "cost gap", ".0e"),
    Column("violation_max", "violation", ".0e"),
    Column("certified_percent", "certified [%]", ".1f"),
    Column("failed", "failed"),
)

FAMILIES = {"lexicographic": "lexicographic QP", "slack": "slack QP", "damped": "raw or damped QP"}


def jobs(scale: Scale) -> list[Job]:
    """Return one job a backend and formulation."""
    return [replayed_job(scale, solver, chosen) for solver in steady_solvers(scale) for chosen in formulations(solver)]


def build(scale: Scale, results: Results) -> Table:
    """Return one row a formulation and backend."""
    rows: list[tuple[Cell, ...]] = []
    for formulation in FORMULATIONS:
        for solver in steady_solvers(scale):
            if formulation in formulations(solver):
                found = summary(scale, results, solver, formulation)
                errors = (found.dtheta_median, found.dtheta_max, found.dx_median, found.dx_max)
                bound = (found.bound_median, found.bound_max, found.cost_gap_max, found.violation_max)
                last = (100.0 * found.certified, f"{found.failed}/{found.steps}")
                rows.append((formulation.title, solver, *errors, *bound, *last))
    return Table(COLUMNS, tuple(rows), notes(scale, results))


def steps(found: Summary) -> int:
    """Return how many steps a summary is of."""
    return found.steps


def notes(scale: Scale, results: Results) -> str:
    """Return how many steps were replayed, and which of the formulations that are one QP come nearest to the truth."""
    every = {(f, s): summary(scale, results, s, f) for s in steady_solvers(scale) for f in formulations(s)}
    most = max(every.values(), key=steps)
    lines = [
        f"Up to {most.steps} recorded steps ({most.free_steps} free) of {len(scale.directions)} windings, fewer where a "
        f"formulation is one QP: see the last column; rank tolerance {RANK_TOLERANCE:g}."
    ]
    for name, title in FAMILIES.items():
        worst = sorted(
            (found.dtheta_max, solver, formulation.title)
            for (formulation, solver), found in every.items()
            if formulation.name == name and found.dtheta_max is not None and not found.failed
        )
        if worst:
            (low, *first), (high, *last) = worst[0], worst[-1]
            lines.append(
                f"Largest dθ error on free steps by the {title}, of backends that fail nowhere: from {low:.0e} "
                f"({', '.join(first)}) to {high:.0e} ({', '.join(last)})."
            )
    return " ".join(lines)


CAPTION = """\
Every backend solves the same recorded winding steps, limits and contact rows included, in every formulation. Errors are
those *before* the polish, which makes all lexicographic answers one.

- **lexicographic**: the stages of this library, at its accuracy of 1e-8, refinement included;
- **raw**: min (dX\\* − J dθ)ᵀW(dX\\* − J dθ) alone; **damped δ**: the same + δ‖dθ‖², as mink and pink do; **slack δ**: the
  same optimum as damped δ, posed without squaring J: min sᵀWs + δ‖dθ‖² subject to J dθ + s = dX\\*. One call each, with
  the backend's default options, as these formulations are used elsewhere;
- **damped δ accurate**: the damped QP with the tight options, refinement and second attempt of the lexicographic stages,
  so that what is left is the formulation's and not the options' (without HiGHS, which cycles on it until a time limit);
- **mink**: `mink.solve_ik` with 17 frame tasks, its own limits and its default damping of 1e-12.

Errors of dθ and dX are relative. The truth is Eqs. 12–14 (dX: Eq. 15) on *free* steps, on which no row binds, and the
certified lexicographic optimum on *bound* ones. Cost gap: Eq. 10 above its optimum, over its value at dθ = 0.
Violation: of the worst row, as a fraction of the step; both are the largest of all steps. Certified: of all steps,
after the polish where there is one, which is in the lexicographic formulation only. Failed, of all replayed: no answer,
or one that breaks a row by more than 1e-6 of the step; errors are of the steps that did not fail, violations of all
answers.

**To see:** where one QP is solved, the median dθ is off by more than the median dX, and both by far more than the cost:
what the cost hardly feels is left to damping, rounding and the solver's tolerance. Small damping leaves it to the last
two, large damping to the bias (next table). The slack QP loses no digits before the solver starts; what that gains is
up to the solver.

It does *not* say that these backends are inaccurate: each solves the QP that it is given about as well as it is asked
to. J is cut to the rank that all share, but for mink, which builds its own. Native backends (`…-warm`) are kept for the
lexicographic stages only. `proxqp-warm` is left out: its last digits hang on where its memory lies."""

ARTEFACT = Artefact("table-4", "Table 4: closed form against every backend and formulation", CAPTION, jobs, build)
