"""
Leg with a closed ankle
=======================

Legs of walking robots are light where they move most: both motors of the ankle sit in the shank, and two rods carry
their torques to the foot. Moved together they pitch the foot, moved against each other they roll it. Here the leg rises
from a squat, under the weight of its robot.
"""

import math

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import simpson

from alfmu import Mechanism, kinematics
from alfmu.view.picture import animate

THIGH, SHANK, CRANK, HEIGHT, SIDE = 0.4, 0.4, 0.05, 0.22, 0.04  # lengths; place of the motors above the ankle [m]
BODIES = {  # mass [kg], moments of inertia [kg.m2], centre of mass [m]
    "thigh": (6.0, (0.08, 0.08, 0.01), (0, 0, -THIGH / 2)),
    "shank": (3.0, (0.04, 0.04, 4e-3), (0, 0, -SHANK / 2)),
    "foot": (1.0, (1e-3, 4e-3, 4e-3), (0.04, 0, -0.05)),
    "left_crank": (0.2, (1e-4, 1e-4, 1e-4), (-CRANK / 2, 0, 0)),
    "right_crank": (0.2, (1e-4, 1e-4, 1e-4), (-CRANK / 2, 0, 0)),
}
LOAD = 300.0  # of the ground on the sole [N]
PERIOD = 0.8  # of the motion [s]

# %%
# A Cardan joint holds the foot. The rods are massless: each keeps its ends at a distance. All is seen from the hip, to
# which the ground presses the foot up.


def biped_leg() -> Mechanism:
    m = Mechanism("biped_leg", "A leg whose ankle two rods move")
    thigh, shank, foot, *cranks = (
        m.spatial_body(name, mass=mass, inertia=moments, center=center, relative=True)
        for name, (mass, moments, center) in BODIES.items()
    )
    hip, knee, pitch, roll = (
        m.coordinate(name, "rad", start=start, independent=True)
        for name, start in (("hip", -0.5), ("knee", 0.9), ("pitch", -0.4), ("roll", 0.0))
    )
    across, top = (0, 1, 0), m.spatial_ground.at(0, 0, 0)
    motors = [m.spatial_revolute("hip_motor", top, thigh.at(0, 0, 0), axis=across, coordinate=hip)]
    end, ankle = thigh.at(0, 0, -THIGH), shank.at(0, 0, -SHANK)
    motors.append(m.spatial_revolute("knee_motor", end, shank.at(0, 0, 0), axis=across, coordinate=knee))
    m.universal("ankle", ankle, foot.at(0, 0, 0), axis=across, second_axis=(1, 0, 0), coordinates=[pitch, roll])
    for crank, name, y in zip(cranks, ("left", "right"), (SIDE, -SIDE), strict=True):
        angle = m.coordinate(f"{name}_angle", "rad", start=-0.4)
        seat = shank.at(0, y, HEIGHT - SHANK)
        motors.append(m.spatial_revolute(f"{name}_motor", seat, crank.at(0, 0, 0), axis=across, coordinate=angle))
        m.distance(f"{name}_rod", crank.at(-CRANK, 0, 0), foot.at(-CRANK, y, 0), length=HEIGHT)
    for motor in motors:
        m.drive(motor, m.input(f"{motor.name}.input", "N.m"))
    m.output("tilt", hip + knee + pitch, "rad", "of the foot")
    m.watch("sole", foot.at(0.05, 0, -0.08))
    m.force(foot.at(0.05, 0, -0.08), 0, 0, m.input("pressure", "N", start=LOAD))
    m.gravity(0, 0, -9.81)
    return m


# %%
# The sole goes down straight and flat, and rolls a little on the way, as the robot leans aside.

mechanism = biped_leg()
robot = kinematics(mechanism)
time = np.linspace(0.0, PERIOD, 81)
part = time / PERIOD
smooth = part**4 * (35 - 84 * part + 70 * part**2 - 20 * part**3)
bump = np.sin(np.pi * smooth) ** 2
goals = {"sole.x": 0.04 + 0 * time, "sole.z": -0.62 - 0.2 * smooth, "tilt": 0 * time, "roll": 0.15 * bump}
positions = [robot.start]
for k in range(len(time)):
    positions.append(robot.inverse({name: values[k] for name, values in goals.items()}, positions[-1]))
result = robot.along({name: (time, np.array([x[name] for x in positions[1:]])) for name in robot.actuated})

fig, (top, bottom) = plt.subplots(2, 1, sharex=True, layout="constrained")
for name in robot.actuated:
    top.plot(time, result[f"{name}.torque"], label=name)
    if name in ("left_motor", "right_motor"):
        bottom.plot(time, result[name], label=name)
bottom.plot(time, result["pitch"], "--", label="pitch of the ankle")
bottom.plot(time, result["roll"], "--", label="roll of the ankle")
top.set_ylabel("torque [N.m]")
bottom.set(xlabel="time [s]", ylabel="angle [rad]")
top.legend()
bottom.legend()

# %%
animate(mechanism, result, "biped_leg.gif", fps=12, speed=0.25)

# %%
# **Check.** The end of a crank is on a circle about its motor and on a sphere about the heel, which gives the angle in
# closed form. And as the leg rests at both ends, the work of motors and ground is what its weight has gained.


def crank_angle(pitch: float, roll: float, y: float) -> float:
    """Angle of the crank whose rod stands at y on the foot."""
    x = y * math.sin(roll) * math.sin(pitch) - CRANK * math.cos(pitch)
    z = y * math.sin(roll) * math.cos(pitch) + CRANK * math.sin(pitch)
    up, aside = HEIGHT - z, y * (1 - math.cos(roll))
    reach = (HEIGHT**2 - CRANK**2 - x**2 - up**2 - aside**2) / (2 * CRANK)
    return math.atan2(up, x) - math.acos(reach / math.hypot(up, x))


sides = {"left_motor": SIDE, "right_motor": -SIDE}
expected = [[crank_angle(x["pitch"], x["roll"], y) for y in sides.values()] for x in positions[1:]]
deviation = float(np.abs(np.array([[x[name] for name in sides] for x in positions[1:]]) - expected).max())
lifted = LOAD * float(result["sole.z"][-1] - result["sole.z"][0])
work = float(simpson(sum(result[f"{k}.torque"] * result[f"der({k})"] for k in robot.actuated), x=time))
gained = float(
    sum(9.81 * mass * (result[f"{name}.z"][-1] - result[f"{name}.z"][0]) for name, (mass, *_) in BODIES.items())
)
print(f"The cranks are where the closed form has them, to {deviation:.1e} rad.")
print(f"The motors give {work:.4f} J and the ground {lifted:.4f} J, and the leg has gained {gained:.4f} J.")
