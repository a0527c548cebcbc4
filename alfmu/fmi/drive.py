"""An FMU run by fmpy, with the interface of an `Instance`."""

from __future__ import annotations

import json
import logging
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..catalogue import registry
from ..equations import Variable
from ..model.errors import AlfmuError, ExportError, InputError, StepError
from ..model.files import scratch
from ..model.mechanism import Mechanism
from ..model.words import there_is
from .slave import OPTIONS

try:
    from fmpy import extract, instantiate_fmu, platform_tuple, read_model_description, sharedLibraryExtension
    from fmpy import platform as platform_2
    from fmpy.fmi1 import FMICallException
    from fmpy.model_description import ModelDescription, ModelVariable
except ModuleNotFoundError as error:
    raise InputError(
        f"running or checking an FMU needs fmpy ({error}); install it with: pip install 'alfmu[fmu]'"
    ) from None

_LOGGER = logging.getLogger("alfmu")

_LOG: list[tuple[int, str]] = []
"""Status and text of the messages of the current call. All FMUs share the list, because fmpy passes every message to
the logger of the newest instance."""

_WARNING = 1
"""Status of a warning, in FMI 2 and 3."""


def _logged(*said: Any) -> None:
    """Store a logged message; status, category and text are the last arguments in every version of FMI."""
    _LOG.append((said[-3], (said[-1] or b"").decode(errors="replace")))


LARGEST = 4e9
"""Largest size of an unpacked FMU in bytes."""

_KINDS = {
    **{"Real": "Real", "Float64": "Real", "Float32": "Real", "Integer": "Integer"},
    **{f"{sign}Int{bits}": "Integer" for sign in ("", "U") for bits in (8, 16, 32, 64)},
    **{"Boolean": "Boolean", "String": "String", "Enumeration": "Enumeration"},
}
"""Types of FMI 2 and 3, and the kinds of values that they are mapped to."""

_NUMBERS = ("Real", "Integer", "Boolean")
"""Kinds with numerical values in a table."""

_STATE = {
    "2": ("getFMUstate", "setFMUstate", "freeFMUstate", "serializeFMUstate", "deSerializeFMUstate"),
    "3": ("getFMUState", "setFMUState", "freeFMUState", "serializeFMUState", "deserializeFMUState"),
}
"""Functions of fmpy that get, set, free, serialise and deserialise a state."""

_LOGGERS: list[object] = []
"""Callbacks of all FMUs, which must outlive them."""


def platforms_of(folder: Path) -> list[str]:
    """Return the platforms for which an unpacked FMU has a library."""
    return sorted(each.name for each in (folder / "binaries").glob("*") if each.is_dir() and any(each.iterdir()))


def missing_library(folder: Path, description: ModelDescription) -> str:
    """Return why the code of an unpacked FMU cannot run on this machine; empty if it can."""
    platform = platform_2 if description.fmiVersion.startswith("2") else platform_tuple
    name = f"{description.coSimulation.modelIdentifier}{sharedLibraryExtension}"
    if (folder / "binaries" / platform / name).is_file():
        return ""
    others = ", ".join(platforms_of(folder))
    return f"there is no library for {platform} in it; it has {f'those of {others}' if others else 'none'}"


def kind_of(type_name: str) -> str:
    """Return the kind of a type of FMI 2 or 3; Binary and others are `Other`."""
    return _KINDS.get(type_name, "Other")


