"""A web page on localhost, by viser and mjviser."""

import copy
import sys
from collections.abc import Sequence
from contextlib import redirect_stdout
from html import escape

import mjviser
import numpy as np
import viser

from prioritized_ik.robot import Robot
from prioritized_ik.viewer.canvas import seen
from prioritized_ik.viewer.marks import Mark
from prioritized_ik.viewer.panel import Line

Handle = viser.IcosphereHandle | viser.LineSegmentsHandle

RED, GREEN, TEXT = "#c42e3c", "#218754", "margin:0.3em 0.8em;font-size:0.9em;line-height:1.35"


class Page:
    """The robot, marks and panel in whatever browser looks at `address`; only this machine can."""

    def __init__(self, robot: Robot, port: int) -> None:
        with redirect_stdout(sys.stderr):  # what viser says of itself is no output of ours
            self._server = viser.ViserServer(host="127.0.0.1", port=port, label="prioritized_ik", verbose=False)
        self.address = f"http://127.0.0.1:{self._server.get_port()}"
        self._scene = mjviser.ViserMujocoScene(self._server, copy.deepcopy(robot.model), num_envs=1)
        self._scene.camera_tracking_enabled = False
        self._panel = self._server.gui.add_html("")
        self._marks: dict[int, Handle] = {}
        self._server.gui.configure_theme(show_logo=False, control_layout="floating")
        centre, radius = seen(robot.model, robot.data)
        self._server.initial_camera.position = centre + radius * np.array([1.6, -1.3, 0.6])
        self._server.initial_camera.look_at = centre
        self.is_open = True

    def show(self, robot: Robot, marks: Sequence[Mark], lines: Sequence[Line]) -> None:
        """Show a state, with marks and panel."""
        with self._server.atomic():
            self._scene.update_from_mjdata(robot.data)
            self._draw(marks)
            self._panel.content = text_of(lines)
        self._server.flush()

    def close(self) -> None:
        """End the page's server."""
        self.is_open = False
        with redirect_stdout(sys.stderr):
            self._server.stop()

    def _draw(self, marks: Sequence[Mark]) -> None:
        """Move the marks of the state before where they serve again, as a new one takes a while to be seen."""
        for number in range(max(len(marks), len(self._marks))):
            mark = marks[number] if number < len(marks) else None
            name, old = f"/marks/{number}", self._marks.get(number)
            if old is not None and (mark is None or (mark.end is None) != isinstance(old, viser.IcosphereHandle)):
                old.remove()
                del self._marks[number]
                old = None
            if mark is not None:
                self._marks[number] = self._placed(name, mark, old)

    def _placed(self, name: str, mark: Mark, old: Handle | None) -> Handle:
        colour = (round(255 * mark.colour[0]), round(255 * mark.colour[1]), round(255 * mark.colour[2]))
        if mark.end is None:
            if not isinstance(old, viser.IcosphereHandle):
                return self._server.scene.add_icosphere(name, mark.radius, colour, position=mark.start)
            old.position, old.color, old.radius = mark.start, colour, mark.radius
            return old
        points = np.array([[mark.start, mark.end]], dtype=np.float32)
        if not isinstance(old, viser.LineSegmentsHandle):
            return self._server.scene.add_line_segments(name, points, colour, thickness=2.0 * mark.radius)
        old.points, old.colors = points, np.array(colour, dtype=np.uint8)
        return old


def text_of(lines: Sequence[Line]) -> str:
    """Return the panel as HTML."""
    shown = []
    for number, line in enumerate(lines, 1):
        name, error, reason = escape(line.name), escape(line.error), escape(line.reason)
        colour = RED if line.gives_way else GREEN
        shown.append(f'<p style="{TEXT}"><span style="color:{colour}">&#9679;</span> <b>{number} {name}</b> {error}')
        shown.append(f'<br><span style="color:{RED}">gives way to {reason}</span></p>' if line.gives_way else "</p>")
    return "".join(shown)
