"""Who gave way: three levels, of which the second is held back by a limit and the third by the levels above."""

import numpy as np
from PIL import Image

import prioritized_ik as pik
from prioritized_ik.viewer import Camera, picture

robot = pik.example("arm", q=[0.3, 0.5, 0.2, 1.2, 0.1, 0.6, 0.0])
turn = pik.Orientation(robot, site="tool")
tool = pik.Position(robot, site="tool")
tool.target = tool.target + np.array([0.1, -0.1, 0.1])
elbow = pik.JointCoupling(robot, {"elbow": 1.0}, target=2.0)
levels, limits = [turn, tool, elbow], [pik.JointRange(robot), pik.Velocity(robot, {"base": 0.5, "elbow": 1.0})]

motion = pik.solve_step(robot, levels, limits, dt=0.05, damping=0.0)
for concession in motion.report:
    print(concession)
robot.integrate(motion.velocity, 0.05)
Image.fromarray(picture(robot, levels, limits, motion, camera=Camera(azimuth=140, elevation=-20))).save("who_gave_way.png")
