"""Parts as mechanisms of their own, for export as FMUs and connection: a motor, a gearbox, a controller, a load.

    controller          motor               gearbox             load or mechanism
    wanted   ->         voltage ->          motor_speed ->      torque ->
    measured ->  output speed   -> torque   load_speed  -> motor_torque, load_torque   -> angle, speed

A motor without inertia takes the speed of its load and returns a torque: it is connected to a mechanism directly. A
motor with a rotor takes the load torque and returns its speed, as a gearbox with elastic shafts requires.
"""

from __future__ import annotations

from collections.abc import Callable
from types import MappingProxyType
from typing import Any

from ..model.calls import explained
from ..model.errors import DeclarationError
from ..model.mechanism import Mechanism
from ..model.words import shown
from .control import pi_controller
from .declared import named
from .load import load as loaded
from .motor import dc_motor


@explained
def motor(
    resistance: float = 0.4,
    inductance: float = 0.5e-3,
    constant: float = 0.05,
    inertia: float = 0.0,
    damping: float = 0.0,
    nominal: float = 1.0,
) -> Mechanism:
    """Return a DC motor with inputs `voltage` and `speed` of its shaft, and outputs `torque` and `current`.

    With the `inertia` [kg.m2] of a rotor and its viscous `damping` [N.m.s/rad] the motor integrates its own motion: the
    inputs are `voltage` and the opposing torque `load`, the outputs `speed`, `angle`, `torque` and `current`. `nominal`
    [A] is the order of magnitude of the current.
    """
    m = Mechanism("motor", "DC motor")
    voltage = m.input("voltage", "V", description="at its terminals")
    numbers: dict[str, Any] = {
        "resistance": resistance,
        "inductance": inductance,
        "constant": constant,
        "nominal": nominal,
    }
    if not inertia:
        if damping:
            raise DeclarationError(
                f"the damping of a motor without inertia is {shown(damping)}; it has the shaft of the driven part: "
                "give it an inertia, or damp the driven part"
            )
        speed = m.input("speed", "rad/s", description="of its shaft")
        dc_motor(m, "", voltage=voltage, speed=speed, **numbers)
        return m
    against = m.input("load", "N.m", description="torque on the driven shaft")
    angle = m.coordinate("turned", "rad", start=0.0, independent=True)
    J = named(m, "", "inertia", inertia, "kg.m2", "inertia of the rotor", minimum=1e-12)
    rotor = m.body("rotor", mass=0.0, inertia=J)
    shaft = m.revolute("shaft", m.ground.at(0, 0), rotor.at(), coordinate=angle)
    dc_motor(m, "", shaft, voltage=voltage, **numbers)
    m.drive(shaft, -against)
    if damping:
        m.friction(shaft, named(m, "", "damping", damping, "N.m.s/rad", "viscous loss", minimum=0.0))
    m.output("angle", angle, "rad", "of the shaft")
    m.output("speed", m.rate(angle), "rad/s", "of the shaft")
    return m


@explained
def gearbox(ratio: float = 10.0, stiffness: float = 1000.0, damping: float = 1.0) -> Mechanism:
    """Return a gearbox with elastic shafts: inputs `motor_speed`, `load_speed`, outputs `motor_torque`, `load_torque`.

    `ratio` is the speed of the motor over that of the load [1], `stiffness` [N.m/rad] and `damping` [N.m.s/rad] are
    those of its shafts, referred to the load. The state `twist` [rad] is the angle by which the motor side leads.
    """
    m = Mechanism("gearbox", "Gearbox with elastic shafts")
    motor_speed = m.input("motor_speed", "rad/s", description="of the shaft of the motor")
    load_speed = m.input("load_speed", "rad/s", description="of the shaft of the load")
    r = named(m, "", "ratio", ratio, "1", "speed of the motor over that of the load")
    k = named(m, "", "stiffness", stiffness, "N.m/rad", "stiffness of the shafts", minimum=0.0)
    d = named(m, "", "damping", damping, "N.m.s/rad", "damping of the shafts", minimum=0.0)
    twist = m.state("twist", "rad", description="of the shafts", nominal=1e-2)
    ahead = motor_speed / r - load_speed
    m.derivative(twist, ahead)
    torque = k * twist + d * ahead
    m.output("load_torque", torque, "N.m", "on the load")
    m.output("motor_torque", torque / r, "N.m", "that the motor gives")
    return m


@explained
def controller(gain: float = 1.0, time: float = 0.1, limit: float = 24.0) -> Mechanism:
    """Return a PI controller of a speed: inputs `wanted` and `measured` [rad/s], `output` [V] in +-`limit` [V].

    `gain` is in V.s/rad, `time` [s] is the integral time.
    """
    m = Mechanism("controller", "PI controller of a speed")
    wanted, measured = m.input("wanted", "rad/s"), m.input("measured", "rad/s")
    integral = m.parameter("integral_time", time, "s", minimum=1e-9, description="time of the integral part")
    pi_controller(m, "", wanted=wanted, measured=measured, gain=gain, time=integral, limit=limit)
    return m


@explained
def load(inertia: float = 0.01, damping: float = 0.0, opposing: float = 0.0, fan: float = 0.0) -> Mechanism:
    """Return a load on its own shaft: input `torque`, outputs `angle` and `speed`; the numbers are those of
    `parts.load`."""
    m = Mechanism("load", "Load on a shaft")
    torque = m.input("torque", "N.m", description="that drives the shaft")
    angle = m.coordinate("turned", "rad", start=0.0, independent=True)
    J = named(m, "", "inertia", inertia, "kg.m2", "inertia of the load", minimum=1e-12)
    wheel = m.body("wheel", mass=0.0, inertia=J)
    shaft = m.revolute("shaft", m.ground.at(0, 0), wheel.at(), coordinate=angle)
    m.drive(shaft, torque)
    numbers = {"damping": damping, "opposing": opposing, "fan": fan}
    if any(numbers.values()):
        loaded(m, "load", shaft, **numbers)
    m.output("angle", angle, "rad", "of the shaft")
    m.output("speed", m.rate(angle), "rad/s", "of the shaft")
    return m


BLOCKS: MappingProxyType[str, Callable[..., Mechanism]] = MappingProxyType(
    {"motor": motor, "gearbox": gearbox, "controller": controller, "load": load}
)
"""Parts by their names in a file of a system; their arguments are its options."""
