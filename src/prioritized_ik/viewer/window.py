"""MuJoCo's own viewer."""

from collections.abc import Iterable, Sequence

import mujoco
import mujoco.viewer

from prioritized_ik.robot import Robot
from prioritized_ik.viewer.canvas import add_marks
from prioritized_ik.viewer.marks import Mark
from prioritized_ik.viewer.panel import Line

#: What MuJoCo's fonts, which are ASCII, have in place of other letters of ours.
ASCII = str.maketrans({"°": " deg", "–": "-", "…": "...", "²": "^2", "≥": ">=", "≤": "<=", "·": "|", "θ": "theta"})


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
                _plain(f"{number} {line.name}" for number, line in enumerate(lines, 1)),
                _plain(f"{line.error}{f'  gives way to {line.reason}' if line.gives_way else ''}" for line in lines),
            )
        )
        self._handle.sync()

    def close(self) -> None:
        """Close the window."""
        self._handle.close()


def _plain(lines: Iterable[str]) -> str:
    """Return lines of text in letters that MuJoCo's fonts have."""
    return "\n".join(lines).translate(ASCII).encode("ascii", "replace").decode("ascii")
