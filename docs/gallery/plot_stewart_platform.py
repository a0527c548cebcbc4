"""
Stewart platform
================

A platform on six legs, each an electric cylinder between two universal joints: the motion base of flight simulators
(D. Stewart, *A platform with six degrees of freedom*, 1965). Inverse kinematics tells the legs their lengths, and the
platform follows: it tilts about an inclined axis while it rises.
"""

import math

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

from alfmu import Experiment, Mechanism, simulate
from alfmu.model.spatial import about, rotation
from alfmu.view.picture import animate

HEIGHT, PERIOD = 1.80, 2.0  # of the platform at the start [m]; of its motion [s]
BASE = [2.0 * np.array([math.cos(a), math.sin(a), 0.0]) for a in np.radians([-10, 10, 110, 130, 230, 250])]
TOP = [1.2 * np.array([math.cos(a), math.sin(a), 0.0]) for a in np.radians([-50, 50, 70, 170, 190, 290])]
CYLINDER, ROD = (60.0, 5.0, 0.6), (30.0, 2.5, 0.6)  # mass [kg], inertia [kg.m2], centre of mass from its joint [m]

# %%
# The legs are declared at the general level: each by two angles and its length, with the kinetic and the potential
# energy of cylinder and rod. Three constraints put its end to the platform, a body in space with Euler parameters.
# The drive of a leg is a spring of 2e6 N/m with a damper along it. What is declared by energies has no body to draw, so
# pictures are told of the legs.


def wanted(t: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Place [m] and Euler parameters that the platform should have."""
    swell = (1 - ca.cos(2 * ca.pi * t / PERIOD)) / 2
    return ca.vertcat(0, 0, HEIGHT + 0.15 * swell), about((0.6, 0.8, 0.0), 0.2 * swell)


def stewart_platform() -> Mechanism:
    m = Mechanism("stewart_platform", "A platform on six legs", experiment=Experiment(PERIOD, communication_step=0.02))
    platform = m.spatial_body("platform", mass=1000.0, inertia=(360.0, 360.0, 700.0), position=(0.0, 0.0, HEIGHT))
    place, attitude = wanted(m.time)
    for i, (base, top) in enumerate(zip(BASE, TOP, strict=True), 1):
        x, y, z = (float(each) for each in top - base + np.array([0, 0, HEIGHT]))
        tilt = m.coordinate(f"tilt{i}", "rad", start=math.atan2(math.hypot(x, y), z))
        turn = m.coordinate(f"turn{i}", "rad", start=math.atan2(y, x))
        length = m.coordinate(f"length{i}", "m", start=math.hypot(x, y, z))
        q = ca.vertcat(tilt, turn, length)
        v = ca.vertcat(m.rate(tilt), m.rate(turn), m.rate(length))
        along = ca.vertcat(ca.sin(tilt) * ca.cos(turn), ca.sin(tilt) * ca.sin(turn), ca.cos(tilt))
        swing = ca.jtimes(along, q, v)
        for mass, inertia, center in ((*CYLINDER[:2], CYLINDER[2]), (*ROD[:2], length - ROD[2])):
            speed = ca.jtimes(center * along, q, v)
            m.kinetic_energy((mass * ca.sumsqr(speed) + inertia * ca.sumsqr(swing)) / 2)
            m.potential_energy(mass * 9.81 * center * along[2])
        gap = platform.at(*top).place - (base + length * along)
        for axis, each in zip("xyz", ca.vertsplit(gap), strict=True):
            m.constraint(f"joint{i}.{axis}", each)
        goal = ca.norm_2(place + rotation(attitude) @ top - base)
        force = 2e6 * (goal - length) + 8e4 * (ca.jacobian(goal, m.time) - m.rate(length))
        m.generalized_force(length, force)
        m.drawn_joint(f"foot{i}", base, kind="spherical")
        m.drawn_joint(f"head{i}", base + length * along, kind="spherical")
        m.drawn_bar(f"leg{i}", f"foot{i}", f"head{i}")
        m.output(f"leg{i}.length", length, "m", f"length of leg {i}")
        m.output(f"leg{i}.force", force, "N", f"force with which the drive of leg {i} pushes")
    m.gravity(0, 0, -9.81)
    return m


# %%
# At the start the legs yield a little under the platform's ton.

mechanism = stewart_platform()
result = simulate(mechanism, outputs=["platform.?", "platform.e?", "leg*", "head*", "monitor.*"])
fig, axes = plt.subplots(layout="constrained")
for i in range(1, 7):
    axes.plot(result.time, result[f"leg{i}.force"] / 1e3, label=f"leg {i}")
axes.set(xlabel="time [s]", ylabel="force of the drive [kN]")
axes.legend()

# %%
# The platform rises, tilts and comes back.

animate(mechanism, result, "stewart_platform.gif", fps=15, speed=0.5)

# %%
# **Check.** Inverse kinematics of the simulated pose gives the simulated lengths.


def legs(place: np.ndarray, attitude: np.ndarray) -> list[float]:
    """Lengths of the legs for a pose of the platform."""
    turn = ca.evalf(rotation(ca.SX(attitude))).full()
    return [float(np.linalg.norm(place + turn @ top - base)) for base, top in zip(BASE, TOP, strict=True)]


places = np.column_stack([result[f"platform.{axis}"] for axis in "xyz"])
attitudes = np.column_stack([result[f"platform.e{i}"] for i in range(4)])
expected = np.array([legs(*pose) for pose in zip(places, attitudes, strict=True)])
lengths = np.column_stack([result[f"leg{i}.length"] for i in range(1, 7)])
deviation = float(np.abs(lengths - expected).max())
off = float(np.abs(places[-1] - [0, 0, HEIGHT]).max())
print(f"Lengths of the legs and pose of the platform belong together to {deviation:.1e} m.")
print(f"After its motion the platform is back to {1e3 * off:.1f} mm, which is how far the drives yield to its weight.")
