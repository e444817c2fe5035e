"""Models of robots in the size and with the ranges of machines that exist, as MJCF."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

import mujoco

Vector = tuple[float, float, float]

AXES = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1", "-y": "0 -1 0", "-z": "0 0 -1"}


@dataclass(frozen=True)
class Joint:
    """A joint and the body that it moves, whose frame is the parent's at zero: `offset` [m] from it, range in rad or m."""

    name: str
    axis: str
    offset: Vector
    range: tuple[float, float]
    kind: str = "hinge"


def chain(joints: Iterable[Joint], inside: str) -> str:
    """Return nested bodies, one a joint, as MJCF; `inside` is what the last one holds."""
    text = inside
    for joint in reversed(list(joints)):
        place, ends = " ".join(map(str, joint.offset)), " ".join(map(str, joint.range))
        text = (
            f'<body name="{joint.name}" pos="{place}">'
            f'<joint name="{joint.name}" type="{joint.kind}" axis="{AXES[joint.axis]}" range="{ends}"/>'
            f'<geom type="sphere" size="0.05"/>{text}</body>'
        )
    return text


def site(name: str, *offset: float) -> str:
    """Return a site at `offset` [m] as MJCF."""
    return f'<site name="{name}" pos="{" ".join(map(str, offset))}"/>'


def mjcf(bodies: str) -> str:
    """Return the MJCF of a model that holds `bodies`."""
    return f'<mujoco><compiler angle="radian" autolimits="true"/><worldbody>{bodies}</worldbody></mujoco>'


ARM_7 = mjcf(
    chain(
        [
            Joint("base", "z", (0, 0, 0.333), (-2.9, 2.9)),
            Joint("shoulder", "y", (0, 0, 0), (-1.76, 1.76)),
            Joint("upper arm", "z", (0, 0, 0.316), (-2.9, 2.9)),
            Joint("elbow", "-y", (0.0825, 0, 0), (-3.07, -0.07)),
            Joint("forearm", "z", (-0.0825, 0, 0.384), (-2.9, 2.9)),
            Joint("wrist", "-y", (0, 0, 0), (-0.02, 3.75)),
            Joint("flange", "-z", (0.088, 0, 0), (-2.9, 2.9)),
        ],
        site("tool", 0, 0, -0.21),
    )
)

INDUSTRIAL_6 = mjcf(
    chain(
        [
            Joint("axis 1", "z", (0, 0, 0.495), (-3.14, 3.14)),
            Joint("axis 2", "y", (0.175, 0, 0), (-1.57, 2.61)),
            Joint("axis 3", "y", (0, 0, 1.095), (-3.14, 1.3)),
            Joint("axis 4", "x", (0.3, 0, 0.175), (-6.98, 6.98)),
            Joint("axis 5", "y", (0.97, 0, 0), (-2.18, 2.09)),
            Joint("axis 6", "x", (0.135, 0, 0), (-6.98, 6.98)),
        ],
        site("tool", 0.3, 0, 0.1),
    )
)

MOBILE_ARM = mjcf(
    chain(
        [
            Joint("drive x", "x", (0, 0, 0.3), (-20.0, 20.0), "slide"),
            Joint("drive y", "y", (0, 0, 0), (-20.0, 20.0), "slide"),
            Joint("turn", "z", (0, 0, 0), (-30.0, 30.0)),
            Joint("pan", "z", (0.2, 0, 0.4), (-6.28, 6.28)),
            Joint("lift", "y", (0, 0.136, 0), (-6.28, 6.28)),
            Joint("elbow", "y", (0.425, -0.12, 0), (-3.14, 3.14)),
            Joint("wrist 1", "y", (0.392, 0, 0), (-6.28, 6.28)),
            Joint("wrist 2", "-z", (0, 0.093, 0), (-6.28, 6.28)),
            Joint("wrist 3", "y", (0, 0, -0.095), (-6.28, 6.28)),
        ],
        site("tool", 0, 0.18, 0),
    )
)

