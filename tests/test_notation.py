"""docs/notation.md leads from the paper to the code: every function in it exists and cites its equation."""

import importlib
import inspect
import re

import pytest
from notation import PAGE, lines


def resolve(path: str) -> object:
    """Return the object at a dotted path, the longest importable part of it being a module."""
    parts = path.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            found: object = importlib.import_module(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        for name in parts[cut:]:
            found = getattr(found, name)
        return found
    raise ModuleNotFoundError(path)


def cites(text: str, equation: int) -> bool:
    """Whether a docstring names an equation: "Eq. (12)", "Eqs. 12 and 13", "(Eqs. 4, 5)", "Eqs. (12) to (14)"."""
    for passage in re.findall(r"Eqs?\. ?([()\d, andto-]+)", text):
        numbers = [int(n) for n in re.findall(r"\d+", passage)]
        spans = re.findall(r"(\d+)\)? ?(?:-|to) ?\(?(\d+)", passage)
        if equation in numbers or any(int(a) <= equation <= int(b) for a, b in spans):
            return True
    return False


@pytest.mark.parametrize(("equations", "path"), lines(), ids=lambda value: str(value))
def test_every_function_of_the_page_exists_and_cites_its_equation(equations: list[int], path: str) -> None:
    text = inspect.getdoc(resolve(path)) or ""
    missing = [equation for equation in equations if not cites(text, equation)]
    assert not missing, f"{path} does not cite Eq. {missing}"


def test_the_page_covers_every_equation_that_has_a_function() -> None:
    covered = {equation for equations, _ in lines() for equation in equations}
    assert covered == {*range(1, 7), *range(10, 25)}


def test_every_name_in_backticks_with_dots_exists() -> None:
    for path in re.findall(r"`(prioritized_ik\.[\w.]+)`", PAGE.read_text(encoding="utf-8")):
        assert resolve(path) is not None


def test_a_function_that_is_not_there_is_found_out() -> None:
    with pytest.raises((AttributeError, ModuleNotFoundError)):
        resolve("prioritized_ik.weights.no_such_function")
    assert not cites("Eq. (12): something", 13)
