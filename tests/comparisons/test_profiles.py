"""The summaries of times and successes are those of the literature, worked out by hand here."""

import math

import numpy as np
import polars
import pytest

from comparisons.profiles import SHIFT, per_problem, performance_profiles, shifted_geometric_mean, success
from prioritized_ik.errors import InputError

INF = math.inf


def test_the_shifted_geometric_mean_of_equal_times_is_that_time() -> None:
    assert shifted_geometric_mean([3e-3, 3e-3, 3e-3]) == pytest.approx(3e-3)
    assert math.isnan(shifted_geometric_mean([]))


def test_the_shifted_geometric_mean_by_hand() -> None:
    assert shifted_geometric_mean([1.0, 7.0], shift=1.0) == pytest.approx(math.sqrt(2 * 8) - 1)
    assert SHIFT == 1e-3
    tiny, small = shifted_geometric_mean([1e-9, 1e-2]), shifted_geometric_mean([1e-5, 1e-2])
    assert tiny == pytest.approx(small, rel=0.02), "the shift keeps the quickest from deciding"


def test_the_performance_profile_by_hand() -> None:
    times = [[1.0, 2.0], [3.0, 1.0], [1.0, INF], [INF, INF]]
    found = performance_profiles(times, ["a", "b"])
    a, b = found.filter(name="a"), found.filter(name="b")
    assert a.rows() == [("a", 1.0, 0.5), ("a", 3.0, 0.75)]
    assert b.rows() == [("b", 1.0, 0.25), ("b", 2.0, 0.5)]


def test_a_profile_rises_and_ends_at_the_fraction_solved() -> None:
    rng = np.random.default_rng(0)
    times = rng.uniform(1.0, 2.0, (50, 3))
    times[rng.random(times.shape) < 0.3] = INF
    found = performance_profiles(times, ["a", "b", "c"])
    for number, name in enumerate("abc"):
        mine = found.filter(name=name)
        assert mine["ratio"].is_sorted()
        assert mine["fraction"].is_sorted()
        assert mine["fraction"][-1] == pytest.approx(np.isfinite(times[:, number]).mean())
    assert found.filter(ratio=1.0)["fraction"].sum() == pytest.approx(np.isfinite(times).any(axis=1).mean())


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([[1.0, 2.0, 3.0]], "shape"),
        ([1.0, 2.0], "shape"),
        ([[0.0, 1.0]], "not above 0"),
        ([[math.nan, 1.0]], "not above 0"),
    ],
)
def test_times_that_are_none_are_refused(times: list[float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        performance_profiles(times, ["a", "b"])


def steps() -> polars.DataFrame:
    step = {"case": "up", "formulation": "lexicographic", "accuracy": 1e-8, "start": "cold", "build_s": 1.0, "found": True,
            "dx_error": 0.0, "certified_dx_error": None}  # fmt: skip
    free = {**step, "free": True, "step": 0}
    bound = {**step, "free": False, "step": 1, "dtheta_error": None, "dx_error": None}
    rows = [
        *({**free, "solver": "a", "repeat": n, "solve_s": s, "dtheta_error": 1e-9} for n, s in enumerate((1.0, 2.0, 99.0))),
        {**free, "solver": "b", "repeat": 0, "solve_s": 5.0, "dtheta_error": 1e-4},
        {**bound, "solver": "a", "repeat": 0, "solve_s": 3.0, "certified_dx_error": 1e-7},
        {**bound, "solver": "b", "repeat": 0, "solve_s": 0.0, "certified_dx_error": None, "found": False},
    ]
    return polars.DataFrame(rows, infer_schema_length=None)


def test_success_counts_steps_right_within_each_tolerance() -> None:
    found = success(steps(), (1e-8, 1e-6, 1e-3))
    fractions = {(row["solver"], row["tolerance"]): row["fraction"] for row in found.iter_rows(named=True)}
    assert fractions == {
        ("a", 1e-8): 0.75, ("a", 1e-6): 1.0, ("a", 1e-3): 1.0, ("b", 1e-8): 0.0, ("b", 1e-6): 0.0, ("b", 1e-3): 0.5,
    }  # fmt: skip


def test_the_time_of_a_problem_is_the_median_over_its_repeats() -> None:
    assert sorted(per_problem(steps().filter(solver="a"))) == [3.0, 4.0]
