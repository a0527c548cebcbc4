"""
Peaucellier's inversor
======================

The first linkage that drew an exact straight line (C.-N. Peaucellier, 1864): seven bars and no guide. Two long arms and
a rhombus mirror a point at a circle; the crank moves that point on a circle through the fixed hinge, so that its image
runs along a line.
"""

import cmath
import math

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

from alfmu import Experiment, Mechanism, simulate
from alfmu.view.picture import animate

CRANK, ARM, SIDE = 0.15, 0.50, 0.25  # [m]
START = 0.6  # angle of the crank at the start [rad]

# %%
# The hinge O is the origin; the crank turns about a point at its own length from there. All bars are steel strips of
# 20 mm by 5 mm, 0.8 kg per metre. The drawing point carries 2 kg, and the whole hangs upright in gravity: let go, it
# swings up and down its line.


def peaucellier() -> Mechanism:
    m = Mechanism(
        "peaucellier", "Peaucellier's exact straight line", experiment=Experiment(5.0, communication_step=0.01)
    )
    start = m.start("angle", START, "rad")
    O, centre = m.point(0, 0), m.ground.at(CRANK, 0)

    # Guesses: B on the circle, D on the same line through O, the corners A and C beside the middle of both.
    reach = 2 * CRANK * math.cos(START / 2)
    middle = (reach + (ARM**2 - SIDE**2) / reach) / 2
    beside = math.sqrt(ARM**2 - middle**2)
    guesses = {"A": complex(middle, beside), "B": reach, "C": complex(middle, -beside), "D": 2 * middle - reach}
    q = {}
    for name, guess in guesses.items():
        z = guess * cmath.exp(0.5j * START)
        q[name] = m.coordinate(f"{name}_x", "m", start=z.real), m.coordinate(f"{name}_y", "m", start=z.imag)
    A, B, C, D = (m.point(x, y) for x, y in q.values())
    crank = m.bar("crank", mass=0.8 * CRANK, length=CRANK, between=(centre, B))
    bars = {"OA": (O, A, ARM), "OC": (O, C, ARM)}
    bars |= {"AB": (A, B, SIDE), "BC": (B, C, SIDE), "CD": (C, D, SIDE), "DA": (D, A, SIDE)}
    for name, (first, second, length) in bars.items():
        m.bar(name, mass=0.8 * length, length=length, between=(first, second))
    weight = m.body("weight", mass=2.0, pose=(*q["D"], 0.0))
    m.tie(start, ca.atan2(q["B"][1], q["B"][0] - CRANK))
    m.watch("B", crank.end)
    m.watch("D", weight.at(0, 0))
    m.gravity(0, -9.81)
    m.spring_damper((m.ground.at((ARM**2 - SIDE**2) / (2 * CRANK), 0.6), weight.at(0, 0)), stiffness=100.0, rest=0.3)
    return m


# %%
# A spring from above carries the weight, so that it swings about a height near that of the hinge.

mechanism = peaucellier()
result = simulate(mechanism)
fig, axes = plt.subplots(layout="constrained")
axes.plot(result["D.x"], result["D.y"], label="D, the drawing point")
axes.plot(result["B.x"], result["B.y"], label="B, on the crank")
axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
axes.legend()

# %%
# D keeps to its line while B goes round its circle.

animate(mechanism, result, "peaucellier.gif", fps=15, speed=1)

# %%
# **Check.** Inversion at a circle of power ARM^2 - SIDE^2 turns the crank's circle, of diameter 2 CRANK, into the line
# x = (ARM^2 - SIDE^2) / (2 CRANK).

line = (ARM**2 - SIDE**2) / (2 * CRANK)
deviation = float(np.abs(result["D.x"] - line).max())
energy = result["monitor.energy"]
print(f"D moves {np.ptp(result['D.y']):.3f} m and leaves the line x = {line:.4f} m by at most {deviation:.1e} m.")
print(f"It moves at up to {np.abs(result['D.vy']).max():.2f} m/s; the energy changes by {np.ptp(energy):.1e} J.")
