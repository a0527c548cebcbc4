"""
Jansen's leg
============

The leg of Theo Jansen's beach animals: one crank and ten tubes, whose lengths he found by trial and selection, move
a foot along a flat line and lift it back (T. Jansen, *The Great Pretender*, 2007). The numbers are his, taken as
centimetres; a metre of tube weighs 0.4 kg, as plastic conduit does.
"""

import math

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

from alfmu import Experiment, Mechanism, simulate
from alfmu.view.picture import animate

a, b, c, d, e, f, g, h, i, j, k, l, crank = (
    x / 100 for x in (38.0, 41.5, 39.3, 40.1, 55.8, 39.4, 36.7, 65.7, 49.0, 50.0, 61.9, 7.8, 15.0)
)

# %%
# Each point of the leg lies on two circles about others. With places as complex numbers, `meet` gives the point at
# the distance r from p and s from q, to the left of the way from p to q.


def meet(p: complex, r: float, q: complex, s: float) -> complex:
    apart = abs(q - p)
    along = (r**2 - s**2 + apart**2) / (2 * apart)
    return p + (q - p) / apart * complex(along, math.sqrt(r**2 - along**2))


def places(angle: float) -> dict[str, complex]:
    """The joints of the leg for an angle of the crank [rad]; the fixed hinge is the origin."""
    pin = complex(a, l) + crank * complex(math.cos(angle), math.sin(angle))
    top, low = meet(0, b, pin, j), meet(pin, k, 0, c)
    back = meet(0, d, top, e)
    knee = meet(low, g, back, f)
    return {"pin": pin, "top": top, "low": low, "back": back, "knee": knee, "foot": meet(low, i, knee, h)}


# %%
# Tubes between points are what natural coordinates are made for: twelve coordinates of six points, and eleven lengths
# that are kept. The places above are the guess at the start. A motor turns the crank by a turn in two seconds; its
# torque falls with its speed.


def jansen_leg() -> Mechanism:
    m = Mechanism(
        "jansen_leg", "A leg of a beach animal", experiment=Experiment(stop_time=4.0, communication_step=0.01)
    )
    speed = 2 * math.pi / 2.0
    angle = m.start("angle", 0.0, "rad", rate=speed)
    q = {
        name: (m.coordinate(f"{name}_x", "m", start=z.real), m.coordinate(f"{name}_y", "m", start=z.imag))
        for name, z in places(0.0).items()
    }
    pin, top, low, back, knee, foot = (m.point(x, y) for x, y in q.values())
    hinge, axle = m.point(0, 0), m.ground.at(a, l)
    arm = m.bar("crank", mass=1.0, length=crank, between=(axle, pin))
    ends = {"b": (hinge, top), "c": (hinge, low), "d": (hinge, back), "e": (top, back), "f": (back, knee)}
    ends |= {"g": (low, knee), "h": (knee, foot), "i": (low, foot), "j": (pin, top), "k": (pin, low)}
    lengths = {"b": b, "c": c, "d": d, "e": e, "f": f, "g": g, "h": h, "i": i, "j": j, "k": k}
    tubes = {n: m.bar(n, mass=0.4 * lengths[n], length=lengths[n], between=ends[n]) for n in ends}

    x, y = q["pin"]
    m.tie(angle, ca.atan2(y - l, x - a))
    rate = ((x - a) * m.rate(y) - (y - l) * m.rate(x)) / crank**2
    m.drive(m.revolute("motor", axle, arm.start), 20.0 * (speed - rate))
    m.watch("foot", tubes["i"].end)
    m.gravity(0, -9.81)
    return m


# %%
# The foot is on the ground for about half a turn, where its path is flat.

mechanism = jansen_leg()
result = simulate(mechanism)
fig, axes = plt.subplots(layout="constrained")
axes.plot(result["foot.x"], result["foot.y"])
axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="Path of the foot")

# %%
# The foot draws its path.

animate(mechanism, result, "jansen_leg.gif", fps=15, speed=1)

# %%
# **Check.** The circles give the foot for the angle of the crank at any time.

circles = np.array([places(angle)["foot"] for angle in result["crank.angle"]])
deviation = float(np.abs(result["foot.x"] + 1j * result["foot.y"] - circles).max())
low, high = result["foot.y"].min(), result["foot.y"].max()
print(
    f"The foot is where the circles say to {deviation:.1e} m, over {result['crank.angle'][-1] / 2 / math.pi:.2f} turns."
)
print(f"It steps {np.ptp(result['foot.x']):.3f} m far and {high - low:.3f} m high.")
