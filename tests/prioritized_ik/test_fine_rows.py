"""Products with J and Jᵀ along the links with twice the digits, against 150."""

import decimal
from decimal import Decimal

import digits
import numpy as np
import pytest
from trees import end_points, random_tree

from prioritized_ik.double_double import DoubleDouble
from prioritized_ik.kinematic_tree import BASE, PointRows
from prioritized_ik.solvers.tree.fine_rows import FineRows

FINE = 1e-28  # [of the terms]


def _points(seed: int) -> PointRows:
    rng = np.random.default_rng(seed)
    tree = random_tree(rng, 30, branching=0.2 * (seed % 2))
    points = end_points(tree, rng)
    joints = points.joints.copy()
    joints[-1] = BASE
    return PointRows(tree, joints, points.points, points.directions)


def _off(found: DoubleDouble, exact: np.ndarray, terms: np.ndarray) -> float:
    """The worst error [of the terms]."""
    both = zip(found.high.tolist(), found.low.tolist(), exact, strict=True)
    errors = [abs(float(Decimal(high) + Decimal(low) - value)) for high, low, value in both]
    return float(np.max(np.array(errors) / terms.astype(float).max()))


@pytest.mark.parametrize("seed", range(770200, 770206))
def test_products_have_twice_the_digits_of_doubles(seed):
    points, rng = _points(seed), np.random.default_rng(seed)
    u, values = rng.normal(size=points.tree.joint_count), rng.normal(size=len(points))
    fine, low = FineRows(points), 1e-17 * rng.normal(size=len(points))
    with decimal.localcontext() as context:
        context.prec = 150
        matrix = digits._rows(points)
        moved, turned = matrix @ digits._exact(u), matrix.T @ (digits._exact(values) + digits._exact(low))
        assert _off(fine.times(u), moved, abs(matrix) @ abs(digits._exact(u))) < FINE
        found = fine.transposed_times(DoubleDouble(values, low))
        assert _off(found, turned, abs(matrix.T) @ abs(digits._exact(values))) < FINE
    assert float(fine.times(u).high[-1]) == 0.0  # a point that stands still
