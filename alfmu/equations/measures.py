"""Measures on request: the motion of joints, the elongation and the effort of springs."""

from typing import Protocol

import casadi as ca

from ..model.mechanism import Mechanism
from ..model.parts import EFFORTS, FREE, AnyJoint, AnyMarker, Joint
from ..model.units import rate_of
from .types import Variable


class Displacements(Protocol):
    """Displacements of joints and springs: `model.kinematics.Kinematics`."""

    def free(self, joint: AnyJoint) -> ca.SX: ...
    def counted(self, joint: AnyJoint) -> ca.SX: ...
    def distance(self, between: tuple[AnyMarker, AnyMarker]) -> ca.SX: ...


def measures(
    m: Mechanism, places: Displacements, q: ca.SX, v: ca.SX, a: ca.SX
) -> tuple[list[ca.SX], list[Variable], dict[str, ca.SX]]:
    """Return values and variables of the requested measures, and the angles of hinges in the plane by output."""
    values: list[ca.SX] = []
    outputs: list[Variable] = []
    angles: dict[str, ca.SX] = {}

    def add(name: str, value: ca.SX, unit: str, text: str) -> None:
        values.append(value)
        outputs.append(Variable(name, unit, description=text))

    for joint in m.measured_joints():
        x, unit, j = places.free(joint), "rad" if joint.kind == "revolute" else "m", joint.name
        rate = ca.jtimes(x, q, v)
        second = ca.jtimes(rate, q, v) + ca.jtimes(x, q, a)
        of, along, along_twice = (f"{j}.{suffix}" for suffix in FREE[joint.kind])
        add(of, x, unit, f"{FREE[joint.kind][0]} of {joint.second.body.name} from {joint.first.body.name} in {j}")
        add(along, rate, rate_of(unit), f"rate of {of}")
        add(along_twice, second, rate_of(rate_of(unit)), f"second rate of {of}")
        if isinstance(joint, Joint) and unit == "rad":
            angles[of] = x
    for name, spring in m.measured_springs():
        between = spring.between
        joint_unit = "rad" if isinstance(between, AnyJoint) and between.kind != "prismatic" else "m"
        x = places.counted(between) if isinstance(between, AnyJoint) else places.distance(between)
        rate = ca.jtimes(x, q, v)
        effort = spring.stiffness * (x - spring.rest) + spring.damping * rate
        what = "torque" if joint_unit == "rad" else "force"
        said = "in tension" if not isinstance(between, AnyJoint) else f"against the motion of {between.name}"
        stretch = x - spring.rest
        add(f"{name}.elongation", stretch, joint_unit, f"of {name}, from where it is at rest")
        stretching = ca.jtimes(stretch, q, v)  # The rest length may vary, too.
        add(f"{name}.elongation_rate", stretching, rate_of(joint_unit), f"rate of {name}.elongation")
        add(f"{name}.{what}", ca.SX(effort), EFFORTS[joint_unit], f"{what} of {name}, positive {said}")
    return values, outputs, angles
