"""
Whitworth's quick return
========================

The drive of a slotting machine: a gear turns at a constant speed, its pin slides in the slot of an
arm that turns about another point, and the arm moves the ram. The ram cuts slowly and returns fast. The ratio of both
times depends on two lengths alone.
"""

import math

import matplotlib.pyplot as plt
import numpy as np

from alfmu import Experiment, Mechanism, simulate
from alfmu.view.picture import animate

PIN, OFFSET = 0.120, 0.050  # radius of the pin, depth of the arm's pivot below the gear's axis [m]
ARM, ROD = 0.100, 0.400  # of the arm beyond its pivot, and the rod from there to the ram [m]
SPEED = 2 * math.pi * 60 / 60  # 60 strokes a minute [rad/s]

# %%
# The pin in its slot is the joint `point_on_line`. The motor holds the speed of the gear like a stiff damper; the gear
# is heavy, so that it hardly feels the stroke.


def quick_return() -> Mechanism:
    m = Mechanism(
        "quick_return", "Whitworth's quick return", experiment=Experiment(stop_time=3.0, communication_step=0.005)
    )
    turn = m.coordinate("turn", "rad", start=0.0, rate=SPEED, independent=True)
    gear = m.body("gear", mass=40.0, inertia=0.8)
    arm = m.body("arm", mass=6.0, inertia=0.05, center=(0.05, 0.0))
    rod = m.bar("rod", mass=4.0, length=ROD)
    ram = m.body("ram", mass=25.0)

    angle = math.atan2(OFFSET, PIN)
    lean = math.asin(ARM * math.sin(angle) / ROD)
    motor = m.revolute("motor", m.ground.at(0, 0), gear.at(0, 0), coordinate=turn)
    m.revolute("pivot", m.ground.at(0, -OFFSET), arm.at(0, 0), coordinate=m.coordinate("arm_angle", start=angle))
    m.point_on_line("slot", arm.at(0, 0), gear.at(PIN, 0))
    m.revolute("crosshead", arm.at(-ARM, 0), rod.start, coordinate=m.coordinate("rod_angle", start=-angle + lean))
    guide = m.prismatic(
        "guide",
        m.ground.at(0, -OFFSET),
        ram.at(0, 0),
        coordinate=m.coordinate("stroke", "m", start=ROD * math.cos(lean) - ARM * math.cos(angle)),
    )
    m.revolute("end", rod.end, ram.at(0, 0))
    m.drive(motor, 2e4 * (SPEED - m.rate(turn)))
    m.friction(guide, 200.0)
    m.gravity(0, -9.81)
    return m


# %%
# The speed of the ram shows the slow stroke and the fast return.

mechanism = quick_return()
result = simulate(mechanism)
fig, (top, bottom) = plt.subplots(2, 1, sharex=True, layout="constrained")
top.plot(result.time, result["ram.position"])
top.set_ylabel("place of the ram [m]")
bottom.plot(result.time, result["ram.velocity"])
bottom.set(xlabel="time [s]", ylabel="speed of the ram [m/s]")

# %%
# Three strokes at half the speed.

animate(mechanism, result, "quick_return.gif", fps=15, speed=0.5)

# %%
# **Check.** The ram turns round where arm and rod are in line, with the pin at the height of the arm's pivot: half a
# turn and twice the angle asin(OFFSET / PIN) later, or earlier, than before.

speed, gear_angle = result["ram.velocity"], result["gear.angle"]
turns = np.flatnonzero(np.sign(speed[1:]) != np.sign(speed[:-1]))
share = speed[turns] / (speed[turns] - speed[turns + 1])
at = gear_angle[turns] + share * (gear_angle[turns + 1] - gear_angle[turns])
strokes = np.sort(np.diff(at)[:2])
ratio = float(strokes[1] / strokes[0])
beyond = 2 * math.asin(OFFSET / PIN)
expected = (math.pi + beyond) / (math.pi - beyond)
print(f"The slow stroke takes {ratio:.4f} times as long as the return; geometry says {expected:.4f}.")
print(f"The gear keeps its speed within {100 * np.ptp(result['gear.angular_velocity']) / SPEED:.2f} percent.")
