"""A hand goes to the other side of a post, and around it: distances are limits, the nearest points are drawn."""

import prioritized_ik as pik
from prioritized_ik.viewer import Camera, Film

DT = 0.05  # [s]

robot = pik.example("arm", q=[0.0, 0.6, 0.0, 1.3, 0.0, 0.6, 0.0])
tool = pik.Position(robot, [0.62, 0.3, 0.3], site="tool", gain=0.3)
levels = [tool, pik.Posture(robot, gain=0.1)]
apart = pik.Collision(robot, [("hand", "post"), ("hand", "table")], min_distance=0.02, margin=0.15)
limits = [pik.JointRange(robot), pik.Velocity(robot, 1.5), apart]

nearest = 1.0
camera = Camera(azimuth=150, elevation=-35, distance=1.6, lookat=(0.3, 0.15, 0.35))
with Film("collision.webp", robot, levels, limits, size=(480, 360), camera=camera) as film:
    for _ in range(45):
        motion = pik.solve_step(robot, levels, limits, DT)
        robot.integrate(motion.velocity, DT)
        nearest = min(nearest, *apart.distances(robot))
        film.add(motion)
print(f"nearest on the way: {1e3 * nearest:.1f} mm, asked for at least 20 mm")