class Fmu:
    """A co-simulation FMU of FMI 2 or 3, unpacked and instantiated; close it, or use it in a `with` statement.

    Of an FMI 3 FMU only the scalar variables are available.
    """

    def __init__(self, path: str | Path):
        checked_archive(path)
        self.description = description_of(path)
        self._version = self.description.fmiVersion[:1]
        if self._version not in _STATE or self.description.coSimulation is None:
            raise ExportError(f"{path} is not a co-simulation FMU of FMI 2.0 or 3.0; alfmu runs only these")
        self.name = self.description.modelName
        self._by_name = {v.name: v for v in self.description.modelVariables if not v.dimensions}
        self.outputs, self.input_variables = (
            [_variable(v) for v in self._of(each) if _KINDS.get(v.type) in _NUMBERS] for each in ("output", "input")
        )
        experiment = self.description.defaultExperiment
        self.stop_time = float(experiment.stopTime) if experiment and experiment.stopTime else 10.0
        self.interval = float(experiment.stepSize) if experiment and experiment.stepSize else 0.02
        self._inputs = self._readings(self.input_variables)
        self._outputs = self._readings(self.outputs)
        self.parameters = {
            v.name: float(v.start) for v in self._of("parameter") if _KINDS.get(v.type) == "Real" and v.start
        }
        """Defaults of numerical parameters."""
        with ExitStack() as stack:
            self._folder = stack.enter_context(scratch())
            extract(str(path), self._folder)
            checked_folder(self._folder, path)
            if missing := missing_library(Path(self._folder), self.description):
                raise ExportError(f"{path} cannot be instantiated: {missing}")
            try:
                self.slave = instantiate_fmu(
                    self._folder, self.description, "CoSimulation", debug_logging=True, logger=_logged
                )
                # fmpy's logging library calls the logger of the newest FMU of the process, even after it was freed.
                _LOGGERS.append(getattr(self.slave, "callbacks", None))
            except Exception:
                why = " ".join(self._why("it logs no reason").removeprefix("cannot be instantiated: ").split())
                raise ExportError(f"{path} cannot be instantiated: {why}") from None
            self._stack = stack.pop_all()
        self.mechanism, self.options = _facts(self._folder / "resources" / OPTIONS) or ("", {})
        """The mechanism and its options if alfmu exported the FMU, as stored in it."""
        self._logs = not (self.mechanism and (self._folder / "resources" / "slavemodule.txt").is_file())
        """Whether to pass on warnings; alfmu's own Python code logs them itself."""
        self.begun = False

    def __repr__(self) -> str:
        return f"Fmu({self.name!r}, FMI {self.description.fmiVersion}{'' if self.slave else ', closed'})"

    def __enter__(self) -> Fmu:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Free the instance and remove the unpacked files."""
        if self.slave is not None:
            slave, self.slave = self.slave, None
            slave.freeInstance()
        self._stack.close()

    def set(self, name: str, value: float | str) -> None:
        """Set a variable by name; one of an enumeration takes the name or number of an item.

        The FMU itself rejects a bad value: a native one at once, one in Python at the next step or at initialisation.
        """
        variable = self._by_name.get(name)
        if variable is None or variable.causality not in ("parameter", "input"):
            settable = [v.name for v in self._by_name.values() if v.causality in ("parameter", "input")]
            raise InputError(f"{self.name} has no input or parameter {name!r}; {there_is(name, settable)}")
        try:
            kinds: dict[str, Callable[[Any], Any]] = {
                "Real": float,
                "Integer": partial(_whole, variable.type),
                "Boolean": _truth,
                "String": str,
            }
            kinds["Enumeration"] = partial(_item, variable)
            if isinstance(value, bool) and variable.type != "Boolean":
                raise TypeError(value)
            value = kinds[_KINDS[variable.type]](value)
        except (KeyError, OverflowError, TypeError, ValueError):
            raise InputError(f"{self.name}: {name} is {value!r}; it must be a value of type {variable.type}") from None
        kind = variable.type
        if kind == "Enumeration":
            kind = "Integer" if self._version == "2" else "Int64"
        self._call(f"set{kind}", [variable.valueReference], [value])

    @property
    def rewinds(self) -> bool:
        """Whether the FMU declares that it saves and restores its state (`save`, `restore`)."""
        can = self.description.coSimulation
        return bool(can.canGetAndSetFMUstate and can.canSerializeFMUstate)

    @property
    def interpolates(self) -> bool:
        """Whether inputs may change linearly within a communication step (`slope`)."""
        return self._version == "2" and bool(self.description.coSimulation.canInterpolateInputs)

    def slope(self, name: str, rate: float) -> None:
        """Set the rate of change per second of a numerical input in the next communication step."""
        self._call("setRealInputDerivatives", [self._by_name[name].valueReference], [1], [rate])

    def followed(self, output: str) -> frozenset[str]:
        """Return the inputs on which an output depends directly; all of them if the description has no dependencies."""
        inputs = frozenset(v.name for v in self._of("input"))
        for unknown in self.description.outputs:
            if unknown.variable.name == output and unknown.dependencies is not None:
                return inputs & {v.name for v in unknown.dependencies}
        return inputs

    def initialize(self, start_time: float = 0.0) -> None:
        if self._version == "2":
            self._call("setupExperiment", startTime=start_time)
            self._call("enterInitializationMode")
        else:
            self._call("enterInitializationMode", startTime=start_time)
        self._call("exitInitializationMode")
        self.begun = True

    def step(self, communication_step: float, time: float) -> None:
        said = self._call("doStep", time, communication_step)
        if self._version == "3" and (said[1] or said[2]):
            raise StepError(self._why(f"{self.name}: doStep from {time:g} s ended at {said[3]:g} s"))

    def read(self) -> NDArray[np.float64]:
        return self._read(self._outputs, len(self.outputs))

    def read_inputs(self) -> NDArray[np.float64]:
        return self._read(self._inputs, len(self.input_variables))

    def _read(self, readings: dict[str, list[tuple[int, int]]], size: int) -> NDArray[np.float64]:
        y = np.empty(size)
        for kind, pairs in readings.items():
            y[[i for i, _ in pairs]] = self._call(f"get{kind}", [reference for _, reference in pairs])
        return y

    def _readings(self, variables: list[Variable]) -> dict[str, list[tuple[int, int]]]:
        """Return, by type, the indices of variables and their value references."""
        found: dict[str, list[tuple[int, int]]] = {}
        for i, v in enumerate(variables):
            found.setdefault(self._by_name[v.name].type, []).append((i, self._by_name[v.name].valueReference))
        return found

    def reset(self) -> None:
        """Return to the state after instantiation."""
        self._call("reset")
        self.begun = False

    def save(self) -> bytes:
        """Return the complete state, serialised by the FMU."""
        get, _, free, write, _ = _STATE[self._version]
        state = self._call(get)
        try:
            return self._call(write, state)
        finally:
            self._call(free, state)

    def restore(self, data: bytes) -> None:
        _, put, free, _, read = _STATE[self._version]
        state = self._call(read, data)
        try:
            self._call(put, state)
        finally:
            self._call(free, state)

    def settable(self) -> list[Variable]:
        """Return the numerical parameters."""
        return [_variable(v) for v in self._of("parameter") if _KINDS.get(v.type) in _NUMBERS]

    def starts(self) -> dict[str, str]:
        """Return the defaults of all parameters as in the description."""
        return {v.name: v.start for v in self._of("parameter") if v.start is not None}

    def facts(self, parameters: Mapping[str, float | str]) -> dict[str, Any]:
        """Return the metadata of a result: the FMU, its mechanism and these parameters."""
        known = {**self.parameters, **parameters}
        return {"mechanism": self.mechanism or self.name, "options": self.options, "parameters": known}

    def declared(self) -> Mechanism | None:
        """Return the installed mechanism named by the FMU, None if there is none; files are never executed."""
        try:
            return registry.load(self.mechanism, **self.options) if self.mechanism in registry.known() else None
        except (AlfmuError, TypeError, ValueError):  # options come from the FMU
            return None

    def _of(self, causality: str) -> Iterator[ModelVariable]:
        return (v for v in self._by_name.values() if v.causality == causality)

    def _call(self, function: str, *arguments: Any, **named: Any) -> Any:
        _LOG.clear()
        try:
            result = getattr(self.slave, function)(*arguments, **named)
        except FMICallException as error:
            raise StepError(self._why(f"{self.name}: {function} failed ({error})")) from None
        for status, text in _LOG if self._logs else ():
            if status == _WARNING:
                _LOGGER.warning("%s", text)
        return result

    def _why(self, what: str) -> str:
        """Return a message on a failure, with the FMU's own messages if there are any."""
        words = [line.split("InputError('")[-1].split("Error('")[-1].removesuffix("')") for _, line in _LOG]
        return words[-1] if words and words[-1] else what


