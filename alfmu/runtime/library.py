"""The C library of the runtime by ctypes: scenes, and units that run them. It needs Python alone.

This module and the library beside it are packed into FMUs for Python.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable, Sequence
from ctypes import POINTER, c_char_p, c_double, c_int, c_int64, c_long, c_size_t, c_void_p
from functools import cache, partial
from pathlib import Path

DONE, REFUSED, OPEN, FAILED, UNHELD, BRAKES, ENDED = range(7)
"""Outcomes of a call: success; rejected, with nothing changed; constraints that cannot be closed; failure; a massless
body that nothing holds; redundant constraints that the scene must be traced for; no further step, as a law of time
breaks."""

INTERRUPTED = -1
"""Outcome of a run that its callback ended."""

_KINDS = ("parameter", "choice", "input", "switch", "output")
_TYPES = ("Real", "Integer", "Boolean", "String")
_WHY = 500

_Progress = ctypes.CFUNCTYPE(c_int, c_long)


class _Run(ctypes.Structure):
    _fields_ = (
        ("times", c_void_p),
        ("count", c_long),
        ("inputs", c_void_p),
        ("input_count", c_int),
        ("table", c_void_p),
        ("wanted", c_void_p),
        ("wanted_count", c_int),
        ("values", c_void_p),
        ("progress", _Progress),
    )


_SIGNATURES = {
    "warns": (c_void_p, c_void_p),
    "warning": (c_char_p, c_void_p),
    "balance": (c_double, c_void_p),
    "scene_version": (c_int,),
    "scene_load": (c_void_p, c_char_p, c_size_t, c_char_p, c_size_t),
    "scene_compiled": (c_int, c_void_p, c_void_p, c_int, c_int, c_char_p, c_int),
    "lane_flags": (c_char_p,),
    "scene_free": (None, c_void_p),
    "new": (c_void_p, c_void_p),
    "length": (c_size_t, c_void_p, c_int),
    "free": (None, c_void_p),
    "reset": (None, c_void_p),
    "text": (c_char_p, c_void_p),
    "name": (c_char_p, c_void_p),
    "variable_count": (c_int, c_void_p),
    "variable": (c_char_p, c_void_p, c_int, POINTER(c_int), POINTER(c_int)),
    "set": (c_int, c_void_p, c_int, c_double),
    "choose": (c_int, c_void_p, c_int, c_char_p),
    "chosen": (c_char_p, c_void_p, c_int),
    "get": (c_double, c_void_p, c_int),
    "get_many": (c_int, c_void_p, c_void_p, c_int, c_void_p),
    "time": (c_double, c_void_p),
    "set_time": (None, c_void_p, c_double),
    "slope": (c_int, c_void_p, c_int, c_double),
    "tolerate": (c_int, c_void_p, c_double),
    "begin": (c_int, c_void_p, c_double, c_double),
    "run_on": (None, c_void_p, c_int),
    "initialized": (c_int, c_void_p),
    "initialize": (c_int, c_void_p),
    "ready": (c_int, c_void_p, c_double, c_double),
    "breaks": (c_int, c_void_p, c_void_p),
    "step": (c_int, c_void_p, c_double, c_double),
    "python_step": (c_void_p, c_void_p),
    "read": (c_int, c_void_p, c_void_p),
    "state_size": (c_size_t, c_void_p),
    "save": (None, c_void_p, c_char_p),
    "restore": (c_int, c_void_p, c_char_p, c_size_t),
    "state": (c_void_p, c_void_p),
    "stabilise": (c_int, c_void_p, c_double, c_double, c_int),
    "update_way": (None, c_void_p),
    "mobility": (c_int, c_void_p, c_int, POINTER(c_int), POINTER(c_int), POINTER(c_int), c_void_p),
    "brakes": (c_int, c_void_p),
    "penalize": (c_int, c_void_p, c_void_p),
    "penalties": (None, c_void_p, c_void_p),
    "counts": (None, c_void_p, c_void_p),
    "run": (c_long, c_void_p, POINTER(_Run), POINTER(c_int)),
    "batch_new": (c_void_p, c_void_p, c_size_t),
    "batch_free": (None, c_void_p),
    "batch_member": (c_void_p, c_void_p, c_size_t),
    "batch_set": (None, c_void_p, c_void_p, c_int, c_void_p, c_void_p, c_void_p),
    "batch_get": (None, c_void_p, c_void_p, c_int, c_void_p, c_void_p, c_void_p),
    "batch_initialize": (None, c_void_p, c_void_p, c_void_p),
    "batch_step": (None, c_void_p, c_double, c_void_p, c_void_p),
    "batch_run": (None, c_void_p, POINTER(_Run), c_void_p, c_int, *[c_void_p] * 4),
    "gradient_new": (c_void_p, c_void_p, c_int),
    "gradient_free": (None, c_void_p),
    "tangent_run": (c_long, c_void_p, POINTER(_Run), c_int, c_void_p, c_void_p, c_void_p, POINTER(c_int)),
    "recorded_run": (c_long, c_void_p, POINTER(_Run), c_double, POINTER(c_int)),
    "adjoint_run": (c_int, c_void_p, POINTER(_Run), c_void_p, c_void_p, c_void_p),
    "arrange": (c_int, c_int, c_void_p, c_void_p, c_void_p, c_int, *[c_void_p] * 4),
    "in_runs": (c_int, c_int, c_int, *[c_void_p] * 7),
    "share_places": (c_int, c_void_p),
    "listing": (c_int, ctypes.c_char_p, c_int, c_void_p, c_int, c_void_p),
    "instructions": (c_int, c_int, *[c_void_p] * 6),
    "straight": (c_int, c_int, *[c_void_p] * 7, c_int, c_void_p, c_int64, *[c_void_p] * 4),
}
"""Result and argument types of each function."""


@cache
def library(folder: Path = Path(__file__).parent) -> ctypes.CDLL:
    """Load the library for this machine from a folder; raise OSError if there is none, AttributeError if it lacks a
    function."""
    suffix = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
    there = sorted(folder.glob(f"alfmu-*{suffix}"))
    loaded, why = None, f"there is no alfmu-*{suffix} in {folder}"
    for path in there:
        try:
            loaded = ctypes.CDLL(str(path))
            break
        except OSError as error:  # built for another processor
            why = str(error)
    if loaded is None:
        source = folder.parent.parent
        if not there and (source / "pyproject.toml").is_file():
            raise OSError(
                f"Python takes alfmu from its source folder {source}, where the runtime is not built; run this in "
                f"another folder, or build it there: pip install -e {source}"
            )
        raise OSError(f"alfmu's runtime for this machine is missing ({why}); install alfmu again, with a C compiler")
    for name, (result, *arguments) in _SIGNATURES.items():
        function = getattr(loaded, f"alfmu_{name}")
        function.restype, function.argtypes = result, arguments
    return loaded


class Scene:
    """A scene that a library has loaded and checked; ValueError if it is no scene of the library's version."""

    def __init__(self, data: bytes, by: ctypes.CDLL):
        self.library: ctypes.CDLL = by
        self.code: list[ctypes.CDLL] = []
        why = ctypes.create_string_buffer(_WHY)
        self.address: int | None = self.library.alfmu_scene_load(data, len(data), why, _WHY)
        if not self.address:
            raise ValueError(why.value.decode(errors="replace"))
        self.name: str = self.library.alfmu_name(self.address).decode(errors="replace")
        kind, type_ = c_int(), c_int()
        self.names: list[str] = []
        self.types: list[str] = []
        self.kinds: list[str] = []
        for reference in range(self.library.alfmu_variable_count(self.address)):
            name = self.library.alfmu_variable(self.address, reference, ctypes.byref(type_), ctypes.byref(kind))
            self.names.append(name.decode(errors="replace"))
            self.types.append(_TYPES[type_.value])
            self.kinds.append(_KINDS[kind.value])
        self.references: dict[str, int] = {name: reference for reference, name in enumerate(self.names)}
        self.first_output: int = self.kinds.index("output") if "output" in self.kinds else len(self.kinds)

    def compiled_by(self, path: Path, in_lanes: bool = False) -> None:
        """Run compiled functions, or ones in lanes, instead of interpreted ones; raise ValueError if they belong to
        another scene."""
        code = ctypes.CDLL(str(path))
        count, spare = (c_int.in_dll(code, f"alfmu_{name}").value for name in ("function_count", "spare"))
        table = (c_void_p * count).in_dll(code, "alfmu_functions")
        identity = ctypes.string_at(ctypes.addressof(ctypes.c_char.in_dll(code, "alfmu_scene")))
        if not self.library.alfmu_scene_compiled(
            self.address, ctypes.addressof(table), count, spare, identity, in_lanes
        ):
            raise ValueError(f"{self.name}: {path.name} has the functions of another scene; export it again")
        self.code.append(code)  # keeps the library alive as long as the scene

    def __del__(self) -> None:
        if getattr(self, "address", None):
            self.library.alfmu_scene_free(self.address)


