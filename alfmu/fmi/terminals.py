"""Terminals of an FMU: shafts with torque, angle and speed, sliders with force, position and speed."""

from collections.abc import Collection
from xml.etree import ElementTree as ET

import casadi as ca

from ..model.mechanism import Mechanism
from .markup import written

_MEMBERS = {
    "N.m": {"torque": "", "angle": "angle", "angular_velocity": "angular_velocity"},
    "N": {"force": "", "position": "position", "velocity": "velocity"},
}
"""Members of a terminal, the first its driving input, with suffixes of their variables, by the unit of that input."""


def terminals(mechanism: Mechanism, names: Collection[str]) -> dict[str, dict[str, str]]:
    """Return the variables (of those in `names`) that are members of each terminal, by its name.

    An input that drives a joint forms a terminal with the motion of that joint, or of the body that it turns against
    the ground.
    """
    found = {}
    for each in mechanism.inputs:
        stem = each.name.rpartition(".")[0]
        bodies = [
            drive.joint.second.body.name
            for drive in mechanism.drives
            if getattr(drive.joint.first, "body", None) is mechanism.ground
            and ca.depends_on(ca.SX(drive.effort), each.symbol)
        ]
        (first, _), *others = _MEMBERS.get(each.unit, {"": ""}).items()
        for owner in (stem, *bodies):
            members = {first: each.name, **{member: f"{owner}.{output}" for member, output in others}}
            if stem and others and set(members.values()) <= set(names):
                found[stem] = members
                break
    return found


def document(found: dict[str, dict[str, str]]) -> bytes:
    """Return terminalsAndIcons.xml (FMI 3.0), for an icon.png beside it."""
    root = ET.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    picture = ET.SubElement(root, "GraphicalRepresentation")
    square = {"x1": "-100", "y1": "-100", "x2": "100", "y2": "100"}
    ET.SubElement(picture, "CoordinateSystem", square, suggestedScalingFactorTo_mm="0.1")
    ET.SubElement(picture, "Icon", square)
    every = ET.SubElement(root, "Terminals") if found else root
    for name, members in found.items():
        what = " and ".join((", ".join(list(members)[:-1]), list(members)[-1])).replace("_", " ")
        terminal = ET.SubElement(
            every,
            "Terminal",
            name=name,
            matchingRule="bus",
            description=f"{what}: the effort is an input, the motion an output",
        )
        for member, variable in members.items():
            ET.SubElement(
                terminal, "TerminalMemberVariable", variableName=variable, memberName=member, variableKind="signal"
            )
    return written(root)
