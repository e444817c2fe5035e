"""Numbers of twice the digits against rational ones."""

from fractions import Fraction

import numpy as np
import pytest

from prioritized_ik.double_double import DoubleDouble
from prioritized_ik.tolerances import FINEST


def drawn(rng: np.random.Generator, *shape: int) -> DoubleDouble:
    """Numbers of every size from 1e-12 to 1e12, with all their digits."""
    high = rng.normal(size=shape) * 10.0 ** rng.uniform(-12, 12, shape)
    return DoubleDouble(high, high * rng.uniform(-0.5, 0.5, shape) * 2.0**-53)


def rational(numbers: DoubleDouble) -> np.ndarray:
    exactly = np.vectorize(Fraction, otypes=[object])
    return exactly(numbers.high) + exactly(numbers.low)


@pytest.mark.parametrize("seed", range(20))
def test_products_are_right_to_their_bound(seed):
    rng = np.random.default_rng(seed)
    k, m, n = rng.integers(1, 12, 3)
    a, b = drawn(rng, k, m), drawn(rng, m, n)
    off = np.abs(rational(a @ b) - rational(a) @ rational(b))
    allowed = FINEST * m * np.abs(a.high).max(axis=1)[:, None] * np.abs(b.high).max(axis=0)
    assert (off <= allowed).all()
    assert (off > 0.0).any()  # the bound is of something


def test_products_of_doubles_keep_what_doubles_lose():
    rng = np.random.default_rng(0)
    a = rng.normal(size=(4, 300))
    b = np.linalg.qr(a.T, mode="complete")[0][:, 4:]  # orthogonal to a but for rounding
    left = (DoubleDouble.of(a) @ DoubleDouble.of(b)).rounded
    exactly = np.vectorize(Fraction, otypes=[object])
    wanted = (exactly(a) @ exactly(b[:, :3])).astype(float)
    assert np.allclose(left[:, :3], wanted, rtol=1e-9, atol=0.0)
    assert not np.allclose((a @ b)[:, :3], wanted, rtol=1e-2, atol=0.0)


def test_sums_and_products_by_doubles_are_right_to_thirty_digits():
    rng = np.random.default_rng(1)
    a, b, factors = drawn(rng, 5, 7), drawn(rng, 5, 7), rng.normal(size=(5, 1))
    exactly = np.vectorize(Fraction, otypes=[object])
    for found, wanted, terms in (
        (a + b, rational(a) + rational(b), np.abs(a.high) + np.abs(b.high)),
        (a - b, rational(a) - rational(b), np.abs(a.high) + np.abs(b.high)),
        (a.times(factors), rational(a) * exactly(factors), np.abs(a.high * factors)),
    ):
        assert (np.abs(rational(found) - wanted) <= 2.0**-100 * terms).all()


def test_nothing_times_nothing_is_zeros():
    assert (DoubleDouble.of(np.zeros((2, 0))) @ DoubleDouble.of(np.zeros((0, 3)))).rounded.tolist() == [[0.0] * 3] * 2
    assert (DoubleDouble.of(np.zeros((0, 2))) @ DoubleDouble.of(np.zeros((2, 3)))).rounded.shape == (0, 3)
