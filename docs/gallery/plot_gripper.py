"""
Two-finger gripper
==================

Each finger is a parallelogram of two links, so that its pad never turns, and one motor closes both fingers by a pair of
gears, as in many grippers of robots. They centre a part that does not lie in the middle, and hold it.
"""

import math

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

from alfmu import Experiment, Mechanism, kinematics, simulate
from alfmu.view.picture import animate

LINK, WIDTH, APART = 0.06, 0.02, 0.03  # links, hinges of a finger, and inner hinges of both fingers [m]
PART, OFF = 0.04, 0.006  # width of the part, and how far it lies from the middle [m]
TORQUE = 0.3  # of the motor [N.m]

# %%
# Two gears of one size turn the inner links against each other. The pads press on the part as stiff springs that never
# pull: end stops on the distance of part and pad.


def gripper() -> Mechanism:
    m = Mechanism("gripper", "Two four-bar fingers", experiment=Experiment(0.3, communication_step=2e-3))
    x = m.coordinate("x", "m", start=OFF, independent=True)
    part = m.body("part", mass=0.05, inertia=2e-5)
    table = m.prismatic("table", m.ground.at(0, 1.3 * LINK), part.at(0, 0), coordinate=x)
    m.friction(table, 2.0)
    inner = {}
    for name, side in (("left", -1), ("right", 1)):
        start = math.pi / 2 - 0.7 * side
        angle, other, tilt = (
            m.coordinate(f"{name}_{what}", "rad", start=value, independent=side > 0 and what == "angle")
            for what, value in (("angle", start), ("other", start), ("tilt", -start))
        )
        inner[name], outer = (m.bar(f"{name}_{which}", mass=0.02, length=LINK) for which in ("inner", "outer"))
        pad = m.body(f"{name}_pad", mass=0.03, inertia=1e-5, center=(side * WIDTH / 2, 0.3 * LINK))
        feet = [m.ground.at(side * (APART / 2 + shift), 0) for shift in (0, WIDTH)]
        axle = m.revolute(f"{name}_axle", feet[0], inner[name].start, coordinate=angle)
        m.revolute(f"{name}_foot", feet[1], outer.start, coordinate=other)
        m.revolute(f"{name}_tip", inner[name].end, pad.at(0, 0), coordinate=tilt)
        m.revolute(f"{name}_end", outer.end, pad.at(side * WIDTH, 0))
        m.watch(f"{name}_nail", pad.at(0, 0.6 * LINK))
        gap = side * (side * APART / 2 + LINK * ca.cos(angle) - x)
        m.end_stop(f"{name}_touch", gap, lower=PART / 2, stiffness=2e4, onset=1e-4, dissipation=5.0)
    m.gear("gears", inner["left"].start, inner["right"].start, radii=(APART / 2, APART / 2), phase=math.pi)
    m.friction(axle, 0.02)  # that of the gearbox
    m.drive(axle, m.input("motor", "N.m", start=TORQUE))
    m.gravity(0, 0)
    return m


# %%
# The right pad comes to the part first and pushes it to the other one.

mechanism = gripper()
result = simulate(mechanism)
fig, (left, right) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
for name in ("left", "right"):
    left.plot(result.time, result[f"{name}_touch.force"], label=name)
left.set(xlabel="time [s]", ylabel="force of a pad [N]")
left.legend()

# %%
# How hard the fingers hold a part depends on its width: kinematics has the rate of a pad by the angle of the motor.

way = kinematics(mechanism, actuated=["right_axle", "table"], watch=["right_nail"]).cycle("right_axle", span=(0.6, 1.8))
right.plot(2e3 * way["right_nail.x"], TORQUE / 2 / np.abs(way["right_nail.x/right_axle"]))
right.set(xlabel="width of a part [mm]", ylabel="force of a pad [N]", ylim=(0, 5))

# %%
animate(mechanism, result, "gripper.gif", fps=25, speed=0.2)

# %%
# **Check.** Where the fingers hold the part, virtual work says that the torque is twice the force of a pad times the
# height of the link's end: torque = 2 force LINK sin(angle).

force = float(result["right_touch.force"][-1])
expected = TORQUE / (2 * LINK * math.sin(result["right_inner.angle"][-1]))
centred = float(result["part.x"][-1])
turned = float(max(np.abs(result[f"{name}_pad.angle"]).max() for name in ("left", "right")))
print(f"A pad presses with {force:.4f} N, expected {expected:.4f} N, and never turns (to {turned:.0e} rad).")
print(f"The part lay {1e3 * OFF:.0f} mm off, and lies {1e6 * centred:.3f} um off.")
