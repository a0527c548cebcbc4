"""A system as data: its components, their connections, its experiment; from Python or from a TOML file.

    name = "drive"
    stop_time = 1.0                      # s
    communication_step = 0.001           # s
    master = "held"                      # held, extrapolated or iterated

    [components.arm]
    mechanism = "four_bar"               # a registered name, a recipe or a Python file beside this one
    set = { m2 = 2.0 }

    [components.motor]
    part = "motor"                       # of alfmu.parts.blocks
    options = { constant = 2.0 }

    [components.brake]
    fmu = "brake.fmu"                    # any co-simulation FMU

    [[connections]]
    from = "motor.torque"
    to = "arm.A.torque"

    [inputs]
    "motor.voltage" = 24.0

docs/howto/systems.md has every key.
"""

import math
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

from ..fmi.recipe import Recipe
from ..model.errors import InputError
from ..model.mechanism import Mechanism
from ..model.sources import is_file
from ..model.words import counted, in_words, shown, text, there_is
from .masters import MASTERS

_NAME = re.compile(r"[A-Za-z_]\w*\Z")
_FILE_KEYS = (
    *("name", "description", "start_time", "stop_time", "communication_step", "master"),
    *("components", "connections", "inputs", "bonds", "monolithic"),
)
_SOURCES = ("mechanism", "part", "fmu")
_COMPONENT_KEYS = (*_SOURCES, "options", "set", "outputs")
_CONNECTION_KEYS = ("from", "to", "factor", "offset", "convert")
_MONOLITHIC_KEYS = ("mechanism", "options", "set", "inputs", "compare")


@dataclass(frozen=True)
class Component:
    """One model of a system."""

    name: str
    kind: str
    """mechanism, part or fmu."""
    what: str | Path | Mechanism | Recipe
    """The mechanism or its name, the part, or the FMU (in an archive, its path there)."""
    options: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, float | str] = field(default_factory=dict)
    outputs: Sequence[str] | None = None
    """Names or patterns of the outputs to compute; None for all."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Units that an external description states for variables of an FMU, which must agree with the FMU."""


@dataclass(frozen=True)
class Connection:
    """A connection of an output to an input: `factor` times its value plus `offset`, after conversion of its unit."""

    source: str
    """COMPONENT.OUTPUT."""
    target: str
    """COMPONENT.INPUT."""
    factor: float = 1.0
    offset: float = 0.0
    convert: str | None = None
    """Conversion of units, both of them as "r/min -> rad/s", if they differ; "*" converts any units, "none" none, as an
    SSP may request."""

    def __str__(self) -> str:
        return f"{self.source} -> {self.target}"


@dataclass(frozen=True)
class Monolithic:
    """One mechanism equivalent to a system, to judge its coupling."""

    mechanism: str | Path | Mechanism | Recipe
    compare: Mapping[str, str]
    """Outputs of the system, and the outputs of the mechanism for comparison."""
    options: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, float | str] = field(default_factory=dict)
    inputs: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, repr=False, eq=False)
