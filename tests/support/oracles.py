"""Requests as in winding, and answers to them that share no code with the library's solvers."""

from collections.abc import Iterator

import numpy as np
from arms import Bench

from prioritized_ik.solvers.closed_form import RankDecomposition, minimum_norm_solution, weighted_optimum
from prioritized_ik.weights import diagonal_of_weights, winding_weights

Request = tuple[np.ndarray, np.ndarray, np.ndarray]


def norm_error(found: np.ndarray, truth: np.ndarray) -> float:
    """How far a vector is off, relative to the true one."""
    return float(np.linalg.norm(found - truth) / np.linalg.norm(truth))


def requests(bench: Bench, kind: str, count: int, seed: int) -> Iterator[Request]:
    """J, diag W and dX* as in winding: links 1 … k hold the object and arm k + 1 alone is asked to move 4 mm."""
    rng = np.random.default_rng([seed, len(kind)])
    for q in bench.general_poses(count, seed):
        k = int(rng.integers(1, 17))
        desired = np.zeros((17, 3))
        desired[k] = rng.normal(size=3)
        desired *= 4e-3 / np.linalg.norm(desired)
        yield bench.jacobian(q), diagonal_of_weights(winding_weights(k, 17, kind), 3), desired.ravel()


def eqs_12_and_14(factors: RankDecomposition, weights: np.ndarray, desired: np.ndarray) -> np.ndarray:
    return minimum_norm_solution(factors.j_b, weighted_optimum(factors.j_a, weights, desired))


def svd_oracle(jacobian: np.ndarray, weights: np.ndarray, desired: np.ndarray) -> np.ndarray:
    """(W^½J)⁺ W^½ dX* of rank 34."""
    root = np.sqrt(weights)
    u, s, vt = np.linalg.svd(root[:, None] * jacobian)
    return vt[:34].T @ ((u[:, :34].T @ (root * desired)) / s[:34])
