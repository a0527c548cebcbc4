"""
Crank press with its motor
==========================

An eccentric press with the drive that turns it: a DC motor, a gearbox and a speed controller, declared by
`alfmu.parts`. In each stroke the plate under the ram takes more than the motor can give, the crank slows down, and the
controller calls for all the voltage there is.
"""

import math

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

from alfmu import Experiment, Mechanism, parts, simulate
from alfmu.view.picture import animate

CRANK, ROD = 0.060, 0.320  # [m]
SPEED = 2 * math.pi * 90 / 60  # 90 strokes a minute [rad/s]
THICK, PLATE = 0.004, 8e6  # the plate [m], and the force that it takes over its depth [N/m]
RESISTANCE, INDUCTANCE, CONSTANT, RATIO = 0.25, 0.8e-3, 0.11, 18.0

# %%
# The plate yields for good: it resists on the way down, and does not push the ram up again. Three states more meter
# energies: what the supply gives, what the winding turns into heat, what the plate takes.


def crank_press() -> Mechanism:
    m = Mechanism("crank_press", "A press with its motor", experiment=Experiment(2.0, communication_step=0.002))
    turn = m.coordinate("turn", "rad", start=math.pi / 2, independent=True)
    wheel = m.body("wheel", mass=60.0, inertia=0.9)
    rod = m.bar("rod", mass=6.0, length=ROD)
    ram = m.body("ram", mass=25.0)
    axle = m.revolute("axle", m.ground.at(0, 0), wheel.at(0, 0), coordinate=turn)
    m.revolute("pin", wheel.at(CRANK, 0), rod.start, coordinate=m.coordinate("swing", "rad", start=math.pi))
    height = m.coordinate("height", "m", start=CRANK - ROD)
    guide = m.prismatic("guide", m.ground.at(0, 0), ram.at(0, 0), axis=math.pi / 2, coordinate=height)
    m.revolute("wrist", rod.end, ram.at(0, 0))
    m.gravity(0, -9.81)

    depth = ca.fmax(THICK - (height + CRANK + ROD), 0)
    force = PLATE * depth * (1 - ca.tanh(m.rate(height) / 0.005)) / 2
    m.drive(guide, force)
    m.output("plate", force, "N", "force of the plate on the ram")

    wanted = m.input("wanted", "rad/s", start=SPEED)
    voltage = parts.pi_controller(
        m, "controller", wanted=wanted, measured=m.rate(turn), gain=6.0, time=0.15, limit=24.0
    )
    data = {"resistance": RESISTANCE, "inductance": INDUCTANCE, "constant": CONSTANT, "inertia": 4e-4}
    motor = parts.dc_motor(m, "motor", axle, voltage=voltage, gearbox=parts.Gearbox(ratio=RATIO), **data)
    m.state("supplied", "J", voltage * motor.current, nominal=100.0)
    m.state("heat", "J", RESISTANCE * motor.current**2, nominal=100.0)
    m.state("pressed", "J", -force * m.rate(height), nominal=100.0)
    return m


# %%
# The crank comes up to its speed, and each stroke takes some of it away.

result = simulate(crank_press(), 3.0)
fig, panels = plt.subplots(3, 1, sharex=True, layout="constrained")
shown = {"wheel.angular_velocity": "speed [rad/s]", "motor.current": "current [A]", "plate": "plate [N]"}
for panel, (name, label) in zip(panels, shown.items(), strict=True):
    panel.plot(result.time, result[name])
    panel.set_ylabel(label)
panels[0].axhline(SPEED, color="0.7", linestyle="--")
panels[-1].set_xlabel("time [s]")

# %%
# The press at half its speed.

animate(crank_press(), result, "crank_press.gif", fps=20, speed=0.5)

# %%
# **Check.** The plate takes the same energy in each stroke, half of its stiffness times the square of its thickness,
# but for what it does not resist where the ram hardly moves. What the supply gave is in the heat of the winding, in the
# plates, in the coil, and in the motion.

stored = INDUCTANCE * result["motor.current"] ** 2 / 2
motion = result["monitor.energy"] - result["monitor.energy"][0]
spent = result["heat"] + result["pressed"] + stored + motion
unaccounted = float(np.abs(result["supplied"] - spent).max())
strokes = int(np.sum((result["plate"][1:] > 100.0) & (result["plate"][:-1] <= 100.0)))
stroke = PLATE * THICK**2 / 2
print(f"{strokes} strokes took {result['pressed'][-1]:.1f} J, by hand {strokes * stroke:.1f} J.")
print(f"Of the {result['supplied'][-1]:.0f} J that the supply gave, {unaccounted:.1e} J are not accounted for.")
