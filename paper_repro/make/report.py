"""The report: everything that was made, in one Markdown file and in one HTML file that needs no other.

It is put together from the artefacts' own Markdown, so that what was made by itself is in it too. Measured times are only
in the HTML: the Markdown file is the same, byte for byte, in every run.
"""

import base64
import re
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.latex import latex
from prioritized_ik.files import write_whole

TITLE = "The paper, reproduced"

INTRODUCTION = """\
What this library makes of T. Tsuji, S. Nakayama and K. Ito, *Instantaneous Inverse Kinematic Solution for Redundant
Manipulators Based on Virtual Arms and Its Application to Winding Control*: what the paper states, checked; its equations,
audited; its figures, drawn anew; and what it leaves open, measured.

The paper gives neither the initial pose nor the object's, no link radius, time step, joint range or contact threshold. Its
Figs. 6 and 7 can therefore be reproduced **in quality only**: no pose here is claimed to be the paper's. What was chosen in
their place, and how much it matters, stands in the chapter *What the paper leaves open*.

What a reader of the paper may want to know first:

- The closed form, Eqs. 12 to 14 alone, **winds as the paper says**, from all four directions, where less than about 0.8
  of a turn is to be wound. Around tilted objects and from bent poses the rank tolerance of Eq. 6, which is not stated,
  decides. With a full turn or more the free tail, which Eqs. 12 to 14 hold in place, is in the way. *Where the closed form
  winds.*
- The plan of Eqs. 18 to 22 is parallel and distributed, to the last bit; the weights of Eqs. 23 and 24 are not, as k is
  known to no link by itself. *Table 11.*
- Lateral inhibition winds without folding, but in a plane, and beyond a full turn into itself. *Table 12.*
- The paper's second approach, end-point springs and τ = Jᵀ F_v with the weights of Eq. 23 as stiffnesses, winds a dynamic
  arm within a joint's range, more than a turn too, where the first folds. *Table 13.*
- Held and shaken, what is wound is caged around a level axis. Along an upright one neither approach is enough: virtual end
  points do not feel links roll, and dθ* hardly presses. A strict hierarchy of torques holds it. *Table 14.*
- The time step, the contact distance and the dead band of Eq. 21, none of which is stated, decide whether the arm winds at
  all; the pose, the tilt and the first link whether the closed form does. *What the paper leaves open.*

Under every table and figure stands the command that makes it. `tables.tex` has all tables as one document of LaTeX.
"""

#: A document of all tables, on sheets that are wide enough for the widest.
DOCUMENT = r"""\documentclass{article}
\usepackage[paperwidth=60cm,paperheight=42cm,margin=1.5cm]{geometry}
\usepackage{booktabs,longtable,textcomp,amssymb}
\IfFileExists{lmodern.sty}{\usepackage{lmodern}}{}
\setlength{\parindent}{0pt}
\begin{document}
%s
\end{document}
"""


OUTDATED = "What is there was made at another scale or by another version; `prioritized-ik paper --only {}` makes it anew."


def write_report(chapters: dict[str, list[Artefact]], out: Path, scale: Scale) -> list[Path]:
    """Write `report.md`, `report.html` and `tables.tex` into `out` from the artefacts that are there, and return them.

    One that was made at another scale, or by another version, is named but not shown.
    """
    markdown, html = [f"# {TITLE}\n", INTRODUCTION], [INTRODUCTION]
    contents, tables = [], []
    for chapter, artefacts in chapters.items():
        made = [(a, path) for a in artefacts if (path := a.file(out, "md")).is_file()]
        if not made:
            continue
        contents.append((chapter, [(a.name, a.title) for a, _ in made]))
        markdown.append(f"## {chapter}\n")
        html.append(f"## {chapter}\n")
        for artefact, path in made:
            text, stamp, _ = path.read_text(encoding="utf-8").partition(scale.stamp)
            if not stamp:
                text = f"### {artefact.title}\n\n{OUTDATED.format(artefact.name)}\n"
            place = path.relative_to(out)
            if stamp and not artefact.timed and path.with_suffix(".tex").is_file():
                name = place.with_suffix(".tex").as_posix()
                tables.append(rf"\section*{{{latex(artefact.title)}}}" + "\n" + rf"\input{{{name}}}" + "\n" + r"\clearpage")
            moved = re.sub(r"\]\((?!https?:|#)", f"]({place.parent}/", text)
            if artefact.timed and stamp:
                told = f"Measured times, which no two runs share, are kept apart: [{place}]({place})."
                moved = f"### {artefact.title}\n\n{told}\n"
            markdown.append(moved)
            html.append(f'<a id="{artefact.name}"></a>\n\n{_with_pictures(text, path.parent)}')
    texts = ("\n".join(markdown), _page("\n".join(html), contents), DOCUMENT % "\n".join(tables))
    paths = [out / "report.md", out / "report.html", out / "tables.tex"]
    for path, text in zip(paths, texts, strict=True):
        write_whole(path, lambda file, text=text: file.write(text.encode("utf-8")))  # type: ignore[misc]
    return paths


def _with_pictures(text: str, folder: Path) -> str:
    """Return an artefact's Markdown with its pictures inside, and without links to files beside it."""

    def inlined(match: re.Match[str]) -> str:
        alt, name = match.groups()
        data = base64.b64encode((folder / name).read_bytes()).decode()
        return f'<figure><img alt="{escape(alt)}" src="data:image/svg+xml;base64,{data}"></figure>'

    text = re.sub(r"!\[([^]]*)\]\(([^)]+\.svg)\)", inlined, text)
    return re.sub(r"^\[SVG\].*\n", "", text, flags=re.MULTILINE)


def _page(markdown: str, contents: list[tuple[str, list[tuple[str, str]]]]) -> str:
    from markdown_it import MarkdownIt

    body = MarkdownIt("commonmark", {"html": True}).enable("table").render(markdown)
    body = body.replace("<table>", '<div class="table" tabindex="0"><table>').replace("</table>", "</table></div>")
    links = "".join(
        f"<li>{escape(chapter)}<ol>"
        + "".join(f'<li><a href="#{name}">{escape(title)}</a></li>' for name, title in entries)
        + "</ol></li>"
        for chapter, entries in contents
    )
    template = Template(files("paper_repro.make").joinpath("report.html").read_text(encoding="utf-8"))
    return template.substitute(title=escape(TITLE), contents=f"<ol>{links}</ol>", body=body)
