"""The page as a reader meets it, in a real headless Chromium: it shows, sorts, plays and downloads, on a phone too."""

import base64
import io
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import playwright.sync_api as playwright
import polars
import pytest
from page_fixtures import CASE, FAST, MESSAGE, SLOW, WRONG, SmallStore
from PIL import Image
from repository import ROOT
from winding_fixtures import recorded

import prioritized_ik as pik
from comparisons.page import write_page
from comparisons.summary import summarise
from prioritized_ik.problem_file import load_problem
from prioritized_ik.recording import Recording
from prioritized_ik.winding.episode import Episode

EPISODE = recorded(link=13)  # what FAST drove, the first of the choice

WIDTHS = {"desktop": (1280, 900), "phone": (390, 844)}


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    store = SmallStore(tmp_path_factory.mktemp("comparison"))
    return write_page(store.folder, store, summarise(store.steps(), store.episodes()))


@pytest.fixture(scope="module", params=WIDTHS.values(), ids=WIDTHS.keys())
def window(request: pytest.FixtureRequest, browser: "playwright.Browser") -> Iterator["playwright.Page"]:
    """An empty page, for the report to be opened in."""
    width, height = request.param
    context = browser.new_context(viewport={"width": width, "height": height}, accept_downloads=True)
    yield context.new_page()
    context.close()


#: Told by what stands in for a graphics card, whenever the browser shows a canvas: no fault of the page.
STALL = "GPU stall due to ReadPixels"


@contextmanager
def complaints(page: "playwright.Page") -> Iterator[list[str]]:
    """What the page says on its console, or raises, meanwhile."""
    said: list[str] = []

    def on_console(message: "playwright.ConsoleMessage") -> None:
        if STALL not in message.text:
            said.append(f"{message.type}: {message.text}")

    def on_error(error: "playwright.Error") -> None:
        said.append(str(error))

    page.on("console", on_console)
    page.on("pageerror", on_error)
    yield said
    page.remove_listener("console", on_console)
    page.remove_listener("pageerror", on_error)


@pytest.fixture
def page(window: "playwright.Page", report: Path) -> Iterator["playwright.Page"]:
    """The report, opened anew; it must neither complain nor ask for anything else whatever a test does to it."""
    ours = (report.as_uri(), "blob:", "data:")
    asked: list[str] = []

    def on_request(request: "playwright.Request") -> None:
        asked.append(request.url)

    window.goto("about:blank")  # else the browser would put choices back as the test before left them
    window.on("request", on_request)
    with complaints(window) as said:
        window.goto(report.as_uri())
        yield window
    window.remove_listener("request", on_request)
    assert said == []
    assert report.as_uri() in asked
    assert [url for url in asked if not url.startswith(ours)] == []


def picture(page: "playwright.Page", selector: str) -> str:
    data: str = page.locator(selector).evaluate("canvas => canvas.toDataURL()")
    return data


def shown(page: "playwright.Page") -> np.ndarray:
    """The pixels of the replay: red, green, blue, opacity."""
    content = base64.b64decode(picture(page, ".stage canvas").partition(",")[2])
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGBA"), dtype=int)


def count_orange(page: "playwright.Page") -> int:
    """How many pixels of the replay have the colour of links in contact."""
    red, _, blue, alpha = np.moveaxis(shown(page), 2, 0)
    return int(((alpha > 0) & (red > 2 * blue + 40)).sum())


def status(page: "playwright.Page") -> tuple[int, int, int]:
    """Step, last step and links in contact, as the replay tells."""
    found = re.fullmatch(r"step (\d+) of (\d+) · (\d+) of \d+ links in contact", page.locator(".status").inner_text())
    assert found is not None
    step, last, touching = map(int, found.groups())
    return step, last, touching


def column(page: "playwright.Page", place: int) -> list[str]:
    return page.locator(f"#verdict-table tbody tr > :nth-child({place})").all_inner_texts()


def test_nothing_is_wider_than_the_screen(page: "playwright.Page") -> None:
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    outside = page.evaluate("""[...document.querySelectorAll("body *")]
        .filter((node) => !node.closest(".scroll, nav, pre"))
        .filter((node) => node.getBoundingClientRect().right > window.innerWidth + 1)
        .map((node) => node.outerHTML)""")
    assert outside == []


def test_every_section_shows_something(page: "playwright.Page") -> None:
    assert "The fastest that agrees is proxqp" in page.locator("#finding").inner_text()
    assert page.locator("#verdict-table tbody tr").count() == 3
    assert page.locator("#profiles path.line").count() == 3
    assert page.locator("#agreement tbody tr").count() == 3
    assert page.locator("#course path.line").count() == 6
    assert page.locator("#failures .card").count() == 3
    assert page.locator("#facts dt").count() >= 4


