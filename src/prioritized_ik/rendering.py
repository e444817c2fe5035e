"""Off-screen rendering by whatever works here: EGL, OSMesa or a window.

MuJoCo takes its OpenGL from the environment variable MUJOCO_GL when it is imported, a window unless told, and where that
does not work it can abort in native code. So each way is tried in a process of its own first, and only one that has drawn
a picture there is used here.
"""

import functools
import importlib
import os
import subprocess
import sys

from prioritized_ik.errors import InputError

BACKENDS = ("egl", "osmesa", "glfw")  # in the order in which they are tried
PROBING = 60.0  # [s] a software renderer on a busy machine takes a few
HELP = "install one (Debian: apt-get install libegl1 libgl1-mesa-dri), or set MUJOCO_GL to one that works"

#: Draws a white sphere that fills the picture: all black is no picture.
PROBE = """
import mujoco
model = mujoco.MjModel.from_xml_string(
    '<mujoco><visual><headlight ambient="1 1 1"/></visual><worldbody><geom size="1"/></worldbody></mujoco>'
)
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 16, 16) as renderer:
    renderer.update_scene(data)
    if not renderer.render().any():
        raise RuntimeError("the picture is black")
"""


def use_working_backend() -> str:
    """Let `mujoco.Renderer` use a backend that renders here, and return its name: what MUJOCO_GL names, if it is set.

    Raises:
        InputError: none renders; the message says why, one backend after the other.
    """
    name, failures = _found(os.environ.get("MUJOCO_GL", "").strip().lower())
    if name is None:
        raise InputError(f"cannot render here ({'; '.join(failures)}); {HELP}.")
    _use(name)
    return name


@functools.cache
def works(name: str) -> bool:
    """Whether backend `name`, one of `BACKENDS`, draws here."""
    return _probe(name) is None


@functools.cache
def _found(wanted: str) -> tuple[str | None, tuple[str, ...]]:
    """Return the first backend that draws, or None and why each does not; only `wanted` is tried if it is not empty."""
    failures = []
    for name in (wanted,) if wanted else BACKENDS:
        failure = _probe(name)
        if failure is None:
            return name, ()
        failures.append(f"{name}: {failure}")
    return None, tuple(failures)


def _probe(name: str) -> str | None:
    """Return why a process of its own cannot draw with backend `name`, or None if it can."""
    environment = {key: value for key, value in os.environ.items() if key != "PYOPENGL_PLATFORM"}
    environment["MUJOCO_GL"] = name
    try:
        done = subprocess.run(
            [sys.executable, "-c", PROBE],
            env=environment,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=PROBING,
        )
    except subprocess.TimeoutExpired:
        return f"no picture within {PROBING:g} s"
    if done.returncode == 0:
        return None
    if done.returncode < 0:
        return f"ended by signal {-done.returncode}"
    return (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]


def _use(name: str) -> None:
    """Hand MuJoCo, which chose when it was imported, the OpenGL context of backend `name`."""
    if name not in BACKENDS:  # another platform's own, named by MUJOCO_GL: what MuJoCo chose already
        return
    if name != "glfw":
        os.environ["PYOPENGL_PLATFORM"] = name
    import mujoco

    context = importlib.import_module(f"mujoco.{name}").GLContext
    sys.modules[mujoco.Renderer.__module__].gl_context.GLContext = context
