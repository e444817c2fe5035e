"""A live problem is the problem that one would make anew from the same numbers, to the last bit."""

import pickle

import numpy as np
import pytest
from winding_fixtures import recorded

from prioritized_ik.errors import InputError
from prioritized_ik.live import LiveProblem
from prioritized_ik.packed import Parts
from prioritized_ik.problem import Bounds, Equalities, IKProblem, Level, Rows, replaced
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.registry import get_method

CUT = SolveOptions(rank_tolerance=RANK_TOLERANCE)
M = 5


def numbers(seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    half = rng.uniform(0.1, 0.5, M)
    return {
        "A": rng.normal(size=(2, M)), "a": rng.normal(size=2), "w": rng.uniform(0.1, 2.0, 2),
        "B": rng.normal(size=(3, M)), "b": rng.normal(size=3),
        "low": -half, "high": half, "G": rng.normal(size=(2, M)), "h": np.array([0.1, np.inf]),
        "E": rng.normal(size=(1, M)), "e": np.array([0.01]), "r": rng.normal(size=M),
    }  # fmt: skip


def fresh(n: dict[str, np.ndarray]) -> IKProblem:
    return IKProblem(
        [Level(n["A"], n["a"], n["w"], name="hands"), Level(n["B"], n["b"], name="feet", damping=0.01, below="hold")],
        Bounds(n["low"], n["high"]),
        Rows(n["G"], n["h"]),
        n["r"],
        Equalities(n["E"], n["e"]),
        metric=np.arange(1.0, M + 1.0),
    )


def written(live: LiveProblem, n: dict[str, np.ndarray]) -> None:
    live.matrix("hands")[:], live.target("hands")[:], live.weights("hands")[:] = n["A"], n["a"], n["w"]
    live.matrix(1)[:], live.target(1)[:] = n["B"], n["b"]
    live.lower[:], live.upper[:], live.reference[:] = n["low"], n["high"], n["r"]
    live.row_matrix[:], live.row_upper[:] = n["G"], n["h"]
    live.equality_matrix[:], live.equality_target[:] = n["E"], n["e"]


def test_it_has_the_steps_of_problems_made_anew_to_the_last_bit():
    live = LiveProblem(fresh(numbers(0)))
    warm, other = get_method("active-set"), get_method("active-set")
    for seed in range(30):
        written(live, numbers(seed))
        step, wanted = (
            warm.step(live.frozen(), SolveOptions()),
            other.step(fresh(numbers(seed)), SolveOptions()),
        )
        assert step.dtheta.tobytes() == wanted.dtheta.tobytes()
        assert step.certificate == wanted.certificate
        assert (step.tight_rows, step.status, step.costs) == (wanted.tight_rows, wanted.status, wanted.costs)


def test_it_winds_like_problems_made_anew():
    problems = list(recorded("up").problems(range(40)))
    live = LiveProblem(problems[0])
    for problem in problems:
        if problem.rows.names != problems[0].rows.names:
            continue
        live.matrix(0)[:], live.target(0)[:], live.weights(0)[:] = (
            problem.levels[0].matrix,
            problem.levels[0].target,
            problem.levels[0].weights,
        )
        live.lower[:], live.upper[:] = problem.bounds.lower, problem.bounds.upper
        live.row_matrix[:], live.row_upper[:] = problem.rows.matrix, problem.rows.upper
        one, other = (get_method("active-set").step(p, CUT) for p in (live.frozen(), problem))
        assert one.dtheta.tobytes() == other.dtheta.tobytes()


def test_what_is_frozen_does_not_change_with_the_arrays():
    live = LiveProblem(fresh(numbers(0)))
    before = live.frozen()
    written(live, numbers(1))
    assert (before.levels[0].matrix == numbers(0)["A"]).all()
    assert (live.frozen().levels[0].matrix == numbers(1)["A"]).all()
    with pytest.raises(ValueError, match="read-only"):
        before.levels[0].matrix[0, 0] = 1.0


def test_the_first_problem_does_not_change_with_the_arrays():
    first = fresh(numbers(0))
    written(LiveProblem(first), numbers(1))
    assert (first.levels[0].matrix == numbers(0)["A"]).all()


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda live: live.matrix("hands").__setitem__((0, 1), np.nan), r"matrix of level 'hands'\[0, 1\] is nan"),
        (lambda live: live.target("feet").__setitem__(2, np.inf), r"target of level 'feet'\[2\] is inf"),
        (lambda live: live.weights("hands").__setitem__(1, -1.0), r"weights of level 'hands'\[1\] is -1.0"),
        (lambda live: live.lower.__setitem__(3, 9.0), "'joint 4 lower' is 9.0, above 'joint 4 upper'"),
        (lambda live: live.upper.__setitem__(0, np.nan), r"upper bounds\[0\] is nan"),
        (lambda live: live.row_upper.__setitem__(0, -np.inf), "upper side of rows"),
        (lambda live: live.row_matrix.__setitem__(0, 1e200), "choose other units"),
        (lambda live: live.equality_target.__setitem__(0, np.nan), r"target of equalities\[0\] is nan"),
        (lambda live: live.equality_matrix.__setitem__(0, 0.0), "equality 1 is all zero"),
    ],
)
def test_what_no_problem_may_hold_is_refused_as_the_problem_would(spoil, message):
    live = LiveProblem(fresh(numbers(0)))
    spoil(live)
    with pytest.raises(InputError, match=message):
        live.frozen()


