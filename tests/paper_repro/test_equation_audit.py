"""Table 1: every equation has a row, every row holds, and a wrong equation is found out."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from notation import PAGE, lines

from paper_repro.artefacts import table_1_equations
from paper_repro.make.artefact import QUICK
from paper_repro.make.jobs import Job, Results
from paper_repro.measure import audit
from prioritized_ik.errors import InputError
from prioritized_ik.winding import plan


@pytest.fixture(scope="module")
def measured() -> dict[str, audit.Measured]:
    return audit.measure()


def error_of(equation: str) -> float:
    (row,) = [row for row in audit.ROWS if row.equation == equation]
    error = row.measure()["implemented"]
    return np.inf if error is None else error


def row_of(equation: str) -> audit.Row:
    return next(row for row in audit.ROWS if row.equation == equation)


# What the table covers


def test_every_equation_of_the_paper_has_a_row() -> None:
    assert {number for row in audit.ROWS for number in row.numbers} == set(range(1, 25))


def test_no_two_rows_have_the_same_name() -> None:
    assert len({row.equation for row in audit.ROWS}) == len(audit.ROWS)


def test_the_table_and_the_notation_page_name_the_same_functions() -> None:
    audited = audit.paths()
    for equations, path in lines():
        for equation in equations:
            assert path in audited[equation], f"Table 1 does not audit {path} as Eq. {equation}"


def test_rows_that_the_notation_page_calls_different_say_why() -> None:
    page = PAGE.read_text(encoding="utf-8").splitlines()
    different = {line.split("|")[1].strip() for line in page if line.startswith("| ") and "| differs" in line}
    for equations in different:
        for number in equations.split(","):
            assert any(row.differs for row in audit.ROWS if int(number) in row.numbers), f"Eq. {number}"


# What the table says


@pytest.mark.parametrize("row", audit.ROWS, ids=lambda row: row.equation)
def test_what_is_implemented_holds_against_its_oracle(row: audit.Row, measured: dict[str, audit.Measured]) -> None:
    assert table_1_equations.holds(row, measured[row.equation])


@pytest.mark.parametrize("equation", ["2", "16 on Fig. 5", "17 on Fig. 5", "20 γ", "22", "22 (sign of c)"])
def test_printed_forms_that_are_false_are_off_by_more_than_rounding(
    equation: str, measured: dict[str, audit.Measured]
) -> None:
    printed = measured[equation]["printed"]
    assert printed is None or printed > 0.1


def test_printed_forms_that_are_implemented_hold_too(measured: dict[str, audit.Measured]) -> None:
    for row in audit.ROWS:
        printed = measured[row.equation]["printed"]
        if not row.differs:
            assert printed is not None
            assert printed <= row.allowed_printed, row.equation


def test_what_forming_the_inverse_may_cost_is_the_condition_number_squared() -> None:
    worst = 0.0
    for seed in audit.POSES:
        jacobian, weights, _ = audit.request(seed)
        j_a = audit.solve.rank_decomposition_svd(jacobian).j_a
        worst = max(worst, float(np.linalg.cond(np.sqrt(weights)[:, None] * j_a)) ** 2 * float(np.finfo(float).eps))
    assert 0.1 * audit.SQUARED < worst < audit.SQUARED


def test_only_eqs_16_and_17_are_refused_on_the_arm_of_fig_5(measured: dict[str, audit.Measured]) -> None:
    refused = {equation for equation, errors in measured.items() if errors["implemented"] is None}
    assert refused == {"16 on Fig. 5", "17 on Fig. 5"}


def test_an_answer_where_a_refusal_is_due_does_not_hold() -> None:
    assert audit.refused(lambda: np.zeros(1)) == np.inf

    def refuse() -> np.ndarray:
        raise InputError("not here")

    assert audit.refused(refuse) is None


def test_the_table_marks_a_row_whose_error_is_too_large() -> None:
    row = row_of("14")
    assert not table_1_equations.holds(row, {"printed": 0.0, "implemented": 2.0 * row.allowed})


def test_the_quick_table_needs_no_winding_and_has_every_row(measured: dict[str, audit.Measured]) -> None:
    (job,) = table_1_equations.jobs(QUICK)
    table = table_1_equations.build(QUICK, Results({Job(audit.measure).key: measured}))
    assert job == Job(audit.measure)
    assert [cells[0] for cells in table.rows] == [row.equation for row in audit.ROWS]
    assert all(cells[-1] is True for cells in table.rows)


# Wrong equations are found out


@pytest.mark.parametrize(
    ("equation", "name", "wrong"),
    [
        ("12", "weighted_optimum", lambda right: lambda j, w, x: 1.001 * right(j, w, x)),
        ("14", "weighted_optimum", lambda right: lambda j, w, x: right(j, np.sqrt(w), x)),
        ("13", "general_solution", lambda right: lambda j, x, r: right(j, x, 0.999 * r)),
        ("15", "resulting_displacement", lambda right: lambda j, w, x: right(j, w[::-1], x)),
        ("10", "weighted_cost", lambda right: lambda *a: 2.0 * right(*a)),
        ("16", "redundant_solution", lambda right: lambda j, x: right(j, x) + 1e-6),
        ("17", "overconstrained_solution", lambda right: lambda j, w, x: right(j, np.ones_like(w), x)),
    ],
)
def test_a_wrong_solve_is_found_out(
    equation: str, name: str, wrong: Callable[..., Callable[..., object]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(audit.solve, name, wrong(getattr(audit.solve, name)))
    assert error_of(equation) > row_of(equation).allowed


@pytest.mark.parametrize(
    ("equation", "name", "wrong"),
    [
        ("18", "desired_displacement", lambda alpha, before, now, **given: given["dt"] * alpha),
        ("18 (equilibria)", "driven_arms", lambda state: np.zeros(len(state), dtype=bool)),
        ("20 β", "into_plane", lambda sign, e: -sign * e),
        ("20 γ", "towards_object", lambda a, e: np.cross(e, a)),
        ("21", "side_sign", lambda a, e, band=plan.DEAD_BAND: -float(np.sign(a @ e))),
        ("22", "plane_normal", lambda a, c: np.cross(c, a)),
        ("22 (sign of c)", "plane_normal", lambda a, c: np.cross(c, a)),
    ],
)
def test_a_wrong_plan_is_found_out(
    equation: str, name: str, wrong: Callable[..., object], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(audit.plan, name, wrong)
    assert error_of(equation) > row_of(equation).allowed


@pytest.mark.parametrize(
    ("equation", "name", "factor"),
    [("2", "jacobian_of_inner_arm", 1.0 + 1e-9), ("4–5", "joint_torques", 1.0 + 1e-6), ("23", "winding_weights", 2.0)],
)
def test_a_wrong_scale_is_found_out(equation: str, name: str, factor: float, monkeypatch: pytest.MonkeyPatch) -> None:
    right = getattr(audit, name)
    monkeypatch.setattr(audit, name, lambda *arguments: factor * right(*arguments))
    assert error_of(equation) > row_of(equation).allowed


def test_weights_with_the_printed_order_of_indices_are_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(audit, "diagonal_of_weights", lambda weights, dimension: np.asarray(weights).T.ravel())
    assert error_of("11") > row_of("11").allowed


# The oracles themselves


def test_eqs_19_to_21_read_literally_have_zero_as_their_only_solution() -> None:
    for before, contact, _ in audit.scenes(20):
        assert np.abs(audit.self_defined_alpha(np.cross(before, contact))).max() == 0.0


def test_a_request_built_backwards_is_served_best_by_the_answer_it_was_built_from() -> None:
    matrix, weights = np.random.default_rng(1).normal(size=(7, 3)), np.arange(1.0, 8.0)
    desired, answer = audit.built_backwards(matrix, weights, 2)
    assert np.abs(matrix.T @ (weights * (desired - matrix @ answer))).max() < 1e-12
    assert np.abs(desired - matrix @ answer).max() > 0.1


@pytest.mark.parametrize("links", [1, 2, 4, 8])
def test_states_at_rest_are_those_in_which_contact_never_ends(links: int) -> None:
    assert len(audit.resting_states(links)) == links + 1


def test_eq_2_as_printed_is_worst_for_the_innermost_arm(measured: dict[str, audit.Measured]) -> None:
    inner = measured["2"]
    assert inner["printed"] is not None
    assert inner["printed"] > 10.0 * inner["printed_least"]


def test_rows_know_the_equations_they_audit() -> None:
    row = row_of("23")
    assert replace(row, equation="7–9").numbers == (7, 8, 9)
    assert replace(row, equation="22 (sign of c)").numbers == (22,)