def checked_archive(path: str | Path, kind: str = "an FMU") -> None:
    """Raise ExportError if an archive is damaged, too large, or has paths outside its folder."""
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            for each in members:
                name = each.orig_filename
                if name.startswith("/") or set(name) & set("\\:\0") or ".." in name.split("/"):
                    raise ExportError(f"{path} is not opened: it has a file {name!r}, a place outside its folder")
            if (size := sum(each.file_size for each in members)) > LARGEST:
                raise ExportError(f"{path} is not opened: it unpacks to {size:.1e} bytes, more than {LARGEST:.0e}")
            damaged = archive.testzip()
    except (OSError, zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
        why = getattr(error, "strerror", None) or error
        raise ExportError(f"{path} is not {kind} that can be read ({why})") from None
    if damaged:
        raise ExportError(f"{path} is damaged: the check sum of {damaged} does not agree; export or copy it again")


def checked_folder(folder: Path, path: str | Path) -> None:
    """Raise ExportError for a folder that crashes pythonfmu's library, which decodes only blanks in a URI."""
    resources = folder / "resources"
    if (resources / "slavemodule.txt").is_file() and "%" in resources.as_uri().replace("%20", ""):
        raise ExportError(
            f"{path} is of kind python, and cannot be started in {resources.parent}, where FMUs are unpacked: "
            "pythonfmu takes ASCII letters, digits, blanks and -._~ in a path alone; set TMPDIR to another one, or "
            "export with --kind native"
        )


def description_of(path: str | Path, valid: bool = True) -> ModelDescription:
    """Return the description in an FMU; if `valid`, it must follow the schema."""
    try:
        found = read_model_description(str(path), validate=valid)
    except Exception as error:  # fmpy passes on any exception of the XML parser
        raise ExportError(f"{path} is not an FMU that can be read ({error})") from None
    kinds = (found.coSimulation, found.modelExchange, getattr(found, "scheduledExecution", None))
    for name in (kind.modelIdentifier for kind in kinds if kind):
        if not (name.isascii() and name.isidentifier()):
            raise ExportError(f"{path} is not opened: its model identifier {name!r} is no C identifier")
    return found


def _facts(path: Path) -> tuple[str, dict[str, Any]] | None:
    """Return the mechanism and its options from a file that alfmu wrote; None for any other file."""
    try:
        known = json.loads(path.read_bytes())
        mechanism, options = known["mechanism"], known["options"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    return (mechanism, options) if isinstance(mechanism, str) and isinstance(options, dict) else None


def _truth(value: float | str) -> bool:
    known = {"true": True, "1": True, "1.0": True, "false": False, "0": False, "0.0": False}
    if (text := str(value).lower()) not in known:
        raise ValueError(value)
    return known[text]


def _item(v: ModelVariable, value: float | str) -> int:
    """Return the number of an item of an enumeration, given by name or number."""
    numbers = {item.name: int(item.value) for item in v.declaredType.items}
    return numbers[value] if value in numbers else _whole("Int64", value)


def _whole(kind: str, value: float | str) -> int:
    """Return an integer in the range of a type; ctypes would truncate a larger one."""
    number, bits = int(value), int("".join(filter(str.isdigit, kind)) or 32)
    lowest = 0 if kind.startswith("U") else -(2 ** (bits - 1))
    if (isinstance(value, float) and number != value) or not lowest <= number < lowest + 2**bits:
        raise ValueError(value)
    return number


def _variable(v: ModelVariable) -> Variable:
    return Variable(v.name, v.unit or "1", description=v.description or "", type=_KINDS[v.type])
