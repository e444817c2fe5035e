"""A drop-in for mink: the same tasks, limits and call; the answer no longer depends on the solver."""

import matplotlib.pyplot as plt
import mink
import numpy as np

import prioritized_ik as pik
from prioritized_ik.mink import solve_ik

SOLVERS = ("daqp", "quadprog", "proxqp", "piqp")

robot = pik.example("arm", q=[0.3, 0.5, 0.2, 1.2, 0.1, 0.6, 0.0])
configuration = mink.Configuration(robot.model, robot.q)
hand = mink.FrameTask("tool", "site", position_cost=1.0, orientation_cost=0.0)
hand.set_target(mink.SE3.from_translation(robot.position(robot.frame(site="tool")) + np.array([0.02, 0.01, -0.01])))
limits = [mink.ConfigurationLimit(robot.model)]

theirs = {name: mink.solve_ik(configuration, [hand], 0.01, name, limits=limits) for name in SOLVERS}
ours = {name: solve_ik(configuration, [hand], 0.01, name, limits=limits) for name in SOLVERS}
assert all(np.array_equal(velocity, ours["daqp"]) for velocity in ours.values())  # to the last bit

off = [np.linalg.norm(theirs[name] - ours[name]) / np.linalg.norm(ours[name]) for name in SOLVERS]
for name, error in zip(SOLVERS, off, strict=True):
    print(f"mink with {name}: {error:.1e} from the optimum; ours: the same bits with each")

figure, axes = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
axes.barh(SOLVERS, np.maximum(off, 1e-16), color="#4c78a8")
axes.invert_yaxis()
axes.set(xscale="log", xlim=(1e-16, 10.0), xlabel="relative distance of the velocity from the certified optimum")
axes.set_title("mink's answer by solver, at its default damping of 1e-12")
figure.savefig("drop_in.png", dpi=100)
