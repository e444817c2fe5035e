"""Strict levels against weights: how far a humanoid's feet slip and its balance moves when a hand asks for too much."""

import matplotlib.pyplot as plt
import numpy as np

import prioritized_ik as pik

DT = 0.02  # [s]


def slips(weight):
    """Return how far a foot and the centre of mass move [mm]; `weight` None stands for strict levels."""
    robot = pik.example("humanoid")
    feet = [pik.Pose(robot, site=f"{side} foot", weights=weight or 1.0) for side in ("left", "right")]
    balance = pik.CentreOfMass(robot, weights=np.array([1, 1, 0]) * (weight or 1.0))
    hand = pik.Position(robot, site="left hand", gain=0.2)
    hand.target = hand.target + np.array([0.9, 0.2, 0.1])  # further than the robot reaches
    levels = [feet, balance, hand] if weight is None else [[*feet, balance, hand]]
    limits = [pik.JointRange(robot), pik.Velocity(robot, 3.0)]
    for _ in range(60):
        motion = pik.solve_step(robot, [*levels, pik.Posture(robot, gain=0.1)], limits, DT)
        robot.integrate(motion.velocity, DT)
    foot = robot.position(robot.frame(site="left foot")) - feet[0].target[:3, 3]
    mass = balance.place(robot) - balance.target
    return 1e3 * np.linalg.norm(foot), 1e3 * np.linalg.norm(mass[:2])


choices = {"weights 1 : 1": 1.0, "10 : 1": 10.0, "100 : 1": 100.0, "1000 : 1": 1000.0, "strict levels": None}
feet, balance = np.array([slips(weight) for weight in choices.values()]).T
for name, foot, mass in zip(choices, feet, balance, strict=True):
    print(f"{name}: foot {foot:.3f} mm, centre of mass {mass:.3f} mm")

figure, axes = plt.subplots(figsize=(6.4, 4.0), layout="constrained")
place = np.arange(len(choices))
axes.bar(place - 0.2, feet, 0.4, label="left foot", color="#4c78a8")
axes.bar(place + 0.2, balance, 0.4, label="centre of mass, sideways", color="#f58518")
axes.set(yscale="log", ylabel="moved [mm]", xticks=place, xticklabels=choices)
axes.set_title("A hand is drawn 93 cm away: what gives way")
axes.legend()
figure.savefig("strict_or_weighted.png", dpi=100)
