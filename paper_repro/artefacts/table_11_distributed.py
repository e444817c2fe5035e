"""Table 11: the plan by a process a link, against the plan in one place."""

from typing import Any

import numpy as np

from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.jobs import Job, Results
from paper_repro.make.table import Column, Table
from paper_repro.measure.distributed import NUMBER, DistributedPlan
from paper_repro.measure.windings import METHOD_NAMES, settings
from prioritized_ik.winding.episode import wind
from prioritized_ik.winding.plan import first_and_last_in_contact
from prioritized_ik.winding.settings import WindingSettings

LINKS = 17

#: Windings whose every state is planned again: method and changes to the settings.
WINDINGS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("closed form", {"link": 12}),
    ("closed form", {"link": 6, "tilt": 0.3}),
    ("qp", {"link": 6, "tilt": 0.3}),
)

COLUMNS = (
    Column("direction", "object from"),
    Column("method", "method"),
    Column("first_link", "first link"),
    Column("tilt_rad", "tilt [rad]", ".1f"),
    Column("states", "states planned"),
    Column("different_bits", "dX* with other bits"),
    Column("different_k", "other k"),
    Column("readings", "readings to the next link, a step"),
    Column("sweep", "messages of the sweep for k, a step"),
    Column("answers", "dX* to the solve, a step"),
    Column("bytes", "bytes a step"),
)

CAPTION = f"""\
The desired displacements planned by {LINKS} processes, one a link. Each is given the contact vector and the direction
of its own link, by its own sensors, and passes them to the process of the next link: two links' vectors are all that
Eqs. 18 to 22 read. Every state of whole windings is planned so, and in one place by `winding.plan.plan`; *other bits*
counts the dX* of a state that are not equal to the last bit.

**To see:** as the paper says, the plan is parallel and distributed: {LINKS - 1} messages between neighbours, all at the
same time, and nothing else however long the arm. What the paper does not say is that the weights are not: k in Eqs. 23
and 24 is known to no link by itself. Here a sweep along the arm and back finds it, {2 * (LINKS - 1)} messages one after
the other, which is the latency of the whole, and grows with the arm. Eqs. 12 and 14 are solved in one place, for which
every link sends its dX* there. It does *not* show a distributed solve, nor times: processes of one machine say nothing
of an arm's wires.
"""


def directions(scale: Scale) -> tuple[str, ...]:
    """Return where the object comes from; one direction in the reduced run."""
    return scale.directions[:1] if scale.quick else scale.directions


def cases(scale: Scale) -> list[tuple[str, str, dict[str, Any]]]:
    """Return direction, method and changes of each winding; one winding in the reduced run."""
    windings = WINDINGS[:1] if scale.quick else WINDINGS
    return [(direction, method, changes) for method, changes in windings for direction in directions(scale)]


def planned_job(chosen: WindingSettings) -> Job:
    """Return the job of one winding: see `planned`."""
    return Job(planned, {"settings": chosen.to_json()})


def planned(settings: str) -> dict[str, Any]:
    """Return how a winding is planned by a process a link.

    The number of `states`, of those with other bits in dX* or s, `different`, or with another k, `different_k`; `messages`
    and `numbers` sent by kind.
    """
    episode = wind(WindingSettings.from_json(settings))
    chosen = episode.settings
    different = different_k = 0
    given = {"speed": chosen.speed, "dt": chosen.dt, "dead_band": chosen.dead_band}
    with DistributedPlan(chosen.arm.links, **given) as distributed:
        for step in range(episode.steps):
            contact = episode.in_contact[step]
            desired, signs, k = distributed.step(episode.directions[step], episode.contact_vectors[step], contact)
            same = desired.tobytes() == episode.desired[step].tobytes() and signs.tobytes() == episode.signs[step].tobytes()
            different += not same
            different_k += k != first_and_last_in_contact(np.asarray(contact))[1]
    return {
        "states": episode.steps,
        "different": different,
        "different_k": different_k,
        "messages": dict(distributed.messages),
        "numbers": dict(distributed.numbers),
    }


def jobs(scale: Scale) -> list[Job]:
    """Return one job a winding."""
    return [planned_job(settings(method, direction=direction, **changes)) for direction, method, changes in cases(scale)]


def build(scale: Scale, results: Results) -> Table:
    """Return the table."""
    rows = []
    for (direction, method, changes), job in zip(cases(scale), jobs(scale), strict=True):
        found = results[job]
        steps, sent = found["states"], found["messages"]
        sweep = sent["contact so far to the next link"] + sent["k to the link before"]
        rows.append(
            (
                direction,
                METHOD_NAMES[method],
                changes["link"],
                changes.get("tilt", 0.0),
                steps,
                found["different"],
                found["different_k"],
                sent["reading to the next link"] // steps,
                sweep // steps,
                sent["dX* to the solve"] // steps,
                NUMBER * sum(found["numbers"].values()) // steps,
            )
        )
    return Table(COLUMNS, tuple(rows), f"{LINKS} processes beside the one that drives the arm.")


ARTEFACT = Artefact("table-11", "Table 11: the plan by a process a link", CAPTION, jobs, build)
