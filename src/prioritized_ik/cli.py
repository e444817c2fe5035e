"""`prioritized-ik`: the command line. Commands of other packages join by the entry point `prioritized_ik.commands`.

Nothing heavy is imported before a command runs, so that `--help` answers at once.
"""

from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from prioritized_ik.errors import PrioritizedIkError

if TYPE_CHECKING:
    from prioritized_ik.robot import Robot
    from prioritized_ik.validation import Array
    from prioritized_ik.winding.loop import Outcome
    from prioritized_ik.winding.metrics import WindingMetrics

DISAGREES, BAD_INPUT = 1, 2  # exit codes


class BadInput(click.ClickException):
    """An error of this package, as one message."""

    exit_code = BAD_INPUT


class CommandGroup(click.Group):
    """A group that finds commands of other packages, and turns this package's errors into exit code 2."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of its own commands and of those that joined."""
        return sorted({*super().list_commands(ctx), *entry_points(group="prioritized_ik.commands").names})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return the command called `cmd_name`, loading it if it joined by entry point."""
        own = super().get_command(ctx, cmd_name)
        if own is not None:
            return own
        for entry in entry_points(group="prioritized_ik.commands", name=cmd_name):
            command: click.Command = entry.load()
            return command
        return None

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; an error of this package is one message and exit code 2."""
        try:
            return super().invoke(ctx)
        except PrioritizedIkError as error:
            raise BadInput(str(error)) from error


@click.group(cls=CommandGroup, context_settings={"help_option_names": ["-h", "--help"], "show_default": True})
@click.version_option(package_name="prioritized-ik")
def main() -> None:
    """Prioritized inverse kinematics on MuJoCo: exact, constrained, with whichever QP solver you like.

    Exit codes: 0 done; 1 done, but the arm is not wound (wind), the required tasks are not met (solve) or a solver does not
    agree (compare --strict); 2 bad usage or input.
    """


@main.command()
@click.argument("task_file", metavar="TASKFILE", type=click.Path(path_type=Path))
@click.option("--scene", type=click.Path(path_type=Path), help="Model (.xml, .urdf) in place of TASKFILE's.")
@click.option("--solver", help="A method, or a QP solver for lexicographic:SOLVER.  [default: TASKFILE's, or active-set]")
@click.option(
    "--json", "json_file", type=click.Path(dir_okay=False), help="File for the outcome and all positions, as JSON."
)
@click.option("--save", type=click.Path(dir_okay=False), help="Save problems and steps to this .npz file, to compare on.")
@click.option("--record", type=click.Path(dir_okay=False), help="Picture of the end (.png), or film (.gif, .webp, .mp4).")
@click.option("--view", is_flag=True, help="Show it: in a window where there is a display, else on a page on localhost.")
def solve(
    task_file: Path,
    scene: Path | None,
    solver: str | None,
    json_file: str | None,
    save: str | None,
    record: str | None,
    view: bool,
) -> None:
    """Move a robot as a task file says, and print what was reached and which level gave way.

    Exit codes: 0 the required levels are met at the end; 1 they are not; 2 bad usage or input.
    """
    import json
    from functools import partial

    from rich.console import Console
    from rich.progress import track
    from threadpoolctl import threadpool_limits

    from prioritized_ik.files import advising, write_whole
    from prioritized_ik.reaching import Ending
    from prioritized_ik.scene.task_file import load_scene

    for file in (json_file, save, record):
        if file is not None:
            writable_file(file)
    loaded = load_scene(task_file, scene)
    bar = Console(stderr=True)
    with threadpool_limits(1):  # matrices this small only lose by more
        taken = loaded.steps(solver)
        if record is not None or view:
            from prioritized_ik.viewer.show import shown

            taken = shown(loaded, taken, record=record, view=view, say=partial(click.echo, err=True))
        steps = track(
            taken,
            task_file.name,
            loaded.step_count,
            console=bar,
            transient=True,
            disable=not bar.is_terminal,
        )
        run = loaded.ended(list(steps))
        click.echo(run.told())
    if json_file is not None:
        content = json.dumps(run.to_json(), indent=1, ensure_ascii=False) + "\n"
        with advising("write", json_file):
            write_whole(json_file, lambda file: file.write(content.encode("utf-8")))
    if save is not None:
        run.recording().save(save)
    if run.ending is not Ending.REACHED:
        raise SystemExit(DISAGREES)


