"""Puts tables of the report between the markers of a Markdown file, so that no figure there is typed by hand."""

import re
from pathlib import Path

from paper_repro.make.artefact import Scale
from paper_repro.make.catalogue import chosen
from prioritized_ik.errors import InputError
from prioritized_ik.files import advising, write_whole

MARKED = re.compile(r"(<!-- paper: (?P<name>[a-z0-9-]+) -->\n).*?(<!-- end of table -->)", re.DOTALL)


def marked(file: Path) -> list[str]:
    """Return the names of the artefacts that a Markdown file has a place for.

    Raises:
        InputError: it has none, or one for an artefact that there is not.
    """
    names = [match["name"] for match in MARKED.finditer(file.read_text(encoding="utf-8"))]
    if not names:
        raise InputError(
            f"{str(file)!r} has no place for a table; expected '<!-- paper: table-8 -->' and '<!-- end of table -->'."
        )
    chosen(tuple(names))
    return names


def fill(file: Path, out: Path, scale: Scale) -> None:
    """Put the tables made in `out` between the markers of `file`, without headings and captions.

    Raises:
        InputError: one was not made, or at another scale or by another version; or the file cannot be written.
    """
    tables = {}
    for artefact in chosen(tuple(marked(file))):
        path = artefact.file(out, "md")
        text, stamp, _ = path.read_text(encoding="utf-8").partition(scale.stamp) if path.is_file() else ("", "", "")
        if not stamp:
            raise InputError(f"{artefact.name} was not made now in {str(out)!r}; run without --only, or with it named.")
        _, bar, body = text.partition("\n|")
        tables[artefact.name] = bar[1:] + body.rstrip() + "\n"
    text = MARKED.sub(lambda match: match[1] + tables[match["name"]] + match[3], file.read_text(encoding="utf-8"))
    with advising("write", file):
        write_whole(file, lambda handle: handle.write(text.encode("utf-8")))
