"""A closed loop: a five-bar linkage, two arms with one pen, draws a circle; the model's own equality keeps it closed."""

import mujoco
import numpy as np

import prioritized_ik as pik
from prioritized_ik.viewer import Camera, Film

DT = 0.05  # [s]

FIVE_BAR = """
<mujoco model="five-bar linkage">
  <compiler angle="radian"/>
  <equality><connect name="pen" site1="pen" site2="pen too"/></equality>
  <default><joint axis="0 1 0"/><geom type="capsule" size="0.007" rgba="0.62 0.68 0.76 1"/></default>
  <worldbody>
    <body name="left arm" pos="-0.1 0 0"><joint name="left shoulder"/><geom fromto="0 0 0 0 0 0.2"/>
      <body name="left forearm" pos="0 0 0.2"><joint name="left elbow"/><geom fromto="0 0 0 0 0 0.32"/>
        <site name="pen" pos="0 0 0.32"/></body></body>
    <body name="right arm" pos="0.1 0 0"><joint name="right shoulder"/><geom fromto="0 0 0 0 0 0.2"/>
      <body name="right forearm" pos="0 0 0.2"><joint name="right elbow"/><geom fromto="0 0 0 0 0 0.32"/>
        <site name="pen too" pos="0 0 0.32"/></body></body>
  </worldbody>
</mujoco>"""

robot = pik.Robot(mujoco.MjModel.from_xml_string(FIVE_BAR), [-0.7, 1.0, 0.7, -1.0])
pen = pik.Position(robot, [0.0, 0.0, 0.44], site="pen", weights=[1, 0, 1])
loop = pik.ModelEqualities(robot)
limits = [loop, pik.Velocity(robot, 3.0)]
steps = 0
while max(loop.drift(robot).values()) > 1e-6:  # the two arms come together
    robot.integrate(pik.solve_step(robot, [pen], limits, DT).velocity, DT)
    steps += 1
print(f"closed after {steps} steps")

widest = 0.0
camera = Camera(azimuth=90, elevation=0, distance=0.8, lookat=(0.0, 0.0, 0.22))
with Film("closed_loop.webp", robot, [pen], limits, size=(480, 360), camera=camera) as film:
    for angle in np.linspace(0.0, 2.0 * np.pi, 50):
        pen.target = [0.06 * np.sin(angle), 0.0, 0.38 + 0.06 * np.cos(angle)]
        motion = pik.solve_step(robot, [pen], limits, DT)
        robot.integrate(motion.velocity, DT)
        widest = max(widest, *loop.drift(robot).values())
        film.add(motion)
print(f"the loop opens by at most {1e3 * widest:.2f} mm a step, which the next one takes back")
