"""
Cam and valve
=============

A cam lifts a valve by 9 mm over 110 degrees, lets it down over the next 110, and rests. The profile is a cycloid, which
has no jump in acceleration. A spring keeps the flat follower on the cam; whether it does at a given speed is what one
wants to know.
"""

import math

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

from alfmu import Experiment, Mechanism, simulate
from alfmu.view.picture import animate

LIFT, RISE, BASE = 0.009, math.radians(110), 0.016  # [m], [rad], radius of the base circle [m]
MASS, STIFFNESS, PRELOAD = 0.120, 35e3, 280.0  # valve, retainer and follower [kg]; spring [N/m], [N]
SPEED = 2 * math.pi * 3000 / 60  # of the camshaft: 6000 turns a minute of the engine [rad/s]


def face(direction: ca.SX) -> ca.SX:
    """Distance of the face from the camshaft [m] over its direction, the nose of the cam being at 0."""
    part = ca.fmax(1 - ca.fmin(direction, 2 * ca.pi - direction) / RISE, 0)
    return BASE + LIFT * (part - ca.sin(2 * ca.pi * part) / (2 * ca.pi))


# %%
# `m.cam` keeps the flat follower on the cam, and its force is an output. The camshaft has the inertia of the engine
# behind it, and a motor that holds its speed.


def valve_train() -> Mechanism:
    m = Mechanism(
        "valve_train", "A cam and its valve", experiment=Experiment(0.06, step_size=2e-4, communication_step=1e-4)
    )
    turn = m.coordinate("turn", "rad", start=math.pi / 2 - RISE, rate=SPEED, independent=True)
    height = m.coordinate("height", "m", start=0.0)
    cam = m.body("cam", mass=1.2, inertia=1.0)
    valve = m.body("valve", mass=MASS)
    bearing = m.revolute("bearing", m.ground.at(0, 0), cam.at(0, 0), coordinate=turn)
    m.prismatic("stem", m.ground.at(0, BASE), valve.at(0, 0), axis=math.pi / 2, coordinate=height)
    m.cam("tappet", cam.at(0, 0), valve.at(0, 0), distance=face, face=math.pi / 2)
    m.spring_damper(
        (m.ground.at(0, BASE + 0.040), valve.at(0, 0)), stiffness=STIFFNESS, rest=0.040 + PRELOAD / STIFFNESS
    )
    m.watch("nose", cam.at(BASE + LIFT, 0))
    m.drive(bearing, 5.0 * (SPEED - m.rate(turn)))
    m.gravity(0, -9.81)
    return m


# %%
# In the second half of the way up, and in the first half of the way down, the spring alone slows the valve. The place
# of contact, seen from the cam, draws its outline.

mechanism = valve_train()
result = simulate(mechanism)
force = result["tappet.force"]
degrees = np.degrees(result["cam.angle"] - result["cam.angle"][0])
outline = (result["tappet.contact.x"] + 1j * result["tappet.contact.y"]) * np.exp(-1j * result["cam.angle"])
fig, axes = plt.subplot_mosaic([["lift", "cam"], ["force", "cam"]], layout="constrained", figsize=(9, 4.5))
axes["lift"].plot(degrees, 1e3 * (result["valve.y"] - BASE))
axes["lift"].set_ylabel("lift [mm]")
axes["force"].plot(degrees, force)
axes["force"].set(xlabel="angle of the cam [degrees]", ylabel="force on the follower [N]")
axes["cam"].plot(1e3 * outline.real, 1e3 * outline.imag)
axes["cam"].set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", title="Outline of the cam")

# %%
# The valve, a hundred times as slow as in the engine.

animate(mechanism, result, "valve_train.gif", fps=15, speed=0.01)

# %%
# **Check.** A cycloid of this height and length has the greatest acceleration 2 pi LIFT SPEED^2 / RISE^2, and the force
# is that of spring, weight and acceleration.

greatest = 2 * math.pi * LIFT * SPEED**2 / RISE**2
seen = float(np.abs(result["valve.ay"]).max())
lifted = result["valve.y"] - BASE
balance = float(np.abs(force - (PRELOAD + STIFFNESS * lifted + MASS * (9.81 + result["valve.ay"]))).max())
print(f"The valve is accelerated by up to {seen:.0f} m/s2; the cycloid says {greatest:.0f} m/s2.")
print(f"The follower is pressed on with {force.min():.0f} N at least, so it stays on the cam.")
print(f"Its force is that of spring, weight and acceleration to {balance:.1e} N.")
