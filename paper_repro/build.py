"""From artefacts to files: jobs first, then every table and figure, then the report. Whole files or none."""

from pathlib import Path

from paper_repro.artefact import Artefact, Scale
from paper_repro.catalogue import by_chapter
from paper_repro.figure import KINDS, write_figure
from paper_repro.jobs import Progress, Results, run
from paper_repro.table import Table
from prioritized_ik.errors import InputError
from prioritized_ik.files import write_whole

ANSWERS = "answers"  # folder of what jobs gave
TIMED = "timed"  # folder of what no two runs share


def build(artefacts: list[Artefact], out: Path, scale: Scale, workers: int, progress: Progress) -> list[Path]:
    """Do the jobs of `artefacts` and write each into `out`, then the report of all that is there; return the files.

    `tables/<name>.csv`, `.tex` and `.md`; `figures/<name>.svg`, `.pdf`, `.png` and `.md`, which is its caption. Artefacts
    that hold measured times go to `timed/`.

    Raises:
        InputError: `out` is not writable.
    """
    results = run((job for artefact in artefacts for job in artefact.jobs(scale)), out / ANSWERS, workers, progress)
    try:
        written = [path for artefact in artefacts for path in write(artefact, out, scale, results)]
        from paper_repro.report import write_report

        return [*written, *write_report(by_chapter(), out)]
    except OSError as error:
        raise InputError(f"cannot write into {str(out)!r} ({error}); choose a folder that is writable.") from error


def write(artefact: Artefact, out: Path, scale: Scale, results: Results) -> list[Path]:
    """Write one artefact of the answers to its jobs, and return its files."""
    made = artefact.build(scale, results)
    folder = folder_of(artefact, out)
    folder.mkdir(parents=True, exist_ok=True)
    stem = folder / artefact.name
    command = f"prioritized-ik paper --only {artefact.name}{' --quick' if scale.quick else ''}"
    head = f"### {artefact.title}\n\n{artefact.caption}\n\n"
    foot = f"\nMade by `{command}`.\n"
    if isinstance(made, Table):
        texts = {".csv": made.csv(), ".tex": f"% {command}\n{made.latex()}", ".md": head + made.markdown() + foot}
        files = [stem.with_name(artefact.name + ending) for ending in texts]
        for path, text in zip(files, texts.values(), strict=True):
            _write_text(path, text)
        return files
    pictures = write_figure(made, stem)
    links = " · ".join(f"[{kind.upper()}]({artefact.name}.{kind})" for kind in KINDS)
    _write_text(stem.with_name(f"{artefact.name}.md"), f"{head}![{artefact.title}]({artefact.name}.svg)\n\n{links}\n{foot}")
    return [*pictures, stem.with_name(f"{artefact.name}.md")]


def folder_of(artefact: Artefact, out: Path) -> Path:
    """Return where an artefact's files go."""
    kind = artefact.name.partition("-")[0]
    return out / (TIMED if artefact.timed else "figures" if kind == "figure" else "tables")


def _write_text(path: Path, text: str) -> None:
    write_whole(path, lambda file: file.write(text.encode("utf-8")))
