"""
Flyball governor
================

Watt's governor in space: two rods with balls on a shaft, which lift a slider by stiff spring-dampers as the shaft turns
faster. It is a benchmark of the IFToMM library (A05), registered with alfmu as `flyball_governor`. Its springs call for
an implicit integrator, which alfmu finds by itself.
"""

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

from alfmu import load, simulate
from alfmu.model.spatial import rotation
from alfmu.view.picture import animate

# %%
# The shaft begins with a turn a second. A torque speeds it up, and the balls rise.

TORQUE = 15.0  # [N.m]
mechanism = load("flyball_governor")
result = simulate(mechanism, 2.0, 0.02, inputs={"bearing.torque": TORQUE})
fig, (top, bottom) = plt.subplots(2, 1, sharex=True, layout="constrained")
top.plot(result.time, result["slider.z"])
top.set_ylabel("height of the slider [m]")
bottom.plot(result.time, result["bearing.angular_velocity"])
bottom.set(xlabel="time [s]", ylabel="speed of the shaft [rad/s]")

# %%
# The governor, seen from the side.

animate(mechanism, result, "governor.gif", fps=15, speed=1)

# %%
# **Check.** The angular momentum about the vertical grows by torque times time. It is that of the centres of mass and
# that of the turning bodies.

symbols = ca.vertcat(*(each.symbol for each in mechanism.parameters))
defaults = [each.default for each in mechanism.parameters]
momentum = np.zeros(len(result.time))
for body in mechanism.spatial_bodies:
    mass, *inertia = ca.evalf(ca.substitute(ca.vertcat(body.mass, *body.inertia), symbols, defaults)).full().ravel()
    x, y, vx, vy = (result[f"{body.name}.{each}"] for each in ("x", "y", "vx", "vy"))
    spin = np.column_stack([result[f"{body.name}.angular_velocity.{axis}"] for axis in "xyz"])
    attitude = np.column_stack([result[f"{body.name}.e{i}"] for i in range(4)])
    turns = np.array([ca.evalf(rotation(ca.SX(e))).full() for e in attitude])
    momentum += mass * (x * vy - y * vx) + np.einsum("tj,j,tkj,tk->t", turns[:, 2], inertia, turns, spin)
deviation = float(np.abs(momentum - momentum[0] - TORQUE * result.time).max())
grown = momentum[-1] - momentum[0]
print(f"The angular momentum grows by {grown:.3f} kg m2/s, which is torque times time to {deviation:.1e}.")