def test_the_solver_stays_in_sight_while_the_table_scrolls(page: "playwright.Page") -> None:
    first = page.locator("#verdict-table tbody th").first
    before = first.bounding_box()
    page.locator("#verdicts .scroll").evaluate("box => { box.scrollLeft = 400; }")
    after = first.bounding_box()
    assert before is not None
    assert after is not None
    assert after["x"] == pytest.approx(before["x"], abs=2)


def test_a_click_on_a_heading_sorts_and_another_one_turns_it_round(page: "playwright.Page") -> None:
    heading = page.get_by_role("button", name="p50 [ms]")
    place = 1 + page.locator("#verdict-table thead th").all_inner_texts().index("p50 [ms]")
    heading.click()
    assert column(page, 1) == [FAST, WRONG, SLOW]
    heading.click()
    assert column(page, 1) == [SLOW, WRONG, FAST]
    assert [float(cell) for cell in column(page, place)] == [10.0, 4.0, 2.0]
    page.get_by_role("button", name="solver", exact=True).click()
    assert column(page, 1) == sorted([FAST, SLOW, WRONG])


def test_the_replay_starts_with_the_wound_arm_and_scrubs_back(page: "playwright.Page") -> None:
    step, last, touching = status(page)
    assert (step, touching) == (last, EPISODE.in_contact[-1].sum())
    wound, orange = picture(page, ".stage canvas"), count_orange(page)
    page.locator(".slider").fill("0")
    step, _, at_first = status(page)
    assert (step, at_first) == (0, EPISODE.in_contact[0].sum())
    assert at_first < touching
    assert picture(page, ".stage canvas") != wound
    assert count_orange(page) < orange / 2


def wait_until(page: "playwright.Page", comes_true: Callable[[], bool]) -> None:
    """Let the page go on until then. Its policy forbids the evaluation that Playwright's own waiting rests on."""
    for _ in range(600):
        if comes_true():
            return
        page.wait_for_timeout(50)
    raise AssertionError("it never came true")


def test_the_replay_plays_to_the_end_and_pauses_on_the_way(page: "playwright.Page") -> None:
    page.get_by_role("button", name="Play").click()
    wait_until(page, lambda: status(page)[0] >= 5)
    page.get_by_role("button", name="Pause").click()
    step, last, _ = status(page)
    assert 5 <= step < last
    page.wait_for_timeout(200)
    assert status(page)[0] == step
    page.get_by_label("Speed", exact=True).select_option("4 ×")
    page.locator(".slider").fill(str(last - last // 4))
    page.get_by_role("button", name="Play").click()
    wait_until(page, lambda: status(page)[0] == last)
    page.get_by_role("button", name="Play").wait_for()


def test_the_replay_shows_the_chosen_solver_and_lays_another_over_it(page: "playwright.Page") -> None:
    solver, other = page.get_by_label("Solver", exact=True), page.get_by_label("Laid over it", exact=True)
    assert solver.locator("option").all_inner_texts() == [FAST, SLOW]
    assert status(page)[1] == EPISODE.steps
    first = picture(page, ".stage canvas")
    other.select_option(SLOW)
    both = picture(page, ".stage canvas")
    solver.select_option(SLOW)
    other.select_option("–")
    second = picture(page, ".stage canvas")
    assert len({first, both, second}) == 3
    assert status(page)[1] == recorded(link=13, tilt=0.3).steps != EPISODE.steps
    solver.select_option(FAST)
    assert picture(page, ".stage canvas") == first


class Pierced(SmallStore):
    """The same, but for one winding whose last links stand in the middle of the object."""

    def _driven(self, solver: str) -> Episode:
        driven = super()._driven(solver)
        if solver == FAST:
            return driven
        positions = driven.positions.copy()
        positions[:, -3:] = driven.settings.wound_object().position
        return replace(driven, positions=positions)


def test_what_is_inside_the_object_shows_and_nothing_else_has_its_colour(
    browser: "playwright.Browser", tmp_path: Path
) -> None:
    store = Pierced(tmp_path)
    file = write_page(tmp_path, store, summarise(store.steps(), store.episodes()))
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.goto(file.as_uri())
    pink = []
    for solver in (FAST, SLOW):
        page.get_by_label("Solver", exact=True).select_option(solver)
        red, green, blue = np.moveaxis(shown(page), 2, 0)[:3]
        pink.append(int(((red > green + 60) & (blue > green + 40)).sum()))
    assert pink[0] == 0
    assert pink[1] > 200


def test_a_drag_turns_the_arm(page: "playwright.Page") -> None:
    before = picture(page, ".stage canvas")
    page.locator(".stage canvas").scroll_into_view_if_needed()
    box = page.locator(".stage canvas").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 100, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 180, box["y"] + 120)
    page.mouse.up()
    assert picture(page, ".stage canvas") != before


def test_agreement_shows_digits_by_answer(page: "playwright.Page") -> None:
    first = page.locator("#agreement tbody tr").first.locator("td")
    assert first.all_inner_texts() == ["", "9", "3"]
    page.get_by_label("Answer", exact=True).select_option("certified step")
    assert first.all_inner_texts() == ["", "16", "16"]
    page.locator("#agreement tbody td").nth(1).click()
    assert "daqp and proxqp: the same to all 16 digits" in page.locator("#agreement .told").inner_text()


def test_a_chip_hides_a_solver_in_every_chart(page: "playwright.Page") -> None:
    page.locator("#profiles .chip", has_text=WRONG).click()
    assert page.locator("#profiles path.line").count() == 2
    assert page.locator("#course path.line").count() == 4
    assert page.locator("#course .chip", has_text=WRONG).get_attribute("aria-pressed") == "false"


def test_a_chart_tells_the_figure_under_the_pointer(page: "playwright.Page") -> None:
    chart = page.locator("#course .chart").nth(1)
    chart.scroll_into_view_if_needed()
    box = chart.locator("svg").bounding_box()
    assert box is not None
    for part in range(2, 9):  # somewhere on the way down there is a line
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] * part / 10)
        if chart.locator(".tip").is_visible():
            break
    assert re.search(r"(daqp|proxqp|scs)\s+step \d+: (2|4|10)$", chart.locator(".tip").inner_text())


