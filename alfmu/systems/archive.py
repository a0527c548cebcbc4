"""Systems as SSP archives: written with FMUs, units, parameter sets and the annotation of the master; read back as what
they are, data from somewhere else.
"""

from __future__ import annotations

import importlib.metadata
import math
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any
from xml.etree import ElementTree as ET

from ..files import scratch
from ..fmi.drive import check_archive
from ..fmi.export import archive, export
from ..model.errors import ExportError, InputError
from ..model.words import in_words, there_is
from .description import MASTERS, Component, Connection, System
from .ports import Measure, Port
from .slaves import Slave, recipe_of

__all__ = ["VERSIONS", "read", "unpacked", "write"]

VERSIONS = ("1.0", "2.0")
"""Of SSP."""

_SPACES = {
    "ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription",
    "ssc": "http://ssp-standard.org/SSP1/SystemStructureCommon",
    "ssv": "http://ssp-standard.org/SSP1/SystemStructureParameterValues",
    "osp": "https://open-simulation-platform.com/SSP/OSPAnnotations",
    "alfmu": "urn:alfmu:system",
}
"""Prefixes, which libcosim and ecos take as part of the names, and namespaces."""

_DESCRIPTION = "SystemStructure.ssd"
_OSP, _OWN = "com.opensimulationplatform", "alfmu"
_SET = "defaults"
"""Name of the parameter sets of all components; ecos applies sets by name."""

_LARGEST = 16_000_000
"""Bytes of a description or a parameter set, at most."""

_TYPES = ("Real", "Integer", "Boolean")


# Write ---------------------------------------------------------------------------------------------------------------


def write(system: System, path: str | Path | None, version: str) -> Path:
    """Write a system as an SSP; see `System.export`."""
    if version not in VERSIONS:
        raise InputError(f"{system.name}: there is no SSP {version!r}; use {in_words(VERSIONS)}")
    path = Path(path or f"{system.name}.ssp")
    if path.suffix != ".ssp":
        raise ExportError(f"{system.name}: {path} does not end in .ssp")
    from .run import Assembly

    files: dict[str, bytes] = {}
    with scratch() as folder:
        packed: dict[str, Component] = {}
        for component in system.components.values():
            data = _fmu(system, component, folder)
            place = next((name for name, known in files.items() if known == data), f"resources/{component.name}.fmu")
            files[place] = data
            (folder / place).parent.mkdir(exist_ok=True)
            (folder / place).write_bytes(data)
            given = component.parameters if component.kind == "fmu" else {}
            packed[component.name] = Component(component.name, "fmu", place, parameters=given)
        as_fmus = system.changed(components=packed, folder=folder)
        object.__setattr__(as_fmus, "archive", None)
        with Assembly(as_fmus) as assembly:  # all connections are checked with the FMUs that are packed
            for slave in assembly.slaves:
                values = {**system.components[slave.name].parameters, **_constants(system, slave.name)}
                if numbers := _parameter_set(slave, values, version):
                    files[f"resources/{slave.name}.ssv"] = numbers
            files[_DESCRIPTION] = _described(system, assembly, packed, files, version)
    archive(path, files)
    return path


def _fmu(system: System, component: Component, folder: Path) -> bytes:
    """The FMU of a component."""
    if component.kind != "fmu":
        # Values of inputs are defaults, too: fmpy applies no parameter set by itself.
        constants = _constants(system, component.name)
        recipe = recipe_of(component).changed(kind="native", reference=False, parameters=constants)
        return export(recipe, folder / f"{component.name}.fmu").read_bytes()
    if system.archive is not None:
        with zipfile.ZipFile(system.archive) as opened:
            return opened.read(str(component.what))
    try:
        return (system.folder / str(component.what)).read_bytes()
    except OSError as error:
        raise InputError(f"{system.name}: cannot read {component.what} ({error.strerror})") from None


def _constants(system: System, component: str) -> dict[str, float]:
    """Values of inputs of a component that nothing is connected to."""
    parts = {name.partition(".")[2]: x for name, x in system.inputs.items() if name.partition(".")[0] == component}
    return dict(parts)


def _tag(name: str) -> str:
    prefix, _, local = name.partition(":")
    return f"{{{_SPACES[prefix]}}}{local}"


