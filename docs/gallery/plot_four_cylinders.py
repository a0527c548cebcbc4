"""
Engine with four cylinders
==========================

An in-line engine of 1.6 litres: a crankshaft with four throws, rods, pistons, and the pressure of an ideal four-stroke
cycle in each cylinder, in the firing order 1-3-4-2. The load takes what the gas gives on average.
"""

import math

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

from alfmu import Experiment, Mechanism, simulate
from alfmu.view.picture import animate

BORE, STROKE, ROD = 0.0765, 0.0869, 0.138  # [m], as in many engines of this size
CRANK, AREA = STROKE / 2, math.pi * BORE**2 / 4
COMPRESSION, EXPONENT, AMBIENT, RISE = 10.5, 1.3, 1e5, 3.0  # ratio, polytropic exponent, pressure [Pa], burnt / unburnt
CLEARANCE = STROKE / (COMPRESSION - 1)  # [m]
THROWS = (0.0, math.pi, math.pi, 0.0)  # of the crankshaft [rad]
FIRING = (0.0, math.pi, 3 * math.pi, 2 * math.pi)  # angles of the crankshaft at which cylinders 1 to 4 fire [rad]
SPEED = 2 * math.pi * 2400 / 60  # [rad/s]

# %%
# Compression takes p V^n = AMBIENT V_0^n, the gas burns at the top and expands at RISE times that pressure; intake and
# exhaust are at ambient pressure. The work of a cycle follows in closed form.

DISPLACED = AREA * STROKE
TOP = AMBIENT * COMPRESSION**EXPONENT  # pressure at the end of the compression [Pa]
WORK = (RISE - 1) * TOP * AREA * CLEARANCE * (1 - COMPRESSION ** (1 - EXPONENT)) / (EXPONENT - 1)  # of one cycle [J]
TORQUE = 4 * WORK / (4 * math.pi)


def overpressure(since_firing: ca.SX, depth: ca.SX) -> ca.SX:
    """Pressure over ambient [Pa], by the angle since the last firing (0 to 4 pi) and the piston's depth below top."""
    compressed = AMBIENT * ((CLEARANCE + STROKE) / (CLEARANCE + depth)) ** EXPONENT
    burning, squeezing = since_firing < math.pi, since_firing > 3 * math.pi
    return ca.if_else(burning, RISE * compressed - AMBIENT, ca.if_else(squeezing, compressed - AMBIENT, 0))


START = 0.3  # angle of the crankshaft [rad]


def top_of(angle: float) -> float:
    """Height of a piston pin over the crankshaft [m], for the angle of its throw from the top [rad]."""
    return CRANK * math.cos(angle) + math.sqrt(ROD**2 - (CRANK * math.sin(angle)) ** 2)


def engine() -> Mechanism:
    m = Mechanism("engine", "Four cylinders in line", experiment=Experiment(0.1, step_size=2e-4))
    turn = m.coordinate("turn", "rad", start=START, rate=SPEED, independent=True)
    shaft = m.body("crankshaft", mass=12.0, inertia=0.15)
    main = m.revolute("main", m.ground.at(0, 0), shaft.at(0, 0), coordinate=turn)
    for i, (throw, firing) in enumerate(zip(THROWS, FIRING, strict=True), 1):
        lean = math.asin(CRANK / ROD * math.sin(START + throw))
        rod = m.body(f"rod{i}", mass=0.45, inertia=1.5e-3, center=(0.040, 0.0))
        piston = m.body(f"piston{i}", mass=0.35)
        rod_angle = m.coordinate(f"rod_angle{i}", "rad", start=math.pi / 2 - lean - START)
        height = m.coordinate(f"height{i}", "m", start=top_of(START + throw))
        pin = shaft.at(-CRANK * math.sin(throw), CRANK * math.cos(throw))
        m.revolute(f"pin{i}", pin, rod.at(0, 0), coordinate=rod_angle)
        bore = m.prismatic(f"bore{i}", m.ground.at(0, 0), piston.at(0, 0), axis=math.pi / 2, coordinate=height)
        m.revolute(f"wrist{i}", rod.at(ROD, 0), piston.at(0, 0))
        pressure = overpressure(ca.fmod(turn - firing + 4 * math.pi, 4 * math.pi), CRANK + ROD - height)
        m.drive(bore, -pressure * AREA)
        m.output(f"pressure{i}", pressure + AMBIENT, "Pa", f"pressure in cylinder {i}")
    m.drive(main, -TORQUE)
    m.gravity(0, 0)
    return m


# %%
# Four times in two turns a cylinder fires; the crankshaft speeds up each time.

mechanism = engine()
result = simulate(mechanism)
angle = result["crankshaft.angle"]
fig, (top, bottom) = plt.subplots(2, 1, sharex=True, layout="constrained")
for i in (1, 3, 4, 2):
    top.plot(np.degrees(angle), result[f"pressure{i}"] / 1e5, label=f"cylinder {i}")
top.set_ylabel("pressure [bar]")
top.legend()
bottom.plot(np.degrees(angle), result["crankshaft.angular_velocity"] * 60 / (2 * math.pi))
bottom.set(xlabel="angle of the crankshaft [degrees]", ylabel="turns a minute")

# %%
# Four turns of the engine, slowed down forty times, seen along the crankshaft.

animate(mechanism, result, "four_cylinders.gif", fps=15, speed=0.025)

# %%
# **Check.** The pistons are where the angle of the crankshaft puts them. A cycle of each cylinder gives WORK, which the
# load takes in two turns, so that the speed is then what it was.

deviation = max(
    float(np.abs(result[f"piston{i}.y"] - [top_of(x + throw) for x in angle]).max())
    for i, throw in enumerate(THROWS, 1)
)
speed = np.interp(START + 4 * math.pi, angle, result["crankshaft.angular_velocity"])
change = float(abs(speed / SPEED - 1))
print(f"The pistons are where the crankshaft puts them to {deviation:.1e} m.")
print(f"The four cylinders give {TORQUE:.1f} N m on average. After two turns the speed has changed by {change:.1e}.")
