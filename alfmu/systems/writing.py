"""Write systems as SSP archives: FMUs, units, parameter sets, the annotation of the master."""

import importlib.metadata
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

from ..analysis.start import rest_of
from ..fmi.export import archive, export
from ..fmi.markup import written
from ..model.errors import ExportError, InputError
from ..model.files import scratch
from ..model.words import in_words
from .description import Component, Description
from .ports import Measure, Port
from .run import Assembly
from .slaves import Remote, naming, recipe_of
from .ssp import DESCRIPTION, OSP, OWN, SPACES, VERSIONS, tag

_SET = "defaults"
"""Name of the parameter sets of all components; ecos selects sets by name."""


def write(system: Description, path: str | Path | None, version: str) -> Path:
    """Write a system as an SSP; see `alfmu.System.export`."""
    if version not in VERSIONS:
        raise InputError(f"{system.name}: there is no SSP {version!r}; use {in_words(VERSIONS)}")
    path = Path(path or f"{system.name}.ssp")
    if path.suffix != ".ssp":
        raise ExportError(f"{system.name}: {path} does not end in .ssp")
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
        as_fmus = replace(system, components=packed, folder=folder, archive=None)
        with Assembly(as_fmus) as assembly:  # checks all connections with the packed FMUs
            for slave in assembly.slaves:
                assert isinstance(slave, Remote)
                values = {**system.components[slave.name].parameters, **_constants(system, slave.name)}
                whole = system.components[slave.name].kind == "fmu"
                if numbers := _parameter_set(slave, values, whole, version):
                    files[f"resources/{slave.name}.ssv"] = numbers
            files[DESCRIPTION] = _described(system, assembly, packed, files, version)
    archive(path, files)
    return path


def _fmu(system: Description, component: Component, folder: Path) -> bytes:
    """Return the FMU of a component."""
    if component.kind != "fmu":
        # Values of inputs become defaults, too: fmpy applies no parameter set by itself.
        constants = _constants(system, component.name)
        with naming(component):
            recipe = recipe_of(component).changed(kind="native", reference=False, parameters=constants)
            return export(recipe, folder / f"{component.name}.fmu", rest_of(recipe)).read_bytes()
    if system.archive is not None:
        with zipfile.ZipFile(system.archive) as opened:
            return opened.read(str(component.what))
    try:
        return (system.folder / str(component.what)).read_bytes()
    except OSError as error:
        raise InputError(f"{system.name}: cannot read {component.what} ({error.strerror})") from None


def _constants(system: Description, component: str) -> dict[str, float]:
    """Return values of unconnected inputs of a component."""
    parts = {name.partition(".")[2]: x for name, x in system.inputs.items() if name.partition(".")[0] == component}
    return dict(parts)


def _element(parent: ET.Element, name: str, attributes: Mapping[str, str] | None = None) -> ET.Element:
    return ET.SubElement(parent, tag(name), dict(attributes or {}))


def _bytes(root: ET.Element) -> bytes:
    for prefix, space in SPACES.items():
        ET.register_namespace(prefix, space)
    return written(root)


def _about() -> dict[str, str]:
    return {"generationTool": f"alfmu {importlib.metadata.version('alfmu')}"}


def _written(value: float) -> str:
    return repr(float(value)).removesuffix(".0")


def _units(parent: ET.Element, prefix: str, ports: list[Port]) -> None:
    """Add the definitions of the units of some variables."""
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


def _parameter_set(slave: Remote, values: Mapping[str, float | str], whole: bool, version: str) -> bytes | None:
    """Return values of parameters and inputs as an SSV.

    Unless `whole`, it has numbers only, as the FMU has all values: libcosim crashes at an enumeration.
    """
    root = ET.Element(tag("ssv:ParameterSet"), {"version": version, "name": _SET, **_about()})
    listed, used = _element(root, "ssv:Parameters"), []
    for name in sorted(values):
        kind, port, value = slave.kinds.get(name, "Real"), slave.ports.get(name), values[name]
        if kind != "Real" and not whole:
            continue
        used += [port] if port is not None else []
        unit = {"unit": port.unit} if port is not None and port.unit and kind == "Real" else {}
        one = _element(listed, "ssv:Parameter", {"name": name})
        _element(one, f"ssv:{kind}", {"value": _valued(kind, value), **unit})
    _units(root, "ssv", used)
    return _bytes(root) if len(listed) else None


def _valued(kind: str, value: float | str) -> str:
    """Return a value as text for an SSV; the FMU has accepted it before."""
    if kind == "Boolean":
        return "true" if str(value).lower() in ("true", "1", "1.0") else "false"
    if kind in ("Real", "Integer"):
        return _written(float(value))
    return str(int(value)) if isinstance(value, float) and value.is_integer() else str(value)


def _described(
    system: Description, assembly: Assembly, packed: Mapping[str, Component], files: Mapping[str, bytes], version: str
) -> bytes:
    """Return SystemStructure.ssd."""
    about = {"version": version, "name": system.name, **_about()}
    root = ET.Element(tag("ssd:SystemStructureDescription"), about)
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
                _element(
                    one, "ssc:LinearTransformation", {"factor": _written(each.factor), "offset": _written(each.offset)}
                )
    _units(root, "ssd", [p for _, p in ends])
    span = {"startTime": _written(system.start_time), "stopTime": _written(system.stop_time)}
    notes = _element(_element(root, "ssd:DefaultExperiment", span), "ssd:Annotations")
    step = _written(system.communication_step)
    algorithm = _element(_element(notes, "ssc:Annotation", {"type": OSP}), "osp:Algorithm")
    _element(algorithm, "osp:FixedStepAlgorithm", {"baseStepSize": step})
    own = _element(notes, "ssc:Annotation", {"type": OWN})
    _element(own, "alfmu:Master", {"algorithm": system.master, "communicationStep": step})
    return _bytes(root)
