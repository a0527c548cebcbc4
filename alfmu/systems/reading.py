"""Read systems from SSP archives of untrusted origin: checked completely, never executed."""

import math
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote
from xml.etree import ElementTree as ET

from ..fmi.drive import checked_archive
from ..fmi.markup import tree
from ..model.errors import InputError
from ..model.words import in_words, there_is
from .description import Component, Connection, Description
from .masters import MASTERS
from .ssp import DESCRIPTION, OSP, OWN, VERSIONS, tag

_LARGEST = 16_000_000
"""Largest size of a description or a parameter set in bytes."""


def read(path: Path) -> dict[str, Any]:
    """Return the fields of the `Description` in an SSP, checked completely; nothing in it is executed.

    Unsupported features are rejected by name: systems in systems, signal dictionaries, parameter mappings, FMUs outside
    the archive. FMUs are checked when they are opened.
    """
    checked_archive(path, "an SSP")
    with zipfile.ZipFile(path) as opened:
        names = set(opened.namelist())
        root = _parsed(path, opened, names, DESCRIPTION, "ssd:SystemStructureDescription")
        try:
            return _system(path, opened, names, root)
        except InputError as error:
            said = str(error)
            raise InputError(said if said.startswith(str(path)) else f"{path}: {said}") from None


def unpacked(system: Description, folder: Path) -> None:
    """Unpack the FMUs of a system's archive into a folder."""
    assert system.archive is not None
    checked_archive(system.archive, "an SSP")  # it may have changed since it was read
    with zipfile.ZipFile(system.archive) as opened:
        for place in {str(c.what) for c in system.components.values() if c.kind == "fmu"}:
            target = folder / place
            target.parent.mkdir(parents=True, exist_ok=True)
            try:
                target.write_bytes(opened.read(place))
            except KeyError:
                raise InputError(f"{system.archive} has no {place} any more") from None


def _parsed(path: Path, opened: zipfile.ZipFile, names: set[str], name: str, element: str) -> ET.Element:
    """Return the root of an XML file of the archive."""
    if name not in names:
        raise InputError(f"{path} has no {name}")
    if opened.getinfo(name).file_size > _LARGEST:
        raise InputError(f"{path}: {name} has more than {_LARGEST:.0e} bytes")
    root = tree(opened.read(name), f"{path}: {name}")
    if root.tag != tag(element):
        raise InputError(f"{path}: {name} is no {element.partition(':')[2]} of SSP")
    if (version := root.get("version", "")).partition("-")[0] not in VERSIONS:
        raise InputError(f"{path}: {name} is of SSP {version!r}; alfmu reads {in_words(VERSIONS)}")
    return root


def _system(path: Path, opened: zipfile.ZipFile, names: set[str], root: ET.Element) -> dict[str, Any]:
    top = _one(root, "ssd:System", "the description")
    for part in ("ssd:SignalDictionaries",):
        if top.find(tag(part)) is not None:
            raise InputError(f"the system has {part.partition(':')[2]}, which alfmu does not support")
    if top.find(tag("ssd:Connectors")) is not None:
        raise InputError("the system has connectors of its own, which alfmu does not support; connect components alone")
    components: dict[str, Component] = {}
    connectors: dict[str, dict[str, ET.Element]] = {}
    for each in _children(top, "ssd:Elements"):
        kind = each.tag.rpartition("}")[2]
        if each.tag != tag("ssd:Component"):
            raise InputError(f"the system has a {kind} {each.get('name')!r}, which alfmu does not support")
        name = each.get("name", "")
        if name in components:
            raise InputError(f"two components are called {name!r}")
        components[name] = _read_component(path, opened, names, name, each)
        connectors[name] = _read_connectors(name, each)
    values, units = _bindings(path, opened, names, top, "the system")
    for name, value in values.items():
        component, _, variable = name.partition(".")
        if (known := components.get(component)) is None:
            raise InputError(f"the system binds {name!r}, which is of no component; {there_is(component, components)}")
        stated = {variable: units[name]} if name in units else {}
        parameters, units_of_all = {**known.parameters, variable: value}, {**known.units, **stated}
        components[component] = replace(known, parameters=parameters, units=units_of_all)
    connections = [_read_connection(each, connectors) for each in _children(top, "ssd:Connections")]
    experiment = root.find(tag("ssd:DefaultExperiment"))
    own: dict[str, Any] = {}
    if experiment is not None:
        for key, field in (("startTime", "start_time"), ("stopTime", "stop_time")):
            if key in experiment.attrib:
                own[field] = _number(f"{key} of the experiment", experiment.get(key))
        own |= _read_annotations(experiment)
    name = root.get("name") or top.get("name") or path.stem
    own |= {"archive": path, "description": top.get("description", "")}
    return {"name": name, "components": components, "connections": connections, **own}


