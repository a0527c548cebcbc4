"""The modelDescription.xml of an FMU and its documentation page."""

import html
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from xml.etree import ElementTree as ET

import markdown

from ..equations import Equations, Variable
from ..equations.interface import BALANCE, default_settings
from ..equations.interface import variables_of as interface
from ..equations.types import configured
from ..model.units import composed
from .markup import written

LICENSE = "MIT"

Choices = Mapping[str, Mapping[str, str]]
"""Text variables of a native FMU: their possible values, with descriptions."""

_LOG_CATEGORIES = {
    "logStatusWarning": "Warnings, after which the run continues",
    "logStatusDiscard": "A step or a value was not taken, and why",
    "logStatusError": "Errors of the slave",
    "logStatusFatal": "Errors that end the run",
    "logAll": "All messages",
}


_CAPABILITIES = {
    2: {
        "needsExecutionTool": "false",
        "canHandleVariableCommunicationStepSize": "true",
        "canInterpolateInputs": "{inputs}",
        "canRunAsynchronuously": "false",
        "canBeInstantiatedOnlyOncePerProcess": "false",
        "canNotUseMemoryManagementFunctions": "true",
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
        "providesDirectionalDerivative": "{directional}",
        "maxOutputDerivativeOrder": "{order}",
    },
    3: {
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
        "providesDirectionalDerivatives": "{directional}",
        "providesAdjointDerivatives": "{directional}",
        "canHandleVariableCommunicationStepSize": "true",
        "maxOutputDerivativeOrder": "{order}",
        "canReturnEarlyAfterIntermediateUpdate": "true",
        "providesIntermediateUpdate": "true",
        "mightReturnEarlyFromDoStep": "true",
    },
}
"""Attributes of co-simulation by version of FMI; those in braces depend on the kind of FMU and its inputs."""

_EXCHANGE = {
    2: {
        "needsExecutionTool": "false",
        "completedIntegratorStepNotNeeded": "false",
        "canBeInstantiatedOnlyOncePerProcess": "false",
        "canNotUseMemoryManagementFunctions": "true",
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
        "providesDirectionalDerivative": "{directional}",
    },
    3: {
        "needsCompletedIntegratorStep": "true",
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
        "providesDirectionalDerivatives": "{directional}",
        "providesAdjointDerivatives": "{directional}",
    },
}
"""Attributes of Model Exchange by version of FMI."""

_TYPES3 = {"Real": "Float64", "Integer": "Int32", "Boolean": "Boolean", "Enumeration": "Enumeration"}
"""Types of FMI 2 and of FMI 3."""


def model_description(
    equations: Equations,
    version: str,
    generator: str,
    guid: str,
    variables: Sequence[tuple[str, Variable]] | None = None,
    sources: Sequence[str] = (),
    credits: Mapping[str, str] = MappingProxyType({}),
    choices: Choices = MappingProxyType({}),
    fmi: int = 2,
    directional: bool = True,
    interfaces: Sequence[str] = ("cs",),
    states: Sequence[tuple[Variable, Variable]] = (),
    indicators: Sequence[Variable] = (),
    once: bool = False,
) -> bytes:
    """Return modelDescription.xml as UTF-8, the same bytes for the same arguments.

    `variables` are those of a native FMU, and `sources` its C files; `credits` are further attributes of the model. A
    native FMU may have directional derivatives and the interfaces "me" (Model Exchange) and "cs" (co-simulation);
    `states` are those that an importer may integrate, with their rates, and `indicators` its event indicators. An FMU
    of sources has memory for one instance (`once`).
    """
    e, native = equations, variables is not None
    variables = interface(e).causalities if variables is None else enumerated(variables, choices)
    head = {"fmiVersion": f"{fmi}.0", "modelName": e.name, "guid" if fmi == 2 else "instantiationToken": guid}
    head |= {"description": e.description, "version": version, "license": LICENSE, "generationTool": generator}
    own = states if "me" in interfaces else ()
    if own:
        of_run = {v.name for _, v in variables if v.of_step} | BALANCE - {"monitor.energy"}
        variables = [
            (c, replace(v, description=f"{v.description}; 0 in Model Exchange") if v.name in of_run else v)
            for c, v in variables
        ]
    if own and fmi == 2:
        head["numberOfEventIndicators"] = str(len(indicators))
    # Names of the interface Jacobian have a slash, which structured names forbid.
    convention = "flat" if configured(e).jacobian else "structured"
    root = ET.Element("fmiModelDescription", head, variableNamingConvention=convention, **credits)
    known = {
        "directional": str(native and directional).lower(),
        "inputs": str(native and bool(e.inputs)).lower(),
        "order": 2 * native,
    }
    for each in interfaces:
        element, table = ("ModelExchange", _EXCHANGE) if each == "me" else ("CoSimulation", _CAPABILITIES)
        capabilities = {name: value.format(**known) for name, value in table[fmi].items()}
        capabilities |= {"canBeInstantiatedOnlyOncePerProcess": "true"} if once else {}
        interface_of = ET.SubElement(root, element, {"modelIdentifier": e.name, **capabilities})
        if fmi == 2 and sources:
            _files(ET.SubElement(interface_of, "SourceFiles"), "File", sources)
    units = {
        v.unit
        for v in (*(v for _, v in variables), *(v for pair in own for v in pair), *(indicators if own else ()))
        if v.type == "Real"
    }
    _units(root, sorted({*["s"] * (fmi == 3), *units}))
    types = ET.SubElement(root, "TypeDefinitions") if choices else root
    for name, items in choices.items():
        if fmi == 2:
            _items(ET.SubElement(ET.SubElement(types, "SimpleType", name=name), "Enumeration"), items)
        else:
            _items(ET.SubElement(types, "EnumerationType", name=name), items)
    _categories(root)
    _experiment(root, e)
    model_variables = ET.SubElement(root, "ModelVariables")
    for reference, (causality, v) in enumerate(variables):
        head, kind = _facts(reference, causality, v)
        if fmi == 2:
            ET.SubElement(ET.SubElement(model_variables, "ScalarVariable", head), v.type, kind)
        else:
            if causality == "input":
                head.pop("initial", None)
            ET.SubElement(model_variables, _TYPES3[v.type], head | kind)
    first = len(variables)
    for k, v in enumerate((*(v for v, _ in own), *(v for _, v in own), *(indicators if own else ()))):
        head, kind = _facts(first + k, "local", v)
        if len(own) <= k < 2 * len(own):
            kind["derivative"] = str(first + k - len(own) + (fmi == 2))
        if fmi == 2:
            ET.SubElement(ET.SubElement(model_variables, "ScalarVariable", head), "Real", kind)
        else:
            ET.SubElement(model_variables, "Float64", head | kind)
    if fmi == 3:
        time = {"causality": "independent", "variability": "continuous", "unit": "s", "description": "time"}
        ET.SubElement(
            model_variables,
            "Float64",
            {"name": "time", "valueReference": str(first + 2 * len(states) + len(indicators)), **time},
        )
    _structure(root, e, variables, fmi, range(first, first + len(own)), len(indicators))
    return written(root)


