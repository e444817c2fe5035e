"""Table 8: how windings end, by direction, weights and method, over random initial poses."""

from collections import Counter
from collections.abc import Callable
from functools import cache
from statistics import median
from typing import Any

from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.jobs import Job, Results
from paper_repro.make.table import Cell, Column, Table
from paper_repro.measure.windings import (
    CRITERION,
    LONG,
    METHOD_NAMES,
    METHODS,
    TERM_TITLES,
    counted,
    measured_job,
    settings,
)
from prioritized_ik.weights import KINDS
from prioritized_ik.winding.episode import Outcome
from prioritized_ik.winding.settings import WindingSettings

WEIGHT_NAMES = {"eq23": "Eq. 23", "eq24": "Eq. 24", "strict": "strict"}

#: Figures with a median and a worst value: key in `measured`, what makes it of the table's unit, and which one is worst.
FIGURES: dict[str, tuple[float, Callable[[list[float]], float]]] = {
    "turns_ratio": (1.0, min),
    "bend": (1.0, max),
    "penetration": (1e3, max),
    "drift": (1e3, max),
    "steps": (1.0, max),
    "flips": (1.0, max),
    "driven_together": (1.0, max),
}

COLUMNS = (
    Column("direction", "object from"),
    Column("weights", "weights"),
    Column("method", "method"),
    Column("statistic", "statistic"),
    Column("turns_ratio", "turns / ideal", ".2f"),
    Column("bend_rad", "bend [rad]", ".2f"),
    Column("penetration_mm", "penetration [mm]", ".1f"),
    Column("drift_mm", "drift [mm]", ".1f"),
    Column("steps", "steps", ".0f"),
    Column("beta_flips", "β flips", ".0f"),
    Column("steps_driving_several_arms", "steps with several arms driven", ".0f"),
    Column("in_contact", TERM_TITLES[0]),
    Column("turned", TERM_TITLES[1]),
    Column("within_range", TERM_TITLES[2]),
)

CAPTION = f"""\
Windings of the 17-link arm from link {LONG} on, from random initial poses (seeded, every joint within a few hundredths
of a radian of straight), each wound with the weights of Eq. 23, of Eq. 24 and with strict priorities in their place, by
the *closed form* (Eqs. 12 to 14 alone, as in the paper) and by the *QP*, which adds joint ranges, a step limit and
contact rows to the same solve. Two rows a case: the median of the windings, and the worst of each figure by itself.
Turns are those of the links from the first in contact on about the object's axis, over what a polygon of tangent links
would make; bend, penetration (negative: the least clearance) and drift (motion of a link's end after its link was
wound) are the largest at any time.

{CRITERION}. The ideal bend is 41°, 0.72 rad.

From link {LONG} on there is 1.26 of a turn to wind, more than the closed form does from any pose tried: it nearly
always ends with every link in contact, but the free tail, which Eqs. 12 to 14 hold in place, is then in the object or
folded back. With up to 0.8 of a turn it winds; where, shows the closed-form map. This table does *not* say how the
paper's own windings were: its initial pose, the object's, the link radius and the joint ranges are not stated. Links
here may pass through each other, since contact within the arm is not modelled.
"""


@cache
def winding(direction: str, weights: str, method: str, seed: int) -> WindingSettings:
    """Return the settings of one winding of the table; others use the same."""
    return settings(method, direction=direction, weights=weights, posture="random", seed=seed)


def directions(scale: Scale) -> tuple[str, ...]:
    """Return where the object comes from; one direction in the reduced run."""
    return scale.directions[:1] if scale.quick else scale.directions


def cases(scale: Scale) -> list[tuple[str, str, str]]:
    """Return direction, weights and method of each case."""
    return [(direction, weights, method) for direction in directions(scale) for weights in KINDS for method in METHODS]


def jobs(scale: Scale) -> list[Job]:
    """Return one job a winding."""
    return [
        measured_job(winding(direction, weights, method, seed))
        for direction, weights, method in cases(scale)
        for seed in range(scale.seeds)
    ]


def found(scale: Scale, results: Results, sides: tuple[str, ...], weights: str, method: str) -> list[dict[str, Any]]:
    """Return the figures of the windings from `sides` and all seeds."""
    return [results[measured_job(winding(d, weights, method, seed))] for d in sides for seed in range(scale.seeds)]


def two_rows(head: tuple[Cell, ...], wound: list[dict[str, Any]]) -> list[tuple[Cell, ...]]:
    """Return the rows of median and worst figures of windings, `head` before them and, after the former, how many wound."""
    return [
        (*head, "median", *(figure(wound, key, median) for key in FIGURES), *counted(wound)),
        (*head, "worst", *(figure(wound, key, worst) for key, (_, worst) in FIGURES.items()), None, None, None),
    ]


def build(scale: Scale, results: Results) -> Table:
    """Return the table."""
    rows: list[tuple[Cell, ...]] = []
    every: list[dict[str, Any]] = []
    for direction, weights, method in cases(scale):
        wound = found(scale, results, (direction,), weights, method)
        rows += two_rows((direction, WEIGHT_NAMES[weights], METHOD_NAMES[method]), wound)
        every += wound
    return Table(COLUMNS, tuple(rows), _notes(scale, results, every))


def figure(windings: list[dict[str, Any]], key: str, statistic: Callable[[list[float]], float]) -> float:
    """Return a statistic of one of `FIGURES` over windings, in the table's unit."""
    return statistic([FIGURES[key][0] * float(figures[key]) for figures in windings])


def _notes(scale: Scale, results: Results, every: list[dict[str, Any]]) -> str:
    """Return how windings ended that did not end wound, and what the weights do to the tail."""
    others = Counter(figures["outcome"] for figures in every if figures["outcome"] != Outcome.WOUND.name)
    ends = ", ".join(f"{count} {Outcome[name].value!r}" for name, count in sorted(others.items()))
    sentences = [
        f"Of {len(every)} windings, {sum(others.values())} did not end with every link in contact{': ' * bool(ends)}{ends}."
    ]
    for method in METHODS:
        steps, paths = [], []
        for weights in KINDS:
            wound = found(scale, results, directions(scale), weights, method)
            steps.append(f"{1e3 * median([figures['free_step'] for figures in wound]):.2f}")
            paths.append(f"{median([figures['tail_path'] for figures in wound]):.2f}")
        names = ", ".join(WEIGHT_NAMES[weights] for weights in KINDS)
        sentences.append(
            f"What the weights do to the links not yet wound, medians by the {METHOD_NAMES[method]} for {names}: one of "
            f"their ends moves by {' / '.join(steps)} mm a step; the path of the arm's end until equilibrium is "
            f"{' / '.join(paths)} m long."
        )
    return "\n\n".join(sentences)


ARTEFACT = Artefact("table-8", "Table 8: winding outcomes over random initial poses", CAPTION, jobs, build)
