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

# %%
# The shaft turns freely at first with a turn a second. Gravity pulls the balls down and the slider with them.

mechanism = load("flyball_governor")
result = simulate(mechanism, 2.0, 0.01)
fig, (top, bottom) = plt.subplots(2, 1, sharex=True, layout="constrained")
top.plot(result.time, result["slider.z"])
top.set_ylabel("height of the slider [m]")
bottom.plot(result.time, result["bearing.angular_velocity"])
bottom.set(xlabel="time [s]", ylabel="speed of the shaft [rad/s]")

# %%
# **Check.** No torque acts about the vertical, so that the angular momentum about it stays what it was: that of the
# centres of mass, and that of the turning bodies. The dampers take energy, and nothing gives any.

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
change = float(np.ptp(momentum) / momentum[0])
lost = -np.diff(result["monitor.energy"])
print(f"The angular momentum, {momentum[0]:.3f} kg m2/s, changes by {change:.1e} of itself.")
print(f"The dampers take {lost.sum():.3f} J; in no step does the energy grow by more than {max(-lost.min(), 0):.1e} J.")
