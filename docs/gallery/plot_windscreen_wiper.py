"""
Windscreen wiper
================

A motor that turns one way moves two blades to and fro: a crank-rocker swings the first arm, a parallel link takes the
second one along. The dimensions suit a small car. The angle that the blades sweep follows from the two
positions in which crank and rod are in line.
"""

import math

import matplotlib.pyplot as plt

from alfmu import Experiment, Mechanism, simulate
from alfmu.view.picture import animate

CRANK, ROD, LEVER = 0.040, 0.306, 0.055  # [m]
PIVOT = (0.300, 0.060)  # of the first arm, from the motor [m]
SPACING = 0.450  # of the two arms [m]
ARM = 0.550  # from its pivot to the middle of the blade [m]

# %%
# The motor is a geared one: 30 N.m at rest, 45 turns a minute without load. The film of water resists the blades in
# proportion to their speed. Each arm weighs 0.6 kg with its blade and is one body with its lever, which points
# downwards.


def windscreen_wiper() -> Mechanism:
    m = Mechanism(
        "windscreen_wiper", "Two wipers, one motor", experiment=Experiment(stop_time=4.0, communication_step=0.005)
    )
    full_speed = 45 * 2 * math.pi / 60
    turn = m.coordinate("turn", "rad", start=0.0, rate=0.0, independent=True)
    swing = m.coordinate("swing", "rad", start=0.4)
    crank = m.bar("crank", mass=0.15, length=CRANK)
    rod = m.bar("rod", mass=0.25, length=ROD)
    arms = [m.body(f"arm{i}", mass=0.6, inertia=0.02, center=(0.0, 0.6 * ARM)) for i in (1, 2)]
    link = m.bar("link", mass=0.3, length=SPACING)

    motor = m.revolute("motor", m.ground.at(0, 0), crank.start, coordinate=turn)
    m.revolute("A", crank.end, rod.start, coordinate=m.coordinate("rod_angle", "rad", start=0.0))
    pivot = m.revolute("B", m.ground.at(*PIVOT), arms[0].at(0, 0), coordinate=swing)
    m.revolute("C", rod.end, arms[0].at(0, -LEVER))
    second = m.ground.at(PIVOT[0] + SPACING, PIVOT[1])
    other = m.revolute("D", second, arms[1].at(0, 0), coordinate=m.coordinate("swing2", "rad", start=0.4))
    m.revolute("E", arms[0].at(0, -LEVER), link.start, coordinate=m.coordinate("link_angle", "rad", start=-0.4))
    m.revolute("F", link.end, arms[1].at(0, -LEVER))

    m.drive(motor, 30.0 * (1 - m.rate(turn) / full_speed))
    m.friction(pivot, 1.5)
    m.friction(other, 1.5)
    m.watch("blade1", arms[0].at(0, ARM))
    m.watch("blade2", arms[1].at(0, ARM))
    m.gravity(0, -9.81)
    return m


# %%
# The motor comes up to speed within a few hundredths of a second.

mechanism = windscreen_wiper()
result = simulate(mechanism)
fig, (top, bottom) = plt.subplots(2, 1, sharex=True, layout="constrained")
for name in ("arm1", "arm2"):
    top.plot(result.time, [math.degrees(x) for x in result[f"{name}.angle"]], label=name)
top.set_ylabel("angle [degrees]")
top.legend()
bottom.plot(result.time, result["crank.angular_velocity"])
bottom.set(xlabel="time [s]", ylabel="speed of the crank [rad/s]")

# %%
# Both blades in motion.

animate(mechanism, result, "windscreen_wiper.gif", fps=15, speed=1)

# %%
# **Check.** Where crank and rod are in line, pivot, motor and pin form a triangle of known sides.

distance = math.hypot(*PIVOT)


def angle_at_pivot(reach: float) -> float:
    """Angle of the lever from the line between pivot and motor, with its pin so far from the motor."""
    return math.acos((distance**2 + LEVER**2 - reach**2) / (2 * distance * LEVER))


swept = angle_at_pivot(ROD + CRANK) - angle_at_pivot(ROD - CRANK)
simulated = float(result["arm1.angle"].max() - result["arm1.angle"].min())
apart = float(abs(result["arm1.angle"] - result["arm2.angle"]).max())
print(f"The blades sweep {math.degrees(simulated):.3f} degrees; the triangles say {math.degrees(swept):.3f}.")
print(f"The two arms stay parallel to {apart:.1e} rad.")
