"""The slave that pythonfmu runs inside an FMU: FMI calls by value reference on one `Instance`.

This module and everything it imports travel inside the FMU, under a package name of their own.
"""

from __future__ import annotations

import ctypes
import logging
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, wraps
from pathlib import Path
from typing import Any

from pythonfmu import Fmi2Slave
from pythonfmu.enums import Fmi2Status

from ..equations import Equations, Variable
from ..equations.interface import CHOICES, choices
from ..kernel.program import LIBRARY, PLATFORM
from ..model.errors import AlfmuError, ExportError, InputError
from ..runtime import Instance

__all__ = ["FUNCTIONS", "SCENE", "Slave", "interface", "loaded"]

_LOGGER = logging.getLogger("alfmu")

SCENE = "scene.json"
"""Name of the file with the equations, in the resources of the FMU."""

FUNCTIONS = "functions.json"
"""Name of the file with their functions in portable form, there too."""


def interface(instance: Instance) -> list[tuple[str, Variable]]:
    """Every variable of the FMU with its causality; the place in the list is the value reference."""
    return [
        *(("parameter", v) for v in instance.parameters),
        *(("parameter", v) for v in choices(instance.choices)),
        *(("input", v) for v in instance.input_variables),
        *(("output", v) for v in instance.outputs),
    ]


def loaded(folder: Path) -> tuple[Equations, str]:
    """The scene in the resources of an FMU, and one line on what runs it.

    Compiled functions where there are some for this platform, otherwise the portable ones; ExportError where there are
    neither, or where these need a package that is missing.
    """
    scene = (folder / SCENE).read_text(encoding="utf-8")
    equations = Equations.from_json(scene)
    name = equations.name
    kernel = "kernel" if equations.kernel else "oracle"
    if equations.workspace:
        from ..kernel.compiled import Library

        if (folder / LIBRARY).is_file():
            library = Library(folder / LIBRARY, equations)
            return replace(equations, library=library), f"{name}: compiled {kernel} for {PLATFORM}"
    if not (folder / FUNCTIONS).is_file():
        there = ", ".join(sorted(path.name for path in folder.glob("kernel-*")))
        raise ExportError(f"{name}: this FMU has {there}, nothing for {PLATFORM}; export it without --no-portable")
    try:
        equations = _portable(scene, (folder / FUNCTIONS).read_text(encoding="utf-8"))
    except ImportError as error:
        missing = f"{name}: the portable {kernel} needs the Python package {error.name}; install it"
        raise ExportError(missing) from None
    return equations, f"{name}: portable {kernel}"


@lru_cache(maxsize=1)
def _portable(scene: str, functions: str) -> Equations:
    """A scene with its functions in portable form: kept, as instances and resets of an FMU share it."""
    from ..kernel.vm import with_serialized

    return with_serialized(Equations.from_json(scene), functions)


def _kept(*objects: object) -> None:
    """Give objects a reference that nobody drops, against one that pythonfmu's library drops but does not own."""
    for each in objects:
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(each))


def _called_from_fmi(call: Callable[..., Any]) -> Callable[..., Any]:
    """A call whose exceptions reach pythonfmu's library, and so the host as fmi2Fatal.

    The library drops its references to class, instance and log at the exception, and again when the instance is freed.
    The reason goes to the Python logger, not to the FMI log: with anything logged,
    the text of the exception is lost there.
    """

    @wraps(call)
    def guarded(self: Slave, *arguments: Any, **named: Any) -> Any:
        try:
            return call(self, *arguments, **named)
        except Exception as error:
            _fatal(self, error)
            raise

    return guarded


def _fatal(slave: Slave, error: Exception) -> None:
    _LOGGER.error("%s", error)
    _kept(type(slave), slave, slave.log_queue)