class Description:
    """Description of a system; `alfmu.System` documents the fields."""

    name: str
    components: Mapping[str, Any]
    connections: Sequence[Any]
    inputs: Mapping[str, float] = field(default_factory=dict)
    stop_time: float = 1.0
    communication_step: float = 1e-3
    master: str = "held"
    start_time: float = 0.0
    description: str = ""
    bonds: Sequence[tuple[str, str]] | None = None
    monolithic: Monolithic | None = None
    folder: Path = Path()
    """Base folder of paths of FMUs."""
    archive: Path | None = None
    """The SSP that contains the FMUs, if any."""

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.strip():
            raise InputError(f"a system is called {shown(self.name)}; give it a name")
        for field_name in ("name", "description"):
            text(f"the {field_name} of the system {self.name}", getattr(self, field_name))
        who = f"the system {self.name}"
        for what in ("stop_time", "communication_step", "start_time"):
            value = getattr(self, what)
            if not _is_number(value) or (what != "start_time" and value <= 0) or value < 0:
                raise InputError(f"{who}: {what} is {shown(value)}; it must be a finite number of seconds above zero")
        if self.stop_time <= self.start_time:
            raise InputError(f"{who}: stop_time is {self.stop_time:g} s; it must be after {self.start_time:g} s")
        if self.master not in list(MASTERS):
            raise InputError(f"{who}: there is no master {shown(self.master)}; use {in_words(list(MASTERS))}")
        if not isinstance(self.components, Mapping) or not self.components:
            raise InputError(f"{who} has no components; give it some by name")
        components = {name: _component(who, name, what) for name, what in self.components.items()}
        connections = tuple(_connection(who, each) for each in self.connections)
        object.__setattr__(self, "components", MappingProxyType(components))
        object.__setattr__(self, "connections", connections)
        fed: dict[str, Connection] = {}
        for each in connections:
            for end in (each.source, each.target):
                self._of_component(who, end)
            if each.target in fed:
                raise InputError(f"{who}: {each.target} is connected to {fed[each.target].source} and {each.source}")
            fed[each.target] = each
        for name, value in self.inputs.items():
            self._of_component(who, name)
            if name in fed:
                raise InputError(f"{who}: the input {name} is given, and connected to {fed[name].source}; give one")
            if not _is_number(value) and not isinstance(value, bool):
                raise InputError(f"{who}: the input {name} is {shown(value)}; it must be a finite number")
        object.__setattr__(self, "inputs", MappingProxyType(dict(self.inputs)))
        sources = [each.source for each in connections]
        for bond in self.bonds or ():
            for end in bond:
                if end not in sources:
                    raise InputError(f"{who}: the bond {bond} has {end!r}, which is connected to nothing")

    def __repr__(self) -> str:
        sizes = f"{counted(len(self.components), 'component')}, {counted(len(self.connections), 'connection')}"
        return f"{type(self).__name__}({self.name!r}, {sizes}, {self.master}, {self.communication_step:g} s)"

    def _of_component(self, who: str, name: str) -> None:
        component = name.partition(".")[0]
        if component not in self.components:
            raise InputError(f"{who}: {name!r} is of no component; {there_is(component, self.components)}")

    def changed(self, **given: Any) -> Self:
        """Return the system with other fields, of which None changes nothing; inputs are merged."""
        given = {name: value for name, value in given.items() if value is not None}
        if "inputs" in given:
            given["inputs"] = {**self.inputs, **given["inputs"]}
        return replace(self, **given)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _component(who: str, name: object, what: Any) -> Component:
    """Return a component from a user's value."""
    if not isinstance(name, str) or not _NAME.match(name):
        raise InputError(f"{who} has a component {shown(name)}; use letters, digits and _ in its name")
    if isinstance(what, Component):
        return replace(what, name=name)
    if isinstance(what, Mechanism | Recipe):
        return Component(name, "mechanism", what)
    if isinstance(what, str | Path):
        return Component(name, "fmu" if str(what).lower().endswith(".fmu") else "mechanism", what)
    raise InputError(f"{who}: the component {name} is {shown(what)}; give a mechanism, a recipe, a name or a file")


def _connection(who: str, given: Any) -> Connection:
    if isinstance(given, tuple | list) and len(given) == 2:
        given = Connection(*given)
    if not isinstance(given, Connection):
        raise InputError(f'{who}: a connection is {shown(given)}; give ("COMPONENT.OUTPUT", "COMPONENT.INPUT")')
    for end in (given.source, given.target):
        if not isinstance(end, str) or not all(end.partition(".")[::2]):
            raise InputError(f"{who}: a connection ends at {shown(end)}; give COMPONENT.VARIABLE")
    if not _is_number(given.factor) or not _is_number(given.offset) or not given.factor:
        raise InputError(
            f"{who}, {given}: factor {shown(given.factor)} and offset {shown(given.offset)}; give finite numbers, and "
            "a factor other than zero"
        )
    return given


# Files ---------------------------------------------------------------------------------------------------------------


