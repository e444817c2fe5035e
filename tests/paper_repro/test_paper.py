"""The paper by one command: the reduced run makes everything, once, whole, and the same each time."""

import csv
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from pylatexenc.latex2text import get_default_latex_context_db
from pylatexenc.latexwalker import LatexMacroNode, LatexWalker, LatexWalkerParseError
from repository import ROOT

from paper_repro.make import jobs
from paper_repro.make.artefact import QUICK, Artefact
from paper_repro.make.build import ANSWERS
from paper_repro.make.catalogue import CHAPTERS, artefacts
from paper_repro.make.figure import KINDS
from paper_repro.make.readme import marked
from prioritized_ik.cli import main

NAMES = [artefact.name for artefact in artefacts()]
MAGIC = {"svg": b"<?xml", "pdf": b"%PDF", "png": b"\x89PNG"}

#: Made anew from nothing and compared byte by byte in the suite: cheap ones of every kind, whole windings among them.
COMPARED = (
    "facts",
    "table-1",
    "table-2",
    "table-3",
    "table-6",
    "table-8",
    "table-11",
    "table-13",
    "closed-form-map",
    "leaves-open",
    "figure-3",
    "figure-7",
)


def paper(*arguments: str) -> Result:
    return CliRunner().invoke(main, ["paper", *arguments])


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("paper")
    result = paper("--quick", "--out", str(out))
    assert result.exit_code == 0, result.output
    return out


def files_of(artefact: Artefact, out: Path) -> list[Path]:
    kinds = (*KINDS, "md") if artefact.name.startswith("figure") else ("csv", "tex", "md")
    return [artefact.file(out, kind) for kind in kinds]


@pytest.mark.parametrize("artefact", artefacts(), ids=NAMES)
def test_every_artefact_is_made_in_every_form_and_says_what_it_shows(made, artefact):
    for path in files_of(artefact, made):
        content = path.read_bytes()
        assert content.startswith(MAGIC.get(path.suffix[1:], b"")), path
    text = files_of(artefact, made)[-1].read_text(encoding="utf-8")
    assert artefact.title in text
    assert len(artefact.caption) > 80
    assert f"`prioritized-ik paper --only {artefact.name} --quick`" in text


@pytest.mark.parametrize("artefact", [a for a in artefacts() if not a.name.startswith("figure")], ids=lambda a: a.name)
def test_the_three_forms_of_a_table_have_the_same_rows_and_columns(made, artefact):
    stem = files_of(artefact, made)[0].with_suffix("")
    rows = list(csv.reader(stem.with_suffix(".csv").read_text(encoding="utf-8").splitlines()))
    assert len(rows) > 1
    assert len({len(row) for row in rows}) == 1
    lines = [line for line in stem.with_suffix(".md").read_text(encoding="utf-8").splitlines() if line.startswith("|")]
    assert len(lines) == len(rows) + 1
    assert {len(re.findall(r"(?<!\\)\|", line)) for line in lines} == {len(rows[0]) + 1}
    body = stem.with_suffix(".tex").read_text(encoding="utf-8")
    assert [len(re.findall(r"(?<!\\)&", line)) for line in body.splitlines() if line.endswith(r"\\")] == [
        len(rows[0]) - 1
    ] * len(rows)
    assert body.isascii()
    assert "bfseries ?" not in body


#: Commands that tables use beyond letters and symbols: of the packages that `tables.tex` loads.
COMMANDS = {"toprule", "midrule", "bottomrule", "endhead"}


def test_the_syntax_of_every_table_is_that_of_latex(made):
    """Braces, environments and mathematics closed, by a strict parser; and no command that is not known."""
    symbols = get_default_latex_context_db()
    for path in sorted(made.rglob("table*/*.tex")):
        text = path.read_text(encoding="utf-8")
        assert text.isascii(), path
        waiting = list(LatexWalker(text, tolerant_parsing=False).get_latex_nodes()[0])
        assert waiting, path
        while waiting:
            node = waiting.pop()
            for parts in (getattr(node, "nodelist", None), getattr(getattr(node, "nodeargd", None), "argnlist", None)):
                waiting += [part for part in parts or [] if part is not None]
            if node.isNodeType(LatexMacroNode):
                assert node.macroname in COMMANDS or symbols.get_macro_spec(node.macroname), (path, node.macroname)


