"""
Planetary gear with two inputs
==============================

Two motors drive one shaft: one turns the sun, the other the ring, and the arm of the planets goes out. This is how
hybrid cars and winches add speeds. Which share each has follows from the numbers of teeth.
"""

import math

import matplotlib.pyplot as plt
import numpy as np

from alfmu import Experiment, Mechanism, simulate
from alfmu.view.picture import animate

SUN, PLANET, RING = 24, 18, 60  # teeth
DISTANCE = 0.063  # of the planets' pins from the middle [m]
LOAD = 0.8  # on the arm [N.m.s/rad]
FIRM = 2.0  # torque of a motor for each rad/s that it is too slow [N.m.s/rad]

# %%
# A gear pair is one call. It takes the centres of both gears, and hinges tell on which body they turn: the pins of the
# planets are on the arm, so that the arm carries all six pairs.


def planetary_gear() -> Mechanism:
    m = Mechanism("planetary_gear", "A planetary gear with two inputs", experiment=Experiment(4.0, 0.01))
    arm_angle = m.coordinate("arm_angle", "rad", independent=True)
    sun_angle = m.coordinate("sun_angle", "rad", independent=True)
    arm = m.body("arm", mass=2.0, inertia=0.02)
    sun = m.body("sun", mass=1.0, inertia=2e-3)
    ring = m.body("ring", mass=1.5, inertia=0.03)
    output = m.revolute("output", m.ground.at(0, 0), arm.at(0, 0), coordinate=arm_angle)
    ring_angle = m.coordinate("ring_angle", "rad")
    sun_shaft = m.revolute("sun_shaft", m.ground.at(0, 0), sun.at(0, 0), coordinate=sun_angle)
    ring_shaft = m.revolute("ring_shaft", m.ground.at(0, 0), ring.at(0, 0), coordinate=ring_angle)
    for k in range(3):
        towards = 2 * math.pi * k / 3
        planet = m.body(f"planet{k + 1}", mass=0.3, inertia=1e-4)
        pin = arm.at(DISTANCE * math.cos(towards), DISTANCE * math.sin(towards))
        m.revolute(f"pin{k + 1}", pin, planet.at(0, 0), coordinate=m.coordinate(f"planet_angle{k + 1}", "rad"))
        m.gear(f"inner{k + 1}", sun.at(0, 0), planet.at(0, 0), teeth=(SUN, PLANET))
        m.gear(f"outer{k + 1}", planet.at(0, 0), ring.at(0, 0), teeth=(PLANET, RING), internal=True)
    m.friction(output, LOAD)
    m.measure(output, sun_shaft, ring_shaft)
    m.drive(sun_shaft, FIRM * (m.input("sun.speed", "rad/s", start=30.0) - m.rate(sun_angle)))
    m.drive(ring_shaft, FIRM * (m.input("ring.speed", "rad/s") - m.rate(ring_angle)))
    m.gravity(0, 0)
    return m


# %%
# The motor of the sun keeps its speed. That of the ring turns back faster and faster: the output slows down, stands,
# and goes backwards, while both motors turn.

mechanism = planetary_gear()
result = simulate(mechanism, inputs={"ring.speed": lambda t: -6.0 * t})
fig, axes = plt.subplots(layout="constrained")
for name in ("sun_shaft", "ring_shaft", "output"):
    axes.plot(result.time, result[f"{name}.angular_velocity"], label=name)
axes.set(xlabel="time [s]", ylabel="speed [rad/s]")
axes.legend()

# %%
# The spokes show how fast each gear turns.

animate(mechanism, result, "planetary_gear.gif", fps=15, speed=0.25)

# %%
# **Check.** Willis: seen from the arm, sun and ring turn against each other in the ratio of their teeth. The power of
# both motors goes into the load and into kinetic energy. Three planets share the force of the teeth equally.

sun, ring, arm = (result[f"{name}.angular_velocity"] for name in ("sun_shaft", "ring_shaft", "output"))
willis = float(np.abs(SUN * (sun - arm) + RING * (ring - arm)).max() / RING)
balance = float(np.abs(result["monitor.energy"] - result["monitor.energy"][0] - result["monitor.work"]).max())
shares = [result[f"inner{k}.force"] for k in (1, 2, 3)]
uneven = float(np.ptp(shares, axis=0).max() / np.abs(shares).max())
print(f"Speeds follow Willis's equation to {willis:.1e} rad/s.")
print(f"The balance of energy holds to {balance:.1e} J of {np.ptp(result['monitor.work']):.0f} J.")
print(f"The three planets carry the same to {uneven:.1e}.")
