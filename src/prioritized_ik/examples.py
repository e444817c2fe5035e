"""Robots to try things on, which come with the package."""

from importlib.resources import files

import mujoco
from numpy.typing import ArrayLike

from prioritized_ik.robot import Robot
from prioritized_ik.validation import one_of

#: An arm of seven joints over a table, and a small humanoid with a free base.
EXAMPLES = ("arm", "humanoid")


def example_model(name: str) -> mujoco.MjModel:
    """Return the model of one of the robots that come with the package, one of `EXAMPLES`."""
    file = files("prioritized_ik") / f"data/{one_of('example', name, EXAMPLES)}.xml"
    return mujoco.MjModel.from_xml_string(file.read_text("utf-8"))


def example(name: str, q: ArrayLike | None = None) -> Robot:
    """Return one of the robots that come with the package: `"arm"`, of seven joints, or `"humanoid"`.

    Args:
        name: one of `EXAMPLES`.
        q: position `(nq,)`; the model's own unless given.

    Raises:
        InputError: another name, or a position of another length.
    """
    return Robot(example_model(name), q)