@main.command()
@click.option("--scene", type=click.Path(path_type=Path), help="Your own robot and object (.xml, .urdf), see docs.")
@click.option("--object", "wound", default="object", help="Geom of --scene to wind around, or its body; by name or number.")
@click.option("--tip", help="Last body of the chain of --scene that winds.  [default: the model's last]")
@click.option("--keyframe", help="Keyframe of --scene to start from.")
@click.option("--direction", default="up", help="Where the object comes from: up, down, front or back.")
@click.option("--solver", default="active-set", help="A method, or a QP solver for lexicographic:SOLVER; see `solvers`.")
@click.option(
    "--formulation", hidden=True, help="`--solver proxqp --formulation damped` is damped:proxqp; or lifted, slack, dense."
)
@click.option("--weights", default="eq23", help="eq23, eq24, strict: levels, or trailing: the tail of a long arm is free.")
@click.option("--links", default=17, help="Number of links n.")
@click.option("--length", type=float, help="Length of the arm [m]; touch goes with its links'.  [default: 0.06 a link]")
@click.option("--speed", type=float, help="Speed of the driven link's end [m/s].  [default: 2, less for shorter links]")
@click.option("--radius", "link_radius", default=0.01, help="Radius of the links [m].")
@click.option(
    "--kinematics", default="auto", help="Solve joint by joint (tree), by matrices (dense), or what is faster (auto)."
)
@click.option(
    "--rank-tolerance",
    type=float,
    help="Singular values up to this fraction of the largest count as zero; long arms need less.  [default: 1e-4]",
)
@click.option("--link", default=6, help="The link k that touches the object first.")
@click.option("--shape", default="cylinder", help="cylinder, capsule or sphere.")
@click.option("--diameter", default=0.14, help="Diameter of the object [m].")
@click.option("--tilt", default=0.0, help="Tilt of the object's axis [rad]; not zero winds a helix.")
@click.option("--posture", default="straight", help="Initial posture: straight, arched or random.")
@click.option("--seed", default=0, help="Seed of a random posture.")
@click.option("--limits/--no-limits", default=True, help="Keep joint ranges and the step limit.")
@click.option("--contacts/--no-contacts", default=True, help="Keep links out of the object.")
@click.option("--steps", default=1500, help="End after this many steps without equilibrium.")
@click.option("--save", type=click.Path(dir_okay=False), help="Save the episode to this .npz file.")
@click.option("--record", type=click.Path(dir_okay=False), help="Picture of the end (.png), or film (.gif, .webp, .mp4).")
@click.option("--view", is_flag=True, help="Show it: in a window where there is a display, else on a page on localhost.")
def wind(
    scene: Path | None,
    wound: str,
    tip: str | None,
    keyframe: str | None,
    direction: str,
    solver: str,
    formulation: str | None,
    weights: str,
    links: int,
    length: float | None,
    speed: float | None,
    link_radius: float,
    kinematics: str,
    rank_tolerance: float | None,
    link: int,
    shape: str,
    diameter: float,
    tilt: float,
    posture: str,
    seed: int,
    limits: bool,
    contacts: bool,
    steps: int,
    save: str | None,
    record: str | None,
    view: bool,
) -> None:
    """Wind an arm around an object by touch alone, and print how it went: the paper's, or with --scene your own.

    Exit codes: 0 it is wound; 1 it is not; 2 bad usage or input.
    """
    from click.core import ParameterSource
    from threadpoolctl import threadpool_limits

    from prioritized_ik.models import Arm
    from prioritized_ik.solvers.closed_form import RANK_TOLERANCE
    from prioritized_ik.solvers.lexicographic import SolveOptions
    from prioritized_ik.solvers.registry import DENSE, LEXICOGRAPHIC, LIFTED, old_name
    from prioritized_ik.validation import one_of, positive
    from prioritized_ik.winding.episode import wind as run
    from prioritized_ik.winding.metrics import ROUND_SHAPES, measure
    from prioritized_ik.winding.settings import CLOSED_FORM, WindingSettings, in_proportion

    if scene is None:
        _refuse(OF_OWN_ROBOT, "is of --scene, which is missing: give the file of your robot")
    else:
        _refuse(OF_PAPERS_ARM, "is of the paper's arm: leave it out with --scene")
    one_of("shape", shape, ROUND_SHAPES)
    radius = positive("diameter", diameter) / 2.0
    if save is not None:
        writable_file(save)
    if record is not None:
        from prioritized_ik.pictures import kind_of
        from prioritized_ik.rendering import use_working_backend

        kind_of(writable_file(record))
        use_working_backend()
    if view:
        from prioritized_ik.viewer.live import require_screen

        require_screen()
    if formulation is not None:
        unnamed = click.get_current_context().get_parameter_source("solver") is ParameterSource.DEFAULT
        usual = {LEXICOGRAPHIC: solver, DENSE: solver, LIFTED: "piqp"}.get(formulation, "daqp")
        solver = old_name(usual if unnamed else solver, formulation)
    if solver.startswith(f"{LIFTED}:") and kinematics == "auto":
        kinematics = "tree"  # it takes no matrices, however short the arm
    free = solver == CLOSED_FORM  # the closed form knows no limits
    control: dict[str, Any] = ({} if speed is None else {"speed": speed}) | {
        "weights": weights,
        "limits": limits and not free,
        "contacts": contacts and not free,
        "max_steps": steps,
        "solver": solver,
        "options": SolveOptions(
            rank_tolerance=RANK_TOLERANCE if rank_tolerance is None else rank_tolerance, kinematics=kinematics
        ),
    }
    if scene is not None:
        parts = {"tip": _name_or_number(tip), "wound": _name_or_number(wound)}
        _wind_own_robot(scene, keyframe, {**parts, **control}, save, record, view)
        return
    link_length = Arm.link_length if length is None else positive("length", length) / max(links, 1)
    settings = WindingSettings(
        arm=Arm(links=links, link_length=link_length, radius=link_radius),
        shape=shape,
        size=(radius,) if shape == "sphere" else (radius, 0.5),
        direction=direction,
        link=link,
        tilt=tilt,
        posture=posture,
        seed=seed,
        **{**in_proportion(link_length), **control},
    )
    with threadpool_limits(1):  # matrices this small only lose by more
        episode = run(settings)
    _tell_winding(episode.outcome, episode.message, measure(episode))
    if save is not None:
        episode.save(save)
        click.echo(f"saved        {save}")
    if record is not None:
        from prioritized_ik.winding.picture import record as draw

        draw(episode, record)
        click.echo(f"recorded     {record}")
    if view:
        from prioritized_ik.robot import Robot
        from prioritized_ik.winding.picture import model_of

        _view_winding(Robot(model_of(episode.settings)), episode.q)
    _end_winding(episode.outcome)


