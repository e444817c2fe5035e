"""What the rank tolerance decides along the windings: rank, length of the step, error of dX, and the solvers' agreement."""

from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.figure import COLOURS, DASHES, MARKERS, new_figure
from paper_repro.make.jobs import Job, Results
from paper_repro.measure.replays import recorded, relative, sampled, windings
from prioritized_ik.models import update_kinematics
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.hierarchy import strict_solution
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.solvers.step import StepStatus
from prioritized_ik.validation import Array
from prioritized_ik.virtual_arms import VirtualArms

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TOLERANCES = tuple(float(f"{10.0**power:.2e}") for power in np.arange(-12.0, -0.9, 0.5))
DECADES = TOLERANCES[::2]

#: Of three kinds: active set, augmented Lagrangian, dual active set.
SOLVERS = ("daqp", "proxqp", "quadprog")

FLOOR = 1e-9  # below which an error of dX is not drawn

SHARE = 4  # of the sampled steps every fourth is solved by QPs


def scaling_job(scale: Scale, winding: str) -> Job:
    """Return the job of the closed form along one winding: see `scaling`."""
    return Job(scaling, {"winding": winding, "steps": scale.steps})


def scaling(winding: str, steps: int) -> dict[str, list[list[float]]]:
    """Return by tolerance and step: `rank`; `norm` of dθ [rad]; and relative to ‖dX*‖ `truncation` and `curvature`.

    Truncation: how far J dθ is from that at the smallest tolerance. Curvature: how far the end points really go from J dθ.
    """
    settings = recorded(winding).settings
    model = settings.model()
    data, arms = mujoco.MjData(model), VirtualArms(model, settings.arm.end_sites)

    def positions(q: Array) -> Array:
        update_kinematics(model, data, q)
        return np.array(arms.positions(data)).ravel()

    found: dict[str, list[list[float]]] = {"rank": [], "norm": [], "truncation": [], "curvature": []}
    for tolerance in TOLERANCES:
        row: dict[str, list[float]] = {name: [] for name in found}
        for posed in sampled(winding, steps):
            (level,), q = posed.item.problem.levels, posed.item.q
            singular = np.linalg.svd(level.matrix, compute_uv=False)
            least, dtheta = (strict_solution([level], np.zeros(len(q)), t) for t in (TOLERANCES[0], tolerance))
            moved = positions(q + dtheta) - positions(q)
            demand = np.linalg.norm(level.target)
            row["rank"].append(int(np.count_nonzero(singular > tolerance * singular[0])))
            row["norm"].append(float(np.linalg.norm(dtheta)))
            row["truncation"].append(float(np.linalg.norm(level.matrix @ (dtheta - least)) / demand))
            row["curvature"].append(float(np.linalg.norm(moved - level.matrix @ dtheta) / demand))
        for name, values in row.items():
            found[name].append(values)
    return found


def disagreement_job(scale: Scale, winding: str) -> Job:
    """Return the job of the solvers along one winding: see `disagreement`."""
    return Job(disagreement, {"winding": winding, "steps": scale.steps})


def disagreement(winding: str, steps: int) -> dict[str, list[list[Any]]]:
    """Return by tolerance and step: `apart`, the solvers' largest distance, relative, None if one fails; and `certified`.

    The distance is of their own answers, with all rows, before the polish; certified are how many of them after it.
    """
    found: dict[str, list[list[Any]]] = {"apart": [], "certified": []}
    for tolerance in DECADES:
        options = SolveOptions(rank_tolerance=tolerance, closed_form_first=False)
        methods = [get_method(name) for name in SOLVERS]
        apart: list[float | None] = []
        certified = []
        for posed in sampled(winding, steps)[::SHARE]:
            answers = [method.step(posed.item.problem, options) for method in methods]
            raw = [answer.raw for answer in answers if answer.raw is not None and answer.found]
            apart.append(max(relative(own, np.median(raw, axis=0)) for own in raw) if len(raw) == len(SOLVERS) else None)
            certified.append(sum(answer.status is StepStatus.SOLVED for answer in answers))
        found["apart"].append(apart)
        found["certified"].append(certified)
    return found


def jobs(scale: Scale) -> list[Job]:
    """Return two jobs a winding."""
    return [job(scale, winding) for winding in windings(scale) for job in (scaling_job, disagreement_job)]


