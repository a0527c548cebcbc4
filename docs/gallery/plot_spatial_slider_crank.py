"""
Slider-crank in space
=====================

The crank turns about the axis along which the slider moves, beside it: rod, ball and universal joint turn a rotation
into a stroke around the corner, as in hand pumps and sewing machines. Each body stands on its joint, so that four
coordinates and the three equations of the ball describe it all.
"""

import math

import matplotlib.pyplot as plt
import numpy as np

from alfmu import Experiment, Mechanism, simulate
from alfmu.view.picture import animate

RADIUS, LENGTH, HEIGHT = 0.08, 0.30, 0.12  # of the crank, of the rod, of the crank's axis above the slider's [m]

# %%
# The crank carries the ball, the slider carries the rod on a universal joint. `coordinate=` puts a body on a joint, and
# a joint without one closes the loop. A motor of 0.5 N.m drives the crank, and a spring holds the slider back.


def spatial_slider_crank() -> Mechanism:
    m = Mechanism(
        "spatial_slider_crank", "A slider-crank in space", experiment=Experiment(2.0, communication_step=0.01)
    )
    ground = m.spatial_ground
    crank = m.spatial_body("crank", mass=0.4, inertia=(2e-3, 1e-3, 1e-3), relative=True)
    slider = m.spatial_body("slider", mass=0.6, inertia=(1e-4, 2e-4, 2e-4), relative=True)
    moment = 0.5 * LENGTH**2 / 12
    rod = m.spatial_body("rod", mass=0.5, inertia=(0, moment, moment), center=(-LENGTH / 2, 0, 0), relative=True)

    turn = m.coordinate("turn", "rad", start=0.3, independent=True)
    motor = m.spatial_revolute("motor", ground.at(0, 0, HEIGHT), crank.at(), axis=(1, 0, 0), coordinate=turn)
    way = m.coordinate("way", "m", start=0.25)
    guide = m.spatial_prismatic("guide", ground.at(), slider.at(), axis=(1, 0, 0), coordinate=way)
    swing = [m.coordinate(f"swing{i}", "rad", start=x) for i, x in ((1, 0.5), (2, -0.2))]
    m.universal("pin", slider.at(), rod.at(), axis=(0, 1, 0), second_axis=(0, 0, 1), coordinates=swing)
    m.spherical("ball", crank.at(0, RADIUS, 0), rod.at(-LENGTH, 0, 0))

    m.drive(motor, m.input("motor.torque", "N.m", start=0.5))
    m.friction(motor, 0.02)
    m.spring_damper(guide, stiffness=40.0, rest=0.25)
    m.gravity(0, 0, -9.81)
    return m


# %%
# The crank gathers speed; the rod pulls the slider sideways into its guide.

mechanism = spatial_slider_crank()
result = simulate(mechanism)
fig, (top, bottom) = plt.subplots(2, 1, sharex=True, layout="constrained")
top.plot(result.time, result["slider.position"])
top.set_ylabel("position of the slider [m]")
for axis in "yz":
    bottom.plot(result.time, result[f"guide.force.{axis}"], label=axis)
bottom.set(xlabel="time [s]", ylabel="force of the guide [N]")
bottom.legend()

# %%
# The motion.

animate(mechanism, result, "spatial_slider_crank.gif", fps=15, speed=0.25)

# %%
# **Check.** The length of the rod tells the place of the slider, and the energy changes by the work of motor and
# friction alone.

angle = result["motor.angle"]
across = [RADIUS * np.cos(angle), HEIGHT + RADIUS * np.sin(angle)]
deviation = float(np.abs(result["slider.position"] - np.sqrt(LENGTH**2 - across[0] ** 2 - across[1] ** 2)).max())
stroke = float(np.ptp(result["slider.position"]))
balance = result["monitor.energy"] - result["monitor.work"]
lost = float(np.ptp(balance) / np.ptp(result["monitor.energy"]))
turns = float(angle[-1] - angle[0]) / (2 * math.pi)
print(f"In {turns:.1f} turns the slider is where the length of the rod puts it, to {deviation:.1e} m.")
print(f"Its stroke is {1e3 * stroke:.1f} mm, and {lost:.1e} of the energy is lost.")
