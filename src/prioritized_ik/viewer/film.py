"""A motion as a file, and one state as a picture, each with its panel."""

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

import numpy as np

from prioritized_ik.errors import InputError
from prioritized_ik.extras import require_extra
from prioritized_ik.guard import Limit
from prioritized_ik.motion import Levels, Motion, grouped
from prioritized_ik.pictures import STILL, Picture, kind_of, write_pictures
from prioritized_ik.robot import Robot
from prioritized_ik.validation import positive
from prioritized_ik.viewer.canvas import Camera, Canvas
from prioritized_ik.viewer.marks import marks_of
from prioritized_ik.viewer.panel import Line, lines_of

Ink = tuple[int, int, int]
INK, GREEN, RED, PAPER = (40, 44, 52), (33, 135, 84), (196, 46, 60), (255, 255, 255)


class Film:
    """A motion, frame by frame, written to a file when it ends.

        with Film("reach.gif", robot, levels, limits) as film:
            for _ in range(50):
                motion = solve_step(robot, levels, limits, dt=0.02)
                robot.integrate(motion.velocity, 0.02)
                film.add(motion)

    Args:
        path: of a `.gif`, `.webp` or `.mp4`, or of a `.png`, which gets the last frame alone.
        robot: is shown where it is at each frame.
        levels: see `solve_step`; their targets are drawn, and their errors listed.
        limits: see `solve_step`; pairs of a `Collision` that are near each other are joined by a line.
        camera: where from.
        size: width and height [pixels].
        rate: frames a second.
        panel: whether the levels are listed in the picture.

    Raises:
        InputError: another kind of file, or no way to render here.
        MissingExtraError: the extra `render` is not installed.
    """

    def __init__(
        self,
        path: str | Path,
        robot: Robot,
        levels: Levels = (),
        limits: Sequence[Limit] = (),
        *,
        camera: Camera | None = None,
        size: tuple[int, int] = (640, 480),
        rate: float = 20.0,
        panel: bool = True,
    ) -> None:
        self._path, self._kind = Path(path), kind_of(path)
        self._robot, self._levels, self._limits = robot, grouped(levels), limits
        self._rate, self._panel, self._frames = positive("rate", rate), panel, list[Picture]()
        self._written = False
        self._canvas = Canvas(robot.model, robot.data, *size, camera or Camera())

    def add(self, motion: Motion | None = None) -> None:
        """Take a frame of the robot where it is; `motion` is the step that brought it here, for the panel."""
        lines = lines_of(self._robot, self._levels, motion)
        holding = {name for line in lines for name in line.holding}
        tasks = [task for tasks in self._levels for task in tasks]
        frame = self._canvas.draw(self._robot.data, marks_of(self._robot, tasks, self._limits, holding))
        frame = _with_panel(frame, lines) if self._panel and lines else frame
        self._frames = [frame] if self._kind == STILL else [*self._frames, frame]

    def close(self) -> None:
        """Write the file; once.

        Raises:
            InputError: there is no frame, or the place is not writable.
        """
        if self._written:
            return
        self._written = True
        self._canvas.close()
        if not self._frames:
            raise InputError(f"{self._path} has no frame; expected add() to be called before the film ends.")
        write_pictures(self._path, self._frames, self._rate)

    def __enter__(self) -> "Film":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is None:
            self.close()
        else:
            self._canvas.close()


def picture(
    robot: Robot,
    levels: Levels = (),
    limits: Sequence[Limit] = (),
    motion: Motion | None = None,
    *,
    camera: Camera | None = None,
    size: tuple[int, int] = (640, 480),
    panel: bool = True,
) -> Picture:
    """Return the picture `(height, width, 3)` of a robot where it is; see `Film`.

    Raises:
        InputError: no way to render here.
        MissingExtraError: the extra `render` is not installed, which the panel needs.
    """
    if panel:
        require_extra("render")
    shown = grouped(levels)
    lines = lines_of(robot, shown, motion)
    holding = {name for line in lines for name in line.holding}
    with Canvas(robot.model, robot.data, *size, camera or Camera()) as canvas:
        drawn = canvas.draw(robot.data, marks_of(robot, [task for tasks in shown for task in tasks], limits, holding))
    return _with_panel(drawn, lines) if panel and lines else drawn


def _with_panel(frame: Picture, lines: Sequence[Line]) -> Picture:
    """Return the frame with a list of the levels in its upper left."""
    from PIL import Image, ImageDraw, ImageFont

    image = Image.fromarray(frame)
    size = max(11, round(image.height / 34))
    font = ImageFont.load_default(size)
    gap, indent = round(1.45 * size), round(1.3 * size)
    texts: list[tuple[str, Ink, Ink | None]] = []
    for number, line in enumerate(lines, 1):
        texts.append((f"{number}  {line.name}: {line.error}", INK, GREEN if not line.gives_way else RED))
        if line.gives_way:
            texts.append((f"    gives way to {line.reason}", RED, None))
    width = max(int(font.getlength(text)) for text, _, _ in texts) + 2 * indent
    veil = Image.new("RGBA", image.size)
    ImageDraw.Draw(veil).rounded_rectangle(
        (size // 2, size // 2, size // 2 + width, size + gap * len(texts)), size // 2, fill=(*PAPER, 215)
    )
    image = Image.alpha_composite(image.convert("RGBA"), veil).convert("RGB")
    draw = ImageDraw.Draw(image)
    for place, (text, ink, dot) in enumerate(texts):
        top = round(0.7 * size) + gap * place
        if dot is not None:
            draw.ellipse((size, top + 0.35 * size, 1.6 * size, top + 0.95 * size), fill=dot)
        draw.text((size + indent * 0.8, top), text, fill=ink, font=font)
    return np.asarray(image)
