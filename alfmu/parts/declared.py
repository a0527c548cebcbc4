"""Common services of the parts: their parameters, and units that follow from others."""

from __future__ import annotations

from typing import Any

import casadi as ca

from ..model.kinematics import Kinematics
from ..model.mechanism import Mechanism
from ..model.parts import Joint, Scalar, stack
from ..model.spatial import SpatialJoint

__all__ = ["label", "mounted", "named", "of", "rate_of_joint"]


def label(part: str, name: str) -> str:
    """Return the name of a quantity of a part; as it is where the part is a mechanism of its own, without a name."""
    return f"{part}.{name}" if part else name


def of(part: str) -> str:
    """of the part, where it has a name."""
    return f" of {part}" if part else ""


def named(
    m: Mechanism,
    part: str,
    name: str,
    value: Scalar,
    unit_name: str,
    description: str,
    minimum: float | None = None,
    maximum: float | None = None,
) -> Any:
    """Return a number as the parameter `<part>.<name>` of the mechanism; an expression stays what it is."""
    if isinstance(value, ca.SX):
        return value
    return m.parameter(
        label(part, name),
        value,
        unit_name,
        minimum=minimum,
        maximum=maximum,
        description=f"{description.rstrip(',') if not part else description}{of(part)}",
    )


def mounted(
    m: Mechanism,
    part: str,
    body: str,
    joint: Joint | SpatialJoint,
    ratio: Scalar,
    torque: Scalar,
    inertia: Scalar,
    damping: Scalar,
) -> None:
    """A torque on a joint, by a body in a bearing on the first body where that has inertia; it turns `ratio` times as
    fast as the joint. In space that body is a thin disc about the axis of the joint."""
    if not isinstance(inertia, ca.SX) and inertia == 0:
        m.drive(joint, ratio * torque)
        if isinstance(damping, ca.SX):
            m.spring_damper(joint, damping=ratio**2 * damping)
        return
    J = named(m, part, "inertia", inertia, "kg.m2", f"inertia of the {body}", minimum=0.0)
    turned = ratio * Kinematics(m).counted(joint)
    bearing: Joint | SpatialJoint
    if isinstance(joint, SpatialJoint):
        disc = m.spatial_body(label(part, body), mass=0.0, inertia=(J / 2, J / 2, J), relative=True)
        axes: dict[str, Any] = {"axis": joint.axes[0], "second_axis": (0.0, 0.0, 1.0)}
        bearing = m.spatial_revolute(label(part, "bearing"), joint.first, disc.at(), coordinate=turned, **axes)
    else:
        turning = m.body(label(part, body), mass=0.0, inertia=J)
        bearing = m.revolute(label(part, "bearing"), joint.first, turning.at(), coordinate=turned)
    m.drive(bearing, torque)
    if isinstance(damping, ca.SX):
        m.friction(bearing, damping)


def rate_of_joint(m: Mechanism, joint: Joint | SpatialJoint) -> ca.SX:
    """Return the rate of the free displacement of a joint: coordinates, or a law of time beside them."""
    moving, rates = stack([m.time, *(c.q for c in m.coordinates)]), stack([1.0, *(c.v for c in m.coordinates)])
    return ca.jtimes(Kinematics(m).free(joint), moving, rates)