#: Options of `wind` that go with one kind of robot alone.
OF_PAPERS_ARM = ("direction", "links", "length", "link_radius", "link", "shape", "diameter", "tilt", "posture", "seed")
OF_OWN_ROBOT = ("wound", "tip", "keyframe")
FRAMES = 60  # of a film of one's own robot


def _refuse(names: tuple[str, ...], why: str) -> None:
    from click.core import ParameterSource

    from prioritized_ik.errors import InputError

    context = click.get_current_context()
    given = [name for name in names if context.get_parameter_source(name) is not ParameterSource.DEFAULT]
    if given:
        option = {"wound": "object", "link_radius": "radius"}.get(given[0], given[0])
        raise InputError(f"--{option} {why}.")


def _name_or_number(part: str | None) -> str | int | None:
    """Return a number for what is one: many parts of real models have no name."""
    return int(part) if part is not None and part.isdigit() else part


def _wind_own_robot(
    scene: Path, keyframe: str | None, control: dict[str, Any], save: str | None, record: str | None, view: bool
) -> None:
    from threadpoolctl import threadpool_limits

    from prioritized_ik.robot import Robot
    from prioritized_ik.winding.own_robot import RobotWinding, measure_robot, wind_robot

    robot = Robot(scene)
    if keyframe is not None:
        robot.update(robot.keyframe(keyframe))
    with threadpool_limits(1):  # matrices this small only lose by more
        wound = wind_robot(RobotWinding(model=robot.model, q=robot.q, **control))
    _tell_winding(wound.outcome, wound.message, measure_robot(wound))
    if save is not None:
        wound.recording().save(save)
        click.echo(f"saved        {save}")
    if record is not None:
        from prioritized_ik.viewer.film import Film

        with Film(record, robot) as film:
            for number in range(0, len(wound.q) + FRAMES, max(1, len(wound.q) // FRAMES)):
                robot.update(wound.q[min(number, len(wound.q) - 1)])
                film.add()
        click.echo(f"recorded     {record}")
    if view:
        _view_winding(robot, wound.q)
    _end_winding(wound.outcome)


def _view_winding(robot: "Robot", positions: "Array") -> None:
    from functools import partial

    from prioritized_ik.viewer.show import replayed

    replayed(robot, positions, say=partial(click.echo, err=True))


def _tell_winding(outcome: "Outcome", message: str, metrics: "WindingMetrics") -> None:
    click.echo(f"outcome      {outcome.value}")
    if message:
        click.echo(f"             {message}")
    click.echo(f"steps        {metrics.steps}")
    of_ideal = "" if metrics.turns_ratio is None else f" ({metrics.turns_ratio:.3f} of the ideal)"
    click.echo(f"turns        {metrics.turns:.3f}{of_ideal}")
    click.echo(f"penetration  {metrics.penetration * 1e3:.2f} mm")
    click.echo(f"bend         {metrics.bend:.3f} rad")
    click.echo(f"drift        {metrics.drift * 1e3:.2f} mm")


def _end_winding(outcome: "Outcome") -> None:
    from prioritized_ik.winding.loop import Outcome

    if outcome is not Outcome.WOUND:
        raise SystemExit(DISAGREES)


def writable_file(path: str) -> str:
    """Return `path` if a file can be written there.

    Raises:
        PrioritizedIkError: it has no name, is a folder, or its folder is not writable.
    """
    from prioritized_ik.errors import InputError

    if not Path(path).name or Path(path).is_dir():
        raise InputError(f"cannot write to {path!r}; expected the name of a file.")
    writable_folder(Path(path).parent)
    return path


def made_folder(folder: Path) -> Path:
    """Return `folder`, made if it was not there.

    Raises:
        PrioritizedIkError: it cannot be made, or files cannot be written into it.
    """
    from prioritized_ik.files import advising

    with advising("write into", folder):
        folder.mkdir(parents=True, exist_ok=True)
    return writable_folder(folder)


def writable_folder(folder: Path) -> Path:
    """Return `folder` if files can be written into it.

    Raises:
        PrioritizedIkError: it is not a folder, or not writable.
    """
    import os

    from prioritized_ik.errors import InputError

    if not folder.is_dir() or not os.access(folder, os.W_OK):
        raise InputError(f"cannot write into {str(folder)!r}; expected a folder that exists and is writable.")
    return folder
