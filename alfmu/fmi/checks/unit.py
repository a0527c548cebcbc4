"""An FMU for co-simulation with the same calls for FMI 2 and 3, each of which returns its status."""

from __future__ import annotations

import ctypes
import math
import mmap
import os
import pickle
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import fmpy
import numpy as np
from fmpy import fmi2, fmi3
from fmpy.model_description import ModelDescription, ModelVariable

from ..markup import tree

OK, WARNING, DISCARD, ERROR, FATAL = range(5)
STATUS = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")
"""Names of status values of FMI by number."""

LONGEST = 500
"""Largest length of a call in the journal in bytes."""

TYPES = {
    "2": ("Real", "Integer", "Boolean", "String"),
    "3": (
        *("Float32", "Float64", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64"),
        *("Boolean", "String"),
    ),
}
"""Types with functions to get and set them; Binary and Clock of FMI 3 are left out."""


_ONCE = "canBeInstantiatedOnlyOncePerProcess is true, and this check takes more than one instance"

Result = TypeVar("Result")


class Broken(Exception):
    """A required call failed: its name, its status, and the FMU's log messages."""


class Once(Exception):
    """A check would instantiate an FMU twice that can be instantiated only once per process."""


class Journal:
    """The current call, in a file that survives a crash."""

    def __init__(self, path: Path):
        path.write_bytes(bytes(LONGEST))
        with path.open("r+b") as file:
            self._map = mmap.mmap(file.fileno(), LONGEST)

    def say(self, text: str) -> None:
        data = text.encode("utf-8", "replace")[: LONGEST - 1]
        self._map[: len(data) + 1] = data + b"\0"

    @staticmethod
    def read(path: Path) -> str:
        """Return the current call; empty if there is none."""
        return path.read_bytes().partition(b"\0")[0].decode("utf-8", "replace") if path.is_file() else ""


@dataclass(frozen=True)
class Variable:
    """A scalar variable of an FMU; `type` selects the functions that get and set it."""

    name: str
    reference: int
    type: str
    declared: str
    causality: str
    variability: str
    initial: str | None
    start: Any
    minimum: float | None
    maximum: float | None
    items: tuple[int, ...]
    """Item values of an enumeration."""
    nominal: float | None
    unit: str | None

    @classmethod
    def of(cls, v: ModelVariable, version: str) -> Variable:
        kind = {"Enumeration": "Integer" if version == "2" else "Int64"}.get(v.type, v.type)
        simple, items = v.declaredType, tuple[int, ...]()
        if v.type == "Enumeration" and simple is not None:
            items = tuple(int(item.value) for item in simple.items)

        def limit(name: str) -> float | None:
            text = getattr(v, name, None)
            text = getattr(simple, name, None) if text is None else text
            return None if text is None or kind in ("String", "Boolean") else float(text)

        unit = v.unit or getattr(simple, "unit", None)
        causality, variability = v.causality or "local", v.variability or "continuous"
        limits = limit("min"), limit("max"), items, limit("nominal"), unit
        start = None if v.start is None else _value(str(v.start), kind)
        return cls(v.name, v.valueReference, kind, v.type, causality, variability, _initial(v, version), start, *limits)


def _initial(v: ModelVariable, version: str) -> str | None:
    """Return the attribute `initial`, or its default, which both versions of FMI share."""
    if v.initial or v.causality in ("input", "independent"):
        return v.initial
    if v.variability == "constant" or v.causality in ("parameter", "structuralParameter"):
        return "exact"
    return "calculated"


def _value(text: str, kind: str) -> Any:
    if kind == "String":
        return text
    if kind == "Boolean":
        return text.lower() in ("true", "1")
    return float(text) if kind in ("Real", "Float32", "Float64") else int(text)


def _raw(self: Any, name: str, *arguments: Any) -> Any:
    """Call a function of fmpy and return the status instead of raising."""
    return self._functions[name](*arguments)


class FMU2Calls(fmi2.FMU2Slave):  # type: ignore[misc]
    _call = _raw


class FMU3Calls(fmi3.FMU3Slave):  # type: ignore[misc]
    _call = _raw


@dataclass
class Session:
    """An unpacked FMU: its description and its library, from which units are created."""

    folder: Path
    description: ModelDescription
    journal: Journal
    log: list[tuple[int, str, str]] = field(default_factory=list)
    """Messages since the latest call: status, category, text."""
    fatal: str = ""
    """The call that returned Fatal, after which the standard allows no other."""

    def __post_init__(self) -> None:
        d = self.description
        self.version = d.fmiVersion[:1]
        made = FMU2Calls if self.version == "2" else FMU3Calls
        self.journal.say("loading the library")
        self.library = made(
            guid=d.guid, modelIdentifier=d.coSimulation.modelIdentifier, unzipDirectory=str(self.folder)
        )
        self.journal.say("")
        self.types = TYPES[self.version]
        # fmpy reads some of these attributes by their names in the other version.
        root = tree((self.folder / "modelDescription.xml").read_bytes(), "modelDescription.xml")
        flags = (element.attrib.items() for element in root.findall("CoSimulation"))
        self.flags = {key: text.strip() for each in flags for key, text in each}
        scalar = [v for v in d.modelVariables if not v.dimensions and v.type not in ("Binary", "Clock")]
        self.variables = [Variable.of(v, self.version) for v in scalar]
        self.by_name = {v.name: v for v in self.variables}
        self._callbacks()
        experiment = d.defaultExperiment
        self.start = _number(experiment and experiment.startTime, 0.0)
        self.stop = _number(experiment and experiment.stopTime, self.start + 1.0)
        self.tolerance = _number(experiment and experiment.tolerance, None)
        fixed = getattr(d.coSimulation, "fixedInternalStepSize", None)
        step = _number(experiment and experiment.stepSize, None) or _number(fixed, None)
        self.step = step or (self.stop - self.start) / 500
        self.varies = self.flag("canHandleVariableCommunicationStepSize")
        self.once, self.made = self.flag("canBeInstantiatedOnlyOncePerProcess"), 0

    def flag(self, *names: str) -> bool:
        """Return whether one of these capabilities is declared."""
        return any(self.flags.get(name) in ("true", "1") for name in names)

    def of(self, *causalities: str) -> list[Variable]:
        return [v for v in self.variables if v.causality in causalities]

    @property
    def outputs(self) -> list[Variable]:
        return self.of("output")

    @property
    def real_inputs(self) -> list[Variable]:
        """Continuous inputs."""
        return [v for v in self.of("input") if v.type in ("Real", "Float64") and v.variability == "continuous"]

    @property
    def real_outputs(self) -> list[Variable]:
        """Continuous outputs."""
        return [v for v in self.outputs if v.type in ("Real", "Float64") and v.variability == "continuous"]

    @property
    def numbers(self) -> list[Variable]:
        """Numerical and Boolean outputs."""
        return [v for v in self.outputs if v.type != "String"]

    def name(self, function: str) -> str:
        return f"fmi{self.version}{function}"

    def apart(self, run: Callable[[], Result]) -> Result:
        """Return the result of a run with a separate instance, in a copy of this process if only one instance is
        allowed."""
        if not self.once:
            return run()
        if not hasattr(os, "fork"):
            raise Once(_ONCE)
        out, into = os.pipe()
        if (child := os.fork()) == 0:
            said: tuple[bool, object]
            try:
                said = True, run()
            except Exception as error:  # raised again in the parent process
                said = False, error
            with open(into, "wb") as file:
                file.write(pickle.dumps(said))
            os._exit(0)
        os.close(into)
        with open(out, "rb") as file:
            data = file.read()
        _, status = os.waitpid(child, 0)
        if status or not data:  # the copy died: fail as it did
            os._exit(128 + os.WTERMSIG(status) if os.WIFSIGNALED(status) else os.WEXITSTATUS(status))
        good, found = pickle.loads(data)
        if not good:
            raise found
        return found

    def unit(self, name: str = "one", token: str | None = None, logging: bool = True) -> Unit:
        """Create an instance; raise Broken if that fails, Once if only one is allowed per process."""
        self.made += 1
        if self.once and self.made > 1:
            raise Once(_ONCE)
        unit = Unit(self, name)
        unit.instantiate(token, logging)
        return unit

    def ready(self, values: Mapping[str, Any] | None = None, name: str = "one") -> Unit:
        """Create and initialise an instance, with these values set before initialisation."""
        unit = self.unit(name)
        unit.begin(values)
        return unit

    def _callbacks(self) -> None:
        def said(status: int, category: bytes | None, message: bytes | None) -> None:
            texts = [(text or b"").decode("utf-8", "replace") for text in (category, message)]
            self.log.append((status, texts[0], texts[1]))

        if self.version == "2":
            self.callbacks = fmi2.fmi2CallbackFunctions()
            self.callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(lambda e, n, status, c, m, *rest: said(status, c, m))
            self.callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(fmi2.calloc)
            self.callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(fmi2.free)
            fmpy.fmi1.addLoggerProxy(ctypes.byref(self.callbacks))
        else:
            self.callbacks = fmi3.fmi3LogMessageCallback(lambda e, status, c, m: said(status, c, m))


def _number(value: Any, default: Any) -> Any:
    try:
        return float(value)
    except (TypeError, ValueError):
        return default


class Unit:
    """An instance. Every call is written to the journal first; `status` is that of the latest."""

    def __init__(self, session: Session, name: str):
        self.session, self.name = session, name
        self.component: Any = None
        self.time = session.start

    # Calls ------------------------------------------------------------------------------------------------------------

    def call(self, function: str, *arguments: Any, said: str = "") -> int:
        """Call a function of FMI by its name without the prefix, and return the status."""
        s = self.session
        full = s.name(function)
        after = f" (after {s.fatal} had ended with Fatal)" if s.fatal else ""
        s.journal.say(f"{full}({said}){after}")
        s.log.clear()
        status = getattr(s.library, full)(self.component, *arguments)
        s.journal.say("")
        if status == FATAL:
            s.fatal = full
        return status

    def must(self, status: int, function: str) -> None:
        """Raise Broken if a call did not succeed."""
        if status > WARNING:
            raise Broken(f"{self.session.name(function)} ended with {shown(status)}{self.words()}")

    def words(self) -> str:
        """Return the FMU's messages of the latest call, as the end of a sentence."""
        texts = [text for _, _, text in self.session.log if text]
        return f": {texts[-1][:200]}" if texts else ""

    # Life cycle -------------------------------------------------------------------------------------------------------

    def instantiate(self, token: str | None = None, logging: bool = True) -> None:
        s, library = self.session, self.session.library
        identity = (s.description.guid if token is None else token).encode()
        s.log.clear()
        s.journal.say(s.name("Instantiate" if s.version == "2" else "InstantiateCoSimulation"))
        name = self.name.encode()
        if s.version == "2":
            folder = (s.folder / "resources").as_uri().encode()
            self.component = library.fmi2Instantiate(
                name, fmi2.fmi2CoSimulation, identity, folder, ctypes.byref(s.callbacks), 0, int(logging)
            )
        else:
            folder = f"{s.folder / 'resources'}/".encode()
            none = (fmi3.fmi3ValueReference * 0)()
            truth = fmi3.fmi3Boolean
            self.component = library.fmi3InstantiateCoSimulation(
                *(name, identity, folder, truth(False), truth(logging), truth(False), truth(False), none, 0, None),
                *(s.callbacks, fmi3.fmi3IntermediateUpdateCallback()),
            )
        s.journal.say("")
        if not self.component:
            raise Broken(f"the FMU cannot be instantiated{self.words()}")

    def begin(self, values: Mapping[str, Any] | None = None, start: float | None = None) -> None:
        """Initialise with these values set before; raise Broken if a call fails."""
        self.must(self.enter(start), "EnterInitializationMode")
        for name, value in (values or {}).items():
            v = self.session.by_name[name]
            self.must(self.set(v, value), f"Set{v.type}")
        self.must(self.exit(), "ExitInitializationMode")

    def setup(self, start: float | None = None) -> int:
        """Call `fmi2SetupExperiment`; return OK in FMI 3, which has none."""
        s = self.session
        self.time = s.start if start is None else start
        if s.version == "3":
            return OK
        return self.call("SetupExperiment", 0, 0.0, self.time, 0, 0.0, said=f"startTime={self.time:g}")

    def enter(self, start: float | None = None) -> int:
        """Set up and enter the initialisation mode."""
        s = self.session
        if (status := self.setup(start)) > WARNING:
            return status
        if s.version == "2":
            return self.call("EnterInitializationMode")
        no = fmi3.fmi3Boolean(False)
        return self.call("EnterInitializationMode", no, 0.0, self.time, no, 0.0, said=f"startTime={self.time:g}")

    def show_starts(self) -> None:
        """Make start values readable: FMI 3 allows it after instantiation, FMI 2 in initialisation mode."""
        if self.session.version == "2":
            self.must(self.enter(), "EnterInitializationMode")

    def exit(self) -> int:
        return self.call("ExitInitializationMode")

    def terminate(self) -> int:
        return self.call("Terminate")

    def reset(self) -> int:
        return self.call("Reset")

    def free(self) -> None:
        s = self.session
        s.journal.say(s.name("FreeInstance"))
        getattr(s.library, s.name("FreeInstance"))(self.component)
        s.journal.say("")
        self.component = None

    def end(self) -> None:
        """Terminate and free the instance, unless that is forbidden."""
        if self.component and not self.session.fatal:
            self.free()

    # Values -----------------------------------------------------------------------------------------------------------

    def get_raw(self, kind: str, references: Sequence[int]) -> tuple[int, list[Any]]:
        """Return status and values of a type, by references."""
        s = self.session
        values = (_ctype(s.name(kind)) * len(references))()
        array = (ctypes.c_uint * len(references))(*references)
        size = () if s.version == "2" else (len(references),)
        said = f"vr={_short(references)}"
        status = self.call(f"Get{kind}", array, len(references), values, *size, said=said)
        if kind == "String":
            return status, [(each or b"").decode("utf-8", "replace") for each in values]
        return status, [bool(each) for each in values] if kind == "Boolean" else list(values)

    def set_raw(self, kind: str, references: Sequence[int], values: Sequence[Any]) -> int:
        s = self.session
        given = [str(x).encode() for x in values] if kind == "String" else values
        data = (_ctype(s.name(kind)) * len(given))(*given)
        array = (ctypes.c_uint * len(references))(*references)
        size = () if s.version == "2" else (len(given),)
        said = f"vr={_short(references)}, value={_short(values)}"
        return self.call(f"Set{kind}", array, len(references), data, *size, said=said)

    def get(self, v: Variable) -> tuple[int, Any]:
        status, values = self.get_raw(v.type, [v.reference])
        return status, values[0]

    def set(self, v: Variable, value: Any) -> int:
        return self.set_raw(v.type, [v.reference], [value])

    def read(self, variables: Iterable[Variable]) -> np.ndarray:
        """Return the values of numerical variables; raise Broken if one cannot be read."""
        variables = list(variables)
        found = np.empty(len(variables))
        for kind in dict.fromkeys(v.type for v in variables):
            places = [i for i, v in enumerate(variables) if v.type == kind]
            status, values = self.get_raw(kind, [variables[i].reference for i in places])
            self.must(status, f"Get{kind}")
            found[places] = values
        return found

    # Steps ------------------------------------------------------------------------------------------------------------

    def step_raw(self, time: float, size: float) -> int:
        """Return the status of a communication step; one that FMI 3 ended early counts as Discard."""
        s, said = self.session, f"from {time:g} s, by {size:g} s"
        if s.version == "2":
            return self.call("DoStep", time, size, 1, said=said)
        events, ended, early = (fmi3.fmi3Boolean() for _ in range(3))
        reached = fmi3.fmi3Float64(math.nan)
        refs = (ctypes.byref(each) for each in (events, ended, early, reached))
        status = self.call("DoStep", time, size, fmi3.fmi3Boolean(True), *refs, said=said)
        return DISCARD if status <= WARNING and (ended.value or early.value) else status

    def step(self, size: float | None = None) -> None:
        """Make a communication step from the current time; raise Broken if it fails."""
        size = self.session.step if size is None else size
        self.must(self.step_raw(self.time, size), f"DoStep from {self.time:g} s by {size:g} s")
        self.time += size

    # State ------------------------------------------------------------------------------------------------------------

    def save(self) -> ctypes.c_void_p:
        state = ctypes.c_void_p()
        name = state_call("GetFMUState", self.session.version)
        self.must(self.call(name, ctypes.byref(state)), name)
        return state

    def restore(self, state: ctypes.c_void_p) -> None:
        name = state_call("SetFMUState", self.session.version)
        self.must(self.call(name, state), name)

    def forget(self, state: ctypes.c_void_p) -> None:
        name = state_call("FreeFMUState", self.session.version)
        self.must(self.call(name, ctypes.byref(state)), name)

    def write(self, state: ctypes.c_void_p) -> bytes:
        """Serialise a state."""
        size, version = ctypes.c_size_t(), self.session.version
        name = state_call("SerializedFMUStateSize", version)
        self.must(self.call(name, state, ctypes.byref(size)), name)
        data = (ctypes.c_uint8 * size.value)()
        bytes_ = ctypes.cast(data, ctypes.POINTER(_BYTE[version]))
        name = state_call("SerializeFMUState", version)
        self.must(self.call(name, state, bytes_, size.value), name)
        return bytes(data)

    def load(self, data: bytes) -> ctypes.c_void_p:
        state, version = ctypes.c_void_p(), self.session.version
        array = (ctypes.c_uint8 * len(data)).from_buffer_copy(data)
        bytes_ = ctypes.cast(array, ctypes.POINTER(_BYTE[version]))
        name = state_call("DeserializeFMUState", version)
        self.must(self.call(name, bytes_, len(data), ctypes.byref(state)), name)
        return state

    # Derivatives ------------------------------------------------------------------------------------------------------

    def directional(
        self, unknowns: Sequence[Variable], knowns: Sequence[Variable], seed: Sequence[float], adjoint: bool = False
    ) -> tuple[int, np.ndarray]:
        """Return the status, and J seed (or J' seed) for the derivatives J of unknowns by knowns."""
        s = self.session
        rows, columns = ([v.reference for v in each] for each in (unknowns, knowns))
        arrays = [(ctypes.c_uint * len(each))(*each) for each in (rows, columns)]
        given = (ctypes.c_double * len(seed))(*seed)
        found = (ctypes.c_double * (len(columns) if adjoint else len(rows)))()
        said = f"unknowns={_short(rows)}, knowns={_short(columns)}"
        head = arrays[0], len(rows), arrays[1], len(columns), given
        if s.version == "2":
            status = self.call("GetDirectionalDerivative", *head, found, said=said)
        else:
            name = "GetAdjointDerivative" if adjoint else "GetDirectionalDerivative"
            status = self.call(name, *head, len(seed), found, len(found), said=said)
        return status, np.array(found)

    def output_derivatives(self, outputs: Sequence[Variable], order: int) -> tuple[int, np.ndarray]:
        s, count = self.session, len(outputs)
        references = (ctypes.c_uint * count)(*(v.reference for v in outputs))
        orders, found = (ctypes.c_int * count)(*[order] * count), (ctypes.c_double * count)()
        size = () if s.version == "2" else (count,)
        name = "GetRealOutputDerivatives" if s.version == "2" else "GetOutputDerivatives"
        said = f"vr={_short([v.reference for v in outputs])}, order={order}"
        return self.call(name, references, count, orders, found, *size, said=said), np.array(found)

    def logging(self, on: bool, categories: Sequence[str]) -> int:
        version = self.session.version
        names = (ctypes.c_char_p * len(categories))(*(each.encode() for each in categories))
        flag = int(on) if version == "2" else fmi3.fmi3Boolean(on)
        return self.call("SetDebugLogging", flag, len(categories), names, said=_short(categories))


def state_call(name: str, version: str) -> str:
    """Return the name of a function of the state in a version of FMI."""
    return name.replace("FMUState", "FMUstate").replace("Deserialize", "DeSerialize") if version == "2" else name


def shown(status: int) -> str:
    return STATUS[status] if 0 <= status < len(STATUS) else f"status {status}, which FMI does not know"


_BYTE: dict[str, Any] = {"2": fmi2.fmi2Byte, "3": fmi3.fmi3Byte}


def _ctype(name: str) -> Any:
    return getattr(fmi2 if name.startswith("fmi2") else fmi3, name)


def _short(values: Sequence[Any]) -> str:
    shown = ", ".join(f"{x:.6g}" if isinstance(x, float) else str(x) for x in values[:6])
    return f"[{shown}{', ...' if len(values) > 6 else ''}]"
