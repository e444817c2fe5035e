"""A MuJoCo model's tree of hinges, slides and sites as URDF, which pink and placo read."""

from xml.etree import ElementTree

import mujoco
import numpy as np

from prioritized_ik.errors import ModelError
from prioritized_ik.validation import Array

KINDS = {int(mujoco.mjtJoint.mjJNT_HINGE): "revolute", int(mujoco.mjtJoint.mjJNT_SLIDE): "prismatic"}
EFFORT = "1000"  # [N·m] which no kinematic solver reads


def urdf(model: mujoco.MjModel, velocity: float) -> str:
    """Return the URDF of `model`: its joints and sites under their own names, geoms left out.

    Args:
        model: of limited hinges and slides whose axes go through their bodies' origins.
        velocity: limit of every joint [rad/s, m/s].

    Raises:
        ModelError: a joint of another kind or place, or one without limits.
    """
    robot = ElementTree.Element("robot", name="robot")
    _link(robot, "world")
    for body in range(1, model.nbody):
        name = model.body(body).name
        parent = model.body(model.body_parentid[body]).name
        place = (model.body_pos[body], model.body_quat[body])
        first, count = model.body_jntadr[body], model.body_jntnum[body]
        for joint in range(first, first + count):
            if int(model.jnt_type[joint]) not in KINDS or model.jnt_pos[joint].any() or not model.jnt_limited[joint]:
                raise ModelError(
                    f"joint {model.joint(joint).name!r} has no URDF; expected a limited hinge or slide at a body's origin."
                )
            child = name if joint == first + count - 1 else f"{name} at {model.joint(joint).name}"
            low, high = model.jnt_range[joint]
            moved = _joint(robot, model.joint(joint).name, KINDS[int(model.jnt_type[joint])], parent, child, *place)
            ElementTree.SubElement(moved, "axis", xyz=_text(model.jnt_axis[joint]))
            ends = {"effort": EFFORT, "velocity": repr(velocity), "lower": repr(float(low)), "upper": repr(float(high))}
            ElementTree.SubElement(moved, "limit", ends)
            parent, place = child, (np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
        if not count:
            _joint(robot, f"{name} fixed", "fixed", parent, name, *place)
    for site in range(model.nsite):
        holder = model.body(model.site_bodyid[site]).name
        name = model.site(site).name
        _joint(robot, f"{name} fixed", "fixed", holder, name, model.site_pos[site], model.site_quat[site])
    return ElementTree.tostring(robot, encoding="unicode")


def _joint(
    robot: ElementTree.Element, name: str, kind: str, parent: str, child: str, position: Array, quaternion: Array
) -> ElementTree.Element:
    _link(robot, child)
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    ElementTree.SubElement(joint, "origin", xyz=_text(position), rpy=_text(_roll_pitch_yaw(quaternion)))
    return joint


def _link(robot: ElementTree.Element, name: str) -> None:
    """Add a link of unit mass, which readers of URDF want and kinematics do not feel."""
    link = ElementTree.SubElement(robot, "link", name=name)
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "mass", value="1")
    ElementTree.SubElement(inertial, "inertia", ixx="1", iyy="1", izz="1", ixy="0", ixz="0", iyz="0")


def _roll_pitch_yaw(quaternion: Array) -> Array:
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, quaternion)
    r = rotation.reshape(3, 3)
    return np.array([np.arctan2(r[2, 1], r[2, 2]), -np.arcsin(np.clip(r[2, 0], -1.0, 1.0)), np.arctan2(r[1, 0], r[0, 0])])


def _text(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)
