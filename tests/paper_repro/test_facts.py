"""What the paper states against what we have: facts, checks, verdicts, choices."""

import dataclasses
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

import paper_repro.artefacts.facts as facts
from paper_repro.artefacts.facts import Fact, Finding, Verdict, finding, known_facts, parse, read, same, table
from paper_repro.make.artefact import FULL, QUICK
from paper_repro.make.jobs import Job, Results
from paper_repro.measure.checks import STATIC, WOUND, Ours, run_static
from prioritized_ik.models import Arm
from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.winding.settings import WindingSettings


@pytest.fixture(scope="module")
def found() -> dict[str, Finding]:
    """Findings on all that needs no winding."""
    given = {name: Ours(**ours) for name, ours in run_static().items()}
    return {fact.id: finding(fact, given.get(fact.id)) for fact in known_facts() if fact.id not in WOUND}


def fact_called(name: str) -> Fact:
    return next(fact for fact in known_facts() if fact.id == name)


# Facts and checks belong together


def test_every_fact_has_a_check_or_a_place_and_every_check_a_fact() -> None:
    assert {*STATIC, *WOUND} == {fact.id for fact in known_facts() if fact.is_stated or not fact.set_at}


ENTRY = '[[fact]]\nid = "{}"\nsays = "s"\nwhere = "w"\n'


def test_a_fact_without_a_check_is_an_error() -> None:
    text = "".join(ENTRY.format(fact.id) + "value = true\n" for fact in known_facts() if fact.id in {*STATIC, *WOUND})
    with pytest.raises(ValueError, match="facts without a check: the moon"):
        parse(text + ENTRY.format("the moon") + "value = 1\n")


def test_a_check_without_a_fact_is_an_error() -> None:
    text = "".join(ENTRY.format(name) + "value = true\n" for name in {*STATIC, *WOUND} - {"eta"})
    with pytest.raises(ValueError, match="checks without a fact: eta"):
        parse(text)


def test_what_is_not_stated_needs_a_check_or_a_place_to_read_our_choice_at() -> None:
    text = "".join(ENTRY.format(name) + "value = true\n" for name in {*STATIC, *WOUND})
    with pytest.raises(ValueError, match="facts without a check: the weather"):
        parse(text + ENTRY.format("the weather"))
    placed = text + ENTRY.format("the weather") + 'set_at = { "models.Arm.radius" = "m" }\n'
    assert parse(placed)[-1].id == "the weather"


def test_an_id_used_twice_is_an_error() -> None:
    text = "".join(ENTRY.format(name) + "value = true\n" for name in [*STATIC, *WOUND, "eta"])
    with pytest.raises(ValueError, match="ids used twice: eta"):
        parse(text)


def test_every_fact_says_where_the_paper_says_it() -> None:
    assert all(fact.says and fact.where for fact in known_facts())


def test_every_choice_says_why() -> None:
    assert all(fact.why for fact in known_facts() if not fact.is_stated)


# Verdicts


def test_nothing_differs_that_is_not_known_to(found: dict[str, Finding]) -> None:
    assert not [name for name, each in found.items() if each.unexpected]


def test_what_has_a_reason_to_differ_does_differ(found: dict[str, Finding]) -> None:
    explained = {name for name, each in found.items() if each.fact.reason}
    assert explained
    assert all(found[name].verdict is Verdict.DIFFERS for name in explained)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("links", 18),
        ("joints", 51),
        ("link length", 0.0601),
        ("diameter", 0.07),
        ("eta", 2.5),
        ("rows", 49),
        ("weights of Eq. 23", [200.0, 20.0, 1.0]),
        ("weights of Eq. 24", [200.0, 20.0]),
        ("case b", [5, 10, 4]),
        ("shape", "sphere"),
        ("two equilibria", 3),
        ("r is zero", 1e-9),
    ],
)
def test_a_changed_fact_is_reported_as_differing(name: str, value: Any, found: dict[str, Finding]) -> None:
    assert found[name].verdict is Verdict.AGREES
    changed = dataclasses.replace(fact_called(name), value=value)
    again = finding(changed, STATIC[name]())
    assert again.verdict is Verdict.DIFFERS
    assert again.unexpected


