"""The problems of a robot's steps in one file, so that any solver can be run on them later.

Arrays of the file, for those who read it without this package: `format`; `q` `(T, nq)`, where each step was posed; `dtheta`
`(T, nv)`, what was taken, NaN where nothing was; `ending`; `content`, bytes, and `ends` `(T,)`: those of step i, from
`ends[i - 1]` to `ends[i]`, are a file of `problem_file` by themselves.
"""

import io
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from prioritized_ik.errors import EpisodeFileError, InputError
from prioritized_ik.files import UNREADABLE, advising, write_whole
from prioritized_ik.problem import IKProblem
from prioritized_ik.problem_file import load_problem, problem_bytes
from prioritized_ik.validation import Array, read_only

FORMAT = "prioritized-ik recording 1"


@dataclass(frozen=True, eq=False)
class Recording:
    """The problems of T steps, in their order.

    Attributes:
        contents: the problems' files.
        q: the position where each was posed `(T, nq)`; nq is 0 where nobody knows.
        dtheta: the steps `(T, nv)`; NaN where there was none.
        ending: how it ended, as its maker says.
    """

    contents: tuple[bytes, ...]
    q: Array
    dtheta: Array
    ending: str = ""

    @staticmethod
    def of(problems: Iterable[IKProblem], q: Array, dtheta: Array, ending: str = "") -> "Recording":
        """Return the recording of problems."""
        return Recording(tuple(map(problem_bytes, problems)), read_only(q), read_only(dtheta), ending)

    @property
    def steps(self) -> int:
        """Number of steps T."""
        return len(self.contents)

    def problem(self, step: int) -> IKProblem:
        """Return the problem of `step` (from 0), as it was solved then.

        Raises:
            InputError: there is no such step.
        """
        if not 0 <= step < self.steps:
            raise InputError(f"step is {step}; expected 0 to {self.steps - 1}.")
        return load_problem(io.BytesIO(self.contents[step]))

    def problems(self) -> Iterator[IKProblem]:
        """Yield all problems."""
        return map(self.problem, range(self.steps))

    def save(self, path: str | Path) -> None:
        """Write it to one `.npz` file, whole or not at all.

        Raises:
            EpisodeFileError: it cannot be written.
        """
        with advising("write the recording to", path, EpisodeFileError, "choose a folder that exists and is writable"):
            write_whole(path, self.write)

    def write(self, file: BinaryIO) -> None:
        """Write into an open file what `save` writes."""
        np.savez(
            file,
            format=np.array(FORMAT),
            q=self.q,
            dtheta=self.dtheta,
            ending=np.array(self.ending),
            ends=np.cumsum([len(content) for content in self.contents], dtype=np.int64),
            content=np.frombuffer(b"".join(self.contents), dtype=np.uint8),
        )

    @staticmethod
    def load(path: str | Path) -> "Recording":
        """Return what `save` wrote. Nothing in the file is executed.

        Raises:
            EpisodeFileError: not there, not such a file, or damaged.
        """
        try:
            with open(path, "rb") as raw, np.load(raw, allow_pickle=False) as file:
                parts = {name: file[name] for name in file.files}
            if str(parts["format"]) != FORMAT:
                raise ValueError(f"its format is {str(parts['format'])!r}")
            content, ends = parts["content"].tobytes(), parts["ends"].tolist()
            if ends[-1:] != [len(content)] or len(parts["q"]) != len(ends) or len(parts["dtheta"]) != len(ends):
                raise ValueError("its arrays do not fit each other")
            contents = tuple(content[start:end] for start, end in zip([0, *ends], ends, strict=False))
            recording = Recording(contents, read_only(parts["q"]), read_only(parts["dtheta"]), str(parts["ending"]))
            for _ in recording.problems():
                pass
        except (*UNREADABLE, InputError) as error:
            raise EpisodeFileError(
                f"cannot read a recording from {str(path)!r} ({error}); expected a file of the format {FORMAT!r}, whole."
            ) from error
        return recording
