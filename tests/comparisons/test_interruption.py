"""A run that is killed and started again, or whose cluster loses a worker, ends with the rows of an undisturbed one."""

import json
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import polars
import pytest
from polars.testing import assert_frame_equal

from comparisons.store import Store
from prioritized_ik.winding.episode import Episode

BIN = Path(sys.executable).parent
ARGUMENTS = "compare --solvers daqp,daqp-warm --directions up,down --link 15 --steps 6 --no-mink --workers 2".split()
PATIENCE = 240.0  # [s] no test waits longer


def command(out: Path, *more: str) -> list[str]:
    return [str(BIN / "prioritized-ik"), *ARGUMENTS, "--out", str(out), *more]


def figures(out: Path) -> tuple[polars.DataFrame, polars.DataFrame]:
    """All rows that a folder holds, timings and revision aside. Reads every file, so that an unreadable one is an error."""
    store = Store(out)
    steps, episodes = store.steps(), store.episodes()
    for file in episodes["file"].drop_nulls():
        Episode.load(out / file)
    timings = [name for name in steps.columns if name.endswith("_s")]
    return steps.drop(*timings, "revision"), episodes.drop("revision")


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("undisturbed")
    subprocess.run(command(out), check=True, capture_output=True, timeout=PATIENCE)
    return out


def assert_same(out: Path, undisturbed: Path) -> None:
    for found, expected in zip(figures(out), figures(undisturbed), strict=True):
        assert found.height > 0
        assert_frame_equal(found, expected, check_exact=True)


def test_a_run_killed_at_random_moments_ends_with_the_same_rows(
    undisturbed: Path, tmp_path: Path, pytestconfig: pytest.Config
) -> None:
    moments = random.Random(5)
    parts = []
    for _ in range(pytestconfig.getoption("--kills")):
        run = subprocess.Popen(command(tmp_path), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(moments.uniform(0.5, 5.0))
        run.kill()
        run.wait()
        parts.append(len(list(tmp_path.rglob("*.parquet"))))
    assert parts == sorted(parts), "nothing that was done is lost"
    subprocess.run(command(tmp_path), check=True, capture_output=True, timeout=PATIENCE)
    assert_same(tmp_path, undisturbed)
    assert not list(tmp_path.rglob("*.part"))


@contextmanager
def started(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(
        [sys.executable, "-m", "dask", *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def until(happened: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not happened():
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.05)


def test_a_dask_cluster_that_loses_a_worker_gives_the_same_rows(undisturbed: Path, tmp_path: Path) -> None:
    file, out = tmp_path / "scheduler.json", tmp_path / "out"
    where = ("--scheduler-file", str(file))
    worker = ("worker", *where, "--no-nanny", "--nthreads", "1", "--no-dashboard", "--local-directory", str(tmp_path))
    with started("scheduler", *where, "--port", "0", "--no-dashboard", "--host", "127.0.0.1"):
        until(file.exists)
        address = json.loads(file.read_text())["address"]
        with started(*worker) as first, started(*worker):
            run = subprocess.Popen(command(out, "--scheduler", address), stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
            until(lambda: len(list(out.rglob("parts/steps/*.parquet"))) >= 2 or run.poll() is not None)
            first.send_signal(signal.SIGKILL)
            output, _ = run.communicate(timeout=PATIENCE)
    assert run.returncode == 0, output.decode()
    assert_same(out, undisturbed)
