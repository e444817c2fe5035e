"""A humanoid reaches out of its reach, and keeps its feet and its balance: feet > balance > hands > posture."""

import numpy as np

import prioritized_ik as pik
from prioritized_ik.viewer import Camera, Film

DT = 0.05  # [s]

robot = pik.example("humanoid")
for side in ("left", "right"):  # knees and elbows a little bent, feet flat on the floor
    robot.data.joint(f"{side} hip pitch").qpos = -0.4
    robot.data.joint(f"{side} knee").qpos = 0.8
    robot.data.joint(f"{side} ankle pitch").qpos = -0.4
    robot.data.joint(f"{side} elbow").qpos = -0.9
robot.update()

feet = [pik.Pose(robot, site=f"{side} foot") for side in ("left", "right")]
balance = pik.CentreOfMass(robot, weights=[1, 1, 0])  # over the feet, at any height
hands = [pik.Position(robot, site=f"{side} hand", gain=0.5) for side in ("left", "right")]
levels = [feet, balance, hands, pik.Posture(robot, gain=0.1)]
limits = [pik.JointRange(robot), pik.Velocity(robot, 3.0)]

start = [hand.target for hand in hands]
away = np.array([[0.35, 0.05, -0.3], [0.1, -0.1, 0.35]])  # [m] further than the left hand can go

with Film(
    "humanoid_reach.webp",
    robot,
    levels,
    limits,
    camera=Camera(azimuth=150, elevation=-12, distance=1.8, lookat=(-0.1, -0.22, 0.47)),
    rate=20,
) as film:
    for t in np.linspace(0.0, 1.0, 60):
        for hand, from_, by in zip(hands, start, away, strict=True):
            hand.target = from_ + by * np.sin(np.pi * t) ** 2
        motion = pik.solve_step(robot, levels, limits, DT)
        robot.integrate(motion.velocity, DT)
        film.add(motion)

foot = robot.position(robot.frame(site="left foot")) - feet[0].target[:3, 3]
print(f"the left foot is {1e3 * np.linalg.norm(foot):.2f} mm from where it was")
