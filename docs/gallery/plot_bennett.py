"""
Bennett's linkage
=================

Four bars and four hinges in space whose axes are skew: by count, such a loop has minus two degrees of freedom, and
yet it moves (G. T. Bennett, 1903). Three constraints are redundant at every position. It is registered with
alfmu as `bennett`.
"""

import math

import matplotlib.pyplot as plt
import numpy as np

from alfmu import load, simulate
from alfmu.view.picture import animate

# %%
# Links of 0.3 m with a twist of 0.7 rad, and links with a twist of 1.2 rad whose length the condition of Bennett gives.

mechanism = load("bennett")
result = simulate(mechanism, 4.0, 0.02)
fig, axes = plt.subplots(layout="constrained")
for i in (1, 2, 3, 4):
    axes.plot(result.time, result[f"hinge{i}.angle"], label=f"hinge {i}")
axes.set(xlabel="time [s]", ylabel="angle [rad]")
axes.legend()

# %%
# The linkage in motion.

animate(mechanism, result, "bennett.gif", fps=15, speed=1)

# %%
# **Check.** The tangents of half the angles of neighbouring hinges have a constant product, and opposite hinges turn
# alike.

product = math.sin((1.2 + 0.7) / 2) / math.sin((1.2 - 0.7) / 2)
one, two = (result[f"hinge{i}.angle"] / 2 for i in (1, 2))
deviation = float(np.abs(np.sin(one) * np.sin(two) - product * np.cos(one) * np.cos(two)).max())
opposite = float(np.abs(result["hinge1.angle"] + result["hinge3.angle"]).max())
energy = result["monitor.energy"]
print(f"The product of the tangents is {product:.4f} to {deviation:.1e}; opposite hinges agree to {opposite:.1e} rad.")
print(f"The energy changes by {np.ptp(energy) / np.abs(energy).max():.1e} of itself.")