GANTRY = mjcf(
    chain(
        [
            Joint("bridge", "x", (0, 0, 5.0), (0.0, 15.0), "slide"),
            Joint("trolley", "y", (0, 0, 0), (0.0, 8.0), "slide"),
            Joint("column", "z", (0, 0, 0), (-4.0, 0.0), "slide"),
            Joint("wrist 1", "z", (0, 0, -0.4), (-3.14, 3.14)),
            Joint("wrist 2", "y", (0, 0, 0), (-2.0, 2.0)),
            Joint("wrist 3", "x", (0, 0, -0.3), (-1.5, 1.5)),
        ],
        site("tool", 0, 0, -0.5),
    )
)

SCARA = mjcf(
    chain(
        [
            Joint("shoulder", "z", (0, 0, 0.4), (-2.3, 2.3)),
            Joint("elbow", "z", (0.3, 0, 0), (-2.6, 2.6)),
            Joint("second elbow", "z", (0.25, 0, 0), (-2.6, 2.6)),
            Joint("quill", "z", (0.2, 0, 0), (-0.2, 0.0), "slide"),
            Joint("roll", "z", (0, 0, 0), (-6.28, 6.28)),
        ],
        site("tool", 0.05, 0, -0.1),
    )
)


def _leg(side: str, y: float) -> str:
    joints = [
        Joint(f"{side} hip yaw", "z", (0, y, -0.08), (-0.8, 0.8)),
        Joint(f"{side} hip roll", "x", (0, 0, 0), (-0.6, 0.6)),
        Joint(f"{side} hip pitch", "y", (0, 0, -0.04), (-2.0, 0.7)),
        Joint(f"{side} knee", "y", (0, 0, -0.38), (0.0, 2.4)),
        Joint(f"{side} ankle pitch", "y", (0, 0, -0.38), (-0.9, 0.6)),
        Joint(f"{side} ankle roll", "x", (0, 0, 0), (-0.5, 0.5)),
    ]
    return chain(
        joints, site(f"{side} foot", 0.03, 0, -0.07) + '<geom type="box" size="0.1 0.05 0.02" pos="0.03 0 -0.05"/>'
    )


def _arm(side: str, y: float) -> str:
    joints = [
        Joint(f"{side} shoulder pitch", "y", (0, y, 0.3), (-3.0, 1.0)),
        Joint(f"{side} shoulder roll", "x", (0, 0, 0), (-1.6, 1.6)),
        Joint(f"{side} shoulder yaw", "z", (0, 0, -0.05), (-1.5, 1.5)),
        Joint(f"{side} elbow", "y", (0, 0, -0.24), (-2.4, 0.0)),
        Joint(f"{side} forearm", "z", (0, 0, -0.12), (-1.5, 1.5)),
    ]
    return chain(joints, site(f"{side} hand", 0.02, 0, -0.2))


HUMANOID = mjcf(
    '<body name="pelvis" pos="0 0 0.95"><freejoint name="float"/><geom type="box" size="0.1 0.15 0.08"/>'
    + _leg("left", 0.09)
    + _leg("right", -0.09)
    + chain(
        [Joint("waist yaw", "z", (0, 0, 0.1), (-1.2, 1.2)), Joint("waist pitch", "y", (0, 0, 0.05), (-0.4, 1.0))],
        '<geom type="box" size="0.1 0.15 0.2" pos="0 0 0.2"/>'
        + _arm("left", 0.2)
        + _arm("right", -0.2)
        + chain([Joint("neck", "z", (0, 0, 0.45), (-1.4, 1.4))], site("eyes", 0.08, 0, 0.1)),
    )
    + "</body>"
)


@cache
def compiled(text: str) -> mujoco.MjModel:
    """Return the model of an MJCF text."""
    return mujoco.MjModel.from_xml_string(text)
