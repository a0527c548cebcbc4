"""
Bar clamp
=========

A quick-action clamp: its jaw slides on a bar, and a hand pushes it against the work. The work pushes back far below the
bar, so that the jaw bears at two edges of its slot. Their friction grows with the very force that it holds: no thread
and no ratchet is needed. With a short jaw the same clamp slides open.
"""

import math

import casadi as ca
import matplotlib.pyplot as plt

from alfmu import Experiment, Mechanism, simulate
from alfmu.view.picture import animate

FRICTION, EDGES = 0.2, 0.04  # coefficient; distance of the edges of the slot [m]
HAND, STROKE = 400.0, 1.2  # greatest push of the hand [N], its duration [s]
GAP, STIFFNESS = 0.12, 8e3  # way to the work [m], a rubber block [N/m]


def bar_clamp(reach: float = 0.16) -> Mechanism:
    m = Mechanism("bar_clamp", "A clamp that friction locks", experiment=Experiment(2.0, communication_step=0.01))
    place = m.coordinate("place", "m", start=0.0, independent=True)
    jaw = m.bar("jaw", mass=0.6, length=reach)
    bar = m.prismatic("bar", m.ground.at(0, 0), jaw.start, coordinate=place, angle=-math.pi / 2)
    m.friction(bar, coulomb=FRICTION, length=EDGES)
    hand = HAND * ca.if_else(m.time < STROKE, ca.sin(math.pi / STROKE * m.time) ** 2, 0)
    m.drive(bar, hand - 150.0 * m.rate(place))
    press = STIFFNESS * ca.fmax(place - GAP, 0)
    m.force(jaw.end, -press, 0.0)
    m.output("press", press, "N", "force on the work")
    m.gravity(0, -9.81)
    return m


# %%
# Half-way through the stroke the hand pushes hardest. Then it lets go, and the long jaw stays where it is.

mechanism = bar_clamp()
result, short = simulate(mechanism), simulate(bar_clamp(reach=0.06))
fig, (top, bottom) = plt.subplots(2, 1, sharex=True, layout="constrained")
for run, label in ((result, "jaw of 16 cm"), (short, "jaw of 6 cm")):
    top.plot(run.time, run["press"], label=label)
    bottom.plot(run.time, run["bar.friction_force"], label=label)
top.set_ylabel("force on the work [N]")
top.legend()
bottom.set(xlabel="time [s]", ylabel="friction on the jaw [N]")

# %%
# The jaw is the rod that hangs from the bar; its lower end meets the work.

animate(mechanism, result, "bar_clamp.gif", fps=20, speed=0.5)

# %%
# **Check.** The edges carry a force P at the arm r with 2 P r/b, so that friction holds P where 2 mu r/b is above 1.
# What the clamp keeps is the hand's push over 1 + 2 mu r/b, but for its weight and speed.

hold, slide = (2 * FRICTION * reach / EDGES for reach in (0.16, 0.06))
kept, left = float(result["press"][-1]), float(short["press"][-1])
expected = HAND / (1 + hold)
print(f"A ratio of {hold:.1f} holds {kept:.0f} N (by hand {expected:.0f} N), one of {slide:.1f} leaves {left:.1f} N.")
creep = abs(float(result["jaw.velocity"][-1]))
print(f"The jaw rests at {creep:.1e} m/s.")
