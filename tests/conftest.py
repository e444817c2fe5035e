import gc
import os
import shutil
import subprocess
from collections.abc import Iterator
from typing import TYPE_CHECKING

import paths
import pytest
import slow
from arms import Bench

from prioritized_ik import rendering
from prioritized_ik.errors import InputError
from prioritized_ik.models import Arm
from prioritized_ik.solvers import registry

if TYPE_CHECKING:
    import playwright.sync_api

CAMPAIGN = 200  # problems that a campaign solves unless told: a few seconds
KILLS = 2  # times that a comparison is killed unless told: a few seconds each


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--campaign", type=int, default=CAMPAIGN, metavar="N", help="problems a campaign solves")
    parser.addoption("--kills", type=int, default=KILLS, metavar="N", help="times that a comparison is killed")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Look for garbage only after the collection of tests, whose objects stay: a fourth of its time."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the slow tests, and put the longest modules first."""
    for item in items:
        module, name = _module(item), item.name.partition("[")[0].removeprefix("test_")
        if module in slow.MODULES or name in slow.TESTS.get(module, ()):
            item.add_marker(pytest.mark.slow)
    places = {module: place for place, module in enumerate(slow.LONGEST)}
    items.sort(key=lambda item: places.get(_module(item), len(places)))


def _module(item: pytest.Item) -> str:
    return item.path.stem.removeprefix("test_")


def _not_run(reporter: pytest.TerminalReporter) -> dict[str, int]:
    """Why tests were skipped, and how many for each reason."""
    reasons: dict[str, int] = {}
    for report in reporter.stats.get("skipped", []):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        reasons[reason] = reasons.get(reason, 0) + 1
    return reasons


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """List what was not run, last of all."""
    reasons = _not_run(terminalreporter)
    if reasons:
        terminalreporter.section("not run")
    for reason, count in reasons.items():
        terminalreporter.line(f"{count} tests: {reason.removeprefix('Skipped: ')}")


@pytest.hookimpl(tryfirst=True)
def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Fail where something was not run in CI, whose machine must have all there is to have."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if os.environ.get("CI") == "true" and exitstatus == 0 and reporter is not None and _not_run(reporter):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


@pytest.fixture(scope="session")
def renders() -> None:
    """Skip a test that needs pictures where MuJoCo cannot render."""
    try:
        rendering.use_working_backend()
    except InputError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def browser() -> Iterator["playwright.sync_api.Browser"]:
    """A headless Chromium; tests that need it are skipped where there is none."""
    import playwright.sync_api
    from playwright._impl._driver import compute_driver_executable

    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if chromium is None:
        pytest.skip("no Chromium here (Debian: apt-get install chromium)")
    driver, script = compute_driver_executable()
    started = subprocess.run([driver, script, "--version"], capture_output=True, text=True, check=False)
    if started.returncode:
        pytest.skip(f"the driver of Chromium does not start here ({started.stderr.strip()})")
    with playwright.sync_api.sync_playwright() as running:
        # The sandbox of Chromium does not start for root, as in a container; WebGL is drawn without a graphics card, and
        # nothing else by way of one, which would take twice as long.
        options = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu-compositing"]
        browser = running.chromium.launch(executable_path=chromium, args=options)
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def paper_arm() -> Bench:
    """The 17-link arm of Fig. 5."""
    return Bench.of(Arm())


@pytest.fixture
def python_path() -> Iterator[None]:
    """Only the Python form of the solve answers: what is tested is its bits, or its own parts."""
    with paths.only("python"):
        yield


@pytest.fixture
def sabotage(monkeypatch: pytest.MonkeyPatch) -> None:
    """The solvers of `saboteurs` are the ones that were added."""
    import saboteurs

    monkeypatch.setattr(registry, "_added", {})
    saboteurs.register_all()
