"""One step explained: two joints, a level that cannot be had in full, and what is left for the level below.

The plane is that of the two joints' steps. The first level asks for a sum of both, a line; the joints' limits allow a part
of the plane; the second level would rather be at a point. The step is the point of the first level's optima, within the
limits, that is nearest to what the second asks for, and the certificate proves it.
"""

import matplotlib.pyplot as plt
import numpy as np

import prioritized_ik as pik

hand = pik.Level([[1.0, 0.6]], target=[0.7], name="hand")
posture = pik.Level(np.eye(2), target=[-0.3, 0.5], name="posture")
bounds = pik.Bounds([-0.5, -0.6], [0.5, 0.6], ["shoulder", "elbow"])
problem = pik.IKProblem([hand, posture], bounds)

step = pik.solve(problem)
print(step)  # what was found, and the proof
for concession in pik.explain(problem, step):
    print(concession)  # who gave way, by how much, and to what
weighted = pik.solve(pik.IKProblem([pik.Level(np.vstack([[1.0, 0.6], np.eye(2)]), [0.7, -0.3, 0.5])], bounds))

figure, axes = plt.subplots(figsize=(6.4, 4.8), layout="constrained")
axes.add_patch(plt.Rectangle((-0.5, -0.6), 1.0, 1.2, color="#dfe7f1", label="within the limits"))
first = np.linspace(-0.8, 1.1, 2)
axes.plot(first, (0.7 - first) / 0.6, color="#218754", label="all that the first level asks for")
for radius in (0.2, 0.4, 0.6, 0.8):
    axes.add_patch(plt.Circle((-0.3, 0.5), radius, fill=False, color="#b9a0d8", linewidth=0.8))
axes.plot(-0.3, 0.5, "o", color="#6f42c1", label="what the second level asks for")
axes.plot(*weighted.dtheta, "s", color="#e8872d", label="both as weights of one level: neither")
axes.plot(*step.dtheta, "*", color="#c42e3c", markersize=16, label="strict levels: the certified step")
axes.set(xlabel="step of the shoulder [rad]", ylabel="step of the elbow [rad]", xlim=(-0.8, 1.1), ylim=(-0.75, 1.35))
axes.set_aspect("equal")
axes.legend(loc="lower right", fontsize=8)
figure.savefig("one_step.png", dpi=100)
