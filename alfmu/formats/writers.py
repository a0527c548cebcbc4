"""Write a mechanism as MJCF, URDF or SDF.

In MJCF joints keep their displacements (`ref`); in URDF and SDF displacements are
counted from the start.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from ..model.mechanism import Mechanism
from .described import Form, described
from .linkage import ANYWHERE, Joint, Link, Linkage
from .poses import Array, Pose, about, quaternion

_LEAST = 1e-15
"""Least mass [kg] and moment of inertia [kg.m2] of a moving body in MuJoCo."""

_NEAR = 1e-9
"""Distance [m] and share of a right angle within which two hinges are a universal joint."""

_GRAVITY = 9.81
"""Gravity [m/s2] of a URDF, along -z."""

_HINGED = {"revolute": "hinge", "prismatic": "slide", "spherical": "ball", "free": "free"}
_KINDS = {"spherical": "ball", "free": "floating", "weld": "fixed"}
"""Names of kinds of joints in MJCF, and those in URDF and SDF that differ from alfmu's."""


def written(
    mechanism: Mechanism, numbers: Sequence[Mapping[str, float]], constraints: Array, suffix: str
) -> tuple[bytes, Linkage]:
    """Return a file and the linkage that it describes; see `described` for the arguments and the refusals."""
    form, write = FORMS[suffix]
    linkage = described(mechanism, numbers, constraints, form)
    root = write(linkage)
    linkage.judge()
    indent(root)
    return tostring(root, encoding="utf-8", xml_declaration=True) + b"\n", linkage


def _text(*values: Any) -> str:
    """Return a text unchanged, or numbers with all their digits."""
    if isinstance(values[0], str):
        return values[0]
    return " ".join(repr(float(x) + 0.0) for value in values for x in np.clip(np.ravel(value), -1e16, 1e16))


def _add(parent: Element, tag: str, *text: Any, **given: Any) -> Element:
    """Add an element with its text and attributes, each numbers or text; attributes that are None are omitted."""
    child = SubElement(parent, tag, {key: _text(x) for key, x in given.items() if x is not None})
    child.text = _text(*text) if text else None
    return child


def _filled(parent: Element, tag: str, **given: float | None) -> Element:
    """Add an element with a child for each number that is not None; add nothing if all are None."""
    found = {key: x for key, x in given.items() if x is not None}
    child = SubElement(parent, tag) if found else parent
    for key, x in found.items():
        _add(child, key, x)
    return child


def _limits(joint: Joint, zero: float = 0.0) -> tuple[float, float] | None:
    """Return the limits of a joint counted from `zero`, None if it has none."""
    low, high = joint.limits[0] if joint.limits else (-ANYWHERE, ANYWHERE)
    return (low - zero, high - zero) if low > -ANYWHERE or high < ANYWHERE else None


def _started(linkage: Linkage, hint: str) -> None:
    """Warn of rates and inputs at the start that the file cannot represent."""
    if any(any(joint.rates) for joint in linkage.joints):
        linkage.warn("rates at the start", linkage.node)
    for motor in linkage.motors:
        if motor.start:
            linkage.warn(f"the start value of {motor.name}", linkage.node)
        if hint:
            linkage.warn(f"the input {motor.name}; {hint}{motor.along[0][0].name} adds it again", linkage.node)


# MJCF -----------------------------------------------------------------------------------------------------------