@pytest.mark.parametrize("broken", ["{", "$x", r"\begin{tabular}", r"\end{longtable}"])
def test_the_parser_refuses_what_latex_would(broken):
    """Sabotage of the test above."""
    with pytest.raises(LatexWalkerParseError):
        LatexWalker(f"\\toprule a & {broken}", tolerant_parsing=False).get_latex_nodes()


def test_the_document_of_all_tables_holds_them_all_and_compiles_where_there_is_latex(made):
    text = (made / "tables.tex").read_text(encoding="utf-8")
    given = re.findall(r"\\input\{(tables/[^}]*)\}", text)
    assert given == [f"tables/{name}.tex" for name in NAMES if not name.startswith("figure") and name != "table-7"]
    latex = shutil.which("pdflatex")
    if latex:
        command = [latex, "-draftmode", "-halt-on-error", "-interaction=nonstopmode", "tables.tex"]
        done = subprocess.run(command, cwd=made, capture_output=True, timeout=120, check=False)
        assert done.returncode == 0, done.stdout[-2000:].decode(errors="replace")


COUNTED = re.compile(r"^(joint|step|first link|last wound link k)$")


def everything(made: Path, artefact: Artefact) -> jobs.Results:
    """What the jobs of an artefact gave in the reduced run."""
    return jobs.run(artefact.jobs(QUICK), made / ANSWERS, 1, lambda *told: None)


@pytest.mark.parametrize("artefact", [a for a in artefacts() if a.name.startswith("figure")], ids=lambda a: a.name)
def test_every_axis_of_a_figure_says_its_unit(made, artefact):
    """In brackets, `[–]` for a ratio; but for numbers of steps and links, and axes without numbers."""
    figure = artefact.build(QUICK, everything(made, artefact))
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            label = axis.get_label().get_text()
            if label and not COUNTED.search(label):
                assert re.search(r"\[[^]]+\]", label), label


def test_the_report_needs_no_other_file(made):
    html = (made / "report.html").read_text(encoding="utf-8")
    assert html.count('src="data:image/svg+xml;base64,') == sum(name.startswith("figure") for name in NAMES)
    assert not re.findall(r'(?:src|href)="(?!data:|#)[^"]*"', html)
    for name in NAMES:
        assert f'id="{name}"' in html
        assert f'href="#{name}"' in html


def test_the_markdown_report_leads_to_files_that_are_there(made):
    text = (made / "report.md").read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)#]+)\)", text)
    assert len(links) > len(NAMES)
    for link in links:
        assert (made / link).is_file(), link
    assert [line[3:] for line in text.splitlines() if line.startswith("## ")] == list(CHAPTERS)


def test_the_report_claims_the_unpublished_poses_in_quality_only(made):
    text = (made / "report.md").read_text(encoding="utf-8")
    assert "in quality only" in text
    assert not re.search(r"(same|identical|equal) (pose|posture|configuration)s? (as|to) (the paper|Fig)", text)


def test_two_runs_give_the_same_bytes(made, tmp_path):
    """Everything computed anew, by one process instead of all."""
    result = paper("--quick", "--out", str(tmp_path), "--workers", "1", "--only", ",".join(COMPARED))
    assert result.exit_code == 0, result.output
    for artefact in artefacts():
        if artefact.name in COMPARED:
            for first, second in zip(files_of(artefact, made), files_of(artefact, tmp_path), strict=True):
                assert first.read_bytes() == second.read_bytes(), first.name


def test_one_artefact_is_made_by_itself_from_what_is_done(made, monkeypatch):
    report = (made / "report.md").read_bytes()
    table = made / "tables" / "table-8.csv"
    before = table.read_bytes()
    table.unlink()
    monkeypatch.setattr(jobs, "process_pool", None)  # no job may run
    result = paper("--quick", "--out", str(made), "--only", "table-8")
    assert result.exit_code == 0, result.output
    assert table.read_bytes() == before
    assert (made / "report.md").read_bytes() == report


