import json
import math

import pytest

from prioritized_ik.errors import InputError
from prioritized_ik.models import Arm
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.winding.settings import CLOSED_FORM, WindingSettings

OTHERS = WindingSettings(
    arm=Arm(links=9, joint_range=0.8, hinge_order="xyz"),
    shape="sphere",
    size=(0.1,),
    direction="back",
    link=3,
    tilt=-0.2,
    posture="random",
    seed=7,
    weights="eq24",
    solver="proxqp",
    options=SolveOptions(closed_form_first=False, accuracy=1e-7),
)


@pytest.mark.parametrize(
    "settings", [WindingSettings(), OTHERS, WindingSettings(weights="strict")], ids=["default", "others", "strict"]
)
def test_settings_survive_json(settings):
    assert WindingSettings.from_json(settings.to_json()) == settings


def test_settings_that_differ_are_not_equal_after_json():
    assert WindingSettings.from_json(OTHERS.to_json()) != WindingSettings()


@pytest.mark.parametrize("text", ["", "{", "null", "[]", "{}", '{"arm": 3}'])
def test_a_text_that_holds_no_settings_is_refused(text):
    with pytest.raises(InputError):
        WindingSettings.from_json(text)


def test_a_setting_that_is_unknown_is_refused():
    content = json.loads(WindingSettings().to_json()) | {"colour": "red"}
    with pytest.raises(InputError, match="colour"):
        WindingSettings.from_json(json.dumps(content))


def test_a_value_out_of_range_in_json_is_refused():
    content = json.loads(WindingSettings().to_json()) | {"link": 99}
    with pytest.raises(InputError, match="link is 99; expected 1 to 16"):
        WindingSettings.from_json(json.dumps(content))


BAD = {
    "direction": ({"direction": "left"}, "unknown direction 'left'; choose one of: up, down, front, back"),
    "posture": ({"posture": "curled"}, "unknown posture 'curled'"),
    "weights": ({"weights": "eq25"}, "unknown weights 'eq25'; choose one of: eq23, eq24, strict"),
    "shape": ({"shape": "torus"}, "unknown shape 'torus'"),
    "size": ({"size": (0.07,)}, "size of a cylinder"),
    "link 0": ({"link": 0}, "link is 0"),
    "link 18": ({"link": 18}, "link is 18; expected 1 to 16"),
    "tilt": ({"tilt": 1.3}, r"tilt is 1\.3"),
    "tilt nan": ({"tilt": math.nan}, "tilt is nan"),
    "speed": ({"speed": 0.0}, r"speed is 0\.0"),
    "speed nan": ({"speed": math.nan}, "speed is nan"),
    "dt": ({"dt": -1e-3}, r"dt is -0\.001"),
    "dt inf": ({"dt": math.inf}, "dt is inf"),
    "gap": ({"gap": -1e-3}, r"gap is -0\.001"),
    "dead band": ({"dead_band": -0.1}, r"dead_band is -0\.1"),
    "max step": ({"max_step": 0.0}, r"max_step is 0\.0"),
    "gain 0": ({"contact_gain": 0.0}, r"contact_gain is 0\.0"),
    "gain 2": ({"contact_gain": 2.0}, r"contact_gain is 2\.0"),
    "min distance negative": ({"min_distance": -1e-3}, r"min_distance is -0\.001"),
    "min distance not below contact": ({"min_distance": 2e-3}, r"min_distance 0\.002 is not below contact_distance 0\.002"),
    "release below contact": ({"release_distance": 1e-3}, r"release_distance 0\.001 is below contact_distance 0\.002"),
    "max steps": ({"max_steps": 0}, "max_steps is 0"),
    "closed form with limits": ({"solver": CLOSED_FORM, "contacts": False}, "the closed form knows no limits or contacts"),
    "closed form with contacts": ({"solver": CLOSED_FORM, "limits": False}, "the closed form knows no limits or contacts"),
}


@pytest.mark.parametrize(("changes", "message"), BAD.values(), ids=BAD.keys())
def test_a_bad_value_is_refused_by_name(changes, message):
    with pytest.raises(InputError, match=message):
        WindingSettings(**changes)


def test_links_may_stop_anywhere_if_contacts_are_off():
    assert WindingSettings(contacts=False, min_distance=5e-3).min_distance == 5e-3


OPTIONS = {
    "damping": ({"damping": -1.0}, r"damping is -1\.0"),
    "rank tolerance negative": ({"rank_tolerance": -1e-4}, r"rank_tolerance is -0\.0001"),
    "rank tolerance 1": ({"rank_tolerance": 1.0}, r"rank_tolerance is 1\.0"),
}


@pytest.mark.parametrize(("changes", "message"), OPTIONS.values(), ids=OPTIONS.keys())
def test_a_bad_solve_option_is_refused_by_name(changes, message):
    with pytest.raises(InputError, match=message):
        SolveOptions(**changes)
