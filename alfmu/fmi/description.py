"""The modelDescription.xml of an FMU and its documentation page."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from xml.etree import ElementTree as ET

import markdown

from ..equations import Equations, Variable
from ..equations.interface import default_settings
from ..equations.interface import variables_of as interface
from ..model.units import composed

__all__ = [
    "build_description",
    "dependencies",
    "documentation",
    "enumerated",
    "model_description",
    "model_description3",
]

LICENSE = "MIT"

Choices = Mapping[str, Mapping[str, str]]
"""Text variables of a native FMU: their possible values, with descriptions."""

_LOG_CATEGORIES = {
    "logStatusWarning": "Something was left as it was",
    "logStatusDiscard": "A step or a value was not taken, and why",
    "logStatusError": "Errors of the slave",
    "logStatusFatal": "Errors that end the run",
    "logAll": "All messages",
}


def model_description(
    equations: Equations,
    version: str,
    generator: str,
    guid: str,
    variables: Sequence[tuple[str, Variable]] | None = None,
    sources: Sequence[str] = (),
    credits: Mapping[str, str] = MappingProxyType({}),
    choices: Choices = MappingProxyType({}),
    directional: bool = True,
) -> bytes:
    """Return modelDescription.xml (FMI 2.0, co-simulation) as UTF-8, the same bytes for the same arguments.

    `variables` are those of a native FMU, and `sources` its C files; `credits` are further attributes of the model.
    A native FMU may have directional derivatives.
    """
    e, native = equations, variables is not None
    variables = interface(e).causalities if variables is None else enumerated(variables, choices)
    derivatives = str(native and bool(e.inputs)).lower()
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=e.name,
        guid=guid,
        description=e.description,
        version=version,
        license=LICENSE,
        generationTool=generator,
        variableNamingConvention=_convention(e),
        **credits,  # type: ignore[arg-type]
    )
    simulation = ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=e.name,
        needsExecutionTool="false",
        canHandleVariableCommunicationStepSize="true",
        canInterpolateInputs=derivatives,
        canRunAsynchronuously="false",
        canBeInstantiatedOnlyOncePerProcess="false",
        canNotUseMemoryManagementFunctions="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
        providesDirectionalDerivative=str(native and directional).lower(),
        maxOutputDerivativeOrder=str(2 * native),
    )
    if sources:
        files = ET.SubElement(simulation, "SourceFiles")
        for name in sources:
            ET.SubElement(files, "File", name=name)
    _units(root, sorted({v.unit for _, v in variables if v.type == "Real"}))
    types = ET.SubElement(root, "TypeDefinitions") if choices else root
    for name, items in choices.items():
        _items(ET.SubElement(ET.SubElement(types, "SimpleType", name=name), "Enumeration"), items)
    _categories(root)
    _experiment(root, e)
    model_variables = ET.SubElement(root, "ModelVariables")
    for reference, (causality, v) in enumerate(variables):
        head, kind = _facts(reference, causality, v)
        ET.SubElement(ET.SubElement(model_variables, "ScalarVariable", head), v.type, kind)
    _structure(root, e, [causality for causality, _ in variables], [v for _, v in variables])
    ET.indent(root)
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"


def model_description3(
    equations: Equations,
    version: str,
    generator: str,
    token: str,
    variables: Sequence[tuple[str, Variable]],
    credits: Mapping[str, str] = MappingProxyType({}),
    choices: Choices = MappingProxyType({}),
    directional: bool = True,
) -> bytes:
    """Return modelDescription.xml (FMI 3.0, co-simulation) of a native FMU."""
    e, variables = equations, enumerated(variables, choices)
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=e.name,
        instantiationToken=token,
        description=e.description,
        version=version,
        license=LICENSE,
        generationTool=generator,
        variableNamingConvention=_convention(e),
        **credits,  # type: ignore[arg-type]
    )
    ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=e.name,
        canGetAndSetFMUState="true",
        canSerializeFMUState="true",
        providesDirectionalDerivatives=str(directional).lower(),
        providesAdjointDerivatives=str(directional).lower(),
        canHandleVariableCommunicationStepSize="true",
        maxOutputDerivativeOrder="2",
        canReturnEarlyAfterIntermediateUpdate="true",
        providesIntermediateUpdate="true",
        mightReturnEarlyFromDoStep="true",
    )
    _units(root, sorted({"s"} | {v.unit for _, v in variables if v.type == "Real"}))
    types = ET.SubElement(root, "TypeDefinitions") if choices else root
    for name, items in choices.items():
        _items(ET.SubElement(types, "EnumerationType", name=name), items)
    _categories(root)
    _experiment(root, e)
    model_variables = ET.SubElement(root, "ModelVariables")
    for reference, (causality, v) in enumerate(variables):
        head, kind = _facts(reference, causality, v)
        if causality == "input":
            head.pop("initial", None)
        ET.SubElement(model_variables, _TYPES3[v.type], head | kind)
    time = {"causality": "independent", "variability": "continuous", "unit": "s", "description": "time"}
    ET.SubElement(model_variables, "Float64", {"name": "time", "valueReference": str(len(variables)), **time})
    structure = ET.SubElement(root, "ModelStructure")
    inputs = [str(i) for i, (causality, v) in enumerate(variables) if causality == "input" and v.type == "Real"]
    outputs = [(str(i), v) for i, (causality, v) in enumerate(variables) if causality == "output"]
    for number, v in outputs:
        on = inputs if v.instant else []
        kinds = " ".join("dependent" for _ in on)
        ET.SubElement(structure, "Output", valueReference=number, dependencies=" ".join(on), dependenciesKind=kinds)
    for number, v in outputs:
        needed = " ".join(str(i) for i in _at_the_start(e, variables, v))
        ET.SubElement(structure, "InitialUnknown", valueReference=number, dependencies=needed)
    ET.indent(root)
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"


_TYPES3 = {"Real": "Float64", "Integer": "Int32", "Boolean": "Boolean", "Enumeration": "Enumeration"}
"""FMI 3 types of FMI 2 types."""


def enumerated(variables: Sequence[tuple[str, Variable]], choices: Choices) -> list[tuple[str, Variable]]:
    """Return the variables with text ones as enumerations, whose items are the values of this FMU, counted from 1."""

    def numbered(v: Variable) -> Variable:
        items = list(choices[v.name])
        text = ", ".join(f"{k} {item}" for k, item in enumerate(items, 1))
        return replace(
            v, type="Enumeration", start=items.index(str(v.start)) + 1, description=f"what this FMU has: {text}"
        )

    return [(causality, numbered(v) if v.name in choices else v) for causality, v in variables]


def _convention(e: Equations) -> str:
    """Return the naming convention: names of the interface Jacobian have a slash, which structured names forbid."""
    return "flat" if e.jacobian else "structured"


def _items(element: ET.Element, items: Mapping[str, str]) -> None:
    for k, (name, text) in enumerate(items.items(), 1):
        ET.SubElement(element, "Item", name=name, value=str(k), description=text)


def build_description(identifier: str, sources: Sequence[str]) -> bytes:
    """Return buildDescription.xml (FMI 3.0) of C files."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=identifier)
    files = ET.SubElement(configuration, "SourceFileSet", language="C99")
    for name in sources:
        ET.SubElement(files, "SourceFile", name=name)
    ET.indent(root)
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"


