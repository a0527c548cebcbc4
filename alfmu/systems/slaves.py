"""Opened components of a system, with one interface for mechanisms in this process and FMUs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..analysis.start import rest_of
from ..equations import Equations
from ..fmi.drive import Fmu, kind_of
from ..fmi.export import packed_scene
from ..model.errors import AlfmuError, DeclarationError, InputError
from ..model.words import there_is
from ..parts.blocks import BLOCKS
from ..runtime import Instance
from .ports import Measure, Port, measure

if TYPE_CHECKING:
    from ..fmi.recipe import Recipe
    from .description import Component


class Slave(ABC):
    """A component that can be stepped, rewound, and read."""

    name: str
    ports: dict[str, Port]
    unit: Instance | Fmu
    """The mechanism or FMU that runs; another one after `begin` of a mechanism."""

    @property
    def interpolates(self) -> bool:
        """Whether its inputs may change linearly within a step."""
        return isinstance(self.unit, Instance) or self.unit.interpolates

    @property
    def rewinds(self) -> bool:
        """Whether its state can be saved and restored."""
        return isinstance(self.unit, Instance) or self.unit.rewinds

    @property
    def inputs(self) -> list[Port]:
        return [p for p in self.ports.values() if p.kind == "input"]

    @property
    def outputs(self) -> list[Port]:
        """Outputs in the order of `read`."""
        return [p for p in self.ports.values() if p.kind == "output"]

    @abstractmethod
    def begin(self, inputs: Mapping[str, float], start_time: float) -> None:
        """Restart with these inputs."""

    def set(self, name: str, value: float) -> None:
        """Set an input."""
        self.unit.set(name, value)

    def slope(self, name: str, rate: float) -> None:
        """Set the rate of change of an input in the next step, per second."""
        self.unit.slope(name, rate)

    def step(self, communication_step: float, time: float) -> None:
        self.unit.step(communication_step, time)

    def read(self) -> NDArray[np.float64]:
        return self.unit.read()

    def get(self, name: str) -> float:
        """Return the value of an input."""
        return float(self.unit.read_inputs()[[v.name for v in self.unit.input_variables].index(name)])

    def save(self) -> bytes:
        return self.unit.save()

    def restore(self, state: bytes) -> None:
        self.unit.restore(state)

    @abstractmethod
    def close(self) -> None:
        """Free resources."""


class Local(Slave):
    """A mechanism in this process, with the runtime and scene of its FMU."""

    def __init__(self, name: str, equations: Equations):
        self.name, self._equations = name, equations
        self.unit = i = Instance(equations)
        real = frozenset(v.name for v in i.input_variables if v.type == "Real")
        self.ports = {}
        for kind, variables in (("parameter", i.parameters), ("input", i.input_variables), ("output", i.outputs)):
            for v in variables:
                follows = real if kind == "output" and v.instant else frozenset()
                unit = v.unit if v.type == "Real" else None
                self.ports[v.name] = Port(v.name, kind, v.type, unit, measure(unit), v.description, follows)

    def begin(self, inputs: Mapping[str, float], start_time: float) -> None:
        self.unit = Instance(self._equations)
        self.unit.time = start_time
        self.unit.initialize_with(inputs)

    def close(self) -> None:
        """Do nothing: an instance frees itself."""


class Remote(Slave):
    """An FMU."""

    def __init__(self, name: str, path: Path, parameters: Mapping[str, float | str], stated: Mapping[str, str]):
        self.name, self._parameters = name, dict(parameters)
        self.unit = self._fmu = fmu = Fmu(path)
        units: dict[str, Measure] = {}
        for each in fmu.description.unitDefinitions:
            if (base := each.baseUnit) is not None and each.name:
                exponents = {n: getattr(base, n) for n in ("kg", "m", "s", "A", "K", "mol", "cd", "rad")}
                units[each.name] = Measure.of(each.name, exponents, base.factor, base.offset)
        written = {v.name: v for v in fmu.description.modelVariables}
        self.kinds = {name: kind_of(v.type) for name, v in written.items()}
        """Types of all variables, including those that cannot be connected."""
        self.ports = {}
        found = [("parameter", p) for p in fmu.parameters]
        found += [("input", v.name) for v in fmu.input_variables] + [("output", v.name) for v in fmu.outputs]
        for kind, each in found:
            v = written[each]
            declared = v.declaredType
            own = v.unit or (declared.unit if declared is not None else None)
            follows = fmu.followed(each) if kind == "output" else frozenset()
            unit = units.get(str(own)) or measure(own)
            if unit is not None and (v.relativeQuantity or (declared is not None and declared.relativeQuantity)):
                unit = replace(unit, offset=0.0)  # the offset does not apply to differences
            self.ports[each] = Port(each, kind, self.kinds[each], own, unit, v.description or "", follows)
        try:
            for key, unit_name in stated.items():
                self._check_unit(key, unit_name)
            for key, value in self._parameters.items():  # set first, so that a bad value is reported at once
                fmu.set(key, value)
        except AlfmuError:
            fmu.close()
            raise

    def _check_unit(self, name: str, stated: str) -> None:
        """Raise InputError if a variable does not have the unit stated in an external description."""
        port = self.ports.get(name)
        if (
            port is not None
            and port.unit not in (None, stated)
            and (port.measure is None or measure(stated) != port.measure)
        ):
            raise InputError(f"{name} is in {port.unit} and described in {stated}; describe it in {port.unit}")

    def begin(self, inputs: Mapping[str, float], start_time: float) -> None:
        if self._fmu.begun:
            self._fmu.reset()
        for name, value in {**self._parameters, **inputs}.items():
            self._fmu.set(name, value)
        self._fmu.initialize(start_time)

    def close(self) -> None:
        self._fmu.close()


def recipe_of(component: Component) -> Recipe:
    """Return the recipe of a mechanism or part."""
    from ..fmi.recipe import Recipe, of

    c = component
    if c.kind == "part":
        if c.what not in BLOCKS:
            raise InputError(f"there is no part {c.what!r}; {there_is(c.what, BLOCKS)}")
        make = partial(BLOCKS[str(c.what)], **c.options)
        try:
            recipe = Recipe(make())
        except DeclarationError as error:  # options come from the description
            raise InputError(str(error)) from None
        return recipe.changed(parameters=c.parameters, outputs=c.outputs)
    return of(c.what).changed(options=c.options, parameters=c.parameters, outputs=c.outputs)


def opened(component: Component, folder: Path, parameters: Mapping[str, float | str]) -> Slave:
    """Open a component, with additional parameters; FMUs of an archive are in this folder.

    Raises AlfmuError with the component's name.
    """
    given = {**component.parameters, **parameters}
    with naming(component):
        if component.kind == "fmu":
            return Remote(component.name, folder / str(component.what), given, component.units)
        recipe = recipe_of(component).changed(parameters=parameters)
        scene = (recipe.parameters, recipe.outputs, recipe.freeze, recipe.kernel, rest_of(recipe))
        return Local(component.name, packed_scene(recipe.declared(), *scene)[1])


@contextmanager
def naming(component: Component) -> Iterator[None]:
    """Add the component's name to errors."""
    try:
        yield
    except AlfmuError as error:
        raise type(error)(f"the component {component.name}: {error}") from None


def outputs_of(slaves: Sequence[Slave]) -> NDArray[np.float64]:
    """Return the outputs of all, concatenated."""
    return np.concatenate([each.read() for each in slaves])
