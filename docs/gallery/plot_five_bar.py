"""
Five-bar linkage with a redundant bar
=====================================

A parallelogram with a second coupler, so that one constraint is redundant. It starts where all bars are in line, where
the rank of the constraints drops once more: the first example of Blajer's paper (*Multibody System Dynamics* 8, 2002,
Figure 6), registered with alfmu as `five_bar`.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp

from alfmu import load, simulate
from alfmu.view.picture import animate

# %%
# The bars hang down, swing through the position in which all are in line, and up again.

mechanism = load("five_bar")
result = simulate(mechanism, 6.0, 0.02)
fig, (top, bottom) = plt.subplots(2, 1, sharex=True, layout="constrained")
top.plot(result.time, result["link1.angle"])
top.set_ylabel("angle of link 1 [rad]")
for name in ("C", "F"):
    bottom.plot(result.time, result[f"{name}.force.x"], label=f"joint {name}")
bottom.set(xlabel="time [s]", ylabel="force along x [N]")
bottom.legend()

# %%
# The bars swing through the line and back.

animate(mechanism, result, "five_bar.gif", fps=15, speed=1)

# %%
# **Check.** All bars weigh 1 kg and are 1 m long, so that the linkage moves as one body of one degree of freedom,
# (1/3 + 1/3 + 1 + 1/4) angle'' = -(1/2 + 1/2 + 1 + 1/2) g cos(angle), which SciPy integrates to 1e-12.

inertia, weight = 23 / 12, 2.5 * 9.81
exact = solve_ivp(
    lambda t, y: (y[1], -weight / inertia * np.cos(y[0])),
    (0.0, result.time[-1]),
    (result["link1.angle"][0], result["link1.angular_velocity"][0]),
    "DOP853",
    result.time,
    rtol=1e-12,
    atol=1e-12,
)
deviation = float(np.abs(result["link1.angle"] - exact.y[0]).max())
print(f"Through the singular positions the angle is that of one degree of freedom to {deviation:.1e} rad.")
