"""Parameter sets of the SSP standard (`.ssv`): numbers, Booleans and texts by the names of variables."""

from collections.abc import Callable, Mapping
from xml.etree import ElementTree as ET

from ..model.errors import InputError
from .markup import tree, written

SSV = "application/x-ssp-parameter-set"
"""Media type of a parameter set."""

_VALUES = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"

_TRUTHS = {"true": True, "1": True, "false": False, "0": False}

_TYPES: dict[str, Callable[[str], float | int | bool | str]] = {
    "Real": float,
    "Integer": int,
    "Boolean": lambda text: _TRUTHS[text],
    "String": str,
    "Enumeration": str,
}
"""Value elements of SSP 1.0 and their conversion to Python."""


def parameter_set(name: str, values: Mapping[str, float | int | bool | str]) -> bytes:
    """Return a parameter set (SSP 1.0) of these values, as UTF-8."""
    ET.register_namespace("ssv", _VALUES)
    root = ET.Element(f"{{{_VALUES}}}ParameterSet", version="1.0", name=name)
    listed = ET.SubElement(root, f"{{{_VALUES}}}Parameters")
    for each, value in values.items():
        kind = {bool: "Boolean", int: "Integer", str: "String"}.get(type(value), "Real")
        text = str(value).lower() if kind == "Boolean" else f"{value:.17g}" if kind == "Real" else str(value)
        ET.SubElement(ET.SubElement(listed, f"{{{_VALUES}}}Parameter", name=each), f"{{{_VALUES}}}{kind}", value=text)
    return written(root)


def read_parameter_set(data: bytes, name: str) -> dict[str, float | int | bool | str]:
    """Return the values by name from a parameter set of SSP 1.0 or 2.0.

    Raises InputError, with the `name` of the file, if it is not one, or a value has another form.
    """
    root = tree(data, name)
    if _plain(root) != "ParameterSet":
        raise InputError(f"{name} is a {_plain(root)}, and no ParameterSet")
    found: dict[str, float | int | bool | str] = {}
    for each in (one for one in root.iter() if _plain(one) == "Parameter"):
        variable, value = each.get("name"), next(iter(each), None)
        kind = "nothing" if value is None else _plain(value)
        if variable is None or value is None or kind not in _TYPES:
            raise InputError(f"{name}: the parameter {variable} holds {kind}; {', '.join(_TYPES)} are read")
        try:
            found[variable] = _TYPES[kind](value.attrib["value"])
        except (KeyError, ValueError):
            raise InputError(f"{name}: {variable} is {value.get('value')!r}, which is no {kind}") from None
    return found


def _plain(element: ET.Element) -> str:
    """Return the name of an element without its namespace."""
    return element.tag.rpartition("}")[2]