def _mjcf(linkage: Linkage) -> Element:
    twists, paths, _ = linkage.twists
    root = Element("mujoco", model=linkage.name)
    _add(root, "compiler", angle="radian")
    _add(root, "option", gravity=linkage.gravity)
    bodies: dict[Link | None, Element] = {None: _add(root, "worldbody")}
    massive = {link for link in linkage.links if link.inertial.mass}
    for link in linkage.links[::-1]:  # a link without joints adds its mass to its parent
        massive |= {link.parent} if link in massive and not link.joints and link.parent else set()
    for link in linkage.links:
        x, inertia, at = link.inertial, link.inertial.inertia, link.pose
        body = _add(bodies[link.parent], "body", name=link.name, pos=at.place, quat=quaternion(at.turn))
        bodies[link] = body
        if not inertia.any() and not twists[paths[link], :3].any():
            inertia = x.mass * np.eye(3)  # MuJoCo requires an inertia even of a body that cannot turn
        if link.joints and (link not in massive or (x.mass and np.linalg.eigvalsh(inertia).min() < _LEAST)):
            what = "a moment of inertia that is zero" if link in massive else "no mass"
            linkage.refuse(link.name, f"it has {what}, and moving bodies of MuJoCo have both; give it small ones")
        if x.mass or inertia.any():
            full = (*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2])
            given: dict[str, Any] = {"fullinertia": full} if any(full[3:]) else {"diaginertia": full[:3]}
            _add(body, "inertial", pos=x.center, mass=x.mass, **given)
        for joint in link.joints:
            given = {"name": joint.name, "type": _HINGED[joint.kind]}
            if joint.kind != "free":
                given |= {"pos": joint.point, "damping": joint.damping[0], "armature": joint.armature}
            if joint.axes:
                given |= {"axis": joint.axes[0], "ref": joint.reference, "range": _limits(joint)}
                given |= {"stiffness": joint.stiffness[0], "springref": joint.rest[0]}
                given |= {"frictionloss": joint.friction[0], "actuatorfrcrange": joint.effort}
            _add(body, "joint", **{key: x for key, x in given.items() if not isinstance(x, float) or x})
    tendon, equality, actuator = (Element(tag) for tag in ("tendon", "equality", "actuator"))
    flat = not twists[:, (0, 1, 5)].any()
    for closure in linkage.closures:
        (one, frame), (two, _) = sorted((closure.first, closure.second), key=lambda x: x[0] is None)
        assert one is not None
        ends = {"body1": one.name, "body2": two.name if two else "world"}
        if closure.joint.kind == "weld":
            _add(equality, "weld", name=closure.joint.name, **ends)
            continue
        # A hinge takes two points on its axis, or one point in a plane.
        for k in (0, 1) if closure.joint.axes and not flat else (0,):
            anchor = frame.at(k * closure.joint.axes[0] if k else np.zeros(3))
            _add(equality, "connect", name=closure.joint.name + "_axis" * k, anchor=anchor, **ends)
    for coupling in linkage.couplings:
        if len(coupling.of) > 1:
            fixed = _add(tendon, "fixed", name=coupling.name)
            for joint, factor in coupling.of:
                _add(fixed, "joint", joint=joint.name, coef=factor)
            _add(equality, "tendon", name=coupling.name, tendon1=coupling.name, polycoef=(0.0,) * 5)
            continue
        (joint, _), by = coupling.of[0], coupling.by[0][0].name if coupling.by else None
        numbers = [*coupling.coefficients, *[0.0] * 5][:5]
        _add(equality, "joint", name=coupling.name, joint1=joint.name, joint2=by, polycoef=numbers)
    for each in linkage.tendons:
        sign = -1.0 if each.rest == (-1.0, -1.0) else 1.0  # this length stands for that at the start
        given = {key: getattr(each, key) or None for key in ("stiffness", "damping", "armature")}
        given |= {"springlength": sorted(sign * x for x in each.rest) if each.stiffness else None}
        given |= {"range": sorted(sign * x for x in each.limits) if each.limits else None}
        fixed = _add(tendon, "fixed", name=each.name, **given)
        for joint, factor in each.along:
            _add(fixed, "joint", joint=joint.name, coef=sign * factor)
    for motor in linkage.motors:
        given = {"name": motor.name, "joint": motor.along[0][0].name, "ctrlrange": motor.control}
        if len(motor.along) > 1:
            given |= {"joint": None, "tendon": motor.name}
            fixed = _add(tendon, "fixed", name=motor.name)
            for joint, factor in motor.along:
                _add(fixed, "joint", joint=joint.name, coef=factor)
        if any(motor.bias) or motor.force:
            given |= {"gainprm": motor.gain, "biastype": "affine", "biasprm": motor.bias, "forcerange": motor.force}
            _add(actuator, "general", **given)
        else:
            _add(actuator, "motor", **given, gear=motor.gain)
    root.extend(part for part in (tendon, equality, actuator) if len(part))
    start, rates = ([x for j in linkage.joints for x in getattr(j, which)] for which in ("start", "rates"))
    controls = [motor.start for motor in linkage.motors]
    _add(_add(root, "keyframe"), "key", name="start", qpos=start, qvel=rates, ctrl=controls if any(controls) else None)
    return root


# URDF -----------------------------------------------------------------------------------------------------------


