"""Compiled models of long chains are kept between processes, and nothing depends on it."""

import os

import mujoco
import numpy as np
import pytest

from prioritized_ik import model_cache, models
from prioritized_ik.model_cache import VARIABLE, cache_folder, cached_model
from prioritized_ik.models import LONG, Arm
from prioritized_ik.winding.settings import WindingSettings


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(VARIABLE, str(tmp_path / "models"))
    return tmp_path / "models"


class Compiler:
    """Compiles an arm and counts how often."""

    def __init__(self, links: int = 4) -> None:
        self.links, self.calls = links, 0

    def __call__(self) -> mujoco.MjModel:
        self.calls += 1
        return Arm(links=self.links).spec().compile()


def content(model: mujoco.MjModel) -> bytes:
    buffer = np.empty(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()


def test_a_model_is_compiled_once_and_read_to_the_last_bit(folder):
    compiler = Compiler()
    made, read = (cached_model("arm of 4", compiler) for _ in range(2))
    assert compiler.calls == 1
    assert content(read) == content(made)


def test_another_description_or_another_mujoco_is_another_model(folder, monkeypatch):
    compiler = Compiler()
    cached_model("arm of 4", compiler)
    cached_model("arm of 5", compiler)
    monkeypatch.setattr(mujoco, "__version__", "0")
    cached_model("arm of 4", compiler)
    assert compiler.calls == 3


@pytest.mark.parametrize(
    "damage", [lambda whole: whole[:-9], lambda whole: whole[:999] + b"?" + whole[1000:], lambda whole: b""]
)
def test_a_damaged_file_is_compiled_anew_and_replaced(damage, folder):
    compiler = Compiler()
    cached_model("arm of 4", compiler)
    (file,) = folder.iterdir()
    file.write_bytes(damage(file.read_bytes()))
    assert content(cached_model("arm of 4", compiler)) == content(compiler())
    calls = compiler.calls
    cached_model("arm of 4", compiler)
    assert compiler.calls == calls


def test_a_folder_that_cannot_be_made_leaves_a_model_all_the_same(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv(VARIABLE, str(tmp_path / "file" / "models"))
    assert cached_model("arm of 4", Compiler()).nv == Arm(links=4).joint_count


def test_the_files_read_last_are_kept(folder, monkeypatch):
    compiler = Compiler()
    cached_model("first", compiler)
    (first,) = folder.iterdir()
    cached_model("second", compiler)
    (second,) = set(folder.iterdir()) - {first}
    os.utime(first, (1000, 1000))
    os.utime(second, (2000, 2000))
    cached_model("first", compiler)  # which is the newest now
    monkeypatch.setattr(model_cache, "MOST", 2 * first.stat().st_size)
    cached_model("third", compiler)
    assert first.exists()
    assert not second.exists()
    assert len(list(folder.iterdir())) == 2


def test_an_empty_variable_turns_it_off_and_none_is_the_users_own_folder(monkeypatch, tmp_path):
    monkeypatch.setenv(VARIABLE, "")
    assert cache_folder() is None
    assert cached_model("arm of 4", Compiler()).nbody == 5
    monkeypatch.delenv(VARIABLE)
    assert cache_folder().parts[-2:] == ("prioritized-ik", "models")


def test_long_arms_are_kept_and_short_ones_are_not(folder, monkeypatch):
    models._arm_model.cache_clear()
    monkeypatch.setattr(models, "LONG", 5)
    models.arm_model(Arm(links=4))
    assert not folder.exists()
    models.arm_model(Arm(links=5))
    models._arm_model.cache_clear()
    assert len(list(folder.iterdir())) == 1
    assert models.arm_model(Arm(links=5)).nbody == 6
    models._arm_model.cache_clear()
    assert LONG > 17


@pytest.mark.parametrize("posture", ["straight", "arched", "random"])
@pytest.mark.parametrize("link", [1, 6, 16])
def test_the_object_stands_where_the_whole_arm_has_the_link(link, posture):
    settings = WindingSettings(link=link, posture=posture, seed=2)
    model = models.arm_model(settings.arm)
    data = mujoco.MjData(model)
    models.update_kinematics(model, data, settings.initial_posture())
    body = data.body(f"link_{link}")
    along = body.xmat.reshape(3, 3)[:, 0]
    middle = body.xpos + 0.5 * settings.arm.link_length * along
    wound = settings.wound_object()
    facing = middle + (settings.arm.radius + settings.gap) * wound.rotation[:, 0]
    np.testing.assert_allclose(wound.position - settings.size[0] * wound.rotation[:, 0], facing, atol=1e-15)
