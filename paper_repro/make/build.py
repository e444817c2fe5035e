"""From artefacts to files: jobs first, then every table and figure, then the report. Whole files or none."""

from pathlib import Path

from paper_repro.make.artefact import Artefact, Scale
from paper_repro.make.catalogue import by_chapter
from paper_repro.make.figure import KINDS, write_figure
from paper_repro.make.jobs import Progress, Results, run
from paper_repro.make.report import write_report
from paper_repro.make.table import Table
from prioritized_ik.files import advising, write_whole

ANSWERS = "answers"  # folder of what jobs gave


def build(artefacts: list[Artefact], out: Path, scale: Scale, workers: int, progress: Progress) -> list[Path]:
    """Do the jobs of `artefacts` and write each into `out`, then the report of all that is there; return the files.

    `tables/<name>.csv`, `.tex` and `.md`; `figures/<name>.svg`, `.pdf`, `.png` and `.md`, which is its caption. Artefacts
    that hold measured times go to `timed/`.

    Raises:
        InputError: `out` is not writable.
    """
    with advising("write into", out, advice="choose a folder that is writable"):
        results = run((job for artefact in artefacts for job in artefact.jobs(scale)), out / ANSWERS, workers, progress)
        written = [path for artefact in artefacts for path in write(artefact, out, scale, results)]
        return [*written, *write_report(by_chapter(), out, scale)]


def write(artefact: Artefact, out: Path, scale: Scale, results: Results) -> list[Path]:
    """Write one artefact of the answers to its jobs, and return its files."""
    made = artefact.build(scale, results)
    text = artefact.file(out, "md")
    text.parent.mkdir(parents=True, exist_ok=True)
    command = f"prioritized-ik paper --only {artefact.name}{' --quick' if scale.quick else ''}"
    head = f"### {artefact.title}\n\n{artefact.caption}\n\n"
    foot = f"\nMade by `{command}`.\n\n{scale.stamp}\n"
    if isinstance(made, Table):
        forms = {"csv": made.csv(), "tex": f"% {command}\n{made.latex()}", "md": head + made.markdown() + foot}
        for kind, content in forms.items():
            _write_text(artefact.file(out, kind), content)
        return [artefact.file(out, kind) for kind in forms]
    pictures = [write_figure(made, artefact.file(out, kind)) for kind in KINDS]
    links = " · ".join(f"[{kind.upper()}]({artefact.name}.{kind})" for kind in KINDS)
    _write_text(text, f"{head}![{artefact.title}]({artefact.name}.svg)\n\n{links}\n{foot}")
    return [*pictures, text]


def _write_text(path: Path, text: str) -> None:
    write_whole(path, lambda file: file.write(text.encode("utf-8")))
