"""Arms of several lengths to read: how a step grows with the links, and what sparse solvers make of it."""

from pathlib import Path

from rich.console import Console
from rich.markup import escape

from comparisons.bench.clock import ratio
from comparisons.bench.growth import FITTED, OURS, WARM_DENSE, WARM_TREE, exponent
from comparisons.bench.run import LinksBench, links_alone
from comparisons.bench.shown import Shown, drawn_as
from comparisons.drawn import as_markdown
from prioritized_ik.files import advising, write_whole

LEGEND = (
    "Growth: medians, programs in turns, Eq. 24; by links is on the kinematic tree, by matrices the dense form, both "
    "certified: closed form without any limit, and warm with limits and contacts active, of which active says how many. "
    "Apart: of their steps, relative. Memory: the most that one step by links allocates. The exponent is b of a n^b, "
    f"fitted by least squares to links from {FITTED[0]} to {FITTED[1]}. A time in brackets is of a step without a "
    "certificate that holds. Sparse solvers: steps of windings, 17 links as in the paper, more of them a little bent and "
    "around a thin post; guess: from the posed problem to the solver's own answer; step: to the certified one; gap: how "
    "much more the answer costs in level 1, relative to not moving."
)


def links_tables(bench: LinksBench) -> list[Shown]:
    """Return the tables of growth and of sparse solvers."""
    return [_growth(bench), _lifted(bench)]


def links_notes(bench: LinksBench) -> list[str]:
    """Return what was left out, and by which paths steps were made that were to go another way."""
    growth = bench.growth
    lines = [f"Growth: {name} {why}." for name, why in growth.left_out.items()]
    for name, numbers in growth.none.items():
        several = ", ".join(map(str, numbers))
        lines.append(f"Growth: {name}: no step is clear with {several} links, where matrices answer instead.")
    for name in OURS:
        wanted = {"tree"} if name.endswith("links") else {"compiled", "python"}
        others = {links: path for links, path in growth.paths.get(name, {}).items() if path not in wanted}
        lines += [f"Growth: {name}: the step of {links} links went by the path {path}." for links, path in others.items()]
    for name, rows in bench.lifted.items():
        lines += [f"lifted:{name}, {row.links} links: {row.message}." for row in rows if row.message]
    return lines


def show_links(bench: LinksBench, console: Console) -> None:
    """Print both tables and what was left out."""
    for shown in links_tables(bench):
        console.print(drawn_as(shown))
    for line in links_notes(bench):
        console.print(escape(line), soft_wrap=True)
    console.print(escape(LEGEND))


def write_links_markdown(path: Path, bench: LinksBench) -> None:
    """Write the same as one Markdown file, whole or not at all.

    Raises:
        InputError: it cannot be written.
    """
    told, lines = links_alone(bench), []
    for shown in links_tables(bench):
        lines += [f"## {shown.title}", "", *as_markdown(drawn_as(shown, markdown=True)), ""]
    stated = ", ".join(f"{name} {version}" for name, version in told["versions"].items())
    content = "\n".join([*lines, *links_notes(bench), "", LEGEND, "", f"{told['cpu']}; {stated}."]) + "\n"
    with advising("write", path):
        write_whole(path, lambda file: file.write(content.encode("utf-8")))


def _growth(bench: LinksBench) -> Shown:
    growth = bench.growth
    columns = ("links", "joints", "active", *growth.seconds, "matrices / links", "apart", "memory [MiB]")
    rows = []
    for links, joints in growth.joints.items():
        warm, dense = (growth.seconds.get(name, {}).get(links) for name in (WARM_TREE, WARM_DENSE))
        faster, apart = ratio(dense, warm), growth.apart.get(links)
        rows.append(
            (
                str(links), str(joints), str(growth.active.get(links, "–")),
                *(_time(bench, name, links) for name in growth.seconds),
                "–" if faster is None else f"{faster:.3g}", "–" if apart is None else f"{apart:.0e}",
                f"{growth.memory[links]:.3g}",
            )
        )  # fmt: skip
    grown = [_exponent(growth.exponent(name)) for name in growth.seconds]
    rows.append(("exponent", "–", "–", *grown, "–", "–", _exponent(exponent(growth.memory))))
    return Shown("Growth with the arm's links [ms]", columns, rows)


def _time(bench: LinksBench, name: str, links: int) -> str:
    seconds = bench.growth.seconds[name].get(links)
    if seconds is None:
        return "–"
    time = f"{1e3 * seconds:.3g}"
    return time if bench.growth.certified.get(name, {}).get(links, True) else f"({time})"


def _exponent(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def _lifted(bench: LinksBench) -> Shown:
    columns = ("solver", "links", "steps", "answered", "certified", "guess [ms]", "step [ms]", "gap", "worst gap")
    rows = [
        (
            f"lifted:{name}", str(row.links), str(row.steps), str(row.answered), str(row.certified),
            f"{1e3 * row.guess:.3g}", f"{1e3 * row.step:.3g}", _gap(row.gap), _gap(row.worst),
        )
        for name, measured in bench.lifted.items()
        for row in measured
    ]  # fmt: skip
    return Shown("Sparse solvers in the lifted form", columns, rows)


def _gap(value: float | None) -> str:
    return "–" if value is None else f"{value:.0e}"