def test_an_array_is_written_in_place_and_not_replaced():
    live = LiveProblem(fresh(numbers(0)))
    with pytest.raises(AttributeError):
        live.lower = np.zeros(M)
    assert (live.matrix()[2:] == live.matrix("feet")).all()
    assert np.shares_memory(live.matrix(), live.matrix("hands"))
    assert live.matrix("feet").flags.c_contiguous


def test_a_level_that_is_not_there_is_refused_with_those_that_are():
    live = LiveProblem(fresh(numbers(0)))
    for unknown in ("head", 2, -3):
        with pytest.raises(InputError, match=f"there is no level {unknown!r}; there are: 'hands', 'feet'"):
            live.target(unknown)


def test_zero_rows_that_every_step_keeps_are_accepted():
    live = LiveProblem(fresh(numbers(0)))
    live.row_matrix[0] = 0.0
    live.equality_matrix[:], live.equality_target[:] = 0.0, 0.0
    assert not live.frozen().rows.matrix[0].any()


def test_it_is_made_of_a_problem():
    with pytest.raises(InputError, match="expected an IKProblem with the shapes to keep"):
        LiveProblem([Level(np.eye(2), np.ones(2))])


def test_what_is_frozen_goes_to_another_process_as_a_plain_problem():
    live = LiveProblem(fresh(numbers(0)))
    written(live, numbers(1))
    frozen = live.frozen()
    sent = pickle.loads(pickle.dumps(frozen))
    assert type(sent) is IKProblem
    assert_same(sent, fresh(numbers(1)))
    assert_same(frozen, fresh(numbers(1)))
    assert type(replaced(frozen, noise=1e-6)) is IKProblem


def assert_same(one: IKProblem, other: IKProblem) -> None:
    for part, same in zip(Parts.of(one), Parts.of(other), strict=True):
        assert part.tobytes() == same.tobytes()
    assert [level.name for level in one.levels] == [level.name for level in other.levels]
    assert (one.metric == other.metric).all()


@pytest.mark.skipif(get_method("active-set").path == "python", reason="the Python form looks at the parts")
def test_a_solve_takes_the_numbers_as_they_are_without_parting_them():
    frozen = LiveProblem(fresh(numbers(0))).frozen()
    step = get_method("active-set").step(frozen)
    assert step.path == "compiled"
    assert vars(frozen).keys() == {"layout", "memory"}
