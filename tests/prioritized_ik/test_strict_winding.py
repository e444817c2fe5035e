"""Winding with strict levels in place of the weights of Eqs. (23) and (24)."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from winding_fixtures import QP_ONLY, By, recorded

from prioritized_ik.errors import EpisodeFileError, InputError
from prioritized_ik.models import DIRECTIONS
from prioritized_ik.problem import IKProblem, Level
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.weights import winding_priorities
from prioritized_ik.winding.controller import WindingController, levels_of
from prioritized_ik.winding.episode import Episode, Outcome, replay, wind
from prioritized_ik.winding.metrics import measure
from prioritized_ik.winding.plan import first_and_last_in_contact
from prioritized_ik.winding.settings import WindingSettings

DAQP = get_method("daqp")
NEARLY = 1e-6  # of the target's square: what solvers at accuracy 1e-8 leave, and ten times as much again


@cache
def short_episode() -> Episode:
    return wind(WindingSettings(weights="strict", max_steps=30))


def posed(in_contact: list[int]) -> tuple[IKProblem, IKProblem]:
    """The strict problem and that of Eq. (23) of one and the same state, with these links in contact."""
    problems = []
    for weights in ("strict", "eq23"):
        settings = WindingSettings(weights=weights, posture="arched")
        controller = WindingController(settings)
        q = settings.initial_posture()
        situation = controller.observe(q, np.zeros(17, dtype=bool))
        contact = np.isin(np.arange(1, 18), in_contact)
        first, last = first_and_last_in_contact(contact)
        situation = replace(situation, in_contact=contact, first=first, last=last)
        problems.append(controller.problem(q, situation))
    return problems[0], problems[1]


@pytest.mark.parametrize(
    ("in_contact", "arms"),
    [
        ([6], [range(1, 7), range(7, 8), range(8, 18)]),
        ([6, 7, 8], [range(1, 9), range(9, 10), range(10, 18)]),
        ([6, 7, 9], [range(1, 8), range(8, 9), range(9, 18)]),  # a gap ends the succession
        (range(6, 16), [range(1, 16), range(16, 17), range(17, 18)]),
        (range(6, 17), [range(1, 17), range(17, 18)]),
        (range(6, 18), [range(1, 18)]),
        ([], [range(1, 2), range(2, 18)]),  # as the weights have it: arm 1 is next
    ],
    ids=str,
)
def test_the_levels_are_the_wound_arms_then_the_next_then_the_rest(in_contact, arms):
    problem, weighted = posed(in_contact)
    stacked = weighted.levels[0]
    assert len(problem.levels) == len(arms)
    for level, numbers in zip(problem.levels, arms, strict=True):
        rows = slice(3 * numbers[0] - 3, 3 * numbers[-1])
        assert np.array_equal(level.matrix, stacked.matrix[rows])
        assert np.array_equal(level.target, stacked.target[rows])
        assert (level.weights == 1.0).all()
        name = f"virtual arms {numbers[0]} to {numbers[-1]}" if len(numbers) > 1 else f"virtual arm {numbers[0]}"
        assert level.name == name


def test_limits_and_contacts_are_those_of_the_weighted_problem():
    problem, weighted = posed([6])
    assert np.array_equal(problem.inequalities.matrix, weighted.inequalities.matrix)
    assert np.array_equal(problem.inequalities.upper, weighted.inequalities.upper)
    assert problem.inequalities.names == weighted.inequalities.names


def test_a_weighted_episode_is_all_in_one_level():
    assert not recorded().priorities.any()
    assert len(recorded().problem(100).levels) == 1


def bits(problem: IKProblem) -> list[object]:
    parts = [(level.name, level.matrix, level.target, level.weights) for level in problem.levels]
    limits = (problem.bounds.lower, problem.bounds.upper, problem.rows.matrix, problem.rows.upper, problem.reference)
    arrays = [array for part in parts for array in part[1:]] + list(limits)
    names = [part[0] for part in parts] + [problem.bounds.names, problem.rows.names]
    return [(array.dtype, array.shape, array.tobytes()) for array in arrays] + names


def test_problems_of_a_saved_episode_are_those_that_were_posed(tmp_path):
    seen = []

    def solve(problem, q):
        seen.append(problem)
        return DAQP.step(problem, QP_ONLY)

    wind(WindingSettings(weights="strict", link=14, tilt=0.3, max_steps=60), By(solve)).save(tmp_path / "strict.npz")
    loaded = Episode.load(tmp_path / "strict.npz")
    assert {len(problem.levels) for problem in seen} == {2, 3}  # 2 once link 16 touches
    assert [bits(problem) for problem in loaded.problems()] == [bits(problem) for problem in seen]


def test_a_saved_strict_episode_replays_bit_for_bit(tmp_path):
    short_episode().save(tmp_path / "strict.npz")
    loaded = Episode.load(tmp_path / "strict.npz")
    again = replay(loaded)
    for name in ("q", "dtheta", "jacobian", "desired", "weights", "priorities", "row_upper"):
        assert getattr(again, name).tobytes() == getattr(loaded, name).tobytes(), name
    assert again.priorities.max() == 2


BROKEN = {
    "not from 0": lambda p: p + 1,
    "a number left out": lambda p: 2 * p,
    "falling": lambda p: p[:, ::-1],
    "no integers": lambda p: p.astype(float),
}


@pytest.mark.parametrize("broken", BROKEN.values(), ids=BROKEN.keys())
def test_a_file_whose_rows_belong_to_no_such_levels_is_refused(broken, tmp_path):
    path = tmp_path / "strict.npz"
    episode = short_episode()
    replace(episode, priorities=broken(episode.priorities)).save(path)
    with pytest.raises(EpisodeFileError, match="priorities are not whole numbers that start at 0"):
        Episode.load(path)


def test_a_file_from_before_there_were_levels_is_refused_as_of_another_format(tmp_path):
    path = tmp_path / "old.npz"
    short_episode().save(path)
    with np.load(path) as file:
        content = {name: file[name] for name in file.files if name != "priorities"}
    np.savez(path, **(content | {"format": np.array("prioritized-ik episode 1")}))
    with pytest.raises(EpisodeFileError, match=r"has the format 'prioritized-ik episode 1'; expected .*Record it anew"):
        Episode.load(path)


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_strict_levels_wind_from_every_direction(direction):
    # Tilted, so that the arm leaves its plane by more than rounding; see the next test.
    episode = wind(WindingSettings(direction=direction, weights="strict", link=12, tilt=0.3))
    figures = measure(episode)
    assert episode.outcome is Outcome.WOUND
    assert figures.turns_ratio >= 0.95
    assert figures.penetration <= 1.5e-3
    assert figures.hinge_excess <= 1e-6


def test_in_a_plane_that_its_hinge_stands_in_the_last_link_waits_for_ever():
    # Wound upwards from straight, the arm stays in the plane of its last hinge: only wound arms could move link 17 to the
    # object. Weights let them give way a little, strict levels never.
    episode = wind(WindingSettings(weights="strict", link=14, max_steps=120))
    assert episode.outcome is Outcome.OUT_OF_STEPS
    assert episode.in_contact[-1].tolist() == [False] * 13 + [True] * 3 + [False]
    assert np.abs(episode.dtheta[-1]).max() <= 1e-12
    next_arm = episode.problem(episode.steps - 1).levels[1]
    assert next_arm.cost(episode.dtheta[-1]) == pytest.approx(next_arm.target @ next_arm.target)
    assert wind(WindingSettings(weights="eq23", link=14, max_steps=120)).outcome is Outcome.WOUND


def in_strict_levels(problem: IKProblem, in_contact: np.ndarray) -> IKProblem:
    """The strict problem of the state at which `problem` was posed with weights."""
    (level,) = problem.levels
    _, last = first_and_last_in_contact(in_contact)
    levels = levels_of(level.matrix, level.target, np.ones(51), np.repeat(winding_priorities(last, 17), 3))
    return IKProblem(levels, problem.bounds, problem.rows)


@pytest.mark.parametrize("step", range(10, 290, 20))
def test_the_wound_arms_move_no_more_than_with_the_weights_of_eq23(step):
    weighted = recorded().problem(step)
    problem = in_strict_levels(weighted, recorded().in_contact[step])
    first = problem.levels[0]
    ours = DAQP.step(problem, QP_ONLY).dtheta
    theirs = DAQP.step(weighted, QP_ONLY).dtheta
    assert first.cost(ours) <= first.cost(theirs) + NEARLY * (weighted.levels[0].target @ weighted.levels[0].target)


@pytest.mark.parametrize("step", range(10, 290, 40))
def test_the_tail_takes_nothing_from_the_levels_above_whatever_it_asks(step):
    problem = in_strict_levels(recorded().problem(step), recorded().in_contact[step])
    *above, tail = problem.levels
    greedy = Level(tail.matrix, np.random.default_rng(step).normal(scale=1.0, size=len(tail.target)), tail.weights)
    alone = DAQP.step(IKProblem(above, problem.bounds, problem.rows), QP_ONLY).dtheta
    after = DAQP.step(IKProblem([*above, greedy], problem.bounds, problem.rows), QP_ONLY).dtheta
    assert np.linalg.norm(after - alone) > 1e-3  # it does pull
    for level in above:
        assert level.cost(after) <= level.cost(alone) + NEARLY * (above[1].target @ above[1].target)


def test_a_damped_solve_of_strict_levels_is_refused():
    settings = WindingSettings(weights="strict", solver="damped:daqp", options=QP_ONLY)
    with pytest.raises(InputError, match="the damped formulation takes one level, not 3"):
        wind(settings)


@pytest.mark.parametrize("weights", ["eq23", "eq24", "strict"])
def test_no_step_of_the_eight_windings_is_left_undecided(weights):
    for tilt in (0.0, 0.3):
        for direction in DIRECTIONS:
            episode = wind(WindingSettings(direction=direction, tilt=tilt, weights=weights))
            assert episode.outcome is Outcome.WOUND
            assert set(episode.status) <= {"SOLVED", "CLOSED_FORM"}