def test_what_a_solver_says_is_text_and_its_problem_can_be_downloaded(page: "playwright.Page", tmp_path: Path) -> None:
    card = page.locator(".card", has_text="crashed")
    assert card.locator(".message").text_content() == MESSAGE
    assert page.locator("main img").count() == 0
    assert page.get_by_label("Winding", exact=True).first.locator("option").all_inner_texts() == [CASE]
    with page.expect_download() as started:
        card.locator(".link").click()
    started.value.save_as(tmp_path / "problem.npz")
    assert re.fullmatch(r"[\w.=-]+\.npz", started.value.suggested_filename)
    assert load_problem(tmp_path / "problem.npz").joint_count > 0
    assert "SolveOptions(rank_tolerance=0.0001)" in page.locator("#failures-view pre").inner_text(), "as it was compared"


class Scened(SmallStore):
    """The same, but two solvers drove the robot of a scene, the second to another place."""

    scene = pik.load_scene(ROOT / "examples" / "scenes" / "reach.toml")

    def episodes(self) -> polars.DataFrame:
        episodes = super().episodes().with_columns(turns=None, outcome=polars.lit("REACHED"), error=1e-7)
        for solver, away in ((FAST, 0.1), (SLOW, 0.8)):
            q = self.scene.q + away * np.linspace(0.0, 1.0, 11)[:, None]
            Recording.of([self.episode.problem(0)] * 11, q, np.zeros((11, 7))).save(self.folder / f"{solver}.npz")
        return episodes.with_columns(steps=polars.lit(11))

    def model(self, case: str) -> mujoco.MjModel:
        return self.scene.model


@pytest.mark.parametrize("size", WIDTHS.values(), ids=WIDTHS.keys())
def test_a_scene_is_replayed_with_all_its_geoms(
    browser: "playwright.Browser", tmp_path: Path, size: tuple[int, int]
) -> None:
    store = Scened(tmp_path)
    file = write_page(tmp_path, store, summarise(store.steps(), store.episodes()))
    page = browser.new_page(viewport={"width": size[0], "height": size[1]})
    with complaints(page) as said:
        page.goto(file.as_uri())
        replays(page)
    assert said == []
    page.close()


def replays(page: "playwright.Page") -> None:
    """The replay of `Scened`, as it should be."""
    assert page.locator(".status").inner_text() == "step 11 of 11"
    assert "tasks met" in page.locator(".numbers").inner_text()
    red, green, blue = np.moveaxis(shown(page), 2, 0)[:3]
    assert ((red > blue + 30) & (red > green + 10)).sum() > 200, "the post is brown"
    assert ((blue > red + 15) & (blue < 200)).sum() > 1000, "the arm is blue"
    end = shown(page)
    page.locator(".slider").fill("0")
    start = shown(page)
    assert (np.abs(start - end) > 40).sum() > 2000, "it moves"
    page.get_by_label("Laid over it", exact=True).select_option(FAST)
    assert (np.abs(shown(page) - start) > 40).sum() < 100, "the second is hidden where both agree"
    page.get_by_label("Laid over it", exact=True).select_option(SLOW)
    page.locator(".slider").fill("11")
    assert (np.abs(shown(page) - end) > 40).sum() > 2000, "and shows where they do not"
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
