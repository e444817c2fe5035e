"""Table 2: the rank of the arm's stacked Jacobian, by place and axis of its one hinge, the balls' hinge order, and pose."""

import itertools
import warnings
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.jobs import Job, Results
from paper_repro.make.table import Column, Table
from paper_repro.measure.checks import directions
from paper_repro.measure.posed import PosedArm
from paper_repro.measure.windings import settings, story_job
from prioritized_ik.models import AXES, Arm
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE, task_case
from prioritized_ik.validation import Array

ORDERS = tuple("".join(order) for order in itertools.permutations("xyz"))
TWIST_TWICE = "xzx"  # not three axes but two: what an arm with proper Euler angles would have
PLACES = {"last link": 17, "first link": 1}
BEND = 0.25  # [rad] standard deviation of the random pose's bends about y and z
SEED = 2
LAST = 16  # place of link 17
ARMATURE = 1.0  # [kg m²] any; nothing here moves by forces
ROUNDING = 1e-14  # of the largest: what rounding leaves of a zero, and no two machines alike
EXACT = 1e-10  # of the largest: below are zeros, each a rounding error or a few
WOUND_FROM = {"wound from above": "up", "wound from the front": "front"}

COLUMNS = (
    Column("place", "one hinge in the"),
    Column("axis", "about its"),
    Column("pose", "pose"),
    Column("orders", "hinge orders of the balls"),
    Column("rank_exact", "rank, exact"),
    Column("rank", f"rank p at tolerance {RANK_TOLERANCE:g}"),
    Column("sigma_p", "σ_p/σ_1, least", ".0e"),
    Column("sigma_p_most", "σ_p/σ_1, most", ".0e"),
    Column("sigma_next", "σ_{p+1}/σ_1, most", ".0e"),
    Column("null", "m − p"),
    Column("case", "case of Fig. 3"),
)


def jobs(scale: Scale) -> list[Job]:
    """Return the windings whose last poses are in the map."""
    return [_winding(direction) for direction in _directions(scale).values()]


def build(scale: Scale, results: Results) -> Table:
    """Return the map."""
    wound = {pose: np.array(results[_winding(d)]["q"][-1]) for pose, d in _directions(scale).items()}
    shapes = poses(wound)
    rows = [row for place, axis in itertools.product(PLACES, AXES) for row in _rows(place, axis, ORDERS, shapes)]
    rows += _rows("last link", "z", (TWIST_TWICE,), shapes)
    return Table(COLUMNS, tuple(rows))


def _directions(scale: Scale) -> dict[str, str]:
    chosen = directions(scale)
    return {pose: direction for pose, direction in WOUND_FROM.items() if direction in chosen}


def _winding(direction: str) -> Job:
    return story_job(settings(direction=direction))


def poses(wound: dict[str, Array]) -> dict[str, Array]:
    """Return the poses as rotations of each link against the one before `(17, 3, 3)`, whatever the joints that make them.

    Args:
        wound: joint positions of the default arm, wound, by pose `(49,)` [rad].
    """
    arm = Arm()
    drawn = np.random.default_rng(SEED).normal(scale=BEND, size=arm.joint_count)
    joints = {"straight": arm.posture("straight"), "arched": arm.posture("arched"), "random": drawn}
    shapes = {name: relative_rotations(q) for name, q in (joints | wound).items()}
    for shape in shapes.values():
        shape[LAST] = shape[LAST - 1]  # the default arm's last hinge bends one way only: what a ball would do there
    in_line = shapes["random"].copy()
    in_line[LAST] = np.eye(3)
    return shapes | {"random, links 16 and 17 in line": in_line}


def relative_rotations(q: Array) -> Array:
    """Return the rotation of each link of the default arm at `q` against the one before `(17, 3, 3)`."""
    frames = PosedArm.of(Arm(), q).data.xmat[1:].reshape(-1, 3, 3)
    before = np.concatenate([np.eye(3)[None], frames[:-1]])
    return np.einsum("nji,njk->nik", before, frames)


def variant(place: str, axis: str, order: str) -> mujoco.MjSpec:
    """Return the arm of Fig. 5 with its one hinge in another place or about another axis, and balls of another order.

    Args:
        place: a key of `PLACES`.
        axis: of that hinge, in the link's own frame, whose x runs along the link.
        order: axes of a ball's three hinges, from the base outward.
    """
    spec = Arm().spec()
    for joint in list(spec.joints):
        spec.delete(joint)
    for link in Arm().link_numbers:
        for number, letter in enumerate(hinges(link, place, axis, order)):
            kind = mujoco.mjtJoint.mjJNT_HINGE
            # Without armature the inertia of a link that can only twist would be nearly singular, which MuJoCo warns of.
            spec.body(f"link_{link}").add_joint(
                name=f"joint_{link}_{number}", type=kind, axis=AXES[letter], armature=ARMATURE
            )
    return spec


