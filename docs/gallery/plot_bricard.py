"""
Bricard's linkage
=================

Six bars along edges of a cube, six hinges, each square to the next: by count such a loop is rigid, and yet it turns
itself inside out (R. Bricard, 1927). Toys and unfolding roofs do so. Each bar stands on the one before, so that
five angles describe it; the last hinge closes the loop with five equations, of which one is redundant.
"""

import matplotlib.pyplot as plt
import numpy as np

from alfmu import Experiment, Mechanism, simulate
from alfmu.view.picture import animate

EDGES = np.array([(1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 0, 0), (0, -1, 0)], float)  # the ground is the sixth
AXES = [(0, 1, 0), (0, 0, 1), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 0)]  # of the hinges

# %%
# Where all angles are zero, the frames of all bars are parallel, so that edges and axes are those of the cube.


def bricard() -> Mechanism:
    m = Mechanism("bricard", "Bricard's linkage of six hinges", experiment=Experiment(6.0, communication_step=0.02))
    before = m.spatial_ground.at()
    for i, (edge, axis) in enumerate(zip(EDGES, AXES, strict=False), 1):
        angle = m.coordinate(f"angle{i}", "rad", independent=i == 1, rate=2.0 * (i == 1))
        moments = tuple((1 - np.abs(edge)) / 12)  # of a thin bar of 1 kg and 1 m
        bar = m.spatial_body(f"bar{i}", mass=1.0, inertia=moments, center=tuple(edge / 2), relative=True)
        m.spatial_revolute(f"H{i}", before, bar.at(), axis=axis, coordinate=angle)
        before = bar.at(*edge)
    m.spatial_revolute("H6", m.spatial_ground.at(0, 0, 1), before, axis=AXES[5])
    m.gravity(0, 0, -9.81)
    return m


# %%
# It swings under gravity.

mechanism = bricard()
result = simulate(mechanism)
fig, axes = plt.subplots(layout="constrained")
for i in (1, 2):
    axes.plot(result.time, result[f"H{i}.angle"], label=f"hinge {i}")
axes.set(xlabel="time [s]", ylabel="angle [rad]")
axes.legend()

# %%
# The motion.

animate(mechanism, result, "bricard.gif", fps=15, speed=1)

# %%
# **Check.** Hinges of one parity turn alike, and those of the other follow by a closed form: with a and b the angles
# from the cube, sin b = sin a (1 - sin b).

a, b = result["H1.angle"], result["H2.angle"]
deviation = float(np.abs(np.sin(b) - np.sin(a) * (1 - np.sin(b))).max())
alike = float(max(np.abs(a + result["H3.angle"]).max(), np.abs(a + result["H5.angle"]).max()))
lost = float(np.ptp(result["monitor.energy"]))
print(f"The closed form holds to {deviation:.1e}, and hinges of one parity turn alike to {alike:.1e} rad.")
print(f"The energy changes by {lost:.1e} J, where lifting one bar to its length takes 9.8 J.")
