"""MuJoCo's own viewer."""

from collections.abc import Sequence

import mujoco
import mujoco.viewer

from prioritized_ik.robot import Robot
from prioritized_ik.viewer.canvas import add_marks
from prioritized_ik.viewer.marks import Mark
from prioritized_ik.viewer.panel import Line


class Window:
    """MuJoCo's passive viewer, with marks and the panel."""

    address = ""

    def __init__(self, robot: Robot) -> None:
        self._handle = mujoco.viewer.launch_passive(robot.model, robot.data, show_left_ui=False, show_right_ui=False)

    @property
    def is_open(self) -> bool:
        """Whether the window is still there."""
        return bool(self._handle.is_running())

    def show(self, robot: Robot, marks: Sequence[Mark], lines: Sequence[Line]) -> None:
        """Show a state, with marks and panel."""
        with self._handle.lock():
            self._handle.user_scn.ngeom = 0
            add_marks(self._handle.user_scn, marks)
        self._handle.set_texts(
            (
                mujoco.mjtFontScale.mjFONTSCALE_150,
                mujoco.mjtGridPos.mjGRID_TOPLEFT,
                "\n".join(f"{number} {line.name}" for number, line in enumerate(lines, 1)),
                "\n".join(f"{line.error}{f'  gives way to {line.reason}' if line.gives_way else ''}" for line in lines),
            )
        )
        self._handle.sync()

    def close(self) -> None:
        """Close the window."""
        self._handle.close()
