"""Helpers of the parts: parameters, and units derived from others."""

from __future__ import annotations

from typing import Any

import casadi as ca

from ..model.kinematics import Kinematics
from ..model.mechanism import Mechanism
from ..model.parts import Joint, Scalar, stack
from ..model.spatial import SpatialJoint


def label(part: str, name: str) -> str:
    """Return the name of a quantity of a part, without a prefix if the part has no name."""
    return f"{part}.{name}" if part else name


def of(part: str) -> str:
    """Return " of the part" if it has a name."""
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
    """Return a number as the parameter `<part>.<name>` of the mechanism, and an expression unchanged."""
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
    """Add a torque on a joint, through a body in a bearing on the first body if it has inertia.

    The body rotates `ratio` times as fast as the joint; in space it is a thin disc about the axis of the joint.
    """
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
    """Return the rate of the free displacement of a joint, due to coordinates and a law of time."""
    moving, rates = stack([m.time, *(c.q for c in m.coordinates)]), stack([1.0, *(c.v for c in m.coordinates)])
    return ca.jtimes(Kinematics(m).free(joint), moving, rates)
