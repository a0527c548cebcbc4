"""Connected systems that tests share: a four-bar with DC motor and speed controller, in parts and in one mechanism."""

from pathlib import Path

import alfmu
from alfmu import Mechanism, System, parts

GAIN, TIME, LIMIT = 10.0, 0.2, 60.0
R, L, K = 0.5, 0.01, 1.0
WANTED = 2.0

ONE = f"""
import alfmu
from alfmu import Mechanism, parts


def one() -> Mechanism:
    m = alfmu.load("four_bar", coordinates="joint")
    joint = next(each for each in m.joints if each.name == "A")
    speed = next(each for each in m.coordinates if each.name == "th1").v
    wanted = m.input("wanted", "rad/s")
    voltage = parts.pi_controller(
        m, "controller", wanted=wanted, measured=speed, gain={GAIN}, time={TIME}, limit={LIMIT}
    )
    parts.dc_motor(m, "motor", joint, voltage=voltage, resistance={R}, inductance={L}, constant={K})
    return m
"""

DRIVE = f"""
name = "drive"
description = "A four-bar with motor and speed controller"
stop_time = 0.4
communication_step = 0.01

[components.arm]
mechanism = "four_bar"
options = {{ coordinates = "joint" }}
set = {{ "start.angle" = 0.5, "start.angular_velocity" = 0.0 }}

[components.motor]
part = "motor"
options = {{ resistance = {R}, inductance = {L}, constant = {K} }}

[components.controller]
part = "controller"
options = {{ gain = {GAIN}, time = {TIME}, limit = {LIMIT} }}

[[connections]]
from = "motor.torque"
to = "arm.A.torque"

[[connections]]
from = "arm.link1.angular_velocity"
to = "motor.speed"

[[connections]]
from = "arm.link1.angular_velocity"
to = "controller.measured"

[[connections]]
from = "controller.output"
to = "motor.voltage"

[inputs]
"controller.wanted" = {WANTED}

[monolithic]
mechanism = "one.py"
set = {{ "start.angle" = 0.5, "start.angular_velocity" = 0.0 }}
inputs = {{ wanted = {WANTED} }}
compare = {{ "arm.link1.angle" = "link1.angle", "motor.current" = "motor.current" }}
"""


def drive(folder: Path) -> Path:
    """The files of the driven four-bar; the path of its description."""
    (folder / "one.py").write_text(ONE)
    path = folder / "drive.toml"
    path.write_text(DRIVE)
    return path


def first_order(name: str = "filter", unit: str = "rad/s", instant: float = 0.0) -> Mechanism:
    """A block with one state, x' = u - x, whose output is x, or x + instant u, which follows its input at once."""
    m = Mechanism(name)
    u = m.input("u", unit)
    x = m.state("x", unit)
    m.derivative(x, u - x)
    m.output("y", x + instant * u, unit)
    return m


def spindle() -> System:
    """A motor at a constant voltage that turns a load through an elastic gearbox; all that is connected begins at 0."""
    blocks = parts.blocks
    return System(
        "spindle",
        {
            "motor": blocks.motor(inertia=1e-3, inductance=2e-3, nominal=10.0),
            "gearbox": blocks.gearbox(ratio=5.0, stiffness=50.0, damping=0.5),
            "load": alfmu.Recipe(blocks.load(inertia=0.05, damping=0.1), outputs=["speed", "angle"]),
        },
        [
            ("motor.speed", "gearbox.motor_speed"),
            ("load.speed", "gearbox.load_speed"),
            ("gearbox.motor_torque", "motor.load"),
            ("gearbox.load_torque", "load.torque"),
        ],
        {"motor.voltage": 12.0},
        stop_time=0.2,
        communication_step=1e-3,
    )
