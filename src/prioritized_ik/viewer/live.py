"""A motion live: in MuJoCo's own window where there is a display, in a web page on localhost otherwise."""

import os
import time
from collections.abc import Sequence
from types import TracebackType
from typing import Protocol

from prioritized_ik.errors import InputError
from prioritized_ik.extras import require_extra
from prioritized_ik.guard import Limit
from prioritized_ik.motion import Levels, Motion, grouped
from prioritized_ik.rendering import works
from prioritized_ik.robot import Robot
from prioritized_ik.validation import one_of
from prioritized_ik.viewer.marks import Mark, marks_of
from prioritized_ik.viewer.panel import Line, lines_of

PLACES = ("window", "page")
DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")
PORT = 8080
PAUSE = 0.05  # [s] between looks whether a view is still open


class Screen(Protocol):
    """Where a `View` is seen."""

    address: str

    @property
    def is_open(self) -> bool:
        """Whether anybody can still see it."""

    def show(self, robot: Robot, marks: Sequence[Mark], lines: Sequence[Line]) -> None:
        """Show a state, with marks and panel."""

    def close(self) -> None:
        """Close it."""


class View:
    """A robot seen live, with its targets, and a panel that says which level gives way to what.

        with View(robot, levels, limits) as view:
            while view.is_open:
                motion = solve_step(robot, levels, limits, dt=0.02)
                robot.integrate(motion.velocity, 0.02)
                view.show(motion)

    Args:
        robot: is shown where it is at each `show`.
        levels: see `solve_step`; their targets are drawn, and their errors listed.
        limits: see `solve_step`; pairs of a `Collision` that are near each other are joined by a line.
        place: `"window"`, MuJoCo's own viewer, or `"page"`, a web page on localhost; the window unless given, where
            there is a display that it opens on.
        port: of the page.

    Attributes:
        address: of the page; empty for a window.

    Raises:
        InputError: another place, or a window where there is no display.
        MissingExtraError: the page needs the extra `view`.
    """

    def __init__(
        self,
        robot: Robot,
        levels: Levels = (),
        limits: Sequence[Limit] = (),
        *,
        place: str | None = None,
        port: int = PORT,
    ) -> None:
        self._robot, self._levels, self._limits = robot, grouped(levels), limits
        where = one_of("place", place, PLACES) if place is not None else PLACES[not has_display()]
        self._screen: Screen = _window(robot) if where == "window" else _page(robot, port)
        self.address = self._screen.address
        self.show()

    @property
    def is_open(self) -> bool:
        """Whether anybody can still see it: false once its window is closed."""
        return self._screen.is_open

    def show(self, motion: Motion | None = None) -> None:
        """Show the robot where it is; `motion` is the step that brought it here, for the panel."""
        lines = lines_of(self._robot, self._levels, motion)
        holding = {name for line in lines for name in line.holding}
        tasks = [task for tasks in self._levels for task in tasks]
        self._screen.show(self._robot, marks_of(self._robot, tasks, self._limits, holding), lines)

    def wait(self) -> None:
        """Return once the window is closed, or on Ctrl-C."""
        try:
            while self.is_open:
                time.sleep(PAUSE)
        except KeyboardInterrupt:
            return

    def close(self) -> None:
        """Close the window, or the page's server."""
        self._screen.close()

    def __enter__(self) -> "View":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def has_display() -> bool:
    """Whether there is a display on which a window can open."""
    return any(os.environ.get(name) for name in DISPLAYS) and works("glfw")


def require_screen() -> None:
    """Return if a `View` can open here.

    Raises:
        MissingExtraError: there is no display, and the page needs the extra `view`.
    """
    if not has_display():
        require_extra("view")


def _window(robot: Robot) -> Screen:
    if not has_display():
        raise InputError("no window opens here; expected a display, or place='page'.")
    from prioritized_ik.viewer.window import Window

    return Window(robot)


def _page(robot: Robot, port: int) -> Screen:
    require_extra("view")
    from prioritized_ik.viewer.page import Page

    return Page(robot, port)
