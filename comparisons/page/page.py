"""Puts one self-contained HTML file together: the data as JSON, the style and scripts that ship beside this module.

The file needs nothing else: it states, as its content security policy, that it loads nothing and runs no script but its
own. Names and messages from solvers are data all the way: the scripts only ever show them as text.
"""

import base64
import hashlib
import html
import json
from dataclasses import asdict
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

from comparisons.page.agreement import agreement
from comparisons.page.courses import courses
from comparisons.page.failures import failures
from comparisons.page.profile import profiles
from comparisons.page.replays import replays
from comparisons.page.series import answers_of
from comparisons.page.source import Source
from comparisons.page.verdicts import finding, verdicts
from comparisons.summary import Row
from prioritized_ik.files import advising, write_whole

NAME = "report.html"

#: In this order: the later use the earlier.
SCRIPTS = ("dom.js", "table.js", "chart.js", "heatmap.js", "solid.js", "replay.js", "failures.js", "main.js")


def write_page(folder: Path, store: Source, rows: list[Row]) -> Path:
    """Write the report of a comparison to `folder` / `report.html`, whole or not at all, and return its path.

    Args:
        folder: where to.
        store: the results.
        rows: the verdict table.

    Raises:
        InputError: it cannot be written.
        EpisodeFileError: a recorded winding cannot be read.
    """
    content = page(data(store, rows)).encode("utf-8")
    target = folder / NAME
    with advising("write", target):
        write_whole(target, lambda file: file.write(content))
    return target


def data(store: Source, rows: list[Row]) -> dict[str, Any]:
    """Return everything that the page shows, as what JSON can hold."""
    episodes = store.episodes()
    answers = answers_of(store.steps(), [(row.solver, row.formulation) for row in rows])
    shown, left_out = courses(answers)
    return {
        "finding": finding(rows),
        "facts": list(_flat(store.facts())),
        "verdicts": verdicts(rows),
        "series": [asdict(item) for item in answers.series],
        "profiles": profiles(answers),
        "agreement": agreement(answers),
        "courses": shown,
        "courses_left_out": left_out,
        "replays": replays(store.folder, episodes, store.model),
        "failures": failures(answers, episodes, store.problem),
    }


def page(content: dict[str, Any]) -> str:
    """Return the HTML that shows `content`."""
    style, script = _asset("page.css"), "\n".join([_three(), *(_asset(name) for name in SCRIPTS)])
    policy = f"default-src 'none'; style-src {_hash(style)}; script-src {_hash(script)}; img-src data:"
    return Template(_asset("page.html")).substitute(
        policy=html.escape(policy),
        style=style,
        script=script,
        # A "</script>" or "<!--" in the data would end it, whatever it stands in.
        data=json.dumps(content, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
    )


def _three() -> str:
    """Return three.js as one object, `THREE`: a module as it is would have to be loaded, and this page loads nothing."""
    body, _, exported = _asset("three/three.module.min.js").rpartition("export{")
    pairs = [name.split(" as ") for name in exported.strip().removesuffix(";").removesuffix("}").split(",")]
    return f"const THREE = (() => {{{body}return {{{', '.join(f'{pair[-1]}: {pair[0]}' for pair in pairs)}}}; }})();"


def _asset(name: str) -> str:
    return files("comparisons.page").joinpath("assets", name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode('utf-8')).digest()).decode('ascii')}'"


def _flat(facts: dict[str, Any], above: str = "") -> list[list[str]]:
    """Return nested facts as pairs of name and text; lists as their items."""
    pairs: list[list[str]] = []
    for name, value in facts.items():
        if isinstance(value, dict):
            pairs += _flat(value, f"{above}{name}: ")
        elif isinstance(value, list | tuple):
            pairs.append([f"{above}{name}", ", ".join(str(item) for item in value) or "–"])
        else:
            pairs.append([f"{above}{name}", "–" if value in (None, "") else str(value)])
    return pairs
