"""
Four-bar linkage under a torque
===============================

A parallelogram driven through the positions in which its bars are in line. A torque cannot pass through bars in line:
the accelerations have to be those of the motion all the same (Blajer, *Multibody System Dynamics* 8, 2002, Figure 8).
It is registered with alfmu as `four_bar`.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp

from alfmu import load, simulate
from alfmu.view.picture import animate

TORQUE = 4.0  # [N.m]

# %%
# An input is a number, a function of time, or a table. The start is exactly singular.

mechanism = load("four_bar")
result = simulate(mechanism, 5.0, 0.02, inputs={"A.torque": TORQUE})
fig, (top, bottom) = plt.subplots(2, 1, sharex=True, layout="constrained")
top.plot(result.time, result["link1.angle"])
top.set_ylabel("angle of link 1 [rad]")
bottom.semilogy(result.time, result["monitor.distance"])
bottom.set(xlabel="time [s]", ylabel="distance to a singular position")

# %%
# The bars swing under the torque.

animate(mechanism, result, "four_bar.gif", fps=15, speed=1)

# %%
# **Check.** The linkage has one degree of freedom, (1/3 + 1/3 + 1) angle'' = TORQUE - 2 g cos(angle).

exact = solve_ivp(
    lambda t, y: (y[1], (TORQUE - 2 * 9.81 * np.cos(y[0])) / (5 / 3)),
    (0.0, result.time[-1]),
    (result["link1.angle"][0], result["link1.angular_velocity"][0]),
    "DOP853",
    result.time,
    rtol=1e-12,
    atol=1e-12,
)
deviation = float(np.abs(result["link1.angle"] - exact.y[0]).max())
print(f"The angle is that of one degree of freedom to {deviation:.1e} rad after {result.time[-1]:g} s.")
