"""A bench to read: tables for a terminal and as Markdown from the same rows, and a plot."""

import io
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

from comparisons.bench.links_report import links_notes, links_tables
from comparisons.bench.run import MINK, Bench, figures, programs
from comparisons.bench.settings import ROBOT_LEVELS
from comparisons.bench.shown import Shown, drawn_as
from comparisons.bench.tracks import label
from comparisons.bench.winding import APART, OURS
from comparisons.drawn import as_markdown
from prioritized_ik.errors import InputError
from prioritized_ik.files import write_whole
from prioritized_ik.validation import one_of

PLOTS = ("png", "svg", "pdf")

#: What each headline is a ratio of, and what it is to stay below.
TARGETS = {
    "winding_step_over_mink_p50": ("whole step, p50 / mink's p50", 0.13),
    "winding_step_p99_over_mink_p50": ("whole step, p99 / mink's p50", 0.35),
    "winding_step_over_placo_p50": ("whole step / placo with joint limits", 1.0),
    "solve_over_gelsy_p50": ("solve and certificate / one dgelsy", 0.9),
    "solve_over_gelsy_near_cut_p50": ("the same near the rank's cut", 1.2),
    "strict_over_one_level_p50": ("strict levels / one level, solve and certificate", 1.2),
    "robots_1_level_solve_over_mink_p50": ("robots, 1 level, problem to certified step / mink, worst robot", 0.3),
    "robots_1_level_over_mink_p50": ("the same with posing the problem", 0.3),
    "robots_3_levels_active_solve_over_mink_p50": (
        "robots, 3 levels with limits active, problem to step / mink's 1, worst robot",
        0.5,
    ),
    "robots_3_levels_active_over_mink_p50": ("the same with posing the problem", 0.5),
    "first_solve_s": ("import and first solve [s]", 1.0),
}

LEGEND = (
    "All in one process, one BLAS thread; programs take turns at stretches of some steps, which each goes through by "
    "itself, as in a loop. A step's time is the median over repeats, p50 and p99 are over steps. Whole step: from "
    "joint positions to certified step, touch included, warm from the step before. Rivals: the answering call alone, "
    "posed before. Of the whole step: observe (kinematics, touch, plan), problem, solve and certificate; plan is part "
    "of observe and timed again by itself, certificate is a proof of the same step from nothing (`certify`). mink: "
    "`mink.solve_ik`, whose distances to the cylinder are MuJoCo's, right to 1e-6 m. pink and placo know no contacts, "
    "dgelsy no limits. Gap: how much more level 1 costs at their "
    "answer than at ours to the same question, relative to not moving; none where they are asked for one level in "
    "place of three. Robots: posing (Jacobians and sides written into a `LiveProblem`), solve and certificate against "
    "`mink.solve_ik` of the first level, at the same states, of which posing is a part too; solve: from the posed problem "
    "on; 6 levels: a robot's own, or the three with their rows parted in two; cold: first step of a track."
)


def tables(bench: Bench) -> list[Shown]:
    """Return every table, ratios first."""
    told = figures(bench)
    return [
        _headlines(told),
        _programs(bench, told["winding"]),
        _kinds(told["winding"]["kinds"]),
        _parts(told["winding"]),
        _robots(told["robots"]),
        *links_tables(bench.links),
        _first_calls(bench),
        _functions(bench),
        _floor(bench),
    ]


def show(bench: Bench, console: Console) -> None:
    """Print all tables, and what was not there."""
    for shown in tables(bench):
        console.print(drawn_as(shown))
    for line in notes(bench):
        console.print(escape(line), soft_wrap=True)
    console.print(escape(LEGEND))


def markdown(bench: Bench) -> str:
    """Return the same as Markdown."""
    told = figures(bench)
    lines = []
    for shown in tables(bench):
        lines += [f"## {shown.title}", "", *as_markdown(drawn_as(shown, markdown=True)), ""]
    stated = ", ".join(f"{name} {version}" for name, version in told["versions"].items())
    return "\n".join([*lines, *notes(bench), "", LEGEND, "", f"{told['cpu']}; {stated}."]) + "\n"


def notes(bench: Bench) -> list[str]:
    """Return what was not there, what was left out, and by which path our steps were made."""
    lines = [f"{name} is not installed, so it is not compared: {how}." for name, how in bench.missing.items()]
    lines += links_notes(bench.links)
    windings = bench.windings
    made = ", ".join(f"{count} by the path {path}" for path, count in windings.paths.items())
    steps, certified = windings.steps, windings.certified
    lines.append(f"Winding steps timed: {steps}, {made}; all with certificate, which holds for {certified}.")
    return lines


def write_markdown(path: Path, bench: Bench) -> None:
    """Write the tables as one Markdown file, whole or not at all.

    Raises:
        InputError: it cannot be written.
    """
    _write(path, markdown(bench).encode("utf-8"))


def kind_of_plot(path: str) -> str:
    """Return the kind of plot that a file's name asks for, if it can be drawn.

    Raises:
        InputError: another kind, or Matplotlib is missing.
    """
    kind = one_of("kind of plot", Path(path).suffix.lstrip(".").lower(), PLOTS)
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise InputError("--plot needs Matplotlib: pip install 'prioritized-ik[report]'.") from error
    return kind


