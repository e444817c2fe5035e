"""Files that are written whole or not at all, and what goes wrong when one is read that was not."""

import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from prioritized_ik.errors import InputError, PrioritizedIkError

#: What NumPy and zipfile raise on `.npz` files that hold something else, or are damaged.
UNREADABLE = (OSError, ValueError, KeyError, TypeError, EOFError, NotImplementedError, zipfile.BadZipFile, zlib.error)


def write_whole(path: str | Path, write: Callable[[BinaryIO], object]) -> None:
    """Let `write` fill a neighbour of `path` that replaces it once it is whole.

    Raises:
        OSError: it cannot be written; nothing is left behind.
    """
    target = Path(path)
    part = target.with_name(f".{target.name}.part")
    try:
        with part.open("wb") as file:
            write(file)
        part.replace(target)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def advising(
    what: str,
    place: str | Path,
    kind: type[PrioritizedIkError] = InputError,
    advice: str = "choose a place that is writable",
) -> Iterator[None]:
    """Turn what the system refuses inside into one message: cannot `what` `place`, why, and `advice`.

    Raises:
        PrioritizedIkError: of that `kind`; the system refused.
    """
    try:
        yield
    except OSError as error:
        raise kind(f"cannot {what} {str(place)!r} ({error}); {advice}.") from error
