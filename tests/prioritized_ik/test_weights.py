"""Priorities as weights, Eqs. (11), (23), (24), and as strict levels."""

import numpy as np
import pytest

from prioritized_ik.errors import InputError
from prioritized_ik.weights import diagonal_of_weights, winding_priorities, winding_weights


@pytest.mark.parametrize(("kind", "free"), [("eq23", 0.01), ("eq24", 1.0)])
def test_eqs_23_and_24_weigh_wound_next_and_free_arms(kind: str, free: float) -> None:
    assert winding_weights(3, 6, kind).tolist() == [200.0, 200.0, 200.0, 20.0, free, free]


def test_eq23_is_the_default() -> None:
    assert np.array_equal(winding_weights(3, 6), winding_weights(3, 6, "eq23"))


@pytest.mark.parametrize(
    ("last", "expected"),
    [
        (0, [20.0, 0.01, 0.01, 0.01]),
        (1, [200.0, 20.0, 0.01, 0.01]),
        (3, [200.0, 200.0, 200.0, 20.0]),
        (4, [200.0, 200.0, 200.0, 200.0]),
    ],
)
def test_eq23_at_every_edge_of_the_arm(last: int, expected: list[float]) -> None:
    assert winding_weights(last, 4).tolist() == expected


@pytest.mark.parametrize(
    ("last", "expected"),
    [
        (0, [0, 1, 1, 1]),  # arm 1 is next, as the weights have it
        (1, [0, 1, 2, 2]),
        (2, [0, 0, 1, 2]),
        (3, [0, 0, 0, 1]),
        (4, [0, 0, 0, 0]),
    ],
)
def test_strict_levels_at_every_edge_of_the_arm_leave_no_number_out(last: int, expected: list[int]) -> None:
    assert winding_priorities(last, 4).tolist() == expected


@pytest.mark.parametrize("last", range(18))
def test_arms_share_a_strict_level_where_eq23_weighs_them_alike(last: int) -> None:
    weights, priorities = winding_weights(last, 17), winding_priorities(last, 17)
    assert np.array_equal(np.diff(weights) != 0.0, np.diff(priorities) != 0)
    assert (np.diff(priorities) >= 0).all()  # the heavier come first


def test_arms_of_a_strict_level_weigh_the_same() -> None:
    assert winding_weights(3, 6, "strict").tolist() == [1.0] * 6


@pytest.mark.parametrize("last", range(5))
def test_trailing_arms_are_those_that_eq23_holds_and_weigh_nothing(last: int) -> None:
    held = winding_weights(last, 4) == 0.01
    assert winding_weights(last, 4, "trailing").tolist() == np.where(held, 0.0, winding_weights(last, 4)).tolist()


@pytest.mark.parametrize("kind", ["eq23", "eq24", "trailing"])
def test_weights_leave_every_arm_in_one_level(kind: str) -> None:
    assert winding_priorities(3, 6, kind).tolist() == [0] * 6


def test_eq11_repeats_an_arms_weight_over_its_axes_and_puts_arms_one_after_another() -> None:
    assert diagonal_of_weights([1.0, 2.0], 3).tolist() == [1.0, 1.0, 1.0, 2.0, 2.0, 2.0]


def test_eq11_takes_a_weight_for_each_arm_and_axis() -> None:
    assert diagonal_of_weights([[1.0, 2.0], [3.0, 4.0]], 2).tolist() == [1.0, 2.0, 3.0, 4.0]


def test_eq11_with_its_printed_indices_would_order_the_rows_otherwise() -> None:
    table = np.array([[1.0, 2.0], [3.0, 4.0]])
    assert diagonal_of_weights(table.T, 2).tolist() != diagonal_of_weights(table, 2).tolist()


def test_the_diagonal_fits_the_stacked_rows_of_the_paper_arm() -> None:
    assert diagonal_of_weights(winding_weights(6, 17), 3).shape == (51,)


@pytest.mark.parametrize("bad", [0.0, -1.0])
def test_a_weight_that_is_not_positive_is_refused_at_its_place(bad: float) -> None:
    with pytest.raises(InputError, match=rf"arm_weights\[1\] is {bad}; expected numbers above 0"):
        diagonal_of_weights([1.0, bad], 3)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_weight_that_is_not_finite_is_refused_at_its_place(bad: float) -> None:
    with pytest.raises(InputError, match=rf"arm_weights\[1\] is {bad}"):
        diagonal_of_weights([1.0, bad], 3)


def test_more_links_in_contact_than_there_are_is_refused() -> None:
    for rule in (winding_weights, winding_priorities):
        with pytest.raises(InputError, match="last_in_contact is 7; expected at most the number of links, 6"):
            rule(7, 6)


def test_weights_of_another_dimension_are_refused() -> None:
    with pytest.raises(InputError, match=r"arm_weights has shape \(2, 2\); expected \(any, 3\)"):
        diagonal_of_weights([[1.0, 2.0], [3.0, 4.0]], 3)


def test_a_dimension_below_one_is_refused() -> None:
    with pytest.raises(InputError, match="dimension is 0"):
        diagonal_of_weights([1.0], 0)


def test_an_unknown_kind_of_weights_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InputError, match="unknown weights 'eq25'; choose one of: eq23, eq24, strict, trailing"):
        winding_weights(3, 6, "eq25")
    with pytest.raises(InputError, match="unknown weights 'eq25'; choose one of: eq23, eq24, strict, trailing"):
        winding_priorities(3, 6, "eq25")


@pytest.mark.parametrize("last", [-1, 1.5])
def test_a_contact_that_is_no_link_number_is_refused(last: float) -> None:
    with pytest.raises(InputError, match=f"last_in_contact is {last}"):
        winding_weights(last, 6)


def test_an_arm_without_links_is_refused() -> None:
    with pytest.raises(InputError, match="links is 0"):
        winding_weights(0, 0)
