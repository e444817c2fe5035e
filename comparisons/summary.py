"""From records to one row a solver and formulation, with a verdict. Pure."""

import math
from collections import Counter, defaultdict
from dataclasses import asdict, dataclass
from importlib.metadata import version

import numpy as np

from comparisons.run import MINK_ROWS, WITNESS, Record
from prioritized_ik.solvers.backends.registry import get_backend
from prioritized_ik.solvers.step import StepStatus
from prioritized_ik.winding.episode import Outcome
from prioritized_ik.winding.settings import CLOSED_FORM

AGREES = 1e-6  # relative error of a free step, and level-1 cost above the best found, up to which a solver agrees

CERTIFIED_ENOUGH = 0.99  # of the constrained steps, for a solver to agree
SAME_STEP = 1e-12  # relative distance up to which two certified steps are one

#: Only steps that keep every row this well can set the best cost: a step that breaks a row by the accepted 1e-6 of its size
#: gains a few 1e-6 of cost by it.
BEST_KEEPS = 1e-8


@dataclass(frozen=True)
class Row:
    """One line of the table. Errors are relative, lengths in metres, times in seconds; None where there is nothing.

    Attributes:
        solver, version, formulation: who.
        free_steps: replayed steps on which no row binds.
        free_dtheta_error_max, free_dtheta_error_median: of dθ against Eqs. (12) to (14).
        free_dx_error_max: of dX = J dθ against Eq. (15).
        constrained_steps: the other replayed steps.
        constrained_violation_max: worst violation of a bound or row by an accepted step, relative to the step.
        cost_gap_max: level-1 cost above the best that any solver found, relative to the cost of not moving.
        constrained_dtheta_spread_median, constrained_dtheta_spread_max: of dθ on those steps from the median answer.
        certified_fraction: of the constrained steps, those whose step is proven optimal.
        certified_dtheta_spread_max: worst relative distance of a certified dθ from the one most solvers have.
        certified_same_bits_fraction: of the certified constrained steps, those equal to that one to the last bit.
        step_status: how many replayed steps ended how, by `StepStatus`.
        not_found: replayed steps without an accepted answer.
        solve_time_p50_s, solve_time_p99_s: of building and solving one step.
        polish_time_p50_s: of polish and certificate.
        constrained_time_p50_s: of all three on constrained steps.
        turns_ratio_min, penetration_max_m, bend_max_rad, drift_max_m: worst of the driven episodes.
        wound: driven episodes that reached equilibrium [1], of `episodes`.
        verdict: `reference`, `agrees`, `disagrees: …` or `fails: …`.
    """

    solver: str
    version: str
    formulation: str
    free_steps: int
    free_dtheta_error_max: float | None
    free_dtheta_error_median: float | None
    free_dx_error_max: float | None
    constrained_steps: int
    constrained_violation_max: float | None
    cost_gap_max: float | None
    constrained_dtheta_spread_median: float | None
    constrained_dtheta_spread_max: float | None
    certified_fraction: float | None
    certified_dtheta_spread_max: float | None
    certified_same_bits_fraction: float | None
    step_status: dict[str, int]
    not_found: int
    solve_time_p50_s: float | None
    solve_time_p99_s: float | None
    polish_time_p50_s: float | None
    constrained_time_p50_s: float | None
    turns_ratio_min: float | None
    penetration_max_m: float | None
    bend_max_rad: float | None
    drift_max_m: float | None
    wound: int
    episodes: int
    verdict: str

    @property
    def must_agree(self) -> bool:
        """Whether this row claims to be the closed form wherever nothing binds."""
        return self.formulation == "lexicographic"


def summarise(steps: list[Record], episodes: list[Record]) -> list[Row]:
    """Return the table's rows: the closed form, the lexicographic ones by error, then the others."""
    add_cost_gaps(steps)
    add_spreads(steps)
    add_certified_spreads(steps)
    replayed, driven = _by_row(steps), _by_row(episodes)
    rows = [_row(key, replayed.get(key, []), driven.get(key, [])) for key in {**replayed, **driven}]
    order = ("closed form", "lexicographic", "witness", "mink", "damped", "slack")
    return sorted(rows, key=lambda row: (order.index(row.formulation), row.verdict != "agrees", row.solver))


def add_cost_gaps(steps: list[Record]) -> None:
    """Give every record its `cost_gap`: level-1 cost above the best one, over the cost of not moving."""
    best: dict[tuple[str, int], float] = defaultdict(lambda: math.inf)
    for record in steps:
        if record["cost"] is not None and record["violation"] <= BEST_KEEPS:
            key = (record["direction"], record["step"])
            best[key] = min(best[key], record["cost"])
    for record in steps:
        lowest = best[record["direction"], record["step"]]
        known = record["cost"] is not None and math.isfinite(lowest)
        record["cost_gap"] = (record["cost"] - lowest) / record["cost_at_zero"] if known else None


def add_spreads(steps: list[Record]) -> None:
    """Give every record its `dtheta_spread`: distance of dθ from the median of the lexicographic answers, relative.

    The optimum is unique, so that on a step where rows bind the distance is an error of somebody.
    """
    answers: dict[tuple[str, int], list[list[float]]] = defaultdict(list)
    for record in steps:
        if record["dtheta"] is not None and record["formulation"] == "lexicographic":
            answers[record["direction"], record["step"]].append(record["dtheta"])
    middles = {key: np.median(found, axis=0) for key, found in answers.items()}
    for record in steps:
        middle = middles.get((record["direction"], record["step"]))
        record["dtheta_spread"] = None
        if record["dtheta"] is not None and middle is not None:
            record["dtheta_spread"] = float(np.linalg.norm(record["dtheta"] - middle) / np.linalg.norm(middle))


