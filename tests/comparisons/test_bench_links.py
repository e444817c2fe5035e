"""Arms of several lengths in the bench: one question by links and by matrices, sparse solvers, and what is told.

No time is asserted here.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from comparisons.bench import command, growth, lifted
from comparisons.bench.growth import (
    CLOSED_TREE,
    DGELSY,
    FITTED,
    LIMITED,
    MATRICES,
    ON_TREE,
    OURS,
    PATIENCE,
    WARM_TREE,
    Growth,
    asked,
    exponent,
)
from comparisons.bench.links_report import links_notes, links_tables
from comparisons.bench.run import LinksBench, links_alone, run_links
from comparisons.bench.settings import USUAL_LINKS, BenchSettings
from prioritized_ik.cli import CommandGroup
from prioritized_ik.errors import InputError
from prioritized_ik.solvers.backends.abilities import SPARSE
from prioritized_ik.solvers.backends.sparse import SparseBackend, SparseResult
from prioritized_ik.solvers.methods import ActiveSet
from prioritized_ik.solvers.solve import step_of
from prioritized_ik.tree_problem import tree_of

TINY = BenchSettings(links=(3, 4), lifted=(4,), lifted_steps=2, largest_rival=3)


@pytest.fixture(scope="module")
def bench() -> LinksBench:
    return run_links(TINY, lambda *_: None)


def call(*arguments: str) -> Result:
    return CliRunner().invoke(CommandGroup(commands={"bench": command.bench}), ["bench", *arguments])


def test_a_range_takes_the_usual_numbers_within_it_and_its_ends_a_list_takes_its_own() -> None:
    assert BenchSettings.of_links("8..1000").links == USUAL_LINKS
    assert BenchSettings.of_links("20..120").links == (20, 34, 50, 100, 120)
    assert BenchSettings.of_links("400,17,100").links == (17, 100, 400)
    assert BenchSettings.of_links("8..120").lifted == (17, 100)


@pytest.mark.parametrize(
    ("text", "message"),
    [("many", "links is 'many'"), ("8..", "links is '8..'"), ("9..8", "which holds none"), ("1..9", "links is 1")],
)
def test_numbers_of_links_that_are_none_are_refused(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        BenchSettings.of_links(text)
    done = call("--links", text)
    assert done.exit_code == 2
    assert message in done.output


@pytest.mark.parametrize("other", [["--quick"], ["--plot", "growth.png"]])
def test_links_are_measured_alone(other: list[str]) -> None:
    done = call("--links", "3,4", *other)
    assert done.exit_code == 2
    assert "--links takes neither --quick nor --plot" in done.output


@pytest.mark.parametrize("power", [1.0, 3.0])
def test_the_exponent_is_that_of_the_growth_between_the_links_that_are_fitted(power: float) -> None:
    values = {links: 2e-6 * links**power for links in (50, 100, 200, 400, 800)}
    outside = {8: 1.0, 1000: 1.0}
    assert exponent(values | outside) == pytest.approx(power)
    assert exponent({50: 1.0, 800: 2.0}) is None
    assert FITTED == (50, 800)


@pytest.mark.parametrize("links", [6, 20, 40])
def test_the_question_has_limits_active_and_one_answer_by_links_and_by_matrices(links: int) -> None:
    problems, _, _ = asked(links)
    method = ActiveSet()
    for problem in problems:
        assert tree_of(problem) is not None
        tree, dense = step_of(method, problem, ON_TREE), step_of(ActiveSet(), growth.in_matrices(problem), MATRICES)
        assert len(tree.active_rows) >= LIMITED // 2
        for step in (tree, dense):
            assert step.certificate is not None
            assert step.certificate.holds
        assert np.linalg.norm(tree.dtheta - dense.dtheta) <= 1e-8 * np.linalg.norm(dense.dtheta)
    assert step_of(method, problems[0], ON_TREE).repairs <= 2  # warm from the other one's rows


def test_every_step_is_told_with_its_certificate_its_path_and_its_memory(bench: LinksBench) -> None:
    measured = bench.growth
    for name in OURS:
        assert measured.seconds[name].keys() == measured.certified[name].keys() == measured.paths[name].keys() == {3, 4}
        assert all(measured.certified[name].values())
    assert all(path == "tree" for name in (CLOSED_TREE, WARM_TREE) for path in measured.paths[name].values())
    assert all(value > 0.0 for value in measured.memory.values())
    assert measured.left_out == {"mink (daqp)": "not asked beyond 3 links"}


def test_a_step_that_goes_another_way_or_lacks_its_certificate_shows() -> None:
    odd = Growth(
        joints={3: 7},
        seconds={WARM_TREE: {3: 2e-3}},
        certified={WARM_TREE: {3: False}},
        paths={WARM_TREE: {3: "python"}},
        memory={3: 1.0},
    )
    shown = LinksBench(TINY, odd, {})
    assert "(2)" in links_tables(shown)[0].rows[0]
    assert links_notes(shown) == [f"Growth: {WARM_TREE}: the step of 3 links went by the path python."]


def test_matrices_are_not_asked_where_a_step_would_take_too_long() -> None:
    measured = Growth(seconds={DGELSY: {100: PATIENCE / 7.0, 50: 0.1}})
    assert measured.expected(DGELSY, 200) == pytest.approx(8.0 / 7.0 * PATIENCE)
    assert measured.expected("mink (daqp)", 200) == 0.0


def test_a_length_without_a_clear_step_by_links_is_named_and_not_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growth, "tree_step", lambda *_, **__: None)
    measured = growth.measure_growth(replace(TINY, links=(4,)), lambda *_: None)
    assert measured.none == {CLOSED_TREE: [4], WARM_TREE: [4]}
    assert not measured.seconds.get(WARM_TREE)
    assert any("no step is clear with 4 links" in line for line in links_notes(LinksBench(TINY, measured, {})))


def test_every_sparse_solver_is_asked_for_the_same_steps(bench: LinksBench) -> None:
    assert bench.lifted.keys() == SPARSE.keys()
    for name, rows in bench.lifted.items():
        (row,) = rows
        assert row.steps == 2
        assert row.answered == row.steps or name in row.message
        assert row.gap is None or abs(row.gap) < 1e-6
    assert all(row.certified == row.steps for row in bench.lifted["piqp"])


def test_a_solver_that_gives_nothing_is_told_as_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SparseBackend, "solve", lambda *_: SparseResult(None, "piqp is on strike"))
    steps = lifted.winding_steps(4, 2)
    options = lifted.winding(4).options
    row = lifted._measured("piqp", 4, steps, options)
    assert (row.answered, row.gap, row.worst) == (0, None, None)
    assert "on strike" in row.message


def test_the_command_writes_what_it_shows(bench: LinksBench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("comparisons.bench.run.run_links", lambda *_: bench)
    done = call("--links", "3,4", "--json", str(tmp_path / "a.json"), "--markdown", str(tmp_path / "a.md"))
    assert done.exit_code == 0, done.output
    told = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    assert told == json.loads(json.dumps(links_alone(bench), allow_nan=False))
    assert told["growth"]["exponents"].keys() == {*bench.growth.seconds, "memory"}
    text = (tmp_path / "a.md").read_text(encoding="utf-8")
    for title in ("Growth with the arm's links [ms]", "Sparse solvers in the lifted form"):
        assert f"## {title}" in text
        assert title.split("[")[0].strip() in done.output
    assert all(f"| lifted:{name} " in text for name in SPARSE)
