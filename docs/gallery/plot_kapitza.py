"""
Kapitza's pendulum
==================

A pendulum stands on its head, and nothing holds it but its base, which shakes up and down. The shaking is prescribed:
the point of the ground at which the hinge sits is an expression of time, and alfmu finds what it costs.
"""

import math

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

from alfmu import Experiment, Mechanism, simulate
from alfmu.view.picture import animate

LENGTH, MASS, GRAVITY = 0.3, 0.2, 9.81  # of the bar [m, kg], and gravity [m/s2]
STROKE, FREQUENCY = 0.01, 2 * math.pi * 60  # amplitude of the base [m] and its frequency [rad/s]
LEAN = 0.3  # of the bar at the start, from upright [rad]

# %%
# The base is a body of its own without mass, so that pictures show it; its pose is the law of its motion.


def kapitza() -> Mechanism:
    m = Mechanism(
        "kapitza", "A pendulum on a vibrating base", experiment=Experiment(stop_time=2.0, communication_step=0.002)
    )
    base = m.body("base", mass=0.0, pose=(0.0, STROKE * ca.cos(FREQUENCY * m.time), 0.0))
    rod = m.bar("rod", mass=MASS, length=LENGTH)
    angle = m.coordinate("angle", "rad", start=math.pi / 2 - LEAN, independent=True)
    m.revolute("hinge", base.at(0, 0), rod.start, coordinate=angle)
    m.gravity(0, -GRAVITY)
    return m


# %%
# The bar swings slowly about the upright position, with a ripple of the base's frequency.

mechanism = kapitza()
result = simulate(mechanism)
fig, (top, bottom) = plt.subplots(2, 1, sharex=True, layout="constrained")
top.plot(result.time, result["rod.angle"] - math.pi / 2)
top.set_ylabel("lean of the bar [rad]")
bottom.plot(result.time, result["hinge.force.y"], linewidth=0.5)
bottom.set(xlabel="time [s]", ylabel="force of the hinge [N]")

# %%
# One second at a third of the speed.

animate(mechanism, result, "kapitza.gif", fps=15, speed=0.33)

# %%
# **Check.** Averaged over the shaking, the bar feels a potential with a minimum on top where STROKE^2 FREQUENCY^2 is
# above 2 g L, with L two thirds of its length. It swings there with (STROKE^2 FREQUENCY^2 / (2 L^2) - g / L)^(1/2).
# That is the first term of a series in STROKE / L, and for small swings.

reduced = 2 / 3 * LENGTH
expected = math.sqrt((STROKE * FREQUENCY / reduced) ** 2 / 2 - GRAVITY / reduced)
lean = result["rod.angle"] - math.pi / 2
window = round(2 * math.pi / FREQUENCY / 0.002 * 3)
smooth = np.convolve(lean, np.ones(window) / window, "same")[window:-window]
times = result.time[window:-window]
crossings = np.flatnonzero(np.sign(smooth[1:]) != np.sign(smooth[:-1]))
found = math.pi * (len(crossings) - 1) / (times[crossings[-1]] - times[crossings[0]])
largest = float(abs(lean).max())
print(f"The bar leans by {largest:.2f} rad at most and swings with {found:.2f} 1/s; the series says {expected:.2f}.")