def _element(parent: ET.Element, name: str, attributes: Mapping[str, str] | None = None) -> ET.Element:
    return ET.SubElement(parent, _tag(name), dict(attributes or {}))


def _bytes(root: ET.Element) -> bytes:
    for prefix, space in _SPACES.items():
        ET.register_namespace(prefix, space)
    ET.indent(root)
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"


def _about() -> dict[str, str]:
    return {"generationTool": f"alfmu {importlib.metadata.version('alfmu')}"}


def _written(value: float) -> str:
    return repr(float(value)).removesuffix(".0")


def _units(parent: ET.Element, prefix: str, ports: list[Port]) -> None:
    """The definitions of the units of some variables."""
    found: dict[str, Measure] = {p.unit: p.measure for p in ports if p.unit and p.measure}
    if not found:
        return
    units = _element(parent, f"{prefix}:Units")
    for name in sorted(found):
        m = found[name]
        base = {key: str(power) for key, power in m.exponents}
        base |= {
            key: _written(x) for key, x, none in (("factor", m.factor, 1.0), ("offset", m.offset, 0.0)) if x != none
        }
        _element(_element(units, "ssc:Unit", {"name": name}), "ssc:BaseUnit", base)


def _parameter_set(slave: Slave, values: Mapping[str, float | str], version: str) -> bytes | None:
    """Values of parameters and inputs that are numbers, as an SSV; choices and texts stand in the FMU alone."""
    root = ET.Element(_tag("ssv:ParameterSet"), {"version": version, "name": _SET, **_about()})
    listed, used = _element(root, "ssv:Parameters"), []
    for name in sorted(values):
        port, value = slave.ports.get(name), values[name]
        if port is None or port.type != "Real" or isinstance(value, str):
            continue
        used.append(port)
        one = _element(listed, "ssv:Parameter", {"name": name})
        _element(one, "ssv:Real", {"value": _written(float(value)), **({"unit": port.unit} if port.unit else {})})
    _units(root, "ssv", used)
    return _bytes(root) if used else None


def _described(
    system: System, assembly: Any, packed: Mapping[str, Component], files: Mapping[str, bytes], version: str
) -> bytes:
    """SystemStructure.ssd."""
    about = {"version": version, "name": system.name, **_about()}
    root = ET.Element(_tag("ssd:SystemStructureDescription"), about)
    whole = {"name": system.name, **({"description": system.description} if system.description else {})}
    top = _element(root, "ssd:System", whole)
    elements = _element(top, "ssd:Elements")
    ends = [(each.source[0], p) for each in assembly.links for p in (each.ends[0],)]
    ends += [(each.target[0], each.ends[1]) for each in assembly.links]
    for c, slave in enumerate(assembly.slaves):
        source = {"name": slave.name, "type": "application/x-fmu-sharedlibrary", "source": str(packed[slave.name].what)}
        one = _element(elements, "ssd:Component", source)
        ports = {p.name: p for place, p in ends if place == c}
        if ports:
            connectors = _element(one, "ssd:Connectors")
            for p in ports.values():
                connector = _element(connectors, "ssd:Connector", {"name": p.name, "kind": p.kind})
                _element(connector, f"ssc:{p.type}", {"unit": p.unit} if p.type == "Real" and p.unit else {})
        if (numbers := f"resources/{slave.name}.ssv") in files:
            bindings = _element(one, "ssd:ParameterBindings")
            _element(bindings, "ssd:ParameterBinding", {"type": "application/x-ssp-parameter-set", "source": numbers})
    if assembly.links:
        connections = _element(top, "ssd:Connections")
        for each in assembly.links:
            start, end = (x.partition(".") for x in (each.given.source, each.given.target))
            places = {
                "startElement": start[0],
                "startConnector": start[2],
                "endElement": end[0],
                "endConnector": end[2],
            }
            changed = (each.factor, each.offset) != (1.0, 0.0)
            one = _element(
                connections, "ssd:Connection", places | ({"suppressUnitConversion": "true"} if changed else {})
            )
            if changed:
                numbers = {"factor": _written(each.factor), "offset": _written(each.offset)}
                _element(one, "ssc:LinearTransformation", numbers)
    _units(root, "ssd", [p for _, p in ends])
    span = {"startTime": _written(system.start_time), "stopTime": _written(system.stop_time)}
    notes = _element(_element(root, "ssd:DefaultExperiment", span), "ssd:Annotations")
    step = _written(system.communication_step)
    algorithm = _element(_element(notes, "ssc:Annotation", {"type": _OSP}), "osp:Algorithm")
    _element(algorithm, "osp:FixedStepAlgorithm", {"baseStepSize": step})
    own = _element(notes, "ssc:Annotation", {"type": _OWN})
    _element(own, "alfmu:Master", {"algorithm": system.master, "communicationStep": step})
    return _bytes(root)


