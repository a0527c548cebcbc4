"""
Gyroscope
=========

A rotor in two gimbals, its centre of mass 50 mm above theirs: at rest it would fall over, but it spins at 3000 turns a
minute, and goes round instead (J. B. L. Foucault gave it its name in 1852). What turns slowly about the vertical nods
at the same time, as its two constant momenta ask.
"""

import math

import matplotlib.pyplot as plt
import numpy as np

from alfmu import Experiment, Mechanism, simulate
from alfmu.view.picture import animate

G, MASS, ABOVE = 9.81, 0.8, 0.05  # gravity [m/s2], of the rotor [kg], its centre of mass above that of the gimbals [m]
ROTOR = (4e-4, 4e-4, 7e-4)  # moments of inertia [kg.m2], the last about its axis
GIMBAL = (1e-4, 2e-4, 1e-4)
SPIN, TILT = 3000 * 2 * math.pi / 60, 0.6  # [rad/s], [rad]

# %%
# Each body stands on the one before by a hinge, so that three angles are all its coordinates. No constraint is left.


def gyroscope() -> Mechanism:
    m = Mechanism("gyroscope", "A rotor in gimbals", experiment=Experiment(1.5, communication_step=0.005))
    outer = m.spatial_body("outer", mass=0.1, inertia=GIMBAL, relative=True)
    inner = m.spatial_body("inner", mass=0.1, inertia=GIMBAL, relative=True)
    rotor = m.spatial_body("rotor", mass=MASS, inertia=ROTOR, center=(0, 0, ABOVE), relative=True)
    turn = m.coordinate("turn", "rad", independent=True)
    tilt = m.coordinate("tilt", "rad", start=TILT, independent=True)
    spin = m.coordinate("spin", "rad", rate=SPIN, independent=True)
    foot, side = (0, 0, -0.08), (0.06, 0, 0)
    m.spatial_revolute("turning", m.spatial_ground.at(*foot), outer.at(*foot), axis=(0, 0, 1), coordinate=turn)
    m.spatial_revolute("tilting", outer.at(*side), inner.at(*side), axis=(1, 0, 0), coordinate=tilt)
    m.spatial_revolute("spinning", inner.at(0, 0, -0.03), rotor.at(0, 0, -0.03), axis=(0, 0, 1), coordinate=spin)
    m.watch("tip", rotor.at(0, 0, 0.12))
    m.gravity(0, 0, -G)
    return m


# %%
# The tip of its axis draws cusps: it starts without turning, falls a little, and is carried round.

mechanism = gyroscope()
result = simulate(mechanism)
fig, (left, right) = plt.subplots(1, 2, layout="constrained")
left.plot(result.time, np.degrees(result["tilting.angle"]))
left.set(xlabel="time [s]", ylabel="tilt of the axis [degrees]")
right.plot(result["tip.x"], result["tip.y"])
right.set(xlabel="tip, x [m]", ylabel="tip, y [m]", aspect="equal")

# %%
# The motion, at a tenth of its speed.

animate(mechanism, result, "gyroscope.gif", fps=15, speed=0.1)

# %%
# **Check.** The momentum about the vertical and that of the spin stay what they were. On the average it goes round at
# m g h/(C w), as a fast top does.

tilt, turning, spinning = (result[f"{joint}.angular_velocity"] for joint in ("tilting", "turning", "spinning"))
lean = result["tilting.angle"]
own = ROTOR[2] * (spinning + turning * np.cos(lean))
yaw = GIMBAL[2] + (GIMBAL[1] + ROTOR[1] + MASS * ABOVE**2) * np.sin(lean) ** 2 + GIMBAL[2] * np.cos(lean) ** 2
vertical = yaw * turning + own * np.cos(lean)
lost = float(max(np.ptp(own), np.ptp(vertical)) / own[0])
usual = float(result["turning.angle"][-1] / result.time[-1])
expected = MASS * G * ABOVE / (ROTOR[2] * SPIN)
print(f"Both momenta are constant to {lost:.1e} of themselves.")
print(f"It goes round at {usual:.2f} rad/s on the average; a fast top does at {expected:.2f} rad/s.")