def test_measured_times_stay_out_of_what_must_not_change(made):
    timed = [artefact for artefact in artefacts() if artefact.timed]
    assert [artefact.name for artefact in timed] == ["table-7"]
    text = (made / "report.md").read_text(encoding="utf-8")
    assert "kept apart: [timed/table-7.md](timed/table-7.md)" in text
    lines = files_of(timed[0], made)[-1].read_text(encoding="utf-8").splitlines()
    rows = [line for line in lines if line.startswith("| lexicographic")]
    assert rows
    assert not any(row in text for row in rows)
    for artefact in artefacts():
        assert artefact.timed or not any(job.alone for job in artefact.jobs(QUICK)), artefact.name


def test_the_check_prints_a_verdict_for_every_fact(made):
    result = paper("--quick", "--out", str(made), "check")
    assert result.exit_code == 0, result.output
    for verdict in ("agrees", "not stated"):
        assert verdict in result.output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--only", "table-99"), "unknown artefact 'table-99'; choose one of: facts, table-1"),
        (("--workers", "0"), "workers is 0; expected a whole number of at least 1"),
        (("--out", "/proc/paper"), "cannot write into '/proc"),
    ],
)
def test_bad_arguments_are_refused_with_what_to_do(arguments, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = paper("--quick", *arguments)
    assert result.exit_code == 2
    assert message in result.output
    assert not list(tmp_path.iterdir())


def test_tables_go_between_the_markers_of_a_file(made, tmp_path):
    file = tmp_path / "page.md"
    file.write_text("before\n<!-- paper: table-3 -->\nold\n<!-- end of table -->\nafter\n", encoding="utf-8")
    result = paper("--quick", "--out", str(made), "--only", "table-3", "--readme", str(file))
    assert result.exit_code == 0, result.output
    text = file.read_text(encoding="utf-8")
    table = (made / "tables" / "table-3.md").read_text(encoding="utf-8")
    table = table[table.index("| ") : table.index("\n<!-- ")]
    assert text == f"before\n<!-- paper: table-3 -->\n{table}<!-- end of table -->\nafter\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("nothing", "has no place for a table"),
        ("<!-- paper: table-99 -->\n<!-- end of table -->", "unknown artefact 'table-99'"),
        ("<!-- paper: table-1 -->\n<!-- end of table -->", "table-1 was not made now in"),
    ],
)
def test_a_file_without_a_fitting_place_is_left_as_it_is(text, message, tmp_path):
    file = tmp_path / "page.md"
    file.write_text(text, encoding="utf-8")
    result = paper("--quick", "--out", str(tmp_path / "out"), "--only", "table-3", "--readme", str(file))
    assert result.exit_code == 2
    assert message in result.output
    assert file.read_text(encoding="utf-8") == text


@pytest.mark.parametrize("name", ["README.md", "docs/winding.md"])
def test_the_tables_of_the_readme_are_ones_that_the_command_makes(made, name):
    page = (ROOT / name).read_text(encoding="utf-8")
    names = marked(ROOT / name)
    headings = [line for line in page.splitlines() if re.match(r"\| ?:?---", line)]
    assert len(headings) == len(names), "a table that no command makes"
    by_name = {each.name: each for each in artefacts()}
    for artefact in names:
        text = by_name[artefact].file(made, "md").read_text(encoding="utf-8")
        header = next(line for line in text.splitlines() if line.startswith("|"))
        assert header in page, artefact


def test_what_was_made_at_another_scale_is_named_in_the_report_but_not_shown(made, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(made, out, ignore=shutil.ignore_patterns("answers"))
    result = paper("--out", str(out), "--only", "table-3")
    assert result.exit_code == 0, result.output
    text = (out / "report.md").read_text(encoding="utf-8")
    assert text.count("made at another scale or by another version") == len(NAMES) - 1
    assert "Made by `prioritized-ik paper --only table-3`." in text
    assert "--quick" not in text


def test_without_its_extra_the_command_says_how_to_get_it(monkeypatch, tmp_path):
    monkeypatch.setattr("prioritized_ik.extras.find_spec", lambda name: None if name == "pylatexenc" else object())
    result = paper("--out", str(tmp_path / "out"), "--only", "table-3")
    assert result.exit_code == 2
    assert "pip install 'prioritized-ik[report]'" in result.output