def _categories(root: ET.Element) -> None:
    categories = ET.SubElement(root, "LogCategories")
    for name, text in _LOG_CATEGORIES.items():
        ET.SubElement(categories, "Category", name=name, description=text)


def _experiment(root: ET.Element, e: Equations) -> None:
    span = {"startTime": "0", "stopTime": _number(e.stop_time)}
    span["tolerance"] = _number(default_settings(e).relative_tolerance)
    ET.SubElement(root, "DefaultExperiment", span, stepSize=_number(e.interval))


def _units(root: ET.Element, names: Sequence[str]) -> None:
    definitions = ET.SubElement(root, "UnitDefinitions")
    for name in names:
        element, known = ET.SubElement(definitions, "Unit", name=name), composed(name)
        ET.SubElement(element, "BaseUnit", {k: str(n) for k, n in known.exponents.items()})
        for display, factor in known.display.items():
            ET.SubElement(element, "DisplayUnit", name=display, factor=_number(factor))


def _facts(reference: int, causality: str, v: Variable) -> tuple[dict[str, str], dict[str, str]]:
    """Return the attributes of a variable, and those of its type."""
    continuous = v.type == "Real" and not v.of_step
    variability = "fixed" if causality == "parameter" else "continuous" if continuous else "discrete"
    head = {"name": v.name, "valueReference": str(reference), "causality": causality, "variability": variability}
    if v.description:
        head["description"] = v.description
    if causality != "input":
        head["initial"] = "calculated" if causality == "output" else "exact"
    kind: dict[str, str] = {}
    if causality != "output":
        kind["start"] = v.start if isinstance(v.start, str) else _number(v.start, v.type)
    if v.type == "Enumeration":
        kind["declaredType"] = v.name
    if v.type == "Real":
        kind["unit"] = v.unit
        if display := _display(v.unit):
            kind["displayUnit"] = display
        if v.nominal is not None:
            kind["nominal"] = _number(v.nominal)
    if v.type in ("Real", "Integer"):
        kind |= {key: _number(x, v.type) for key, x in (("min", v.minimum), ("max", v.maximum)) if x is not None}
    return head, kind


