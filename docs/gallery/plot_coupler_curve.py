"""
A four-bar for a given path
===========================

A point of the coupler is to follow a path that was recorded on another machine, whose lengths nobody knows. The lengths
of the four-bar are found by least squares with exact derivatives of the run: each step of the search is one run.
"""

import math

import matplotlib.pyplot as plt
import numpy as np

from alfmu import Experiment, Mechanism, Result, fit, simulate
from alfmu.view.picture import animate

BASE = 1.0  # between the pivots of crank and rocker [m]
FIRST = {"l1": 0.35, "l2": 1.00, "l3": 0.90, "px": 0.45, "py": 0.35}  # guess of a designer [m]
WANTED = {"l1": 0.30, "l2": 1.10, "l3": 0.80, "px": 0.60, "py": 0.25}  # of the other machine [m]

# %%
# The crank turns evenly, once a second. Two lengths say where on the coupler the point is.


def coupler_curve() -> Mechanism:
    m = Mechanism(
        "coupler_curve",
        "A four-bar whose coupler carries a point",
        experiment=Experiment(stop_time=1.0, communication_step=0.01),
    )
    l1, l2, l3, px, py = (m.parameter(name, value, "m", minimum=0.05) for name, value in FIRST.items())
    turn = m.coordinate("turn", "rad", start=0.0, independent=True)
    swing = m.coordinate("swing", "rad", start=1.6)
    x, y = (m.coordinate(name, "m", start=guess) for name, guess in (("x", 0.8), ("y", 0.4)))
    crank = m.bar("crank", mass=1.0, length=l1)
    rocker = m.bar("rocker", mass=1.0, length=l3)
    rod = m.bar("rod", mass=2.0, length=l2, pose=(x, y, m.coordinate("tilt", "rad", start=0.8)))

    motor = m.revolute("A", m.ground.at(0, 0), crank.start, coordinate=turn)
    m.revolute("B", crank.end, rod.start)
    m.revolute("C", rod.end, rocker.end)
    m.revolute("D", m.ground.at(BASE, 0), rocker.start, coordinate=swing)
    m.motion(motor, 2 * math.pi * m.time)
    m.watch("P", rod.at(px, py))
    m.gravity(0, 0)
    return m


# %%
# The path of the other machine is known at a hundred instants of a turn.

mechanism = coupler_curve()
other = simulate(mechanism, parameters=WANTED)
path = Result("path", other.time, ("P.x", "P.y"), {"P.x": "m", "P.y": "m"}, other["P.*"][:, :2])
first = simulate(mechanism)
found = fit(mechanism, path, list(FIRST), bounds={"l1": (0.1, 0.6)})
print(found)
print(f"{found.runs} runs")

fig, axes = plt.subplots(layout="constrained")
axes.plot(first["P.x"], first["P.y"], ":", label="first guess")
axes.plot(path["P.x"], path["P.y"], "o", markersize=4, label="wanted")
axes.plot(found.result["P.x"], found.result["P.y"], label="found")
axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
axes.legend()

# %%
# The search ends where the lengths are those of the other machine. Two points of a path tell little; a hundred, each at
# its instant, tell five lengths.

lengths_apart = max(abs(found[name] - value) for name, value in WANTED.items())
path_apart = max(float(np.abs(left).max()) for left in found.residuals.values())
first_apart = float(np.hypot(first["P.x"] - path["P.x"], first["P.y"] - path["P.y"]).max())
print(f"the first guess was {first_apart:.2f} m off; lengths are found to {lengths_apart:.1e} m")

result = simulate(mechanism, parameters=dict(found.values))
animate(mechanism, result, "coupler_curve.gif", fps=15, speed=0.3)
