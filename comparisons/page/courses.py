"""Error and time of every series along each episode. Pure."""

from typing import Any

from comparisons.page.series import Answers

FAILED = -1.0  # in place of a figure where the series gave no accepted answer

#: A page holds so many figures of each kind at most; cases beyond are left out, and the page says so.
MOST_FIGURES = 150_000


def courses(answers: Answers) -> tuple[list[dict[str, Any]], int]:
    """Return the course of each case, as many as fit, and how many cases are left out.

    Each has `case`, `steps`, `free` (0 or 1 for each step), and `error` and `time` [ms]: a list for each series, None where
    the step was not asked of it, `FAILED` where it gave no accepted answer. The error is
    that of `profiles.error`.
    """
    found: list[dict[str, Any]] = []
    left_out = figures = 0
    for (case,), table in answers.table.group_by(["case"], maintain_order=True):
        steps = sorted(set(table["step"].to_list()))
        figures += len(steps) * len(answers.series)
        if found and figures > MOST_FIGURES:
            left_out += 1
            continue
        place = {step: number for number, step in enumerate(steps)}
        free = [0] * len(steps)
        error: list[list[float | None]] = [[None] * len(steps) for _ in answers.series]
        time: list[list[float | None]] = [[None] * len(steps) for _ in answers.series]
        columns = ("step", "series", "free", "found", "error", "seconds")
        for step, series, is_free, accepted, value, seconds in table.select(columns).iter_rows():
            at = place[step]
            free[at] = int(bool(is_free))
            error[series][at] = _short(value) if accepted else FAILED
            time[series][at] = None if seconds is None else _short(1e3 * seconds)
        found.append({"case": case, "steps": steps, "free": free, "error": error, "time": time})
    return found, left_out


def _short(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.3g}")