def build(scale: Scale, results: Results) -> "Figure":
    """Return four panels over the rank tolerance."""
    scales = [results[scaling_job(scale, winding)] for winding in windings(scale)]
    found = {name: np.hstack([np.array(one[name]) for one in scales]) for name in scales[0]}
    figure, axes = new_figure(2, 2, height=4.6, sharex=True)
    _ranks(axes[0, 0], found["rank"])
    _band(axes[0, 1], found["norm"], "blue", "‖dθ‖")
    axes[0, 1].set(yscale="log", ylabel="‖dθ‖ of Eqs. 12–14 [rad]", title="(b) Length of the step")
    _band(axes[1, 0], found["curvature"], "vermilion", "linearisation")
    _band(axes[1, 0], found["truncation"], "green", "truncation", 1)
    axes[1, 0].set(yscale="log", ylim=(FLOOR, None), ylabel="error of dX over ‖dX*‖ [–]", title="(c) Error of dX")
    _agreement(axes[1, 1], [results[disagreement_job(scale, winding)] for winding in windings(scale)])
    for axis in axes.flat:
        axis.set(xscale="log")
        axis.axvline(RANK_TOLERANCE, color=COLOURS["grey"], linewidth=1.0, linestyle=":")
        axis.set_xticks([1e-12, 1e-10, 1e-8, 1e-6, 1e-4, 1e-2])
    for axis in axes[1]:
        axis.set_xlabel("rank tolerance, relative to σ₁ of J [–]")
    return figure


def _ranks(axis: Any, ranks: Array) -> None:
    """Draw the share of steps of each rank."""
    shares = {
        "34": (ranks == 34).mean(axis=1),
        "33": (ranks == 33).mean(axis=1),
        "32 and less": (ranks <= 32).mean(axis=1),
    }
    for place, ((name, share), hue) in enumerate(zip(shares.items(), ("blue", "orange", "green"), strict=True)):
        look = {"color": COLOURS[hue], "marker": MARKERS[place], "linestyle": DASHES[place]}
        axis.plot(TOLERANCES, 100.0 * share, label=name, **look)
    axis.set(ylabel="steps of this rank [%]", title="(a) Rank of J", ylim=(-3, 103))
    axis.legend(title="rank", loc="best", title_fontsize=7.0)


def _band(axis: Any, values: Array, hue: str, name: str, place: int = 0) -> None:
    """Draw median and maximum over the steps, and what lies between."""
    shown = np.maximum(values, 1e-17)  # of which rounding may leave nothing
    middle, top = np.median(shown, axis=1), shown.max(axis=1)
    look = {"color": COLOURS[hue], "marker": MARKERS[place]}
    axis.plot(TOLERANCES, middle, linestyle=DASHES[0], label=f"{name}: median", **look)
    axis.plot(TOLERANCES, top, linestyle=DASHES[1], markersize=2.0, linewidth=0.8, label=f"{name}: max", **look)
    axis.fill_between(TOLERANCES, middle, top, color=COLOURS[hue], alpha=0.12, linewidth=0.0)
    axis.legend(loc="best", fontsize=6.5)


def _agreement(axis: Any, found: list[dict[str, list[list[Any]]]]) -> None:
    """Draw how far the solvers are apart, and write above how many answers are certified."""
    apart = [[d for one in found for d in one["apart"][place] if d is not None] for place in range(len(DECADES))]
    known = [(tolerance, values) for tolerance, values in zip(DECADES, apart, strict=True) if values]
    tolerances = [tolerance for tolerance, _ in known]
    look = {"color": COLOURS["purple"]}
    axis.plot(tolerances, [np.median(v) for _, v in known], marker="o", linestyle="-", label="median", **look)
    axis.plot(tolerances, [max(v) for _, v in known], marker="s", linestyle="--", label="max", **look)
    axis.set(yscale="log", ylim=(1e-17, 1e4), ylabel="distance of dθ, relative [–]", title="(d) Solvers apart, unpolished")
    for place, tolerance in enumerate(DECADES):
        counts = [one["certified"][place] for one in found]
        certified = sum(map(sum, counts)) / (len(SOLVERS) * sum(map(len, counts)))
        axis.annotate(f"{100.0 * certified:.0f}", (tolerance, 2.0), ha="center", va="bottom", fontsize=6.5)
    axis.annotate("certified after the polish [%]:", (DECADES[0], 60.0), ha="left", va="bottom", fontsize=6.5)
    axis.legend(loc="upper left", bbox_to_anchor=(0.0, 0.8))


CAPTION = f"""\
What the rank tolerance decides along the recorded windings, where σ₃₄ of J goes through every size down to zero.
Singular values of J below the tolerance times σ₁ count as zero. (a) Rank, by share of the steps. (b) Length of the
closed form's dθ, without limits. (c) Error of dX over ‖dX\\*‖: *truncation*, how far J dθ is from that of the smallest
tolerance; *linearisation*, how far X(θ + dθ) − X(θ) is from J dθ when the arm takes the step. (d) Largest distance of
the answers of {", ".join(SOLVERS)} from their median, in the lexicographic QP with limits and contact rows, before the
polish, where all three give one. Solid lines: median over the steps; dashed: maximum; dotted: the tolerance used
everywhere else, {RANK_TOLERANCE:g}.

**To see:** a small tolerance keeps directions along which millimetres cost radians: the longest steps grow past all
sense, and for them the linearisation fails by far more than truncation would take away. A large tolerance gives up
motion that the task needs. Between the two lie some decades in which hardly anything changes. The tolerance is a choice
of this project, which the paper does not state; it has to be the same for all that are compared.

It does *not* show poses other than those of these windings."""

ARTEFACT = Artefact("figure-rank-tolerance", "What the rank tolerance decides", CAPTION, jobs, build)
