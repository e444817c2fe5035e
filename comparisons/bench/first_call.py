"""What a fresh process pays: import, first step, memory."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from comparisons.bench.settings import BenchSettings
from prioritized_ik.errors import PrioritizedIkError

#: One position task on the paper's arm with joint and step limits; times from the first import on [s].
OURS = """
import json, time
started = time.perf_counter()
import mujoco
import prioritized_ik as pik
arm = pik.Arm()
model, q = arm.spec().compile(), arm.posture("random")
data = mujoco.MjData(model)
pik.update_kinematics(model, data, q)
jacobian = pik.VirtualArms(model, ["end_17"]).jacobian(data)
bounds = pik.joint_range_bounds(model, q).intersect(pik.step_bounds(model, max_step=0.01))
problem = pik.IKProblem([pik.Level(jacobian, [0.0, 0.02, 0.01])], bounds)
pik.solve
imported = time.perf_counter()
step = pik.solve(problem)
solved = time.perf_counter()
pik.solve(problem)
again = time.perf_counter()
"""

MINK = """
import json, time
started = time.perf_counter()
import mink
import prioritized_ik as pik
arm = pik.Arm()
model = arm.spec().compile()
configuration = mink.Configuration(model)
configuration.update(arm.posture("random"))
task = mink.FrameTask("end_17", "site", position_cost=1.0, orientation_cost=0.0)
here = configuration.get_transform_frame_to_world("end_17", "site")
task.set_target(mink.SE3.from_rotation_and_translation(here.rotation(), here.translation() + [0.0, 0.02, 0.01]))
limits = [mink.ConfigurationLimit(model, gain=1.0)]
imported = time.perf_counter()
mink.solve_ik(configuration, [task], 1.0, "daqp", limits=limits)
solved = time.perf_counter()
mink.solve_ik(configuration, [task], 1.0, "daqp", limits=limits)
again = time.perf_counter()
"""

PROGRAMS = {"ours": OURS, "mink (daqp)": MINK}

#: Peak resident memory as the kernel counts it for this program alone; `getrusage` would count its parent's too.
TOLD = """
try:
    with open("/proc/self/status") as file:
        peak = next(int(line.split()[1]) / 1024.0 for line in file if line.startswith("VmHWM"))
except (OSError, StopIteration):
    peak = None
print(json.dumps([imported - started, solved - imported, again - solved, solved - started, peak]))
"""


@dataclass(frozen=True)
class FirstCall:
    """Medians over fresh processes [s]; memory [MiB].

    Attributes:
        ready: imports and posing.
        first: the first solve.
        second: the same once more.
        total: imports, posing and first solve.
        peak: peak resident memory; None where the system does not tell.
    """

    ready: float
    first: float
    second: float
    total: float
    peak: float | None


def measure_first_calls(settings: BenchSettings, tell: Callable[[str, int, int], object]) -> dict[str, FirstCall]:
    """Return the first call of ours and of mink's, in processes that take turns.

    Raises:
        PrioritizedIkError: such a process fails.
    """
    told: dict[str, list[list[float | None]]] = {name: [] for name in PROGRAMS}
    for number in range(settings.starts):
        tell("first calls", number, settings.starts)
        for name, program in PROGRAMS.items():
            told[name].append(_run(name, program))
    tell("first calls", settings.starts, settings.starts)
    return {name: _median(runs) for name, runs in told.items()}


def _median(runs: list[list[float | None]]) -> FirstCall:
    *times, peaks = zip(*runs, strict=True)
    ready, first, second, total = (float(np.median(column)) for column in times)
    return FirstCall(ready, first, second, total, None if None in peaks else float(np.median(peaks)))


def _run(name: str, program: str) -> list[float | None]:
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-c", program + TOLD]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if ran.returncode:
        last = ran.stderr.strip().splitlines()[-1:]
        raise PrioritizedIkError(f"the first call of {name} failed in a fresh process: {' '.join(last)}")
    figures: list[float | None] = json.loads(ran.stdout.splitlines()[-1])
    return figures
