"""
Scissor lift
============

A goods lift of three stages: six arms of 1.6 m, a platform with 500 kg of goods, and a spindle that pulls the lower
roller inwards. The platform also runs on a rail in the wall of the shaft. The scissors alone carry and guide it, so
that the rail adds two constraints that the motion does not need. Such redundant constraints are declared like any
others.
"""

import math

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

from alfmu import Experiment, Mechanism, simulate
from alfmu.view.picture import animate

ARM, STAGES = 1.6, 3
ARM_MASS, PLATFORM_MASS, G = 30.0, 620.0, 9.81  # [kg], [kg] with the goods, [m/s2]
LOW, HIGH = math.radians(12), math.radians(55)
LIFT_TIME = 8.0  # [s]


def pull(angle: float) -> float:
    """Force of the spindle that holds the lift at an angle of the arms [N], by virtual work."""
    lifted = sum(2 * ARM_MASS * (n + 0.5) for n in range(STAGES)) + STAGES * PLATFORM_MASS
    return lifted * G / math.tan(angle)


# %%
# Arms are declared by their angles: `rising` ones go up to the right, `falling` ones up to the left. The spindle is
# told where the roller should be, along a smooth step between two positions. It is a spring of 2e7 N/m with a damper,
# and starts with the elongation that carries the load.


def scissor_lift() -> Mechanism:
    m = Mechanism(
        "scissor_lift", "A goods lift of three scissors", experiment=Experiment(10.0, communication_step=0.02)
    )
    part = ca.fmin(m.time / LIFT_TIME, 1)
    goal = ARM * ca.cos(LOW + (HIGH - LOW) * (part - ca.sin(2 * ca.pi * part) / (2 * ca.pi)))
    slide = m.coordinate("slide", "m", start=ARM * math.cos(LOW) + pull(LOW) / 2e7, independent=True)

    roller = m.body("roller", mass=15.0)
    spindle = m.prismatic("spindle", m.ground.at(0, 0), roller.at(0, 0), coordinate=slide)
    left, right, left_angle, right_angle = m.ground.at(0, 0), roller.at(0, 0), 0.0, 0.0
    for n in range(1, STAGES + 1):
        rising, falling = (m.bar(f"{name}{n}", mass=ARM_MASS, length=ARM) for name in ("rising", "falling"))
        up = m.coordinate(f"up{n}", "rad", start=LOW - left_angle)
        down = m.coordinate(f"down{n}", "rad", start=math.pi - LOW - right_angle)
        m.revolute(f"left{n}", left, rising.start, coordinate=up)
        m.revolute(f"right{n}", right, falling.start, coordinate=down)
        m.revolute(f"middle{n}", rising.at(ARM / 2, 0), falling.at(ARM / 2, 0))
        left, right, left_angle, right_angle = falling.end, rising.end, math.pi - LOW, LOW
    platform = m.body("platform", mass=PLATFORM_MASS, inertia=200.0, center=(ARM / 2, 0.4))
    level = m.coordinate("level", "rad", start=-left_angle)
    m.revolute("corner", left, platform.at(0, 0), coordinate=level)
    m.point_on_line("track", platform.at(0, 0), right)
    m.prismatic("rail", m.ground.at(0, 0), platform.at(0, 0), axis=math.pi / 2)

    force = 2e7 * (goal - slide) + 1e6 * (ca.jacobian(goal, m.time) - m.rate(slide))
    m.drive(spindle, force)
    m.output("pull", -force, "N", "force with which the spindle pulls the roller inwards")
    m.gravity(0, -G)
    return m


# %%
# The spindle has to pull hardest at the bottom, where the arms lie flat.

mechanism = scissor_lift()
result = simulate(mechanism)
height = result["platform.y"] - 0.4
fig, (top, bottom) = plt.subplots(2, 1, sharex=True, layout="constrained")
top.plot(result.time, height)
top.set_ylabel("height [m]")
bottom.plot(result.time, result["pull"] / 1e3)
bottom.set(xlabel="time [s]", ylabel="pull of the spindle [kN]")

# %%
# The lift at twice its speed.

animate(mechanism, result, "scissor_lift.gif", fps=15, speed=2)

# %%
# **Check.** Three stages stand 3 ARM sin(angle) high, and at rest the pull is that of virtual work.

angle = result["rising1.angle"]
height_error = float(np.abs(height - STAGES * ARM * np.sin(angle)).max())
held, statics = float(result["pull"][-1]), pull(float(angle[-1]))
print(f"Height and angle agree to {height_error:.1e} m, from {height[0]:.2f} m to {height[-1]:.2f} m.")
print(f"At the top the spindle pulls with {held:.1f} N; virtual work says {statics:.1f} N.")
