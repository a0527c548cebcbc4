"""
Delta robot
===========

Three arms on the base move a platform by two parallel rods each, so that it never turns (R. Clavel, *Device for the
movement and positioning of an element in space*, 1990). It picks a part up and puts it down: inverse kinematics tells
the motors their angles, inverse dynamics their torques.
"""

import math

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import simpson

from alfmu import Mechanism, kinematics
from alfmu.view.picture import animate

ARM, ROD, BASE, TOP = 0.25, 0.55, 0.15, 0.05  # lengths, and radii of the joints on base and platform [m]
SIDE = 0.04  # of a rod from the middle of its pair [m]
PERIOD = 0.6  # of a motion [s]

# %%
# The rods are massless: each keeps its ends at a distance. A motor turns each arm about a horizontal axis.


def delta() -> Mechanism:
    m = Mechanism("delta", "A platform on three pairs of rods")
    platform = m.spatial_body("platform", mass=0.8, inertia=(1e-3, 1e-3, 2e-3), position=(0.0, 0.0, -0.5))
    for i in range(3):
        c, s = math.cos(2 * math.pi * i / 3), math.sin(2 * math.pi * i / 3)
        along, across = np.array([c, s, 0.0]), np.array([-s, c, 0.0])
        arm = m.spatial_body(
            f"arm{i}", mass=0.4, inertia=(2e-3, 2e-3, 2e-3), center=tuple(ARM / 2 * along), relative=True
        )
        motor = m.spatial_revolute(
            f"motor{i}",
            m.spatial_ground.at(*(BASE * along)),
            arm.at(0, 0, 0),
            axis=tuple(across),
            coordinate=m.coordinate(f"angle{i}", "rad", start=0.3, independent=True),
        )
        for k, shift in enumerate((-SIDE * across, SIDE * across)):
            ends = arm.at(*(ARM * along + shift)), platform.at(*(TOP * along + shift))
            m.distance(f"rod{i}{'ab'[k]}", *ends, length=ROD)
        m.drive(motor, m.input(f"motor{i}.input", "N.m"))
    m.watch("tool", platform.at(0, 0, 0))
    m.gravity(0, 0, -9.81)
    return m


# %%
# The tool rises, goes over and comes down, and rests at both ends. At each point of the path the solution nearest to
# the last one is taken.

mechanism = delta()
robot = kinematics(mechanism)
time = np.linspace(0.0, PERIOD, 121)
part = time / PERIOD
smooth = part**4 * (35 - 84 * part + 70 * part**2 - 20 * part**3)  # without acceleration at both ends
path = np.column_stack([0.3 * smooth - 0.15, 0.1 * smooth - 0.05, -0.6 + 0.1 * np.sin(np.pi * smooth) ** 2])
positions = [robot.inverse({"tool": path[0]})]
for place in path[1:]:
    positions.append(robot.inverse({"tool": place}, positions[-1]))
angles = {name: np.array([each[name] for each in positions]) for name in robot.actuated}

# %%
# The torques of the motors, and how far the position is from singular ones.

result = robot.along({name: (time, each) for name, each in angles.items()})
near = [robot.transmission(each) for each in positions]
fig, (top, bottom) = plt.subplots(2, 1, sharex=True, layout="constrained")
for name in robot.actuated:
    top.plot(time, result[f"{name}.torque"], label=name)
bottom.plot(time, [each.parallel for each in near], label="parallel")
bottom.plot(time, [each.serial for each in near], label="serial")
top.set_ylabel("torque [N.m]")
bottom.set(xlabel="time [s]", ylabel="to a singular position [1]", ylim=(0, None))
top.legend()
bottom.legend()

# %%
# One motion, at a tenth of its speed.

animate(mechanism, result, "delta.gif", fps=20, speed=0.15)

# %%
# **Check.** The end of an arm is on a circle about its motor and on a sphere about the joint of the platform, which
# gives the angle in closed form. And as the tool rests at one height at both ends, the work of the motors is what the
# weight of the arms has gained.


def arm_angle(i: int, place: np.ndarray) -> float:
    """Angle of an arm, downwards from the horizontal, for a place of the tool."""
    c, s = math.cos(2 * math.pi * i / 3), math.sin(2 * math.pi * i / 3)
    out, side, down = c * place[0] + s * place[1] + TOP - BASE, c * place[1] - s * place[0], -place[2]
    reach = (out**2 + side**2 + down**2 + ARM**2 - ROD**2) / (2 * ARM)
    return math.atan2(down, out) - math.acos(reach / math.hypot(out, down))


expected = np.array([[arm_angle(i, place) for i in range(3)] for place in path])
deviation = float(np.abs(np.column_stack(list(angles.values())) - expected).max())
power = sum(result[f"{name}.torque"] * result[f"der({name})"] for name in robot.actuated)
work, moved = float(simpson(power, x=time)), float(simpson(np.maximum(power, 0.0), x=time))
gained = float(0.4 * 9.81 * ARM / 2 * np.sum(np.sin(expected[0]) - np.sin(expected[-1])))
print(f"The angles of the arms are those of the closed form to {deviation:.1e} rad.")
print(f"The motors give {moved:.2f} J, and in all {1e3 * work:.4f} mJ; the arms have gained {1e3 * gained:.4f} mJ.")
