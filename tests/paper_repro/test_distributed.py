"""The plan by a process a link: the same bits, and no more told than a link can know."""

from collections.abc import Iterator

import numpy as np
import pytest

from paper_repro.measure import distributed
from paper_repro.measure.distributed import DistributedPlan
from prioritized_ik.winding.plan import first_and_last_in_contact, plan

LINKS = 17
GIVEN = {"speed": 2.0, "dt": 2e-3, "dead_band": 0.05}


@pytest.fixture(scope="module")
def processes() -> Iterator[DistributedPlan]:
    with DistributedPlan(LINKS, **GIVEN) as found:
        yield found


def readings(seed: int, likely: float = 0.5) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    vectors = rng.normal(size=(2, LINKS, 3))
    vectors /= np.linalg.norm(vectors, axis=2, keepdims=True)
    touching = rng.random(LINKS) < likely
    return vectors[0], np.where(touching[:, None], vectors[1], 0.0), touching


@pytest.mark.parametrize("likely", [0.0, 0.2, 0.5, 0.8, 1.0])
def test_a_process_a_link_plans_the_same_bits_as_the_plan_in_one_place(processes: DistributedPlan, likely: float) -> None:
    for seed in range(20):
        state = readings(seed, likely)
        desired, signs, k = processes.step(*state)
        expected, expected_signs = plan(*state, **GIVEN)
        assert desired.tobytes() == expected.tobytes()
        assert signs.tobytes() == expected_signs.tobytes()
        assert k == first_and_last_in_contact(state[2])[1]


def test_a_step_takes_one_message_between_neighbours_a_sweep_and_one_to_the_solve(processes: DistributedPlan) -> None:
    before = processes.messages.copy()
    processes.step(*readings(1))
    assert processes.messages - before == {
        "reading to the next link": LINKS - 1,
        "contact so far to the next link": LINKS - 1,
        "k to the link before": LINKS - 1,
        "dX* to the solve": LINKS,
    }


def test_links_further_than_a_neighbour_change_nothing_but_k(processes: DistributedPlan) -> None:
    directions, contacts, touching = readings(2)
    desired, *_ = processes.step(directions, contacts, touching)
    other = [array.copy() for array in readings(3)]
    for array, own in zip(other, (directions, contacts, touching), strict=True):
        array[7:9] = own[7:9]
    changed, *_ = processes.step(*other)
    assert changed[8].tobytes() == desired[8].tobytes()
    assert changed.tobytes() != desired.tobytes()


def test_a_plan_with_other_settings_is_told_apart_by_its_bits() -> None:
    """Sabotage: the comparison is not of two copies of one answer."""
    state = readings(4)
    with DistributedPlan(LINKS, **{**GIVEN, "dead_band": 0.9}) as wrong:
        desired, signs, _ = wrong.step(*state)
    expected, expected_signs = plan(*state, **GIVEN)
    assert signs.tobytes() != expected_signs.tobytes()
    assert desired.tobytes() != expected.tobytes()


def test_theprocesses_end_with_their_plan() -> None:
    with DistributedPlan(3, **GIVEN) as found:
        alive = list(found.processes)
        assert all(process.is_alive() for process in alive)
    assert not any(process.is_alive() for process in alive)
    assert distributed.NUMBER == np.dtype(float).itemsize
