"""One bench: everything measured in one process, and its figures as JSON takes them."""

import dataclasses
import importlib.metadata
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

import qpsolvers

from comparisons.bench.clock import Times, quantile, ratio
from comparisons.bench.first_call import FirstCall, measure_first_calls
from comparisons.bench.growth import Growth, exponent, measure_growth
from comparisons.bench.lifted import LiftedTimes, measure_lifted
from comparisons.bench.neighbours import PACKAGES, missing
from comparisons.bench.profile import Profile, measure_profile
from comparisons.bench.settings import ROBOT_LEVELS, BenchSettings
from comparisons.bench.tracks import SOLVING, RobotTimes, label, measure_robots
from comparisons.bench.winding import KINDS, NEAR, OURS, PARTS, WindingTimes, measure_windings
from comparisons.origin import cpu_model, versions
from comparisons.settings import MINK_SOLVERS

MINK = "mink (daqp)"
SOLVE = "solve and certificate"
DGELSY = "dgelsy"


@dataclass(frozen=True)
class LinksBench:
    """What was measured of arms of several lengths.

    Attributes:
        settings: how much.
        growth: see its module.
        lifted: sparse solvers by name, see its module.
    """

    settings: BenchSettings
    growth: Growth
    lifted: dict[str, list[LiftedTimes]]


@dataclass(frozen=True)
class Bench:
    """What one bench measured.

    Attributes:
        settings: how much.
        windings, robots, first_calls, profile: see each one's module.
        links: arms of several lengths.
        missing: programs that are not installed, and how to get them.
    """

    settings: BenchSettings
    windings: WindingTimes
    robots: dict[str, RobotTimes]
    links: LinksBench
    first_calls: dict[str, FirstCall]
    profile: Profile
    missing: dict[str, str]


def run(settings: BenchSettings, tell: Callable[[str, int, int], object]) -> Bench:
    """Return what everything takes; `tell` hears what is done, how much of it, and of how much."""
    absent = missing()
    for solver in MINK_SOLVERS:
        if solver not in qpsolvers.available_solvers:
            absent[f"mink ({solver})"] = f"pip install qpsolvers[{solver}]"
    return Bench(
        settings,
        measure_windings(settings, tell),
        measure_robots(settings, tell),
        run_links(settings, tell),
        measure_first_calls(settings, tell),
        measure_profile(settings),
        absent,
    )


def run_links(settings: BenchSettings, tell: Callable[[str, int, int], object]) -> LinksBench:
    """Return what arms of several lengths take; `tell` as in `run`."""
    return LinksBench(settings, measure_growth(settings, tell), measure_lifted(settings, tell))


def links_figures(bench: LinksBench) -> dict[str, Any]:
    """Return what was measured of arms of several lengths as JSON takes it."""
    growth = bench.growth
    exponents = {name: growth.exponent(name) for name in growth.seconds} | {"memory": exponent(growth.memory)}
    return {
        "growth": dataclasses.asdict(growth) | {"exponents": exponents},
        "lifted": {name: [dataclasses.asdict(row) for row in rows] for name, rows in bench.lifted.items()},
    }


def links_alone(bench: LinksBench) -> dict[str, Any]:
    """Return the same with what it was measured on."""
    return {
        "cpu": cpu_model(),
        "versions": versions({"daqp": importlib.metadata.version("daqp")}),
        "blas_threads": 1,
        "settings": {name: getattr(bench.settings, name) for name in ("links", "largest_rival", "lifted", "lifted_steps")},
        **links_figures(bench),
    }


def figures(bench: Bench) -> dict[str, Any]:
    """Return everything that was measured as JSON takes it: the ratios to watch first, times in seconds."""
    times, works = bench.windings.times, bench.windings.works
    mink = quantile(times.of(MINK), 0.5)
    return {
        **headlines(bench),
        "cpu": cpu_model(),
        "versions": versions(_versions(bench)),
        "blas_threads": 1,
        "settings": dataclasses.asdict(bench.settings),
        "missing": bench.missing,
        "paths": dict(bench.windings.paths),
        "winding": {
            "steps": bench.windings.steps,
            "certificates": bench.windings.certificates,
            "certified": bench.windings.certified,
            "without_qp": bench.windings.without_qp,
            "programs": {
                name: _told(times, name) | {"over_mink_p50": ratio(quantile(times.of(name), 0.5), mink)}
                for name in programs(bench)
            },
            "parts": {name: _told(times, name) for name in PARTS},
            "kinds": {kind: kind_figures(bench, kind) for kind in (*KINDS, *bench.settings.weights) if works[kind]},
            "gaps": {name: _gaps(found) for name, found in bench.windings.gaps.items()},
        },
        "robots": {name: _robot(robot) for name, robot in bench.robots.items()},
        **links_figures(bench.links),
        "first_calls": {name: dataclasses.asdict(call) for name, call in bench.first_calls.items()},
        "profile": dataclasses.asdict(bench.profile),
    }


