"""From the long table to one row a solver, formulation and accuracy, with a verdict. Pure."""

from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import polars

from comparisons.isolation import FAILURES
from comparisons.jobs import COLD, WARM
from comparisons.profiles import WHO, error, per_problem, shifted_geometric_mean
from prioritized_ik.solvers.backends.abilities import abilities_of
from prioritized_ik.solvers.step import StepStatus
from prioritized_ik.validation import Array
from prioritized_ik.winding.settings import CLOSED_FORM

AGREES = 1e-6  # relative error of a free step, and level-1 cost above the best found, up to which a solver agrees

CERTIFIED_ENOUGH = 0.99  # of the constrained steps, for a solver to agree
SAME_STEP = 1e-12  # relative distance up to which two certified steps are one

#: Formulations whose steps are certified, so that an error is known where rows bind too.
KNOWN_RIGHT = ("lexicographic", "reference")

TIME_LIMIT = 10.0  # [s]

Key = tuple[str, str, float | None]  # of a row: solver, formulation, accuracy


@dataclass(frozen=True)
class Row:
    """One line of the table. Errors are relative, lengths in metres, times in seconds; None where there is nothing.

    Attributes:
        solver, version, formulation, accuracy: who. No accuracy is asked of mink and of the damped formulation.
        free_steps: replayed problems on which no row binds.
        free_dtheta_error_max, free_dtheta_error_median: of dθ against Eqs. (12) to (14).
        free_dx_error_max: of dX = J dθ against Eq. (15).
        constrained_steps: the other replayed problems.
        constrained_violation_max: worst violation of a bound or row by an accepted step, relative to the step.
        cost_gap_max: level-1 cost above the best that any solver found, relative to the cost of not moving.
        constrained_dx_error_max: of the solver's own dX on those steps against that of the certified step, weighed by W,
            relative to what is asked.
        constrained_dtheta_spread_median, constrained_dtheta_spread_max: of dθ on those steps from the median answer.
        certified_fraction: of the constrained steps, those whose step is proven optimal.
        own_guess_fraction: of the certified constrained steps, those that the solver's own answer led to; the others the
            kernel made from nothing.
        certified_dtheta_spread_max: worst relative distance of a certified dθ from the one most solvers have.
        certified_same_bits_fraction: of the certified constrained steps, those equal to that one to the last bit.
        step_status: how many replayed steps ended how, by `StepStatus`.
        not_found: replayed problems without an accepted answer, if only once.
        failures: of these, how many for which of `isolation.FAILURES`; of the others the solver itself said so.
        right_fraction: steps found with an error (`profiles.error`) of at most `AGREES`, where that is known on every step.
        solve_time_p50_s, solve_time_p99_s: of building and solving one step, from a warm start where there is one; of each
            problem the median over repeats.
        solve_time_mean_s: their shifted geometric mean with shift `profiles.SHIFT`; one not found counts as the time limit.
        cold_time_p50_s: of solvers that start warm, the same from a cold start.
        build_time_p50_s: of that, outside the solver.
        polish_time_p50_s: of the polish, with the certificates that steer it.
        certificate_time_p50_s: of one certificate by itself.
        constrained_time_p50_s: of building, solving and polishing on constrained steps.
        turns_ratio_min, penetration_max_m, bend_max_rad, drift_max_m: worst of the driven windings.
        task_error_max: worst of the driven scenes: the largest error of a required task at the end [m, rad].
        done: driven episodes, of `episodes`, that ended as they should: windings in equilibrium [1], scenes as they ended
            when they were recorded.
        verdict: `reference`, `agrees`, `agrees: strays …` (see `abilities.py`), `disagrees: …` or `fails: …`.
    """

    solver: str
    version: str
    formulation: str
    accuracy: float | None
    free_steps: int
    free_dtheta_error_max: float | None
    free_dtheta_error_median: float | None
    free_dx_error_max: float | None
    constrained_steps: int
    constrained_violation_max: float | None
    cost_gap_max: float | None
    constrained_dx_error_max: float | None
    constrained_dtheta_spread_median: float | None
    constrained_dtheta_spread_max: float | None
    certified_fraction: float | None
    own_guess_fraction: float | None
    certified_dtheta_spread_max: float | None
    certified_same_bits_fraction: float | None
    step_status: dict[str, int]
    not_found: int
    failures: dict[str, int]
    right_fraction: float | None
    solve_time_p50_s: float | None
    solve_time_p99_s: float | None
    solve_time_mean_s: float | None
    cold_time_p50_s: float | None
    build_time_p50_s: float | None
    polish_time_p50_s: float | None
    certificate_time_p50_s: float | None
    constrained_time_p50_s: float | None
    turns_ratio_min: float | None
    penetration_max_m: float | None
    bend_max_rad: float | None
    drift_max_m: float | None
    task_error_max: float | None
    done: int
    episodes: int
    verdict: str

    @property
    def step_count(self) -> int:
        """Replayed problems."""
        return self.free_steps + self.constrained_steps

    @property
    def agrees(self) -> bool:
        """Whether the verdict is that it agrees."""
        return self.verdict.startswith("agrees")

    @property
    def must_agree(self) -> bool:
        """Whether this row claims to be the closed form wherever nothing binds."""
        return self.formulation == "lexicographic"


