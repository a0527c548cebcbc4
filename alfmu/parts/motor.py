"""A DC motor with a gearbox, on a joint or alone.

With u the voltage, i the current and w the speed of the rotor,

    L di/dt = u - R i - k w,      T = k i,

and behind a gearbox of ratio r the rotor turns r times as fast as the joint, whose torque is r T.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from ..model.calls import explained
from ..model.errors import DeclarationError
from ..model.mechanism import Mechanism
from ..model.parts import Joint, Scalar, symbolic
from ..model.spatial import SpatialJoint
from ..model.words import in_words, shown
from .declared import label, mounted, named, of, rate_of_joint

_DRIVEN = ("revolute", "prismatic", "screw")
"""Kinds of joints that a motor can drive."""

TURNING = 0.1
"""Speed of a rotor [rad/s] above which the loss of a gearbox is fully developed; well below the speeds of motors, and
large enough for a step to pass a change of direction."""


@dataclass(frozen=True)
class Gearbox:
    """A gearbox between a motor and a joint; a number becomes a parameter of the motor.

    `ratio` is the speed of the motor over that of the joint [1], or over the velocity of a sliding joint [rad/m]; it
    may be negative. `efficiency` [1] is the share of the motor's torque that reaches the joint if the motor drives; if
    the joint drives the motor, the same share reaches the motor. The torque that accelerates the rotor has no loss.
    `damping` [N.m.s/rad] is the viscous loss at the motor's shaft.
    """

    ratio: Scalar = 1.0
    efficiency: Scalar = 1.0
    damping: Scalar = 0.0


@dataclass(frozen=True)
class Motor:
    """Quantities of a motor, for outputs and controllers: expressions in the symbols of its mechanism."""

    current: ca.SX
    """Current [A]."""
    torque: ca.SX
    """Torque on the joint, after the gearbox [N.m]; on the shaft without a joint; on a sliding joint the force [N]."""
    speed: ca.SX
    """Speed of the rotor relative to its housing [rad/s]."""


@explained
def dc_motor(
    m: Mechanism,
    name: str,
    joint: Joint | SpatialJoint | None = None,
    *,
    voltage: Scalar,
    resistance: Scalar,
    inductance: Scalar,
    constant: Scalar,
    inertia: Scalar = 0.0,
    gearbox: Gearbox | None = None,
    speed: Scalar | None = None,
    current: float = 0.0,
    nominal: float = 1.0,
) -> Motor:
    """Add a DC motor that drives the second body of a joint from the first.

    The joint is revolute, prismatic or, in space, a screw, which the motor drives by its angle.

    `voltage` [V] is any expression: an input, the output of a controller. `resistance` [Ohm], `inductance` [H],
    `constant` [N.m/A, V.s/rad] and `inertia` [kg.m2] of the rotor are numbers, which become the parameters
    `<name>.resistance` and so on, or expressions in parameters. With an inductance of 0 the current follows without
    delay. `current` [A] is its start, `nominal` [A] its order of magnitude (as in `Mechanism.state`).

    A rotor with inertia is a body, `<name>.rotor`, in a bearing on the first body: its inertia counts with the square
    of the gearbox's ratio, and the joints that carry the motor feel it. In space it is a thin disc about the axis of
    the joint, whose inertia across the axis is half of that about it. Without a joint, `speed` [rad/s] is that of the
    shaft, usually an input: the motor is then connected to a mechanism elsewhere, which contains the inertia.

    Outputs are `<name>.current`, `<name>.torque` and `<name>.voltage`. With an empty name the mechanism is the motor
    itself: its names have no prefix, and the voltage is no output. Raises DeclarationError if the arguments do not
    define a motor.
    """
    gearbox = gearbox or Gearbox()
    _check(m, name, joint, speed, inertia, gearbox)
    R = named(m, name, "resistance", resistance, "Ohm", "resistance", minimum=0.0)
    k = named(m, name, "constant", constant, "N.m/A", "torque per current, and voltage per speed,")
    r, efficiency, damping = _geared(m, name, gearbox)
    w = symbolic(0.0 if speed is None else speed) if joint is None else r * rate_of_joint(m, joint)
    instant = not isinstance(inductance, ca.SX) and inductance == 0
    if instant:
        i = symbolic((voltage - k * w) / R)
        m.output(label(name, "current"), i, "A", f"current{of(name)}")
    else:
        L = named(m, name, "inductance", inductance, "H", "inductance", minimum=1e-12)
        i = m.state(label(name, "current"), "A", start=current, nominal=nominal, description=f"current{of(name)}")
        m.derivative(i, (voltage - R * i - k * w) / L)
    torque = _through(k * i, w, efficiency)
    if joint is not None:
        mounted(m, name, "rotor", joint, r, torque, inertia, damping)
    out = torque if joint is None else r * torque
    sliding = joint is not None and joint.kind == "prismatic"
    kind = "force" if sliding else "torque"
    what = f"{kind}{of(name)} on {joint.name if joint else 'its shaft'}"
    m.output(label(name, kind), out, "N" if sliding else "N.m", what)
    if name:  # without a name the motor is a mechanism whose input is the voltage
        m.output(f"{name}.voltage", voltage, "V", f"voltage of {name}")
    return Motor(i, symbolic(out), w)


def _check(
    m: Mechanism,
    name: str,
    joint: Joint | SpatialJoint | None,
    speed: Scalar | None,
    inertia: Scalar,
    gearbox: Gearbox,
) -> None:
    if not isinstance(gearbox, Gearbox):
        raise DeclarationError(f"{m.name}: the gearbox of {name} is {shown(gearbox)}; give parts.Gearbox(ratio=...)")
    if (joint is None) == (speed is None):
        given = "neither" if joint is None else "both"
        raise DeclarationError(
            f"{m.name}: the motor {name} takes a joint, or the speed of its shaft, and is given {given}; give one"
        )
    if joint is None:
        if isinstance(inertia, ca.SX) or inertia != 0 or gearbox != Gearbox():
            raise DeclarationError(
                f"{m.name}: the motor {name} has no joint, so it can have no rotor and no gearbox; declare them in "
                "the driven mechanism"
            )
    elif not isinstance(joint, Joint | SpatialJoint) or joint.kind not in _DRIVEN or joint not in _joints(m):
        raise DeclarationError(
            f"{m.name}: the motor {name} is on {joint.name if hasattr(joint, 'name') else shown(joint)}; give it a "
            f"joint of this mechanism that is {in_words([f'a {kind}' for kind in _DRIVEN])}, in the plane or in space"
        )


def _joints(m: Mechanism) -> tuple[Joint | SpatialJoint, ...]:
    return *m.joints, *m.spatial_joints


def _geared(m: Mechanism, name: str, gearbox: Gearbox) -> tuple[Scalar, Scalar, Scalar]:
    """Return ratio, efficiency and damping, as parameters if they differ from the defaults."""
    none, ratio, efficiency, damping = Gearbox(), gearbox.ratio, gearbox.efficiency, gearbox.damping
    if isinstance(ratio, ca.SX) or ratio != none.ratio:
        ratio = named(m, name, "ratio", ratio, "1", "speed over that of its joint,")
    if isinstance(efficiency, ca.SX) or efficiency != none.efficiency:
        efficiency = named(m, name, "efficiency", efficiency, "1", "efficiency of the gearbox", 1e-3, 1.0)
    if isinstance(damping, ca.SX) or damping != none.damping:
        damping = named(m, name, "damping", damping, "N.m.s/rad", "viscous loss at the shaft", minimum=0.0)
    return ratio, efficiency, damping


def _through(torque: ca.SX, speed: ca.SX, efficiency: Scalar) -> ca.SX:
    """Return the torque behind a gearbox, referred to the motor: smaller if the motor drives, else larger."""
    if not isinstance(efficiency, ca.SX) and efficiency == 1:
        return torque
    passed = torque * ca.if_else(torque * speed > 0, efficiency, 1 / efficiency)
    return torque - ca.fabs(ca.tanh(speed / TURNING)) * (torque - passed)
