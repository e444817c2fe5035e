"""Where the closed form winds, by first link, weights, direction, tilt, pose and rank tolerance, and why not elsewhere."""

import itertools
from collections import Counter
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.jobs import Job, Results
from paper_repro.make.table import NOTHING, Cell, Column, Table
from paper_repro.measure.failing import Reason, examined_job
from paper_repro.measure.windings import CRITERION, TERM_TITLES, counted, settings
from prioritized_ik.models import DIRECTIONS, Arm
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.winding.metrics import ideal_angle
from prioritized_ik.winding.settings import WindingSettings

FIRST_LINKS = (6, 8, 9, 10, 11, 12, 13, 14, 15)
WEIGHTS = {"eq23": "Eq. 23", "eq24": "Eq. 24"}
TILTS = (0.0, 0.3)  # [rad]
TOLERANCES = (RANK_TOLERANCE, 1e-3)  # of the rank: the default, and one that cuts off more
POSES: dict[str, dict[str, Any]] = {
    "straight": {},
    "arched": {"posture": "arched"},
    **{f"random {seed}": {"posture": "random", "seed": seed} for seed in range(3)},
}


class Case(NamedTuple):
    """One winding of the map; `tilt` is in rad."""

    tolerance: float
    weights: str
    tilt: float
    pose: str
    direction: str
    link: int

    @property
    def kind(self) -> tuple[float, str, float, str]:
        """Everything but first link, direction and the seed of a random pose."""
        return self.tolerance, self.weights, self.tilt, self.pose.partition(" ")[0]


REASONS = "; ".join(f"{reason.name}, {reason.value}" for reason in Reason)

CAPTION = f"""\
The closed form, Eqs. 12 to 14 alone, with nothing that keeps links out of the object: with both weights, from every
direction, with the object's axis square to the arm and tilted, from the straight pose, the arched one and random ones
(every joint within a few hundredths of a radian of straight), and at two rank tolerances of Eq. 6. Each column of a
first link counts windings by turns and depth; in brackets, the turns that a polygon of tangent links from
there on makes. Turns, depth and fold of every winding stand in its own table, at the end.

{CRITERION}.

**Why not**, what went wrong first, with how often: {REASONS}.

**To see.** From the straight pose and around an untilted object the closed form winds as the paper says, from all four
directions: from first links 11 to 15 with Eq. 23 and 10 to 15 with Eq. 24, at either rank tolerance. Around tilted
objects and from bent poses it hangs on the rank tolerance, which the paper does not state: such arms are nearly but not
exactly in line, and singular values just above 1e-4 of the largest turn millimetres into joint steps of up to radians,
of which one is enough to push wound links in (P) or lose them (L). Cut at 1e-3 the same windings mostly succeed, the
tilted ones from all four directions too.

What no rank tolerance mends is a long winding: from first link 6 on none succeeded. Eqs. 12 to 14 ask the free tail to
stay where it is while its beginning is led round the object, so that links fold by up to 3 rad on the way; with a full
turn or more to wind the object comes round to where the tail is kept, whose links are then in it (T) or touch while
they are still folded back (F). With 0.8 to 1 of a turn it depends on the pose. Only windings of two or three links keep
within a right angle.

It does *not* show where the paper's own windings stand on this map: its initial pose, first link, tilt, rank tolerance,
link radius and thresholds are not stated, and on much of the map its Figs. 6 and 7 are what happens.
"""


def cases(scale: Scale) -> list[Case]:
    """Return all cases; of the reduced run three first links from one direction, straight, with Eq. 23."""
    if scale.quick:
        return [Case(RANK_TOLERANCE, "eq23", 0.0, "straight", "up", link) for link in (6, 12, 15)]
    return [Case(*each) for each in itertools.product(TOLERANCES, WEIGHTS, TILTS, POSES, DIRECTIONS, FIRST_LINKS)]


@cache
def winding(case: Case) -> WindingSettings:
    """Return the settings of a case."""
    return settings(
        "closed form",
        link=case.link,
        weights=case.weights,
        direction=case.direction,
        tilt=case.tilt,
        options=SolveOptions(rank_tolerance=case.tolerance),
        **POSES[case.pose],
    )


def jobs(scale: Scale) -> list[Job]:
    """Return one job a winding."""
    return [examined_job(winding(case)) for case in cases(scale)]


def found(scale: Scale, results: Results) -> dict[Case, dict[str, Any]]:
    """Return the figures of every case."""
    return {case: results[examined_job(winding(case))] for case in cases(scale)}


def ideal_turns(link: int, tilt: float = 0.0) -> float:
    """Return the turns of a polygon of tangent links from `link` on."""
    arm, radius = Arm(), WindingSettings().size[0]
    return (arm.links - link) * ideal_angle(arm.link_length, radius + arm.radius, tilt) / (2.0 * np.pi)


def build(scale: Scale, results: Results) -> Table:
    """Return the table: a row a rank tolerance, weights, tilt and kind of pose; a column a first link."""
    every = found(scale, results)
    links = sorted({case.link for case in every})
    columns = (
        Column("rank_tolerance", "rank tolerance", ".0e"),
        Column("weights", "weights"),
        Column("tilt_rad", "tilt [rad]", ".1f"),
        Column("pose", "initial pose"),
        Column("windings_a_first_link", "windings a first link"),
        *(Column(f"first_link_{link}", f"{link} ({ideal_turns(link):.2f})") for link in links),
        *(Column(key, title) for key, title in zip(("in_contact", "turned", "within_range"), TERM_TITLES, strict=True)),
        Column("reasons", "why not by turns and depth", width="3cm"),
    )
    rows: list[tuple[Cell, ...]] = []
    for kind in dict.fromkeys(case.kind for case in every):
        windings = {link: [f for case, f in every.items() if (case.kind, case.link) == (kind, link)] for link in links}
        together = list(itertools.chain(*windings.values()))
        turned = [counted(figures)[1] for figures in windings.values()]
        tolerance, weights, tilt, pose = kind
        head = (tolerance, WEIGHTS[weights], tilt, pose, len(windings[links[0]]))
        rows.append((*head, *turned, *counted(together), reasons(together)))
    return Table(columns, tuple(rows), _notes(every))


def _notes(every: dict[Case, dict[str, Any]]) -> str:
    sentences = []
    for tolerance in dict.fromkeys(case.tolerance for case in every):
        windings = [figures for case, figures in every.items() if case.tolerance == tolerance]
        contact, turned, within = counted(windings)
        sentences.append(
            f"Of {len(windings)} windings at the rank tolerance {tolerance:.0e} all links are in contact in {contact}, "
            f"{turned} are wound by turns and depth, {within} within a joint's range; why not by turns and depth: "
            f"{reasons(windings)}."
        )
    return " ".join(sentences)


def reasons(windings: list[dict[str, Any]]) -> str:
    """Return the letters of the reasons, with how often, in the order of `Reason`."""
    counts = Counter(figures["reason"] for figures in windings)
    return ", ".join(f"{reason.name} {counts[reason.name]}" for reason in Reason if counts[reason.name]) or NOTHING


ARTEFACT = Artefact("closed-form-map", "Where the closed form winds, and why not elsewhere", CAPTION, jobs, build)
