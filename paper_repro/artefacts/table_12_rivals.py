"""Table 12: the methods that the paper names, on the same arms and objects."""

from dataclasses import dataclass
from statistics import median
from typing import Any

import mujoco
import numpy as np

from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.jobs import Job, Results
from paper_repro.make.table import Cell, Column, Table
from paper_repro.measure.lateral_inhibition import LateralInhibition
from paper_repro.measure.windings import CRITERION, DRIVER, TERM_TITLES, counted, figures_of
from prioritized_ik.models import Arm, update_kinematics
from prioritized_ik.validation import Array
from prioritized_ik.winding.episode import Episode, Outcome, wind
from prioritized_ik.winding.settings import WindingSettings

SIDES = ("front", "back")  # along y, where all arms have hinges that bend them in one plane


@dataclass(frozen=True)
class BallArm(Arm):
    """An arm with a ball joint at the base of every link: 8 links have 24 joints, as ACM 7 has."""

    def hinge_axes(self, link: int) -> str:
        """See `Arm.hinge_axes`."""
        del link
        return self.hinge_order


#: Arm and first link in contact.
ARMS: dict[str, tuple[Arm, int]] = {
    "17 links, 49 joints": (Arm(), 12),
    "17 links, 49 joints, longer": (Arm(), 6),
    "8 links, 24 joints": (BallArm(links=8), 3),
}
OBJECTS: dict[str, dict[str, Any]] = {
    "cylinder": {},
    "cylinder, tilted 0.3 rad": {"tilt": 0.3},
    "ellipsoid": {"shape": "ellipsoid", "size": (0.06, 0.09, 0.2)},
}
METHODS: dict[str, dict[str, Any]] = {
    "virtual arms, Eq. 23, closed form": {},
    "virtual arms, Eq. 23, QP": {"limits": True, "contacts": True},
    "strict equality priorities": {"weights": "strict"},
    "lateral inhibition": {},
}
PLANAR = "lateral inhibition"

COLUMNS = (
    Column("arm", "arm", width="2.6cm"),
    Column("first_link", "first link"),
    Column("object", "object", width="2.6cm"),
    Column("method", "method", width="3.4cm"),
    Column("windings", "windings"),
    Column("in_contact", TERM_TITLES[0]),
    Column("turned", TERM_TITLES[1]),
    Column("within_range", TERM_TITLES[2]),
    Column("turns", "turns, median", ".2f"),
    Column("penetration_mm", "penetration, worst [mm]", ".1f"),
    Column("fold_rad", "fold, worst [rad]", ".2f"),
    Column("clearance_mm", "clearance between links at the end, least [mm]", ".1f"),
    Column("steps", "steps, median", ".0f"),
)

CAPTION = f"""\
Every method of winding that the paper names, from the straight pose, with the object from the front and from the back.
*Virtual arms*: the paper's, by Eqs. 12 to 14 alone and by the QP with joint ranges and contact rows. *Strict equality
priorities*: what H. Hanafusa, T. Yoshikawa and Y. Nakamura (ref. 7) proposed for subtasks in a given order, each met as
well as the ones before allow: wound arms before the driven one before the rest, in place of the weights of Eq. 23; the
closed form of `weights="strict"`. *Lateral inhibition*: joints that act on touch alone, in the manner of S. Hirose and
Y. Umetani (ref. 9) as M. Wada and Y. Kuba used it (ref. 11), after the paper's description of it; the choices made
stand in `paper_repro/lateral_inhibition.py`. The arm of 8 links and 24 joints has the numbers of ACM 7 (ref. 10), every
link on a ball joint, and this project's links of 0.06 m; neither is stated.

{CRITERION}. An ellipsoid has no ideal turns, and therefore only the first term. *Clearance* is between the surfaces of
links that are not neighbours; negative: the arm lies in itself, which no method here knows of.

**To see:** lateral inhibition winds, and without folding, since it lets the free tail swing instead of asking it to
stay. But its winding is planar, as the paper says: beyond a full turn the arm runs into itself, around a tilted
cylinder as around a straight one, where virtual arms lay turns beside each other around a tilted one. It does *not*
show arms that start bent, nor what a swinging tail would hit.
"""


def cases(scale: Scale) -> list[tuple[str, str, str]]:
    """Return arm, object and method; of the reduced run the short arm and the cylinder."""
    arms, objects = (list(ARMS)[-1:], list(OBJECTS)[:1]) if scale.quick else (list(ARMS), list(OBJECTS))
    return [(arm, wound, method) for arm in arms for wound in objects for method in METHODS]


def sides(scale: Scale) -> tuple[str, ...]:
    """Return where the object comes from; one direction in the reduced run."""
    return SIDES[:1] if scale.quick else SIDES


def rival_job(arm: str, wound: str, method: str, side: str) -> Job:
    """Return the job of one winding: see `rival`."""
    return Job(rival, {"arm": arm, "wound": wound, "method": method, "side": side})


def rival(arm: str, wound: str, method: str, side: str) -> dict[str, Any]:
    """Return what `measured` returns, and the `clearance` between links at the end [m]."""
    episode = episode_of(arm, wound, method, side)
    return {**figures_of(episode), "clearance": clearance(episode.settings, episode.q[-1])}


def episode_of(arm: str, wound: str, method: str, side: str) -> Episode:
    """Return the winding of an arm of `ARMS`, an object of `OBJECTS` and a method of `METHODS`."""
    model, link = ARMS[arm]
    free = {"solver": DRIVER, "limits": False, "contacts": False}
    chosen = WindingSettings(**{**free, **OBJECTS[wound], **METHODS[method]}, arm=model, link=link, direction=side)
    return wind(chosen, LateralInhibition(chosen) if method == PLANAR else None)


def clearance(settings: WindingSettings, q: Array) -> float:
    """Return the least distance between the surfaces of links that are not neighbours, at `q` `(m,)` [m]."""
    model = settings.model()
    data = mujoco.MjData(model)
    update_kinematics(model, data, q)
    geoms = [model.geom(name).id for name in settings.arm.link_geoms]
    return min(
        mujoco.mj_geomDistance(model, data, geoms[i], geoms[j], 1.0, None)
        for i in range(len(geoms))
        for j in range(i + 2, len(geoms))
    )


def jobs(scale: Scale) -> list[Job]:
    """Return one job a winding."""
    return [rival_job(*case, side) for case in cases(scale) for side in sides(scale)]


def build(scale: Scale, results: Results) -> Table:
    """Return the table."""
    rows = []
    for arm, wound, method in cases(scale):
        windings = [results[rival_job(arm, wound, method, side)] for side in sides(scale)]
        name = arm.removesuffix(", longer")
        rows.append((name, ARMS[arm][1], wound, method, len(windings), *_cells(windings)))
    return Table(COLUMNS, tuple(rows))


def _cells(windings: list[dict[str, Any]]) -> tuple[Cell, ...]:
    known = all(figures["turns_ratio"] is not None for figures in windings)
    contact = sum(figures["outcome"] == Outcome.WOUND.name for figures in windings)
    return (
        *(counted(windings) if known else (contact, None, None)),
        median([figures["turns"] for figures in windings]),
        1e3 * max(figures["penetration"] for figures in windings),
        max(figures["bend"] for figures in windings),
        1e3 * min(figures["clearance"] for figures in windings),
        float(np.median([figures["steps"] for figures in windings])),
    )


ARTEFACT = Artefact("table-12", "Table 12: the methods that the paper names", CAPTION, jobs, build)
