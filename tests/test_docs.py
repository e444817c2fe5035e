"""The documentation: built without a warning, whole without the network, and readable on a screen and on a phone."""

import re
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlparse

import playwright.sync_api as playwright
import pytest
from repository import ROOT

import prioritized_ik

WIDTHS = {"desktop": (1280, 900), "phone": (390, 844)}


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The documentation, built; a warning is an error."""
    place = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html", str(ROOT / "docs"), str(place)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return place


class Asked(HTMLParser):
    """What a browser asks for when it opens a page, and where its links lead."""

    def __init__(self) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.links: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = dict(attrs)
        if tag in ("img", "script", "source", "video", "iframe") and named.get("src"):
            self.fetched.append(str(named["src"]))
        if tag == "link" and named.get("href"):
            self.fetched.append(str(named["href"]))
        if tag == "a" and named.get("href"):
            self.links.append(str(named["href"]))


def read(page: Path) -> Asked:
    asked = Asked()
    asked.feed(page.read_text(encoding="utf-8"))
    return asked


def test_no_page_asks_for_anything_that_is_not_beside_it(site: Path) -> None:
    for page in site.rglob("*.html"):
        for address in read(page).fetched:
            parts = urlparse(address)
            assert not parts.netloc, f"{address} in {page.name}"
            assert (page.parent / unquote(parts.path)).exists(), f"{address} in {page.name}"
    for sheet in site.rglob("*.css"):
        assert not re.search(r"url\(['\"]?(?:https?:)?//", sheet.read_text(encoding="utf-8")), sheet.name


def test_every_link_inside_the_site_leads_to_a_page_of_it(site: Path) -> None:
    for page in site.rglob("*.html"):
        for address in read(page).links:
            parts = urlparse(address)
            if not parts.scheme and parts.path:
                assert (page.parent / unquote(parts.path)).exists(), f"{address} in {page.name}"


def test_every_public_name_is_in_the_api(site: Path) -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in (site / "api").glob("*.html"))
    names = [name for name in prioritized_ik.__all__ if not name.startswith("_")]
    assert [name for name in names if f'id="prioritized_ik.{name}"' not in text] == []


def test_equations_are_written_out(site: Path) -> None:
    text = (site / "concepts.html").read_text(encoding="utf-8")
    assert text.count("<math") >= 5
    assert "$" not in re.sub(r"<pre>.*?</pre>", "", text.partition("<article")[2], flags=re.DOTALL)


@pytest.fixture
def page(browser: "playwright.Browser") -> Iterator["playwright.Page"]:
    """A page that must not complain, whatever a test opens in it."""
    context = browser.new_context()
    page = context.new_page()
    said: list[str] = []
    page.on("console", lambda message: said.append(f"{message.type}: {message.text}"))
    page.on("pageerror", lambda error: said.append(str(error)))
    yield page
    assert said == []
    context.close()


def test_every_page_fits_the_screen_and_shows_its_pictures(site: Path, page: "playwright.Page") -> None:
    for file in sorted(site.rglob("*.html")):
        page.goto(file.as_uri())
        for device, (width, height) in WIDTHS.items():
            page.set_viewport_size({"width": width, "height": height})
            assert page.evaluate("window.innerWidth") == width
            assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth"), (file.name, device)
        broken = "[...document.images].filter((image) => image.complete && !image.naturalWidth).map((image) => image.src)"
        assert page.evaluate(broken) == [], file.name


@pytest.mark.parametrize(("width", "height"), WIDTHS.values(), ids=WIDTHS.keys())
def test_the_search_finds_a_page_without_a_server(site: Path, page: "playwright.Page", width: int, height: int) -> None:
    page.set_viewport_size({"width": width, "height": height})
    page.goto(f"{(site / 'search.html').as_uri()}?q=certificate")
    found = page.locator("#search-results li a", has_text="Concepts").first
    found.wait_for()
    assert "concepts.html" in str(found.get_attribute("href"))