class Slave(Fmi2Slave):
    """One mechanism behind FMI 2.0; an FMU entry subclasses it under the name of its mechanism.

    A step that cannot be taken is discarded and the state before it kept; a value that is refused discards the next
    step, or ends the initialisation, unless a good one follows; a mechanism that cannot be assembled ends the
    initialisation (fatal in FMI). The reason goes to the FMI log and, as hosts often have that switched off, to the
    Python logger `alfmu`.
    """

    def __init_subclass__(cls) -> None:
        # The library runs the entry module at each instantiation, and then drops the module's dictionary.
        _kept(sys.modules[cls.__module__].__dict__)
        super().__init_subclass__()

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        equations, self._kernel = loaded(Path(self.resources))
        if equations.reason:
            self._kernel += f", {equations.reason}"
        _LOGGER.info("%s", self._kernel)
        self.modelName = equations.name
        self.instance = Instance(equations)
        self._names = [v.name for _, v in interface(self.instance)]
        causalities = [causality for causality, _ in interface(self.instance)]
        self._first_input = len(self.instance.parameters) + len(CHOICES)
        self._first_output = causalities.index("output")
        self._running = False
        self._refused: dict[str, str] = {}

    # Life --------------------------------------------------------------------------------------------------------

    def setup_experiment(self, start_time: float, stop_time: float | None = None, tolerance: float | None = None):
        self.instance.time = start_time
        if tolerance and self.instance.adapts:
            self._set(self._names.index("solver.relative_tolerance"), tolerance)
        self.log(self._kernel, Fmi2Status.ok, "logAll")

    @_called_from_fmi
    def exit_initialization_mode(self) -> None:
        self._no_refusals()
        if not self.instance.initialized:
            self.instance.initialize()
        self._running = True

    def do_step(self, current_time: float, step_size: float) -> bool:
        try:
            if self._refused:
                self._no_refusals()
            self.instance.step(step_size, current_time)
        except AlfmuError as error:
            self._say(error, Fmi2Status.discard)
            return False
        except Exception as error:  # As in `_called_from_fmi`, whose wrapper would cost every step.
            _fatal(self, error)
            raise
        return True

    def _no_refusals(self) -> None:
        refused, self._refused = self._refused, {}
        if refused:
            raise InputError("; ".join(refused.values()))

    def _say(self, error: AlfmuError, status: Fmi2Status) -> None:
        _LOGGER.warning("%s", error)
        self.log(str(error), status)

    # Values ------------------------------------------------------------------------------------------------------

    @_called_from_fmi
    def get_real(self, vrs: list[int]) -> list[float]:
        first_output = self._first_output
        if vrs and min(vrs) >= first_output:  # What is asked for in every step.
            y = self._read().tolist()
            return [y[i - first_output] for i in vrs]
        inputs, values = self.instance.read_inputs().tolist(), self.instance.values.tolist()
        y = self._read().tolist() if vrs and max(vrs) >= first_output else []
        known = [*values, *self.instance.choices.values(), *inputs, *y]
        return [known[i] for i in vrs]

    @_called_from_fmi
    def get_integer(self, vrs: list[int]) -> list[int]:
        return [int(value) for value in self.get_real(vrs)]

    @_called_from_fmi
    def get_boolean(self, vrs: list[int]) -> list[bool]:
        return [value != 0.0 for value in self.get_real(vrs)]

    @_called_from_fmi
    def get_string(self, vrs: list[int]) -> list[str]:
        return [str(self.instance.get(self._names[vr])) for vr in vrs]

    @_called_from_fmi
    def set_real(self, vrs: list[int], values: list[float]) -> None:
        for vr, value in zip(vrs, values, strict=True):
            self._set(vr, value)

    set_integer = set_boolean = set_string = set_real

    def _set(self, vr: int, value: float | str) -> None:
        name = self._names[vr]
        self._refused.pop(name, None)
        try:
            if vr >= self._first_output:
                raise InputError(f"{self.modelName}: {name} is an output and cannot be set")
            if vr < self._first_input and not self._running:
                self.instance.initialized = False
            self.instance.set(name, value)
        except AlfmuError as error:
            self._refused[name] = str(error)

    def _read(self):
        instance = self.instance
        if not instance.initialized:
            instance.initialize()
        try:
            return instance.read()
        except AlfmuError as error:
            self._say(error, Fmi2Status.warning)
            return instance.read_state()

    # State -------------------------------------------------------------------------------------------------------

    @_called_from_fmi
    def _get_fmu_state(self) -> bytes:
        return bytes([self._running]) + self.instance.save()

    @_called_from_fmi
    def _set_fmu_state(self, state: bytes) -> None:
        self.instance.restore(state[1:])
        self._running, self._refused = bool(state[0]), {}

    @staticmethod
    def _fmu_state_to_bytes(state: bytes) -> bytes:
        return state

    @staticmethod
    def _fmu_state_from_bytes(state: bytes) -> bytes:
        return bytes(state)