def _read_component(path: Path, opened: zipfile.ZipFile, names: set[str], name: str, each: ET.Element) -> Component:
    kind = each.get("type", "application/x-fmu-sharedlibrary")
    if kind != "application/x-fmu-sharedlibrary":
        raise InputError(f"the component {name} is of type {kind!r}; alfmu runs FMUs")
    if (how := each.get("implementation", "any")) not in ("any", "CoSimulation"):
        raise InputError(f"the component {name} asks for {how}; alfmu runs FMUs for co-simulation")
    source = _place(f"the component {name}", each.get("source"), names)
    values, units = _bindings(path, opened, names, each, f"the component {name}")
    for connector, one in _read_connectors(name, each).items():
        stated = [kind.get("unit", "") for kind in one.iter(tag("ssc:Real")) if kind.get("unit")]
        if stated:
            units[connector] = stated[0]
    return Component(name, "fmu", source, parameters=values, units=units)


def _place(what: str, source: str | None, names: set[str]) -> str:
    """Return the file of a URI relative to the archive, whose names were checked to stay inside."""
    place = PurePosixPath(unquote(source or "").removeprefix("./")).as_posix()
    if place not in names:
        raise InputError(f"{what} is {source!r}, which is not a file in the archive; alfmu reads no other")
    return place


def _read_connectors(component: str, each: ET.Element) -> dict[str, ET.Element]:
    found: dict[str, ET.Element] = {}
    for one in _children(each, "ssd:Connectors"):
        name = one.get("name", "")
        if name in found:
            raise InputError(f"the component {component} has two connectors {name!r}")
        if one.get("kind") not in (
            "input",
            "output",
            "parameter",
            "calculatedParameter",
            "inout",
            "structuralParameter",
        ):
            raise InputError(f"the connector {component}.{name} is of kind {one.get('kind')!r}")
        found[name] = one
    return found


def _read_connection(each: ET.Element, connectors: Mapping[str, Mapping[str, ET.Element]]) -> Connection:
    ends = []
    for side in ("start", "end"):
        component, name = each.get(f"{side}Element"), each.get(f"{side}Connector", "")
        if component is None:
            raise InputError(f"a connection of {name!r} ends at the system itself, which alfmu does not support")
        if component not in connectors:
            raise InputError(f"a connection ends at {component!r}; {there_is(component, connectors)}")
        if name not in connectors[component]:
            raise InputError(f"{component} has no connector {name!r}; {there_is(name, connectors[component])}")
        ends.append((f"{component}.{name}", connectors[component][name].get("kind")))
    # SSP allows either direction of a connection.
    if ends[0][1] == "input" and ends[1][1] == "output":
        ends.reverse()
    if (ends[0][1], ends[1][1]) != ("output", "input"):
        raise InputError(
            f"a connection goes from {ends[0][0]} ({ends[0][1]}) to {ends[1][0]} ({ends[1][1]}); alfmu "
            "connects outputs to inputs"
        )
    factor, offset = 1.0, 0.0
    for one in each:
        kind = one.tag.rpartition("}")[2]
        if one.tag == tag("ssc:LinearTransformation"):
            factor = _number("the factor of a connection", one.get("factor", "1"))
            offset = _number("the offset of a connection", one.get("offset", "0"))
        elif kind not in ("ConnectionGeometry", "Annotations"):
            raise InputError(f"the connection {ends[0][0]} -> {ends[1][0]} has a {kind}, which alfmu does not support")
    suppressed = each.get("suppressUnitConversion", "false") in ("true", "1")
    return Connection(ends[0][0], ends[1][0], factor, offset, "none" if suppressed else "*")