def summarise(steps: polars.DataFrame, episodes: polars.DataFrame, time_limit: float = TIME_LIMIT) -> list[Row]:
    """Return the table's rows: the closed form, the lexicographic ones by error, then the others.

    Args:
        steps: the long table of a `Store`.
        episodes: its driven episodes.
        time_limit: what a problem without an answer counts for in the shifted geometric mean [s].
    """
    replayed, driven = _by_row(steps), _by_row(episodes)
    keys = dict.fromkeys([*replayed, *driven])
    rows = [_row(key, replayed.get(key, steps.clear()), driven.get(key, episodes.clear()), time_limit) for key in keys]
    order = ("closed form", "lexicographic", "reference", "mink", "damped", "slack")
    places = {formulation: place for place, formulation in enumerate(order)}  # others, of other packages, come last
    return sorted(
        rows,
        key=lambda row: (places.get(row.formulation, len(order)), not row.agrees, row.solver, -(row.accuracy or 0.0)),
    )


def bound_limit(solver: str) -> float:
    """Return the relative error of dX on a step where rows bind up to which a solver agrees; on a free one, `AGREES`."""
    return max(AGREES, abilities_of(solver).strays)


def _by_row(table: polars.DataFrame) -> dict[Key, polars.DataFrame]:
    return cast(dict[Key, polars.DataFrame], table.partition_by(*WHO, as_dict=True)) if table.height else {}


def _row(key: Key, steps: polars.DataFrame, episodes: polars.DataFrame, time_limit: float) -> Row:
    solver, formulation, accuracy = key
    free, bound = steps.filter("free"), steps.filter(~polars.col("free"))
    accepted, certified = bound.filter("found"), bound.filter("certified")
    warm = steps.filter(start=WARM)
    timed = warm if warm.height else steps
    answered = timed.filter("found")
    cold = steps.filter(start=COLD) if warm.height else steps.clear()
    times = per_problem(answered)
    missed = _problems(steps.filter(~polars.col("found")))
    counted = np.append(times, np.full(_problems(timed) - len(times), time_limit))
    right = steps.select(right=(error() <= AGREES) & polars.col("found")).fill_null(value=False)
    statuses = dict(steps["status"].value_counts().iter_rows())
    failures = {kind: _problems(steps.filter(failure=kind)) for kind in FAILURES}
    known = polars.concat([steps["version"], episodes["version"]]).unique(maintain_order=True).to_list()
    row = Row(
        solver=solver,
        version=", ".join(text for text in known if text != "unknown" or len(known) == 1),
        formulation=formulation,
        accuracy=accuracy,
        free_steps=_problems(free),
        free_dtheta_error_max=_worst(free, "dtheta_error"),
        free_dtheta_error_median=_median(free, "dtheta_error"),
        free_dx_error_max=_worst(free, "dx_error"),
        constrained_steps=_problems(bound),
        constrained_violation_max=_worst(accepted, "violation"),
        cost_gap_max=_worst(accepted, "cost_gap"),
        constrained_dx_error_max=_worst(accepted, "certified_dx_error"),
        constrained_dtheta_spread_median=_median(accepted, "dtheta_spread"),
        constrained_dtheta_spread_max=_worst(accepted, "dtheta_spread"),
        certified_fraction=certified.height / bound.height if bound.height else None,
        own_guess_fraction=_mean(certified, "own_guess"),
        certified_dtheta_spread_max=_worst(certified, "certified_spread"),
        certified_same_bits_fraction=_mean(certified, "certified_same_bits"),
        step_status={status.name: statuses.get(status.name, 0) for status in StepStatus},
        not_found=missed,
        failures={kind: count for kind, count in failures.items() if count},
        right_fraction=_mean(right, "right") if formulation in KNOWN_RIGHT else None,
        solve_time_p50_s=_quantile(times, 0.5),
        solve_time_p99_s=_quantile(times, 0.99),
        solve_time_mean_s=shifted_geometric_mean(counted) if len(counted) else None,
        cold_time_p50_s=_quantile(per_problem(cold.filter("found")), 0.5),
        build_time_p50_s=_median(answered, "build_s"),
        polish_time_p50_s=_median(answered, "polish_s"),
        certificate_time_p50_s=_median(answered, "certificate_s"),
        constrained_time_p50_s=_median(
            answered.filter(~polars.col("free")).select(
                t=polars.col("build_s") + polars.col("solve_s") + polars.col("polish_s")
            ),
            "t",
        ),
        turns_ratio_min=_number(episodes["turns_ratio"].min()),
        penetration_max_m=_worst(episodes, "penetration"),
        bend_max_rad=_worst(episodes, "bend"),
        drift_max_m=_worst(episodes, "drift"),
        task_error_max=_worst(episodes, "error"),
        done=int(episodes["done"].sum()),
        episodes=episodes.height,
        verdict="",
    )
    return replace(row, verdict=_verdict(row))


