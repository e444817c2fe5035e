"""Who answered: one series of answers for each solver, formulation, accuracy and start. Pure."""

from dataclasses import dataclass

import polars

from comparisons.jobs import COLD, WARM
from comparisons.profiles import error

KEY = ("solver", "formulation", "accuracy", "start")
STEP = ("case", "step")

Key = tuple[str, str, float | None, str | None]  # values of the columns `KEY`


@dataclass(frozen=True)
class Series:
    """One series.

    Attributes:
        solver, formulation: as in the verdict table.
        label: shortest name that no other series has.
        aside: whether these are the cold starts of a solver that also starts warm, shown when asked for.
    """

    solver: str
    formulation: str
    label: str
    aside: bool


@dataclass(frozen=True)
class Answers:
    """Answers of all series, repeats made one.

    Attributes:
        series: in the order of the verdict table.
        table: one row for each case, step and series, whose number is in the column `series`; figures are those of the
            first repeat, or of the first that failed; `seconds` (build and solve) is the median of all. `error` says how
            wrong an accepted answer is (`profiles.error`); null if that is not known.
    """

    series: tuple[Series, ...]
    table: polars.DataFrame


def answers_of(steps: polars.DataFrame, order: list[tuple[str, str]]) -> Answers:
    """Return the series and their answers.

    Args:
        steps: the long table of `Source.steps`.
        order: (solver, formulation) of the verdict table's rows; series that it lacks come last.
    """
    places = {pair: place for place, pair in enumerate(order)}
    keys = steps.select(KEY).unique().rows()
    keys.sort(
        key=lambda key: (places.get(key[:2], len(places)), *(str(part) for part in key[:2]), -(key[2] or 0.0), str(key[3]))
    )
    series = tuple(
        Series(key[0], key[1], name, key[3] == COLD and (*key[:3], WARM) in keys)
        for key, name in zip(keys, labels(keys), strict=True)
    )
    numbers = polars.DataFrame(
        [(*key, number) for number, key in enumerate(keys)],
        schema={**{name: steps.schema[name] for name in KEY}, "series": polars.Int64},
        orient="row",
    )
    firsts = [name for name in steps.columns if name not in (*STEP, "repeat")]
    table = (
        steps.sort("found", "repeat", maintain_order=True)
        .join(numbers, on=list(KEY), how="left", nulls_equal=True)
        .group_by(*STEP, "series", maintain_order=True)
        .agg(
            *[polars.col(name).first() for name in firsts],
            (polars.col("build_s") + polars.col("solve_s")).median().alias("seconds"),
        )
        .with_columns(polars.when(polars.col("found")).then(error()).alias("error"))
        .sort("case", "step", "series")
    )
    return Answers(series, table)


def labels(keys: list[Key]) -> list[str]:
    """Return the shortest name of each of `keys` that no other has."""
    return [_label(key, keys) for key in keys]


def _label(key: Key, keys: list[Key]) -> str:
    solver, formulation, accuracy, start = key
    parts = [solver]
    if any(other[0] == solver and other[1] != formulation for other in keys) and formulation != "lexicographic":
        parts.append(formulation)
    if len({other[2] for other in keys if other[:2] == key[:2]}) > 1:
        parts.append("as is" if accuracy is None else f"{accuracy:.0e}")
    if start != WARM and any(other[:3] == key[:3] and other[3] != start for other in keys):
        parts.append(str(start))
    return ", ".join(parts)
