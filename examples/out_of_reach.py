"""A target goes out of reach and comes back: the arm comes to rest at its nearest, and follows again without a jump."""

import numpy as np

import prioritized_ik as pik
from prioritized_ik.viewer import Camera, Film

DT = 0.05  # [s]

robot = pik.example("arm", q=[0.3, 0.5, 0.2, 1.2, 0.1, 0.6, 0.0])
tool = pik.Position(robot, site="tool", gain=0.6)
levels, limits = [tool, pik.Posture(robot, gain=0.1)], [pik.JointRange(robot), pik.Velocity(robot, 2.0)]
start = tool.target
camera = Camera(azimuth=200, elevation=-20, distance=2.2, lookat=(0.4, -0.2, 0.4))

fastest = []
with Film("out_of_reach.webp", robot, levels, limits, size=(480, 360), camera=camera) as film:
    for t in np.linspace(0.0, 1.0, 60):
        tool.target = start + np.array([0.5, -0.9, 0.2]) * np.sin(np.pi * t) ** 2
        motion = pik.solve_step(robot, levels, limits, DT)
        robot.integrate(motion.velocity, DT)
        fastest.append(np.abs(motion.velocity).max())
        film.add(motion)
print(f"fastest joint while out of reach: {max(fastest[25:35]):.3f} rad/s; at the end {fastest[-1]:.3f} rad/s")
