"""A problem survives its file, and a file that is none is refused."""

import io
from pathlib import Path

import numpy as np
import pytest
from trees import random_problem, random_tree

from prioritized_ik.errors import InputError
from prioritized_ik.problem import Bounds, Equalities, IKProblem, Level, Rows
from prioritized_ik.problem_file import load_problem, problem_bytes, save_problem
from prioritized_ik.tree_problem import tree_of


@pytest.fixture
def problem() -> IKProblem:
    rng = np.random.default_rng(3)
    return IKProblem(
        [
            Level(rng.normal(size=(3, 5)), rng.normal(size=3), [1.0, 2.0, 200.0], name="hand"),
            Level(rng.normal(size=(1, 5)), [0.5], name="wall", kind="at_most"),
            Level(rng.normal(size=(1, 5)), [0.2], name="calm", damping=1e-3, below="hold"),
        ],
        Bounds([-np.inf, -0.1, -0.1, -0.1, -0.1], [0.1, 0.1, 0.1, 0.1, np.inf], ["a", "b", "c", "d", "e"]),
        Rows(rng.normal(size=(2, 5)), [0.1, 0.2], ["contact of link 3", "contact of link 4"]),
        rng.normal(size=5),
        Equalities(rng.normal(size=(1, 5)), [0.0], ["held"]),
        metric=rng.uniform(0.5, 2.0, size=5),
        noise=1e-7,
    )


def content(problem: IKProblem) -> list[object]:
    parts = [problem.bounds, problem.rows, problem.equalities, *problem.levels]
    return [
        value.tolist() if isinstance(value, np.ndarray) else value
        for part in parts
        for value in (getattr(part, name) for name in part.__dataclass_fields__)
    ] + [problem.reference.tolist(), problem.metric.tolist(), problem.noise]


def test_a_problem_is_read_as_it_was_written_to_the_last_bit(problem: IKProblem, tmp_path: Path) -> None:
    save_problem(problem, tmp_path / "problem.npz")
    assert content(load_problem(tmp_path / "problem.npz")) == content(problem)


def test_a_problem_without_rows_is_read_too(tmp_path: Path) -> None:
    bare = IKProblem([Level(np.eye(3), np.ones(3))])
    save_problem(bare, tmp_path / "problem.npz")
    assert content(load_problem(tmp_path / "problem.npz")) == content(bare)


def test_a_metric_that_couples_joints_is_read_too(tmp_path: Path) -> None:
    coupled = IKProblem([], reference=[0.1, 0.2], metric=[[2.0, 0.5], [0.5, 1.0]])
    save_problem(coupled, tmp_path / "problem.npz")
    assert content(load_problem(tmp_path / "problem.npz")) == content(coupled)


@pytest.mark.parametrize("contacts", [0, 2])
def test_a_problem_on_a_kinematic_tree_keeps_it_and_makes_no_matrix(contacts: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    posed = random_problem(rng, random_tree(rng, 9, branching=0.3), 2, contacts=contacts)
    save_problem(posed, tmp_path / "problem.npz")
    read = load_problem(tmp_path / "problem.npz")
    for one in (posed, read):
        assert tree_of(one) is not None
        assert not any("matrix" in vars(level) for level in one.levels)
    assert content(read) == content(posed)
    for name in ("parents", "angular", "linear", "anchors"):
        np.testing.assert_array_equal(getattr(tree_of(read), name), getattr(tree_of(posed), name))


def test_the_file_holds_no_pickle(problem: IKProblem) -> None:
    with np.load(io.BytesIO(problem_bytes(problem)), allow_pickle=False) as file:
        assert all(file[name].dtype.kind in "fU" for name in file.files)


@pytest.mark.parametrize("damage", ["cut", "other", "text", "missing", "wrong shape"])
def test_another_file_is_refused_by_name(problem: IKProblem, tmp_path: Path, damage: str) -> None:
    path = tmp_path / "problem.npz"
    whole = problem_bytes(problem)
    with np.load(io.BytesIO(whole)) as file:
        arrays = dict(file)
    if damage == "cut":
        path.write_bytes(whole[: len(whole) // 2])
    elif damage == "other":
        np.savez(path, P=np.eye(2), q=np.ones(2))
    elif damage == "text":
        path.write_text("no archive")
    elif damage == "wrong shape":
        np.savez(path, **{**arrays, "lower": np.zeros(4)})
    with pytest.raises(InputError, match=r"problem\.npz"):
        load_problem(path)
