"""Table 3: the three cases of Fig. 3, and what each equation gives there."""

import numpy as np

from paper_repro.make.artefact import Artefact, Scale, no_jobs
from paper_repro.make.jobs import Results
from paper_repro.make.table import Cell, Column, Table
from paper_repro.measure.planar_cases import CASES, MOVE, Answer, Case, answers, case_arm, request_of
from prioritized_ik.solvers.closed_form import rank_decomposition_svd, task_case

COLUMNS = (
    Column("case", "Fig. 3"),
    Column("points", "end points at the ends of links"),
    Column("rows", "L"),
    Column("joints", "m"),
    Column("rank", "p"),
    Column("kind", "case"),
    Column("equation", "equation"),
    Column("applies", "applies"),
    Column("residual_mm", "residual ‖dX_v* − J dθ‖ [mm]", ".3f"),
    Column("cost", "cost Q [mm²]", ".4g"),
    Column("norm_rad", "‖dθ‖ [rad]", ".3g"),
    Column("library", "the library"),
)

ROUNDING = 1e-9  # residuals below this fraction of the request are what rounding leaves of zero


def build(scale: Scale, results: Results) -> Table:
    """Return the table."""
    del scale, results
    return Table(COLUMNS, tuple(row for letter, case in CASES.items() for row in _rows(letter, case)))


def _rows(letter: str, case: Case) -> list[tuple[Cell, ...]]:
    jacobian = case_arm(case).jacobian
    rank = rank_decomposition_svd(jacobian).rank
    kind = task_case(jacobian).name.lower()
    links = ", ".join(point.partition("_")[2] for point in case.points)
    head = (letter, links, *jacobian.shape, rank, kind)
    return [(*head, *_cells(answer, jacobian, case)) for answer in answers(case)]


def _cells(answer: Answer, jacobian: np.ndarray, case: Case) -> tuple[Cell, ...]:
    weights, desired = request_of(case)
    if answer.dtheta is None:
        return answer.equation, answer.applies, None, None, None, answer.library
    left = desired - jacobian @ answer.dtheta
    left[np.abs(left) < ROUNDING * MOVE] = 0.0
    cost = float(left @ (weights * left))
    return (
        answer.equation,
        answer.applies,
        1e3 * float(np.linalg.norm(left)),
        1e6 * cost,
        float(np.linalg.norm(answer.dtheta)),
        answer.library,
    )


ARTEFACT = Artefact(
    "table-3",
    "Table 3: the three cases of Fig. 3",
    """\
The five-link planar arm (m = 5, l = 2) with the virtual end points of Fig. 3, in one pose that is bent at every
joint. Every end point is asked to move by 10 mm, each in a drawn direction of its own; virtual arms have the weight
20, the actual arm 1. For each case: what Eqs. 12 and 14 together give, and what their special forms do, Eq. 16 for
full row rank and Eq. 17 for full column rank. Where a special form does not apply the library refuses it, and the
figures are those of its plain formula.

Eqs. 12 and 14 agree with Eq. 16 in case (a) and with Eq. 17 in case (b), which is what the paper says; in (c) no
special form applies. In (b) and (c) Eq. 16 moves the arm too, but at a higher cost, because J⁺ knows no weights.
Where JᵀWJ is singular, in (a) and (c), Eq. 17 divides rounding by rounding: its step is of any size, or there is none
(–); what it is there depends on the machine's arithmetic. The paper gives neither pose nor request for this figure;
rank and case do not hang on them, residuals and norms do.""",
    no_jobs,
    build,
)
