"""One table, three forms: the same cells in each, and nothing that breaks the form."""

import csv
import io

import pytest

from paper_repro.make.latex import latex
from paper_repro.make.table import PAGE, Column, Table

COLUMNS = (
    Column("solver", "solver"),
    Column("dtheta_error", "‖dθ‖ error [–]", ".1e"),
    Column("steps", "steps"),
    Column("wound", "wound"),
    Column("why", "why", width="4cm"),
)
TABLE = Table(
    COLUMNS, (("daqp", 1.23456789e-13, 60, True, "a | b & 50 %"), ("osqp", None, 0, False, "max_step → θ")), "Notes *here*."
)


def test_the_csv_reads_back_with_keys_as_headings_and_six_digits():
    rows = list(csv.DictReader(io.StringIO(TABLE.csv())))
    assert list(rows[0]) == [column.key for column in COLUMNS]
    assert rows[0] == {
        "solver": "daqp",
        "dtheta_error": "1.23457e-13",
        "steps": "60",
        "wound": "True",
        "why": "a | b & 50 %",
    }
    assert rows[1]["dtheta_error"] == ""


def test_markdown_has_one_line_a_row_and_escapes_what_would_end_a_cell():
    lines = TABLE.markdown().splitlines()
    assert lines[0] == "| solver | ‖dθ‖ error [–] | steps | wound | why |"
    assert lines[1] == "| --- | ---: | ---: | --- | --- |"
    assert lines[2] == r"| daqp | 1.2e-13 | 60 | yes | a \| b & 50 % |"
    assert lines[3] == "| osqp | – | 0 | no | max_step → θ |"
    assert lines[-1] == "Notes *here*."


def test_latex_uses_booktabs_and_escapes_what_tex_would_read():
    text = TABLE.latex()
    assert text.startswith("\\begin{tabular}{lrrlp{4cm}}\n\\toprule\n")
    assert text.count("\\\\") == 3
    assert r"a | b \& 50 \%" in text
    assert r"max\_step" in text
    assert "θ" not in text
    assert text.endswith("\\bottomrule\n\\end{tabular}\n")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("J_aᵀ", r"J\ensuremath{_{a}}\ensuremath{^{\mathsf{T}}}"),
        ("dX_v*", r"dX\ensuremath{_{v}}*"),
        ("e^{i−1}", r"e\ensuremath{^{i\ensuremath{-}1}}"),
        ("w_1^(k+1)", r"w\ensuremath{_{1}}\ensuremath{^{k+1}}"),
        ("hinge_order & `min_distance` 5 %", r"hinge\_order \& min\_distance 5 \%"),
        ("\u4e00", r"{\bfseries ?}"),
    ],
)
def test_symbols_get_indices_and_names_keep_their_underscores(text, expected):
    assert latex(text) == expected


def test_a_table_longer_than_a_page_may_break():
    rows = tuple(("x",) for _ in range(PAGE + 1))
    text = Table((Column("a", "a"),), rows).latex()
    assert "\\begin{longtable}" in text
    assert "\\endhead" in text


def test_nan_is_no_figure():
    table = Table((Column("a", "a"),), ((float("nan"),), (1.0,)))
    assert table.csv() == 'a\n""\n1\n'
    assert "| – |" in table.markdown()


def test_a_row_that_does_not_fit_is_refused():
    with pytest.raises(ValueError, match="has 1 cells; expected 5"):
        Table(COLUMNS, (("daqp",),))
