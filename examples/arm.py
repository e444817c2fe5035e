"""An arm of seven joints takes its tool from place to place: position before orientation before posture, within limits."""

import prioritized_ik as pik
from prioritized_ik.viewer import Camera, Film

DT = 0.05  # [s]

robot = pik.example("arm", q=[0.3, 0.5, 0.2, 1.2, 0.1, 0.6, 0.0])
tool = pik.Position(robot, site="tool", gain=0.6)
levels = [tool, pik.Orientation(robot, [0, 0, 1, 0], site="tool", gain=0.3), pik.Posture(robot, gain=0.3)]
limits = [pik.JointRange(robot), pik.Velocity(robot, 2.0)]

with Film(
    "arm.webp",
    robot,
    levels,
    limits,
    size=(480, 360),
    camera=Camera(azimuth=140, elevation=-20, distance=1.7, lookat=(0.3, 0.1, 0.4)),
) as film:
    for place in ([0.5, -0.3, 0.2], [0.5, 0.0, 0.6], [0.3, -0.4, 0.15]):
        tool.target = place
        for _ in range(16):
            motion = pik.solve_step(robot, levels, limits, DT)
            robot.integrate(motion.velocity, DT)
            film.add(motion)
        print(f"{place}: {motion.step.status.name}")