# Read ----------------------------------------------------------------------------------------------------------------


class _Plain(ET.TreeBuilder):
    """A tree of what declares no document type, and so no entities."""

    def doctype(self, name: str, public: str | None, system: str | None) -> None:
        raise InputError("it declares a document type")


def read(path: Path) -> System:
    """The system that an SSP describes, checked once and completely; nothing in it is run.

    What alfmu does not support is refused by name: systems in systems, signal dictionaries, parameter mappings, FMUs
    outside the archive. FMUs are checked when they are opened.
    """
    check_archive(path, "an SSP")
    with zipfile.ZipFile(path) as opened:
        names = set(opened.namelist())
        root = _parsed(path, opened, names, _DESCRIPTION, "ssd:SystemStructureDescription")
        try:
            return _system(path, opened, names, root)
        except InputError as error:
            said = str(error)
            raise InputError(said if said.startswith(str(path)) else f"{path}: {said}") from None


def unpacked(system: System, folder: Path) -> None:
    """Put the FMUs of a system's archive into a folder."""
    assert system.archive is not None
    check_archive(system.archive, "an SSP")  # it may have changed since it was read
    with zipfile.ZipFile(system.archive) as opened:
        for place in {str(c.what) for c in system.components.values() if c.kind == "fmu"}:
            target = folder / place
            target.parent.mkdir(parents=True, exist_ok=True)
            try:
                target.write_bytes(opened.read(place))
            except KeyError:
                raise InputError(f"{system.archive} has no {place} any more") from None


def _parsed(path: Path, opened: zipfile.ZipFile, names: set[str], name: str, tag: str) -> ET.Element:
    """The root of an XML file of the archive."""
    if name not in names:
        raise InputError(f"{path} has no {name}")
    if opened.getinfo(name).file_size > _LARGEST:
        raise InputError(f"{path}: {name} has more than {_LARGEST:.0e} bytes")
    parser = ET.XMLParser(target=_Plain())
    try:
        parser.feed(opened.read(name))
        root = parser.close()
    except (ET.ParseError, ValueError, LookupError) as error:
        raise InputError(f"{path}: {name} is no XML that can be read ({error})") from None
    except InputError as error:
        raise InputError(f"{path}: {name} is not read: {error}") from None
    if root.tag != _tag(tag):
        raise InputError(f"{path}: {name} is no {tag.partition(':')[2]} of SSP")
    if (version := root.get("version", "")).partition("-")[0] not in VERSIONS:
        raise InputError(f"{path}: {name} is of SSP {version!r}; alfmu reads {in_words(VERSIONS)}")
    return root


def _system(path: Path, opened: zipfile.ZipFile, names: set[str], root: ET.Element) -> System:
    top = _one(root, "ssd:System", "the description")
    for part in ("ssd:SignalDictionaries",):
        if top.find(_tag(part)) is not None:
            raise InputError(f"the system has {part.partition(':')[2]}, which alfmu does not support")
    if top.find(_tag("ssd:Connectors")) is not None:
        raise InputError("the system has connectors of its own, which alfmu does not support; connect components alone")
    components: dict[str, Component] = {}
    connectors: dict[str, dict[str, ET.Element]] = {}
    for each in _children(top, "ssd:Elements"):
        kind = each.tag.rpartition("}")[2]
        if each.tag != _tag("ssd:Component"):
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
        both = {"parameters": {**known.parameters, variable: value}, "units": {**known.units, **stated}}
        components[component] = replace(known, **both)
    connections = [_read_connection(each, connectors) for each in _children(top, "ssd:Connections")]
    experiment = root.find(_tag("ssd:DefaultExperiment"))
    own: dict[str, Any] = {}
    if experiment is not None:
        for key, field in (("startTime", "start_time"), ("stopTime", "stop_time")):
            if key in experiment.attrib:
                own[field] = _number(f"{key} of the experiment", experiment.get(key))
        own |= _read_annotations(experiment)
    name = root.get("name") or top.get("name") or path.stem
    return System(name, components, connections, archive=path, description=top.get("description", ""), **own)