def test_a_claim_that_does_not_hold_differs_and_one_with_a_reason_is_expected() -> None:
    claim = fact_called("ball joints")
    assert finding(claim, Ours(False, "axes 1 mm apart")).unexpected
    assert not finding(dataclasses.replace(claim, reason="known"), Ours(False, "")).unexpected


@pytest.mark.parametrize(
    ("stated", "ours", "is_same"),
    [
        (17, 17, True),
        (0.06, 0.06 + 1e-15, True),
        (0.06, 0.06 + 1e-9, False),
        (0.0, 1e-300, False),
        (1, True, False),
        (True, 1, False),
        ("cylinder", "capsule", False),
        ([4, 3], [4, 3, 3], False),
        ([4, 3], [3, 4], False),
        ([4, 3], 4, False),
        (17, None, False),
    ],
)
def test_values_are_the_same_but_for_rounding(stated: Any, ours: Any, is_same: bool) -> None:
    assert same(stated, ours) is is_same


def test_a_fact_about_which_no_check_found_anything_is_an_error() -> None:
    with pytest.raises(ValueError, match="no check found anything on 'links'"):
        finding(fact_called("links"), None)


def test_the_table_has_a_line_for_each_finding_and_the_reasons_below(found: dict[str, Finding]) -> None:
    made = table(list(found.values()))
    assert len(made.rows) == len(found)
    assert {row[0] for row in made.rows} == {"agrees", "differs", "not stated"}
    assert fact_called("index of a").reason in made.notes


# Choices


def test_choices_are_read_from_the_code() -> None:
    assert read("models.Arm.radius") == Arm().radius
    assert read("solvers.lexicographic.SolveOptions.accuracy") == SolveOptions().accuracy
    assert read("winding.settings.WindingSettings.options.rank_tolerance") == RANK_TOLERANCE
    assert finding(fact_called("rank tolerance"), None).ours == f"rank_tolerance {RANK_TOLERANCE:g} of the largest"
    step = finding(fact_called("time step"), None)
    assert step.verdict is Verdict.NOT_STATED
    assert step.ours == f"dt {WindingSettings().dt:g} s"


def test_a_default_that_changes_changes_the_choice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(WindingSettings, "dt", 0.5)
    assert finding(fact_called("time step"), None).ours == "dt 0.5 s"


def test_a_place_that_is_not_there_is_an_error() -> None:
    with pytest.raises(AttributeError):
        read("models.Arm.colour")


#: Fields whose value the paper does state, or which hold others; facts check them.
STATED = {"links", "link_length", "arm", "shape", "size", "direction", "weights", "options"}


def test_every_setting_is_stated_by_the_paper_or_listed_as_a_choice() -> None:
    listed = {path.rpartition(".")[2] for fact in known_facts() for path, _ in fact.set_at}
    fields = {field.name for kind in (Arm, WindingSettings, SolveOptions) for field in dataclasses.fields(kind)}
    assert fields - listed == STATED | {"kinematics"}  # which is how fast a step is found, not which


def test_the_table_of_choices_has_all_that_is_not_stated(found: dict[str, Finding]) -> None:
    from paper_repro.artefacts import choices

    results = Results({Job(run_static).key: run_static()})
    made = choices.build(QUICK, results)
    assert len(made.rows) == sum(not fact.is_stated for fact in known_facts())
    assert all(all(row) for row in made.rows)


# The command


def test_check_exits_1_if_something_differs_that_is_not_known_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from paper_repro.command import paper

    true, false = (finding(fact_called("links"), Ours(count)) for count in (17, 18))
    monkeypatch.setattr(facts, "jobs", lambda scale: [])
    for given, code in (([true], 0), ([true, false], 1)):
        monkeypatch.setattr(facts, "findings", lambda scale, results, given=given: given)
        result = CliRunner().invoke(paper, ["--out", str(tmp_path), "check"])
        assert result.exit_code == code, result.output
        assert "The manipulator has 17 links." in result.output


def test_the_full_run_winds_from_every_direction_and_the_quick_one_from_one() -> None:
    assert len(facts.jobs(FULL)) > len(facts.jobs(QUICK))
