"""
Excavator
=========

The arm of a 20 t excavator: boom, stick and bucket, moved by three hydraulic cylinders, the bucket through a rocker and
a link. Eleven bodies, four closed loops, three degrees of freedom. Lengths and masses are those of data sheets of this
class, rounded.
"""

import math

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

from alfmu import Body, Experiment, Mechanism, simulate
from alfmu.view.picture import animate

BOOM, STICK = 5.7, 2.9  # between hinges [m]
HOUSE_EYE, BOOM_EYE = complex(0.60, -0.45), complex(2.50, 0.55)  # of the boom's cylinder, from the boom's foot [m]
LIFT, REACH, CURL, SWING = 0.75, -1.3, -0.6, 1.3  # angles of boom, stick, bucket and rocker at the start [rad]
CYCLE = 6.0  # [s]


def turned(angle: float) -> complex:
    return complex(math.cos(angle), math.sin(angle))


# %%
# A cylinder is a barrel with a rod that slides in it, between two eyes whose places at the start are known. Its length
# is led along a smooth wave: oil and pump are a spring of 5e7 N/m with a damper.


def excavator() -> Mechanism:
    m = Mechanism(
        "excavator", "Boom, stick and bucket of an excavator", experiment=Experiment(CYCLE, communication_step=0.02)
    )
    lift, reach, curl, swing, push = (
        m.coordinate(name, "rad", start=start)
        for name, start in (("lift", LIFT), ("reach", REACH), ("curl", CURL), ("swing", SWING), ("push", -1.75))
    )
    boom = m.body("boom", mass=1600.0, inertia=4200.0, center=(2.6, 0.4))
    stick = m.body("stick", mass=750.0, inertia=700.0, center=(1.0, 0.15))
    bucket = m.body("bucket", mass=800.0, inertia=250.0, center=(0.55, -0.2))
    rocker = m.bar("rocker", mass=60.0, length=0.65)
    link = m.bar("link", mass=70.0, length=0.60)
    m.revolute("foot", m.ground.at(0, 0), boom.at(0, 0), coordinate=lift)
    m.revolute("elbow", boom.at(BOOM, 0), stick.at(0, 0), coordinate=reach)
    m.revolute("wrist", stick.at(STICK, 0), bucket.at(0, 0), coordinate=curl)
    m.revolute("rocker_hinge", stick.at(STICK - 0.45, 0.0), rocker.start, coordinate=swing)
    m.revolute("rocker_end", rocker.end, link.start, coordinate=push)
    m.revolute("ear", link.end, bucket.at(0.0, 0.45))
    m.watch("tip", bucket.at(1.35, 0))

    # Origin and angle of each body at the start.
    elbow = BOOM * turned(LIFT)
    hinge = elbow + (STICK - 0.45) * turned(LIFT + REACH)
    at = {m.ground: (0j, 0.0), boom: (0j, LIFT), stick: (elbow, LIFT + REACH), rocker: (hinge, LIFT + REACH + SWING)}

    def cylinder(
        name: str, first: Body, eye1: complex, second: Body, eye2: complex, mass: float, travel: float
    ) -> None:
        """A cylinder from an eye on one body to an eye on another, whose length changes by `travel` [m] and back."""
        places = [at[body][0] + eye * turned(at[body][1]) for body, eye in ((first, eye1), (second, eye2))]
        length, angle = abs(places[1] - places[0]), float(np.angle(places[1] - places[0])) - at[first][1]
        barrel = m.bar(f"{name}_barrel", mass=0.6 * mass, length=0.62 * length)
        rod = m.bar(f"{name}_rod", mass=0.4 * mass, length=0.62 * length)
        turn = m.coordinate(f"{name}_turn", "rad", start=angle)
        stroke = m.coordinate(f"{name}_length", "m", start=length, independent=True)
        m.revolute(f"{name}_eye1", first.at(eye1.real, eye1.imag), barrel.start, coordinate=turn)
        slide = m.prismatic(f"{name}_cylinder", barrel.start, rod.end, coordinate=stroke)
        m.revolute(f"{name}_eye2", second.at(eye2.real, eye2.imag), rod.end)
        goal = length + travel * (1 - ca.cos(2 * ca.pi * m.time / CYCLE)) / 2
        force = 5e7 * (goal - stroke) + 3e6 * (ca.jacobian(goal, m.time) - m.rate(stroke))
        m.drive(slide, force)
        m.output(f"{name}_force", force, "N", f"force with which the cylinder of the {name} pushes")

    cylinder("boom", m.ground, HOUSE_EYE, boom, BOOM_EYE, 200.0, -0.35)
    cylinder("stick", boom, complex(3.0, 0.9), stick, complex(-0.75, 0.2), 180.0, 0.6)
    cylinder("bucket", stick, complex(0.3, 0.55), rocker, complex(0.65, 0.0), 120.0, 0.35)
    m.gravity(0, -9.81)
    return m


# %%
# The boom sinks, the stick comes in, the bucket curls, and back. At the start the arm settles on its oil.

mechanism = excavator()
result = simulate(mechanism)
fig, axes = plt.subplots(layout="constrained")
for name in ("boom", "stick", "bucket"):
    axes.plot(result.time, result[f"{name}_force"] / 1e3, label=name)
axes.set(xlabel="time [s]", ylabel="force of the cylinder [kN]")
axes.legend()

# %%
# One cycle of the bucket.

animate(mechanism, result, "excavator.gif", fps=15, speed=1)

# %%
# **Check.** The cylinder of the boom and its two eyes form a triangle with the foot, so that its length gives the
# angle of the boom. And what the cylinders do in work is in the energy at any time.

house, eye, length = abs(HOUSE_EYE), abs(BOOM_EYE), result["boom_rod.position"]
between = np.arccos((house**2 + eye**2 - length**2) / (2 * house * eye))
expected = between + np.angle(HOUSE_EYE) - np.angle(BOOM_EYE)
deviation = float(np.abs(result["boom.angle"] - expected).max())
energy, work = result["monitor.energy"], result["monitor.work"]
lost = float(np.abs(energy - energy[0] - work + work[0]).max())
print(f"The angle of the boom is that of the triangle to {deviation:.1e} rad.")
print(f"Energy and work agree to {lost:.1e} J, of {np.ptp(energy) / 1e3:.0f} kJ that are moved.")
