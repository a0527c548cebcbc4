"""
Toggle press
============

A knuckle-joint press for coining: a crank pushes the knee of two links towards the straight line, and the ram comes
down with a force that grows without bound as they align. The plate between ram and table yields like a spring of
4e8 N/m over the last 2 mm.
"""

import math

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

from alfmu import Experiment, Mechanism, simulate
from alfmu.view.picture import animate

CRANK, ROD, LINK = 0.080, 0.500, 0.250  # [m]
AXLE = complex(-0.586, -LINK)  # of the crank, from the upper end of the toggle [m]: the knee stops 6 mm before straight
SPEED = 2 * math.pi * 40 / 60  # 40 strokes a minute [rad/s]


def meet(p: complex, r: float, q: complex, s: float) -> complex:
    """The point at distance r from p and s from q, to the left of the way from p to q."""
    apart = abs(q - p)
    along = (r**2 - s**2 + apart**2) / (2 * apart)
    return p + (q - p) / apart * complex(along, math.sqrt(r**2 - along**2))


def knee_and_ram(angle: float) -> tuple[complex, float]:
    """Place of the knee, and height of the ram, for an angle of the crank."""
    pin = AXLE + CRANK * complex(math.cos(angle), math.sin(angle))
    knee = meet(0, LINK, pin, ROD)
    return knee, knee.imag - math.sqrt(LINK**2 - knee.real**2)


BOTTOM = min(knee_and_ram(angle)[1] for angle in np.linspace(-0.1, 0.1, 2001))
PLATE = BOTTOM + 0.002  # height of the plate's upper face [m]

# %%
# A flywheel stores what the stroke takes; the motor only keeps its speed. Its inertia is given as the crank feels it,
# through a gear.


def toggle_press() -> Mechanism:
    m = Mechanism(
        "toggle_press", "A coining press with a knuckle joint", experiment=Experiment(3.0, communication_step=0.002)
    )
    turn = m.coordinate("turn", "rad", start=math.pi / 2, rate=SPEED, independent=True)
    knee, ram_height = knee_and_ram(math.pi / 2)
    pin = AXLE + CRANK * 1j
    angles = [float(np.angle(z)) for z in (knee - pin, knee, 1j * ram_height - knee)]

    flywheel = m.body("flywheel", mass=120.0, inertia=400.0)
    rod = m.bar("rod", mass=20.0, length=ROD)
    upper = m.bar("upper", mass=25.0, length=LINK)
    lower = m.bar("lower", mass=25.0, length=LINK)
    ram = m.body("ram", mass=80.0)
    axle = m.ground.at(AXLE.real, AXLE.imag)
    motor = m.revolute("motor", axle, flywheel.at(0, 0), coordinate=turn)
    rod_angle = m.coordinate("rod_angle", "rad", start=angles[0] - math.pi / 2)
    m.revolute("pin", flywheel.at(CRANK, 0), rod.start, coordinate=rod_angle)
    m.revolute("top", m.ground.at(0, 0), upper.start, coordinate=m.coordinate("upper_angle", "rad", start=angles[1]))
    bend = m.coordinate("bend", "rad", start=angles[2] - angles[1])
    m.revolute("knee", upper.end, lower.start, coordinate=bend)
    m.revolute("knee2", rod.end, upper.end)
    height = m.coordinate("height", "m", start=ram_height)
    m.prismatic("guide", m.ground.at(0, 0), ram.at(0, 0), axis=math.pi / 2, coordinate=height)
    m.revolute("foot", lower.end, ram.at(0, 0))

    press = 4e8 * ca.fmax(PLATE - height, 0)
    m.force(ram.at(0, 0), 0.0, press)
    m.output("press", press, "N", "force on the plate")
    m.drive(motor, 400.0 * (SPEED - m.rate(turn)))
    m.gravity(0, -9.81)
    return m


# %%
# The flywheel loses an eighth of its speed in each stroke, and gets it back from the plate, which is elastic here.

mechanism = toggle_press()
result = simulate(mechanism)
fig, (top, bottom) = plt.subplots(2, 1, sharex=True, layout="constrained")
top.plot(result.time, result["press"] / 1e3)
top.set_ylabel("force on the plate [kN]")
bottom.plot(result.time, result["flywheel.angular_velocity"])
bottom.set(xlabel="time [s]", ylabel="speed of the flywheel [rad/s]")

# %%
# Two strokes; near the bottom the ram hardly moves, which is where it presses.

animate(mechanism, result, "toggle_press.gif", fps=15, speed=1)

# %%
# **Check.** The ram has the height that the circles about both ends of rod and links say.

expected = np.array([knee_and_ram(angle)[1] for angle in result["flywheel.angle"]])
deviation = float(np.abs(result["ram.y"] - expected).max())
peak = int(result["press"].argmax())
print(f"The ram is where geometry says to {deviation:.1e} m.")
deep = 1e3 * (PLATE - result["ram.y"][peak])
print(f"The greatest force is {result['press'][peak] / 1e3:.0f} kN, {deep:.2f} mm deep.")
