"""The plan of Eqs. 18 to 22 by one process a link: each knows its own link, and of the link before what that one sends.

A process is told once its number, η, dt and the dead band. In every step its link's own sensors tell it a^i, c^i and
M^i. It sends them to the process of the next link and receives those of the link before, which is all that dX^i*
needs: one message a pair of neighbours, all at the same time.

W (Eqs. 11, 23, 24) needs more: k is a property of the whole arm. A sweep along the arm finds it, each process told by
the one before whether the links in contact have begun and ended, and the last sends k back: twice n - 1 messages, one
after the other. Eqs. 12 and 14, which make one dθ of all dX^i*, are solved in one place, and get one message from
each process.
"""

import multiprocessing
from collections import Counter
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prioritized_ik.validation import Array
from prioritized_ik.winding.plan import plan_arm

NUMBER = 8  # bytes of a number, as they would be sent

Reading = tuple[Array, Array, bool]  # of one link: a, c, M
Sweep = tuple[bool, bool, int]  # whether the links in contact have begun, whether they have ended, and the last of them


class DistributedPlan:
    """A process a link, connected as the links are; ends them when left.

    Attributes:
        messages: how many were sent so far, by kind.
        numbers: how many numbers they carried, by kind.
        processes: one a link.
    """

    def __init__(self, links: int, *, speed: float, dt: float, dead_band: float) -> None:
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(["paper_repro.measure.distributed"])
        self.messages: Counter[str] = Counter()
        self.numbers: Counter[str] = Counter()
        between = [context.Pipe() for _ in range(links - 1)]
        self._links, self.processes = [], []
        for i in range(links):
            ours, theirs = context.Pipe()
            before = between[i - 1][1] if i > 0 else None
            after = between[i][0] if i < links - 1 else None
            settings = {"speed": speed, "dt": dt, "dead_band": dead_band}
            process = context.Process(target=_link, args=(i, theirs, before, after, settings), daemon=True)
            process.start()
            theirs.close()
            self._links.append(ours)
            self.processes.append(process)
        for pair in between:
            for end in pair:
                end.close()

    def __enter__(self) -> "DistributedPlan":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        for connection in self._links:
            connection.send(None)
        for process in self.processes:
            process.join()

    def step(self, directions: Array, contacts: Array, in_contact: NDArray[np.bool_]) -> tuple[Array, Array, int]:
        """Return dX* `(n, 3)` [m], the signs s `(n,)` and k, from readings a, c `(n, 3)` and M `(n,)`.

        Each process is given the reading of its own link only.
        """
        for connection, *reading in zip(self._links, directions, contacts, in_contact.tolist(), strict=True):
            connection.send(tuple(reading))
        answers = [connection.recv() for connection in self._links]
        for *_, sent in answers:
            for kind, count in sent.items():
                self.messages[kind] += 1
                self.numbers[kind] += count
        desired, signs, lasts = zip(*(answer[:3] for answer in answers), strict=True)
        if len(set(lasts)) != 1:
            raise AssertionError(f"the processes do not agree on k: {lasts}")
        return np.array(desired), np.array(signs), lasts[0]


def _link(i: int, body: Connection, before: Connection | None, after: Connection | None, settings: dict[str, Any]) -> None:
    """Plan arm i + 1, step after step, until told to end."""
    while (reading := body.recv()) is not None:
        direction, contact, touching = reading
        sent: dict[str, int] = {}
        if after is not None:
            after.send(reading)
            sent["reading to the next link"] = len(direction) + len(contact) + 1
        desired, sign = np.zeros_like(direction), np.zeros(())
        if before is not None:
            previous: Reading = before.recv()
            desired, sign = plan_arm(*previous, direction, touching, **settings)
        last, counts = _sweep(i, touching, before, after)
        sent.update(counts)
        sent["dX* to the solve"] = len(desired)
        body.send((desired, sign, last, sent))


def _sweep(i: int, touching: bool, before: Connection | None, after: Connection | None) -> tuple[int, dict[str, int]]:
    """Return k, the last of the links in successive contact with the first, 0 if there are none."""
    begun, ended, last = before.recv() if before is not None else (False, False, 0)
    if touching and not ended:
        begun, last = True, i + 1
    ended = ended or (begun and not touching)
    sent = {}
    if after is not None:
        after.send((begun, ended, last))
        sent["contact so far to the next link"] = 3
        last = after.recv()
    if before is not None:
        before.send(last)
        sent["k to the link before"] = 1
    return last, sent
