"""mink and its drop-in at mink's default damping, beside sixty digits: the table of the README."""

from dataclasses import asdict
from typing import Any

from comparisons.drop_in import SAME, SOLVERS, Row, measure
from comparisons.mink_scenes import MACHINES, SCENARIOS
from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.jobs import Job, Results
from paper_repro.make.table import Cell, Column, Table
from prioritized_ik.solvers.methods import DAMPING


def row_of_machine(machine: str, scenario: str, count: int) -> dict[str, Any]:
    """Return one row of `demo drop-in`."""
    (chosen,) = (each for each in MACHINES if each.name == machine)
    return asdict(measure(chosen, scenario, count))


def count(scale: Scale) -> int:
    """Return how many configurations a row has."""
    return 2 if scale.quick else 50


def jobs(scale: Scale) -> list[Job]:
    """Return one job a robot and scenario."""
    return [
        Job(row_of_machine, {"machine": machine.name, "scenario": scenario, "count": count(scale)})
        for machine in MACHINES
        for scenario in SCENARIOS
    ]


COLUMNS = (
    Column("robot", "robot"),
    Column("limits", "limits"),
    Column("difference", f"mink, {SOLVERS[0]}, from ours", ".0e"),
    *(Column(f"mink_{name}", f"mink, {name}, off", ".0e") for name in SOLVERS),
    Column("mink_failed", "mink failed"),
    Column("ours", "ours, off", ".0e"),
    Column("nearer", "ours nearer"),
    Column("certified", "certified"),
)


def build(scale: Scale, results: Results) -> Table:
    """Return one row a robot and scenario."""
    found = [Row(**results[job]) for job in jobs(scale)]
    rows: tuple[tuple[Cell, ...], ...] = tuple(
        (
            row.machine,
            row.scenario,
            row.difference[SOLVERS[0]],
            *(row.mink[name] for name in SOLVERS),
            "/".join(str(row.failed[name]) for name in SOLVERS),
            row.ours,
            f"{row.nearer}/{row.apart}",
            f"{row.certified}/{row.count}",
        )
        for row in found
    )
    nearer, apart = sum(row.nearer for row in found), sum(row.apart for row in found)
    notes = (
        f"{count(scale)} random configurations a row, tasks of frames alone, damping {DAMPING:g}, mink's default; each "
        "figure is the largest relative distance of Δq. Off: from the optimum of mink's own QP, made of the doubles of its "
        f"tasks and limits, in sixty digits. Ours nearer: of the calls where an answer of mink's is further than {SAME:g} "
        f"from ours, those where ours is the nearest to that optimum: {nearer} of {apart}. mink failed: no answer, by "
        "solver."
    )
    return Table(COLUMNS, rows, notes)


CAPTION = """\
`mink.solve_ik` and `prioritized_ik.mink.solve_ik` on the same calls, with one level of tasks, where both are asked for the
optimum of one and the same QP. Robots are the project's own, one for each kind of joint and coupling, and the paper's arm.
*Limited*: joint ranges with a fifth of the joints at an end, low speeds, a post to keep off. **To see:** mink squares the
Jacobian and adds a damping of 1e-12 to it, which double precision can hardly hold beside 1: in directions that the tasks
leave to the damping its answer hangs on the solver. The drop-in never squares the Jacobian.

From a damping of 1e-6 on both agree to 1e-6, which is a test. The table does *not* show strict levels, which mink has
not."""

ARTEFACT = Artefact("drop-in", "mink and its drop-in, beside sixty digits", CAPTION, jobs, build)