def headlines(bench: Bench) -> dict[str, float | None]:
    """Return the figures that are to be kept low."""
    times, works = bench.windings.times, bench.windings.works
    mink = quantile(times.of(MINK), 0.5)
    solve, gelsy = (quantile(times.of(name), 0.5) for name in (SOLVE, DGELSY))
    near = {name: quantile(times.of(name, works[NEAR]), 0.5) for name in (SOLVE, DGELSY)}
    weighted = set().union(*(works[kind] for kind in bench.settings.weights if kind != "strict"))
    strict, one = (quantile(times.of(SOLVE, chosen), 0.5) for chosen in (works["strict"], weighted))
    placo = quantile(times.of("placo"), 0.5)
    return {
        "winding_step_over_mink_p50": ratio(quantile(times.of(OURS), 0.5), mink),
        "winding_step_p99_over_mink_p50": ratio(quantile(times.of(OURS), 0.99), mink),
        "winding_step_over_placo_p50": ratio(quantile(times.of(OURS), 0.5), placo),
        "solve_over_gelsy_p50": ratio(solve, gelsy),
        "solve_over_gelsy_near_cut_p50": ratio(near[SOLVE], near[DGELSY]),
        "strict_over_one_level_p50": ratio(strict, one),
        **{
            f"robots_{name}_over_mink_p50": worst(
                robot_ratio(robot, levels, robot.active[3] if levels == 3 else None, solving=solving)
                for robot in bench.robots.values()
            )
            for name, levels, solving in (
                ("1_level", 1, False),
                ("3_levels_active", 3, False),
                ("1_level_solve", 1, True),
                ("3_levels_active_solve", 3, True),
            )
        },
        "steps_without_qp": ratio(bench.windings.without_qp, bench.windings.steps),
        "first_solve_s": bench.first_calls["ours"].total,
    }


def programs(bench: Bench) -> list[str]:
    """Return the whole step and every rival of the winding, in the order of the tables."""
    return [OURS, *(name for name in bench.windings.times.seconds if name not in (OURS, *PARTS))]


def kind_figures(bench: Bench, kind: str) -> dict[str, float | int | None]:
    """Return what a kind of winding steps takes: ours and mink's at the same steps."""
    times, chosen = bench.windings.times, set(bench.windings.works[kind])
    ours, mink, solve, gelsy = (times.of(name, chosen) for name in (OURS, MINK, SOLVE, DGELSY))
    return {
        "steps": len(chosen),
        "p50_s": quantile(ours, 0.5),
        "p99_s": quantile(ours, 0.99),
        "over_mink_p50": ratio(quantile(ours, 0.5), quantile(mink, 0.5)),
        "p99_over_mink_p50": ratio(quantile(ours, 0.99), quantile(mink, 0.5)),
        "solve_over_gelsy_p50": ratio(quantile(solve, 0.5), quantile(gelsy, 0.5)),
    }


def robot_ratio(
    robot: RobotTimes, levels: int, works: Collection[Any] | None = None, share: float = 0.5, *, solving: bool = False
) -> float | None:
    """Return ours, without posing if `solving`, over the median of mink's one level at the same states."""
    chosen = None if works is None else set(works)
    ours, mink = (robot.times.of(name, chosen) for name in (label(levels) + SOLVING * solving, MINK))
    return ratio(quantile(ours, share), quantile(mink, 0.5))


def worst(ratios: "Collection[float | None] | Any") -> float | None:
    """Return the largest of ratios, None if there is none."""
    return max((value for value in ratios if value is not None), default=None)


def _robot(robot: RobotTimes) -> dict[str, Any]:
    states = set(robot.times.seconds[label(1)])
    by_levels: dict[str, Any] = {}
    for count in ROBOT_LEVELS:
        active = robot.active[count]
        by_levels[label(count)] = {
            **_told(robot.times, label(count)),
            "over_mink_p50": robot_ratio(robot, count),
            "p99_over_mink_p50": robot_ratio(robot, count, share=0.99),
            "solve_over_mink_p50": robot_ratio(robot, count, solving=True),
            "inactive_over_mink_p50": robot_ratio(robot, count, states - active),
            "active_over_mink_p50": robot_ratio(robot, count, active),
            "cold_over_mink_p50": robot_ratio(robot, count, robot.cold),
            "active": len(active),
        }
    return {
        "joints": robot.joints,
        "states": len(states),
        "steps": robot.steps,
        "certificates": robot.certificates,
        "certified": robot.certified,
        "paths": dict(robot.paths),
        "levels": by_levels,
        "mink": {name: _told(robot.times, name) for name in robot.times.seconds if name.startswith("mink")},
        "gaps": {name: _gaps(found) for name, found in robot.gaps.items()},
    }


def _told(times: Times, name: str) -> dict[str, float | None]:
    found = times.of(name)
    return {"p50_s": quantile(found, 0.5), "p99_s": quantile(found, 0.99)}


def _gaps(found: list[float]) -> dict[str, float | int]:
    finite = sorted(value for value in found if value < float("inf"))
    return {
        "steps": len(found),
        "answered": len(finite),
        "median": finite[len(finite) // 2] if finite else 0.0,
        "max": max(finite, key=abs, default=0.0),
    }


def _versions(bench: Bench) -> dict[str, str]:
    wanted = ["daqp", *(package for name, package in PACKAGES.items() if name not in bench.missing)]
    wanted += [] if "mink (proxqp)" in bench.missing else ["proxsuite"]
    return {package: importlib.metadata.version(package) for package in wanted}
