"""Work is done once, kept whole, and counts only for the code that did it."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from paper_repro.make import jobs
from paper_repro.make.jobs import Job, library_digest, run


def note(folder: str, name: str, value: float = 1.0) -> dict[str, object]:
    """Leave a mark of every call, and answer."""
    with (Path(folder) / f"{name}.calls").open("a") as file:
        file.write("x")
    return {"name": name, "value": value / 3.0, "rows": (1, 2)}


def fail(folder: str) -> None:
    raise ArithmeticError(f"no answer for {Path(folder).name}")


def slow(folder: str, name: str) -> str:
    time.sleep(0.3)
    note(folder, name)
    return name


def calls(folder: Path, name: str) -> int:
    path = folder / f"{name}.calls"
    return len(path.read_text()) if path.exists() else 0


def silent(what: str, done: int, total: int) -> None:
    assert 0 <= done <= total


def noted(folder: Path, *names: str) -> list[Job]:
    return [Job(note, {"folder": str(folder), "name": name}) for name in names]


def test_every_job_is_done_once_even_if_asked_for_twice_and_in_two_runs(tmp_path):
    wanted = noted(tmp_path, "a", "b", "a")
    first = run(wanted, tmp_path / "answers", 2, silent)
    second = run(wanted, tmp_path / "answers", 1, silent)
    assert (calls(tmp_path, "a"), calls(tmp_path, "b")) == (1, 1)
    assert first[wanted[0]] == second[wanted[2]] == {"name": "a", "value": 1.0 / 3.0, "rows": [1, 2]}


def test_an_answer_is_the_same_whether_it_comes_from_the_call_or_from_its_file(tmp_path):
    """Lists for tuples: what is built of an answer must not depend on whether it was just computed."""
    (job,) = noted(tmp_path, "a")
    fresh, kept = (run([job], tmp_path / "answers", 1, silent)[job] for _ in range(2))
    assert json.dumps(fresh) == json.dumps(kept)
    assert fresh["rows"] == [1, 2]


def test_what_was_done_before_a_job_failed_is_kept(tmp_path):
    good = noted(tmp_path, "a")
    with pytest.raises(ArithmeticError, match="no answer for"):
        run([*good, Job(fail, {"folder": str(tmp_path)}, alone=True)], tmp_path / "answers", 1, silent)
    run(good, tmp_path / "answers", 1, silent)
    assert calls(tmp_path, "a") == 1


def test_answers_of_other_code_are_thrown_away(tmp_path, monkeypatch):
    (job,) = noted(tmp_path, "a")
    run([job], tmp_path / "answers", 1, silent)
    assert [path.name for path in (tmp_path / "answers").iterdir()] == [library_digest()]
    (tmp_path / "answers" / "notes of my own").mkdir()
    monkeypatch.setattr(jobs, "library_digest", lambda: "0123456789abcdef")
    run([job], tmp_path / "answers", 1, silent)
    assert calls(tmp_path, "a") == 2
    assert sorted(path.name for path in (tmp_path / "answers").iterdir()) == ["0123456789abcdef", "notes of my own"]


def test_a_damaged_answer_is_computed_anew(tmp_path):
    (job,) = noted(tmp_path, "a")
    run([job], tmp_path / "answers", 1, silent)
    (path,) = (tmp_path / "answers").rglob("*.json")
    path.write_text(path.read_text()[:-5])
    assert run([job], tmp_path / "answers", 1, silent)[job]["name"] == "a"
    assert calls(tmp_path, "a") == 2


def test_the_key_follows_the_arguments_and_the_modules_that_the_function_reaches(monkeypatch):
    from paper_repro.measure.windings import measured_job, settings

    up, down = (measured_job(settings(direction=direction)) for direction in ("up", "down"))
    assert up.key == measured_job(settings(direction="up")).key
    assert up.key != down.key
    assert "paper_repro.make.jobs" in jobs._reached("paper_repro.measure.windings")
    assert "comparisons.judging" in jobs._reached("paper_repro.measure.replays")
    before, source = up.key, jobs._source
    jobs._module_digest.cache_clear()
    monkeypatch.setattr(jobs, "_source", lambda name: source(name) + b"# changed" * (name == "paper_repro.make.jobs"))
    assert up.key != before
    jobs._module_digest.cache_clear()


def test_the_digest_of_the_library_follows_its_code_and_versions(monkeypatch):
    before = library_digest()
    monkeypatch.setattr(jobs.importlib.metadata, "version", lambda name: "0")
    assert library_digest() == before  # it is asked for often
    assert library_digest.__wrapped__() != before


def test_jobs_that_measure_time_run_after_all_others(tmp_path):
    order = []
    alone = Job(note, {"folder": str(tmp_path), "name": "timed"}, alone=True)
    wanted = [alone, *[Job(slow, {"folder": str(tmp_path), "name": name}) for name in "ab"]]
    run(wanted, tmp_path / "answers", 2, lambda what, done, total: order.append(what))
    assert order[-1] == "note"
    assert sorted(order[:-1]) == ["found what is done", "slow", "slow"]


SCRIPT = """
import sys
from pathlib import Path
sys.path.insert(0, {tests!r})
from test_jobs import slow
from paper_repro.make.jobs import Job, run
if __name__ == "__main__":
    folder = Path({folder!r})
    jobs = [Job(slow, {{"folder": str(folder), "name": f"n{{i}}"}}) for i in range(12)]
    run(jobs, folder / "answers", 2, lambda *_: None)
"""


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_a_killed_run_goes_on_where_it_was(tmp_path, how):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(tests=str(Path(__file__).parent), folder=str(tmp_path)))
    command = [sys.executable, str(script)]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 60.0
    while len(list(tmp_path.rglob("answers/*/*.json"))) < 3:
        assert time.monotonic() < deadline
        time.sleep(0.02)
    process.send_signal(how)
    assert process.wait(timeout=60) != 0
    kept = {path.name for path in tmp_path.rglob("answers/*/*.json")}
    assert 3 <= len(kept) < 12
    for path in tmp_path.rglob("answers/*/*.json"):
        json.loads(path.read_text())
    done_before = {
        name: calls(tmp_path, name) for name in (json.loads((next(tmp_path.rglob(k))).read_text())["answer"] for k in kept)
    }
    subprocess.run(command, check=True, env={**os.environ}, timeout=120)
    assert len(list(tmp_path.rglob("answers/*/*.json"))) == 12
    assert {name: calls(tmp_path, name) for name in done_before} == done_before
