"""Pictures and films as files."""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.extras import require_extra
from prioritized_ik.files import advising, write_whole
from prioritized_ik.validation import one_of

Picture = NDArray[np.uint8]  # (height, width, 3)

STILL, FILM = ".png", ".mp4"
KINDS = (STILL, ".gif", ".webp", FILM)
COLOURS = 192  # of an animated GIF


def kind_of(path: str | Path) -> str:
    """Return the kind of file that `path` names, one of `KINDS`.

    Raises:
        InputError: another kind.
        MissingExtraError: the extra `render` is not installed.
    """
    kind = one_of("kind of picture", Path(path).suffix.lower(), KINDS)
    require_extra("render")
    return kind


def write_pictures(path: str | Path, frames: Sequence[Picture], rate: float) -> None:
    """Write frames as a film of `rate` frames a second, or the last one alone where `path` names a `.png`.

    Raises:
        InputError: another kind of file, or a place that is not writable.
    """
    kind = kind_of(path)
    with advising("write", path):
        if kind == FILM:
            write_whole(path, lambda file: file.write(_movie(frames, rate)))
        else:
            write_whole(path, lambda file: _write(file, kind, frames[-1:] if kind == STILL else frames, rate))


def _write(file: BinaryIO, kind: str, frames: Sequence[Picture], rate: float) -> None:
    from PIL import Image

    pictures = [Image.fromarray(frame) for frame in frames]
    if kind == ".gif":  # without dithering, which would not compress
        pictures = [picture.quantize(COLOURS, dither=Image.Dither.NONE) for picture in pictures]
    moving = {"save_all": True, "append_images": pictures[1:], "duration": round(1e3 / rate), "loop": 0}
    pictures[0].save(file, kind[1:], **({} if kind == STILL else moving))


def _movie(frames: Sequence[Picture], rate: float) -> bytes:
    """Return an MP4 (H.264) that every browser plays; its width and height are even numbers."""
    import imageio_ffmpeg

    height, width = (size - size % 2 for size in frames[0].shape[:2])
    with tempfile.TemporaryDirectory() as folder:
        part = Path(folder) / "film.mp4"
        writer = imageio_ffmpeg.write_frames(
            str(part), (width, height), fps=rate, codec="libx264", macro_block_size=2, quality=8
        )
        writer.send(None)
        for frame in frames:
            writer.send(np.ascontiguousarray(frame[:height, :width]))
        writer.close()
        return part.read_bytes()