def _read_component(path: Path, opened: zipfile.ZipFile, names: set[str], name: str, each: ET.Element) -> Component:
    kind = each.get("type", "application/x-fmu-sharedlibrary")
    if kind != "application/x-fmu-sharedlibrary":
        raise InputError(f"the component {name} is of type {kind!r}; alfmu runs FMUs")
    if (how := each.get("implementation", "any")) not in ("any", "CoSimulation"):
        raise InputError(f"the component {name} asks for {how}; alfmu runs FMUs for co-simulation")
    source = _place(f"the component {name}", each.get("source"), names)
    values, units = _bindings(path, opened, names, each, f"the component {name}")
    for connector, one in _read_connectors(name, each).items():
        stated = [kind.get("unit", "") for kind in one.iter(_tag("ssc:Real")) if kind.get("unit")]
        if stated:
            units[connector] = stated[0]
    return Component(name, "fmu", source, parameters=values, units=units)


def _place(what: str, source: str | None, names: set[str]) -> str:
    """A file of the archive by a URI relative to it; names of the archive were checked to stay inside."""
    place = PurePosixPath((source or "").removeprefix("./")).as_posix()
    if place not in names:
        raise InputError(f"{what} is {source!r}, which is no file in the archive; alfmu takes no other")
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
    # SSP lets a connection be drawn either way.
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
        if one.tag == _tag("ssc:LinearTransformation"):
            factor = _number("the factor of a connection", one.get("factor", "1"))
            offset = _number("the offset of a connection", one.get("offset", "0"))
        elif kind not in ("ConnectionGeometry", "Annotations"):
            raise InputError(f"the connection {ends[0][0]} -> {ends[1][0]} has a {kind}, which alfmu does not support")
    suppressed = each.get("suppressUnitConversion", "false") in ("true", "1")
    return Connection(ends[0][0], ends[1][0], factor, offset, "none" if suppressed else "*")


def _bindings(
    path: Path, opened: zipfile.ZipFile, names: set[str], each: ET.Element, what: str
) -> tuple[dict[str, float | str], dict[str, str]]:
    """Values of parameters that are bound to an element, and their units."""
    found: dict[str, float | str] = {}
    units: dict[str, str] = {}
    for one in _children(each, "ssd:ParameterBindings"):
        if one.find(_tag("ssd:ParameterMapping")) is not None:
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
        return _number(what, text)
    if kind == "Boolean":
        if text not in ("true", "false", "0", "1"):
            raise InputError(f"{what} is {text!r}; a Boolean is true or false")
        return float(text in ("true", "1"))
    if kind in ("String", "Enumeration"):
        return text
    raise InputError(f"{what} is a {kind}, which alfmu does not support")


def _read_annotations(experiment: ET.Element) -> dict[str, Any]:
    """What annotations say of the master, alfmu's own before that of the Open Simulation Platform."""
    own: dict[str, Any] = {}
    found = {each.get("type"): each for each in _children(experiment, "ssd:Annotations")}
    if _OSP in found:
        fixed = found[_OSP].find(f".//{_tag('osp:FixedStepAlgorithm')}")
        if fixed is None:  # whatever its namespace
            fixed = next((e for e in found[_OSP].iter() if e.tag.rpartition("}")[2] == "FixedStepAlgorithm"), None)
        if fixed is not None:
            own["communication_step"] = _number("baseStepSize", fixed.get("baseStepSize"))
    if _OWN in found and (master := found[_OWN].find(_tag("alfmu:Master"))) is not None:
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
    found = parent.findall(_tag(name))
    if len(found) != 1:
        raise InputError(f"{what} has {len(found)} elements {name.partition(':')[2]}; it must have one")
    return found[0]


def _children(parent: ET.Element, name: str) -> list[ET.Element]:
    found = parent.find(_tag(name))
    return [] if found is None else list(found)
