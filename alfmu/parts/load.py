"""A load on a rotating joint: a flywheel, viscous friction, an opposing torque, a fan.

With w the speed of the joint, J the inertia, b the damping, T the opposing torque and c that of the fan,

    J dw/dt = -b w - T tanh(w / w0) - c |w| w + torque of the drive.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from ..model.calls import explained
from ..model.errors import DeclarationError
from ..model.mechanism import Mechanism
from ..model.parts import Joint, Scalar, symbolic
from ..model.spatial import SpatialJoint
from ..model.words import shown
from .declared import label, mounted, named, of, rate_of_joint
from .motor import TURNING


@dataclass(frozen=True)
class Load:
    """Quantities of a load, for outputs and controllers: expressions in the symbols of its mechanism."""

    speed: ca.SX
    """Speed of the joint [rad/s]."""
    torque: ca.SX
    """Torque on the joint, without that of the inertia [N.m]."""


@explained
def load(
    m: Mechanism,
    name: str,
    joint: Joint | SpatialJoint,
    *,
    inertia: Scalar = 0.0,
    damping: Scalar = 0.0,
    opposing: Scalar = 0.0,
    fan: Scalar = 0.0,
) -> Load:
    """Add a load with inertia on a rotating joint, a hinge or a screw.

    `inertia` [kg.m2] is that of a flywheel, the body `<name>.wheel`, in space a thin disc about the axis. `damping`
    [N.m.s/rad] is viscous, `opposing` [N.m] a torque against the motion, which vanishes within
    `alfmu.parts.motor.TURNING` of standstill and so does not hold at rest, `fan` [kg.m2] a torque over the square of
    the speed. Numbers other than zero become the parameters `<name>.inertia` and so on; expressions are used unchanged.

    The output `<name>.torque` is the torque on the joint without that of the inertia; an empty name omits the prefix.
    Raises DeclarationError if the joint does not rotate, or nothing is given.
    """
    turns = isinstance(joint, Joint | SpatialJoint) and joint.kind in ("revolute", "screw")
    if not turns or joint not in (*m.joints, *m.spatial_joints):
        instead = "; load a slider by its mass, friction() and drive()" * (getattr(joint, "kind", "") == "prismatic")
        raise DeclarationError(
            f"{m.name}: the load{of(name)} is on {joint.name if hasattr(joint, 'name') else shown(joint)}; give it a "
            f"joint of this mechanism that is a revolute or a screw, in the plane or in space{instead}"
        )
    given = {"inertia": inertia, "damping": damping, "opposing": opposing, "fan": fan}
    if not any(isinstance(x, ca.SX) or x != 0 for x in given.values()):
        raise DeclarationError(f"{m.name}: the load{of(name)} loads nothing; give one of {', '.join(given)}")
    w = rate_of_joint(m, joint)
    torque = symbolic(0.0)
    if isinstance(damping, ca.SX) or damping != 0:
        torque -= named(m, name, "damping", damping, "N.m.s/rad", "viscous friction", minimum=0.0) * w
    if isinstance(opposing, ca.SX) or opposing != 0:
        most = named(m, name, "opposing", opposing, "N.m", "torque against the motion", minimum=0.0)
        torque -= most * ca.tanh(w / TURNING)
    if isinstance(fan, ca.SX) or fan != 0:
        c = named(m, name, "fan", fan, "kg.m2", "torque over the square of the speed", minimum=0.0)
        torque -= c * ca.fabs(w) * w
    mounted(m, name, "wheel", joint, 1.0, torque, inertia, 0.0)
    m.output(label(name, "torque"), torque, "N.m", f"torque{of(name)} on {joint.name}")
    return Load(w, torque)