def _structure(
    root: ET.Element, e: Equations, variables: Sequence[tuple[str, Variable]], fmi: int, states: range, indicators: int
) -> None:
    """Add the model structure: reactions and accelerations depend directly on every input, other outputs on none.

    A Boolean input takes effect in the next step. In Model Exchange outputs and rates depend on all states, whose
    references are `states`, followed by those of the rates; outputs of a communication step do not. FMI 2 refers to
    variables by index from 1, FMI 3 by value reference.
    """
    structure, first = ET.SubElement(root, "ModelStructure"), 1 if fmi == 2 else 0
    inputs = [str(i + first) for i, (c, v) in enumerate(variables) if c == "input" and v.type == "Real"]
    own, rates = ([str(k + first + shift) for k in states] for shift in (0, len(states)))
    key = "index" if fmi == 2 else "valueReference"

    def part(name: str, unknown: str) -> tuple[ET.Element, str]:
        return (ET.SubElement(structure, name), "Unknown") if fmi == 2 else (structure, unknown)

    told = [(str(i + first), v) for i, (causality, v) in enumerate(variables) if causality == "output"]
    element = part("Outputs", "Output")
    for number, v in told:
        on = [*(inputs if v.instant else []), *([] if v.of_step else own)]
        ET.SubElement(*element, {key: number}, dependencies=" ".join(on))
    if states:
        element = part("Derivatives", "ContinuousStateDerivative")
        for number in rates:
            ET.SubElement(*element, {key: number})
    element = part("InitialUnknowns", "InitialUnknown")
    for number, v in told:
        needed = " ".join(str(i + first) for i in _at_the_start(e, variables, v))
        ET.SubElement(*element, {key: number}, dependencies=needed)
    for number in (*own, *rates):
        ET.SubElement(*element, {key: number})
    for k in range(indicators if states and fmi == 3 else 0):
        ET.SubElement(structure, "EventIndicator", {key: str(states[-1] + len(states) + 1 + k)})


def enumerated(variables: Sequence[tuple[str, Variable]], choices: Choices) -> list[tuple[str, Variable]]:
    """Return the variables with text ones as enumerations, whose items are the values of this FMU, counted from 1."""

    def numbered(v: Variable) -> Variable:
        items = list(choices[v.name])
        text = ", ".join(f"{k} {item}" for k, item in enumerate(items, 1))
        return replace(
            v, type="Enumeration", start=items.index(str(v.start)) + 1, description=f"choices in this FMU: {text}"
        )

    return [(causality, numbered(v) if v.name in choices else v) for causality, v in variables]


def _files(element: ET.Element, kind: str, names: Sequence[str]) -> None:
    for name in names:
        ET.SubElement(element, kind, name=name)


def _items(element: ET.Element, items: Mapping[str, str]) -> None:
    for k, (name, text) in enumerate(items.items(), 1):
        ET.SubElement(element, "Item", name=name, value=str(k), description=text)


def build_description(identifier: str, sources: Sequence[str]) -> bytes:
    """Return buildDescription.xml (FMI 3.0) of C files."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=identifier)
    _files(ET.SubElement(configuration, "SourceFileSet", language="C99"), "SourceFile", sources)
    return written(root)


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
    calculated = causality in ("output", "local")
    if causality != "input":
        head["initial"] = "calculated" if calculated else "exact"
    kind: dict[str, str] = {}
    if not calculated:
        kind["start"] = v.start if isinstance(v.start, str) else _number(v.start, v.type)
    if v.type == "Enumeration":
        kind["declaredType"] = v.name
    if v.type == "Real":
        kind["unit"] = v.unit
        if display := {"rad": "deg", "rad/s": "deg/s"}.get(v.unit):
            kind["displayUnit"] = display
        if v.nominal is not None:
            kind["nominal"] = _number(v.nominal)
    if v.type in ("Real", "Integer"):
        kind |= {key: _number(x, v.type) for key, x in (("min", v.minimum), ("max", v.maximum)) if x is not None}
    return head, kind


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
    if output.name == "monitor.iterations":  # the number of iterations at the start depends on the method
        later -= {"solver.method"}
    return [
        i
        for i, (causality, v) in enumerate(variables)
        if (causality == "parameter" and v.name not in later)
        or (causality == "input" and (v.type == "Boolean" or v.name in moving or output.instant))
    ]


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