def hinges(link: int, place: str, axis: str, order: str) -> str:
    """Return the axes of the hinges at the base of `link` (from 1)."""
    return axis if link == PLACES[place] else order


def joint_positions(shape: Array, place: str, axis: str, order: str) -> Array:
    """Return the joint positions `(49,)` [rad] that bring a variant of the arm to a pose `(17, 3, 3)`.

    The one hinge can follow only a part of its link's rotation.
    """
    q: list[float] = []
    for link, rotation in enumerate(shape, start=1):
        if link == PLACES[place]:
            q.append(_about(rotation, axis))
        else:
            with warnings.catch_warnings():
                # Two axes of an x-z-x ball coincide where a link is in line with the one before; SciPy takes one of them.
                warnings.filterwarnings("ignore", message="Gimbal lock")
                q += Rotation.from_matrix(rotation).as_euler(order.upper()).tolist()
    return np.array(q)


def _about(rotation: Array, axis: str) -> float:
    """Return the angle [rad] of a hinge that points a link as `rotation` does, as far as it can."""
    match axis:
        case "x":
            return float(np.arctan2(rotation[2, 1], rotation[1, 1]))
        case "y":
            return float(np.arctan2(-rotation[2, 0], rotation[0, 0]))
    return float(np.arctan2(rotation[1, 0], rotation[0, 0]))


def _rows(place: str, axis: str, orders: tuple[str, ...], shapes: dict[str, Array]) -> Iterator[tuple[Any, ...]]:
    """Yield a row for each pose and group of hinge orders that have the same ranks."""
    specs = {order: variant(place, axis, order) for order in orders}
    for pose, shape in shapes.items():
        groups: dict[tuple[int, int, str], list[tuple[str, Array]]] = {}
        for order, spec in specs.items():
            arm = PosedArm.of(Arm(), joint_positions(shape, place, axis, order), spec=spec)
            jacobian = arm.jacobian
            s = np.linalg.svd(jacobian, compute_uv=False) / np.linalg.norm(jacobian, 2)
            key = (_count(s, EXACT), _count(s, RANK_TOLERANCE), task_case(jacobian).name.lower())
            groups.setdefault(key, []).append((order, s))
        for (exact, p, case), members in groups.items():
            values = np.array([s for _, s in members])
            least, most = values[:, p - 1].min(), values[:, p - 1].max()
            names = ", ".join(order for order, _ in members) if len(members) < len(ORDERS) else "all six"
            following = float(values[:, p].max())
            following = following if following > ROUNDING else 0.0
            yield place, axis, pose, names, exact, p, float(least), float(most), following, values.shape[1] - p, case


def _count(relative: Array, tolerance: float) -> int:
    return int(np.count_nonzero(relative > tolerance))


ARTEFACT = Artefact(
    "table-2",
    "Table 2: the rank of the 17-link arm",
    f"""\
Rank p of the stacked Jacobian J (51 × 49) with all 17 virtual end points, over what the paper does not state about
the arm (where the one joint is that is not of a ball, its axis in the link's frame, the order of the hinges in a
ball) and over the pose. Orders that share a rank share a row; σ_p/σ_1 is the smallest singular value that counts as
nonzero at the library's rank tolerance, relative to the largest, and σ_(p+1)/σ_1 the largest that does not. *Exact*
counts all above {EXACT:g}. Poses are the same shapes for every variant, as far as its hinges can make them: straight;
the evenly arched one; bends drawn with a standard deviation of {BEND} rad a joint; that one with links 16 and 17 in
line; and the last poses of windings with the default settings, lifted to all variants.

Every link's end stays on a sphere about the one before, so that no variant has more than 51 − 17 = 34, and the case
is always (c) of Fig. 3: neither Eq. 16 nor Eq. 17 ever applies to this arm. The order of the hinges does not matter
as long as they are three different axes. The place of the one hinge does: in the first link it leaves that link's end
one direction of two, in every pose; in the last link the twist of the ball before makes up for it wherever the two
links are not in line. A hinge about x only twists its link. Hinges x, z, x (proper Euler angles, twist first) bend
the straight arm in one plane alone. The table does not say which of these arms is the paper's.""",
    jobs,
    build,
)
