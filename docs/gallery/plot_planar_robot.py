"""
Planar robot with three arms
============================

A platform on three arms of two links each, the 3-RRR robot: the motors stand on the ground, so that little mass moves
(C. Gosselin and J. Angeles, 1988). The platform draws a circle and turns to and fro while it does.
"""

import math

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

from alfmu import Experiment, Mechanism, simulate
from alfmu.view.picture import animate

BASE, PLATFORM, LINK = 0.45, 0.10, 0.25  # radii of the joints' circles, and both links of an arm [m]
CORNERS = [2 * math.pi * k / 3 + math.pi / 2 for k in range(3)]
PERIOD = 2.0  # [s]

# %%
# Inverse kinematics: where the platform should be gives the angle of each first link, by a triangle of two links. The
# functions of CasADi work on expressions in time, and on numbers.


Number = float | ca.SX


def wanted(t: Number) -> tuple[Number, Number, Number]:
    """Place [m] and angle [rad] that the platform should have."""
    turn = 2 * ca.pi * t / PERIOD
    return 0.06 * ca.cos(turn), 0.06 * ca.sin(turn), 0.2 * ca.sin(turn)


def arm_angle(k: int, x: Number, y: Number, angle: Number) -> Number:
    """Angle of the first link of arm k for a place and angle of the platform."""
    dx = x + PLATFORM * ca.cos(CORNERS[k] + angle) - BASE * math.cos(CORNERS[k])
    dy = y + PLATFORM * ca.sin(CORNERS[k] + angle) - BASE * math.sin(CORNERS[k])
    return ca.arctan2(dy, dx) + ca.acos(ca.sqrt(dx**2 + dy**2) / (2 * LINK))


# %%
# Each motor holds its angle by a spring and a damper, as a servo drive does.


def planar_robot() -> Mechanism:
    m = Mechanism(
        "planar_robot", "A platform on three arms", experiment=Experiment(2 * PERIOD, communication_step=0.01)
    )
    goals = wanted(m.time)
    start = [float(x) for x in wanted(0.0)]
    x, y = m.coordinate("x", "m", start=start[0]), m.coordinate("y", "m", start=start[1])
    angle = m.coordinate("angle", "rad", start=start[2])
    platform = m.body("platform", mass=0.8, inertia=0.004, pose=(x, y, angle))
    for k, corner in enumerate(CORNERS):
        i, base = k + 1, m.ground.at(BASE * math.cos(corner), BASE * math.sin(corner))
        goal, first = arm_angle(k, *goals), float(arm_angle(k, *start))
        inner, outer = (m.bar(f"{name}{i}", mass=0.3, length=LINK) for name in ("inner", "outer"))
        shoulder = m.coordinate(f"shoulder{i}", "rad", start=first)
        reach = complex(*start[:2]) + PLATFORM * np.exp(1j * corner) - BASE * np.exp(1j * corner)
        elbow = m.coordinate(f"elbow{i}", "rad", start=2 * (np.angle(reach) - first))
        motor = m.revolute(f"motor{i}", base, inner.start, coordinate=shoulder)
        m.revolute(f"elbow_hinge{i}", inner.end, outer.start, coordinate=elbow)
        m.revolute(f"wrist{i}", outer.end, platform.at(PLATFORM * math.cos(corner), PLATFORM * math.sin(corner)))
        m.drive(motor, 3e3 * (goal - shoulder) + 60.0 * (ca.jacobian(goal, m.time) - m.rate(shoulder)))
    m.watch("pen", platform.at(0, 0))
    m.gravity(0, 0)
    return m


# %%
# The robot starts from rest and catches up with the circle in the first tenth of a second.

mechanism = planar_robot()
result = simulate(mechanism)
x, y = result["platform.x"], result["platform.y"]
fig, axes = plt.subplots(layout="constrained")
axes.plot(1e3 * x, 1e3 * y, label="platform")
round_ = np.linspace(0, 2 * math.pi)
axes.plot(60 * np.cos(round_), 60 * np.sin(round_), "--", label="wanted")
axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
axes.legend()

# %%
# Two rounds of the platform.

animate(mechanism, result, "planar_robot.gif", fps=15, speed=1)

# %%
# **Check.** Inverse kinematics of where the platform is gives the angles of the motors, and the circle is kept.

poses = np.column_stack([x, y, result["platform.angle"]])
angles = np.array([[float(arm_angle(k, *pose)) for k in range(3)] for pose in poses])
turned = np.column_stack([result[f"inner{i}.angle"] for i in (1, 2, 3)])
deviation = float(np.abs((angles - turned + math.pi) % (2 * math.pi) - math.pi).max())
late = result.time > 0.5
tracking = float(np.abs(np.hypot(x, y)[late] - 0.06).max())
print(f"Angles of the motors and place of the platform belong together to {deviation:.1e} rad.")
print(f"The circle of 60 mm is kept to {1e3 * tracking:.2f} mm.")