def _structure(root: ET.Element, e: Equations, causalities: Sequence[str], variables: Sequence[Variable]) -> None:
    """Add the model structure: reactions and accelerations depend directly on every input, other outputs on none.

    A Boolean input takes effect in the next step.
    """
    structure = ET.SubElement(root, "ModelStructure")
    continuous = [v.type == "Real" for v in variables]
    inputs = [str(i + 1) for i, causality in enumerate(causalities) if causality == "input" and continuous[i]]
    outputs, unknowns = ET.SubElement(structure, "Outputs"), ET.SubElement(structure, "InitialUnknowns")
    for i, (causality, v) in enumerate(zip(causalities, variables, strict=True)):
        if causality == "output":
            on = inputs if v.instant else []
            ET.SubElement(
                outputs,
                "Unknown",
                index=str(i + 1),
                dependencies=" ".join(on),
                dependenciesKind=" ".join("dependent" for _ in on),
            )
            known = _at_the_start(e, list(zip(causalities, variables, strict=True)), v)
            ET.SubElement(unknowns, "Unknown", index=str(i + 1), dependencies=" ".join(str(k + 1) for k in known))


_LATER = ("step_size", "relative_tolerance", "absolute_tolerance", "input_order", "method")
"""Solver variables without effect before the first step."""


def _at_the_start(e: Equations, variables: Sequence[tuple[str, Variable]], output: Variable) -> list[int]:
    """Return the indices of the variables on which an output may depend at initialisation.

    These are parameters, Boolean inputs (effective at once at the start), inputs that prescribe motion (the run starts
    at their values), and the output's dependencies in steps. Outputs of a communication step are zero then.
    """
    if output.of_step:
        return []
    later = {f"solver.{name}" for name in _LATER}
    moving = {v.name for each in e.followed for v in e.inputs[each.input : each.input + 1 + each.derivatives]}
    if output.name == "monitor.iterations":  # counts the iterations of the start, which differ between methods
        later -= {"solver.method"}
    return [
        i
        for i, (causality, v) in enumerate(variables)
        if (causality == "parameter" and v.name not in later)
        or (causality == "input" and (v.type == "Boolean" or v.name in moving or output.instant))
    ]


def _display(unit_name: str) -> str | None:
    """Return the display unit: degrees for angles."""
    return {"rad": "deg", "rad/s": "deg/s"}.get(unit_name)


def _number(value: float, kind: str = "Real") -> str:
    if kind == "Boolean":
        return "true" if value else "false"
    return f"{value:.17g}" if kind == "Real" else str(int(value))


def _start(causality: str, v: Variable) -> str:
    if causality == "output":
        return ""
    return (
        html.escape(str(v.start))
        if v.type == "String"
        else _number(float(v.start), v.type)
        if v.type == "Boolean"
        else f"{v.start:g}"
    )


_STYLE = """
body { font-family: system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #222; }
pre { background: #f5f5f2; padding: 1rem; overflow-x: auto; }
table { border-collapse: collapse; margin: 1rem 0; } td, th { border: 1px solid #ccc; padding: 0.2rem 0.6rem; }
th { text-align: left; background: #f5f5f2; } img { max-width: 100%; }
"""


def documentation(
    equations: Equations,
    sketch: str,
    readme: str,
    generator: str,
    needs: str,
    picture: str,
    variables: Sequence[tuple[str, Variable]] | None = None,
) -> str:
    """Return documentation/index.html: sketch, equations, all variables, requirements; the picture is in
    the archive."""
    e = equations
    body = markdown.markdown(readme, extensions=["tables", "fenced_code"]) if readme else f"<h1>{e.name}</h1>"
    sketch_block = f"<pre>{html.escape(sketch.strip())}</pre>" if sketch and not readme else ""
    rows = "\n".join(
        f"<tr><td><code>{html.escape(v.name)}</code></td><td>{causality}</td><td>{v.unit}</td>"
        f"<td>{_start(causality, v)}</td>"
        f"<td>{html.escape(v.description)}</td></tr>"
        for causality, v in variables or interface(e).causalities
    )
    options = "".join(f"<li><code>{html.escape(k)}</code> = {html.escape(str(x))}</li>" for k, x in e.options.items())
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{html.escape(e.name)}</title><style>{_STYLE}</style></head>
<body>
<p><img src="../{picture}" alt="{html.escape(e.description)} at its start"></p>
{sketch_block}
{body}
{f"<h2>Options of this FMU</h2><ul>{options}</ul>" if options else ""}
<h2>Variables of this FMU</h2>
<table><tr><th>name</th><th>causality</th><th>unit</th><th>start</th><th>description</th></tr>
{rows}
</table>
<h2>What it needs</h2>
<p>{html.escape(needs)}</p>
<p>Made by {html.escape(generator)}.</p>
</body></html>
"""


def dependencies() -> str:
    """Return the requirements of an FMU for Python, in one line."""
    return (
        "This FMU runs in Python: the process that loads it needs a Python interpreter (3.11 or later), and "
        "no package. Python hosts such as fmpy have an interpreter; other hosts must load libpython first."
    )