def add_certified_spreads(steps: list[Record]) -> None:
    """Give every certified record its `certified_spread` from the answer most have, and whether it is that to the bit."""
    answers: dict[tuple[str, int], Counter[tuple[float, ...]]] = defaultdict(Counter)
    for record in steps:
        if record["certified_dtheta"] is not None and record["formulation"] == "lexicographic":
            answers[record["direction"], record["step"]][tuple(record["certified_dtheta"])] += 1
    for record in steps:
        known = answers.get((record["direction"], record["step"]))
        record["certified_spread"] = record["certified_same_bits"] = None
        if record["certified_dtheta"] is not None and known:
            usual = np.array(known.most_common(1)[0][0])
            distance = float(np.linalg.norm(record["certified_dtheta"] - usual) / np.linalg.norm(usual))
            record["certified_spread"] = distance
            record["certified_same_bits"] = distance == 0.0


def _by_row(records: list[Record]) -> dict[tuple[str, str], list[Record]]:
    groups: dict[tuple[str, str], list[Record]] = defaultdict(list)
    for record in records:
        groups[record["solver"], record["formulation"]].append(record)
    return groups


def _row(key: tuple[str, str], steps: list[Record], episodes: list[Record]) -> Row:
    solver, formulation = key
    free = [record for record in steps if record["free"]]
    bound = [record for record in steps if not record["free"]]
    accepted = [record for record in bound if record["found"]]
    certified = [record for record in bound if record["certified"]]
    constrained_times = [record["solve_s"] + record["polish_s"] for record in bound]
    statuses = Counter(record["status"] for record in steps)
    row = Row(
        solver=solver,
        version=_version(solver),
        formulation=formulation,
        free_steps=len(free),
        free_dtheta_error_max=_worst(free, "dtheta_error"),
        free_dtheta_error_median=_median(free, "dtheta_error"),
        free_dx_error_max=_worst(free, "dx_error"),
        constrained_steps=len(bound),
        constrained_violation_max=_worst(accepted, "violation"),
        cost_gap_max=_worst(accepted, "cost_gap"),
        constrained_dtheta_spread_median=_median(accepted, "dtheta_spread"),
        constrained_dtheta_spread_max=_worst(accepted, "dtheta_spread"),
        certified_fraction=len(certified) / len(bound) if bound else None,
        certified_dtheta_spread_max=_worst(certified, "certified_spread"),
        certified_same_bits_fraction=_mean(certified, "certified_same_bits"),
        step_status={status.name: statuses[status.name] for status in StepStatus},
        not_found=sum(not record["found"] for record in steps),
        solve_time_p50_s=_median(steps, "solve_s"),
        solve_time_p99_s=float(np.quantile(_values(steps, "solve_s"), 0.99)) if steps else None,
        polish_time_p50_s=_median(steps, "polish_s"),
        constrained_time_p50_s=float(np.median(constrained_times)) if constrained_times else None,
        turns_ratio_min=min(_values(episodes, "turns_ratio"), default=None),
        penetration_max_m=_worst(episodes, "penetration"),
        bend_max_rad=_worst(episodes, "bend"),
        drift_max_m=_worst(episodes, "drift"),
        wound=sum(record["outcome"] == Outcome.WOUND.name for record in episodes),
        episodes=len(episodes),
        verdict="",
    )
    return Row(**{**asdict(row), "verdict": _verdict(row)})


def _verdict(row: Row) -> str:
    """Return `reference` for the closed form; else what is worst about the row, with its figure, or `agrees`."""
    if row.solver == CLOSED_FORM:
        return "reference"
    if not row.free_steps + row.constrained_steps:
        return "fails: no steps"
    if row.not_found:
        return f"fails: {row.not_found}/{row.free_steps + row.constrained_steps} steps"
    if row.free_dtheta_error_max is not None and row.free_dtheta_error_max > AGREES:
        return f"disagrees: dθ {row.free_dtheta_error_max:.0e}"
    if row.free_dx_error_max is not None and row.free_dx_error_max > AGREES:
        return f"disagrees: dX {row.free_dx_error_max:.0e}"
    if row.cost_gap_max is not None and row.cost_gap_max > AGREES:
        return f"disagrees: cost {row.cost_gap_max:.0e}"
    if row.must_agree and row.certified_fraction is not None and row.certified_fraction < CERTIFIED_ENOUGH:
        return f"disagrees: {row.certified_fraction:.1%} certified"
    if row.must_agree and row.certified_dtheta_spread_max is not None and row.certified_dtheta_spread_max > SAME_STEP:
        return f"disagrees: certified dθ {row.certified_dtheta_spread_max:.0e}"
    if row.wound < row.episodes:
        return f"fails: {row.episodes - row.wound}/{row.episodes} windings"
    return "agrees"


def _version(solver: str) -> str:
    if solver == CLOSED_FORM:
        return ""
    if solver == WITNESS:
        return version("cvxpy")
    if solver in MINK_ROWS:
        return f"{version('mink')} / {get_backend(MINK_ROWS[solver]).version}"
    return get_backend(solver).version


def _values(records: list[Record], name: str) -> list[float]:
    return [record[name] for record in records if record[name] is not None]


def _worst(records: list[Record], name: str) -> float | None:
    return max(_values(records, name), default=None)


def _median(records: list[Record], name: str) -> float | None:
    values = _values(records, name)
    return float(np.median(values)) if values else None


def _mean(records: list[Record], name: str) -> float | None:
    values = _values(records, name)
    return float(np.mean(values)) if values else None
