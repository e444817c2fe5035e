"""Long arms wind around thin objects: more than a turn, without folding up, and every step certified."""

from functools import cache

import numpy as np
import pytest
from click.testing import CliRunner

from prioritized_ik.cli import main
from prioritized_ik.models import Arm
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.methods import ActiveSet, Place
from prioritized_ik.solvers.step import JointStep
from prioritized_ik.solvers.tree.step import PATH
from prioritized_ik.winding.cameras import FIELD, cameras, shown_part
from prioritized_ik.winding.episode import Episode, Outcome, wind
from prioritized_ik.winding.metrics import measure
from prioritized_ik.winding.settings import WindingSettings, in_proportion

LENGTH = 1.02  # [m] of every arm, as of the paper's
CERTIFIED = {"SOLVED", "CLOSED_FORM"}


def settings(links: int) -> WindingSettings:
    length = LENGTH / links
    return WindingSettings(
        arm=Arm(links=links, link_length=length, radius=0.005),
        link=round(links * 6 / 17),
        size=(0.03, 0.5),
        tilt=0.2,
        weights="trailing",
        options=SolveOptions(rank_tolerance=0.0),
        **in_proportion(length),
    )


class Noting(ActiveSet):
    """The kernel; it notes which form makes its steps."""

    def __init__(self) -> None:
        super().__init__()
        self.paths: list[str] = []

    def step(self, problem: IKProblem, options: SolveOptions | None = None, place: Place | None = None) -> JointStep:
        step = super().step(problem, options, place)
        self.paths.append(step.path)
        return step


@cache
def wound_and_how(links: int) -> tuple[Episode, list[str]]:
    method = Noting()
    return wind(settings(links), method), method.paths


def wound(links: int) -> Episode:
    return wound_and_how(links)[0]


@pytest.mark.parametrize("links", [34, 68, 136])
def test_arms_that_trail_wind_almost_three_turns_around_a_thin_object(links):
    episode = wound(links)
    told = measure(episode)
    assert episode.outcome is Outcome.WOUND
    assert told.turns > 2.7
    assert 0.95 <= told.turns_ratio <= 1.05
    assert told.penetration < episode.settings.contact_distance
    assert told.bend < 0.9  # [rad]; an arm that folds up beside the object bends by more
    assert told.drift < 1e-3
    assert set(episode.status) <= CERTIFIED


@pytest.mark.parametrize("links", [68, 136])
def test_every_step_of_a_long_winding_goes_along_links_whatever_rows_hold(links):
    episode, paths = wound_and_how(links)
    assert len(paths) == episode.steps
    assert set(paths) == {PATH}
    assert "SOLVED" in episode.status  # rows hold some


def test_long_windings_are_recorded_without_any_matrix():
    episode = wound(68)
    assert episode.is_on_tree
    assert episode.jacobian.size == episode.row_matrix.size == 0


def test_speed_and_touch_of_the_papers_links_are_the_defaults():
    assert WindingSettings(**in_proportion(Arm.link_length)) == WindingSettings()


@pytest.mark.parametrize("links", [34, 68])
def test_the_command_winds_long_arms_to_the_same_end(links):
    scene = ["--weights", "trailing", "--length", str(LENGTH), "--diameter", "0.06", "--radius", "0.005", "--tilt", "0.2"]
    link = str(round(links * 6 / 17))
    done = CliRunner().invoke(main, ["wind", *scene, "--links", str(links), "--link", link, "--rank-tolerance", "0"])
    assert done.exit_code == 0, done.output
    assert f"turns        {measure(wound(links)).turns:.3f}" in done.output


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["--length", "-1"], "length is -1.0; expected a finite number above 0"),
        (["--radius", "0"], "radius is 0.0"),
        (["--speed", "0"], "speed is 0.0"),
        (["--scene", "robot.xml", "--radius", "0.1"], "--radius is of the paper's arm"),
        (["--scene", "robot.xml", "--length", "1"], "--length is of the paper's arm"),
    ],
)
def test_lengths_radii_and_speeds_that_make_no_sense_are_refused(given, message):
    done = CliRunner().invoke(main, ["wind", *given])
    assert done.exit_code == 2
    assert message in done.output


def test_every_camera_sees_the_arm_from_its_step_on_and_the_film_only_comes_nearer():
    episode = wound(34)
    steps = list(range(0, episode.steps + 1, 25))
    seen = cameras(episode, steps, 4.0 / 3.0)
    slope = np.tan(np.radians(FIELD / 2.0))
    for step, camera in zip(steps, seen, strict=True):
        azimuth, elevation = np.radians([camera.azimuth, camera.elevation])
        sight = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
        right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
        up = np.cross(right, sight)
        eye = camera.lookat - camera.distance * sight
        for later in steps[steps.index(step) :]:
            from_eye = episode.positions[later] - eye
            depth = from_eye @ sight
            assert (depth > 0.0).all()
            assert (np.abs(from_eye @ up) < depth * slope).all()
            assert (np.abs(from_eye @ right) < depth * slope * 4.0 / 3.0).all()
    assert (np.diff([camera.distance for camera in seen]) <= 1e-9).all()


def test_what_is_shown_of_the_object_is_part_of_it_and_holds_all_that_is_wound():
    episode = wound(34)
    whole, part = episode.settings.wound_object(), shown_part(episode)
    offset = abs(float((part.position - whole.position) @ whole.axis))
    assert offset + part.size[1] <= whole.size[1] + 1e-12
    np.testing.assert_allclose(np.cross(part.position - whole.position, whole.axis), 0.0, atol=1e-12)
    heights = np.abs((episode.positions[-1][11:] - part.position) @ whole.axis)
    assert heights.max() < part.size[1]