def _verdict(row: Row) -> str:
    """Return `reference` for the closed form; else what is worst about the row, with its figure, or `agrees`."""
    if row.solver == CLOSED_FORM:
        return "reference"
    if not row.step_count:
        return "fails: no steps"
    if row.not_found:
        why = ", ".join(f"{count} {kind}" for kind, count in row.failures.items())
        return f"fails: {row.not_found}/{row.step_count} steps" + (f" ({why})" if why else "")
    if row.free_dtheta_error_max is not None and row.free_dtheta_error_max > AGREES:
        return f"disagrees: dθ {row.free_dtheta_error_max:.0e}"
    if row.free_dx_error_max is not None and row.free_dx_error_max > AGREES:
        return f"disagrees: dX {row.free_dx_error_max:.0e}"
    if row.cost_gap_max is not None and row.cost_gap_max > AGREES:
        return f"disagrees: cost {row.cost_gap_max:.0e}"
    if row.constrained_dx_error_max is not None and row.constrained_dx_error_max > bound_limit(row.solver):
        return f"disagrees: bound dX {row.constrained_dx_error_max:.0e}"
    if row.must_agree and row.certified_fraction is not None and row.certified_fraction < CERTIFIED_ENOUGH:
        return f"disagrees: {row.certified_fraction:.1%} certified"
    if row.must_agree and row.certified_dtheta_spread_max is not None and row.certified_dtheta_spread_max > SAME_STEP:
        return f"disagrees: certified dθ {row.certified_dtheta_spread_max:.0e}"
    if row.done < row.episodes:
        return f"fails: {row.episodes - row.done}/{row.episodes} episodes"
    if row.constrained_dx_error_max is not None and row.constrained_dx_error_max > AGREES:
        return f"agrees: strays dX {row.constrained_dx_error_max:.0e}"
    return "agrees"


def _problems(steps: polars.DataFrame) -> int:
    """Return of how many problems the rows are, repeats and starts aside."""
    return steps.select("case", "step").n_unique() if steps.height else 0


def _number(value: Any) -> float | None:
    return None if value is None else float(value)


def _worst(table: polars.DataFrame, name: str) -> float | None:
    return _number(table[name].max())


def _median(table: polars.DataFrame, name: str) -> float | None:
    return _number(table[name].median())


def _mean(table: polars.DataFrame, name: str) -> float | None:
    return _number(table[name].mean())


def _quantile(values: Array, fraction: float) -> float | None:
    return float(np.quantile(values, fraction)) if len(values) else None
