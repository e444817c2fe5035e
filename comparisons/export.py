"""The command `export-qpbenchmark`. Heavy imports wait until it runs."""

from pathlib import Path

import click

from prioritized_ik.cli import made_folder
from prioritized_ik.extras import require_extra


@click.command("export-qpbenchmark")
@click.argument("folder", metavar="DIR", type=click.Path(file_okay=False, path_type=Path))
@click.option(
    "--recorded",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="Folder of saved episodes to take the problems from, such as `recorded` of a comparison.  [default: wind anew]",
)
@click.option("--directions", default="up,down,front,back", help="Where the object comes from, if wound anew.")
@click.option("--link", default=6, help="The link that touches the object first, if wound anew.")
@click.option("--tilt", default=0.0, help="Tilt of the object's axis [rad], if wound anew.")
@click.option("--steps", default=25, help="Problems to take of each episode, evenly spaced; each has two stages or more.")
def export_qpbenchmark(folder: Path, recorded: Path | None, directions: str, link: int, tilt: float, steps: int) -> None:
    """Write recorded winding problems into DIR as a test set of qpbenchmark, for authors of QP solvers."""
    require_extra("compare")
    from threadpoolctl import threadpool_limits

    from comparisons.cases import own_files
    from comparisons.qpbenchmark_set import named_stages, write_test_set
    from comparisons.settings import RECORDER
    from prioritized_ik.winding.episode import Episode, wind
    from prioritized_ik.winding.settings import WindingSettings

    made_folder(folder)
    with threadpool_limits(1):  # matrices this small only lose by more
        if recorded is not None:
            episodes = {path.stem: Episode.load(path) for path in own_files(str(recorded))[0]}
        else:
            names = [part.strip() for part in directions.split(",") if part.strip()]
            settings = {name: WindingSettings(direction=name, link=link, tilt=tilt, solver=RECORDER) for name in names}
            episodes = {name: wind(each) for name, each in settings.items()}
        written = write_test_set(folder, named_stages(episodes, steps))
    for module, count in written.items():
        click.echo(f"{count:5d} problems in {folder / module}.py and .parquet")
    first = folder / f"{next(iter(written))}.py"
    click.echo(f"Run: qpbenchmark {first} --results-path results.csv run --author NAME")
