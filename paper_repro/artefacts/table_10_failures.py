"""Table 10: what goes wrong, how badly, and what the library does about it."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.jobs import Job, Results
from paper_repro.make.table import Column, Table
from paper_repro.measure.disturbed import DeadSensor, LooseContacts, NoisyDistance, wind_with
from paper_repro.measure.singularities import (
    DISTANCES,
    INNER,
    RANK,
    REQUEST,
    TOLERANCES,
    approach_job,
    plain_solve_job,
    row_norms_job,
)
from paper_repro.measure.windings import (
    LONG,
    METHOD_NAMES,
    METHODS,
    counted,
    figures_of,
    is_turned,
    measured_job,
    settings,
)
from prioritized_ik.winding.episode import Outcome
from prioritized_ik.winding.settings import WindingSettings

STEPS, STEPS_QUICK = 600, 150  # of a faulty winding at most: twice as many as the right one takes, in the full run
DT = (1e-3, 2e-3, 4e-3, 8e-3, 16e-3)  # [s]
LOCKED: dict[str, Any] = {
    "weights": "strict",
    "link": 14,
    "max_steps": 120,
}  # wound upwards from straight: the last hinge's plane is the arm's

#: Kinds of singular poses, see `singularities.KINDS`.
PLACES = {
    "base ball": "gimbal lock of the base ball",
    "inner ball": f"gimbal lock of the ball of link {INNER}",
    "collinear tip": "links 16 and 17 collinear",
    "straight arm": "a straight arm",
}

COLUMNS = (
    Column("failure", "failure", width="2.4cm"),
    Column("setting", "setting", width="3.2cm"),
    Column("what_happens", "what happens", width="5cm"),
    Column("with_the_library", "with the library", width="4.2cm"),
    Column("how", "what the library does", width="4.2cm"),
)

CAPTION = f"""\
Each failure is provoked and measured, and so is the library's own way in its place. Windings start straight with Eq.
23; by symmetry those from below and behind mirror those from above and in front, so that the latter two are all there
is. *In contact* and *by turns and depth* count those that are wound in these terms (as in Table 8), *turns* are the
least of the row and everything else the worst. From first link {LONG} on, 1.26 of a turn is more than the closed form
winds even without a fault: see the closed-form map. Steps near singular poses ask 1 mm (length of the stacked
displacement) in the direction of the end-point space that is being lost.

