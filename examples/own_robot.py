"""Your own robot, from a URDF file: load it, name what matters, take a certified step, reach."""

from pathlib import Path

from PIL import Image

import prioritized_ik as pik
from prioritized_ik.viewer import Camera, picture

FILE = Path(__file__).parent / "robots" / "crane.urdf"

robot = pik.Robot(FILE)
print(robot.names("joint"), robot.names("body"))
hook = pik.Position(robot, [0.9, 0.5, 0.6], body="hook")
levels, limits = [hook, pik.Posture(robot)], [pik.JointRange(robot), pik.Velocity(robot, 1.0)]

motion = pik.solve_step(robot, levels, limits, dt=0.01)
print(motion.step)  # SOLVED or CLOSED_FORM: certified
print(pik.reach(robot, levels, limits, dt=0.05))
shown = picture(robot, levels, limits, camera=Camera(azimuth=120, elevation=-15))
Image.fromarray(shown).save("own_robot.png")
