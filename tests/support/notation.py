"""The lines of docs/notation.md: equations of the paper, and the functions that run them."""

import re

from repository import ROOT

PAGE = ROOT / "docs" / "notation.md"
LINE = re.compile(r"^\| ([\d, ]+) \|.*?\| `([\w.]+)` \| (.*?) ?\|$")


def lines() -> list[tuple[list[int], str]]:
    """Equations of each line, and the path of its function."""
    found = [LINE.match(line) for line in PAGE.read_text(encoding="utf-8").splitlines()]
    return [([int(n) for n in match[1].split(",")], match[2]) for match in found if match]