def write_plot(path: Path, bench: Bench) -> None:
    """Draw the ratios of the winding and the growth into one file, whole or not at all.

    Raises:
        InputError: it cannot be written.
    """
    from matplotlib.figure import Figure

    told = figures(bench)["winding"]["programs"]
    mink = told[MINK]["p50_s"]
    drawing = Figure(figsize=(10.0, 4.0), layout="constrained")
    bars, growth = drawing.subplots(1, 2)
    names = list(reversed(programs(bench)))
    bars.barh(names, [told[name]["p99_s"] / mink for name in names], color="0.8", label="p99")
    bars.barh(names, [told[name]["p50_s"] / mink for name in names], height=0.5, label="p50")
    bars.set_xlabel("time of a winding step / mink's p50")
    bars.set_xscale("log")
    bars.legend()
    for name, seconds in bench.links.growth.seconds.items():
        growth.loglog(list(seconds), list(seconds.values()), marker="o", label=name)
    growth.set_xlabel("links of the arm")
    growth.set_ylabel("time of a step [s]")
    growth.legend()
    content = io.BytesIO()
    drawing.savefig(content, format=kind_of_plot(str(path)), dpi=150)
    _write(path, content.getvalue())


def _write(path: Path, content: bytes) -> None:
    try:
        write_whole(path, lambda file: file.write(content))
    except OSError as error:
        raise InputError(
            f"cannot write to {str(path)!r} ({error}); choose a folder that exists and is writable."
        ) from error


def _headlines(told: dict[str, Any]) -> Shown:
    rows = [(what, _ratio(told[key]), f"{most:g}") for key, (what, most) in TARGETS.items()]
    rows.append(("winding steps that need no QP", f"{told['steps_without_qp']:.1%}", ""))
    return Shown("Ratios to watch", ("figure", "measured", "aim at most"), rows)


def _programs(bench: Bench, told: dict[str, Any]) -> Shown:
    rows = []
    for name in programs(bench):
        times, gaps = told["programs"][name], told["gaps"].get(name)
        answered = "–" if gaps is None else f"{gaps['answered']}/{gaps['steps']}"
        gap = ("–", "–", "–") if gaps is None else (f"{gaps['median']:.0e}", f"{gaps['max']:.0e}", answered)
        rows.append((name, _ratio(times["over_mink_p50"]), _micro(times["p50_s"]), _micro(times["p99_s"]), *gap))
    return Shown("The winding arm", ("program", "/ mink", "p50 [µs]", "p99 [µs]", "gap", "max", "answered"), rows)


def _kinds(told: dict[str, Any]) -> Shown:
    columns = ("kind of steps", "steps", "/ mink", "p99 / mink's p50", "solve / dgelsy", "p50 [µs]", "p99 [µs]")
    rows = [
        (
            kind, str(row["steps"]), _ratio(row["over_mink_p50"]), _ratio(row["p99_over_mink_p50"]),
            _ratio(row["solve_over_gelsy_p50"]), _micro(row["p50_s"]), _micro(row["p99_s"]),
        )
        for kind, row in told.items()
    ]  # fmt: skip
    return Shown("The whole step by kinds of winding steps", columns, rows)


def _parts(told: dict[str, Any]) -> Shown:
    whole = told["programs"][OURS]["p50_s"]
    rows = [
        (name, _share(name, times["p50_s"] / whole), _micro(times["p50_s"]), _micro(times["p99_s"]))
        for name, times in told["parts"].items()
    ]
    return Shown("Parts of the whole step", ("part", "share", "p50 [µs]", "p99 [µs]"), rows)


def _robots(told: dict[str, Any]) -> Shown:
    columns = (
        "robot",
        "joints",
        "levels",
        "/ mink",
        "solve / mink",
        "p99 / mink's p50",
        "inactive",
        "active",
        "cold",
        "active states",
        "p50 [µs]",
        "mink [µs]",
    )
    rows, parts = [], ("", "solve_", "p99_", "inactive_", "active_", "cold_")
    for name, robot in told.items():
        for count in ROBOT_LEVELS:
            row = robot["levels"][label(count)]
            rows.append(
                (
                    name, str(robot["joints"]), str(count),
                    *(_ratio(row[f"{part}over_mink_p50"]) for part in parts),
                    f"{row['active']}/{robot['states']}", _micro(row["p50_s"]), _micro(robot["mink"][MINK]["p50_s"]),
                )
            )  # fmt: skip
    return Shown("Robots, strict levels over mink's one", columns, rows)


def _first_calls(bench: Bench) -> Shown:
    columns = (
        "program",
        "imports, posing [ms]",
        "first solve [ms]",
        "second [ms]",
        "to the first answer [ms]",
        "peak memory [MiB]",
    )
    rows = [
        (
            name, _milli(call.ready), _milli(call.first), _milli(call.second), _milli(call.total),
            "–" if call.peak is None else f"{call.peak:.0f}",
        )
        for name, call in bench.first_calls.items()
    ]  # fmt: skip
    return Shown("A fresh process", columns, rows)


def _functions(bench: Bench) -> Shown:
    rows = [
        (function.name, f"{function.calls:.1f}", _micro(function.own), _micro(function.total))
        for function in bench.profile.functions
    ]
    return Shown(
        "Where a winding step's time goes, under the profiler", ("function", "calls", "own [µs]", "all [µs]"), rows
    )


def _floor(bench: Bench) -> Shown:
    floor = bench.profile.floor
    rows = [*((name, _micro(seconds)) for name, seconds in floor.items()), ("together", _micro(sum(floor.values())))]
    return Shown("The floor of a winding step", ("part", "p50 [µs]"), rows)


def _share(part: str, share: float) -> str:
    return "timed apart" if part in APART else f"{share:.0%}"


def _ratio(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"


def _micro(seconds: float | None) -> str:
    return "–" if seconds is None else f"{1e6 * seconds:.0f}"


def _milli(seconds: float | None) -> str:
    return "–" if seconds is None else f"{1e3 * seconds:.3g}"
