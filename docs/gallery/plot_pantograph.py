"""
Pantograph
==========

Four bars that draw a figure two and a half times as large as the one that is traced: the copying machine of
draughtsmen (C. Scheiner, 1603). Fixed hinge, tracer and pen lie on a line at any time, as the small parallelogram keeps
the bars parallel.
"""

import math

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

from alfmu import Experiment, Mechanism, simulate
from alfmu.view.picture import animate

SCALE = 2.5
LONG = 0.60  # bars from the hinge to the corner, and from there to the pen [m]
SHORT = LONG / SCALE

# %%
# A hand leads the tracer round a heart with a soft spring: where it should be is an expression in time, where it is one
# in the angles of the bars. The pantograph lies on a table, so there is no gravity.


def heart(time: ca.SX) -> ca.SX:
    """Where the tracer should be [m]: a heart in eight seconds."""
    t = 2 * ca.pi * time / 8.0
    y = 13 * ca.cos(t) - 5 * ca.cos(2 * t) - 2 * ca.cos(3 * t) - ca.cos(4 * t)
    return ca.vertcat(0.26 + 0.064 * ca.sin(t) ** 3, 0.16 + 0.004 * y)


def pantograph() -> Mechanism:
    m = Mechanism(
        "pantograph", "Drawing at two and a half times the size", experiment=Experiment(8.0, communication_step=0.02)
    )
    shoulder = m.coordinate("shoulder", "rad", start=1.4567, independent=True)
    corner = m.coordinate("corner", "rad", start=-1.7024, independent=True)
    first = m.bar("first", mass=0.15, length=LONG)
    second = m.bar("second", mass=0.15, length=LONG)
    inner = m.bar("inner", mass=0.06, length=SHORT)
    outer = m.bar("outer", mass=0.09, length=LONG - SHORT)
    m.revolute("O", m.ground.at(0, 0), first.start, coordinate=shoulder)
    m.revolute("B", first.end, second.start, coordinate=corner)
    m.revolute("A", first.at(SHORT, 0), inner.start, coordinate=m.coordinate("inner_angle", start=-1.7))
    m.revolute("D", second.at(SHORT, 0), outer.start, coordinate=m.coordinate("outer_angle", start=1.7 - math.pi))
    m.revolute("P", inner.end, outer.end)

    angles = shoulder, shoulder + corner
    place = SHORT * ca.vertcat(sum(map(ca.cos, angles)), sum(map(ca.sin, angles)))
    speed = ca.jtimes(place, ca.vertcat(shoulder, corner), ca.vertcat(m.rate(shoulder), m.rate(corner)))
    hand = 2000.0 * (heart(m.time) - place) + 40.0 * (ca.jacobian(heart(m.time), m.time) - speed)
    m.force(inner.end, *ca.vertsplit(hand))
    m.watch("tracer", inner.end)
    m.watch("pen", second.end)
    m.gravity(0, 0)
    return m


# %%
# The pen resists by nothing but the inertia of the bars.

mechanism = pantograph()
result = simulate(mechanism)
fig, axes = plt.subplots(layout="constrained")
for name in ("tracer", "pen"):
    axes.plot(result[f"{name}.x"], result[f"{name}.y"], label=name)
axes.plot(0, 0, "ko", label="hinge")
axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
axes.legend()

# %%
# Tracer and pen draw their hearts, at twice the speed.

animate(mechanism, result, "pantograph.gif", fps=15, speed=2)

# %%
# **Check.** The pen is at exactly 2.5 times the place of the tracer, from the hinge.

tracer, pen = (np.column_stack([result[f"{name}.x"], result[f"{name}.y"]]) for name in ("tracer", "pen"))
deviation = float(np.abs(pen - SCALE * tracer).max())
print(f"Tracer and pen are at the scale {SCALE} to {deviation:.1e} m.")
