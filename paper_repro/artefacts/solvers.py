"""What each QP solver makes of the recorded steps: the table of the README."""

import importlib.metadata

from comparisons.settings import MINK_SOLVERS
from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.jobs import Job, Results
from paper_repro.make.table import Cell, Column, Table
from paper_repro.measure.replays import DAMPED, LEXICOGRAPHIC, MINK, formulations, replayed_job, summary
from paper_repro.measure.steady import steady_solvers
from prioritized_ik.solvers.backends.registry import get_backend
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE

COLUMNS = (
    Column("solver", "solver"),
    Column("version", "version"),
    Column("free_dtheta_error_max", "dθ, max", ".0e"),
    Column("free_dx_error_max", "dX, max", ".0e"),
    Column("cost_gap_max", "cost gap", ".0e"),
    Column("certified_percent", "certified [%]", ".1f"),
    Column("own_guess_percent", "own guess [%]", ".1f"),
    Column("same_bits_percent", "same bits [%]", ".1f"),
    Column("failed", "failed"),
    Column("damped_free_dtheta_error_median", "damped dθ, median", ".0e"),
    Column("damped_free_dtheta_error_max", "damped dθ, max", ".0e"),
    Column("damped_failed", "damped failed"),
)


def jobs(scale: Scale) -> list[Job]:
    """Return the jobs of table 4 that this table shows."""
    todo = [replayed_job(scale, solver, LEXICOGRAPHIC) for solver in steady_solvers(scale)]
    todo += [replayed_job(scale, solver, DAMPED) for solver in steady_solvers(scale) if DAMPED in formulations(solver)]
    return [*todo, *(replayed_job(scale, solver, MINK) for solver in mink_solvers(scale))]


def mink_solvers(scale: Scale) -> tuple[str, ...]:
    """Return the solvers that mink is shown with."""
    return tuple(solver for solver in MINK_SOLVERS if solver in steady_solvers(scale))


def build(scale: Scale, results: Results) -> Table:
    """Return one row a solver, and mink's."""
    rows: list[tuple[Cell, ...]] = []
    for solver in steady_solvers(scale):
        exact = summary(scale, results, solver, LEXICOGRAPHIC)
        beside: tuple[Cell, ...] = (None, None, None)
        if DAMPED in formulations(solver):
            damped = summary(scale, results, solver, DAMPED)
            beside = (damped.dtheta_median, damped.dtheta_max, f"{damped.failed}/{damped.steps}")
        same = None if exact.same_bits is None else 100.0 * exact.same_bits
        own = None if exact.own_guess is None else 100.0 * exact.own_guess
        figures = (exact.dtheta_max, exact.dx_max, exact.cost_gap_max, 100.0 * exact.certified, own, same)
        rows.append((solver, get_backend(solver).version, *figures, f"{exact.failed}/{exact.steps}", *beside))
    for solver in mink_solvers(scale):
        found = summary(scale, results, solver, MINK)
        versions = f"{importlib.metadata.version('mink')} / {get_backend(solver).version}"
        errors = (found.dtheta_median, found.dtheta_max, f"{found.failed}/{found.steps}")
        rows.append((f"mink ({solver})", versions, *(None,) * 7, *errors))
    one = summary(scale, results, steady_solvers(scale)[0], LEXICOGRAPHIC)
    notes = (
        f"{one.steps} recorded steps of {len(scale.directions)} windings, on {one.free_steps} of which no row binds; for "
        f"the damped QP and mink half as many. Rank tolerance {RANK_TOLERANCE:g}, which mink does not know. Errors are "
        "relative and of the solver's own answer, before it is polished: dθ against Eqs. 12–14 and dX against Eq. 15, "
        "where no row binds; cost gap: the largest excess of Eq. 10 over its optimum, relative to its value at dθ = 0. "
        "Certified: proven optimal at every level after the polish; own guess: of these, made of the "
        "solver's own answer, where the kernel made the others from nothing; same bits: of the certified, equal to the "
        "step that the arm took when recorded, to the last bit. Damped: + 1e-12 ‖dθ‖², as mink and pink do, with the "
        "solver's default options; mink: `mink.solve_ik`. Failed: no answer, or a row broken by more than 1e-6 of the step."
    )
    return Table(COLUMNS, tuple(rows), notes)


CAPTION = """\
The lexicographic QP, in which this library poses Eqs. 12–14 together with limits and contact rows, by every installed
backend, beside the one damped QP that mink and pink solve. **To see:** the lexicographic answers are those of Eqs.
12–14 whichever backend gave them, and once polished they are the same bits; the damped ones hang on the backend. Times
are in table 7, further formulations in table 4. The table does *not* show how backends fare on other problems than
these, nor `proxqp-warm`, whose last digits hang on where its memory lies."""

ARTEFACT = Artefact("solvers", "The solvers on the recorded windings", CAPTION, jobs, build)