def read_toml(path: Path) -> dict[str, Any]:
    """Return the fields of the `Description` in a TOML file."""
    try:
        found = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot read {path} ({error.strerror})") from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path} is no TOML file ({error})") from None
    _known(path, "", found, _FILE_KEYS)
    components = {}
    for name, table in _table(path, "components", found.get("components", {})).items():
        components[name] = _read_component(path, name, _table(path, f"components.{name}", table))
    connections = []
    listed = found.get("connections", [])
    if not isinstance(listed, list):
        raise InputError(f"{path}: connections is no list; write [[connections]] for each")
    for table in listed:
        table = _table(path, "connections", table)
        _known(path, "connections", table, _CONNECTION_KEYS)
        if lacking := [key for key in ("from", "to") if key not in table]:
            raise InputError(f"{path}: a connection has no {lacking[0]!r}; give from and to")
        if "->" not in str(table.get("convert", "->")):
            raise InputError(f'{path}: convert is {shown(table["convert"])}; give both units, as "r/min -> rad/s"')
        more = {key: table[key] for key in ("factor", "offset", "convert") if key in table}
        connections.append(Connection(table["from"], table["to"], **more))
    bonds = found.get("bonds")
    pairs = isinstance(bonds, list) and all(isinstance(b, list) and len(b) == 2 for b in bonds)
    if bonds is not None and not pairs:
        raise InputError(f"{path}: bonds is {shown(bonds)}; give pairs of sources of connections")
    plain = ("stop_time", "communication_step", "master", "start_time", "description")
    own: dict[str, Any] = {key: found[key] for key in plain if key in found}
    own |= {"inputs": _table(path, "inputs", found.get("inputs", {})), "folder": path.parent}
    own["bonds"] = None if bonds is None else [tuple(b) for b in bonds]
    own["monolithic"] = _read_monolithic(path, found["monolithic"]) if "monolithic" in found else None
    return {"name": found.get("name", path.stem), "components": components, "connections": connections, **own}


def _known(path: Path, where: str, table: Mapping[str, Any], keys: Iterable[str]) -> None:
    for key in table:
        if key not in keys:
            raise InputError(
                f"{path}: there is no key {where + '.' if where else ''}{key}; {there_is(key, list(keys))}"
            )


def _table(path: Path, name: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InputError(f"{path}: {name} is {shown(value)}; it must be a table, [{name}]")
    return value


def _source(path: Path, what: Any) -> Any:
    """Return a mechanism's name, or the path of a file in the folder of the TOML file."""
    return path.parent / what if isinstance(what, str) and is_file(what) else what


def _read_component(path: Path, name: str, table: dict[str, Any]) -> Component:
    _known(path, f"components.{name}", table, _COMPONENT_KEYS)
    given = [key for key in _SOURCES if key in table]
    if len(given) != 1 or not isinstance(table[given[0]], str):
        has = " and ".join(given) or "no model"
        raise InputError(f"{path}: the component {name} has {has}; give it a text for one of {in_words(_SOURCES)}")
    kind = given[0]
    outputs = table.get("outputs")
    if outputs is not None and not (isinstance(outputs, list) and all(isinstance(x, str) for x in outputs)):
        raise InputError(f"{path}: components.{name}.outputs is {shown(outputs)}; give a list of names or patterns")
    options, parameters = (_table(path, f"components.{name}.{key}", table.get(key, {})) for key in ("options", "set"))
    what = table[kind] if kind == "fmu" else _source(path, table[kind])
    if kind == "fmu" and (options or outputs is not None):
        raise InputError(f"{path}: the component {name} is an FMU, whose options and outputs are fixed; leave them out")
    return Component(name, kind, what, options, parameters, outputs)


def _read_monolithic(path: Path, value: Any) -> Monolithic:
    table = _table(path, "monolithic", value)
    _known(path, "monolithic", table, _MONOLITHIC_KEYS)
    if not isinstance(table.get("mechanism"), str):
        raise InputError(f"{path}: monolithic has no mechanism; give a name or a Python file")
    parts = {
        key: _table(path, f"monolithic.{key}", table.get(key, {})) for key in ("compare", "options", "set", "inputs")
    }
    if bad := [name for pair in parts["compare"].items() for name in pair if not isinstance(name, str)]:
        raise InputError(f"{path}: monolithic.compare has {shown(bad[0])}; give names of outputs")
    return Monolithic(
        _source(path, table["mechanism"]), parts["compare"], parts["options"], parts["set"], parts["inputs"]
    )
