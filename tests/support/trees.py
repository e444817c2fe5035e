"""Random kinematic trees, MuJoCo's and free of MuJoCo, and problems on them."""

import mujoco
import numpy as np

from prioritized_ik.kinematic_tree import BASE, KinematicTree, PointRows
from prioritized_ik.problem import Bounds, IKProblem
from prioritized_ik.tree_problem import TreeLevel, TreeRows

JOINTS = ("hinge", "hinge", "slide", "ball", "none", "several")


def random_model(rng: np.random.Generator, bodies: int = 12, *, floating: bool = False) -> mujoco.MjModel:
    """Return a model of a tree of bodies with joints of every kind."""
    spec = mujoco.MjSpec()
    made = [spec.worldbody]
    for number in range(bodies):
        parent = made[0] if number == 0 else made[int(rng.integers(0, len(made)))]
        body = parent.add_body(name=f"body {number}", pos=rng.normal(scale=0.2, size=3), quat=rng.normal(size=4))
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.02, 0, 0])
        kind = "free" if floating and number == 0 else JOINTS[int(rng.integers(0, len(JOINTS)))]
        for name in ("hinge", "slide", "hinge") if kind == "several" else (kind,):
            if name != "none":
                joint = getattr(mujoco.mjtJoint, f"mjJNT_{name.upper()}")
                body.add_joint(type=joint, axis=rng.normal(size=3), pos=rng.normal(scale=0.05, size=3))
        made.append(body)
    return spec.compile()


def random_tree(rng: np.random.Generator, joints: int, *, branching: float = 0.0, length: float = 0.1) -> KinematicTree:
    """Return a tree of hinges and a few slides, each near the one before it; `branching` is the share of new branches."""
    parents = np.arange(-1, joints - 1)
    for j in range(1, joints):
        if rng.random() < branching:
            parents[j] = int(rng.integers(-1, j))
    anchors, angular = np.zeros((joints, 3)), rng.normal(size=(joints, 3))
    for j in range(joints):
        before = anchors[parents[j]] if parents[j] != BASE else np.zeros(3)
        anchors[j] = before + length * unit(rng)
    angular /= np.linalg.norm(angular, axis=1, keepdims=True)
    linear = np.zeros((joints, 3))
    slides = rng.random(joints) < 0.1
    linear[slides], angular[slides] = angular[slides], 0.0
    return KinematicTree(parents, angular, linear, anchors)


def ball_chain(
    rng: np.random.Generator, links: int, bend: float = 0.5, length: float = 0.06, kinks: int = 0, turned: bool = False
) -> KinematicTree:
    """Return the tree of the paper's kind of arm: three hinges about orthogonal axes a link, one for the last.

    Links are bent by about `bend` [rad], of those after the first quarter so many as `kinks` says by about 0.3; if it is
    `turned`, the arm lies along no axis of the world.
    """
    start = rotation(rng.normal(size=3)) if turned else np.eye(3)
    kinked = rng.choice(np.arange(links // 4, links), size=kinks, replace=False) if kinks else ()
    turn, at = start, np.zeros(3)
    axes, anchors = [], []
    for link in range(links):
        turn = turn @ rotation(rng.normal(size=3) * (0.3 if link in kinked else bend))
        axes += list(turn.T[::-1]) if link + 1 < links else [turn[:, 2]]
        anchors += [at.copy()] * (3 if link + 1 < links else 1)
        at = at + length * turn[:, 0]
    m = len(axes)
    return KinematicTree(np.arange(-1, m - 1), np.array(axes), np.zeros((m, 3)), np.array(anchors))


def end_points(tree: KinematicTree, rng: np.random.Generator, every: int = 1, length: float = 0.06) -> PointRows:
    """Return the whole motions of a point beyond every so many distinct anchors."""
    last = np.flatnonzero(np.r_[(np.diff(tree.anchors, axis=0) != 0).any(axis=1), True])[::every]
    points = np.array([tree.anchors[j] + length * unit(rng) for j in last])
    following = np.isin(last + 1, tree.parents + 1) & (last + 1 < tree.joint_count)
    nexts = np.minimum(last + 1, tree.joint_count - 1)
    serial = following & (tree.parents[nexts] == last)
    points[serial] = tree.anchors[nexts[serial]]
    return PointRows.along_axes(tree, last, points, np.eye(3))


def unit(rng: np.random.Generator) -> np.ndarray:
    """Return a random direction."""
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def rotation(vector: np.ndarray) -> np.ndarray:
    """Return the rotation about a vector by its length."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector / (angle or 1.0)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def random_problem(
    rng: np.random.Generator,
    tree: KinematicTree,
    levels: int = 1,
    *,
    contacts: int = 0,
    bound: float = np.inf,
    reference: bool = False,
    metric: bool = False,
    weights: float = 0.0,
    size: float = 0.01,
) -> IKProblem:
    """Return a problem on a tree whose levels, weights `10**±weights`, bounds and contact rows are random."""
    m, points = tree.joint_count, end_points(tree, rng)
    cuts = np.sort(rng.choice(np.arange(1, max(2, len(points) // 3)), size=levels - 1, replace=False)) * 3
    parts = np.split(np.arange(len(points)), cuts)
    made = [
        TreeLevel(
            points[part],
            rng.normal(scale=size, size=len(part)),
            10.0 ** rng.uniform(-weights, weights, size=len(part)) if weights else None,
            f"level {number}",
        )
        for number, part in enumerate(parts, 1)
    ]
    rows = None
    if contacts:
        joints = np.sort(rng.choice(np.arange(min(5, m - 1), m), size=contacts, replace=False))
        at = tree.anchors[joints] + 0.03 * rng.normal(size=(contacts, 3))
        normals = np.array([unit(rng) for _ in range(contacts)])
        names = [f"contact {j}" for j in joints]
        rows = TreeRows(PointRows(tree, joints, at, normals), rng.uniform(0.0, size, size=contacts), names)
    bounds = None if bound == np.inf else Bounds(-bound * rng.random(m), bound * rng.random(m))
    return IKProblem(
        made,
        bounds,
        rows,
        rng.normal(scale=0.1 * size, size=m) if reference else None,
        metric=10.0 ** rng.uniform(-1, 1, size=m) if metric else None,
    )
