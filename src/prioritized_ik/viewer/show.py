"""A scene shown while it runs: in a film, live, or both."""

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

from prioritized_ik.motion import Motion
from prioritized_ik.robot import Robot
from prioritized_ik.scene.scene import Scene, SceneStep
from prioritized_ik.validation import Array
from prioritized_ik.viewer.film import Film
from prioritized_ik.viewer.live import View

REPLAY = 8.0  # [s] that a motion without times plays for
RATE = 20.0  # [frames/s], at most, of a film that runs as fast as the robot


def shown(
    scene: Scene,
    steps: Iterable[SceneStep],
    *,
    record: str | Path | None = None,
    view: bool = False,
    say: Callable[[str], object] = print,
) -> Iterator[SceneStep]:
    """Yield the steps of a scene, each shown before the next is taken; a view stays until it is closed, or Ctrl-C.

    Args:
        scene: whose steps they are.
        steps: see `Scene.steps`.
        record: file of a film, see `Film`; none unless given.
        view: whether to open a `View`, as fast as the robot moves.
        say: is told where the view is.

    Raises:
        InputError: another kind of file, no way to render here, or a place that is not writable.
        MissingExtraError: the extra `render` or `view` is not installed.
    """
    staged = scene.staged()
    every = max(1, round(1.0 / (RATE * scene.dt)))  # steps a frame
    with ExitStack() as closing:
        film = live = None
        if record is not None:
            rate = 1.0 / (every * scene.dt)
            film = closing.enter_context(Film(record, staged.robot, staged.levels, staged.limits, rate=min(rate, RATE)))
            film.add()
        if view:
            live = closing.enter_context(View(staged.robot, staged.levels, staged.limits))
            say(f"seen at {live.address}" if live.address else "seen in a window")
        for number, step in enumerate(steps, 1):
            started = time.monotonic()
            for aimed in staged.aimed:
                aimed.aim(step.time)
            staged.robot.update(step.q)
            motion = None
            if step.step.dtheta is not None:
                motion = Motion(step.step.dtheta / scene.dt, step.step, step.problem)
            if film is not None and (number % every == 0 or number == scene.step_count):
                film.add(motion)
            if live is not None and live.is_open:
                live.show(motion)
                time.sleep(max(0.0, scene.dt - (time.monotonic() - started)))
            yield step
        if film is not None:
            film.close()  # a film is there while the view still waits
            say(f"recorded {record}")
        if live is not None:
            _stay(live, say)


def replayed(robot: Robot, positions: Array, say: Callable[[str], object] = print) -> None:
    """Show positions `(T, nq)` one after the other in a view, which stays until it is closed, or Ctrl-C.

    Args:
        robot: is moved.
        positions: where to.
        say: is told where the view is.

    Raises:
        MissingExtraError: the extra `view` is not installed.
    """
    robot.update(positions[0])
    with View(robot) as view:
        say(f"seen at {view.address}" if view.address else "seen in a window")
        for position in positions:
            if not view.is_open:
                break
            robot.update(position)
            view.show()
            time.sleep(REPLAY / len(positions))
        _stay(view, say)


def _stay(view: View, say: Callable[[str], object]) -> None:
    with suppress(KeyboardInterrupt):
        say("the last state stays until the window is closed, or Ctrl-C")
        view.wait()
