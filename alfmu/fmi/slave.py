"""The slave that pythonfmu runs inside an FMU: FMI calls by value reference on one `Instance`.

This module and everything it imports travel inside the FMU, under a package name of their own.
"""

from __future__ import annotations

from pathlib import Path

from pythonfmu import Fmi2Slave
from pythonfmu.enums import Fmi2Status

from ..equations import Equations, Variable
from ..errors import AlfmuError, InputError
from ..runtime import FORMULATION, FORMULATION_TEXT, Instance

__all__ = ["SCENE", "Slave", "interface"]

SCENE = "scene.json"
"""Name of the file with the equations, in the resources of the FMU."""


def interface(instance: Instance) -> list[tuple[str, Variable]]:
    """Every variable of the FMU with its causality; the place in the list is the value reference."""
    formulation = Variable(FORMULATION, "1", description=FORMULATION_TEXT, type="String")
    return [
        *(("parameter", v) for v in instance.parameters),
        ("parameter", formulation),
        *(("input", v) for v in instance.equations.inputs),
        *(("output", v) for v in instance.outputs),
    ]


class Slave(Fmi2Slave):
    """One mechanism behind FMI 2.0; an FMU entry subclasses it under the name of its mechanism.

    Errors: a step that cannot be taken is discarded with the reason in the log and the state before it kept; an error
    before the first step (a loop that cannot be closed) is raised, which is fatal in FMI.
    """

    def __init__(self, **kwargs):  # noqa: ANN003 - the signature of pythonfmu
        super().__init__(**kwargs)
        equations = Equations.from_json((Path(self.resources) / SCENE).read_text(encoding="utf-8"))
        self.modelName = equations.name
        self.instance = Instance(equations)
        self._names = [v.name for _, v in interface(self.instance)]
        causalities = [causality for causality, _ in interface(self.instance)]
        self._first_input = len(self.instance.parameters) + 1
        self._first_output = causalities.index("output")
        self._running = False

    # Life --------------------------------------------------------------------------------------------------------

    def setup_experiment(self, start_time: float, stop_time: float | None = None, tolerance: float | None = None):
        self.instance.time = start_time

    def exit_initialization_mode(self) -> None:
        self._assembled()
        self._running = True

    def do_step(self, current_time: float, step_size: float) -> bool:
        try:
            self.instance.step(step_size, current_time)
        except AlfmuError as error:
            self.log(str(error), Fmi2Status.discard)
            return False
        return True

    def _assembled(self) -> Instance:
        if not self.instance.initialized:
            self.instance.initialize()
        return self.instance

    # Values ------------------------------------------------------------------------------------------------------

    def get_real(self, vrs: list[int]) -> list[float]:
        i, first_input, first_output = self.instance, self._first_input, self._first_output
        if vrs and min(vrs) >= first_output:
            y = self._read()
            return [float(y[vr - first_output]) for vr in vrs]
        values = []
        for vr in vrs:
            if vr >= first_output:
                values.append(float(self._read()[vr - first_output]))
            elif vr >= first_input:
                values.append(float(i.inputs[vr - first_input]))
            else:
                values.append(float(i.values[vr]))
        return values

    def get_integer(self, vrs: list[int]) -> list[int]:
        return [int(value) for value in self.get_real(vrs)]

    def get_string(self, vrs: list[int]) -> list[str]:
        return [str(self.instance.get(self._names[vr])) for vr in vrs]

    def set_real(self, vrs: list[int], values: list[float]) -> None:
        i = self.instance
        for vr, value in zip(vrs, values, strict=True):
            if vr >= self._first_output:
                raise InputError(f"{self.modelName}: {self._names[vr]} is an output and cannot be set")
            if vr >= self._first_input:
                # Taken as it is: a bad value discards the next step, which can be repeated with a good one.
                i.override(vr - self._first_input, value)
            else:
                self._set(self._names[vr], value)

    def set_integer(self, vrs: list[int], values: list[int]) -> None:
        self.set_real(vrs, values)

    def set_string(self, vrs: list[int], values: list[str]) -> None:
        for vr, value in zip(vrs, values, strict=True):
            self._set(self._names[vr], value)

    def _set(self, name: str, value: float | str) -> None:
        if not self._running:
            self.instance.initialized = False
        self.instance.set(name, value)

    def _read(self):  # noqa: ANN202 - an array
        try:
            return self._assembled().read()
        except AlfmuError as error:
            if not self.instance.initialized:
                raise
            self.log(str(error), Fmi2Status.warning)
            return self.instance.read_state()

    # State -------------------------------------------------------------------------------------------------------

    def _get_fmu_state(self) -> bytes:
        return bytes([self._running]) + self.instance.save()

    def _set_fmu_state(self, state: bytes) -> None:
        self.instance.restore(state[1:])
        self._running = bool(state[0])

    @staticmethod
    def _fmu_state_to_bytes(state: bytes) -> bytes:
        return state

    @staticmethod
    def _fmu_state_from_bytes(state: bytes) -> bytes:
        return bytes(state)
