"""
Five-bar robot on a path
========================

Two motors on the ground move a tool by two cranks and two rods, so that no motor is carried; the *Pantograph Mk-II* of
G. Campion, Q. Wang and V. Hayward (2005) is one for the hand. Inverse kinematics tells the motors their angles, and
computed torques let soft servos follow them.
"""

import matplotlib.pyplot as plt
import numpy as np

from alfmu import Mechanism, kinematics, simulate
from alfmu.view.picture import animate

CRANK, ROD, BASE = 0.3, 0.4, 0.3  # lengths, and distance of the motors [m]
STIFFNESS, DAMPING = 60.0, 3.0  # of a servo [N.m/rad, N.m.s/rad]
PERIOD = 2.4  # of a round [s]

# %%
# A servo holds its crank at an angle by a spring and a damper. It takes a torque besides.


def path_robot() -> Mechanism:
    m = Mechanism("path_robot", "Two cranks and two rods that meet in the tool")
    ends = []
    for name, x, start, bend in (("A", 0.0, 2.3, -1.6), ("B", BASE, 0.8, 1.6)):
        crank, rod = m.bar(f"crank{name}", mass=0.6, length=CRANK), m.bar(f"rod{name}", mass=0.3, length=ROD)
        angle = m.coordinate(f"angle{name}", "rad", start=start, independent=True)
        motor = m.revolute(name, m.ground.at(x, 0), crank.start, coordinate=angle)
        m.revolute(f"elbow{name}", crank.end, rod.start, coordinate=m.coordinate(f"bend{name}", "rad", start=bend))
        goal, speed = m.input(f"{name}.goal", "rad"), m.input(f"{name}.speed", "rad/s")
        servo = STIFFNESS * (goal - angle) + DAMPING * (speed - m.rate(angle))
        m.drive(motor, m.input(f"{name}.given", "N.m") + servo)
        ends.append(rod.end)
    m.revolute("E", *ends)
    m.watch("tool", ends[0])
    m.gravity(0, -9.81)
    return m


# %%
# The tool draws a lying eight, and rests at both ends of the motion. At each point of the path the solution nearest to
# the last one is taken. The kinematics leaves the servos out: their motors are what it is asked for.

mechanism = path_robot()
robot = kinematics(mechanism)
time = np.linspace(0.0, PERIOD, 161)
part = time / PERIOD
turn = 2 * np.pi * part**4 * (35 - 84 * part + 70 * part**2 - 20 * part**3)
path = np.column_stack([BASE / 2 + 0.16 * np.sin(turn), 0.46 + 0.07 * np.sin(2 * turn)])
positions = [robot.inverse({"tool": path[0]})]
for place in path[1:]:
    positions.append(robot.inverse({"tool": place}, positions[-1]))
needed = robot.along({name: (time, np.array([each[name] for each in positions])) for name in robot.actuated})

# %%
# The servos alone lag behind; with the torques that the motion takes they do not. They get new numbers every 3 ms,
# those of the middle of the step over which they hold them.

STEP = 0.003
middle = time - STEP / 2
start = {f"start.angle{name}": positions[0][name] for name in robot.actuated}
goals = {f"{name}.goal": (middle, needed[name]) for name in robot.actuated}
goals |= {f"{name}.speed": (middle, needed[f"der({name})"]) for name in robot.actuated}
torques = {f"{name}.given": (middle, needed[f"{name}.torque"]) for name in robot.actuated}
alone = simulate(mechanism, PERIOD, STEP, parameters=start, inputs=goals)
result = simulate(mechanism, PERIOD, STEP, parameters=start, inputs=goals | torques)

fig, (left, right) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
left.plot(*path.T, "k--", label="wanted")
left.plot(alone["tool.x"], alone["tool.y"], label="servos alone")
left.plot(result["tool.x"], result["tool.y"], label="with computed torques")
left.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", ylim=(0.24, 0.56))
left.legend(loc="lower center")
for name in robot.actuated:
    right.plot(middle, needed[f"{name}.torque"], label=name)
right.set(xlabel="time [s]", ylabel="computed torque [N.m]")
right.legend()

# %%
animate(mechanism, result, "path_robot.gif", fps=15, speed=0.5)

# %%
# **Check.** The tool is on its path. A servo alone lags behind by the torque that it gives over its stiffness, which is
# followed by hand where the robot rests: at the end.

wanted = [np.interp(result.time, time, needed[name]) for name in ("tool.x", "tool.y")]
off = np.hypot(result["tool.x"] - wanted[0], result["tool.y"] - wanted[1])
lag = float(needed["A"][-1] - alone["crankA.angle"][-1])
expected = float(needed["A.torque"][-1]) / STIFFNESS
print(f"The tool leaves its path by {1e3 * off.max():.4f} mm.")
print(f"A alone lags behind by {lag:.4f} rad at the end; torque over stiffness is {expected:.4f} rad.")