def _bindings(
    path: Path, opened: zipfile.ZipFile, names: set[str], each: ET.Element, what: str
) -> tuple[dict[str, float | str], dict[str, str]]:
    """Return values of parameters bound to an element, and their units."""
    found: dict[str, float | str] = {}
    units: dict[str, str] = {}
    for one in _children(each, "ssd:ParameterBindings"):
        if one.find(tag("ssd:ParameterMapping")) is not None:
            raise InputError(f"{what} has a parameter mapping, which alfmu does not support")
        if one.get("sourceBase", "SSD") != "SSD":
            raise InputError(f"{what} has parameters relative to its FMU, which alfmu does not support")
        if (kind := one.get("type", "application/x-ssp-parameter-set")) != "application/x-ssp-parameter-set":
            raise InputError(f"{what} has parameters of type {kind!r}, which alfmu does not support")
        if one.get("source") is not None:
            place = _place(f"a parameter set of {what}", one.get("source"), names)
            table = _parsed(path, opened, names, place, "ssv:ParameterSet")
        else:
            values = _one(one, "ssd:ParameterValues", f"a parameter binding of {what}")
            table = _one(values, "ssv:ParameterSet", f"a parameter binding of {what}")
        prefix = one.get("prefix", "")
        for each_value in _children(table, "ssv:Parameters"):
            name = prefix + each_value.get("name", "")
            if name in found:
                raise InputError(f"{what} has two values of {name!r}")
            found[name] = _value(f"the parameter {name} of {what}", each_value)
            if unit := next((one.get("unit") for one in each_value if one.get("unit")), None):
                units[name] = unit
    return found, units


def _value(what: str, each: ET.Element) -> float | str:
    held = [one for one in each if one.tag.rpartition("}")[2] != "Annotations"]
    kind = held[0].tag.rpartition("}")[2] if held else "nothing"
    text = held[0].get("value") if held else None
    if len(held) != 1 or text is None:
        raise InputError(f"{what} has {kind} without a value, or several")
    if kind in ("Real", "Integer"):
        number = _number(what, text)
        if kind == "Integer" and not number.is_integer():
            raise InputError(f"{what} is {text!r}; an Integer is a whole number")
        return number
    if kind == "Boolean":
        if text not in ("true", "false", "0", "1"):
            raise InputError(f"{what} is {text!r}; a Boolean is true or false")
        return text in ("true", "1")
    if kind in ("String", "Enumeration"):
        return text
    raise InputError(f"{what} is a {kind}, which alfmu does not support")


def _read_annotations(experiment: ET.Element) -> dict[str, Any]:
    """Return the master settings in annotations, alfmu's own before those of the Open Simulation Platform."""
    own: dict[str, Any] = {}
    found = {each.get("type"): each for each in _children(experiment, "ssd:Annotations")}
    if OSP in found:
        fixed = found[OSP].find(f".//{tag('osp:FixedStepAlgorithm')}")
        if fixed is None:  # accept any namespace
            fixed = next((e for e in found[OSP].iter() if e.tag.rpartition("}")[2] == "FixedStepAlgorithm"), None)
        if fixed is not None:
            own["communication_step"] = _number("baseStepSize", fixed.get("baseStepSize"))
    if OWN in found and (master := found[OWN].find(tag("alfmu:Master"))) is not None:
        own["communication_step"] = _number("communicationStep", master.get("communicationStep"))
        own["master"] = master.get("algorithm", next(iter(MASTERS)))
    return own


def _number(what: str, text: str | None) -> float:
    try:
        value = float(text if text is not None else "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{what} is {text!r}; it must be a finite number")
    return value


def _one(parent: ET.Element, name: str, what: str) -> ET.Element:
    found = parent.findall(tag(name))
    if len(found) != 1:
        raise InputError(f"{what} has {len(found)} elements {name.partition(':')[2]}; it must have one")
    return found[0]


def _children(parent: ET.Element, name: str) -> list[ET.Element]:
    found = parent.find(tag(name))
    return [] if found is None else list(found)
