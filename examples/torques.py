"""Joint torques of forces at several end points at once (Eqs. 4 and 5), beside MuJoCo's own account of the same forces."""

import matplotlib.pyplot as plt
import mujoco
import numpy as np

import prioritized_ik as pik
from prioritized_ik.virtual_arms import joint_torques

arm = pik.Arm()  # 17 links, 49 joints
robot = pik.Robot(arm.spec().compile(), arm.posture("arched"))
arms = pik.VirtualArms(robot.model, ["end_8", "end_17"])
forces = np.array([[0.0, 0.0, 5.0], [2.0, 0.0, -1.0]])  # [N] on links 8 and 17

torques = joint_torques(arms.jacobian(robot.data), forces.ravel())  # Eq. 5: τ = Jᵀ F
witness = np.zeros(robot.model.nv)
for site, force in zip(("end_8", "end_17"), forces, strict=True):
    place = robot.data.site(site).xpos
    body = robot.model.site_bodyid[robot.site(site)]
    mujoco.mj_applyFT(robot.model, robot.data, force, np.zeros(3), place, body, witness)
print(f"largest torque {np.abs(torques).max():.3f} N·m, {np.abs(torques - witness).max():.1e} N·m from MuJoCo's")

figure, axes = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
axes.bar(np.arange(1, 50), torques, color="#4c78a8", label="Eqs. 4 and 5")
axes.plot(np.arange(1, 50), witness, ".", color="#c42e3c", label="MuJoCo")
axes.set(xlabel="joint", ylabel="torque [N·m]", title="5 N up at link 8, and a pull at the tip")
axes.legend()
figure.savefig("torques.png", dpi=100)
