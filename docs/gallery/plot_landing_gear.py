"""
Landing gear
============

The main gear of a light twin retracts inwards. A folding brace holds the leg while it is straight: a load on the wheel
goes through it like through one bar, and the actuator, which turns the upper half of the brace, hardly feels it. To
retract, the actuator folds the brace upwards.
"""

import math

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

from alfmu import Experiment, Mechanism, simulate
from alfmu.view.picture import animate

LEG, ATTACHED = 1.30, 0.60  # from the trunnion to the wheel, and to the brace [m]
UPPER, LOWER = 0.50, 0.45  # halves of the brace [m]
SIDE = math.sqrt((UPPER + LOWER) ** 2 - ATTACHED**2)  # from the trunnion to the hinge of the brace, level with it [m]
STRAIGHT = math.atan2(-ATTACHED, -SIDE) + 2 * math.pi  # direction of the straight brace [rad]

# %%
# With the leg up, the brace and the way from its hinge to the leg form a triangle: how far the brace folds follows.

UP = SIDE - ATTACHED
FOLDED = math.pi - math.acos((UPPER**2 + UP**2 - LOWER**2) / (2 * UPPER * UP))
GUST, LIFT_OFF, RETRACTED = 8e3, 1.0, 6.0  # side load [N] before lift-off [s]; retraction until then [s]


def landing_gear() -> Mechanism:
    m = Mechanism(
        "landing_gear", "A main gear with a folding brace", experiment=Experiment(7.0, communication_step=0.02)
    )
    swing = m.coordinate("swing", "rad", start=-math.pi / 2)
    fold = m.coordinate("fold", "rad", start=STRAIGHT, independent=True)
    knee = m.coordinate("knee", "rad", start=0.0)
    leg = m.body("leg", mass=35.0, inertia=4.0, center=(0.9, 0.0))
    upper = m.bar("upper", mass=4.0, length=UPPER)
    lower = m.bar("lower", mass=3.5, length=LOWER)
    m.revolute("trunnion", m.ground.at(0, 0), leg.at(0, 0), coordinate=swing)
    hinge = m.revolute("hinge", m.ground.at(SIDE, 0), upper.start, coordinate=fold)
    m.revolute("joint", upper.end, lower.start, coordinate=knee)
    m.revolute("lug", lower.end, leg.at(ATTACHED, 0))

    part = ca.fmin(ca.fmax(m.time - LIFT_OFF, 0) / (RETRACTED - LIFT_OFF), 1)
    goal = STRAIGHT + (FOLDED - STRAIGHT) * (part - ca.sin(2 * ca.pi * part) / (2 * ca.pi))
    torque = 8e4 * (goal - fold) + 4e3 * (ca.jacobian(goal, m.time) - m.rate(fold))
    m.drive(hinge, torque)
    m.output("actuator", torque, "N.m", "torque of the actuator")
    m.force(leg.at(LEG, 0), m.input("wheel.side_load", "N", description="force on the wheel, inwards"), 0.0)
    m.watch("wheel", leg.at(LEG, 0))
    m.gravity(0, -9.81)
    return m


# %%
# On the ground the wheel carries a side load of 8 kN inwards, which presses on the brace. It ends with lift-off.

mechanism = landing_gear()
result = simulate(mechanism, inputs={"wheel.side_load": lambda t: GUST if t < LIFT_OFF else 0.0})
fig, (top, bottom) = plt.subplots(2, 1, sharex=True, layout="constrained")
top.plot(result.time, 90 + np.degrees(result["leg.angle"]))
top.set_ylabel("leg from vertical [degrees]")
bottom.plot(result.time, result["actuator"])
bottom.set(xlabel="time [s]", ylabel="torque of the actuator [N m]")

# %%
# The brace folds, and the leg swings up.

animate(mechanism, result, "landing_gear.gif", fps=15, speed=1)

# %%
# **Check.** Before lift-off the brace carries the side load alone: force times lever arm. At the end the leg is level.

held = int(np.searchsorted(result.time, LIFT_OFF)) - 1
brace = math.hypot(result["lug.force.x"][held], result["lug.force.y"][held])
lever = ATTACHED * SIDE / (UPPER + LOWER)
expected = GUST * LEG / lever
up = float(np.degrees(result["leg.angle"][-1]))
print(f"The brace carries {brace / 1e3:.2f} kN; the lever arm of the load says {expected / 1e3:.2f} kN.")
print(f"The actuator holds against {GUST * LEG:.0f} N m of the load with {abs(result['actuator'][held]):.0f} N m.")
print(f"Retracted, the leg is {up:.3f} degrees from level.")
