"""What went wrong, grouped, with problems to download."""

import base64
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import polars

from comparisons.page.series import Answers
from comparisons.summary import AGREES, bound_limit
from prioritized_ik.problem import IKProblem
from prioritized_ik.problem_file import problem_bytes
from prioritized_ik.reaching import Ending
from prioritized_ik.solvers.step import StepStatus
from prioritized_ik.winding.episode import Outcome

EXAMPLES = 6  # steps shown of each group
BUDGET = 1_500_000  # bytes of a page that all problems together take at most

WORDS = {
    "crash": "crashed",
    "timeout": "ran out of time",
    "memory": "ran out of memory",
    "nan": "answered with values that are not finite",
    "error": "raised an error",
    StepStatus.NOT_FOUND.name: "gave no answer",
    StepStatus.VIOLATED.name: "broke a bound or row",
    StepStatus.INFEASIBLE.name: "called the rows a conflict",
    "off": "answered, and was wrong by more than the verdict allows",
    "uncertified": "answered, and no certificate was reached",
    Outcome.LOST.name: "drove the arm, which lost contact",
    Outcome.OUT_OF_STEPS.name: "drove the arm, which came to no end",
    Ending.REACHED.name: "drove the robot, which met its tasks, as it did not when recorded",
    Ending.OUT_OF_REACH.name: "drove the robot, which came to rest off its targets",
    Ending.STUCK.name: "drove the robot, which limits held back",
    Outcome.SOLVER_FAILED.name: "drove the arm, and failed on the way",
}


def failures(answers: Answers, episodes: polars.DataFrame, problem: Callable[[str, int], IKProblem]) -> dict[str, Any]:
    """Return `groups` and `files`.

    A group is one way in which one series failed: `solver` (its label), `what`, `count` of `asked` steps or `windings`, the
    first `message`, and up to `EXAMPLES` steps, each `case`, `step` and whether its problem is among the `files`: base64 of
    the files of `problem_file`, by "case step". A wrong answer is a failure only of a series that must agree, the
    lexicographic ones. Then the driven episodes that did not succeed.

    Args:
        answers: of all series.
        episodes: the table of `Source.episodes`.
        problem: returns the problem of a case's step.
    """
    lexicographic = [number for number, series in enumerate(answers.series) if series.formulation == "lexicographic"]
    must_agree = polars.col("series").is_in(lexicographic)
    limits = {number: bound_limit(answers.series[number].solver) for number in lexicographic}
    bound = polars.col("series").replace_strict(limits, default=None, return_dtype=polars.Float64)
    allowed = polars.when("free").then(polars.lit(AGREES)).otherwise(bound)
    kind = (
        polars.when(polars.col("failure").is_not_null())
        .then(polars.col("failure"))
        .when(~polars.col("found"))
        .then(polars.col("status"))
        .when(must_agree & (polars.col("error") > allowed))
        .then(polars.lit("off"))
        .when(must_agree & ~polars.col("free") & ~polars.col("certified").fill_null(value=False))
        .then(polars.lit("uncertified"))
    )
    asked = dict(answers.table.group_by("series").len().iter_rows())
    table = answers.table.with_columns(kind.alias("kind")).filter(polars.col("kind").is_not_null())
    groups: list[dict[str, Any]] = []
    for (series, what), failed in sorted(table.group_by(["series", "kind"], maintain_order=True), key=lambda item: item[0]):
        steps = failed.select("case", "step").rows()
        messages = failed["message"].drop_nulls().to_list()
        groups.append(
            {
                "solver": answers.series[series].label,
                "what": WORDS.get(what, what),
                "windings": False,
                "count": len(steps),
                "asked": asked[series],
                "message": next((message for message in messages if message), ""),
                "examples": _spread(steps),
            }
        )
    files = _files([example for group in groups for example in group["examples"]], problem)
    for group in groups:
        group["examples"] = [
            {"case": case, "step": step, "file": f"{case} {step}" in files} for case, step in group["examples"]
        ]
    return {"groups": [*groups, *_windings(episodes)], "files": files}


def _windings(episodes: polars.DataFrame) -> list[dict[str, Any]]:
    """Return a group for each way in which each solver's own episodes ended and should not."""
    groups: dict[tuple[str, str, str], list[dict[str, Any]]] = defaultdict(list)
    for row in episodes.filter(~polars.col("done").fill_null(value=False)).iter_rows(named=True):
        groups[row["solver"], row["formulation"], row.get("failure") or row["outcome"]].append(row)
    return [
        {
            "solver": solver,
            "what": WORDS.get(outcome, outcome),
            "windings": True,
            "count": len(rows),
            "asked": episodes.filter((polars.col("solver") == solver) & (polars.col("formulation") == formulation)).height,
            "message": next((row["message"] for row in rows if row["message"]), ""),
            "examples": [{"case": row["case"], "step": row["steps"], "file": False} for row in rows[:EXAMPLES]],
        }
        for (solver, formulation, outcome), rows in groups.items()
    ]


def _files(wanted: list[tuple[str, int]], problem: Callable[[str, int], IKProblem]) -> dict[str, str]:
    """Return the files of the steps wanted most, as many as fit."""
    counts: dict[tuple[str, int], int] = defaultdict(int)
    for one in wanted:
        counts[one] += 1
    files: dict[str, str] = {}
    room = BUDGET
    for case, step in sorted(counts, key=lambda item: (-counts[item], item)):
        content = base64.b64encode(problem_bytes(problem(case, step))).decode("ascii")
        room -= len(content)
        if room < 0:
            break
        files[f"{case} {step}"] = content
    return files


def _spread(steps: list[tuple[str, int]]) -> list[tuple[str, int]]:
    """Return up to `EXAMPLES` of `steps`: whole numbers apart, so that groups that fail alike show the same ones."""
    return steps[:: max(1, -(-len(steps) // EXAMPLES))]