def _urdf(linkage: Linkage) -> Element:
    root = Element("robot", name=linkage.name)
    names: dict[Link | None, str] = {None: "world"}
    shifts: dict[Link | None, Array] = {None: np.zeros(3)}
    """Origins of the links of the file, which are points of their joints, in the frames of links."""
    _add(root, "link", name=names[None])
    upright, joints = Pose(np.zeros(3), _upright(linkage)), dict[Joint, Element]()
    for link in linkage.links:
        before, x, pose = names[link.parent], link.inertial, link.pose
        pose = Pose(pose.place - shifts[link.parent], pose.turn) if link.parent else upright @ pose
        shift = np.zeros(3)
        for joint in link.joints or [Joint(f"{link.name}_fixed", "weld", linkage.node)]:
            names[link] = link.name if not link.joints or joint is link.joints[-1] else f"{link.name}_{joint.name}"
            at = Pose(pose.at(joint.point - shift), pose.turn)
            joints[joint] = _urdf_joint(root, joint, before, names[link], at)
            pose, shift, before = Pose(), joint.point, names[link]
            made = _add(root, "link", name=before)
        shifts[link] = shift
        if x.mass or x.inertia.any():
            inertial = _add(made, "inertial")
            _add(inertial, "origin", xyz=x.center - shift)
            _add(inertial, "mass", value=x.mass)
            _add(inertial, "inertia", **_moments(x.inertia))
        if link in linkage.lifted:
            _add(_add(root, "gazebo", reference=link.name), "turnGravityOff", "true")
    for closure in linkage.closures:
        kind = _KINDS.get(closure.joint.kind, closure.joint.kind)
        loop = _add(root, "loop_joint", name=closure.joint.name, type=kind)
        for tag, (end, frame) in (("link1", closure.first), ("link2", closure.second)):
            at = upright @ frame if end is None else Pose(frame.place - shifts[end], frame.turn)
            _add(loop, tag, link=names[end], xyz=at.place, rpy=_angles(at.turn))
        for axis in closure.joint.axes:
            _add(loop, "axis", xyz=axis)
    for coupling in linkage.couplings:
        follower = joints[coupling.of[0][0]]
        if follower.find("mimic") is not None:
            linkage.refuse(coupling.name, f"{coupling.of[0][0].name} follows another joint already")
        _add(follower, "mimic", joint=coupling.by[0][0].name, multiplier=coupling.coefficients[1], offset=0.0)
    for motor in linkage.motors:
        transmission = _add(root, "transmission", name=motor.name)
        _add(transmission, "type", "transmission_interface/SimpleTransmission")
        moved = _add(transmission, "joint", name=motor.along[0][0].name)
        _add(moved, "hardwareInterface", "hardware_interface/EffortJointInterface")
        _add(transmission, "actuator", name=f"{motor.name}_actuator")
    _started(linkage, "")
    return root


def _urdf_joint(root: Element, joint: Joint, parent: str, child: str, at: Pose) -> Element:
    """Add a joint, at the origin of its second link."""
    limits = _limits(joint, joint.reference)
    kind = "continuous" if joint.kind == "revolute" and not limits else _KINDS.get(joint.kind, joint.kind)
    made = _add(root, "drake:joint" if kind == "ball" else "joint", name=joint.name, type=kind)
    _add(made, "parent", link=parent)
    _add(made, "child", link=child)
    _add(made, "origin", xyz=at.place, rpy=_angles(at.turn))
    for axis in joint.axes:
        _add(made, "axis", xyz=axis)
        _add(made, "dynamics", damping=joint.damping[0], friction=joint.friction[0])
        low, high = limits or (-1e16, 1e16)
        effort = joint.effort[1] if joint.effort else 1e16
        if kind != "continuous" or joint.effort:
            _add(made, "limit", lower=low, upper=high, effort=effort, velocity=1e16)
    return made


def _upright(linkage: Linkage) -> Array:
    """Return the rotation of the ground that turns gravity to -z, where a URDF expects it."""
    g, down = np.array(linkage.gravity), np.array((0.0, 0.0, -1.0))
    size = float(np.linalg.norm(g))
    if not size:
        linkage.lifted |= {link: 1.0 for link in linkage.links if link.inertial.mass}
        return np.eye(3)
    if abs(size - _GRAVITY) > _NEAR:
        linkage.refuse("gravity", f"it is {size:g} m/s2; in a URDF it is {_GRAVITY} m/s2, or turned off")
    across = np.cross(g, down)
    sine = float(np.linalg.norm(across)) / size
    return about(across if sine > _NEAR else np.array((1.0, 0.0, 0.0)), float(np.arctan2(sine, g @ down / size)))


def _angles(turn: Array) -> Array:
    """Return roll, pitch and yaw about fixed axes, exact also for a pitch of 90 degrees."""
    yaw = np.arctan2(turn[1, 0], turn[0, 0])
    c, s = np.cos(yaw), np.sin(yaw)
    pitch = np.arctan2(-turn[2, 0], c * turn[0, 0] + s * turn[1, 0])
    return np.array((np.arctan2(s * turn[0, 2] - c * turn[1, 2], c * turn[1, 1] - s * turn[0, 1]), pitch, yaw))