The fault of a controller is put in from outside: the library has no switch for it. This does *not* show faults together,
nor how likely any of them is on a real arm.
"""


def faulty_job(fault: str, chosen: WindingSettings) -> Job:
    """Return the job of a winding with one of `disturbed.FAULTS`: see `measured`."""
    return Job(faulty, {"fault": fault, "settings": chosen.to_json()})


def faulty(fault: str, settings: str) -> dict[str, Any]:
    """Return what `measured` returns, of a winding whose controller has a fault."""
    return figures_of(wind_with(fault, WindingSettings.from_json(settings)))


@dataclass(frozen=True)
class Windings:
    """The windings of one method from the two sides: with a fault, or with other settings.

    Attributes:
        method: of `METHODS`.
        fault: of `disturbed.FAULTS`, or none.
        changes: to the settings.
    """

    method: str
    fault: str = ""
    changes: tuple[tuple[str, float], ...] = ()

    def jobs(self, scale: Scale) -> list[Job]:
        """Return one job a side."""
        sides = ("up",) if scale.quick else ("up", "front")
        changes: dict[str, Any] = dict(self.changes)
        if self.fault:
            changes["max_steps"] = _steps(scale)
        chosen = [settings(self.method, direction=side, **changes) for side in sides]
        return [faulty_job(self.fault, one) if self.fault else measured_job(one) for one in chosen]


def disturbed(fault: str, **changes: float) -> list[Windings]:
    """Return the faulty windings of both methods."""
    return [Windings(method, fault, tuple(changes.items())) for method in METHODS]


RIGHT = [Windings(method) for method in METHODS]
NO_BAND = [Windings(method, changes=(("dead_band", 0.0),)) for method in METHODS]
NO_HYSTERESIS = [Windings("qp", changes=(("release_distance", 2e-3),))]
NOISY = {release: disturbed("noisy distance", release_distance=release)[1] for release in (2e-3, 4e-3)}
STEP_SIZES = {dt: [Windings(method, changes=(("dt", dt),) if dt != 2e-3 else ()) for method in METHODS] for dt in DT}
FAULTY = {name: disturbed(name) for name in ("reversed contact", "dead sensor", "loose contacts")}


def step_sizes(scale: Scale) -> tuple[float, ...]:
    """Return the time steps of the sweep [s]."""
    return DT[2:3] if scale.quick else DT


def jobs(scale: Scale) -> list[Job]:
    """Return what is to be measured."""
    groups = [RIGHT, NO_BAND, NO_HYSTERESIS, *FAULTY.values(), list(NOISY.values())]
    groups += [STEP_SIZES[dt] for dt in step_sizes(scale)]
    return [
        *(job for group in groups for windings in group for job in windings.jobs(scale)),
        *(measured_job(settings(**{**LOCKED, "weights": weights})) for weights in ("strict", "eq23")),
        *(approach_job(kind) for kind in PLACES),
        plain_solve_job(),
        *(row_norms_job(weights) for weights in ("eq23", "strict")),
    ]


def build(scale: Scale, results: Results) -> Table:
    """Return the table."""
    rows = [*_singular(results), *_solves(results), *_touch(scale, results), *_sweep(scale, results), *_strict(results)]
    return Table(COLUMNS, tuple(rows), f"Faulty windings are given up after {_steps(scale)} steps.")


def _steps(scale: Scale) -> int:
    return STEPS_QUICK if scale.quick else STEPS


Row = tuple[str, str, str, str, str]


def _singular(results: Results) -> Iterator[Row]:
    far = " / ".join(f"{distance:g}" for distance in DISTANCES)
    for kind, place in PLACES.items():
        found = results[approach_job(kind)]
        costs = [" / ".join(_radians(norms[i]) for norms in found["norms"]) for i in range(len(TOLERANCES))]
        shares = " / ".join(f"{share:.0e}" for share in found["share"])
        if found["rank"] == RANK:
            how = "nothing to do: the twists of the balls before make up for the hinge that is lost"
        else:
            how = "truncates below a rank tolerance that all solvers share; limits hold any step to 0.1 rad a hinge"
        yield (
            "near a singular pose",
            f"{far} rad from {place}",
            f"{1e3 * REQUEST:g} mm costs ‖dθ‖ = {costs[0]} rad (σ₃₄/σ₁ = {shares})",
            f"‖dθ‖ = {costs[1]} rad at tolerance {TOLERANCES[1]:g}, {costs[2]} rad at {TOLERANCES[2]:g}",
            how,
        )
    tip = results[approach_job("collinear tip")]
    yield (
        "collinear tip",
        "links 16 and 17 exactly collinear, as in the straight pose",
        f"p = {RANK} taken for granted: ‖dθ‖ over {_power(tip['forced'])} rad for {1e3 * REQUEST:g} mm",
        f"p = {tip['rank']}: ‖dθ‖ = 0, the direction is left out",
        "finds p from the singular values in every step",
    )


def _solves(results: Results) -> Iterator[Row]:
    plain = results[plain_solve_job()]
    yield (
        "Eq. 17 on the singular arm",
        "plain solve of JᵀWJ dθ = JᵀW dX* at three bent initial poses, and the straight one",
        f"‖dθ‖ over {_power(min(plain['plain']))} rad, no error"
        f"{', and the cost of Eq. 10 the same' if plain['same_cost'] else ''}; straight: {plain['straight']}",
        f"‖dθ‖ = {min(plain['ours']):.2f} to {max(plain['ours']):.2f} rad",
        "Eqs. 12 and 14 by SVD and QR; `overconstrained_solution` refuses J of another case than Fig. 3b",
    )
    weighted, strict = (results[row_norms_job(weights)] for weights in ("eq23", "strict"))
    yield (
        "row-normalised hierarchy",
        "DAQP's hierarchy on rows W^½J, Eq. 23, no limits",
        f"dθ off by {100 * weighted['raw']:.0f} %, cost of Eq. 10 {weighted['cost']:.0e} times the optimum: it is the "
        f"least squares with rows of unit length (to {weighted['normalised']:.0e}), weights lost",
        f"`daqp-hierarchy`: off by {weighted['adapter']:.0e}, before polishing",
        "poses each level in whitened coordinates, whose rows are unit vectors, so that normalising changes nothing",
    )
    yield (
        "row-normalised hierarchy",
        "the same on three strict levels, weights 1",
        f"dθ off by {100 * strict['raw']:.0f} %: rows of J differ in length along the arm",
        f"`daqp-hierarchy`: off by {strict['adapter']:.0e}, before polishing",
        "as above",
    )


def _touch(scale: Scale, results: Results) -> Iterator[Row]:
    right = _both(scale, results, RIGHT[1:])
    yield (
        "wrong sign of c",
        "c from the link into the object",
        _both(scale, results, FAULTY["reversed contact"]),
        right,
        "defines c as the normal from the object into the link, tested on the distance's gradient; counts turns, not M",
    )
    yield (
        "M with gaps",
        f"link {DeadSensor.LINK} never feels contact",
        _both(scale, results, FAULTY["dead sensor"], several=True),
        right,
        "reports steps that drive several arms; cannot wind past a dead link: state [1] is never reached",
    )
    yield (
        "M with gaps",
        f"each link loses {100 * LooseContacts.LOST:g} % of its contacts for a step",
        _both(scale, results, FAULTY["loose contacts"], several=True),
        right,
        "k is the last of the links in succession, so that links beyond a gap count as free until it closes",
    )
    with_noise, with_hysteresis = (_figures(scale, results, NOISY[release]) for release in (2e-3, 4e-3))
    exact, default = (_figures(scale, results, group[0]) for group in (NO_HYSTERESIS, RIGHT[1:]))
    yield (
        "no hysteresis",
        "QP, release at the contact distance, exact distances",
        f"{_lost(exact)}; {_ends(exact)}",
        f"{_lost(default)}; {_ends(default)}",
        "releases at twice the contact distance; exact distances do not need it",
    )
    yield (
        "no hysteresis",
        f"the same, distances with {1e3 * NoisyDistance.DEVIATION:g} mm of noise",
        f"{_lost(with_noise)}; {_several(with_noise)}; {_ends(with_noise)}",
        f"{_lost(with_hysteresis)}; {_several(with_hysteresis)}; {_ends(with_hysteresis)}",
        "releases at twice the contact distance",
    )
    yield (
        "no dead band",
        "Eq. 21 as printed",
        _both(scale, results, NO_BAND, flips=True),
        _both(scale, results, RIGHT[1:], flips=True),
        "s = 0 within 0.05 of the plane (3°): β has a fixed size and overshoots it otherwise",
    )


def _sweep(scale: Scale, results: Results) -> Iterator[Row]:
    right = _both(scale, results, RIGHT[1:], drift=True)
    for dt in step_sizes(scale):
        size = 1e3 * WindingSettings().speed * dt
        yield (
            "η·dt too large" if dt > DT[1] else "η·dt",
            f"{size:g} mm a step",
            _both(scale, results, STEP_SIZES[dt], drift=True),
            right,
            "reads η as a speed and dt apart; rows are linear in the step and the arm is not: keep η·dt near 4 mm",
        )


def _strict(results: Results) -> Iterator[Row]:
    strict, weighted = (results[measured_job(settings(**{**LOCKED, "weights": kind}))] for kind in ("strict", "eq23"))
    yield (
        "strict priorities lock up",
        "QP, from straight, first link 14: the last hinge's axis lies in the plane of the winding",
        f"{_end(strict)} after {strict['steps']} steps, {100 * strict['turns_ratio']:.0f} % of the ideal turns",
        f"Eq. 23: {_end(weighted)} after {weighted['steps']} steps, {100 * weighted['turns_ratio']:.0f} %",
        "says so in its README; weights let the wound arms give way a little, a tilt or a bent arm helps strict levels",
    )


def _figures(scale: Scale, results: Results, windings: Windings) -> list[dict[str, Any]]:
    return [results[job] for job in windings.jobs(scale)]


def _both(
    scale: Scale,
    results: Results,
    group: list[Windings],
    *,
    several: bool = False,
    flips: bool = False,
    drift: bool = False,
) -> str:
    """Return how the windings of both methods went."""
    texts = []
    for windings in group:
        figures = _figures(scale, results, windings)
        parts = [
            _ends(figures),
            f"turns {min(f['turns_ratio'] for f in figures):.2f}",
            f"penetration {1e3 * max(f['penetration'] for f in figures):.1f} mm",
            f"bend {max(f['bend'] for f in figures):.1f} rad",
        ]
        parts += [f"drift {1e3 * max(f['drift'] for f in figures):.0f} mm"] if drift else []
        parts += [_several(figures)] if several else []
        parts += (
            [f"{max(f['flips'] for f in figures)} β flips in {max(f['steps'] for f in figures)} steps"] if flips else []
        )
        texts.append(f"{METHOD_NAMES[windings.method]}: {', '.join(parts)}")
    return "; ".join(texts)


def _ends(figures: list[dict[str, Any]]) -> str:
    """Return how many windings ended how."""
    contact, turned, _ = counted(figures)
    failed = sum(f["outcome"] == Outcome.SOLVER_FAILED.name for f in figures)
    text = f"{contact} of {len(figures)} in contact, {turned} by turns and depth"
    return text + (f", {failed} stopped by a step that failed" if failed else "")


def _end(figures: dict[str, Any]) -> str:
    contact = figures["outcome"] == Outcome.WOUND.name
    return "wound by turns and depth" if is_turned(figures) else "all links in contact" if contact else "not wound"


def _several(figures: list[dict[str, Any]]) -> str:
    return f"several arms driven in up to {max(f['driven_together'] for f in figures)} steps"


def _lost(figures: list[dict[str, Any]]) -> str:
    return f"up to {max(f['contacts_lost'] for f in figures)} contacts lost"


def _radians(norm: float) -> str:
    """Return ‖dθ‖ with two digits, 0 for rounding."""
    return f"{norm:.2g}" if norm > 1e-12 else "0"


def _power(value: float) -> str:
    """Return the power of ten below a value: all that rounding leaves of it."""
    return f"{10.0 ** math.floor(math.log10(value)):.0e}"


ARTEFACT = Artefact("table-10", "Table 10: failure gallery", CAPTION, jobs, build)
