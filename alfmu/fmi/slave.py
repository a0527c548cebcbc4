"""The slave that pythonfmu runs inside an FMU: FMI calls by value reference on one unit of the runtime.

This module and `alfmu.runtime.library` are packed into the FMU under their own package name, beside the C library; they
need Python alone.
"""

from __future__ import annotations

import atexit
import ctypes
import logging
import math
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache, wraps
from pathlib import Path
from typing import Any

from pythonfmu import Fmi2Slave
from pythonfmu.enums import Fmi2Status

from ..runtime.library import DONE, Scene, Unit, library

_LOGGER = logging.getLogger("alfmu")

SCENE = "scene.bin"
"""File name of the scene in the resources of an FMU."""

COMPILED = "compiled-"
"""Prefix of the file names of compiled functions."""

_STOP = -1
"""Marks the stop time in place of a value reference."""

OPTIONS = "options.json"
"""File name of the options of the mechanism."""


def _kept(*objects: object) -> None:
    """Add a permanent reference to objects whose reference pythonfmu's library drops without owning it."""
    for each in objects:
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(each))


@cache
def _ends_once(resources: Path) -> None:
    """Make pythonfmu's library beside these resources release its interpreter when Python ends.

    Otherwise it does so twice at the end of the process: it writes into freed memory, and a host may abort after its
    results are written (pythonfmu 0.7.0, its issue 229). Not done on Windows, where it is untested.
    """
    if not hasattr(os, "RTLD_NOLOAD"):
        return
    for path in resources.parent.glob("binaries/linux64/*.so"):
        with suppress(OSError, AttributeError):  # a host may use another library or version
            atexit.register(ctypes.CDLL(str(path), mode=os.RTLD_NOLOAD | os.RTLD_NOW).finalizePythonInterpreter)


def _called_from_fmi(call: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap a call so that its exceptions reach pythonfmu's library, and so the host as fmi2Fatal.

    The library drops its references to class, instance and log at the exception, and again when the instance is freed.
    The reason goes to the Python logger, not to the FMI log: logging there loses the text of the exception.
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


class Slave(Fmi2Slave):  # type: ignore[misc]  # pythonfmu has no types
    """One mechanism as an FMI 2.0 slave; an FMU entry subclasses it under the name of its mechanism.

    A step that fails is discarded, and the previous state stays. A rejected value leaves the previous one in force and,
    as pythonfmu has no status for it, discards the next step or fails the initialisation, unless a valid one follows.
    If a mechanism cannot be assembled, the initialisation fails (fatal in FMI). The reason goes to the FMI log and, as
    many hosts disable it, to the Python logger `alfmu`.
    """

    def __init_subclass__(cls) -> None:
        # The library runs the entry module at each instantiation, and then drops its reference to the module's
        # dictionary.
        _kept(sys.modules[cls.__module__].__dict__)
        super().__init_subclass__()

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        folder = Path(self.resources)
        _ends_once(folder)
        self.scene = self._scene(folder)
        for path in folder.glob(f"{COMPILED}*"):
            with suppress(OSError):  # compiled for another platform
                self.scene.compiled_by(path)
        self.unit = Unit(self.scene)
        self.modelName = self.scene.name
        self._refused: dict[int, str] = {}
        self._step, self._warns = self.unit.step, self.unit.warns  # cached for every doStep

    def _scene(self, folder: Path) -> Scene:
        """Return the scene from the resources, run by the library there."""
        if not (folder / SCENE).is_file():
            raise ValueError(f"there is no {SCENE} in its resources; unpack the whole FMU")
        return Scene((folder / SCENE).read_bytes(), library(folder))

    # Life cycle --------------------------------------------------------------------------------------------------

    def setup_experiment(
        self, start_time: float, stop_time: float | None = None, tolerance: float | None = None
    ) -> None:
        self._refused.pop(_STOP, None)
        if self.unit.begin(start_time, math.inf if stop_time is None else stop_time) != DONE:
            self._refused[_STOP] = self.unit.text
        if tolerance and self.unit.tolerate(tolerance) != DONE:
            self._say(self.unit.text, Fmi2Status.warning)

    @_called_from_fmi
    def exit_initialization_mode(self) -> None:
        refused, self._refused = self._refused, {}
        if refused:
            raise RuntimeError("; ".join(refused.values()))
        self._initialize()
        self.unit.run_on(True)

    def do_step(self, current_time: float, step_size: float) -> bool:
        if self._refused:
            self._say("; ".join(self._refused.values()), Fmi2Status.discard)
            self._refused.clear()
            return False
        if self._step(current_time, step_size) != DONE:
            self._say(self.unit.text, Fmi2Status.discard)
            return False
        if self._warns.value:
            self._say(self.unit.warning(), Fmi2Status.warning)
        return True

    def _initialize(self) -> None:
        if self.unit.initialized:
            return
        if self.unit.initialize() != DONE:
            raise RuntimeError(self.unit.text)
        if self.unit.text:
            self._say(self.unit.text, Fmi2Status.warning)

    def _say(self, text: str, status: Fmi2Status) -> None:
        _LOGGER.warning("%s", text)
        self.log(text, status)

    # Values ------------------------------------------------------------------------------------------------------

    @_called_from_fmi
    def get_real(self, vrs: Sequence[int]) -> list[float]:
        if vrs and max(vrs) >= self.scene.first_output:
            self._initialize()
        outcome, values = self.unit.get_many(vrs)
        if outcome != DONE:
            self._say(self.unit.text, Fmi2Status.warning)
        return values

    @_called_from_fmi
    def get_integer(self, vrs: Sequence[int]) -> list[int]:
        return [int(value) for value in self.get_real(vrs)]

    @_called_from_fmi
    def get_boolean(self, vrs: Sequence[int]) -> list[bool]:
        return [value != 0.0 for value in self.get_real(vrs)]

    @_called_from_fmi
    def get_string(self, vrs: Sequence[int]) -> list[str]:
        return [str(self.unit.get(vr)) for vr in vrs]

    @_called_from_fmi
    def set_real(self, vrs: Sequence[int], values: Sequence[float | str]) -> None:
        for vr, value in zip(vrs, values, strict=True):
            self._refused.pop(vr, None)
            if self.unit.set(vr, value) != DONE:
                self._refused[vr] = self.unit.text

    set_integer = set_boolean = set_string = set_real

    # State -------------------------------------------------------------------------------------------------------

    @_called_from_fmi
    def _get_fmu_state(self) -> bytes:
        return self.unit.save()

    @_called_from_fmi
    def _set_fmu_state(self, state: bytes) -> None:
        if self.unit.restore(state) != DONE:
            raise ValueError(self.unit.text)
        self._refused.clear()

    @staticmethod
    def _fmu_state_to_bytes(state: bytes) -> bytes:
        return state

    @staticmethod
    def _fmu_state_from_bytes(state: bytes) -> bytes:
        return bytes(state)