def _moments(inertia: Array) -> dict[str, float]:
    return {f"i{'xyz'[i]}{'xyz'[k]}": inertia[i, k] for i in range(3) for k in range(i, 3)}


# SDF ------------------------------------------------------------------------------------------------------------


def _sdf(linkage: Linkage) -> Element:
    root = Element("sdf", version="1.11" if linkage.couplings else "1.9")
    world = _add(root, "world", name="default")
    _add(world, "gravity", linkage.gravity)
    model = _add(world, "model", name=linkage.name)
    poses: dict[Link | None, Pose] = {None: Pose()}
    for link in linkage.links:
        x, poses[link] = link.inertial, poses[link.parent] @ link.pose
        made = _add(model, "link", name=link.name)
        _add(made, "pose", poses[link].place, _angles(poses[link].turn))
        if not x.mass:
            linkage.refuse(link.name, "it has no mass, and links of SDF have one; give it a small one")
        inertial = _add(made, "inertial")
        _add(inertial, "pose", x.center, np.zeros(3))
        _add(inertial, "mass", x.mass)
        _filled(inertial, "inertia", **_moments(x.inertia))
    for link in linkage.links:
        if not any(joint.kind == "free" for joint in link.joints):
            _sdf_joint(linkage, model, link.joints, link.parent, link)
    for closure in linkage.closures:
        sign = -1 if closure.second[0] is None else 1
        (parent, _), (child, frame) = (closure.first, closure.second)[::sign]
        assert child is not None
        parts = [replace(closure.joint, axes=(axis,)) for axis in closure.joint.axes] or [closure.joint]
        for part in parts:
            part.point, part.axes = frame.place, tuple(sign * frame.turn @ axis for axis in part.axes)
            part.kind = "revolute" if part.kind == "universal" else part.kind
        _sdf_joint(linkage, model, parts[::sign], parent, child)
    _started(linkage, "--option drives=")
    return root


def _sdf_joint(linkage: Linkage, model: Element, joints: list[Joint], parent: Link | None, child: Link) -> None:
    """Add the SDF joint with the motions of these joints, in the frame of the child."""
    first = joints[0] if joints else Joint(f"{child.name}_fixed", "weld", linkage.node)
    kind, name = _KINDS.get(first.kind, first.kind), first.name
    if len(joints) > 1:
        one, two = joints[:2]
        square = one.kind == two.kind == "revolute" and abs(one.axes[0] @ two.axes[0]) < _NEAR
        if len(joints) > 2 or not square or np.abs(one.point - two.point).max() > _NEAR:
            what = "motions that no single joint of SDF has, and SDF has no links without mass between joints"
            linkage.refuse(child.name, f"it has {what}; give a body with mass between them")
        kind, name = "universal", name.removesuffix(".angle1").removesuffix(".angle2")
    made = _add(model, "joint", name=name, type=kind)
    _add(made, "pose", first.point, np.zeros(3))
    _add(made, "parent", parent.name if parent else "world")
    _add(made, "child", child.name)
    if kind == "screw":
        _add(made, "screw_thread_pitch", first.lead)
    for tag, joint in zip(("axis", "axis2"), joints if first.axes else (), strict=False):
        axis, limits = _add(made, tag), _limits(joint, joint.reference)
        _add(axis, "xyz", joint.axes[0])
        low, high = limits or (None, None)
        _filled(axis, "limit", lower=low, upper=high, effort=joint.effort[1] if joint.effort else None)
        sizes = {"damping": joint.damping[0] or None, "friction": joint.friction[0] or None}
        if joint.stiffness[0]:
            sizes |= {"spring_stiffness": joint.stiffness[0], "spring_reference": joint.rest[0] - joint.reference}
        _filled(axis, "dynamics", **sizes)
        for coupling in linkage.couplings:
            if coupling.of[0][0] is joint:
                mimic = _filled(axis, "mimic", multiplier=coupling.coefficients[1], offset=0.0, reference=0.0)
                mimic.set("joint", coupling.by[0][0].name)


FORMS: dict[str, tuple[Form, Callable[[Linkage], Element]]] = {
    ".xml": (Form("MJCF", ("revolute", "spherical", "weld"), full=True), _mjcf),
    ".urdf": (Form("URDF", ("revolute", "prismatic", "spherical", "weld"), springs=False), _urdf),
    ".sdf": (Form("SDF", ("revolute", "prismatic", "spherical", "weld", "universal", "screw")), _sdf),
}
"""Formats by file suffix: the abilities of the format and its writer."""