_OF_PYTHON = (
    *("PyFloat_AsDouble", "PyLong_AsVoidPtr", "PyErr_Occurred"),
    *("PyEval_SaveThread", "PyEval_RestoreThread", "PyLong_FromLong"),
)
"""Functions of Python's C interface that the library calls, in its order."""


def _step_of(c: ctypes.CDLL, address: int) -> Callable[[float, float], int]:
    """Return `alfmu_step` bound to an instance: a built-in function in CPython, else a ctypes call."""
    if sys.implementation.name != "cpython":
        return partial(c.alfmu_step, c_void_p(address))
    functions = (ctypes.cast(getattr(ctypes.pythonapi, name), c_void_p).value for name in _OF_PYTHON)
    make = ctypes.pythonapi.PyCFunction_NewEx
    make.restype, make.argtypes = ctypes.py_object, (c_void_p, ctypes.py_object, c_void_p)
    return make(c.alfmu_python_step((c_void_p * len(_OF_PYTHON))(*functions)), address, None)


class Unit:
    """One instance of a scene, with calls by value reference that return an outcome."""

    def __init__(self, scene: Scene):
        c = scene.library
        self.scene: Scene = scene
        self.address: int | None = c.alfmu_new(scene.address)
        if not self.address:
            raise MemoryError("there is not enough memory for an instance")
        address = self.address
        self.step: Callable[[float, float], int] = _step_of(c, address)
        """Makes a communication step from a start with a length [s]; returns the outcome."""
        self._read, self._get = c.alfmu_read, c.alfmu_get
        self._outputs = (c_double * (len(scene.names) - scene.first_output))()
        self._place = ctypes.addressof(self._outputs)
        self._many: dict[tuple[int, ...], tuple[ctypes.Array[c_int], ctypes.Array[c_double]]] = {}
        self._address = address
        self.warns: c_int = c_int.from_address(c.alfmu_warns(address))
        """Whether there is an unread warning."""

    def __del__(self) -> None:
        if getattr(self, "address", None):
            self.scene.library.alfmu_free(self.address)

    @property
    def text(self) -> str:
        """Why the last call was rejected or failed."""
        return self.scene.library.alfmu_text(self.address).decode(errors="replace")

    def warning(self) -> str:
        """Return the unread warning, empty if there is none."""
        if not self.warns.value:
            return ""
        self.warns.value = 0
        return self.scene.library.alfmu_warning(self.address).decode(errors="replace")

    @property
    def initialized(self) -> bool:
        return bool(self.scene.library.alfmu_initialized(self.address))

    @property
    def time(self) -> float:
        """Time [s]."""
        return self.scene.library.alfmu_time(self.address)

    @time.setter
    def time(self, value: float) -> None:
        self.scene.library.alfmu_set_time(self.address, value)

    def reset(self) -> None:
        self.scene.library.alfmu_reset(self.address)

    def _known(self, references: Sequence[int]) -> None:
        """Raise IndexError for an unknown value reference, which the library would read out of bounds."""
        for each in references:
            if not 0 <= each < len(self.scene.kinds):
                raise IndexError(f"{self.scene.name}: no variable has the value reference {each}")

    def set(self, reference: int, value: float | str) -> int:
        self._known([reference])
        c = self.scene.library
        if self.scene.kinds[reference] == "choice":
            return c.alfmu_choose(self.address, reference, str(value).encode())
        return c.alfmu_set(self.address, reference, value)

    def get(self, reference: int) -> float | str:
        self._known([reference])
        if self.scene.kinds[reference] == "choice":
            return self.scene.library.alfmu_chosen(self.address, reference).decode()
        return self._get(self._address, reference)

    def get_many(self, references: Sequence[int]) -> tuple[int, list[float]]:
        """Return the outcome and the values; NaN if outputs cannot be computed."""
        key = tuple(references)
        if key not in self._many:
            self._known(key)
            if len(self._many) > _KEPT:
                self._many.clear()
            self._many[key] = (c_int * len(key))(*key), (c_double * len(key))()
        wanted, values = self._many[key]
        outcome = self.scene.library.alfmu_get_many(self.address, wanted, len(key), values)
        return outcome, values[:]

    def slope(self, reference: int, value: float) -> int:
        """Set the rate of change per second of an input in the next communication step."""
        return self.scene.library.alfmu_slope(self.address, reference, value)

    def tolerate(self, tolerance: float) -> int:
        return self.scene.library.alfmu_tolerate(self.address, tolerance)

    def begin(self, start: float, stop: float) -> int:
        """Set the start time of a run, and the time that no step may exceed."""
        return self.scene.library.alfmu_begin(self.address, start, stop)

    def run_on(self, running: bool) -> None:
        """Set whether parameters are fixed."""
        self.scene.library.alfmu_run_on(self.address, running)

    def initialize(self) -> int:
        return self.scene.library.alfmu_initialize(self.address)

    def read(self) -> int:
        """Compute all outputs into `outputs`."""
        return self._read(self._address, self._place)

    @property
    def outputs(self) -> ctypes.Array[c_double]:
        """Results of the last `read`, overwritten by the next call."""
        return self._outputs

    def save(self) -> bytes:
        size = self.scene.library.alfmu_state_size(self.address)
        state = ctypes.create_string_buffer(size)
        self.scene.library.alfmu_save(self.address, state)
        return state.raw

    def restore(self, state: bytes) -> int:
        return self.scene.library.alfmu_restore(self.address, state, len(state))

    def run(self, run: Run) -> tuple[int, int]:
        """Make a run; return the number of rows and the outcome."""
        outcome = c_int()
        made = self.scene.library.alfmu_run(self.address, ctypes.byref(run.asked), ctypes.byref(outcome))
        return made, outcome.value


class Run:
    """Arguments of a run in one call: communication points, inputs and values by address, references.

    `progress` is called after each communication step; the run ends when it returns False or raises. An error that it
    raises is kept in `raised`.
    """

    def __init__(
        self,
        times: int,
        count: int,
        inputs: Sequence[int],
        table: int,
        wanted: Sequence[int],
        values: int,
        progress: Callable[[int], bool] | None = None,
    ):
        self.raised: list[BaseException] = []
        raised = self.raised

        def guarded(done: int) -> int:
            try:
                return int(progress is None or progress(done) is not False)
            except BaseException as error:
                raised.append(error)
                return 0

        columns, read = (c_int * len(inputs))(*inputs), (c_int * len(wanted))(*wanted)
        places = [ctypes.cast(each, c_void_p) for each in (columns, read)]
        callback = _Progress(guarded) if progress else _Progress()
        self._kept = columns, read, callback
        self.asked: _Run = _Run(times, count, places[0], len(inputs), table, places[1], len(wanted), values, callback)


_KEPT = 50
"""Number of lists of references whose arrays a unit caches."""
